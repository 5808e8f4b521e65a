"""Surfaces: checks, repair and files."""

from __future__ import annotations

import re
import struct
import warnings
from pathlib import Path

import numpy as np
import pytest
from closed_surfaces import ball, cube, inverted, joined

import palpate as pt
from palpate.surface.crossings import column_crossings
from palpate.surface.nesting import winding_number
from palpate.surface.refining import poisson_discs, refine_surface
from palpate.surface.repair import repair_surface
from palpate.surface.surface import boundary_loops, scaled, weld

DATA = Path(__file__).parents[3] / "shared" / "data"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="the organ surfaces are not at hand")


def names(surface):
    return {problem.name for problem in pt.io.check_surface(surface).errors}


def test_volume_and_area_are_those_of_a_cube():
    body = cube(0.1)
    assert body.volume == pytest.approx(1e-3, rel=1e-12)
    assert body.area == pytest.approx(0.06, rel=1e-12)
    assert names(body) == set()


def test_refined_keeps_volume_area_and_closure_and_has_short_edges():
    fine = cube(0.1, 0.007)
    assert fine.volume == pytest.approx(1e-3, rel=1e-12)
    assert fine.area == pytest.approx(0.06, rel=1e-12)
    edges = fine.vertices[fine.triangles] - fine.vertices[np.roll(fine.triangles, 1, axis=1)]
    assert np.linalg.norm(edges, axis=2).max() <= 0.007
    assert pt.io.check_surface(fine).euler == 2


def test_poisson_discs_keep_their_distance_and_leave_no_gap():
    points = np.random.default_rng(0).uniform(size=(2000, 3))
    chosen = poisson_discs(points, np.full(2000, 0.15), np.random.default_rng(1).permutation(2000))
    distance = np.linalg.norm(points[:, None] - points[chosen], axis=2)
    between = distance[chosen]
    assert between[~np.eye(len(chosen), dtype=bool)].min() >= 0.15
    assert distance.min(axis=1).max() < 0.15


def test_vertical_lines_cross_a_ball_at_its_height():
    body = ball(0.05, 0.004)
    start, height = column_crossings(body.vertices, body.triangles, np.array([-0.0501, -0.0497]), 0.00513, (20, 20))
    assert np.all(np.diff(start) % 2 == 0)
    i, j = np.divmod(np.repeat(np.arange(400), np.diff(start)), 20)
    x, y = -0.0501 + 0.00513 * i, -0.0497 + 0.00513 * j
    assert np.sqrt(x**2 + y**2 + height**2) == pytest.approx(0.05, rel=0.005)
    assert np.sum(np.diff(height.reshape(-1, 2), axis=1)) * 0.00513**2 == pytest.approx(body.volume, rel=0.02)


def test_corners_that_differ_by_rounding_are_one():
    body = pt.liver_surface()
    soup = body.vertices[body.triangles].reshape(-1, 3)
    noisy = soup + 5e-8 * body.size * np.random.default_rng(0).uniform(-1, 1, soup.shape)
    own = weld(pt.Surface(noisy, np.arange(len(noisy)).reshape(-1, 3)))
    assert (len(own.vertices), len(own.triangles)) == (len(body.vertices), len(body.triangles))
    assert own.closed
    assert own.volume == pytest.approx(body.volume, rel=1e-6)


def test_welding_joins_coincident_vertices_and_drops_triangles_without_area():
    body = cube()
    loose = pt.Surface(body.vertices[body.triangles].reshape(-1, 3), np.arange(3 * len(body.triangles)).reshape(-1, 3))
    assert "open" in names(loose)
    assert names(weld(loose)) == set()
    extra = pt.Surface(body.vertices, np.concatenate([body.triangles, body.triangles[:3], [[5, 5, 6]]]))
    assert len(weld(extra).triangles) == len(body.triangles)


@pytest.mark.parametrize(
    ("surface", "name"),
    [
        (lambda: pt.Surface(ball().vertices, ball().triangles[3:]), "open"),
        (lambda: inverted(ball()), "inside out"),
        (lambda: joined(ball(), ball(0.03)), "body in a body"),
        (lambda: joined(*(ball(0.002, 0.004, (0.01 * k, 0, 0)) for k in range(101))), "several parts"),
        (lambda: joined(ball(), ball(centre=(0.03, 0.002, 0.001))), "self-intersecting"),
    ],
)
def test_each_fault_has_its_name(surface, name):
    assert name in names(surface())


def test_a_triangle_that_is_turned_is_found_and_repaired():
    body = ball()
    triangles = body.triangles.copy()
    triangles[7] = triangles[7][::-1]
    turned = pt.Surface(body.vertices, triangles)
    assert names(turned) == {"mixed orientation"}
    assert repair_surface(turned).volume == pytest.approx(body.volume, rel=1e-12)
    assert repair_surface(inverted(body)).volume == pytest.approx(body.volume, rel=1e-12)


