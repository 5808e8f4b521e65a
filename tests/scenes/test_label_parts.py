"""What lies in an organ of a label map: of its body in every command, and never a hole."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.core.faults import ChoiceError
from palpate.scenes.open_scene import open_scene
from palpate.surface.labels.writers import write_labels

EDGE = 0.003  # [m] of the voxels


@pytest.fixture(scope="module")
def trunk(tmp_path_factory):
    """Return the file of a block of liver with a large and a small tumour inside, next to a spleen."""
    numbers = np.zeros((34, 34, 24), dtype=int)
    numbers[3:27, 3:27, 3:21], numbers[28:32, 4:20, 4:20] = 1, 4
    numbers[8:16, 8:16, 8:16], numbers[20:22, 20:22, 10:12] = 2, 3
    path = tmp_path_factory.mktemp("trunk") / "trunk.nii.gz"
    names = {1: "liver", 2: "tumour", 3: "small_tumour", 4: "spleen"}
    write_labels(path, numbers, np.diag([EDGE, EDGE, EDGE, 1.0]), names)
    return path


def test_an_organ_that_is_opened_has_no_hole_where_a_tumour_lies(trunk):
    scene = open_scene(trunk, {"spacing": 0.009}, part=["liver"])
    assert scene.description.surface.parts == ("liver", "tumour", "small_tumour")
    assert scene.surface.volume == pytest.approx(24 * 24 * 18 * EDGE**3, rel=0.005)
    (region,) = scene.description.region
    assert (region.name, region.stiffness) == ("tumour", 4.4)
    assert any("tumour, 4.4 times as stiff" in note and "Venkatesh" in note for note in scene.notes)
    assert any("small_tumour lies in the organ; too small" in note for note in scene.notes)


def test_an_organ_with_nothing_inside_is_opened_as_it_is(trunk):
    scene = open_scene(trunk, {"spacing": 0.009}, part=["spleen"])
    assert scene.description.surface.parts == ("spleen",)
    assert scene.description.region == ()
    assert scene.notes == []


@pytest.fixture(scope="module")
def sliver(tmp_path_factory):
    """Return the file of a liver in which a speck of lung lies, a stomach, and a sliver of lung at the image's edge."""
    numbers = np.zeros((34, 34, 24), dtype=int)
    numbers[3:31, 3:31, :21] = 1
    numbers[16:18, 16:18, 16:18], numbers[20:28, 20:28, 10:18], numbers[8:10, 8:10, :2] = 2, 3, 5
    numbers[6:12, 6:12, 10:16] = 4
    path = tmp_path_factory.mktemp("sliver") / "trunk.nii.gz"
    names = {1: "liver", 2: "lung_right", 3: "stomach", 4: "liver_tumor", 5: "lung_left"}
    write_labels(path, numbers, np.diag([EDGE, EDGE, EDGE, 1.0]), names)
    return path


def test_another_organ_never_joins_and_neither_title_nor_name_has_what_joins(sliver):
    scene = open_scene(sliver, {"spacing": 0.009}, part=["liver"])
    assert scene.description.surface.parts == ("liver", "liver_tumor")
    assert scene.title == scene.surface.name == "Liver (trunk)"
    liver, stomach, sliver_of_lung = 28 * 28 * 21, 8**3, 2**3
    assert scene.surface.volume == pytest.approx((liver - stomach - sliver_of_lung) * EDGE**3, rel=0.002)
    notes = " / ".join(scene.notes)
    assert "with liver_tumor, 4.4 times as stiff (5.83 ml), which lies in the organ, a lesion by its name" in notes
    without = {name: line for line in scene.notes for name in ("lung_right", "stomach", "lung_left") if name in line}
    assert without["lung_right"].endswith("is filled with the organ's tissue; add it with part='lung_right'")
    assert "stomach (14 ml, another organ by its name), whose place is left empty" in without["stomach"]
    assert "lung_left (0.22 ml, cut by the edge of the image), whose place is left empty" in without["lung_left"]
    assert any(each.startswith("Liver (trunk) touches the edge") for each in scene.surface.warnings)


def test_a_lesion_can_be_left_out_and_another_organ_added(sliver):
    scene = open_scene(sliver, {"spacing": 0.009}, part=["liver"], without=["liver_tumor"])
    assert scene.description.surface.parts == ("liver",)
    assert scene.description.region == ()
    assert any("without liver_tumor (5.8 ml, left out by choice)" in note for note in scene.notes)
    scene = open_scene(sliver, {"spacing": 0.009}, part=["liver", "lung_right"])
    assert scene.description.surface.parts == ("liver", "lung_right", "liver_tumor")
    for wrong in ("stomach", "liver", "nothing"):
        with pytest.raises(pt.InputError, match=f"without must be one of liver_tumor, got '{wrong}'"):
            open_scene(sliver, part=["liver"], without=[wrong])
    with pytest.raises(pt.InputError, match="without must be left out, since nothing joins the organ, got 'liver'"):
        open_scene(sliver, part=["stomach"], without=["liver"])
    with pytest.raises(pt.InputError, match="without must be left out unless a label map is given"):
        open_scene("organ.stl", without=["tumour"])


def test_what_lies_in_a_label_that_is_left_out_does_not_join_and_a_lesion_has_its_organs_factor(tmp_path):
    numbers = np.zeros((34, 34, 24), dtype=int)
    numbers[3:31, 3:31, 2:22], numbers[8:24, 8:24, 4:20], numbers[12:18, 12:18, 8:14] = 1, 2, 3
    path = tmp_path / "organ.nii.gz"
    write_labels(path, numbers, np.diag([EDGE, EDGE, EDGE, 1.0]), {1: "Leber", 2: "Lebertumor", 3: "necrosis"})
    scene = open_scene(path, {"spacing": 0.009}, part=["Leber"])
    assert scene.description.surface.parts == ("Leber", "Lebertumor", "necrosis")
    assert [each.stiffness for each in scene.description.region] == [4.4]
    scene = open_scene(path, {"spacing": 0.009}, part=["Leber"], without=["Lebertumor", "necrosis", "Lebertumor"])
    assert scene.description.surface.parts == ("Leber",)
    assert open_scene(path, part=["Leber"], without=["2"]).description.surface.parts == ("Leber",)


def test_a_piece_of_a_label_is_a_body_alone(sliver):
    assert open_scene(sliver, part=["liver#1"]).description.surface.parts == ("liver#1",)
    with pytest.raises(pt.InputError, match="without must be left out with a piece of a label"):
        open_scene(sliver, part=["liver#1"], without=["liver_tumor"])


def test_the_list_states_what_joins_before_the_start(sliver):
    with pytest.raises(ChoiceError, match="part must be given") as error:
        open_scene(sliver)
    lines = error.value.table.splitlines()
    (at,) = [k for k, line in enumerate(lines) if line.split()[:2] == ["1", "liver"]]
    assert lines[at + 1].strip() == "with liver_tumor (5.8 ml, a lesion by its name)"
    assert lines[at + 2].strip().startswith("without lung_right (0.22 ml, another organ by its name), stomach (14 ml")
    assert "unless --without NAME" in lines[-1]
