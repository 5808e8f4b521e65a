"""Whether two statements of a header agree: maps from indices to positions, and lengths.

Two maps agree if no corner of the image lies farther apart than a tenth of the shortest edge of a voxel, or a
thousandth of the image's diagonal if that is more: quaternions in single precision are as exact. Lengths agree within
1 %.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from palpate.core.arrays import Floats

EDGE_SHARE, DIAGONAL_SHARE = 0.1, 1e-3
LENGTH_SHARE = 0.01
RIGHT_ANGLE = 1e-4  # largest cosine between axes at right angles, beyond which ITK refuses NIfTI


def difference_of_maps(taken: Floats, other: Floats, shape: tuple[int, ...], millimetres: float = 1.0) -> str:
    """Return how far another map (4, 4) puts voxels from where the taken one does; empty where both agree.

    `shape` has the voxels along each axis; `millimetres` is the unit of the maps.
    """
    corners = np.array(list(product(*((-0.5, size - 0.5) for size in shape))))
    apart = corners @ (other - taken)[:3, :3].T + (other - taken)[:3, 3]
    distance = float(np.linalg.norm(apart, axis=1).max())
    edges = np.linalg.norm(taken[:3, :3], axis=0)
    if distance <= max(EDGE_SHARE * edges.min(), DIAGONAL_SHARE * np.linalg.norm(edges * shape)):
        return ""
    mirrored = np.linalg.det(taken[:3, :3]) * np.linalg.det(other[:3, :3]) < 0
    return f"up to {millimetres * distance:.3g} mm{', and are mirror images' * bool(mirrored)}"


def lengths_agree(taken: Floats, other: Floats) -> bool:
    """Return whether lengths agree."""
    return bool(np.all(np.abs(other - taken) <= LENGTH_SHARE * np.abs(taken)))


def lengths_text(lengths: Floats, millimetres: float = 1.0) -> str:
    """Return lengths for a sentence, such as ``2 x 2 x 3 mm``."""
    return " x ".join(f"{millimetres * each:.4g}" for each in lengths) + " mm"


def is_sheared(affine: Floats) -> bool:
    """Return whether the axes of a map (4, 4) are not at right angles."""
    axes = affine[:3, :3] / np.linalg.norm(affine[:3, :3], axis=0)
    return bool(np.abs(axes.T @ axes - np.eye(3)).max() > RIGHT_ANGLE)
