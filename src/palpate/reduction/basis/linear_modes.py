"""The body at rest, linearised: its stiffness, vibration modes, responses to tools, and modal derivatives.

They are bases that need no training run: vibration modes span small motions; modal derivatives (Idelsohn and Cardona,
Comput. Methods Appl. Mech. Eng. 49, 1985) how the modes change when the body moves along them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse.linalg import LinearOperator, eigsh, splu

from palpate.arrays import Floats
from palpate.dynamics.solid.model import Solid
from palpate.faults import InputError, integer_in_range

__all__ = [
    "interpolated_modes",
    "modal_derivatives",
    "rest_stiffness",
    "stiffness_blocks",
    "tool_responses",
    "vibration_modes",
]


CARRIED = 40  # coarse nodes that a mode is carried over from
DERIVATIVES = 0.55  # of all modes, at most
AMPLITUDE = 0.02  # of the spacing: displacements for second differences
DENSE = 0.1  # of a stiffness's entries that are not zero, from which on a dense factor is found sooner


def rest_stiffness(body: Solid) -> Any:
    """Return the stiffness [N/m] at rest of a body in its energy form, sparse, (3 n, 3 n), rows 3 i + c of node i.

    Raises
    ------
    InputError
        The model is not of the energy form, whose stiffness is symmetric.
    """
    n = len(body.cloud)
    parts = stiffness_blocks(body)
    blocks = [[parts[c, e] if c <= e else parts[e, c].T for e in range(3)] for c in range(3)]
    by_node = np.arange(3 * n).reshape(3, n).T.reshape(-1)
    return sparse.bmat(blocks, format="csr")[by_node][:, by_node].tocsc()


def stiffness_blocks(body: Solid, kind: type[np.floating[Any]] = np.float64) -> dict[tuple[int, int], Any]:
    """Return the stiffness [N/m] at rest between components c <= e of all nodes, by (c, e): sparse (n, n) arrays.

    Parameters
    ----------
    body : Solid
    kind : type
        Of the numbers; single precision halves the memory.

    Raises
    ------
    InputError
        As `rest_stiffness`.
    """
    if not body.conservative:
        raise InputError("the strong form has no symmetric stiffness: make the model with form='energy'")
    n = len(body.cloud)
    near, row = body.stencils.neighbours, body.stencils.row
    slopes = [_operator(near, body.stencils.first[row][:, :, d]) for d in range(3)]
    misses = _operator(near, body.stencils.value[row])
    assert body.smoothing is not None
    smooth = _operator(*body.smoothing) + sparse.identity(n)
    moduli, own = body.moduli("shear_modulus"), body.elastic_volumes
    shear = sparse.diags(own * moduli)
    second = sparse.diags(own * (body.moduli("shear_share") - 2 / 3 * moduli))
    bulk = sparse.diags(own * body.moduli("lame")).astype(kind)
    thetas = [(smooth @ slope).astype(kind) for slope in slopes]
    common = sum(slope.T @ shear @ slope for slope in slopes)
    common = common + body.body.hourglass * misses.T @ sparse.diags(body.shear_volumes) @ misses
    blocks = {}
    for c in range(3):
        for e in range(c, 3):
            block = slopes[e].T @ shear @ slopes[c] + slopes[c].T @ second @ slopes[e]
            block = block + thetas[c].T @ bulk @ thetas[e]
            if c == e:
                block = block + common
                block = (block + block.T) / 2
            blocks[c, e] = block.tocsr().astype(kind, copy=False)
    return blocks


def _operator(near: NDArray[np.int32], weights: Floats) -> Any:
    """Sparse matrix (n, n) of a sum over neighbours' differences from the node."""
    n = len(near)
    node, place = np.nonzero(near != np.arange(n)[:, None])
    matrix = sparse.csr_matrix((weights[node, place], (node, near[node, place])), (n, n))
    return (matrix - sparse.diags(np.asarray(matrix.sum(axis=1)).ravel())).tocsr()


def _free(body: Solid, groups: Sequence[str]) -> NDArray[np.int64]:
    """Degrees of freedom that neither supports nor some groups hold."""
    held = body.fixed_mask.copy()
    for name in groups:
        held[body.cloud.group(name)] = True
    if not held.any():
        raise InputError("a body without supports has no static response: give it fixed= or a tool")
    return np.flatnonzero(np.repeat(~held, 3))


class _Statics(NamedTuple):
    """The stiffness of a body at rest, that of what is free of it, and the factored one's answers to forces."""

    whole: Any
    free: NDArray[np.int64]
    stiffness: Any
    solve: Callable[[Floats], Floats]


def _statics(body: Solid, held: Sequence[str]) -> _Statics:
    free, whole = _free(body, held), rest_stiffness(body)
    stiffness = whole[free][:, free].tocsc()
    if stiffness.nnz < DENSE * len(free) ** 2:
        symmetric = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
        return _Statics(whole, free, stiffness, splu(stiffness, **symmetric).solve)
    factor = cho_factor(stiffness.toarray(order="F"), lower=True, overwrite_a=True, check_finite=False)
    return _Statics(whole, free, stiffness, lambda forces: cho_solve(factor, forces, check_finite=False))


