"""Sparse stiffness of a body at a state, by differences of its nonlinear force.

Columns without common rows are displaced together (Curtis, Powell and Reid, J. Inst. Maths Applics
13, 1974). So the number of differences depends on the size of a stencil, and not on that of the
cloud.
"""

from __future__ import annotations

from operator import attrgetter
from typing import Any

import numpy as np
import scipy.sparse as sparse

from palpate.compiled.lanes import Lanes, ranges
from palpate.compiled.rows import Rows
from palpate.core.arrays import Floats, Ints
from palpate.dynamics.nodal.model import NodalModel
from palpate.dynamics.solid.model import EnergySolid
from palpate.meshfree.mirror import NO_MIRROR
from palpate.reduction.basis.linear_modes import rest_stiffness

# displacements for central differences, over the spacing, as in `palpate.dynamics.nodal.stability.stiffness`
STEP_SPACINGS = 1e-5
ROUNDING_SHARE = 1e-10  # of the largest entry: rounding error of differences for entries that are zero
STRESS_STEP = 1e-4  # displacements for difference quotients of the stress, in spacings


def nodal_stiffness(model: NodalModel, displacements: Floats | None = None) -> Any:
    """Return the sparse stiffness [N/m] of a body, (3 n, 3 n), rows 3 i + c of node i: minus the force derivatives.

    Row i is the internal force density at node i times the node's weight in the inner product (`NodalModel.weights`).
    So the nodal forces of a surface load are its shares of the total force. The stiffness of the energy form is
    symmetric; that of the strong form, which is collocated, is not.

    The state has displacements (n, 3) [m], and is rest by default. At rest the stiffness of the energy form is
    assembled from its stencils. Otherwise it is computed by differences, with errors of about 1e-9 of the largest
    entry.
    """
    if displacements is None and isinstance(model, EnergySolid) and model.fibres is None:
        return rest_stiffness(model)
    u = np.zeros((len(model.cloud), 3)) if displacements is None else np.array(displacements, dtype=float)
    n, pattern, delta = len(u), coupling(model), STEP_SPACINGS * model.cloud.spacing
    rows, columns, values, work = [], [], [], model.workspace()
    for group in independent_groups(pattern):
        inside = pattern[:, group].tocoo()
        node, moved = inside.row, group[inside.col]
        for c in range(3):
            u[group, c] += delta
            ahead = model.force(u, work=work)
            u[group, c] -= 2 * delta
            slope = (model.force(u, work=work) - ahead) / (2 * delta) * model.weights[:, None]
            u[group, c] += delta
            for e in range(3):
                rows.append(3 * node + e)
                columns.append(3 * moved + c)
                values.append(slope[node, e])
    entries = np.concatenate(values)
    significant = np.abs(entries) > ROUNDING_SHARE * np.abs(entries).max()
    places = np.concatenate(rows)[significant], np.concatenate(columns)[significant]
    return sparse.csc_matrix((entries[significant], places), (3 * n, 3 * n))


def coupling(model: NodalModel) -> Any:
    """Return the sparsity pattern of nodal forces (rows) by nodal displacements, sparse (n, n) of ones."""
    body, n = model.body, len(model.cloud)
    sources = np.concatenate([np.arange(n), model.mirror.source])
    reflected = np.concatenate([np.arange(n), getattr(body, "flux_mirror", NO_MIRROR).source])
    pattern = sparse.identity(n, dtype=np.int32, format="csr")
    for name in model.coupled_by:
        pattern = pattern @ _neighbours(attrgetter(name)(body), reflected if name == "transposed" else sources)
        pattern.data[:] = 1
    return pattern.tocsc()


def _neighbours(family: Lanes | Rows, sources: Ints) -> Any:
    """Return the nodes of a family of stencils, the centre included, sparse (n, n); images count as their sources."""
    n = int(sources.max()) + 1  # every node is its own source
    row, entry = ranges(family.start, family.stop)
    nodes = family.nodes[row].ravel() if isinstance(family, Lanes) else row
    near = sources[family.neighbours[entry].ravel()]
    pattern = sparse.csr_matrix((np.ones(nodes.size, dtype=np.int32), (nodes, near)), (n, n))
    return (pattern + sparse.identity(n, dtype=np.int32, format="csr")).astype(bool).astype(np.int32)


def independent_groups(pattern: Any) -> list[Ints]:
    """Return a partition of a sparse matrix's columns into groups without common rows."""
    meets = (pattern.T @ pattern).tocsr()
    colours = np.full(pattern.shape[1], -1, dtype=np.int64)
    for column in range(len(colours)):
        near = colours[meets.indices[meets.indptr[column] : meets.indptr[column + 1]]]
        used = np.zeros(len(near) + 1, dtype=np.bool_)
        used[near[(near >= 0) & (near < len(used))]] = True
        colours[column] = int(np.argmin(used))
    return [np.flatnonzero(colours == colour) for colour in range(int(colours.max()) + 1)]


def linear_stress(model: NodalModel, displacements: Floats) -> Floats:
    """Return the linearised stress [Pa] of displacements (n, 3) [m] of a body at rest, by central differences."""
    largest = float(np.abs(displacements).max())
    if largest == 0:
        return model.stress(displacements)
    scale = STRESS_STEP * model.cloud.spacing / largest
    return (model.stress(scale * displacements) - model.stress(-scale * displacements)) / (2 * scale)
