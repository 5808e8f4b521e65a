"""Linear model: a linear reduction of a body with the contract of any other model.

Its step is exact for forces that are linear within a step: x1 = E x0 + G0 f0 + G1 f1 with
E = exp(A dt), for any step and pole. A tool's coordinates are also linear within a step, so its
acceleration is an impulse at the times of the steps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.compiled.jit import kernel_njit
from palpate.core.arrays import Floats
from palpate.core.describe import Fact
from palpate.core.faults import InputError, number_in_range
from palpate.dynamics.loads.prepared import Load, PreparedLoads
from palpate.dynamics.run.model import Outputs, State, StepReport
from palpate.dynamics.run.reactions import NodalFields, nodal_outputs
from palpate.reduction.basis.coordinates import CoordinateModel
from palpate.reduction.lti.inputs import (
    linear_loads,
    prepare_linear_loads,
    tool_accelerations,
    tool_coordinates,
)
from palpate.reduction.lti.state_space import FirstOrder, Reduced, first_order_hold
from palpate.reduction.lti.stiffness import linear_stress
from palpate.reduction.lti.system import LinearSystem, force_inputs


class LinearModel(CoordinateModel):
    """A linear reduction of a body.

    Made by `palpate.lti.reduce_linear` or `palpate.lti.from_pymor`. It supports the loads of its
    system, by kind and group, with any values in time, and small displacements from rest.

    Parameters
    ----------
    system : LinearSystem
        Linearised at rest.
    reduced : SecondOrder or FirstOrder
    report : mapping
        Measurements of the reduction.

    Attributes
    ----------
    count : int
        Number of coordinates k, without those of the tools.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> pull = pt.SurfaceForce("x+", force=lambda t: (20 * t, 0, 0))
    >>> system = pt.lti.linearise(bar, [pull], outputs=["x+"])
    >>> model = pt.lti.reduce_linear(system, "modal", 6)
    >>> run = pt.rollout(model, [pull], duration=0.03, every=0.01)
    >>> run.model
    'linear'
    >>> model.poles.shape
    (12,)
    """

    name = "linear"
    _public = (
        "count", "frequency_response", "poles", "reduced", "report", "responses", "stable", "system",
    )  # fmt: skip
    min_steps_per_frame = 20

    def __init__(self, system: LinearSystem, reduced: Reduced, report: Mapping[str, Any] | None = None) -> None:
        if system.at.any():
            raise InputError("system must be linearised at rest, got another state; linearise without state")
        self.system, self.reduced, self.report = system, reduced, dict(report or {})
        full = system.model
        self.full, self.cloud, self.material, self.supports = full, full.cloud, full.material, full.supports
        self.conservative = full.conservative
        self.stiffness_damping, self.mass_damping = full.stiffness_damping, full.mass_damping
        self.volumes = full.volumes
        self.count, self.lifting_count = len(reduced.fields), len(system.lifting)
        self.columns = np.concatenate([reduced.fields, system.lifting])
        self.A, self.B, self.C, self.D = (np.ascontiguousarray(matrix) for matrix in reduced.state_space())
        flat = self.columns.reshape(len(self.columns), -1)
        self._lost = full.stiffness_damping * (flat @ (system.whole @ flat.T))
        self._lost += full.mass_damping * ((flat * np.repeat(full.masses, 3)) @ flat.T)
        forces = force_inputs(full, full.prepare(system.loads), np.repeat(full.masses, 3))[0]
        self._moved = forces @ flat.T  # displacements along the forces for unit coordinates
        self._steps: dict[float, tuple[Floats, ...]] = {}

    def _own_facts(self) -> list[Fact]:
        return [
            ("coordinates", self.count, ""),
            ("method", self.report.get("method"), ""),
            ("status", "stable" if self.stable else "not stable", ""),
            ("inputs", len(self.system.inputs), ""),
            ("outputs", len(self.system.outputs), ""),
            ("bound of the response", self.report.get("bound"), ""),
        ]

    @property
    def poles(self) -> NDArray[np.complex128]:
        """Poles [1/s]; all have negative real parts if the model is stable."""
        return self.reduced.poles()

    @property
    def stable(self) -> bool:
        """Whether all poles have negative real parts."""
        return bool(self.poles.real.max() < 0)

    def frequency_response(self, frequencies: Any) -> NDArray[np.complex128]:
        """Return the transfer function at circular frequencies (t,) [rad/s], as `LinearSystem.frequency_response`."""
        return self.reduced.transfer(1j * np.atleast_1d(np.asarray(frequencies, dtype=float)))

    # loads

    def prepare(self, loads: Load | Sequence[Load]) -> PreparedLoads:
        return prepare_linear_loads(self.system, loads)

    # stepping

    def state(
        self,
        prepared: PreparedLoads,
        displacement: Floats | None = None,
        velocity: Floats | None = None,
        time: float = 0.0,
    ) -> State:
        nodal = self.full.state(prepared, displacement, velocity, time)
        now = np.array([time])
        tools = tool_coordinates(self.system, prepared, now)[0]
        rates = tools
        if self.lifting_count:
            rates = prepared.rates(lambda times: tool_coordinates(self.system, prepared, times), time)[0]
        coordinates: Floats = np.zeros((2, self.count))
        if isinstance(self.reduced, FirstOrder):
            if any(field is not None and np.any(field) for field in (displacement, velocity)):
                raise InputError(
                    "displacement and velocity must be zero for a first-order linear model, which starts at rest"
                )
            forces = self.system.forces
            coordinates[0] = self.B[:, forces:] @ rates  # a tool with a velocity starts by an impulse
            coordinates[1] = self.A @ coordinates[0] + self.B[:, :forces] @ linear_loads(prepared).inputs(now)[0]
        else:
            begun = np.stack([nodal.coordinates.ravel(), nodal.velocities.ravel()])
            begun -= np.stack([tools, rates]) @ self.system.lifts
            self.full.constrain(prepared.constraint_mask(time))(begun.reshape(2, -1, 3))
            flat = self.reduced.fields.reshape(self.count, -1)
            weighted = flat * np.repeat(self.full.weights * self.material.density, 3)
            coordinates = np.asarray(np.linalg.solve(weighted @ flat.T, weighted @ begun.T).T, dtype=float)
        return State(np.concatenate([coordinates[0], tools]), np.concatenate([coordinates[1], rates]), time)

    def stable_step(self, state: State, prepared: PreparedLoads, work: None = None) -> tuple[float, State]:
        """Return infinity: the step is exact, and a run takes the steps of `longest_step`."""
        return np.inf, state

    def _propagator(self, step: float) -> tuple[Floats, ...]:
        """Return E, G0 and G1 of a step for the inputs other than tools, and the impulse matrix of the tools."""
        known = self._steps.get(step)
        if known is None:
            if len(self._steps) > 16:
                self._steps.clear()
            forces = self.system.forces
            hold = first_order_hold(self.A, self.B[:, :forces], step)
            self._steps[step] = known = tuple(np.ascontiguousarray(m) for m in (*hold, self.B[:, forces:]))
        return known

    def advance(
        self, state: State, prepared: PreparedLoads, step: float, steps: int, work: None = None
    ) -> tuple[State, StepReport]:
        number_in_range("step", step, 0.0, open_low=True, unit="s")
        times: Floats = state.time + step * np.arange(-1.0, steps + 2)
        f = np.ascontiguousarray(linear_loads(prepared).inputs(times[1:-1]))
        g = np.ascontiguousarray(tool_coordinates(self.system, prepared, times))
        speeds = (g[2:] - g[:-2]) / (2 * step)
        kicks = np.ascontiguousarray((g[2:] - 2 * g[1:-1] + g[:-2]) / step + step * self.mass_damping * speeds)
        x = self.reduced.packed(state.coordinates[: self.count], state.velocities[: self.count])
        history = np.zeros((steps + 1, len(x)))
        propagate(x, *self._propagator(step), f, kicks, history)
        rates = self.reduced.rates(history, np.hstack([f, self.mass_damping * speeds]))
        c = history[:, : self.count]
        all_c, all_v = np.hstack([c, g[1:-1]]), np.hstack([rates, speeds])
        done = self._work(all_c, f, history, (g[1:-1], speeds, kicks / step))
        power = np.einsum("ti,ij,tj->t", all_v, self._lost, all_v)
        lost = step * float(power.sum() - 0.5 * (power[0] + power[-1]))
        external, dissipated = state.external_work + done, state.dissipated + lost
        new = State(all_c[-1].copy(), all_v[-1].copy(), float(times[-2]), external, dissipated)
        return new, StepReport(done, lost)

    def _work(self, c: Floats, f: Floats, history: Floats, tools: tuple[Floats, Floats, Floats]) -> float:
        """Return the work [J] of loads and tools over some times, by the trapezium rule."""
        done = float(np.sum(0.5 * (f[1:] + f[:-1]) * np.diff(c @ self._moved.T, axis=0)))
        if self.lifting_count:
            g, speeds, bends = tools
            pulled = self._tool_forces(history, f, g, speeds, bends)
            done += float(np.sum(0.5 * (pulled[1:] + pulled[:-1]) * np.diff(g, axis=0)))
        return done

    def _tool_forces(self, x: Floats, f: Floats, g: Floats, speeds: Floats, bends: Floats) -> Floats:
        """Return forces (t, l) [N], [N m] of the tools on the body, conjugate to their coordinates."""
        rows, system = slice(len(self.C) - self.lifting_count, None), self.system
        inputs = np.hstack([f, bends])
        return np.asarray(
            x @ self.C[rows].T
            + inputs @ self.D[rows].T
            + g @ system.static[rows].T
            + speeds @ system.static_rate[rows].T
        )

    def responses(self, state: State, prepared: PreparedLoads) -> Floats:
        """Return the outputs y (q,) of the system at a state, as `LinearSystem.outputs` names them."""
        f = linear_loads(prepared).inputs(np.array([state.time]))[0]
        bends = tool_accelerations(self.system, prepared, state.time)
        g, rates = state.coordinates[self.count :], state.velocities[self.count :]
        x = self.reduced.packed(state.coordinates[: self.count], state.velocities[: self.count])
        y = self.C @ x + self.D @ np.concatenate([f, bends + self.mass_damping * rates])
        return np.asarray(y + self.system.static @ g + self.system.static_rate @ rates)

    # results of a state

    @property
    def quantities(self) -> tuple[str, ...]:
        return self.full.quantities

    def cauchy_stress(self, displacements: Floats) -> Floats:
        return self.full.cauchy_stress(displacements)

    def outputs(self, state: State, prepared: PreparedLoads, work: None = None) -> Outputs:
        u, v = self.displacement(state, prepared), self.velocity(state, prepared)
        damped, nodal = u + self.stiffness_damping * v, self.system.whole
        acceleration = np.tensordot(self._accelerations(state, prepared), self.columns, 1)
        unbalanced = self.masses[:, None] * (acceleration + self.mass_damping * v)
        unbalanced -= self.full.external_force(State(u, v, state.time), prepared)
        fields = self.full.with_internal_forces(
            NodalFields(u, v, unbalanced, None),
            lambda: -(nodal @ damped.ravel()).reshape(-1, 3),
            partial(linear_stress, self.full, damped),
        )
        strain_energy = float(0.5 * u.ravel() @ (nodal @ u.ravel()))
        return nodal_outputs(self.full, fields, state, prepared, strain_energy)

    def _accelerations(self, state: State, prepared: PreparedLoads) -> Floats:
        """Return the accelerations (k + l,) of the coordinates and of the tools."""
        inputs = linear_loads(prepared).inputs
        bends = tool_accelerations(self.system, prepared, state.time)
        now = inputs(np.array([state.time]))[0]
        slope = np.zeros_like(now)
        if isinstance(self.reduced, FirstOrder):
            slope = prepared.rates(inputs, state.time)[0]
        motion = state.coordinates[: self.count], state.velocities[: self.count]
        damped_inputs = np.concatenate([now, bends + self.mass_damping * state.velocities[self.count :]])
        rates = self.reduced.accelerations(*motion, damped_inputs, np.concatenate([slope, self.mass_damping * bends]))
        return np.concatenate([rates, bends])


@kernel_njit(allocates=True, fastmath={"contract", "reassoc"})
def propagate(x, E, G0, G1, impulse, f, kicks, history):
    """Advance x (N,) in place by t - 1 steps with inputs f (t, p), and write the states (t, N).

    Impulses `kicks` (t, l) act half before and half after the states that are written.
    """
    n = x.shape[0]
    new = np.empty(n)
    history[0] = x
    for s in range(f.shape[0] - 1):
        for i in range(n):
            for j in range(kicks.shape[1]):
                x[i] += 0.5 * impulse[i, j] * kicks[s, j]
        for i in range(n):
            value = 0.0
            for j in range(n):
                value += E[i, j] * x[j]
            for j in range(f.shape[1]):
                value += G0[i, j] * f[s, j] + G1[i, j] * f[s + 1, j]
            for j in range(kicks.shape[1]):
                value += 0.5 * impulse[i, j] * kicks[s + 1, j]
            new[i] = value
        for i in range(n):
            x[i] = new[i]
        history[s + 1] = x
