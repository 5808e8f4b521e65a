"""A full body from the file of a surface: what is guessed, and which options are refused."""

from __future__ import annotations

import json
from pathlib import Path
from time import monotonic, sleep

import numpy as np
import pytest

import palpate as pt
from palpate.app.common.compile_ahead import _NotCompiledError
from palpate.app.common.console import Console
from palpate.app.models import full_body
from palpate.app.models.full_body import full_body_lines, prepare_full_body
from palpate.app.models.input import open_input
from palpate.app.models.spacing import FINER_NODES, MAX_NODES, _seconds_per_node, better_spacing, realtime_spacing
from palpate.app.session.messages import validate_message
from palpate.app.session.session import Session
from palpate.meshfree.cloud import BORDER_MARGIN
from palpate.scenes.description import Shape
from palpate.scenes.open_scene import open_scene
from palpate.scenes.organ import liver_surface
from palpate.scenes.places import PlaceFinder, place_of_text, side_mask
from palpate.surface.files import read_surface

POINTS = np.random.default_rng(0).uniform(-1.0, 1.0, (500, 3))
CLOUD = pt.Cloud(
    points=POINTS, volumes=np.ones(500), face_nodes=np.arange(500), face_normals=np.tile([0.0, 0.0, 1.0], (500, 1)),
    face_areas=np.ones(500), groups={}, triangles=np.zeros((0, 3), dtype=np.int64), spacing=0.2,
)  # fmt: skip


@pytest.fixture(scope="module")
def organ(tmp_path_factory):
    """An OFF file of a small liver in millimetres."""
    surface, path = liver_surface(0.006, 6e-5), tmp_path_factory.mktemp("organ") / "my_organ.off"
    path.write_text(
        f"OFF\n{len(surface.vertices)} {len(surface.triangles)} 0\n"
        + "".join(f"{x} {y} {z}\n" for x, y, z in 1e3 * surface.vertices)
        + "".join(f"3 {a} {b} {c}\n" for a, b, c in surface.triangles)
    )
    return path


def opened(path, **options):
    """Return the full body of a surface file."""
    return described(path, **options)[0]


def described(path, fixed=(), **settings):
    """Return the full body of a surface file, and the lines about it."""
    scene = open_scene(path, settings, fixed=fixed)
    fitted = prepare_full_body(scene, Console().status)
    return fitted.body, "\n".join(full_body_lines(scene, fitted))


def mask(text, unit=1.0):
    """Return the nodes of the cloud that the text of a support names."""
    return PlaceFinder(CLOUD, Shape(generated="liver"), unit).mask(place_of_text(text))


def held(body):
    """Return the nodes that the supports of a body hold."""
    return np.unique(np.concatenate([body.cloud.group(each.group) for each in body.supports]))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("x-", POINTS[:, 0] <= POINTS[:, 0].min() + 0.12 * np.ptp(POINTS[:, 0])),
        ("z+", POINTS[:, 2] >= POINTS[:, 2].max() - 0.12 * np.ptp(POINTS[:, 2])),
        ("lowest 15%", POINTS[:, 2] <= POINTS[:, 2].min() + 0.15 * np.ptp(POINTS[:, 2])),
        ("near 100,200,-300,500", np.linalg.norm(POINTS - [0.1, 0.2, -0.3], axis=1) <= 0.5),
    ],
)
def test_supports_hold_the_nodes_of_their_text(text, expected):
    np.testing.assert_array_equal(mask(text), expected)


@pytest.mark.slow
def test_several_supports_hold_the_nodes_of_all(organ):
    body = opened(organ, spacing=0.006, fixed=("x-", "x+"))
    points = body.cloud.points
    width = BORDER_MARGIN * body.cloud.spacing
    expected = np.flatnonzero(side_mask(points, "x-", width) | side_mask(points, "x+", width))
    np.testing.assert_array_equal(held(body), expected)


def test_the_default_support_is_away_from_the_first_view():
    held = POINTS[mask("back")]
    assert held[:, 1].mean() > 0.5  # the camera is at negative y
    assert held[:, 2].mean() < 0.0  # and above


@pytest.mark.parametrize("text", ["x", "lowest", "near 1,2,3", "lowest 0%", "lowest 150%", "painted"])
def test_other_texts_of_supports_are_refused(text):
    with pytest.raises(pt.InputError, match="fixed must be"):
        mask(text)


