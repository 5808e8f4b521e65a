"""Linearisation at rest: stiffness, vibration modes, responses to tools, and modal derivatives.

These bases need no training run. Vibration modes span small motions. Modal derivatives (Idelsohn and
Cardona, Comput. Methods Appl. Mech. Eng. 49, 1985) describe the change of the modes when the body moves
along them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.interpolate import RBFInterpolator
from scipy.linalg import cho_factor, cho_solve
from scipy.sparse.linalg import LinearOperator, eigsh, splu

from palpate.core.arrays import Floats
from palpate.core.faults import InputError, integer_in_range
from palpate.dynamics.loads.supports import free_directions, free_rigid_motions
from palpate.dynamics.nodal.model import NodalModel
from palpate.dynamics.solid.model import EnergySolid, Solid, energy_solid
from palpate.meshfree.mirror import Mirror

INTERPOLATION_NODES = 40  # coarse nodes in the interpolation of a mode
DERIVATIVE_SHARE = 0.55  # largest share of modal derivatives in all modes
DIFFERENCE_STEP = 0.02  # displacements for second differences, in spacings
DENSE_SHARE = 0.1  # of non-zero entries, above which a dense factorisation is faster


def rest_stiffness(body: EnergySolid) -> Any:
    """Return the sparse stiffness [N/m] at rest of a body in its energy form, (3 n, 3 n), rows 3 i + c of node i."""
    n = len(body.cloud)
    by_node = np.arange(3 * n).reshape(3, n).T.reshape(-1)
    return _assembled(stiffness_blocks(body))[by_node][:, by_node].tocsc()


def _assembled(blocks: dict[tuple[int, int], Any]) -> Any:
    """Return the symmetric sparse array of blocks of components c <= e, component by component."""
    rows = [[blocks[c, e] if c <= e else blocks[e, c].T for e in range(3)] for c in range(3)]
    return sparse.bmat(rows, format="csr")


def stiffness_blocks(body: EnergySolid, kind: type[np.floating[Any]] = np.float64) -> dict[tuple[int, int], Any]:
    """Return the stiffness [N/m] at rest between components c <= e of all nodes: sparse (n, n) arrays by (c, e).

    Single precision as the `kind` of the numbers halves the memory.
    """
    n, images = len(body.cloud), len(body.mirror.source)
    near, row = body.stencils.neighbours, body.stencils.row
    slopes = [_operator(near, body.stencils.first[row][:, :, d], images) for d in range(3)]
    hourglass_residual = _operator(near, body.stencils.value[row], images)
    smooth = _operator(body.smoothing.neighbours, body.smoothing.weights) + sparse.identity(n)
    moduli, elastic_volumes = body.tissue.moduli("shear_modulus"), body.elastic_volumes
    shear = sparse.diags(elastic_volumes * moduli)
    second = sparse.diags(elastic_volumes * (body.tissue.moduli("shear_share") - 2 / 3 * moduli))
    bulk = sparse.diags(elastic_volumes * body.tissue.moduli("lame")).astype(kind)
    thetas = [(smooth @ slope).astype(kind) for slope in slopes]
    common = sum(slope.T @ shear @ slope for slope in slopes)
    common = common + body.body.hourglass * hourglass_residual.T @ sparse.diags(body.shear_volumes) @ hourglass_residual
    blocks = {}
    for c in range(3):
        for e in range(c, 3):
            block = slopes[e].T @ shear @ slopes[c] + slopes[c].T @ second @ slopes[e]
            block = block + thetas[c].T @ bulk @ thetas[e]
            if c == e:
                block = block + common
                block = (block + block.T) / 2
            blocks[c, e] = block.tocsr().astype(kind, copy=False)
    return _folded(blocks, body.mirror, n) if images else blocks


def _folded(blocks: dict[tuple[int, int], Any], mirror: Mirror, n: int) -> dict[tuple[int, int], Any]:
    """Return the blocks (n, n) of nodes for those (n + g, n + g) of nodes and images, whose displacements follow."""
    by_component = [np.arange(3 * size).reshape(size, 3).T.reshape(-1) for size in (n + len(mirror.source), n)]
    reflect = mirror.matrix(n)[by_component[0]][:, by_component[1]].astype(blocks[0, 0].dtype)
    folded = (reflect.T @ _assembled(blocks) @ reflect).tocsr()
    return {(c, e): folded[c * n : (c + 1) * n, e * n : (e + 1) * n] for c, e in blocks}


def _operator(near: NDArray[np.int32], weights: Floats, images: int = 0) -> Any:
    """Return the sparse matrix (n, n + g) of a sum over neighbours' differences from the node, with g images."""
    n = len(near)
    node, place = np.nonzero(near != np.arange(n)[:, None])
    matrix = sparse.csr_matrix((weights[node, place], (node, near[node, place])), (n, n + images))
    sums = sparse.diags(np.asarray(matrix.sum(axis=1)).ravel(), shape=(n, n + images))
    return (matrix - sums).tocsr()


