"""Real-time linear models for `palpate.Engine`: one compiled period, exact for a tool of constant velocity.

The change of the tool's speed at the start of a period is an impulse. Mass damping adds a constant
input, alpha times the speed; x minus the state of that input in equilibrium then moves freely. Forces
are means over the period, from the mean state A^-1 (x1 - x0) / T of the free motion.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from palpate.compiled.jit import kernel_njit
from palpate.core.arrays import Floats
from palpate.core.describe import Fact, described_tuple
from palpate.core.faults import InputError, number_in_range
from palpate.dynamics.loads.supports import PRESCRIBED
from palpate.dynamics.material.relaxation import copy_values
from palpate.dynamics.run.period_report import FORCES, KINETIC, STATUS, STEPS, STRAIN, TRUST
from palpate.reduction.lti.model import LinearModel
from palpate.reduction.lti.state_space import SecondOrder, first_order_hold

TRUSTED_NONLINEARITY = 0.1  # relative difference of the tool's force from the linear one at an error indicator of 1
RANGE_BISECTIONS, MAX_RANGE = 24, 64.0  # of the search for that range; its upper end, in spacings or radians
SERIES_NORM, SERIES_TERMS = 0.5, 14  # largest norm for the series of a matrix exponential, and number of terms


class FreeMotion(NamedTuple):
    """Exact step of the free motion: exp(A T), computed again when the period changes."""

    # matrix, sizes: (N, N), (N,) arrays: A for scaled states, and the scales
    matrix: Floats
    sizes: Floats
    step: Floats  # (N, N) array: exp(A T) of the last period
    asked: Floats  # (1,) array [s]: the period of `step`
    scratch: Floats  # (4, N, N) array


class ToolForce(NamedTuple):
    """Maps to the forces (l,) of the tool."""

    mean_force: Floats  # (l, N) array: map from changes of the state over a period to forces times the period
    # static, static_rate, inertia: (l, l) arrays: of coordinates, their rates and accelerations
    static: Floats
    static_rate: Floats
    inertia: Floats


class LinearData(NamedTuple):
    """Constants and work arrays of the compiled period."""

    modes: int  # number of coordinates without those of the tool
    second: bool  # True if the state includes their rates
    motion: FreeMotion
    tool: ToolForce
    impulse: Floats  # (N, l) array
    drag: Floats  # (N, l) array: minus the equilibrium states for unit speeds of the tool, by mass damping
    # mass, elastic: (m, m) arrays: mass and stiffness matrix
    mass: Floats
    elastic: Floats
    linear_range: Floats  # (l,) array: of the tool's coordinates, [m] and [rad], where the error indicator is 1
    vectors: Floats  # (3, max(N, m)) array


@described_tuple
class LinearRealtime(NamedTuple):
    """Linear model for the engine.

    Parameters
    ----------
    advance, stiffness : functions
        Compiled; see `palpate.realtime.contract`.
    data : LinearData
    rest : (m,) array
        Coordinates at rest.
    tool : (l, 12) array
        Map from a rigid pose to the tool coordinates.
    force_bound : None
        The bound of the force's error is unknown.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> tool = pt.PrescribedMotion("x+", (0, 0, 0))
    >>> system = pt.lti.linearise(bar, [tool])
    >>> model = pt.realtime_model(pt.lti.reduce_linear(system, "modal", 4))
    >>> isinstance(model, pt.typing.LinearRealtime)
    True
    """

    advance: Any
    stiffness: Any
    data: LinearData
    rest: Floats
    tool: Floats
    force_bound: None = None

    def _facts(self) -> list[Fact]:
        return [
            ("coordinates", len(self.rest), ""),
            ("tool coordinates", len(self.tool), ""),
            ("bound of the force's error", "not known", ""),
        ]


def linear_realtime(model: LinearModel, period: float) -> LinearRealtime:
    """Return a linear model for `palpate.Engine`, with the one tool of its system.

    The first step with another period than this one [s] computes a matrix exponential.
    """
    number_in_range("period", period, 0.0, open_low=True, unit="s")
    system, count, lifting_count = model.system, model.count, model.lifting_count
    tools = {name.split(", ")[0] for name in system.inputs[system.forces :]}
    if len(tools) != 1 or system.forces:
        raise InputError(
            "system must have one tool and no other load for the engine, got "
            f"{', '.join(dict.fromkeys(name.rsplit(' ', 1)[0] for name in system.inputs))}; "
            "linearise with one PrescribedMotion or Grasp only"
        )
    flat, full = model.columns.reshape(len(model.columns), -1), model.full
    weight, states = np.repeat(full.weights * full.material.density, 3), len(model.A)
    sizes = np.ones(states)
    if isinstance(model.reduced, SecondOrder):
        sizes[count:] = np.abs(np.linalg.eigvals(model.A)).max()
    tool_rows = slice(len(model.C) - lifting_count, None)
    mean_force = np.array(np.linalg.solve(model.A.T, model.C[tool_rows].T).T, dtype=float, order="C")
    drag = np.array(model.mass_damping * np.linalg.solve(model.A, model.B), dtype=float, order="C")
    data = LinearData(
        modes=count,
        second=isinstance(model.reduced, SecondOrder),
        motion=FreeMotion(
            matrix=model.A * sizes / sizes[:, None],
            sizes=sizes,
            step=np.ascontiguousarray(first_order_hold(model.A, model.B[:, :0], period)[0]),
            asked=np.array([period]),
            scratch=np.zeros((4, states, states)),
        ),
        tool=ToolForce(
            mean_force=mean_force,
            static=system.static[tool_rows].copy(),
            static_rate=system.static_rate[tool_rows]
            + model.mass_damping * model.D[tool_rows]
            - model.C[tool_rows] @ drag,
            inertia=model.D[tool_rows].copy(),
        ),
        impulse=model.B.copy(),
        drag=drag,
        mass=(flat * weight) @ flat.T,
        elastic=flat @ (system.whole @ flat.T),
        linear_range=linear_range(model),
        vectors=np.zeros((3, max(states, count + lifting_count))),
    )
    return LinearRealtime(advance, stiffness, data, np.zeros(count + lifting_count), _tool_map(system.inputs))


def _tool_map(inputs: tuple[str, ...]) -> Floats:
    """Return the map (l, 12) from a pose to small translations and rotations (`palpate.realtime.contract.Realtime`)."""
    rows = []
    for name in inputs:
        kind, axis = name.split(", ")[1].split()
        row, c = np.zeros(12), "xyz".index(axis)
        if kind == "translation":
            row[c] = 1.0
        else:
            k, m = (c + 1) % 3, (c + 2) % 3
            row[3 + 3 * m + k], row[3 + 3 * k + m] = 0.5, -0.5
        rows.append(row)
    return np.array(rows)


def linear_range(model: LinearModel) -> Floats:
    """Return the tool coordinates (l,), [m] or [rad], at which the tool's force is nonlinear by a tenth.

    They follow from the nonlinear forces of the tool's static fields L. They measure the range of
    linearity, and not an error.
    """
    system, full, ranges = model.system, model.full, []
    prescribed = np.repeat(full.prepare(system.loads).sites.kind == PRESCRIBED, 3)
    for field in system.lifting:
        rigid = np.where(prescribed, field.ravel(), 0.0)
        straight = float(rigid @ (system.whole @ field.ravel()))

        def bent(size: float, field: Floats = field, rigid: Floats = rigid, straight: float = straight) -> bool:
            worst = 0.0
            for sign in (-1.0, 1.0):
                pulled = -float(rigid @ (full.force(sign * size * field) * full.volumes[:, None]).ravel())
                worst = max(worst, abs(pulled / (sign * size * straight) - 1)) if np.isfinite(pulled) else np.inf
            return worst > TRUSTED_NONLINEARITY

        low, high = 0.0, MAX_RANGE * full.cloud.spacing / np.abs(field).max()
        for _ in range(RANGE_BISECTIONS):
            middle = 0.5 * (low + high)
            low, high = (low, middle) if bent(middle) else (middle, high)
        ranges.append(max(low, 1e-300))
    return np.array(ranges, dtype=float)


@kernel_njit(inner=True, fastmath={"contract", "reassoc"})
def _exponential(motion, period):
    """Compute exp(A T) in place by scaling and squaring of its series."""
    n, scaled = motion.matrix.shape[0], motion.scratch[0]
    norm = 0.0
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += abs(motion.matrix[i, j]) * period
        norm = max(norm, total)
    halvings = 0
    while norm > SERIES_NORM:
        norm, halvings = 0.5 * norm, halvings + 1
    result, term, product = motion.scratch[1], motion.scratch[2], motion.scratch[3]
    for i in range(n):
        for j in range(n):
            scaled[i, j] = motion.matrix[i, j] * period / 2.0**halvings
            result[i, j] = 1.0 if i == j else 0.0
            term[i, j] = result[i, j]
    for k in range(1, SERIES_TERMS):
        _multiply(term, scaled, product)
        for i in range(n):
            for j in range(n):
                term[i, j] = product[i, j] / k
                result[i, j] += term[i, j]
    for _ in range(halvings):
        _multiply(result, result, product)
        copy_values(product, result)
    for i in range(n):
        for j in range(n):
            motion.step[i, j] = result[i, j] * motion.sizes[i] / motion.sizes[j]
    motion.asked[0] = period


@kernel_njit(inner=True, fastmath={"contract"})
def _multiply(a, b, result):
    n = a.shape[0]
    for i in range(n):
        for j in range(n):
            result[i, j] = 0.0
        for k in range(n):
            value = a[i, k]
            for j in range(n):
                result[i, j] += value * b[k, j]


@kernel_njit(fastmath={"contract", "reassoc"})
def advance(data, q, v, target, period, report):
    """Advance coordinates and velocities (m,) by a period [s], with constant velocity of the tool to `target` (l,)."""
    count, m, n = data.modes, q.shape[0], data.motion.matrix.shape[0]
    before, x, new = data.vectors[0], data.vectors[1], data.vectors[2]
    report[:] = 0.0
    if period != data.motion.asked[0]:
        _exponential(data.motion, period)
    for i in range(count):
        x[i] = q[i]
        if data.second:
            x[count + i] = v[i]
    for j in range(count, m):
        speed = (target[j - count] - q[j]) / period
        before[j] = speed - v[j]
        v[j] = speed
    for i in range(n):
        for j in range(m - count):
            x[i] += data.impulse[i, j] * before[count + j] + data.drag[i, j] * v[count + j]
    good = True
    for i in range(n):
        value = 0.0
        for j in range(n):
            value += data.motion.step[i, j] * x[j]
        new[i] = value
        good = good and np.isfinite(value)
    if not good:
        report[STATUS] = 1.0
        return
    for r in range(m - count):
        force = 0.0
        for i in range(n):
            force += data.tool.mean_force[r, i] * (new[i] - x[i]) / period
        for j in range(m - count):
            way = q[count + j] + 0.5 * period * v[count + j]
            force += data.tool.static[r, j] * way + data.tool.static_rate[r, j] * v[count + j]
            force += data.tool.inertia[r, j] * before[count + j] / period
        report[FORCES + r] = force
    for i in range(count):
        if not data.second:
            v[i] = 0.0
            for j in range(n):
                v[i] += data.motion.matrix[i, j] * new[j]
    for i in range(n):
        for j in range(m - count):
            new[i] -= data.drag[i, j] * v[count + j]
    for i in range(count):
        q[i] = new[i]
        if data.second:
            v[i] = new[count + i]
    for j in range(m - count):
        q[count + j] = target[j]
        report[TRUST] = max(report[TRUST], abs(target[j]) / data.linear_range[j])
    report[STEPS] = 1.0
    for i in range(m):
        for j in range(m):
            report[KINETIC] += 0.5 * v[i] * data.mass[i, j] * v[j]
            report[STRAIN] += 0.5 * q[i] * data.elastic[i, j] * q[j]


@kernel_njit()
def stiffness(data, q, out):
    """Write the derivatives (l, l) of the tool's static forces with respect to its coordinates."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = data.tool.static[i, j]
