"""Linear model: a linear reduction of a body with the contract of any other model.

Its step is exact for forces that are linear within a step: x1 = E x0 + G0 f0 + G1 f1 with
E = exp(A dt), for any step and pole. A tool's coordinates are also linear within a step, so its
acceleration is an impulse at the times of the steps.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from palpate.arrays import Floats
from palpate.describe import Fact
from palpate.dynamics.compiled.cache import kernel_njit
from palpate.dynamics.contact.tools import Grasp
from palpate.dynamics.loads.body_force import Gravity
from palpate.dynamics.loads.dead_load import DeadLoad
from palpate.dynamics.loads.prepared import Load, PreparedLoads, check_kinds, is_pressure
from palpate.dynamics.loads.prescribed_motion import PrescribedMotion
from palpate.dynamics.run.model import Model, Nodes, Outputs, State, StepReport
from palpate.dynamics.run.reactions import NodalFields, nodal_outputs
from palpate.faults import InputError, number_in_range
from palpate.reduction.lti.state_space import FirstOrder, Reduced, SecondOrder, first_order_hold
from palpate.reduction.lti.system import LinearSystem, force_inputs

__all__ = ["LinearModel"]


KINDS = (DeadLoad, Gravity, PrescribedMotion, Grasp)  # of loads that are inputs
RIGID_TOLERANCE = 1e-2  # largest error of a tool's motion in small translations and rotations, relative
DIFFERENCE_STEP = 1e-4  # displacements for difference quotients of the stress, in spacings


@dataclass(frozen=True)
class _Inputs:
    """Loads as inputs of the system."""

    prepared: PreparedLoads
    forces: tuple[tuple[int, slice], ...]  # force groups of the schedule, and their inputs
    gravity: slice | None

    def at(self, times: Floats, count: int) -> Floats:
        """Return the inputs (t, count) of loads other than tools at some times [s]."""
        schedule, values = self.prepared.schedule(times), np.zeros((len(times), count))
        for group, own in self.forces:
            values[:, own] += schedule.amplitudes[:, group, : own.stop - own.start]
        if self.gravity is not None:
            values[:, self.gravity] += schedule.gravity
        return values


def _input(load: DeadLoad) -> tuple[str, str, tuple[str, ...]]:
    """Return kind, group and amplitudes of a load, which identify it as an input."""
    return type(load).__name__, load.group, load.labels


class LinearModel(Model):
    """A linear reduction of a body.

    Made by `palpate.lti.reduce_linear`. It supports the loads of its system, by kind and group,
    with any values in time, and small displacements from rest.

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
    """

    name = "linear"
    min_steps_per_frame = 20

    def __init__(self, system: LinearSystem, reduced: Reduced, report: Mapping[str, Any] | None = None) -> None:
        if system.at.any():
            raise InputError("system must be linearised at rest, got another state; linearise without state")
        self.system, self.reduced, self.report = system, reduced, dict(report or {})
        full = system.model
        self.full, self.cloud, self.material, self.supports = full, full.cloud, full.material, full.supports
        self.conservative, self.stiffness_damping = full.conservative, full.stiffness_damping
        self.volumes = full.volumes
        self.count, self.lifting_count = len(reduced.fields), len(system.lifting)
        self.columns = np.concatenate([reduced.fields, system.lifting])
        self.A, self.B, self.C, self.D = (np.ascontiguousarray(matrix) for matrix in reduced.state_space())
        flat = self.columns.reshape(len(self.columns), -1)
        self._lost = full.stiffness_damping * (flat @ (system.whole @ flat.T))
        self._moved = self._force_columns() @ flat.T  # displacements along the forces for unit coordinates
        self._steps: dict[float, tuple[Floats, ...]] = {}

    def _own_facts(self) -> list[Fact]:
        return [
            ("coordinates", self.count, ""),
            ("method", self.report.get("method"), ""),
            ("verdict", "stable" if self.stable else "not stable", ""),
            ("inputs", len(self.system.inputs), ""),
            ("outputs", len(self.system.outputs), ""),
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

    def prepare(self, loads: Sequence[Load]) -> PreparedLoads:
        """Check and prepare loads.

        Raises
        ------
        InputError
            The system does not include one of the loads, or its tools differ.
        """
        check_kinds(loads, KINDS, "loads of a linear model")
        ready = self.full.prepare(loads)
        known = {_input(load) for load in self.system.loads if isinstance(load, DeadLoad)}
        weight = any(isinstance(load, Gravity) for load in self.system.loads)
        for load in ready.loads:
            if isinstance(load, DeadLoad) and (is_pressure(load) or _input(load) not in known):
                listed = ", ".join(f"{name} on {group!r}" for name, group, _ in sorted(known)) or "no dead load"
                raise InputError(f"loads must be those of the linear system ({listed}), got {load!r:.200}")
            if isinstance(load, Gravity) and not weight:
                raise InputError("loads must not include Gravity for a system without it; linearise with Gravity")
        names = {name: nodes for name, nodes in ready.supports.items() if name not in self.fixed}
        own = self.full.prepare(self.system.loads)
        wanted = {name: nodes for name, nodes in own.supports.items() if name not in self.fixed}
        same = names.keys() == wanted.keys() and all(np.array_equal(names[name], wanted[name]) for name in wanted)
        if not same or any(motion.until < np.inf for motion, _ in ready.motions):
            raise InputError(
                f"loads must prescribe {sorted(wanted) or 'no group'} without release, as in the linear system, "
                f"got {sorted(names) or 'none'}"
            )
        return ready

    def _inputs(self, prepared: PreparedLoads) -> _Inputs:
        known = prepared.derived.get(id(self))
        if known is None:  # it keeps the model, whose id no other object has then
            of, place, gravity = {}, 0, None
            for load in self.system.loads:
                if isinstance(load, DeadLoad):
                    of[_input(load)] = slice(place, place + len(load.labels))
                    place += len(load.labels)
                elif isinstance(load, Gravity):
                    gravity, place = slice(place, place + 3), place + 3
            inputs = tuple((g, of[_input(load)]) for g, load in enumerate(prepared.dead_loads))
            prepared.derived[id(self)] = known = (self, _Inputs(prepared, inputs, gravity))
        return cast(_Inputs, known[1])

    def tool_coordinates(self, prepared: PreparedLoads, times: Floats) -> Floats:
        """Return the coordinates (t, l) of the tools at some times [s]: translations [m], small rotations [rad].

        Raises
        ------
        InputError
            The motion is not rigid, or its rotation is too large.
        """
        if not self.lifting_count:
            return np.zeros((len(times), 0))
        prescribed = prepared.sites.prescribed
        motion = prepared.schedule(times).motion.reshape(len(times), -1)
        span = self.system.lifting[:, prescribed].reshape(self.lifting_count, -1)
        coordinates = np.linalg.lstsq(span.T, motion.T, rcond=None)[0].T
        missed = np.abs(coordinates @ span - motion).max()
        if missed > RIGID_TOLERANCE * max(float(np.abs(motion).max()), 1e-3 * self.cloud.spacing):
            raise InputError(
                f"motion of the tool must be small and rigid, got an error of {missed:.3g} m at t = {times[0]:.4g} s"
            )
        return np.asarray(coordinates)

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
        tools = self.tool_coordinates(prepared, now)[0]
        rates = tools
        if self.lifting_count:
            rates = prepared.rates(lambda times: self.tool_coordinates(prepared, times), time)[0]
        own: Floats = np.zeros((2, self.count))
        if isinstance(self.reduced, FirstOrder):
            if any(given is not None and np.any(given) for given in (displacement, velocity)):
                raise InputError(
                    "displacement and velocity must be zero for a first-order linear model, which starts at rest"
                )
            own[1] = self.B[:, : self.system.forces] @ self._inputs(prepared).at(now, self.system.forces)[0]
        else:
            begun = np.stack([nodal.coordinates.ravel(), nodal.velocities.ravel()])
            begun -= np.stack([tools, rates]) @ self.system.lifts
            self.full.constrain(prepared.constraint_mask(time))(begun.reshape(2, -1, 3))
            flat = self.reduced.fields.reshape(self.count, -1)
            weighted = flat * np.repeat(self.full.weights * self.material.density, 3)
            own = np.asarray(np.linalg.solve(weighted @ flat.T, weighted @ begun.T).T, dtype=float)
        return State(np.concatenate([own[0], tools]), np.concatenate([own[1], rates]), time)

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
            own = first_order_hold(self.A, self.B[:, :forces], step)
            self._steps[step] = known = tuple(np.ascontiguousarray(m) for m in (*own, self.B[:, forces:]))
        return known

    def _packed(self, state: State) -> Floats:
        """Return the state x of the first-order equations."""
        if isinstance(self.reduced, SecondOrder):
            return np.concatenate([state.coordinates[: self.count], state.velocities[: self.count]])
        return state.coordinates[: self.count].copy()

    def advance(
        self, state: State, prepared: PreparedLoads, step: float, steps: int, work: None = None
    ) -> tuple[State, StepReport]:
        number_in_range("step", step, 0.0, open_low=True, unit="s")
        times: Floats = state.time + step * np.arange(-1.0, steps + 2)
        f = np.ascontiguousarray(self._inputs(prepared).at(times[1:-1], self.system.forces))
        g = np.ascontiguousarray(self.tool_coordinates(prepared, times))
        kicks = np.ascontiguousarray((g[2:] - 2 * g[1:-1] + g[:-2]) / step)
        x = self._packed(state)
        history = np.zeros((steps + 1, len(x)))
        propagate(x, *self._propagator(step), f, kicks, history)
        rates = self._rates(history, f)
        c, speeds = history[:, : self.count], (g[2:] - g[:-2]) / (2 * step)
        all_c, all_v = np.hstack([c, g[1:-1]]), np.hstack([rates, speeds])
        done = self._work(all_c, f, history, (g[1:-1], speeds, kicks / step))
        power = np.einsum("ti,ij,tj->t", all_v, self._lost, all_v)
        lost = step * float(power.sum() - 0.5 * (power[0] + power[-1]))
        external, dissipated = state.external_work + done, state.dissipated + lost
        new = State(all_c[-1].copy(), all_v[-1].copy(), float(times[-2]), external, dissipated)
        return new, StepReport(done, lost)

    def _rates(self, history: Floats, f: Floats) -> Floats:
        """Return rates (t, k) of the coordinates for states (t, N) and inputs other than tools."""
        if isinstance(self.reduced, SecondOrder):
            return history[:, self.count :]
        return np.asarray(history @ self.A.T + f @ self.B[:, : self.system.forces].T)

    def _work(self, c: Floats, f: Floats, history: Floats, tools: tuple[Floats, Floats, Floats]) -> float:
        """Return the work [J] of loads and tools over some times, by the trapezium rule."""
        done = float(np.sum(0.5 * (f[1:] + f[:-1]) * np.diff(c @ self._moved.T, axis=0)))
        if self.lifting_count:
            g, speeds, bends = tools
            pulled = self._tool_forces(history, f, g, speeds, bends)
            done += float(np.sum(0.5 * (pulled[1:] + pulled[:-1]) * np.diff(g, axis=0)))
        return done

    def _force_columns(self) -> Floats:
        """Return the nodal forces (forces, 3 n) of the inputs other than tools, including those at fixed nodes."""
        model = self.full
        return force_inputs(model, model.prepare(self.system.loads), np.repeat(model.masses, 3))[0]

    def _tool_forces(self, x: Floats, f: Floats, g: Floats, speeds: Floats, bends: Floats) -> Floats:
        """Return forces (t, l) [N], [N m] of the tools on the body, conjugate to their coordinates."""
        own, system = slice(len(self.C) - self.lifting_count, None), self.system
        inputs = np.hstack([f, bends])
        return np.asarray(
            x @ self.C[own].T + inputs @ self.D[own].T + g @ system.static[own].T + speeds @ system.static_rate[own].T
        )

    def responses(self, state: State, prepared: PreparedLoads) -> Floats:
        """Return the outputs y (q,) of the system at a state, as `LinearSystem.outputs` names them."""
        f = self._inputs(prepared).at(np.array([state.time]), self.system.forces)[0]
        bends = self._bends(state, prepared)
        g, rates = state.coordinates[self.count :], state.velocities[self.count :]
        y = self.C @ self._packed(state) + self.D @ np.concatenate([f, bends])
        return np.asarray(y + self.system.static @ g + self.system.static_rate @ rates)

    def _bends(self, state: State, prepared: PreparedLoads) -> Floats:
        """Return the accelerations (l,) of the tools."""
        if not self.lifting_count:
            return np.zeros(0)
        return prepared.rates(lambda times: self.tool_coordinates(prepared, times), state.time)[1]

    # results of a state

    def displacement(self, state: State, prepared: PreparedLoads, nodes: Nodes = slice(None)) -> Floats:
        """Return the displacements [m] of some nodes."""
        return np.tensordot(state.coordinates, self.columns[:, nodes], 1)

    def velocity(self, state: State, prepared: PreparedLoads, nodes: Nodes = slice(None)) -> Floats:
        """Return the velocities [m/s] of some nodes."""
        return np.tensordot(state.velocities, self.columns[:, nodes], 1)

    def outputs(self, state: State, prepared: PreparedLoads, work: None = None) -> Outputs:
        u, v = self.displacement(state, prepared), self.velocity(state, prepared)
        damped, whole = u + self.stiffness_damping * v, self.system.whole
        acceleration = np.tensordot(self._accelerations(state, prepared), self.columns, 1)
        unbalanced = self.masses[:, None] * acceleration
        unbalanced -= self.full.external_force(State(u, v, state.time), prepared)
        stress = None
        if self.conservative:
            unbalanced += self.full.without_images((whole @ damped.ravel()).reshape(-1, 3))
        else:
            stress = partial(self.linear_stress, damped)
        strain_energy = float(0.5 * u.ravel() @ (whole @ u.ravel()))
        return nodal_outputs(self.full, NodalFields(u, v, unbalanced, stress), state, prepared, strain_energy)

    def _accelerations(self, state: State, prepared: PreparedLoads) -> Floats:
        """Return the accelerations (k + l,) of the coordinates and of the tools."""
        inputs, forces = self._inputs(prepared), self.system.forces
        bends = self._bends(state, prepared)
        if isinstance(self.reduced, SecondOrder):
            f = np.concatenate([inputs.at(np.array([state.time]), forces)[0], bends])
            own = (self.A @ self._packed(state) + self.B @ f)[self.count :]
        else:
            slope = prepared.rates(lambda times: inputs.at(times, forces), state.time)[0]
            own = self.A @ state.velocities[: self.count] + self.B[:, :forces] @ slope
        return np.concatenate([own, bends])

    def linear_stress(self, displacements: Floats) -> Floats:
        """Return the linearised stress [Pa] of displacements (n, 3) of the full model, by central differences."""
        largest = float(np.abs(displacements).max())
        if largest == 0:
            return self.full.stress(displacements)
        scale = DIFFERENCE_STEP * self.cloud.spacing / largest
        return (self.full.stress(scale * displacements) - self.full.stress(-scale * displacements)) / (2 * scale)


@kernel_njit(fastmath={"contract", "reassoc"})
def propagate(x, E, G0, G1, impulse, f, kicks, history):  # type: ignore[no-untyped-def]
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