def _free(body: NodalModel, groups: Sequence[str]) -> tuple[Any, NDArray[np.int64]]:
    """Return the basis of displacements that supports and some groups, which do not move, leave free."""
    nodes = np.unique(np.concatenate([np.zeros(0, dtype=np.int64), *(body.cloud.group(name) for name in groups)]))
    check_supported(body, nodes)
    return free_directions(body.supported, nodes)


def check_supported(body: NodalModel, held: NDArray[np.int64] | None = None) -> None:
    """Raise `InputError` for a body that supports and some nodes leave free to move rigidly."""
    mask = np.zeros(len(body.cloud), dtype=bool)
    mask[np.zeros(0, dtype=np.int64) if held is None else held] = True
    moving = free_rigid_motions(body.cloud.points, body.constrain(mask))
    if moving:
        raise InputError(
            f"body must have supports for a static response, got {moving} free rigid motions; give it fixed= or a tool"
        )


class RestStatics(NamedTuple):
    """Stiffness of a body at rest, the free directions and their block, and a solver for that block."""

    whole: Any
    free: Any
    numbers: NDArray[np.int64]
    stiffness: Any
    solve: Callable[[Floats], Floats]


def rest_statics(body: EnergySolid, held: Sequence[str]) -> RestStatics:
    """Return the factorised stiffness at rest of the free degrees of freedom, with those of some groups held."""
    (free, numbers), full = _free(body, held), rest_stiffness(body)
    stiffness = (free.T @ full @ free).tocsc()
    if stiffness.nnz < DENSE_SHARE * len(numbers) ** 2:
        symmetric = {"permc_spec": "MMD_AT_PLUS_A", "diag_pivot_thresh": 0.0, "options": {"SymmetricMode": True}}
        return RestStatics(full, free, numbers, stiffness, splu(stiffness, **symmetric).solve)
    factor = cho_factor(stiffness.toarray(order="F"), lower=True, overwrite_a=True, check_finite=False)
    return RestStatics(full, free, numbers, stiffness, lambda forces: cho_solve(factor, forces, check_finite=False))


def vibration_modes(body: Solid, count: int, held: Sequence[str] = ()) -> tuple[Floats, Floats]:
    """Return the slowest vibration modes of the body at rest.

    Parameters
    ----------
    body : Solid
        In the energy form.
    count : int
    held : sequence of str
        Groups that tools hold, in addition to the supports.

    Returns
    -------
    modes : (count, n, 3) array
        Their largest displacement is 1 m.
    frequencies : (count,) array [rad/s]
        In ascending order.

    Raises
    ------
    InputError
        The body has the strong form or no supports, or the count is out of range.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> modes, frequencies = pt.vibration_modes(bar, 6)
    >>> modes.shape, bool((frequencies[1:] >= frequencies[:-1]).all())
    ((6, 112, 3), True)
    """
    solid = energy_solid(body)
    integer_in_range("count", count, 1, len(_free(solid, held)[1]) - 2)
    return _vibrations(solid, rest_statics(solid, held), count)