def test_two_cubes_that_touch_in_a_corner_are_pinched():
    body = weld(joined(cube(), cube(centre=(0.1, 0.1, 0.1))))
    assert "pinched" in names(body)


def test_holes_are_closed_and_small_parts_dropped_on_request():
    body = ball()
    hole = pt.Surface(body.vertices, body.triangles[body.vertices[body.triangles].mean(axis=1)[:, 0] < 0.04])
    assert names(hole) == {"open"}
    assert len(boundary_loops(weld(hole).triangles)) == 1
    closed = repair_surface(joined(hole, ball(0.002, 0.001, (0.2, 0, 0))))
    assert names(closed) == set()
    cap = np.pi * 0.01**2 * (3 * 0.05 - 0.01) / 3  # what a cut at 40 mm takes of the ball
    assert closed.volume == pytest.approx(body.volume - cap, rel=0.02)


def test_a_fold_is_smoothed_on_request():
    body = ball()
    vertices = body.vertices.copy()
    vertices[np.argmax(vertices[:, 0])] = (-0.06, 0.0011, 0.0023)  # pulled right through the other side
    folded = pt.Surface(vertices, body.triangles)
    assert "self-intersecting" in names(folded)
    assert names(repair_surface(folded)) == set()


@pytest.mark.parametrize(
    ("vertices", "triangles", "said"),
    [
        (np.zeros((0, 3)), np.zeros((0, 3)), "must have triangles"),
        ([[0, 0, 0], [1, 0, 0], [0, np.nan, 0]], [[0, 1, 2]], "got other values at vertices 2"),
        ([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 3]], "vertices in .0, 2., got others"),
        ([[0, 0], [1, 0], [0, 1]], [[0, 1, 2]], "shapes"),
        (np.zeros((3, 3)), np.broadcast_to(np.arange(3), (10_000_000, 3)), "at most 2000000"),
    ],
)
def test_arrays_that_are_not_a_surface_are_refused(vertices, triangles, said):
    with pytest.raises(pt.InputError, match=said):
        pt.Surface(np.asarray(vertices, dtype=float), np.asarray(triangles))


@pytest.mark.parametrize("kind", ["stl", "obj", "ply", "off", "glb"])
def test_every_kind_of_file_gives_the_same_surface(kind, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    body = ball()
    path = tmp_path / f"ball.{kind}"
    trimesh.Trimesh(body.vertices, body.triangles, process=False).export(path)
    read = pt.io.read_surface(path, units="m")
    assert read.volume == pytest.approx(body.volume, rel=1e-5)
    assert len(read.triangles) == len(body.triangles)
    assert names(read) == set()


@pytest.mark.parametrize("kind", ["vtk", "vtp"])
def test_vtk_files_give_the_same_surface(kind, tmp_path):
    pyvista = pytest.importorskip("pyvista")
    body = ball()
    pyvista.PolyData.from_regular_faces(body.vertices, body.triangles).save(tmp_path / f"ball.{kind}")
    assert pt.io.read_surface(tmp_path / f"ball.{kind}", units="m").volume == pytest.approx(body.volume, rel=1e-5)


def test_a_file_of_parts_needs_the_name_of_one(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    scene = trimesh.Scene()
    for name, body in (("left", ball()), ("right", cube(centre=(0.3, 0, 0)))):
        scene.add_geometry(
            trimesh.Trimesh(body.vertices, body.triangles, process=False), geom_name=name, node_name=name
        )
    scene.export(tmp_path / "two.glb")
    with pytest.raises(pt.InputError, match="choose one of left, right"):
        pt.io.read_surface(tmp_path / "two.glb")
    with pytest.raises(pt.InputError, match=r"part must be one of .*, got 'middle'"):
        pt.io.read_surface(tmp_path / "two.glb", part="middle")
    assert pt.io.read_surface(tmp_path / "two.glb", part="right").volume == pytest.approx(1e-3, rel=1e-5)


@pytest.mark.parametrize(("scale", "units"), [(1.0, "m"), (100.0, "cm"), (1000.0, "mm")])
def test_units_are_guessed_from_an_organs_size_with_a_warning(scale, units, tmp_path):
    trimesh = pytest.importorskip("trimesh")
    body = ball()
    trimesh.Trimesh(scale * body.vertices, body.triangles, process=False).export(tmp_path / "ball.stl")
    read = pt.io.read_surface(tmp_path / "ball.stl")
    assert f"{units} assumed" in read.warnings[0]
    assert read.volume == pytest.approx(body.volume, rel=1e-5)
    with pytest.warns(UserWarning, match="does not state its units"):
        pt.fill(tmp_path / "ball.stl", 0.012)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert pt.io.read_surface(tmp_path / "ball.stl", units=units).warnings == ()


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("liver.vtu", b"<VTKFile/>", "a VTK unstructured grid, a volume mesh; export its surface"),
        ("liver.msh", b"$NOD\n181\n", "Gmsh file of version 1"),
        ("liver.msh", b"$MeshFormat\n4.1 0 8\n", "Gmsh file of version 4.1"),
        ("liver.doc", b"x", "got 'doc'"),
        ("liver.stl", b"", "must not be empty"),
        ("liver.stl", b"no triangles here", "STL|no triangles"),
        ("liver.glb", b"glTF no more", "cannot be read as GLB"),
        ("liver.vtk", b"# vtk DataFile Version 3.0\nnothing\nASCII\nDATASET NONE\n", "must be POLYDATA"),
        ("liver.vtp", b"<VTKFile", "not well formed"),
    ],
)
def test_files_of_another_kind_are_refused(name, content, said, tmp_path):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(pt.FileFormatError, match=said):
        pt.io.read_surface(tmp_path / name)


