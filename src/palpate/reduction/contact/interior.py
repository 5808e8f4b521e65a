"""What dents do inside a body: the residual flexibility of its inner nodes, for displacements of the whole body.

A tool's forces on the surface move a node inside, beside what the modes do, by the statics at rest that modes leave,
R f, with R as for the surface (`palpate.reduction.contact.residual_flexibility`), its rows those of nodes inside. Little of it is large
strain: unlike near the tool on the surface, R needs neither a factor nor hardening to be what runs under known forces
show. A coarser model's displacements are carried to the nodes inside a finer one by linear fits.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from palpate.arrays import Floats, Ints
from palpate.meshfree.cloud import Cloud

__all__ = ["Interior", "interior", "interior_displacements", "spread"]


SOURCES = 12  # nodes of a coarser model that a finer one's follows
WIDTH = 0.6  # of the coarse spacing: where a source's weight in the fit has fallen to 1/e
FLAT = 1e-3  # of the weights: keeps a fit from slopes that its sources do not know
DIGITS = 11  # binary ones that are kept of the flexibility: more would double the model's file


class Interior(NamedTuple):
    """How a body's nodes inside follow forces on its surface, beside its modes.

    Parameters
    ----------
    nodes : (i,) int array
        Free nodes that no tool may touch.
    flexibility : (3 c, 3 b) float32 array [m/N]
        Displacements of some of them, or of a coarser model's, columns 3 b + component, by forces on the carriers of
        the surface (`Dents.carriers`).
    sources : (i, w) int array
        What each node follows: from 0 those of the flexibility, then from b on the carriers.
    shares : (i, w) array
        How much.
    factor : float
        Of the surface's flexibility (`Dents.flexibility`) over R.
    """

    nodes: Ints
    flexibility: NDArray[np.float32]
    sources: Ints
    shares: Floats
    factor: float = 1.0


def interior(coarse: Cloud, those: Ints, carriers: Ints, rows: Floats, fine: Cloud, nodes: Ints) -> Interior:
    """Lay out how the nodes inside a body follow.

    Parameters
    ----------
    coarse, fine : Cloud
        Of one body; they may be one.
    those : (b,) int array
        Free nodes inside the coarse one.
    carriers : (c,) int array
        Its free nodes on the surface.
    rows : (3 b, 3 c) array [m/N]
        Residual flexibility of the former for forces on the latter.
    nodes : (i,) int array
        Free nodes inside the fine one.
    """
    if coarse is fine:
        sources, shares = np.searchsorted(those, nodes)[:, None], np.ones((len(nodes), 1))
    else:
        known = coarse.points[np.concatenate([those, carriers])]
        sources, shares = _followed(fine.points[nodes], known, coarse.spacing)
    fraction, exponent = np.frexp(rows.T)
    kept = np.ldexp(np.round(fraction * 2**DIGITS), exponent - DIGITS)
    return Interior(nodes, np.ascontiguousarray(kept, dtype=np.float32), sources, shares)


def _followed(points: Floats, known: Floats, spacing: float) -> tuple[Ints, Floats]:
    """Return nodes and weights (i, w) of linear fits to what is known at some places."""
    distances, sources = cKDTree(known).query(points, k=range(1, min(SOURCES, len(known)) + 1))
    weights = np.exp((distances[:, :1] ** 2 - distances**2) / (WIDTH * spacing) ** 2)
    away = (known[sources] - points[:, None]) / spacing
    basis = np.concatenate([np.ones((*sources.shape, 1)), away], axis=2)
    moments = np.einsum("iw,iwp,iwq->ipq", weights, basis, basis)
    moments[:, [1, 2, 3], [1, 2, 3]] += FLAT * weights.sum(axis=1, keepdims=True)
    level = np.linalg.solve(moments, np.eye(4)[None, :, :1])[:, :, 0]
    return sources, weights * np.einsum("iwp,ip->iw", basis, level)


def interior_displacements(of: Interior, forces: Floats, surface: Floats) -> Floats:
    """Return what a tool does to the nodes inside beside the modes, shape (i, 3) [m].

    Parameters
    ----------
    of : Inside
    forces : (c, 3) array [N]
        Of the tool, on the carriers of the surface.
    surface : (c, 3) array [m]
        What they do to the carriers by `Dents.flexibility`.
    """
    known = np.concatenate([spread(of.flexibility, forces), surface / of.factor])
    return np.asarray(np.einsum("iw,iwc->ic", of.shares, known[of.sources]))


def spread(flexibility: NDArray[np.float32], forces: Floats) -> Floats:
    """Return the displacements (b, 3) [m] by a flexibility (3 c, 3 b) and few forces (c, 3) [N]."""
    loaded = np.flatnonzero(forces.any(axis=1))
    rows = (3 * loaded[:, None] + np.arange(3)).ravel()
    return np.asarray(forces[loaded].reshape(-1) @ flexibility[rows]).reshape(-1, 3)
