"""Stencil check: nodes of a cloud whose stencils or derivatives are unusable."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from palpate.core.arrays import Floats, Ints
from palpate.core.faults import CloudError
from palpate.meshfree.cloud import Cloud
from palpate.meshfree.stencils import moving_least_squares

STENCIL_NODES = 42  # neighbours in a stencil, the default of `palpate.Solid`


def nearest_spacing(points: Floats) -> Floats:
    """Return every node's distance to its nearest neighbour [m], shape (n,)."""
    return np.asarray(cKDTree(points).query(points, k=2, workers=-1)[0][:, 1])


def faulty_nodes(cloud: Cloud, neighbours: int = STENCIL_NODES) -> tuple[Ints, str]:
    """Return the nodes with unusable stencils and the reason; none if all are usable.

    The number of neighbours is as for `palpate.Solid`.
    """
    try:
        moving_least_squares(cloud.points, order=2, neighbours=neighbours, hidden=cloud.hidden)
    except CloudError as error:
        return error.nodes, "the stencils fail"
    return np.zeros(0, dtype=np.int64), ""
