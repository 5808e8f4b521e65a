"""One function opens scenes of the package, scene files and surfaces; a surface has settings and parts of its own."""

from __future__ import annotations

import pytest

import palpate as pt
from palpate.scenes.open_surface import complete_for_training
from palpate.scenes.spacing import TRAINING_NODES, expected_nodes, spacing_for

BOX = "OFF\n8 12 0\n" + "".join(f"{60 * x} {40 * y} {30 * z}\n" for z in (0, 1) for y in (0, 1) for x in (0, 1))
BOX += "".join(
    f"3 {a} {b} {c}\n3 {a} {c} {d}\n"
    for a, b, c, d in [(0, 2, 3, 1), (4, 5, 7, 6), (0, 1, 5, 4), (2, 6, 7, 3), (0, 4, 6, 2), (1, 3, 7, 5)]
)


@pytest.fixture
def box(tmp_path):
    """An OFF file of a box in millimetres."""
    path = tmp_path / "my_box.off"
    path.write_text(BOX)
    return path


def test_a_surface_takes_settings_of_a_scene(box):
    scene = pt.open_scene(box, {"units": "mm", "scale": 2, "spacing": "5 mm", "poisson": 0.4}, fixed="x-")
    assert scene.title == "My box"
    assert scene.surface.volume == pytest.approx(8 * 60 * 40 * 30e-9)
    assert scene.description.body.spacing == 0.005
    assert scene.material.poisson == 0.4
    assert [each.place.side for each in scene.description.support] == ["x-"]


def test_a_law_and_its_parameters_are_set_together(box):
    settings = {"C2": 3e2, "C1": "1 kPa", "law": "MooneyRivlin"}
    for source, given in ((box, settings), ("liver", settings)):
        material = pt.open_scene(source, given).material
        assert isinstance(material, pt.materials.MooneyRivlin)
        assert (material.C1, material.C2) == (1e3, 3e2)
    with pytest.raises(pt.InputError, match="settings must be keys of the scene, got 'C2'"):
        pt.open_scene(box, {"C2": 1.0})


@pytest.mark.parametrize("option", ["part", "labels", "without", "fixed"])
def test_options_of_a_surface_are_refused_for_other_scenes(option):
    with pytest.raises(pt.InputError, match=f"{option} must be left out unless a surface file is given, got 'beam'"):
        pt.open_scene("beam", **{option: "x-"})


def test_a_file_of_another_format_is_refused_with_the_formats(tmp_path):
    path = tmp_path / "organ.txt"
    path.write_text("no surface")
    with pytest.raises(pt.FileFormatError, match=r"the format must be one of STL, OBJ, .*, got 'txt'"):
        pt.open_scene(path)


def test_a_body_to_train_on_needs_no_coarser_one_for_its_statics(box):
    scene = complete_for_training(pt.open_scene(box, {"units": "mm"}))
    spacing, volume = scene.description.body.spacing, scene.surface.volume
    assert spacing == spacing_for(TRAINING_NODES, volume)
    for each in (volume, 1.5e-3, 2.14e-3, 3.66e-5):
        nodes = expected_nodes(each, spacing_for(TRAINING_NODES, each))
        assert nodes == pytest.approx(TRAINING_NODES, rel=0.02)
        assert nodes < 5000  # of which statics are made
    assert complete_for_training(pt.open_scene(box, {"units": "mm", "spacing": 0.01})).description.body.spacing == 0.01
