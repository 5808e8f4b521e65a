"""The stable step, and the stiffness damping of a collocated body.

The collocated stiffness is not symmetric, so some of its eigenvalues w^2 are complex. Such a mode
grows at the rate |Im w| unless stiffness damping beta damps it, beta >= 2 |Im w| / |w|^2. On small
clouds beta follows from the dense spectrum. On large ones it follows from a power iteration on the
step map: a tiny random motion is stepped without loads, and beta is raised until nothing grows. A
negative real part of w^2 cannot be damped. It results from the cloud, and raises an error.

With damping, the step is stable up to dt = (sqrt(z^2 + 4) - z) / w with z = beta w, at the highest
frequency w. A few power iterations on the present tangent update w for the deforming body.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from palpate.core.arrays import Floats, euclidean_norm
from palpate.core.deprecation import renamed_attribute
from palpate.core.describe import Described, Fact
from palpate.core.faults import CloudError, InputError, number_in_range
from palpate.dynamics.loads.prepared import Load, PreparedLoads
from palpate.dynamics.loads.supports import SupportedNodes
from palpate.dynamics.run.model import State, StepReport
from palpate.meshfree.cloud import Cloud
from palpate.tissue.materials import Material

STEP_SAFETY = 0.85  # factor of the step: the power iteration converges from below, and the body deforms
DAMPING_SAFETY = 2.0  # factor of the damping: a body stretched four times requires 1.8 times that at rest
MAX_DENSE_NODES = 400  # largest cloud of the dense spectrum
WINDOW_STEPS, WINDOWS_PER_ROUND, MAX_ROUNDS = 100, 12, 8  # steps a window, windows a round, rounds of raising beta
MIN_GROWTH = 0.03  # logarithmic growth per window of an unstable motion
FIRST_ITERATIONS, LATER_ITERATIONS = 60, 4  # power iterations of the first estimate, and of those that follow it
START_NOISE = 0.03  # noise in the start vector, relative to its largest component
MIN_FREQUENCY, MAX_FREQUENCY = 1e-6, 1e15  # [rad/s], so that squares are in double precision


class ElasticBody(Protocol):
    """The interface of a nodal model for its stability analysis."""

    stiffness_damping: float  # [s]

    @property
    def cloud(self) -> Cloud: ...
    @property
    def material(self) -> Material: ...
    @property
    def fixed_mask(self) -> NDArray[np.bool_]: ...
    @property
    def supported(self) -> SupportedNodes: ...
    @property
    def free_directions(self) -> Any: ...
    def workspace(self) -> Any: ...
    def force(self, displacements: Floats, history: tuple[Floats, ...] = (), work: Any = None) -> Floats: ...
    def highest_frequency(
        self, displacements: Floats, constrained: NDArray[np.bool_]
    ) -> tuple[float, Floats | None]: ...
    def prepare(self, loads: Load | Sequence[Load]) -> PreparedLoads: ...
    def advance(
        self, state: State, prepared: PreparedLoads, step: float, steps: int, work: Any = None
    ) -> tuple[State, StepReport]: ...


@dataclass(frozen=True)
class StabilityReport(Described):
    """Results of a stability analysis at rest.

    Parameters
    ----------
    method : str
        ``"dense spectrum"``, ``"step map"``, ``"given"`` for a given damping, ``"energy form"``, or
        ``"taut sheet"`` of a membrane.
    worst_real_part : float or None [1/s^2]
        Least real part of the eigenvalues w^2; None without a dense spectrum.
    needed, used : float [s]
        Least stiffness damping of a stable body, and the damping in use.
    highest_frequency : float [rad/s]
    step : float [s]
        Stable step at rest, with the safety factor.
    growth : float or None [1/s]
        Remaining growth rate in the step map, with the needed damping.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> bar.stability.method, bar.stability.status
    ('energy form', 'stable at rest')
    """

    method: str
    worst_real_part: float | None
    needed: float
    used: float
    highest_frequency: float
    step: float
    growth: float | None = None

    verdict = renamed_attribute("StabilityReport", "verdict", "status")

    @property
    def status(self) -> str:
        """Whether the damping in use stops all growth at rest, as far as it was examined."""
        if np.isnan(self.needed):
            return "stability not examined"
        return "stable at rest" if self.used >= self.needed else "not stable at rest: use more damping"

    def _facts(self) -> list[Fact]:
        return [
            ("status", self.status, ""),
            ("method", self.method, ""),
            ("stiffness damping needed", self.needed, "s"),
            ("stiffness damping used", self.used, "s"),
            ("stable step", self.step, "s"),
            ("highest frequency", self.highest_frequency, "rad/s"),
        ]

    def __str__(self) -> str:
        needed = "not computed" if np.isnan(self.needed) else f"{self.needed:.3g} s"
        worst = "not computed" if self.worst_real_part is None else f"{self.worst_real_part:.4g} 1/s^2"
        lines = [
            f"stability at rest, by {self.method}",
            f"  worst real part of the spectrum  {worst}",
            f"  stiffness damping needed         {needed}",
            f"  stiffness damping used           {self.used:.3g} s",
            f"  highest frequency                {self.highest_frequency:.4g} rad/s",
            f"  stable step                      {self.step:.3g} s",
        ]
        if self.growth is not None:
            lines.insert(3, f"  growth left at that damping      {self.growth:.3g} 1/s")
        return "\n".join(lines)


def stable_step(frequency: float, stiffness_damping: float) -> float:
    """Return the stable step [s] for a highest frequency [rad/s] and a stiffness damping [s].

    It includes a safety factor, and is 0 if the product of the arguments is not finite.
    """
    z = stiffness_damping * frequency
    if not z * z < np.inf:
        return 0.0
    return float(STEP_SAFETY * (np.sqrt(z * z + 4.0) - z) / frequency)


def resting_frequency(model: ElasticBody, displacements: Floats | None = None) -> float:
    """Return the highest frequency [rad/s] of a body at rest.

    It is linearised at displacements (n, 3) [m], such as those of a taut sheet.
    """
    at = np.zeros((len(model.cloud), 3)) if displacements is None else displacements
    with np.errstate(all="ignore"):
        frequency, _ = model.highest_frequency(at, model.fixed_mask)
    if not MIN_FREQUENCY <= frequency <= MAX_FREQUENCY:
        raise InputError(
            f"the highest frequency of the body must be {MIN_FREQUENCY:g} to {MAX_FREQUENCY:g} rad/s, got "
            f"{frequency:.3g}; give its shear modulus ({model.material.shear_modulus:.3g} Pa), density "
            f"({model.material.density:.3g} kg/m^3) and spacing ({model.cloud.spacing:.3g} m) in SI units"
        )
    return frequency


def stiffness(model: ElasticBody, displacements: Floats | None = None) -> Floats:
    """Return the dense tangent -d(acceleration)/du of the free nodes [1/s^2], by central differences."""
    u = np.zeros((len(model.cloud), 3)) if displacements is None else displacements.copy()
    basis, step = model.free_directions, 1e-5 * model.cloud.spacing
    flat, size = u.reshape(-1), basis.shape[1]
    tangent, work = np.empty((size, size)), model.workspace()
    for k in range(size):
        entries = slice(basis.indptr[k], basis.indptr[k + 1])
        places, direction = basis.indices[entries], step * basis.data[entries]
        before = flat[places]
        flat[places] = before + direction
        ahead = model.force(u, work=work).reshape(-1)
        flat[places] = before - direction
        behind = model.force(u, work=work).reshape(-1)
        flat[places] = before
        tangent[:, k] = basis.T @ (behind - ahead) / (2 * step * model.material.density)
    return tangent


def spectrum(model: ElasticBody, displacements: Floats | None = None) -> NDArray[np.complex128]:
    """Return all eigenvalues w^2 [1/s^2] of the linearised body at a state; for small clouds."""
    return np.linalg.eigvals(stiffness(model, displacements)).astype(complex)


def needed_stiffness_damping(eigenvalues: NDArray[np.complex128]) -> float:
    """Return max 2 |Im w| / |w|^2 [s] over the oscillating eigenvalues w^2."""
    frequency = np.sqrt(eigenvalues)
    moving = np.abs(eigenvalues) > 1e-6 * np.abs(eigenvalues).max()  # rigid motions have w = 0
    return float(np.max(2 * np.abs(frequency.imag[moving]) / np.abs(eigenvalues[moving])))


def highest_frequency(
    force: Callable[[Floats], Floats],
    displacements: Floats,
    constrain: Callable[[Floats], Floats],
    noise: Floats,
    start: Floats | None,
    *,
    amplitude: float,
    density: float,
) -> tuple[float, Floats | None]:
    """Return the highest frequency [rad/s] of a body at displacements, by power iterations on its tangent.

    `force` returns the internal force density (n, 3) [N/m^3] of displacements (n, 3) [m], whose difference quotients
    have a displacement `amplitude` [m]. `constrain` removes the constrained parts of a field (n, 3) in place, and
    returns it. `noise` (n, 3) starts a first estimate, and is added to later ones. It lets another mode grow when the
    fastest part of the body changes. The returned vector is the `start` of the next estimate; it is None for a body
    without stiffness.
    """
    iterations = FIRST_ITERATIONS if start is None else LATER_ITERATIONS
    vector = noise if start is None else start
    rest, ratio = force(displacements), 0.0
    vector = vector / np.abs(vector).max() + START_NOISE * noise
    for _ in range(iterations):
        vector = constrain(vector.copy())
        vector *= amplitude / np.abs(vector).max()
        image = constrain((rest - force(displacements + vector)) / density)
        if not image.any():  # no stiffness, as in a slack sheet
            return 0.0, None
        ratio = euclidean_norm(image) / euclidean_norm(vector)
        vector = image
    return float(np.sqrt(ratio)), vector


def choose_stiffness_damping(model: ElasticBody, stiffness_damping: float | None, neighbours: int) -> StabilityReport:
    """Analyse a model at rest, and choose its stiffness damping unless it is given."""
    frequency = resting_frequency(model)
    if stiffness_damping is not None:
        damping = number_in_range("stiffness_damping", stiffness_damping, 0.0, unit="s")
        return StabilityReport("given", None, np.nan, damping, frequency, stable_step(frequency, damping))
    if len(model.cloud) <= MAX_DENSE_NODES:
        eigenvalues = spectrum(model)
        worst = float(eigenvalues.real.min())
        if worst < -1e-6 * np.abs(eigenvalues).max():
            raise _undamped_mode_error(model, neighbours, np.linalg.eig(stiffness(model)))
        needed = needed_stiffness_damping(eigenvalues)
        used = DAMPING_SAFETY * needed
        return StabilityReport("dense spectrum", worst, needed, used, frequency, stable_step(frequency, used))
    needed, growth = _damping_by_steps(model, neighbours, frequency)
    used = DAMPING_SAFETY * needed
    return StabilityReport("step map", None, needed, used, frequency, stable_step(frequency, used), growth)


def _undamped_mode_error(
    model: ElasticBody, neighbours: int, eigen: tuple[NDArray[np.complex128], NDArray[np.complex128]]
) -> CloudError:
    values, vectors = eigen
    shape = (model.free_directions @ vectors[:, np.argmin(values.real)]).reshape(-1, 3)
    return _cloud_error(model, neighbours, int(np.argmax(np.linalg.norm(np.abs(shape), axis=1))))


def _cloud_error(model: ElasticBody, neighbours: int, node: int) -> CloudError:
    return CloudError(
        f"the body is unstable at rest: stiffness damping cannot damp a mode at node {node}, "
        f"{model.cloud.points[node]} m. Use more neighbours (now {neighbours}), less jitter, or move that node"
    )


def _damping_by_steps(model: ElasticBody, neighbours: int, frequency: float) -> tuple[float, float]:
    """Raise beta until a tiny random motion decays; return beta and the remaining growth rate."""
    prepared, work, needed, rate = model.prepare(()), model.workspace(), 0.0, 0.0
    for _ in range(MAX_ROUNDS):
        model = copy(model)
        vars(model)["stiffness_damping"] = needed
        step = stable_step(frequency, needed)
        tiny = 1e-9 * model.cloud.spacing * np.random.default_rng(1).standard_normal((len(model.cloud), 3))
        model.supported.project(tiny)
        state, logs = State(tiny, np.zeros_like(tiny)), []
        size = euclidean_norm(model.force(state.coordinates))
        for _ in range(WINDOWS_PER_ROUND):
            state, _ = model.advance(state, prepared, step, WINDOW_STEPS, work)
            force = model.force(state.coordinates)
            logs.append(np.log(euclidean_norm(force) / size))
            scale = euclidean_norm(tiny) / max(euclidean_norm(state.coordinates), 1e-300)
            state = State(state.coordinates * scale, state.velocities * scale)
            size = euclidean_norm(force) * scale
        growth = float(np.mean(logs[-4:]))
        rate = growth / (WINDOW_STEPS * step)
        if growth < MIN_GROWTH:
            return needed, rate
        power = -np.sum(state.coordinates * model.force(state.coordinates)) / model.material.density
        stiff = power / np.sum(state.coordinates**2)
        node = int(np.argmax(np.linalg.norm(state.coordinates, axis=1)))
        if stiff <= 0 or needed * frequency > 10:
            raise _cloud_error(model, neighbours, node)
        needed = max(1.25 * needed, needed + 2 * rate / stiff)
    raise _cloud_error(model, neighbours, node)