def vibration_modes(body: Solid, count: int, held: Sequence[str] = ()) -> tuple[Floats, Floats]:
    """Find the slowest vibrations of the body at rest.

    Parameters
    ----------
    body : Solid
        In its energy form.
    count : int
    held : sequence of str
        Groups that tools hold, beside the supports.

    Returns
    -------
    modes : (count, n, 3) array
        Their largest displacement is 1 m.
    frequencies : (count,) array [rad/s]
        In ascending order.

    Raises
    ------
    InputError
        A strong form, a body that nothing holds, or a count out of range.
    """
    integer_in_range("count", count, 1, len(_free(body, held)) - 2)
    return _vibrations(body, _statics(body, held), count)


def _vibrations(body: Solid, statics: _Statics, count: int) -> tuple[Floats, Floats]:
    _, free, stiffness, solve = statics
    inverse = LinearOperator(stiffness.shape, matvec=solve)
    masses = sparse.diags(np.repeat(body.masses, 3)[free])
    start = np.random.default_rng(0).standard_normal(len(free))
    values, vectors = eigsh(stiffness, k=count, M=masses, sigma=0.0, OPinv=inverse, v0=start)
    order = np.argsort(values)
    modes = np.zeros((count, 3 * len(body.cloud)))
    modes[:, free] = vectors[:, order].T
    fields = modes.reshape(count, -1, 3)
    fields /= np.linalg.norm(fields, axis=2).max(axis=1)[:, None, None]
    return fields, np.sqrt(values[order])


def interpolated_modes(coarse: Solid, body: Solid, count: int) -> Floats:
    """Return smooth modes (count, n, 3) of a body, found on a coarser model of it: vibrations, and their derivatives.

    About half are derivatives of the slowest vibrations: without them a body is too stiff where it moves far. They are
    carried over by thin-plate splines over the nearest nodes, and are zero at the body's supports. Their largest
    displacement is about 1 m. The coarser model may be the body itself.

    Raises
    ------
    InputError
        As `vibration_modes`.
    """
    bent = int((np.sqrt(8 * DERIVATIVES * count + 1) - 1) / 2)
    slowest = count - bent * (bent + 1) // 2
    integer_in_range("count", slowest, 1, len(_free(coarse, ())) - 2)
    statics = _statics(coarse, ())
    shapes = _vibrations(coarse, statics, slowest)[0]
    if bent:
        shapes = np.concatenate([shapes, _derivatives(coarse, statics, shapes[:bent])])
    if coarse is body:
        return shapes
    flat = shapes.transpose(1, 0, 2).reshape(len(coarse.cloud), -1)
    near = min(CARRIED, len(coarse.cloud))
    fields = RBFInterpolator(coarse.cloud.points, flat, neighbors=near)(body.cloud.points)
    fields = fields.reshape(len(body.cloud), count, 3).transpose(1, 0, 2)
    for group in body.fixed:
        fields[:, body.cloud.group(group)] = 0.0
    return np.ascontiguousarray(fields)


def tool_responses(body: Solid, fields: Floats, held: Sequence[str]) -> Floats:
    """Return static responses at rest (l, n, 3) to fields that are given at the nodes of some held groups.

    Parameters
    ----------
    body : Solid
        In its energy form.
    fields : (l, n, 3) array
        Read at the held groups' nodes only.
    held : sequence of str
    """
    whole, free, _, solve = _statics(body, held)
    given = np.zeros((len(fields), 3 * len(body.cloud)))
    nodes = np.unique(np.concatenate([body.cloud.group(name) for name in held]))
    given.reshape(len(fields), -1, 3)[:, nodes] = fields[:, nodes]
    given[:, free] = -solve(whole[free] @ given.T).T
    return given.reshape(len(fields), -1, 3)


def modal_derivatives(body: Solid, modes: Floats, held: Sequence[str] = ()) -> Floats:
    """Return how the body follows pairs of modes to second order, (k (k + 1) / 2, n, 3), for modes (k, n, 3).

    Each is the static response at rest to the second derivative of the internal force along two modes; its largest
    displacement is 1 m.
    """
    return _derivatives(body, _statics(body, held), modes)


def _derivatives(body: Solid, statics: _Statics, modes: Floats) -> Floats:
    pairs = []
    body._restore_history(None)
    shapes = AMPLITUDE * body.cloud.spacing * modes / np.linalg.norm(modes, axis=2).max(axis=1)[:, None, None]
    for i, one in enumerate(shapes):
        for two in shapes[i:]:
            bend = body.force(one + two) - body.force(one - two) - body.force(two - one) + body.force(-one - two)
            field = np.zeros(3 * len(body.cloud))
            field[statics.free] = statics.solve((bend * body.volumes[:, None]).reshape(-1)[statics.free])
            pairs.append(field.reshape(-1, 3) / np.linalg.norm(field.reshape(-1, 3), axis=1).max())
    return np.array(pairs)
