"""Parts of surface files: patches joined at their borders, choice by name or pattern, and the default."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from closed_surfaces import ball, cube, inverted

import palpate as pt
from palpate.surface.parts import choose_body, join_parts, matching_parts
from palpate.surface.repair import repair_surface
from palpate.surface.surface import select_triangles, weld

DATA = Path(__file__).parents[3] / "shared" / "data"
needs_data = pytest.mark.skipif(not DATA.is_dir(), reason="the organ surfaces are not at hand")


def patches(body, shift=0.0):
    """The body as eight open patches by octant, each moved by up to `shift` over the size."""
    octant = (body.vertices[body.triangles].mean(axis=1) > 0) @ [1, 2, 4]
    rng = np.random.default_rng(0)
    parts = {}
    for k in range(8):
        part = select_triangles(body, octant == k)
        parts[f"patch {k}"] = pt.Surface(part.vertices + shift * body.size * rng.uniform(-1, 1, 3) / 3, part.triangles)
    return parts


def sheet(*arguments):
    """A third of the triangles of a ball."""
    body = ball(*arguments)
    return select_triangles(body, np.arange(len(body.triangles)) < len(body.triangles) // 3)


@pytest.mark.parametrize("shift", [0.0, 5e-4])
def test_patches_closed_only_together_are_joined(shift):
    body = ball()
    joined = join_parts(patches(body, shift), "ball")
    assert pt.io.check_surface(joined).errors == ()
    assert joined.volume == pytest.approx(body.volume, rel=10 * shift + 1e-12)
    (listed,) = joined.repairs
    assert listed.kind == "repair"
    assert "8 parts" in listed.what
    assert "patch 3" in listed.what
    assert np.abs(listed.points).min(axis=1).max() < 0.01  # on the planes between octants


def test_patches_further_apart_than_the_tolerance_stay_open():
    parts = patches(ball())
    parts["patch 0"] = pt.Surface(parts["patch 0"].vertices - 0.005, parts["patch 0"].triangles)
    assert not join_parts(parts, "ball").closed


def test_walls_between_closed_parts_are_removed():
    left, right = cube(0.1, 0.2), cube(0.1, 0.2, (0.1, 0, 0))
    joined = join_parts({"left": left, "right": right}, "both")
    assert pt.io.check_surface(joined).errors == ()
    assert joined.volume == pytest.approx(2e-3)
    assert joined.area == pytest.approx(0.1)
    assert {each.name for each in joined.repairs} == {"inner walls"}


def test_parts_are_matched_by_name_and_pattern():
    names = ["left lobe", "right lobe", "capsule", "odd [1]"]
    assert matching_parts(names, "capsule") == ["capsule"]
    assert matching_parts(names, "*lobe") == ["left lobe", "right lobe"]
    assert matching_parts(names, ["caps*", "left*"]) == ["left lobe", "capsule"]
    assert matching_parts(names, "odd [1]") == ["odd [1]"]
    with pytest.raises(pt.InputError, match=r"part must be one of capsule, left lobe.*, got 'Cap\*'"):
        matching_parts(names, ["capsule", "Cap*"])
    with pytest.raises(pt.InputError, match="part must name at least one"):
        matching_parts(names, [])


def test_the_body_around_all_others_is_the_default():
    parts = {"vessel": ball(0.01, 0.005), "organ": ball(), "strip": sheet(0.03)}
    chosen = choose_body(parts, "file", repair_surface)
    assert chosen.volume == pytest.approx(ball().volume)
    assert "organ (0.519 litres) chosen" in chosen.warnings[0]


def test_patches_of_one_body_are_the_default_rather_than_a_patch_closed_by_a_fan():
    chosen = choose_body(patches(ball()), "file", repair_surface)
    assert chosen.volume == pytest.approx(ball().volume)
    assert {each.name for each in chosen.repairs} == {"joined parts"}


def test_the_whole_of_one_part_is_preferred_to_the_same_of_several():
    chosen = choose_body({**patches(ball(0.0501)), "whole": ball()}, "file", weld)
    assert "whole (0.519 litres) chosen" in chosen.warnings[0]


@pytest.mark.parametrize("units", ["mm", None])
def test_volumes_are_those_in_the_units_of_the_file(units):
    parts = {
        name: pt.Surface(1e3 * each.vertices, each.triangles)
        for name, each in (("organ", ball()), ("strip", sheet(0.03)))
    }
    assert "organ (0.519 litres) chosen" in choose_body(parts, "file", weld, units).warnings[0]


def test_bodies_side_by_side_are_named_with_their_volumes():
    parts = {"left": ball(), "right": ball(0.04, centre=(0.2, 0, 0)), "open": sheet()}
    with pytest.raises(pt.InputError, match=r"closed are: left \(0.519 litres\); right \(0.263 litres\)"):
        choose_body(parts, "file", weld)


def test_a_file_without_a_closed_body_says_what_is_a_double_shell():
    shell = weld(pt.Surface(*_double_shell()))
    with pytest.raises(pt.InputError, match=r"none of which is closed.*shell is a double shell"):
        choose_body({"shell": shell, "sheet": sheet()}, "file", weld)


def _double_shell():
    """Outer and inner wall of a bowl, joined at the rim."""
    body = ball()
    bowl = select_triangles(body, body.vertices[body.triangles].mean(axis=1)[:, 2] < 0)
    inner = 0.98 * bowl.vertices
    n = len(inner)
    edges = np.concatenate([bowl.triangles[:, [0, 1]], bowl.triangles[:, [1, 2]], bowl.triangles[:, [2, 0]]])
    low = np.sort(edges, axis=1)
    _, index, count = np.unique(low, axis=0, return_index=True, return_counts=True)
    a, b = edges[index[count == 1]].T
    rim = np.concatenate([np.column_stack([b, a, a + n]), np.column_stack([b, a + n, b + n])])
    return np.concatenate([bowl.vertices, inner]), np.concatenate([bowl.triangles, bowl.triangles[:, ::-1] + n, rim])


def test_a_closed_part_inside_another_is_a_cavity_of_both(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    scene = trimesh.Scene()
    for name, body in (("organ", ball()), ("vessel", ball(0.02, 0.006))):
        scene.add_geometry(
            trimesh.Trimesh(body.vertices, body.triangles, process=False), geom_name=name, node_name=name
        )
    scene.export(tmp_path / "organ.glb")
    both = pt.io.read_surface(tmp_path / "organ.glb", part="*", repair=True)
    assert both.volume == pytest.approx(ball().volume - ball(0.02, 0.006).volume, rel=1e-5)
    alone = pt.io.read_surface(tmp_path / "organ.glb", repair=True)
    assert alone.volume == pytest.approx(ball().volume, rel=1e-5)
    with pytest.warns(UserWarning, match="part= to choose"):
        cloud = pt.fill(tmp_path / "organ.glb", 0.012, repair=True)
    assert cloud.volumes.sum() == pytest.approx(ball().volume, rel=1e-5)
    with pytest.warns(UserWarning, match="became empty cavities: 1"):
        cloud = pt.fill(tmp_path / "organ.glb", 0.012, part=["organ", "vess*"], repair=True)
    assert cloud.volumes.sum() == pytest.approx(both.volume, rel=1e-12)
    assert inverted(both).volume < 0


@needs_data
@pytest.mark.parametrize(
    ("name", "litres", "said"),
    [
        ("VH_F_Liver.glb", 2.138, "VH_F_capsule_of_the_liver, VH_F_bare_area_of_liver"),
        ("VH_M_Liver.glb", 1.639, "VH_M_liver_capsule is a double shell"),
    ],
)
def test_livers_of_an_atlas_are_closed_by_their_patches(name, litres, said):
    surface = pt.io.read_surface(DATA / "hra" / name, repair=True)
    assert pt.io.check_surface(surface).errors == ()
    assert 1e3 * surface.volume == pytest.approx(litres, abs=0.01)
    assert said in surface.warnings[0]
