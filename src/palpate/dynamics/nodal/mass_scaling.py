"""More mass for the few fastest modes of a body, so that its stable step is longer.

On an irregular cloud some nodes vibrate faster than all others, and they alone set the step. With mass-normalised modes
p_k of the body at rest and their frequencies w_k, the mass

    M' = M + sum over k of ((w_k / w)^2 - 1) M p_k p_k' M

lowers these frequencies to w, and no other one. Equilibria are unchanged, and so are slow motions: accelerations are

    a = M^-1 f - sum over k of s_k p_k (p_k . f),      s_k = 1 - (w / w_k)^2,

for all forces f on the nodes (selective mass scaling, Gonzalez and Park, Int. J. Numer. Meth. Engng 121, 2020). Modes
of near frequencies at distant places mix. The same sum is that of l_j (l_j . f) with l_j = sum over k of sqrt(s_k) p_k
R_kj for any orthogonal R. That of a QR decomposition with column pivoting makes the l_j local (Damle, Lin and Ying, J.
Chem. Theory Comput. 11, 2015), and a step cheap.

The impulses of tools follow from M. What l_j take from them is subtracted with the forces of the next step. The kinetic
energy of the additional mass is not in that of the body, so a step gains no energy from it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigsh

from palpate.compiled.jit import kernel_njit
from palpate.compiled.passes import internal_force
from palpate.core.arrays import Floats, Ints
from palpate.dynamics.nodal.model import NodalModel
from palpate.dynamics.nodal.stability import highest_frequency

MIN_NODES, NODES_PER_MODE = 500, 33  # of a body that gets modes by default
MIN_DEFAULT_MODES, MAX_DEFAULT_MODES, MAX_MODES = 20, 40, 200  # by default, and by argument
VECTORS_PER_MODE, RITZ_TOLERANCE = 3, 3e-2  # of the Lanczos iteration
MIN_ENERGY = 3e-4  # of a node in a shape, over the largest; smaller parts are left out
MIN_GAIN = 1.05  # of the step; else modes are left out
PROBE = 1e-3  # displacement of difference quotients, in spacings: far above the rounding of single precision


class MassScaling(NamedTuple):
    """Modes that get more mass, as local shapes l_j."""

    start: Ints  # (k + 1,) int array: first entry of every shape in the next two arrays
    nodes: Ints  # (e,) int array
    shapes: Floats  # (e, 3) array [kg^-1/2]: l_j at their nodes
    used: NDArray[np.bool_]  # (k,) bool array: False for shapes that a cut has changed
    mixing: Floats  # (k, k) array: sqrt(s_k) R_kj
    frequencies: Floats  # (k,) array [rad/s]: w_k
    plain_frequency: float  # [rad/s]: highest frequency of the body without them
    forces: Floats  # (n, 3) array [N]: scratch array; empty without modes


def _no_modes(frequency: float) -> tuple[MassScaling, float]:
    none = np.zeros((0, 3))
    used, mixing = np.zeros(0, dtype=np.bool_), np.zeros((0, 0))
    start, nodes = np.zeros(1, dtype=np.int64), np.zeros(0, dtype=np.int64)
    return MassScaling(start, nodes, none, used, mixing, np.zeros(0), frequency, none.copy()), frequency


def default_modes(nodes: int) -> int:
    """Return the number of modes of a solid by its number of nodes; more cost about what their longer steps save."""
    return min(max(nodes // NODES_PER_MODE, MIN_DEFAULT_MODES), MAX_DEFAULT_MODES) if nodes >= MIN_NODES else 0


def scaled_mass(model: NodalModel, fixed: NDArray[np.bool_], modes: int) -> tuple[MassScaling, float]:
    """Return the modes that get more mass, and the highest frequency [rad/s] at rest with them.

    There are none if the step would be less than 5 % longer. `fixed` (n,) nodes do not move; `modes` is 0 for none.
    """
    frequency, _ = model.highest_frequency(np.zeros((len(model.cloud), 3)), fixed)
    if not modes or VECTORS_PER_MODE * (modes + 1) >= 3 * len(model.cloud):
        return _no_modes(frequency)
    constrain, acceleration = model.constrain(fixed), _acceleration_at_rest(model, fixed)
    squares, vectors = _fastest_modes(model, acceleration, constrain, modes)
    if len(squares) < 2 or not squares.min() > 0.0:
        return _no_modes(frequency)
    mass_scaling = _local_shapes(squares, vectors, model.masses[:, None], frequency)
    slowed = max(_slowed_frequency(model, mass_scaling, acceleration, constrain), float(np.sqrt(squares.min())))
    return (mass_scaling, slowed) if frequency > MIN_GAIN * slowed else _no_modes(frequency)


def _acceleration_at_rest(model: NodalModel, fixed: NDArray[np.bool_]) -> Callable[[Floats], Floats]:
    """Return the function of small displacements (n, 3) [m] that computes the accelerations of the body's steps."""
    force_of, work, constrain = internal_force(model.formulation.of_steps), model.workspace(), model.constrain(fixed)
    result = np.zeros((len(model.cloud), 3))

    def acceleration(u: Floats) -> Floats:
        force_of(u, model.tension_compression_step_body, work.step_passes, result)
        return constrain(result / model.material.density)

    return acceleration