def test_a_surface_is_read_once_for_training(organ, monkeypatch):
    read = []
    monkeypatch.setattr(
        "palpate.scenes.scene.read_surface", lambda path, **chosen: read.append(path) or read_surface(path, **chosen)
    )
    monkeypatch.chdir(organ.parent)
    scene = open_input(organ.name, for_training=True, units="mm").scene
    assert scene.name == str(organ)
    assert scene.surface.name == organ.name
    assert scene.surface is scene.with_body(spacing=0.006).surface
    assert read == [Path(organ.name)]


def test_a_slower_machine_steps_a_coarser_body(monkeypatch):
    material = pt.materials.NeoHookean(C1=1.1e3, density=1060.0, poisson=0.45)
    spacings = []
    for seconds in (1e-7, 2e-7, 1e-6):
        monkeypatch.setattr("palpate.app.models.spacing._seconds_per_node", lambda m, s=seconds: s)
        spacings.append(realtime_spacing(1.5e-3, material))
    assert spacings[0] < spacings[1] < spacings[2]
    # nodes times steps a second: the fourth power of the spacing
    assert spacings[1] / spacings[0] == pytest.approx(2**0.25, rel=0.03)


def test_the_pace_is_guessed_where_a_measurement_would_compile(monkeypatch):
    def compiled_later(*_):
        raise _NotCompiledError

    monkeypatch.setattr("palpate.app.models.spacing.sample_block", compiled_later)
    assert _seconds_per_node(pt.materials.NeoHookean(C1=1.1e3, density=1060.0, poisson=0.45)) == pytest.approx(1.6e-7)


def test_the_liver_of_the_package_is_as_fine_as_the_machine_allows(monkeypatch):
    filled = []
    monkeypatch.setattr(full_body, "realtime_spacing", lambda *_: 0.012)
    monkeypatch.setattr(full_body, "fill_scene", lambda scene, spacing, required, _: filled.append((spacing, required)))
    prepare_full_body(open_scene("liver"), Console().status)
    prepare_full_body(open_scene("liver", {"spacing": 0.010}), Console().status)
    assert filled == [(0.012, False), (0.010, True)]  # one that a user gives stays


@pytest.mark.slow
def test_the_spacing_follows_the_measured_load():
    cloud = open_scene("liver", {"spacing": 0.016}).body.cloud
    spacing, count = cloud.spacing, len(cloud)
    assert better_spacing(cloud, 0.6) is None
    assert better_spacing(cloud, 0.6 / 0.92) is None
    assert better_spacing(cloud, 0.6 / 1.25) is None
    assert better_spacing(cloud, 0.3) == pytest.approx(spacing * 0.5**0.25, rel=0.05)  # the fourth power of the spacing
    least = spacing * np.cbrt(count / 600)  # nodes
    assert better_spacing(cloud, 0.8) == pytest.approx(min(least, spacing * (0.8 / 0.6) ** 0.25), rel=0.05)
    assert better_spacing(cloud, 60.0) == better_spacing(cloud, np.inf) == pytest.approx(least, rel=0.05)
    coarsest = open_scene("liver", {"spacing": better_spacing(cloud, np.inf)})
    assert better_spacing(coarsest.body.cloud, 2.0) is None  # a coarser body keeps no more time


def tool_message(position):
    return validate_message(
        {
            "type": "tool", "kind": "sphere", "radius": 0.008, "length": 0.01, "friction": 0.0, "stiffness": None,
            "position": [float(x) for x in position], "quaternion": [1.0, 0.0, 0.0, 0.0], "sequence": 1,
        }
    )  # fmt: skip


def pose_message(position, sequence):
    quaternion = [1.0, 0.0, 0.0, 0.0]
    place = [float(x) for x in position]
    return validate_message({"type": "pose", "position": place, "quaternion": quaternion, "sequence": sequence})


