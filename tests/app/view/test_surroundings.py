"""The other labels around a body: made for a scene, and sent to the viewers that ask for them."""

from __future__ import annotations

import asyncio
import json
import struct
import sys
from pathlib import Path

import numpy as np
import pytest

from palpate.app.view.surroundings import surroundings_of
from palpate.scenes.open_scene import open_scene
from palpate.surface.labels.surroundings import NO_SURROUNDINGS, Surroundings
from palpate.surface.surface import Surface

sys.path.insert(0, str(Path(__file__).parents[2] / "surface" / "labels"))
from label_files import caret, nifti

TETRAHEDRON = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]])
SIDES = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
SHAPES = (Surface(TETRAHEDRON, SIDES, "Niere links"), Surface(TETRAHEDRON + 0.2, SIDES[:3], "rib «7»"))
EDGES = np.array([[[0.0, 0.0, 0.1], [0.0, 0.0, -1.0]]])
AROUND = Surroundings(SHAPES, EDGES)


@pytest.fixture
def label_file(tmp_path):
    """A block along x, y, z of RAS, and a rib at its front."""
    values = np.zeros((60, 50, 40), dtype="u1")
    values[5:45, 5:35, 5:25] = 1
    values[10:40, 36:40, 8:22] = 2
    path = tmp_path / "trunk.nii"
    path.write_bytes(nifti(values, sform=np.diag([2.0, 2.0, 2.0, 1.0]), extension=caret({1: "liver", 2: "rib"})))
    return path


def test_the_surroundings_are_in_the_frame_and_unit_of_the_body(label_file):
    for scale in (1.0, 0.5):
        scene = open_scene(label_file, {"scale": scale}, part=["liver"])
        (rib,), edges = surroundings_of(scene)
        assert not len(edges)
        assert rib.name == "rib"
        assert rib.space == scene.surface.space == "LPS"
        body, shape = scene.surface.vertices, rib.vertices
        assert shape[:, 1].max() == pytest.approx(body[:, 1].min(), abs=5e-3 * scale)  # at the front: y is to the rear
        assert body[:, 0].min() < shape[:, 0].min()
        assert shape[:, 0].max() < body[:, 0].max()


def test_a_surface_file_has_no_surroundings(tmp_path):
    path = tmp_path / "organ.off"
    rows = ["OFF 4 4 0", *(" ".join(map(str, x)) for x in TETRAHEDRON), *(f"3 {a} {b} {c}" for a, b, c in SIDES)]
    path.write_text("\n".join(rows))
    assert surroundings_of(open_scene(path, {"units": "m"})) is NO_SURROUNDINGS


def test_planes_of_the_image_edge_lie_on_the_flat_faces_that_it_cuts(tmp_path):
    """A block whose upper half of a slanted grid is beyond the image."""
    values = np.zeros((30, 30, 20), dtype="u1")
    values[5:25, 5:25, 8:] = 1
    turned = np.array([[2.0, 0.0, 0.5, 7.0], [0.0, 2.5, 0.0, -3.0], [-0.5, 0.0, 3.0, 11.0], [0.0, 0.0, 0.0, 1.0]])
    path = tmp_path / "slab.nii"
    path.write_bytes(nifti(values, sform=turned, extension=caret({1: "liver"})))
    scene = open_scene(path, part=["liver"])
    shapes, ((point, normal),) = surroundings_of(scene)
    assert shapes == ()
    above = (scene.surface.vertices - point) @ normal  # inwards
    near = np.abs(above) < 4e-4
    corners = scene.surface.vertices[scene.surface.triangles]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]) / 2
    faces = near[scene.surface.triangles].all(axis=1)
    assert above.min() > -1e-3
    assert 0.65 < -(area[faces] @ normal).sum() / (20 * 2.06e-3 * 20 * 2.5e-3) < 1.0  # without its rounded rim


def decoded(frame):
    """Positions, triangles, numbers of triangles and the rest of a frame; see docs/reference/protocol.md."""
    kind, count, n, t = struct.unpack("<4I", frame[:16])
    assert kind == 7
    points = np.frombuffer(frame, "<f4", 3 * n, 16).reshape(-1, 3)
    triangles = np.frombuffer(frame, "<u4", 3 * t, 16 + 12 * n).reshape(-1, 3)
    sizes = np.frombuffer(frame, "<u4", count, 16 + 12 * (n + t))
    return points, triangles, sizes, json.loads(frame[16 + 12 * (n + t) + 4 * count :])


def test_viewers_that_ask_get_the_shapes_once_after_the_first_state(site):
    async def run():
        async with site.client(more={"surroundings": True}) as own, site.client() as other:
            site.loop.call_soon_threadsafe(site.server.surround, AROUND)
            await own.hear_until(lambda c: c.surroundings)
            states, frame = own.surroundings[0]
            assert states >= 1
            points, triangles, sizes, rest = decoded(frame)
            np.testing.assert_allclose(points, np.concatenate([each.vertices for each in SHAPES]), atol=1e-6)
            np.testing.assert_array_equal(triangles, np.concatenate([SIDES, SIDES[:3] + 4]))
            assert sizes.tolist() == [4, 3]
            assert rest == {
                "names": [each.name for each in SHAPES],
                "kinds": ["organ", "bone"],
                "edges": EDGES.tolist(),
            }
            for client in (own, other):
                await client.say(type="latency", stamp=1)
                await client.told("latency")
            assert len(own.surroundings) == 1
            assert not other.surroundings
        async with site.client(more={"surroundings": True}) as late:
            await late.hear_until(lambda c: c.surroundings)
            assert late.surroundings[0] == (late.surroundings[0][0], frame)

    asyncio.run(run())


def test_nothing_is_sent_where_there_is_nothing_around_a_body(site):
    async def run():
        async with site.client(more={"surroundings": True}) as own:
            site.loop.call_soon_threadsafe(site.server.surround, NO_SURROUNDINGS)
            await own.hear_until(lambda c: len(c.states) > 0)
            await own.say(type="latency", stamp=2)
            await own.told("latency")
            assert not own.surroundings

    asyncio.run(run())


def test_the_title_names_the_organ_and_the_file(label_file):
    assert open_scene(label_file, part=["liver"]).title == "Liver (trunk)"
    assert open_scene(label_file, part=["liver", "rib"]).title == "Liver, rib (trunk)"
