"""Nodal weights that integrate quadratic fields over a body.

A sum over nodal volumes is the trapezoidal rule: with five nodes across it makes a beam 12 % too stiff in bending.
Here a field is integrated over each node's cell as its fit there says,

    integral of f  =  sum over I of V_I (f_I + m_I . grad f_I + 1/2 M_I : grad grad f_I),

m_I and M_I the first and second moments of the cell about its node, and the derivatives' weights are collected. On a
lattice the weights of the inner nodes stay as they are, and those near a face become end corrections of Gregory's kind.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from palpate.meshfree.cloud import Cloud
from palpate.meshfree.stencils import Stencils

__all__ = ["integration_weights"]

Floats = NDArray[np.float64]

LEAST = 0.3  # of a node's volume: corrections of edges and corners multiply, and a weight must stay positive
PAIRS = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))  # the order of `Stencils.second`


def integration_weights(cloud: Cloud, stencils: Stencils) -> Floats:
    """Return positive weights [m^3], shape (n,), that sum to the body's volume.

    Parameters
    ----------
    cloud : Cloud
        In space.
    stencils : Stencils
        An interpolating fit of order 2 at its points.
    """
    volumes = cloud.volumes
    centre = np.zeros_like(cloud.points)  # of the cell, seen from the node: half its thickness under each face
    thickness = volumes[cloud.face_nodes] / cloud.face_areas
    np.add.at(centre, cloud.face_nodes, -0.5 * thickness[:, None] * cloud.face_normals)
    second = np.stack([centre[:, a] * centre[:, b] for a, b in PAIRS], axis=1)
    second[:, :3] = 0.5 * cloud.spacing**2 / 12
    weights = volumes.copy()
    for moments, table in ((centre, stencils.first), (second, stencils.second)):
        shares = volumes[:, None] * np.einsum("nkw,nw->nk", table[stencils.row], moments)
        np.add.at(weights, stencils.neighbours, shares)
        weights -= shares.sum(axis=1)
    weights = np.maximum(weights, LEAST * volumes)
    return np.asarray(weights * (volumes.sum() / weights.sum()))