def _vibrations(body: NodalModel, statics: RestStatics, count: int) -> tuple[Floats, Floats]:
    _, free, numbers, stiffness, solve = statics
    inverse = LinearOperator(stiffness.shape, matvec=solve)
    masses = sparse.diags(np.repeat(body.masses, 3)[numbers])
    start = np.random.default_rng(0).standard_normal(len(numbers))
    values, vectors = eigsh(stiffness, k=count, M=masses, sigma=0.0, OPinv=inverse, v0=start)
    order = np.argsort(values)
    fields = np.ascontiguousarray((free @ vectors[:, order]).T).reshape(count, -1, 3)
    fields /= np.linalg.norm(fields, axis=2).max(axis=1)[:, None, None]
    return fields, np.sqrt(values[order])


def interpolated_modes(coarse: EnergySolid, body: EnergySolid, count: int) -> Floats:
    """Return smooth modes (count, n, 3) of a body from a coarser model: vibration modes and their derivatives.

    About half are derivatives of the slowest vibrations, without which a body is too stiff in large
    motions. Thin-plate splines over the nearest nodes interpolate them. They are zero at the body's
    supports, and their largest displacement is about 1 m. The coarser model may be the body itself.
    """
    bent = int((np.sqrt(8 * DERIVATIVE_SHARE * count + 1) - 1) / 2)
    slowest = count - bent * (bent + 1) // 2
    statics = rest_statics(coarse, ())
    most = len(statics.numbers) - 2
    if not 1 <= slowest <= most:
        raise InputError(f"count must be from 1 to {most} vibration modes of the body, got {slowest}; use fewer modes")
    shapes = _vibrations(coarse, statics, slowest)[0]
    if bent:
        shapes = np.concatenate([shapes, _derivatives(coarse, statics, shapes[:bent])])
    if coarse is body:
        return shapes
    flat = shapes.transpose(1, 0, 2).reshape(len(coarse.cloud), -1)
    near = min(INTERPOLATION_NODES, len(coarse.cloud))
    fields = RBFInterpolator(coarse.cloud.points, flat, neighbors=near)(body.cloud.points)
    fields = fields.reshape(len(body.cloud), count, 3).transpose(1, 0, 2)
    return np.ascontiguousarray(body.supported.project(np.array(fields)))


def tool_responses(body: EnergySolid, fields: Floats, held: Sequence[str]) -> Floats:
    """Return static responses at rest (l, n, 3) to fields (l, n, 3) prescribed at the nodes of some groups.

    The body is in the energy form. Only the values at the groups' nodes are used.
    """
    full, free, _, _, solve = rest_statics(body, held)
    responses = np.zeros((len(fields), 3 * len(body.cloud)))
    nodes = np.unique(np.concatenate([body.cloud.group(name) for name in held]))
    responses.reshape(len(fields), -1, 3)[:, nodes] = fields[:, nodes]
    responses -= (free @ solve(free.T @ (full @ responses.T))).T
    return responses.reshape(len(fields), -1, 3)


def modal_derivatives(body: Solid, modes: Floats, held: Sequence[str] = ()) -> Floats:
    """Return second-order responses of the body to pairs of modes.

    Each is the static response at rest to the second derivative of the internal force along two modes. Its
    largest displacement is 1 m.

    Parameters
    ----------
    body : Solid
        In the energy form.
    modes : (k, n, 3) array [m]
    held : sequence of str
        Groups that tools hold, in addition to the supports.

    Returns
    -------
    (k (k + 1) / 2, n, 3) array [m]

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> modes, _ = pt.vibration_modes(bar, 3)
    >>> pt.modal_derivatives(bar, modes).shape
    (6, 112, 3)
    """
    solid = energy_solid(body)
    return _derivatives(solid, rest_statics(solid, held), modes)


def _derivatives(body: NodalModel, statics: RestStatics, modes: Floats) -> Floats:
    pairs, force = [], partial(body.force, work=body.workspace())
    shapes = DIFFERENCE_STEP * body.cloud.spacing * modes / np.linalg.norm(modes, axis=2).max(axis=1)[:, None, None]
    for i, one in enumerate(shapes):
        for two in shapes[i:]:
            second_difference = force(one + two) - force(one - two) - force(two - one) + force(-one - two)
            field = statics.free @ statics.solve(
                statics.free.T @ (second_difference * body.volumes[:, None]).reshape(-1)
            )
            pairs.append(field.reshape(-1, 3) / np.linalg.norm(field.reshape(-1, 3), axis=1).max())
    return np.array(pairs)
