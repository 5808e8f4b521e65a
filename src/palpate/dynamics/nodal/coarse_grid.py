"""A preconditioner of the tangent stiffness of a body: its nodes one by one, plus a coarse grid.

The inverse of the tangent is approximated by the sum of two inverses (a two-level additive Schwarz
method: Smith, Bjorstad and Gropp, Domain Decomposition, Cambridge 1996, section 2.1). The blocks of
the nodes resist short waves. Long waves are multilinear functions on a grid that is a few spacings
wide. The stiffness of the grid is an energy summed over the nodes, with their tangent moduli. The
volume's share is averaged over a cell, so that nearly incompressible tissue does not lock (Hughes,
The Finite Element Method, Dover 2000, section 4.5).
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import product
from typing import NamedTuple

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.sparse.linalg import splu

from palpate.core.arrays import Floats, Ints
from palpate.dynamics.loads.supports import SupportedNodes
from palpate.dynamics.material.tissue import TissueField
from palpate.dynamics.nodal.model import NodalModel
from palpate.meshfree.cloud import Cloud

CELL_SPACINGS = (2.0, 2.5, 3.0, 4.0, 6.0)  # widths of a cell in spacings; the first with few enough nodes is used
MAX_GRID_NODES = 1500
NODE_STIFFNESS = 0.3  # stiffness of one node alone, over its moduli times volume / spacing^2
CLAMP_FACTOR = 10.0  # stiffness by which the grid is clamped at a node, over that of the node alone
DIAGONAL_SHIFT = 1e-8  # of the largest stiffness of the grid, for its nodes with little tissue
MIN_MODULUS = 1e-4  # smallest modulus of a node alone, over the shear modulus


class _Moduli(NamedTuple):
    """Moduli with positive energies; rows and columns d c + k of F_ck."""

    shear: Floats  # (n, 3 d, 3 d) array [Pa]: without the volume's share
    bulk: Floats  # (n,) array [Pa]: coefficient of the volume's share, bulk (cof F) x (cof F)
    cofactor: Floats  # (n, 3 d) array


def two_level_preconditioner(
    model: NodalModel, F: Floats, moduli: Floats, constrained: NDArray[np.bool_], springs: Floats
) -> Callable[[Floats], Floats]:
    """Return an approximate inverse of a body's tangent stiffness, as a function of nodal forces.

    The state has deformation gradients `F` (n, 3, d) and tangent moduli dP_ck / dF_em (n, 3 d, 3 d) [Pa], rows d c + k
    and columns d e + m. `constrained` (n,) nodes do not move; `springs` (n,) [N/m] are those of foundations.

    The function takes forces (n, 3) [N] and returns displacements (n, 3) [m], zero at constrained nodes. It is linear,
    symmetric and, on the other nodes, positive definite. Across the supports of sliding nodes forces must be zero, and
    displacements are.
    """
    supported = model.supported
    positive, spring = _positive_moduli(F, moduli), springs[:, None, None] * np.eye(3)
    blocks = _node_blocks(model, positive) + spring
    inverse = np.linalg.inv(blocks)
    inverse[constrained] = 0.0
    inverse[supported.sliding] = supported.slide @ inverse[supported.sliding] @ supported.slide
    stiff = CLAMP_FACTOR * np.trace(blocks, axis1=1, axis2=2) / 3
    grid = (stress_free_points(model), model.cloud.spacing, model.weights)
    coarse = _grid_solver(grid, positive, (constrained, stiff, springs), supported)
    constrain = model.constrain(constrained)

    def precondition(forces: Floats) -> Floats:
        return np.asarray((inverse @ forces[:, :, None])[:, :, 0] + constrain(coarse(constrain(forces.copy()))))

    return precondition


def static_estimate(
    cloud: Cloud,
    weights: Floats,
    tissue: TissueField,
    supported: SupportedNodes,
    constrained: NDArray[np.bool_],
    springs: Floats,
) -> Callable[[Floats], Floats]:
    """Return the static response of a body at rest on the coarse grid, as a function of nodal forces.

    The function takes forces (n, 3) [N] and returns displacements (n, 3) [m]. Long waves of the response are those of
    the grid, some spacings wide; shorter ones are missing. It is the mean of two grids: nodes between two cells count
    to one of them, which bends symmetric bodies.

    A sheet responds like a membrane under a tension of its shear modulus, in all directions. Fibres are left out.
    `weights` (n,) [m^3] are nodal volumes, `springs` (n,) [N/m]; `constrained` (n,) nodes do not move.
    """
    law = tissue.factors[:, 0]
    shear, lame = law * tissue.moduli("shear_modulus"), law * tissue.moduli("lame")
    sheet = cloud.points.shape[1] == 2
    moduli = _tension(shear) if sheet else _isotropic(shear, lame)
    stiff = CLAMP_FACTOR * NODE_STIFFNESS / cloud.spacing**2 * weights * (shear if sheet else lame + 2 * shear)
    constraints = constrained, stiff, springs
    grids = [(sign * cloud.points, cloud.spacing, weights) for sign in (1.0, -1.0)]
    one, two = (_grid_solver(grid, moduli, constraints, supported) for grid in grids)
    return lambda forces: 0.5 * (one(forces) + two(forces))


def _isotropic(shear: Floats, lame: Floats) -> _Moduli:
    """Return the moduli of isotropic solids at rest, with shear modulus and Lame's first parameter (n,) [Pa]."""
    eye = np.eye(3)
    deviator = (
        np.einsum("ce,km->ckem", eye, eye)
        + np.einsum("cm,ke->ckem", eye, eye)
        - 2 / 3 * np.einsum("ck,em->ckem", eye, eye)
    )
    cofactor = np.tile(eye.reshape(1, 9), (len(shear), 1))
    return _Moduli(shear[:, None, None] * deviator.reshape(9, 9), lame + 2 / 3 * shear, cofactor)


