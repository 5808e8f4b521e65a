"""Shares of the nodes' cells that lie in a region, for moduli of nodes at the border of stiff tissue.

A node whose cell lies partly in a region has the mean compliance of its cell: the modulus is the
harmonic mean by volume. A border through the middle of the cells then is where it belongs, whatever
nodes are nearest; a stiff ball represented by the nodes inside it alone acts as a larger one.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from palpate.core.arrays import Floats
from palpate.core.faults import InputError
from palpate.meshfree.cloud import Cloud

SAMPLES_PER_EDGE = 6  # along an edge of a node's cell
BATCH_NODES = 256  # whose samples are kept at once
CELL_REACH = 1.0  # from a region to cells that it can enter, in spacings


def cell_fractions(cloud: Cloud, inside: Callable[[Floats], NDArray[np.bool_]]) -> Floats:
    """Return the share of every node's cell that lies in a region, shape (n,), from 0 to 1.

    Cells are the parts of the body that are nearest to a node (Voronoi), and sampled on a lattice.

    Parameters
    ----------
    cloud : Cloud
        In space.
    inside : function
        Returns True for those of some points (k, 3) [m] that lie in the region.

    Raises
    ------
    InputError
        The cloud is not in space, or `inside` returns another shape.

    Examples
    --------
    >>> import numpy as np
    >>> import palpate as pt
    >>> cloud = pt.box((0.04, 0.04, 0.04), spacing=0.005)
    >>> share = pt.cell_fractions(cloud, lambda x: np.linalg.norm(x - 0.02, axis=1) < 0.01)
    >>> bool(abs(share @ cloud.volumes / (4 / 3 * np.pi * 0.01**3) - 1) < 0.05)
    True
    >>> factors = 1 / (1 - share + share / 10)  # of a nodule ten times as stiff, for `Solid(stiffness=)`
    """
    if cloud.points.shape[1] != 3:
        raise InputError("cloud must be in space (d = 3) for cells, got a plane cloud")
    step, tree = cloud.spacing / SAMPLES_PER_EDGE, cKDTree(cloud.points)
    offsets = step * np.stack(np.meshgrid(*[np.arange(-SAMPLES_PER_EDGE, SAMPLES_PER_EDGE + 1)] * 3), axis=-1).reshape(
        -1, 3
    )
    offsets = offsets[np.linalg.norm(offsets, axis=1) <= CELL_REACH * cloud.spacing]
    fraction, outward = _inside(inside, cloud.points).astype(float), _normals(cloud)
    for part in np.array_split(np.arange(len(cloud)), len(cloud) // BATCH_NODES + 1):
        samples = cloud.points[part, None] + offsets
        within = _inside(inside, samples.reshape(-1, 3)).reshape(len(part), -1)
        for i, places, mask in zip(part, samples, within, strict=True):
            if mask.all() or not mask.any():
                continue
            nearest = tree.query(places)[1] == i
            nearest &= ~((places - cloud.points[i]) @ outward[i].T > 1e-9 * step).any(axis=1)
            fraction[i] = mask[nearest].mean()
    return fraction


def _inside(inside: Callable[[Floats], NDArray[np.bool_]], points: Floats) -> NDArray[np.bool_]:
    mask = np.asarray(inside(points), dtype=bool)
    if mask.shape != (len(points),):
        raise InputError(f"inside must return one truth value per point, ({len(points)},), got shape {mask.shape}")
    return mask


def _normals(cloud: Cloud) -> list[Floats]:
    """Return the outward normals (f, 3) of every node's faces."""
    order = np.argsort(cloud.face_nodes, kind="stable")
    start = np.searchsorted(cloud.face_nodes[order], np.arange(len(cloud) + 1))
    return [cloud.face_normals[order[a:b]] for a, b in pairwise(start)]
