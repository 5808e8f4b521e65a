"""Scenes that label maps propose: lesions in the organ, bones and vessels that hold it, soft neighbours to choose."""

from __future__ import annotations

import tomllib
from pathlib import Path

import numpy as np
import pytest

import palpate as pt
from palpate.app.cli import main
from palpate.app.new.proposals import propose
from palpate.core.faults import InputError
from palpate.scenes.description import Near, Place
from palpate.scenes.places import PlaceFinder
from palpate.surface.labels.reading import read_label_map
from palpate.surface.labels.writers import write_labels

EDGE = 0.003  # [m] of the voxels
NAMES = {1: "liver", 2: "liver_tumour", 3: "rib_right_8", 4: "stomach", 5: "spleen", 6: "hepatic_vessels"}


@pytest.fixture(scope="module")
def trunk(tmp_path_factory) -> Path:
    """Return the file of a block of liver with a tumour and vessels in it, on a rib, next to a stomach."""
    numbers = np.zeros((40, 40, 30), dtype=int)
    numbers[8:32, 8:32, 8:24] = 1
    numbers[12:18, 12:18, 12:18] = 2
    numbers[22:26, 22:26, 12:16] = 6
    numbers[10:20, 8:32, 5:8] = 3
    numbers[32:36, 10:30, 10:20] = 4
    numbers[2:4, 2:4, 2:4] = 5
    path = tmp_path_factory.mktemp("trunk") / "trunk.nii.gz"
    write_labels(path, numbers, np.diag([EDGE, EDGE, EDGE, 1.0]), NAMES)
    return path


@pytest.fixture(scope="module")
def scene(trunk, tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("scene") / "organ.toml"
    assert main(["new", str(trunk), "--part", "liver", "--out", str(path), "--spacing", "0.009"]) == 0
    return path


def test_what_lies_in_the_organ_is_of_the_body_and_a_region_and_a_lesion_is_stiffer(trunk):
    found = propose(read_label_map(trunk), trunk, ["liver"], 0.009)
    assert found.parts == ("liver", "liver_tumour", "hepatic_vessels")
    stiffness = {region.name: (region.stiffness, region.place.part, why) for region, why in found.regions}
    assert stiffness["liver_tumour"][:2] == (4.4, "liver_tumour")
    assert "Venkatesh" in stiffness["liver_tumour"][2]
    assert stiffness.keys() == {"liver_tumour"}  # the vessels can lie between two nodes
    assert found.title == "Liver"


def test_bones_hold_the_organ_and_soft_neighbours_can_be_chosen(trunk):
    found = propose(read_label_map(trunk), trunk, ["liver"], 0.009)
    held = {support.name: why for support, why in found.supports}
    assert held.keys() == {"rib_right_8", "rear"} or held.keys() == {"rib_right_8"}
    assert "a bone that touches" in held["rib_right_8"]
    assert [support.name for support, _ in found.alternatives] == ["stomach"]
    assert found.alternatives[0][0].kind == "springs"


@pytest.mark.slow
def test_a_face_at_the_edge_of_the_image_can_be_held(tmp_path):
    numbers = np.zeros((30, 30, 20), dtype=int)
    numbers[3:27, 3:27, 2:] = 1
    path = tmp_path / "cut.nii.gz"
    write_labels(path, numbers, np.diag([EDGE, EDGE, EDGE, 1.0]), {1: "liver"})
    assert main(["new", str(path), "--out", str(tmp_path / "organ.toml"), "--spacing", "0.009"]) == 0
    text = (tmp_path / "organ.toml").read_text()
    assert "the image cuts the organ here" in text
    commented = text.partition("# [[support]]  # the image cuts the organ")[2].partition("\n\n")[0]
    section = "[[support]]\n" + "\n".join(line.removeprefix("# ") for line in commented.splitlines()[1:])
    held = tomllib.loads(section)["support"][0]["place"]["plane"]
    assert held["normal"] == [0.0, 0.0, -1.0]
    whole = text.partition("[[support]]")[0] + section + "\n" + "[tool]" + text.partition("[tool]")[2]
    (tmp_path / "held.toml").write_text(whole)
    scene = pt.open_scene(tmp_path / "held.toml")
    (support,) = scene.body.supports
    heights = scene.cloud.points[scene.cloud.group(support.group), 2]
    assert heights.min() > scene.cloud.points[:, 2].max() - 0.004


def test_a_new_scene_of_a_label_map_has_what_it_proposes_and_opens(trunk, scene):
    text = scene.read_text()
    table = tomllib.loads(text)
    assert (scene.parent / table["surface"]["file"]).resolve() == trunk.resolve()
    assert table["surface"]["parts"] == ["liver", "liver_tumour", "hepatic_vessels"]
    assert [each["name"] for each in table["region"]] == ["liver_tumour"]
    assert table["support"][0]["name"] == "rib_right_8"
    assert "# a bone that touches" in text
    assert '# kind = "springs"' in text
    opened = pt.open_scene(scene)
    stiff = opened.body.tissue.stiffness
    volumes = opened.cloud.volumes
    assert 3.5 < stiff.max() <= 4.4
    # the tumour's volume by the shares of the cells, from the compliance of each node
    share = (1 / stiff - 1) / (1 / 4.4 - 1)
    assert share @ volumes == pytest.approx((6 * EDGE) ** 3, rel=0.02)


def test_the_distance_of_a_label_map_has_a_default_and_that_of_a_surface_has_none(trunk, scene):
    opened = pt.open_scene(scene)
    finder = PlaceFinder(opened.cloud, opened.description.surface, folder=scene.parent, space="LPS")
    file = opened.description.surface.file
    by_default = finder.mask(Place(near=Near(file=file, parts=("rib_right_8",))))
    by_number = finder.mask(Place(near=Near(file=file, parts=("rib_right_8",), distance=4.5e-3)))
    assert np.array_equal(by_default, by_number)
    assert by_default.sum() > 3
    with pytest.raises(InputError, match="near must have a distance from a surface"):
        finder.mask(Place(near=Near(file="bone.stl")))


@pytest.mark.slow
def test_supports_that_are_given_replace_those_that_are_proposed(trunk, tmp_path):
    path = tmp_path / "organ.toml"
    command = ["new", str(trunk), "--part", "liver", "--out", str(path), "--spacing", "0.009", "--fixed", "left"]
    assert main(command) == 0
    table = tomllib.loads(path.read_text())
    assert [each["place"] for each in table["support"]] == [{"side": "left"}]
