"""What lies in an organ of a label map: of its body in every command, and never a hole."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.scenes.open_surface import open_surface
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
    scene = open_surface(trunk, part=["liver"], spacing=0.009)
    assert scene.description.surface.parts == ("liver", "tumour", "small_tumour")
    assert scene.surface.volume == pytest.approx(24 * 24 * 18 * EDGE**3, rel=0.005)
    (region,) = scene.description.region
    assert (region.name, region.stiffness) == ("tumour", 4.4)
    assert any("tumour, 4.4 times as stiff" in note and "Venkatesh" in note for note in scene.notes)
    assert any("small_tumour lies in the organ; too small" in note for note in scene.notes)


def test_an_organ_with_nothing_inside_is_opened_as_it_is(trunk):
    scene = open_surface(trunk, part=["spleen"], spacing=0.009)
    assert scene.description.surface.parts == ("spleen",)
    assert scene.description.region == ()
    assert scene.notes == []
