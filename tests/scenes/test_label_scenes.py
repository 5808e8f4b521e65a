"""Scenes of label maps: parts and neighbours as places, sides of a patient, and files of other frames."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import palpate as pt
from palpate.app.cli import main
from palpate.scenes.open_scene import json_of_scene, open_description, open_scene
from palpate.scenes.open_surface import complete_for_training
from palpate.scenes.places import side_mask

sys.path.insert(0, str(Path(__file__).parents[1] / "surface" / "labels"))
from label_files import caret, nifti

SCENE = """
[surface]
file = "trunk.nii"
parts = ["liver", "tumour"]
[body]
spacing = "8 mm"
[tissue]
law = "NeoHookean"
parameters = { C1 = "1100 Pa" }
[[region]]
name = "tumour"
place = { part = "tumour" }
stiffness = 5
[[support]]
name = "rib"
place = { near = { file = "trunk.nii", parts = ["rib"], distance = "6 mm" } }
[[support]]
name = "head"
place = { side = "head" }
[[support]]
name = "left"
place = { side = "left" }
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A block of 80 x 60 x 40 mm along x, y, z of RAS, a tumour in it at its right end, a rib at its front."""
    path = tmp_path_factory.mktemp("labels")
    values = np.zeros((60, 50, 40), dtype="u1")
    values[5:45, 5:35, 5:25] = 1
    values[33:41, 16:24, 11:19] = 2
    values[10:40, 35:38, 8:22] = 3
    data = nifti(values, sform=np.diag([2.0, 2.0, 2.0, 1.0]), extension=caret({1: "liver", 2: "tumour", 3: "rib"}))
    (path / "trunk.nii").write_bytes(data)
    (path / "organ.toml").write_text(SCENE, encoding="utf-8")
    return path


def test_parts_neighbours_and_sides_of_a_patient_are_where_the_voxels_are(folder):
    scene = pt.open_scene(folder / "organ.toml")
    cloud = scene.cloud
    assert scene.surface.space == "LPS"
    assert cloud.volumes.sum() == pytest.approx(80 * 60 * 40e-9, rel=0.02)
    points = 1e3 * cloud.points  # [mm], LPS: x to the left, y to the rear
    tumour = points[cloud.group("tumour")]
    assert np.all(np.abs(tumour - [-73, -39, 29]) < 8.5)
    assert len(tumour) > 0
    assert np.all(points[cloud.group("rib"), 1] < points[:, 1].min() + 9)  # the front is at small y
    assert np.all(points[cloud.group("head"), 2] > points[:, 2].max() - 9)
    assert np.all(points[cloud.group("left"), 0] > points[:, 0].max() - 14)


def test_a_scene_knows_its_files_and_keeps_digests_of_others(folder):
    scene = pt.open_scene(folder / "organ.toml")
    assert set(scene.identity["files"]) == {"trunk.nii"}
    assert "labels" not in scene.identity["sections"]["surface"]


def test_sides_of_a_patient_follow_the_frame_and_require_one():
    points = np.random.default_rng(0).uniform(-1, 1, (200, 3))
    for side, axis, sign in (("left", 0, 1), ("right", 0, -1), ("front", 1, -1), ("rear", 1, 1), ("head", 2, 1)):
        for space, turn in (("LPS", 1), ("RAS", 1 if axis == 2 else -1)):
            mask = side_mask(points, side, space=space)
            assert np.all(sign * turn * points[mask, axis] > 0.5)
        with pytest.raises(pt.InputError, match=r"SPACE=LPS"):
            side_mask(points, side)


def test_a_label_map_is_a_scene_by_itself_with_a_spacing_for_training(folder):
    opened = open_scene(str(folder / "trunk.nii"), {"poisson": 0.4}, part=("liver", "tumour"))
    scene = complete_for_training(opened)
    assert scene.description.tissue.poisson == 0.4
    assert 1.45 * scene.surface.volume / scene.description.body.spacing**3 == pytest.approx(4500, rel=0.02)
    again = open_description(scene.name, json_of_scene(scene))  # as workers of a campaign open it
    assert again.digest == scene.digest
    assert again.surface.volume == scene.surface.volume


@pytest.mark.parametrize("option", ["part", "labels"])
def test_a_training_of_a_scene_refuses_options_of_a_surface_file(option, folder, capsys):
    assert main(["train", "beam", f"--{option}", str(folder / "trunk.nii")]) == 2
    assert f"{option} must be left out unless a surface file is given, got 'beam'" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["check", "new -o new.toml", "train", "run", "export --c out"])
def test_every_command_lists_the_labels_and_types_the_command(folder, command, capsys, monkeypatch):
    monkeypatch.chdir(folder)
    words = command.split()
    assert main([words[0], "trunk.nii", *words[1:]]) == 2
    lines = capsys.readouterr().err.splitlines()
    table = [line.split()[:3] for line in lines]
    assert table[table.index(["number", "name", "ml"]) + 1][:2] == ["1", "liver"]
    assert "--part must be given for trunk.nii" in lines[-1]
    assert lines[-1].endswith(f"palpate {words[0]} trunk.nii --part liver")