def _fastest_modes(
    model: NodalModel, acceleration: Callable[[Floats], Floats], constrain: Callable[[Floats], Floats], modes: int
) -> tuple[Floats, Floats]:
    """Return the largest squares of frequencies [rad^2/s^2], one more than modes, and their vectors (3 n, k)."""
    amplitude, masses, size = PROBE * model.cloud.spacing, model.masses[:, None], 3 * len(model.cloud)

    def stiffness(y: Floats) -> Floats:
        moved = constrain(y.reshape(-1, 3) / np.sqrt(masses))
        factor = amplitude / max(np.abs(moved).max(), np.finfo(float).tiny)
        return np.asarray(-acceleration(factor * moved) * np.sqrt(masses) / factor).ravel()

    operator = LinearOperator((size, size), matvec=stiffness, dtype=float)
    start, vectors = np.random.default_rng(0).standard_normal(size), VECTORS_PER_MODE * (modes + 1)
    try:
        squares, shapes = eigsh(operator, k=modes + 1, which="LA", ncv=vectors, tol=RITZ_TOLERANCE, v0=start)
    except ArpackNoConvergence as error:  # with those that are found
        return error.eigenvalues, error.eigenvectors
    return squares, shapes


def _local_shapes(squares: Floats, vectors: Floats, masses: Floats, frequency: float) -> MassScaling:
    """Return the local shapes of modes (3 n, k) that get the frequency of the slowest one."""
    n, order = len(masses), np.argsort(-squares)[:-1]
    target, frequencies = np.sqrt(squares.min()), np.sqrt(squares[order])
    shares = 1.0 - (target / frequencies) ** 2
    mixed = vectors[:, order] * np.sqrt(shares)
    rotation = qr(mixed.T, mode="economic", pivoting=True)[0]
    local = (mixed @ rotation).reshape(n, 3, -1)
    energy = np.sum(local**2, axis=1)
    local *= (energy >= MIN_ENERGY * energy.max(axis=0))[:, None]
    largest = np.linalg.norm(local.reshape(3 * n, -1), 2) ** 2  # below 1, else M' would not be positive definite
    local *= np.sqrt(min(1.0, shares.max() / largest) / masses)[:, :, None]
    mode, node = np.nonzero(local.any(axis=1).T)
    return MassScaling(
        start=np.searchsorted(mode, np.arange(len(order) + 1)),
        nodes=np.ascontiguousarray(node),  # as without modes, so that both compile to the same code
        shapes=np.ascontiguousarray(local[node, :, mode]),
        used=np.ones(len(order), dtype=np.bool_),
        mixing=np.ascontiguousarray(np.sqrt(shares)[:, None] * rotation),
        frequencies=frequencies,
        plain_frequency=frequency,
        forces=np.zeros((n, 3)),
    )


def _slowed_frequency(
    model: NodalModel,
    mass_scaling: MassScaling,
    acceleration: Callable[[Floats], Floats],
    constrain: Callable[[Floats], Floats],
) -> float:
    """Return the highest frequency [rad/s] at rest with the additional mass."""
    none, density = np.zeros((len(model.cloud), 3)), model.material.density

    def scaled(u: Floats) -> Floats:
        force = acceleration(u) * density
        subtract_inertia(mass_scaling, model.volumes, density, 0.0, none, force, 0.0, none, force)
        return force

    noise = constrain(np.random.default_rng(0).standard_normal(none.shape))
    amplitude = PROBE * model.cloud.spacing
    slowed, _ = highest_frequency(scaled, none, constrain, noise, None, amplitude=amplitude, density=density)
    return slowed


def without_nodes(mass_scaling: MassScaling, nodes: NDArray[np.bool_]) -> tuple[MassScaling, float]:
    """Return the shapes without those at any of some nodes (n,), and the highest frequency [rad/s] of the modes then.

    The frequency is 0 if all shapes stay.
    """
    lost = np.array([nodes[each].any() for each in np.split(mass_scaling.nodes, mass_scaling.start[1:-1])], dtype=bool)
    used = ~lost[: len(mass_scaling.used)]
    if used.all():
        return mass_scaling._replace(used=used), 0.0
    left, frequencies = mass_scaling.mixing[:, used], mass_scaling.frequencies
    squares = frequencies[:, None] * (np.eye(len(used)) - left @ left.T) * frequencies
    return mass_scaling._replace(used=used), float(np.sqrt(np.linalg.eigvalsh(squares)[-1]))


@kernel_njit()
def subtract_inertia(mass_scaling, volumes, density, factor, other, force, rate, impulses, result):
    """Subtract from `result` (n, 3) the forces of the additional mass per nodal volume [N/m^3].

    They follow from the forces ``force + factor other`` [N/m^3] and ``rate impulses`` [N].
    """
    start, nodes, used, forces = mass_scaling.start, mass_scaling.nodes, mass_scaling.used, mass_scaling.forces
    for j in range(forces.shape[0]):
        for c in range(3):
            forces[j, c] = volumes[j] * (force[j, c] + factor * other[j, c]) + rate * impulses[j, c]
    # flat arrays and unsigned places take two thirds of the time
    flat, on, taken = mass_scaling.shapes.reshape(-1), forces.reshape(-1), result.reshape(-1)
    one, two, three = np.uint64(1), np.uint64(2), np.uint64(3)
    for k in range(used.shape[0]):
        if not used[k]:
            continue
        x, y, z = 0.0, 0.0, 0.0
        for e in range(start[k], start[k + 1]):
            at, i = three * np.uint64(e), three * np.uint64(nodes[e])
            x += flat[at] * on[i]
            y += flat[at + one] * on[i + one]
            z += flat[at + two] * on[i + two]
        total = density * (x + y + z)
        for e in range(start[k], start[k + 1]):
            at, i = three * np.uint64(e), three * np.uint64(nodes[e])
            taken[i] -= total * flat[at]
            taken[i + one] -= total * flat[at + one]
            taken[i + two] -= total * flat[at + two]
