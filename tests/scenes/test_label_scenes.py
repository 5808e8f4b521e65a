"""Scenes of label maps: parts and neighbours as places, sides of a patient, and files of other frames."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import palpate as pt
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