def test_a_huge_file_is_refused_before_it_is_read(tmp_path):
    count = 10_000_000
    with (tmp_path / "huge.stl").open("wb") as file:  # sparse: takes no room
        file.write(bytes(80) + struct.pack("<I", count))
        file.truncate(84 + 50 * count)
    with pytest.raises(pt.InputError, match="at most 300000000"):
        pt.io.read_surface(tmp_path / "huge.stl")
    (tmp_path / "huge.ply").write_bytes(b"ply\nformat ascii 1.0\nelement vertex 3\nelement face 10000000\nend_header\n")
    with pytest.raises(pt.InputError, match="must have at most 2000000 triangles, got 10000000"):
        pt.io.read_surface(tmp_path / "huge.ply")


def test_wrong_names_are_refused(tmp_path):
    with pytest.raises(FileNotFoundError, match="nowhere"):
        pt.io.read_surface(tmp_path / "nowhere.stl")
    with pytest.raises(pt.InputError, match=r"units must be one of .*, got 'ell'"):
        pt.io.read_surface(tmp_path / "nowhere.stl", units="ell")


def test_a_shell_around_the_shape_of_a_liver_is_refused_as_hollow():
    body = pt.liver_surface()
    middle = body.vertices.mean(axis=0)
    inner = pt.Surface(middle + 0.95 * (body.vertices - middle), body.triangles)
    shell = joined(body, inverted(inner))
    assert "hollow" in names(shell)
    with pytest.raises(pt.InputError, match="hollow shell"):
        pt.fill(shell, 0.01)


@needs_data
def test_the_hollow_liver_is_refused_as_hollow():
    body = pt.io.read_surface(DATA / "hra" / "VH_M_Liver.glb", part="VH_M_liver_capsule")
    assert names(body) == {"hollow"}
    with pytest.raises(pt.InputError, match="hollow shell"):
        pt.fill(body, 0.01)


def test_a_liver_with_a_hole_is_closed_on_request(tmp_path):
    body = pt.liver_surface()
    middles = body.vertices[body.triangles].mean(axis=1)
    tip = middles[middles[:, 0].argmin()]
    whole = np.linalg.norm(middles - tip, axis=1) > 0.015
    lines = [f"v {x:.9f} {y:.9f} {z:.9f}" for x, y, z in body.vertices]
    lines += [f"f {a} {b} {c}" for a, b, c in body.triangles[whole] + 1]
    (tmp_path / "open.obj").write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert names(pt.io.read_surface(tmp_path / "open.obj", units="m")) == {"open"}
    closed = pt.io.read_surface(tmp_path / "open.obj", units="m", repair=True)
    assert names(closed) == set()
    assert closed.volume == pytest.approx(body.volume, rel=0.02)


@needs_data
def test_the_open_liver_is_closed_on_request():
    path = DATA / "hra" / "VH_F_Liver.glb"
    assert names(pt.io.read_surface(path, part="VH_F_capsule_of_the_liver")) == {"open"}
    closed = pt.io.read_surface(path, part="VH_F_capsule_of_the_liver", repair=True)
    assert names(closed) == set()
    assert closed.volume == pytest.approx(1.993e-3, rel=1e-3)