@pytest.mark.slow
def test_a_surface_is_touched_at_once(organ):
    model, lines = described(organ, spacing=0.006)
    assert model.mass_damping > 0
    assert model.material.shear_modulus == pytest.approx(2200.0)
    for word in (
        "6 mm apart",
        "half the spacing here: about",
        "--units",
        "shear modulus 2.2 kPa",
        "--law",
        "--fixed",
        "mm assumed",
    ):
        assert word in lines, lines
    session = Session(model, "Organ")
    assert session.hello()["full"]
    assert session.tool_kinds == ["sphere", "capsule", "grasp", "scalpel"]
    front = model.cloud.points[np.argmin(model.cloud.points[:, 1])]
    session.start()
    try:
        session.handle(tool_message(front - [0.0, 0.009, 0.0]))
        for k in range(60):
            session.handle(pose_message(front - np.array([0.0, 0.009 - 1e-4 * k, 0.0]), k + 2))
            sleep(0.01)
        end = monotonic() + 300.0
        while not np.abs(session.snapshot().tools[0].force).max() > 0.01 and monotonic() < end:
            sleep(0.02)
        snapshot = session.snapshot()
        assert snapshot.tools[0].force[1] < -0.01  # of the body on the ball, which comes from the front
        displacements = snapshot.displacements(session.surface)
        assert np.linalg.norm(displacements, axis=1).max() > 5e-4
        stress = snapshot.scalar(session.surface, "stress", displacements)
        assert np.isfinite(stress).all()
        assert stress.max() > 10.0
        session.reset()
        assert not session.snapshot().coordinates.any()
    finally:
        session.close()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"spacing": 0.0002}, f"spacing must give at most {MAX_NODES} nodes"),
        (
            {"spacing": 0.006, "fixed": ("near 1000,0,0,5",)},
            "fixed: place must hold a node, got none at its near 1000,0,0,5",
        ),
        ({"spacing": 0.006, "fixed": ("near 0,0,0,500",)}, "fixed must leave tissue free"),
        ({"spacing": 0.006, "law": "NeoHook"}, "did you mean NeoHookean"),
        ({"spacing": 0.006, "C2": 1.0}, "settings must be keys of the scene, got 'C2'"),
        ({"spacing": 0.006, "scale": 0.0}, "scale must be"),
        ({"spacing": 0.006, "units": "feet"}, "units must be one of"),
    ],
)
def test_bad_options_are_refused_by_name(organ, options, message):
    with pytest.raises(pt.InputError, match=message):
        opened(organ, **options)


@pytest.mark.slow
def test_a_surface_that_intersects_itself_is_refused_by_its_name(organ, tmp_path):
    surface = open_scene(organ, {"units": "mm"}).surface
    vertices = surface.vertices.copy()
    right = vertices[:, 0] > np.median(vertices[:, 0])
    vertices[right] -= [0.6 * np.ptp(vertices[:, 0]), 0.0, 0.0]  # one half inside the other
    off(tmp_path / "folded.off", pt.Surface(vertices, surface.triangles))
    with pytest.raises(pt.InputError, match=r"folded\.off must hold a closed surface"):
        opened(tmp_path / "folded.off", units="m", spacing=0.006)