def _tension(stress: Floats) -> _Moduli:
    """Return the moduli of sheets under a tension (n,) [Pa] that resists slopes in all directions alike."""
    n = len(stress)
    return _Moduli(stress[:, None, None] * np.eye(6), np.zeros(n), np.zeros((n, 6)))


def _grid_solver(
    grid: tuple[Floats, float, Floats],
    moduli: _Moduli,
    constraints: tuple[NDArray[np.bool_], Floats, Floats],
    supported: SupportedNodes,
) -> Callable[[Floats], Floats]:
    """Return the displacements (n, 3) of the grid under nodal forces (n, 3), as a function.

    `grid` has points (n, d), spacing and weights (n,). `constraints` are the nodes that do not move (n,), the stiffness
    [N/m] by which the grid is held there, and springs [N/m].
    """
    (points, spacing, weights), (constrained, stiff, springs) = grid, constraints
    corners, cell, value, slope = _multilinear(points, spacing)
    n, count = len(value), int(corners.max()) + 1
    values = sparse.csr_array((value.ravel(), (np.repeat(np.arange(n), value.shape[1]), corners.ravel())), (n, count))
    clamp = np.where(constrained, stiff, 0.0)
    stiffness = _grid_stiffness(moduli, weights, corners, cell, slope)
    supports = (values.T @ sparse.diags_array(clamp + springs) @ values).tocsr()
    stiffness = stiffness + sparse.kron(supports, sparse.eye_array(3), format="csr")
    if len(supported.sliding):
        across = stiff[supported.sliding, None, None] * (np.eye(3) - supported.slide)
        sliding_values = sparse.kron(values[supported.sliding], sparse.eye_array(3), format="csr")
        stiffness = stiffness + sliding_values.T @ sparse.block_diag(list(across), format="csr") @ sliding_values
    stiffness = stiffness + DIAGONAL_SHIFT * stiffness.diagonal().max() * sparse.eye_array(3 * count)
    symmetric = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
    factor, gather = splu(sparse.csc_matrix(stiffness), **symmetric), values.T.tocsr()
    return lambda forces: np.asarray(values @ factor.solve((gather @ forces).ravel()).reshape(-1, 3))


def _positive_moduli(F: Floats, moduli: Floats) -> _Moduli:
    """Split the volume's share from moduli, and set negative energies of the rest to zero."""
    n, size = moduli.shape[:2]
    rest = np.nan_to_num((moduli + moduli.transpose(0, 2, 1)) / 2, posinf=0.0, neginf=0.0)
    bulk, cofactor = np.zeros(n), np.zeros((n, size))
    if size == 9:
        cofactor = np.cross(np.roll(F, -1, axis=1), np.roll(F, -2, axis=1)).reshape(n, 9)
        square = np.sum(cofactor**2, axis=1)
        along = np.einsum("ni,nij,nj->n", cofactor, rest, cofactor, optimize=True) / square
        # at rest the other eigenvalues are five times 2 mu and three zeros; 2 mu remain along cof F
        typical = (np.trace(rest, axis1=1, axis2=2) - along) / 5
        bulk = np.maximum(along - np.maximum(typical, 0.0), 0.0) / square
        rest = rest - bulk[:, None, None] * cofactor[:, :, None] * cofactor[:, None, :]
    values, vectors = np.linalg.eigh(rest)
    shear = (vectors * np.maximum(values, 0.0)[:, None, :]) @ vectors.transpose(0, 2, 1)
    return _Moduli(shear, bulk, cofactor)