def test_refinement_follows_a_given_length():
    vertices, triangles = refine_surface(
        cube().vertices, cube().triangles, lambda points: 0.004 + 0.3 * np.abs(points[:, 0])
    )
    middle = vertices[triangles].mean(axis=1)
    longest = np.linalg.norm(vertices[triangles] - vertices[np.roll(triangles, 1, axis=1)], axis=2).max(axis=1)
    assert longest[np.abs(middle[:, 0]) < 0.005].max() < 0.008
    assert longest[np.abs(middle[:, 0]) > 0.04].min() > 0.004


def test_an_open_surface_reports_no_volume(tmp_path):
    whole = ball()
    assert whole.closed
    patch = pt.Surface(
        whole.vertices, whole.triangles[whole.vertices[whole.triangles][:, :, 2].min(axis=1) > 0], "patch"
    )
    assert not patch.closed
    assert "volume" not in str(patch)
    assert "open" in str(patch)
    path = tmp_path / "patch.off"
    path.write_text(
        f"OFF\n{len(patch.vertices)} {len(patch.triangles)} 0\n"
        + "".join(f"{x} {y} {z}\n" for x, y, z in 1e3 * patch.vertices)
        + "".join(f"3 {a} {b} {c}\n" for a, b, c in patch.triangles)
    )
    (warning,) = [each for each in pt.io.read_surface(path, repair=False).warnings if "units" in each]
    assert "mm assumed, for an open surface" in warning
    assert "litres" not in warning


def kinds(surface):
    return {(problem.kind, problem.name) for problem in pt.io.check_surface(surface).problems}


def test_cavities_and_separate_bodies_are_noted():
    assert ("note", "cavities") in kinds(joined(ball(), inverted(ball(0.03))))
    assert ("note", "several bodies") in kinds(joined(ball(), ball(centre=(0.3, 0, 0))))
    assert ("note", "several bodies") in kinds(joined(ball(), inverted(ball(0.03)), ball(0.01, 0.004)))


def test_repair_turns_nested_components_by_their_depth():
    shells = [ball(radius, 0.006) for radius in (0.05, 0.03, 0.015)]
    expected = shells[0].volume - shells[1].volume + shells[2].volume
    for mixed in (joined(*shells), joined(*map(inverted, shells)), joined(shells[0], inverted(shells[1]), shells[2])):
        repaired = repair_surface(mixed)
        assert names(repaired) == set()
        assert repaired.volume == pytest.approx(expected, rel=1e-12)


def test_winding_numbers_are_one_inside_and_zero_outside():
    body = ball()
    corners = body.vertices[body.triangles]
    for point, expected in (((0.01, 0.02, 0.0), 1.0), ((0.04, 0.04, 0.0), 0.0), ((0.3, 0.0, 0.0), 0.0)):
        assert winding_number(corners, np.array(point)) == pytest.approx(expected, abs=1e-9)
    assert winding_number(corners[:, ::-1], np.zeros(3)) == pytest.approx(-1.0)


def test_sheets_that_touch_in_a_point_are_separated():
    left, right = cube(0.1, 0.2), cube(0.1, 0.2, (0.1, 0.1, 0.1))
    touching = weld(joined(left, right))
    assert "pinched" in names(touching)
    repaired = repair_surface(touching)
    assert names(repaired) == set()
    assert ("repair", "separated sheets") in kinds(repaired)


def test_repairs_are_listed_with_their_places():
    body = ball()
    speck = ball(0.002, 0.001, (0.2, 0, 0))
    holed = pt.Surface(body.vertices, body.triangles[body.vertices[body.triangles].mean(axis=1)[:, 0] < 0.04])
    repaired = repair_surface(inverted(joined(holed, speck)))
    listed = {each.name: each for each in repaired.repairs}
    assert set(listed) == {"specks", "closed holes", "turned"}
    assert listed["specks"].points == pytest.approx(np.array([[0.2, 0, 0]]), abs=1e-3)
    assert listed["closed holes"].points[:, 0].min() > 0.035  # the rim
    assert len(listed["turned"].points) == len(holed.triangles)
    assert repair_surface(body).repairs == ()
    assert kinds(repaired) >= {("repair", name) for name in listed}
    assert scaled(repaired, 2.0).repairs[0].points == pytest.approx(2 * repaired.repairs[0].points)


@pytest.mark.parametrize(
    ("factor", "said"), [(1000.0, "scale=0.001"), (0.01, "scale=100"), (7e4, "scale=1e-05|scale=")]
)
def test_an_implausible_volume_names_the_factor_of_an_organ(factor, said):
    body = scaled(ball(), factor)
    (note,) = [each for each in pt.io.check_surface(body).problems if each.name == "scale"]
    assert re.search(said, note.what)
    found = float(re.search(r"scale=(\S+)", note.what)[1])
    assert 2e-6 < (factor * found) ** 3 * ball().volume < 2e-2
