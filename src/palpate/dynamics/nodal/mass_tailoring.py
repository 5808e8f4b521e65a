"""More mass for the few fastest modes of a body, so that its stable step is longer.

On an irregular cloud some nodes vibrate faster than all others, and they alone set the step. With mass-normalised modes
p_k of the body at rest and their frequencies w_k, the mass

    M' = M + sum over k of ((w_k / w)^2 - 1) M p_k p_k' M

lowers these frequencies to w, and no other one. Equilibria are unchanged, and so are slow motions: accelerations are

    a = M^-1 f - sum over k of (1 - (w / w_k)^2) p_k (p_k . f)

for all forces f on the nodes (mass tailoring, Gonzalez and Park, Int. J. Numer. Meth. Engng 121, 2020). The impulses of
tools follow from M. What p_k take from them is subtracted with the forces of the next step.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh

from palpate.arrays import Floats, Ints
from palpate.dynamics.compiled.cache import kernel_njit
from palpate.dynamics.compiled.passes import internal_force
from palpate.dynamics.nodal.model import NodalModel
from palpate.dynamics.nodal.stability import highest_frequency

__all__ = [
    "DEFAULT_MODES",
    "MAX_MODES",
    "MIN_NODES",
    "MassTailoring",
    "subtract_inertia",
    "tailored_mass",
    "without_nodes",
]

DEFAULT_MODES, MIN_NODES = 20, 500  # number of modes, and least number of nodes of a body that gets them
MAX_MODES = 200
VECTORS_PER_MODE, RITZ_TOLERANCE = 3, 3e-2  # of the Lanczos iteration
LEAST_ENERGY = 1e-4  # of a node in a mode, over the largest; smaller parts are left out
LEAST_GAIN = 1.05  # of the step; else modes are left out
PROBE = 1e-3  # displacement of difference quotients, in spacings: far above the rounding of single precision


class MassTailoring(NamedTuple):
    """Modes that get more mass.

    Parameters
    ----------
    start : (k + 1,) int array
        First entry of every mode in the next two arrays.
    nodes : (e,) int array
    shapes : (e, 3) array [kg^-1/2]
        Mass-normalised modes at their nodes.
    shares : (k,) array
        1 - (w / w_k)^2.
    frequencies : (k,) array [rad/s]
        w_k.
    forces : (k,) array
        Scratch array.
    """

    start: Ints
    nodes: Ints
    shapes: Floats
    shares: Floats
    frequencies: Floats
    forces: Floats


def _no_modes() -> MassTailoring:
    none = np.zeros(0)
    return MassTailoring(np.zeros(1, np.int64), np.zeros(0, np.int64), np.zeros((0, 3)), none, none, none)


def tailored_mass(model: NodalModel, fixed: NDArray[np.bool_], modes: int) -> tuple[MassTailoring, float]:
    """Return the modes that get more mass, and the highest frequency [rad/s] at rest with them.

    There are none if the step would be less than 5 % longer.

    Parameters
    ----------
    fixed : (n,) bool array
        Nodes that do not move.
    modes : int
        Number of modes; 0 for none.
    """
    frequency, _ = model.highest_frequency(np.zeros((len(model.cloud), 3)), fixed)
    vectors, n = VECTORS_PER_MODE * (modes + 1), len(model.cloud)
    if not modes or vectors >= 3 * n:
        return _no_modes(), frequency
    force_of, work, amplitude = (
        internal_force(model.formulation.of_steps),
        model.workspace(),
        PROBE * model.cloud.spacing,
    )
    constrain, masses, result = model.constrain(fixed), model.masses[:, None], np.zeros((n, 3))

    def acceleration(u: Floats) -> Floats:
        force_of(u, model.taut_step_body, work.step_passes, result)
        return constrain(result / model.material.density)

    def stiffness(y: Floats) -> Floats:
        moved = constrain(y.reshape(n, 3) / np.sqrt(masses))
        size = amplitude / max(np.abs(moved).max(), np.finfo(float).tiny)
        return np.asarray(-acceleration(size * moved) * np.sqrt(masses) / size).ravel()

    operator = LinearOperator((3 * n, 3 * n), matvec=stiffness, dtype=float)
    start = np.random.default_rng(0).standard_normal(3 * n)
    try:
        squares, shapes = eigsh(operator, k=modes + 1, which="LA", ncv=vectors, tol=RITZ_TOLERANCE, v0=start)
    except ArpackNoConvergence as error:  # with those that are found
        squares, shapes = error.eigenvalues, error.eigenvectors
    if len(squares) < 2 or not squares.min() > 0.0:
        return _no_modes(), frequency
    target, order = np.sqrt(squares.min()), np.argsort(-squares)[:-1]  # that of the slowest one
    frequencies, shapes = np.sqrt(squares[order]), shapes[:, order]
    energy = np.sum(shapes.reshape(n, 3, -1) ** 2, axis=1)
    mode, node = np.nonzero((energy >= LEAST_ENERGY * energy.max(axis=0)).T)
    tailoring = MassTailoring(
        np.searchsorted(mode, np.arange(len(order) + 1)),
        np.ascontiguousarray(node),  # as without modes, so that both compile to the same code
        np.ascontiguousarray((shapes.reshape(n, 3, -1) / np.sqrt(masses)[:, :, None])[node, :, mode]),
        1.0 - (target / frequencies) ** 2,
        frequencies,
        np.zeros(len(order)),
    )
    none = np.zeros((n, 3))

    def tailored(u: Floats) -> Floats:
        force = acceleration(u) * model.material.density
        subtract_inertia(tailoring, model.volumes, model.material.density, 0.0, none, force, 0.0, none, force)
        return force

    noise = constrain(np.random.default_rng(0).standard_normal((n, 3)))
    slowed, _ = highest_frequency(
        tailored, none, constrain, noise, None, amplitude=amplitude, density=model.material.density
    )
    slowed = max(slowed, float(target))
    return (tailoring, slowed) if frequency > LEAST_GAIN * slowed else (_no_modes(), frequency)


def without_nodes(tailoring: MassTailoring, nodes: NDArray[np.bool_]) -> tuple[MassTailoring, float]:
    """Return the modes without those at any of some nodes (n,), and the highest frequency [rad/s] of the latter."""
    lost = np.array([nodes[each].any() for each in np.split(tailoring.nodes, tailoring.start[1:-1])], dtype=bool)
    lost = lost[: len(tailoring.shares)]
    left = tailoring._replace(shares=np.where(lost, 0.0, tailoring.shares))
    return left, float(tailoring.frequencies[lost].max(initial=0.0))


@kernel_njit()
def subtract_inertia(  # type: ignore[no-untyped-def]
    tailoring, volumes, density, factor, other, force, rate, impulses, result
):
    """Subtract from `result` (n, 3) the forces of the additional mass per nodal volume [N/m^3].

    They follow from the forces ``force + factor other`` [N/m^3] and ``rate impulses`` [N].
    """
    start, nodes, shapes, shares = tailoring.start, tailoring.nodes, tailoring.shapes, tailoring.shares
    for k in range(shares.shape[0]):
        total = 0.0
        if shares[k] > 0.0:
            for e in range(start[k], start[k + 1]):
                j = nodes[e]
                for c in range(3):
                    here = volumes[j] * (force[j, c] + factor * other[j, c]) + rate * impulses[j, c]
                    total += shapes[e, c] * here
        tailoring.forces[k] = shares[k] * density * total
    for k in range(shares.shape[0]):
        if tailoring.forces[k] != 0.0:
            for e in range(start[k], start[k + 1]):
                for c in range(3):
                    result[nodes[e], c] -= tailoring.forces[k] * shapes[e, c]