def _node_blocks(model: NodalModel, moduli: _Moduli) -> Floats:
    """Return the stiffness (n, 3, 3) [N/m] of every node alone."""
    n, size = moduli.cofactor.shape
    products = moduli.shear + moduli.bulk[:, None, None] * moduli.cofactor[:, :, None] * moduli.cofactor[:, None, :]
    summed = np.einsum("nckek->nce", products.reshape(n, 3, size // 3, 3, size // 3))
    summed = summed + MIN_MODULUS * model.material.shear_modulus * np.eye(3)
    return np.asarray(NODE_STIFFNESS / model.cloud.spacing**2 * model.weights[:, None, None] * summed)


def _grid_stiffness(moduli: _Moduli, weights: Floats, corners: Ints, cell: Ints, slope: Floats) -> sparse.csr_array:
    """Return the stiffness of the grid, sparse, rows 3 g + c of grid node g."""
    n, size = moduli.cofactor.shape
    per_node, d = slope.shape[1:]
    width = 3 * (int(corners.max()) + 1)
    columns = 3 * corners[:, None, :] + np.arange(3)[:, None]  # (n, c, corner)
    columns = np.broadcast_to(columns[:, :, None], (n, 3, d, per_node))
    entries = np.broadcast_to(slope.transpose(0, 2, 1)[:, None], columns.shape)
    starts = per_node * np.arange(size * n + 1)
    strain = sparse.csr_array((entries.ravel(), columns.ravel(), starts), shape=(size * n, width))
    shear = sparse.bsr_array((weights[:, None, None] * moduli.shear, np.arange(n), np.arange(n + 1)))
    stiffness = strain.T @ (shear.tocsr() @ strain)
    if moduli.bulk.any():
        total = np.bincount(cell, weights)
        share = (weights / total[cell])[:, None] * moduli.cofactor
        places = np.repeat(cell, size), np.arange(size * n)
        mean = sparse.csr_array((share.ravel(), places), shape=(len(total), size * n)) @ strain
        stiffness = stiffness + mean.T @ sparse.diags_array(np.bincount(cell, weights * moduli.bulk)) @ mean
    return sparse.csr_array(stiffness)


def _multilinear(points: Floats, spacing: float) -> tuple[Ints, Ints, Floats, Floats]:
    """Return multilinear functions on a grid at points (n, d).

    They are the grid nodes (n, 2^d) of every point's cell, the cell (n,), and values (n, 2^d) and derivatives
    (n, 2^d, d) [1/m] of the functions of the corners.
    """
    n, d = points.shape
    low, extent = points.min(axis=0), np.ptp(points, axis=0)
    steps = np.array(list(product((0, 1), repeat=d)))
    for width in CELL_SPACINGS:
        cells = np.maximum(np.round(extent / (width * spacing)), 1).astype(np.int64)
        place = (points - low) / (extent / cells)
        index = np.minimum(place.astype(np.int64), cells - 1)
        corners = np.ravel_multi_index(tuple(np.moveaxis(index[:, None] + steps, -1, 0)), tuple(cells + 1))
        used, corners = np.unique(corners, return_inverse=True)
        if len(used) <= MAX_GRID_NODES:
            break
    cell = np.unique(np.ravel_multi_index(tuple(index.T), tuple(cells)), return_inverse=True)[1]
    share = (place - index)[:, None, :]
    factors = np.where(steps, share, 1 - share)  # (n, 2^d, d)
    signs = np.where(steps, 1.0, -1.0) * (cells / extent)
    slope = np.stack([signs[:, k] * np.delete(factors, k, axis=2).prod(axis=2) for k in range(d)], axis=2)
    return corners.reshape(n, 2**d), cell, factors.prod(axis=2), slope


def stress_free_points(model: NodalModel) -> Floats:
    """Return the coordinates (n, d) [m] by which F is a derivative."""
    return np.asarray(model.cloud.points / float(getattr(model, "prestretch", 1.0)))
