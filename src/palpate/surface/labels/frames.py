"""The grid of the parallel frames of a DICOM file, from their places and the distances that it states.

The places decide. A stated distance of slices counts where all frames lie on multiples of it, since empty slices may
be left out. Frames that also move in their own plane from slice to slice, as those of a tilted gantry, are a sheared
image.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from palpate.core.arrays import Floats, Ints
from palpate.core.faults import FileFormatError
from palpate.surface.labels.agreement import LENGTH_SHARE, lengths_agree
from palpate.surface.labels.voxels import MAX_VOXELS

SAME_PLACE = 1e-3  # [mm] along the normal
MAX_EMPTY = 10  # steps between the nearest frames, of a stated distance
MIN_SHEAR = 1e-3  # of a step, of which a note is made
OFF_GRID = 0.1  # of a step, or of an edge of a pixel, by which slices may be off


def grid_of_frames(
    turn: Floats, edges: Floats, places: Floats, stated: Sequence[list[float]]
) -> tuple[Floats, Ints, int, list[str]]:
    """Return the map from indices to positions [mm], the slice of each frame, the number of slices, and notes.

    `turn` (6,) has unit vectors along the rows and down the columns of all frames. `edges` (2,) [mm] are the distances
    of pixels down the columns and along the rows. `places` (n, 3) [mm] are middles of the first pixel of each frame.
    `stated` are the different distances of slices, and the thicknesses [mm], that the file states.
    """
    along, down = turn[:3], turn[3:]
    normal = np.cross(along, down)
    normal /= np.linalg.norm(normal)
    heights = places @ normal
    heights -= heights.min()
    step, notes = _step(heights, *stated)
    if heights.max() > MAX_VOXELS * step:
        raise FileFormatError("its slices must be at most 2^29, got more")
    slices = np.rint(heights / step).astype(np.int64)
    first = places[np.argmin(heights)]
    shift = _shift(places - first, slices, np.stack([along, down]), edges)
    if np.linalg.norm(shift) > MIN_SHEAR * step:
        angle = np.degrees(np.arctan2(np.linalg.norm(shift), step))
        notes.append(f"its slices are sheared by {angle:.3g} degrees, as of a tilted gantry: its image was taken so")
    affine = np.eye(4)
    affine[:3, :3] = np.column_stack([along * edges[1], down * edges[0], normal * step + shift])
    affine[:3, 3] = first
    return affine, slices, int(slices.max()) + 1, notes


def _step(heights: Floats, spacings: list[float], thicknesses: list[float]) -> tuple[float, list[str]]:
    """Return the distance of slices [mm] at heights from 0, and notes on other distances that the file states."""
    word, lengths = ("SpacingBetweenSlices", spacings) if spacings else ("SliceThickness", thicknesses)
    gaps = np.diff(np.sort(heights))
    gaps = gaps[gaps > SAME_PLACE]
    if not len(gaps):
        if not lengths:
            raise FileFormatError(
                "its one slice must have a thickness, got neither SliceThickness nor SpacingBetweenSlices; add one of "
                "them in mm, such as with 3D Slicer"
            )
        others = [each for each in (*spacings, *thicknesses) if not _agree(lengths[0], each)]
        return lengths[0], [
            f"its slice is {lengths[0]:.4g} mm thick, and also {each:.4g} mm: the former was taken" for each in others
        ]
    nearest = float(gaps.min())
    plausible = [each for each in spacings if nearest <= MAX_EMPTY * each]
    thick = [each for each in thicknesses if nearest < OFF_GRID * each]  # frames at about the same place
    steps = (
        _divided(heights, [*plausible, *thick], LENGTH_SHARE)
        or _divided(heights, [nearest], OFF_GRID)
        or _divided(heights, thicknesses, LENGTH_SHARE)
    )
    if not steps:
        raise FileFormatError("its slices must have equal distances, got others; resample it, such as with 3D Slicer")
    step = steps[0]
    notes = [
        f"its {word} is {each:.4g} mm, the places of its slices are {step:.4g} mm apart, which was taken"
        for each in lengths if not _agree(step, each)
    ]  # fmt: skip
    if nearest > 1.5 * step:
        notes.append(
            f"its slices are {step:.4g} mm apart, its nearest frames {nearest:.4g} mm: slices without a frame are empty"
        )
    return step, notes


def _agree(taken: float, other: float) -> bool:
    return lengths_agree(np.array([taken]), np.array([other]))


def _divided(heights: Floats, lengths: list[float], share: float) -> list[float]:
    """Return distances of slices, about the given ones, of which all heights are multiples."""
    steps = []
    for length in lengths:
        step = heights.max() / max(1.0, np.rint(heights.max() / length))
        off = np.abs(heights - step * np.rint(heights / step))
        if abs(step - length) <= share * length and off.max() <= OFF_GRID * step:
            steps.append(float(step))
    return steps


def _shift(offsets: Floats, slices: Ints, axes: Floats, edges: Floats) -> Floats:
    """Return how far (3,) [mm] each slice lies from the one before in its plane, for offsets (n, 3) from the first."""
    in_plane = offsets @ axes.T
    slope = slices @ in_plane / max(1.0, float(slices @ slices))
    off = np.linalg.norm(in_plane - np.outer(slices, slope), axis=1).max()
    if off > OFF_GRID * edges.min():
        raise FileFormatError(
            f"its frames must lie on a straight line, got one {off:.3g} mm away from it; resample it, such as with 3D "
            "Slicer"
        )
    return np.asarray(slope @ axes)