@pytest.mark.slow
def test_a_surface_that_is_open_is_refused(organ, tmp_path):
    lines = organ.read_text().splitlines()
    vertices, triangles, _ = (int(x) for x in lines[1].split())
    path = tmp_path / "sheet.off"
    path.write_text("\n".join(["OFF", f"{vertices} {triangles // 2} 0", *lines[2 : 2 + vertices + triangles // 2]]))
    with pytest.raises(pt.InputError, match="must hold a closed surface"):
        _ = open_scene(path, {"units": "mm"}).surface


def off(path, surface, unit=1.0):
    """Write a surface as an OFF file."""
    path.write_text(
        f"OFF\n{len(surface.vertices)} {len(surface.triangles)} 0\n"
        + "".join(f"{x} {y} {z}\n" for x, y, z in surface.vertices / unit)
        + "".join(f"3 {a} {b} {c}\n" for a, b, c in surface.triangles)
    )


@pytest.mark.slow
def test_a_painted_support_is_in_the_unit_of_the_surface(tmp_path):
    pyvista = pytest.importorskip("pyvista")
    mesh = pyvista.PolyData(1e3 * POINTS)
    mesh["held"] = (POINTS[:, 0] > 0.5).astype(float)
    mesh.save(tmp_path / "paint.vtp")
    expected = POINTS[:, 0] > 0.5
    np.testing.assert_array_equal(mask(f"painted {tmp_path / 'paint.vtp'}", unit=1e-3), expected)
    mesh["other"] = np.zeros(500)
    mesh.save(tmp_path / "two.vtp")
    named = mask(f"painted {tmp_path / 'two.vtp'}:held", unit=1e-3)
    np.testing.assert_array_equal(named, expected)
    with pytest.raises(pt.InputError, match="must have one field on its points, got 'held', 'other'"):
        mask(f"painted {tmp_path / 'two.vtp'}", unit=1e-3)
    said = r"must have painted nodes of the body, got none: paint of at least 0\.5 must hold"
    with pytest.raises(pt.InputError, match=said):
        mask(f"painted {tmp_path / 'two.vtp'}:other", unit=1e-3)
    with pytest.raises(FileNotFoundError, match="no painted mesh at"):
        mask(f"painted {tmp_path / 'none.vtp'}")


@pytest.mark.slow
def test_two_bodies_are_held_each_by_the_default_support(organ, tmp_path):
    surface = pt.io.read_surface(organ, units="mm")
    moved = surface.vertices + np.array([0.0, 0.3, 0.0])
    both = pt.Surface(
        np.concatenate([surface.vertices, moved]),
        np.concatenate([surface.triangles, surface.triangles + len(moved)]),
    )
    off(tmp_path / "pair.off", both)
    model = opened(tmp_path / "pair.off", spacing=0.006, units="m")
    along = model.cloud.points[held(model)][:, 1]
    assert (along < 0.15).sum() > 3
    assert (along > 0.15).sum() > 3
    x, y, z = 1e3 * model.cloud.points[held(model)[0]]
    near = f"near {x:.3f},{y:.3f},{z:.3f},15"
    with pytest.raises(pt.InputError, match=r"at least 3 nodes of body \d of 2, got 0"):
        opened(tmp_path / "pair.off", spacing=0.006, units="m", fixed=(near,))


@pytest.mark.slow
def test_a_guessed_spacing_is_refined_where_tissue_is_thin(tmp_path, monkeypatch):
    outer, inner = liver_surface(0.006, 6e-5), liver_surface(0.006, 6e-5)
    middle = outer.vertices.mean(axis=0)
    shell = pt.Surface(
        np.concatenate([outer.vertices, middle + 0.75 * (inner.vertices - middle)]),
        np.concatenate([outer.triangles, inner.triangles[:, ::-1] + len(outer.vertices)]),
    )
    off(tmp_path / "hollow.off", shell)
    monkeypatch.setattr("palpate.app.models.spacing._seconds_per_node", lambda material: 1e-5)
    model = opened(tmp_path / "hollow.off", units="m")
    assert model.cloud.spacing < 0.8 * realtime_spacing(shell.volume, model.material)


@pytest.mark.slow
def test_what_was_repaired_and_noted_is_in_the_lines(organ, tmp_path):
    surface = pt.io.read_surface(organ, units="mm")
    off(tmp_path / "holed.off", pt.Surface(surface.vertices, surface.triangles[3:]))
    _, lines = described(tmp_path / "holed.off", spacing=0.6, units="m", scale=100.0)
    assert "surface, repair: holes were closed by fans of triangles: 1, with" in lines
    assert "surface, note: its volume of 6e+04 litres is not that of an organ" in lines
    assert "--scale 0.01 would make it" in lines


def test_the_nodes_of_half_the_spacing_are_those_of_the_study():
    file = Path(__file__).parents[3] / "docs" / "validation" / "spacing_force.json"
    rows = json.loads(file.read_text(encoding="utf-8"))["results"]
    assert pytest.approx(np.mean([row["nodes"][1] / row["nodes"][0] for row in rows]), abs=0.1) == FINER_NODES


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "said"),
    [
        (
            ["--fixed", "near 1000,0,0,5"],
            "--fixed: place must hold a node, got none at its near 1000,0,0,5; the body extends from",
        ),
        (["--fixed", "near 0,0,0,500"], "--fixed must leave tissue free, got 100% of the nodes held"),
        (["--fixed", "painted nothing.vtp"], "there is no painted mesh at nothing.vtp"),
        (["--spacing", "0.0002"], "--spacing must give at most 500000 nodes, got 0.0002 m"),
        (["--spacing", "0.03"], "--spacing must be at most"),
        (["--part", "lobe"], "--part must be omitted for OFF files"),
        (["--scale", "0"], "--scale must be"),
    ],
)
def test_bad_input_is_one_line_that_names_the_option(organ, options, said, assert_refused, tmp_path):
    words = options if "--spacing" in options else [*options, "--spacing", "0.006"]
    assert_refused(["run", str(organ), "--full", "--realtime", "--out", str(tmp_path / "out"), *words], said)


def test_a_sheet_is_refused_in_one_line(tmp_path, assert_refused):
    (tmp_path / "sheet.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 1 1 0\nf 1 2 4 3\n")
    said = ("sheet.obj must hold a closed surface, got one that is not: ", "run palpate check for pictures")
    assert_refused(["run", str(tmp_path / "sheet.obj"), "--units", "m", "--realtime"], *said)


@pytest.mark.slow
def test_a_tool_smaller_than_the_spacing_is_refused_with_both_sizes(organ):
    model = opened(organ, spacing=0.006)
    session = Session(model, "Organ")
    session.start()
    try:
        with pytest.raises(pt.InputError, match=r"at least the spacing of the body, 6 mm, got 5 mm; use a larger tool"):
            session.handle({**tool_message(model.cloud.points.min(axis=0) - 0.02), "radius": 0.005})
    finally:
        session.close()
