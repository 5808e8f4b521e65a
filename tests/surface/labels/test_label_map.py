"""Label maps: segments by name, number or pattern, masks as unions, and voxels at positions."""

from __future__ import annotations

import numpy as np
import pytest
from label_files import AFFINE, blocks, caret, nifti

from palpate.core.faults import FileFormatError, InputError
from palpate.surface.labels.label_map import as_grid, choose_segments, mask_of
from palpate.surface.labels.nifti import read_nifti


@pytest.fixture
def labels():
    return read_nifti(nifti(blocks(), extension=caret({1: "liver", 7: "kidney_left", 9: "spleen"})), "trunk.nii")


def test_segments_are_chosen_by_name_number_and_pattern(labels):
    for part, numbers in (("liver", [1]), ("7", [7]), ("*", [1, 7]), (["kidney*", "liver"], [1, 7])):
        assert [each.number for each in choose_segments(labels, part)] == numbers
    for part, message in (
        ("lung", "must be one of liver, kidney_left, got 'lung'"),
        ("spleen", "must have voxels, got 'spleen'"),
        ([], "at least one"),
        (None, "must be given for a label map of 2 labels"),
    ):
        with pytest.raises(InputError, match=message):
            choose_segments(labels, part)


def test_a_name_that_two_labels_have_is_refused_and_numbers_choose():
    labels = read_nifti(nifti(blocks(), extension=caret({1: "lung", 7: "lung"})))
    with pytest.raises(InputError, match="part must name one label, got 'lung', which 1 and 7 have; give a number"):
        choose_segments(labels, "lung")
    assert choose_segments(labels, "7")[0].count == 45


def test_a_mask_of_several_parts_is_the_union_of_their_voxels(labels):
    both = mask_of(labels, ["liver", "kidney_left"])
    assert np.array_equal(both.voxels, blocks()[2:9, 3:8, 2:6] > 0)
    assert both.start.tolist() == [2, 3, 2]
    assert both.volume == pytest.approx(125 * abs(np.linalg.det(AFFINE)) * 1e-9)
    assert mask_of(labels, "7").volume == pytest.approx(45 * labels.voxel_volume)


def test_points_lie_in_the_voxel_whose_middle_is_nearest_in_indices(labels):
    mask = mask_of(labels, "liver")
    rng = np.random.default_rng(0)
    indices = np.argwhere(np.ones(labels.shape))
    points = mask.positions(indices + rng.uniform(-0.49, 0.49, indices.shape))
    assert np.array_equal(mask.contains(points), (blocks() == 1).ravel())
    boundary = np.rint((mask.boundary() - labels.affine[:3, 3]) @ np.linalg.inv(labels.affine[:3, :3]).T)
    assert len(boundary) == 80 - 2 * 3 * 2
    assert (blocks() == 1)[tuple(boundary.astype(int).T)].all()


def test_the_edge_of_the_image_counts_along_axes_of_several_voxels():
    values = np.zeros((9, 9, 9), dtype="u1")
    values[3:6, 3:6, :4] = 1
    assert mask_of(read_nifti(nifti(values))).at_edge
    assert not mask_of(read_nifti(nifti(np.roll(values, 2, axis=2)))).at_edge
    flat = np.zeros((9, 9, 1), dtype="u1")
    flat[3:6, 3:6] = 1
    assert not mask_of(read_nifti(nifti(flat))).at_edge


def test_other_names_and_lengths(labels):
    renamed = labels.with_names({7: "spleen", 12: "aorta"})
    assert [each.name for each in renamed.segments] == ["liver", "spleen"]
    assert "aorta" in renamed.absent
    assert np.allclose(labels.scaled(2.0).affine[:3], 2 * labels.affine[:3])


def test_axes_must_be_finite_and_of_three_directions():
    assert as_grid(AFFINE) is AFFINE
    for column in ([np.inf, 0, 0], [0, 0, 0], AFFINE[:3, 0] + AFFINE[:3, 1]):
        bad = AFFINE.copy()
        bad[:3, 2] = column
        with pytest.raises(FileFormatError, match="orientation"):
            as_grid(bad)
