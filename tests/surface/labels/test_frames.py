"""Grids of the frames of DICOM files: places decide, stated distances count where they fit, and shears are read."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.core.faults import FileFormatError
from palpate.surface.labels.frames import grid_of_frames

AXIAL = np.array([1.0, 0, 0, 0, 1, 0])
TURNED = np.array([0.6, 0.8, 0, 0, 0, -1])  # rows and columns of an oblique plane
EDGES = np.array([0.7, 0.9])  # [mm] down and along


def grid(heights, *, shift=(0.0, 0.0), turn=AXIAL, between=(), thickness=()):
    """Return the grid of frames at heights [mm], each of them moved in its plane by `shift` for each millimetre."""
    along, down = turn[:3], turn[3:]
    heights = np.asarray(heights, dtype=float)[:, None]
    places = [5.0, 6, 7] + heights * (np.cross(along, down) + shift[0] * along + shift[1] * down)
    return places, grid_of_frames(turn, EDGES, places, (list(between), list(thickness)))


@pytest.mark.parametrize("turn", [AXIAL, TURNED], ids=["axial", "oblique"])
@pytest.mark.parametrize("shift", [(0.0, 0.0), (0.0, 0.4), (-0.3, 0.1)], ids=["straight", "tilted", "both"])
@pytest.mark.parametrize("order", [1, -1])
def test_the_first_pixel_of_every_frame_lies_where_the_file_places_it(turn, shift, order):
    places, (affine, slices, count, notes) = grid(np.arange(6)[::order] * 2.5, shift=shift, turn=turn)
    assert count == 6
    assert np.allclose(np.outer(slices, affine[:3, 2]) + affine[:3, 3], places)
    assert np.allclose(affine[:3, :2], np.column_stack([turn[:3] * EDGES[1], turn[3:] * EDGES[0]]))
    sheared = [f"its slices are sheared by {np.degrees(np.arctan(np.hypot(*shift))):.3g} degrees"]
    assert [note.partition(",")[0] for note in notes] == (sheared if any(shift) else [])


@pytest.mark.parametrize(
    ("heights", "between", "thickness", "step", "words"),
    [
        ([0, 5, 10], [5], [5], 5.0, []),
        ([0, 5, 10], [], [], 5.0, []),
        ([0, 5, 15, 40], [], [5], 5.0, []),  # empty slices are left out
        ([0, 10, 20], [5], [], 5.0, ["slices are 5 mm apart, its nearest frames 10 mm"]),
        ([0, 10, 25], [5], [], 5.0, ["nearest frames 10 mm"]),
        ([0, 10, 25], [], [5], 5.0, ["nearest frames 10 mm"]),
        ([0, 10, 20], [], [5], 10.0, ["SliceThickness is 5 mm, the places of its slices are 10 mm apart, which was"]),
        ([0, 4, 8], [5], [], 4.0, ["SpacingBetweenSlices is 5 mm, the places of its slices are 4 mm apart"]),
        ([0, 4, 8], [5], [4], 4.0, ["SpacingBetweenSlices is 5 mm"]),
        ([0, 4, 8], [4, 5], [], 4.0, ["SpacingBetweenSlices is 5 mm"]),
        ([0, 2.5, 5], [2.5], [5], 2.5, []),  # slices that overlap
        ([0, 10, 20], [0.001], [], 10.0, ["SpacingBetweenSlices is 0.001 mm"]),
        ([0, 0.05, 5, 5.05, 10], [], [5], 5.0, []),  # two frames in each slice
        ([0, 1.2, 2.5, 3.8, 5], [], [], 1.25, []),  # places of one decimal
        ([0, 0, 0], [3], [4], 3.0, ["its slice is 3 mm thick, and also 4 mm"]),
        ([0], [], [4], 4.0, []),
    ],
)
def test_places_decide_and_other_distances_are_said(heights, between, thickness, step, words):
    _, (affine, _, _, notes) = grid(heights, between=between, thickness=thickness)
    assert np.linalg.norm(affine[:3, 2]) == pytest.approx(step)
    assert len(notes) == len(words)
    assert all(word in note for word, note in zip(words, notes, strict=True))


def test_frames_off_a_grid_and_a_slice_without_thickness_are_refused_by_their_reason():
    with pytest.raises(FileFormatError, match="equal distances"):
        grid([0, 2, 5])
    with pytest.raises(FileFormatError, match="one slice must have a thickness, got neither SliceThickness nor"):
        grid([3])
    places = np.array([[0, 0, 0], [0, 3, 5], [0, 0, 10.0]])
    with pytest.raises(FileFormatError, match=r"straight line, got one 2\.4 mm away from it"):
        grid_of_frames(AXIAL, EDGES, places, ([], []))
    with pytest.raises(FileFormatError, match="straight line, got one 40 mm away from it"):  # tiles of one slice
        grid_of_frames(AXIAL, EDGES, np.array([[0, 0, 0], [40, 0, 0.0]]), ([], [5.0]))
