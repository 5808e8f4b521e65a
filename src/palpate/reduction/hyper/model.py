"""The hyper-reduced model: an energy sampled at few nodes, in the coordinates of modes and tools.

`palpate.hyper_reduce` makes it from a full model and its runs. The result does not depend on the full
model any more. The cost of a step depends on the numbers of cubature points and coordinates, not
on the number of nodes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np

from palpate.core.arrays import Floats
from palpate.core.describe import Fact
from palpate.core.faults import InputError
from palpate.dynamics.loads.prepared import Load, PreparedLoads
from palpate.dynamics.material.relaxation import restore_history, saved_history
from palpate.dynamics.nodal.stability import stable_step
from palpate.dynamics.run.contact_state import steps_between_checks
from palpate.dynamics.run.model import QUANTITY_UNITS, Nodes, Outputs, State, StepReport, initial_field
from palpate.dynamics.run.reactions import contact_outputs
from palpate.dynamics.run.trajectory import Trajectory
from palpate.reduction.basis.coordinates import CoordinateModel
from palpate.reduction.contact.tools import ContactTools, bonded_nodes, tool_displacements
from palpate.reduction.hyper.body import DIFFERENCE_STEP, ReducedWork, reduced_body
from palpate.reduction.hyper.data import ReducedData
from palpate.reduction.hyper.error_indicator import (
    ExpectedError,
    Measures,
    approach_speeds,
    error_bounds,
    error_indicators,
    expected_error,
    nearness_to_supports,
    residual_norm,
    rms_speeds,
    support_nearness,
    training_distance,
)
from palpate.reduction.hyper.explicit import ContactData, ExplicitData, explicit_step
from palpate.reduction.hyper.implicit import ImplicitData, implicit_step
from palpate.reduction.hyper.load_share import load_share, static_response
from palpate.reduction.hyper.loads import lifting_coordinates, prepare_reduced_loads, reduced_loads
from palpate.reduction.hyper.newton import FACTOR_STEP
from palpate.reduction.hyper.reactions import constraint_forces, reactions
from palpate.reduction.hyper.sampled_energy import shear_weights

__all__ = ["ReducedData", "ReducedModel"]


REFRESH_DISPLACEMENT = 0.1  # displacement after which the stable step is updated, as a fraction of the largest so far
NEWTON_TOLERANCE = 1e-7  # largest displacement of the last Newton update, in spacings
MAX_ENERGY_ERROR = 0.05  # largest gain of energy in accepted steps, relative to the largest of the run
ROUNDING_STRAIN = 1e-7  # strain whose energy is far above that of rounding


class ReducedModel(CoordinateModel):
    """A body in few coordinates, with forces from few cubature points.

    Parameters
    ----------
    data : ReducedData
    step : float, optional [s]
        Of the energy-conserving implicit rule. By default steps are explicit, at the stable step of the
        reduced body.
    single : bool
        Whether the derivatives at the cubature points have single precision.

    Attributes
    ----------
    body : ReducedBody
        Masses, forces and energy in the coordinates.
    count : int
        Number of coordinates: modes and lifting functions.
    report : dict
        Figures measured in training.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> pull = pt.SurfaceForce("x+", force=lambda t: (20 * t, 0, 0))
    >>> full = pt.rollout(bar, [pull], duration=0.03, every=0.001)
    >>> model = pt.hyper_reduce(bar, full, modes=4)
    >>> model.count
    4
    >>> fast = pt.rollout(model, [pull], duration=0.03, every=0.001)
    >>> bool(fast.trust.max() < 1.5)
    True
    >>> model.with_step(1e-3).step
    0.001
    """

    name = "reduced"
    conservative = True
    _public = (
        "body", "count", "data", "expected_error", "report", "single", "step", "stress", "trust", "with_step",
    )  # fmt: skip
    tolerance = NEWTON_TOLERANCE / DIFFERENCE_STEP  # of Newton's method

    def __init__(self, data: ReducedData, *, step: float | None = None, single: bool = True) -> None:
        if step is not None and data.tissue.material.prony is not None:
            raise InputError(
                "step must be None for tissue that relaxes (prony), which is stepped explicitly; leave it out"
            )
        self.data, self.step, self.single = data, step, single
        self.body = reduced_body(data, single)
        # the attributes of every `Model`; they are those of the data
        self.cloud, self.material, self.supports = data.cloud, data.tissue.material, data.supports
        self.stiffness_damping, self.mass_damping = data.stiffness_damping, data.mass_damping
        self.volumes, self.columns = data.volumes, self.body.vectors
        self.min_steps_per_frame = 20 if step is None else 1  # the implicit step is the user's choice
        self._least_energy = float(self.material.shear_modulus * self.volumes.sum() * ROUNDING_STRAIN**2)  # [J]

    @property
    def count(self) -> int:
        """Number of coordinates: modes and lifting functions."""
        return self.body.count

    @property
    def report(self) -> Mapping[str, Any]:
        """Figures measured in training."""
        return self.data.report

    def _own_facts(self) -> list[Fact]:
        data, error = self.data, self.report.get("held_out", {}).get("mean", {}).get("displacement")
        return [
            ("modes", data.modes, ""),
            ("lifting functions", data.lifting_count or None, ""),
            ("sampled nodes", len(data.cubature.nodes), ""),
            (
                "held-out displacement error",
                "not measured" if error is None else 100 * error,
                "" if error is None else "%",
            ),
            ("prescribed", data.prescribed or None, ""),
            ("step", "explicit" if self.step is None else self.step, "" if self.step is None else "s"),
        ]

    def workspace(self) -> ReducedWork:
        return self.body.workspace()

    def prepare(self, loads: Load | Sequence[Load]) -> PreparedLoads:
        return prepare_reduced_loads(self.body, loads, lambda: self._static_response, implicit=self.step is not None)

    def _contact_tools(self, ready: PreparedLoads, work: ReducedWork) -> ContactTools:
        if work.tools is None or work.tools.prepared is not ready:
            work.tools = ContactTools(self.body.surface, ready)
        return work.tools

    # stepping

    def state(
        self,
        prepared: PreparedLoads,
        displacement: Floats | None = None,
        velocity: Floats | None = None,
        time: float = 0.0,
    ) -> State:
        work, flat = self.workspace(), self.body.vectors.reshape(self.count, -1)
        projected = []
        for name, field in (("displacement", displacement), ("velocity", velocity)):
            array = initial_field(name, field, len(self.cloud))
            projected.append(flat @ (array * self.masses[:, None]).reshape(-1))
        coordinates, velocities = np.array(projected)
        modes = slice(self.data.modes)
        if prepared.is_prescribed(np.array([time]))[0]:
            lifting = lifting_coordinates(self.data, prepared, np.array([time]))[0]
            rates = prepared.rates(lambda times: lifting_coordinates(self.data, prepared, times), time)[0]
            for vector, tool_values in ((coordinates, lifting), (velocities, rates)):
                vector[modes] = self.body.constrained_inverse_mass @ (
                    vector[modes] - self.body.mass[modes, self.data.modes :] @ tool_values
                )
                vector[self.data.modes :] = tool_values
        else:
            coordinates, velocities = self.body.inverse_mass @ coordinates, self.body.inverse_mass @ velocities
        history = self.body.equilibrium_history(coordinates, work)
        rest = State(coordinates, velocities, time, history=history)
        tools = self._contact_tools(prepared, work)
        contact = tools.initial_state(lambda: self.displacement(rest, prepared), time, self.cloud.spacing)
        return replace(rest, contact_state=contact)

    def stable_step(
        self, state: State, prepared: PreparedLoads, work: ReducedWork | None = None
    ) -> tuple[float, State]:
        """As `Model.stable_step`; the estimate is updated where the body has moved far enough.

        The estimate of the state is the highest frequency, the displacements at which it was computed, and
        the largest displacement of the run, in the sizes of the coordinates.
        """
        if self.step is not None:
            return self.step, state
        moved = state.coordinates * self.body.sizes
        largest = float(np.abs(moved).max(initial=0.0))
        frequency, at = None, moved
        if state.estimate:
            largest = max(largest, float(state.estimate[2]))
            if np.abs(moved - state.estimate[1]).max() <= REFRESH_DISPLACEMENT * largest:
                frequency, at = float(state.estimate[0]), state.estimate[1]
        if frequency is None:
            prescribed = bool(prepared.is_prescribed(np.array([state.time * (1 + 1e-8) + 1e-12]))[0])
            frequency = self.body.highest_frequency(state.coordinates, prescribed, state.history, work)
        state = replace(state, estimate=(np.array(frequency), at, np.array(largest)))
        springs = reduced_loads(self.body, prepared).coordinate_springs
        highest = float(np.hypot(max(frequency, self.data.trained.taut_frequency), np.sqrt(springs.highest_squared)))
        if not highest:  # no stiffness
            return np.inf, state
        return stable_step(highest, self.stiffness_damping + springs.decay_rate / highest / highest), state

    def most_steps(self, state: State, prepared: PreparedLoads, step: float) -> int:
        """As `steps_between_checks`."""
        return steps_between_checks(prepared, state.time, step, self.cloud.spacing)

    def advance(
        self,
        state: State,
        prepared: PreparedLoads,
        step: float,
        steps: int,
        work: ReducedWork | None = None,
        added_forces: Floats | float = 0.0,
    ) -> tuple[State, StepReport]:
        """Advance by some steps; explicit steps support additional forces (m + l,) on the coordinates."""
        work = self.workspace() if work is None else work
        a, v, history = state.coordinates.copy(), state.velocities.copy(), work.coordinates.history
        restore_history(history, state.history)
        times: Floats = state.time + step * np.arange(-1.0, steps + 2)
        contact = self._contact_tools(prepared, work)
        if self.step is None:
            done, lost, tool_work = self._explicit_steps(a, v, (state, prepared), (step, times), added_forces, work)
            estimate = state.estimate
        else:
            done, lost, tool_work, estimate = self._implicit_steps(a, v, (state, prepared), (step, times), work)
        if history.branches.size:
            lost += float(np.sum(shear_weights(self.body.points) * history.lost) + history.volume_lost.sum())
        if prepared.tools:
            contact.check_penetration(float(times[-2]))
        new = State(
            coordinates=a,
            velocities=v,
            time=float(times[-2]),
            external_work=state.external_work + done + tool_work,
            dissipated=state.dissipated + lost,
            history=saved_history(history),
            contact_state=contact.final_state(state.contact_state),
            estimate=estimate,
        )
        return new, StepReport(done + tool_work, lost, tool_impulses=contact.tools.impulses.copy())

    def _explicit(self, touched: bool) -> Any:
        """Return the compiled explicit step, with or without contact."""
        return explicit_step(self.body.law, self.single, touched)

    def _explicit_steps(
        self,
        a: Floats,
        v: Floats,
        run: tuple[State, PreparedLoads],
        stepping: tuple[float, Floats],
        added_forces: Floats | float,
        work: ReducedWork,
    ) -> tuple[float, float, float]:
        """Advance coordinates and velocities in place; return the work of loads, the losses and the tools' work [J]."""
        (state, prepared), (step, times), body = run, stepping, self.body
        ready, contact = reduced_loads(body, prepared), self._contact_tools(prepared, work)
        explicit_data = ExplicitData(
            constants=body.constants,
            wave_speed=self.data.wave_speed / body.sizes[self.data.modes :],
            scratch=work.coordinates,
            springs=ready.coordinate_springs,
            work=work.newton.vectors,
        )
        contact_data = ContactData(
            poses=contact.poses(times[1:-1], state.contact_state, self.cloud.spacing),
            surface=body.surface,
            scratch=contact.scratch,
            tools=contact.tools,
        )
        loads = np.ascontiguousarray(ready.forces(times[1:-1])[:, : self.count] + added_forces)
        lifting, holds = lifting_coordinates(self.data, prepared, times), prepared.is_prescribed(times[1:-1])
        explicit = self._explicit(len(contact.tools.kind) > 0)
        done, lost, tool_work = explicit(a, v, lifting, holds, step, loads, explicit_data, contact_data)
        return done, lost, tool_work

    def _implicit_steps(
        self,
        a: Floats,
        v: Floats,
        run: tuple[State, PreparedLoads],
        stepping: tuple[float, Floats],
        work: ReducedWork,
    ) -> tuple[float, float, float, tuple[Floats, ...]]:
        """As `_explicit_steps`, with the factor of the last step, which Newton's method starts with."""
        (state, prepared), (step, times), body = run, stepping, self.body
        ready, estimate = reduced_loads(body, prepared), state.estimate
        implicit_data = ImplicitData(
            constants=body.constants,
            tolerance=self.tolerance,
            scratch=work.coordinates,
            springs=ready.coordinate_springs,
            newton=work.newton,
        )
        factor, factored = work.newton.factor, work.newton.factored
        factored[FACTOR_STEP] = 0.0
        if estimate:
            factor[:], factored[:] = estimate
        loads = np.ascontiguousarray(ready.forces(times[1:-2] + 0.5 * step)[:, : self.count])
        lifting, holds = lifting_coordinates(self.data, prepared, times), prepared.is_prescribed(times[2:-1])
        implicit = implicit_step(body.law, self.single)
        done, lost, tool_work, taken = implicit(a, v, lifting, holds, step, loads, implicit_data)
        if taken < len(loads):
            a[:] = np.nan
        return done, lost, tool_work, (factor.copy(), factored.copy())

    def accept_step(self, before: State, after: State, report: StepReport, work: ReducedWork | None = None) -> bool:
        """Return True to accept the last steps, False if explicit steps gained energy.

        Coordinates outside training can stiffen so fast that a step, stable at its estimate, becomes
        unstable. The gain is compared with the largest energy, work and dissipation of the run. The energy
        is not checked while tools touch the body, nor of models with prescribed groups: a jump of a tool
        misses part of its work at any step.
        """
        if not super().accept_step(before, after, report):
            return False
        if self.step is not None or self.data.lifting_count:
            return True
        for state in (before, after):
            if state.contact_state is not None and state.contact_state.forces.any():
                return True
        with np.errstate(all="ignore"):  # an unstable body
            first, last = (self._total_energy(state, work) for state in (before, after))
            gain = last - first - (report.external_work - report.dissipated)
            largest = max(first, last, abs(after.external_work), after.dissipated, self._least_energy)
            if gain > MAX_ENERGY_ERROR * largest:
                gain -= self._damping_energy(after, work) - self._damping_energy(before, work)
        return bool(gain <= MAX_ENERGY_ERROR * largest)  # False for NaN

    def _damping_energy(self, state: State, work: ReducedWork | None) -> float:
        """Return the energy [J] that the dissipation of steps to this state contains, and that is not lost.

        Steps sum beta v . (f(w') - f(w)) with w = a + beta v. The work of the forces f(w) makes the sum of
        kinetic energy, E(w) and beta v . f(w) balance with it, in place of E(a).
        """
        lag = self.stiffness_damping * state.velocities
        now, ahead = (self.body.energy(a, state.history, work) for a in (state.coordinates, state.coordinates + lag))
        return float(now - ahead - lag @ self.body.force(state.coordinates + lag, state.history, work))

    def _total_energy(self, state: State, work: ReducedWork | None) -> float:
        """Return the kinetic and strain energy [J] of a state."""
        kinetic = 0.5 * state.velocities @ self.body.mass @ state.velocities
        return float(kinetic) + self.body.energy(state.coordinates, state.history, work)

    # results of a state

    def displacement(self, state: State, prepared: PreparedLoads, nodes: Nodes = slice(None)) -> Floats:
        """Return the displacements [m] of some nodes."""
        modal = super().displacement(state, prepared, nodes)
        return modal if state.contact_state is None else modal + self._tool_displacements(state, prepared)[0][nodes]

    def _tool_displacements(self, state: State, prepared: PreparedLoads) -> tuple[Floats, Floats]:
        """Return displacements (n, 3) [m] and energies (t,) [J] of the surface compliance."""
        surface, points = self.body.surface, self.cloud.points
        return tool_displacements(self.data.compliance, points, surface, state.contact_state, prepared)

    def outputs(self, state: State, prepared: PreparedLoads, work: ReducedWork | None = None) -> Outputs:
        forces, moments, contact_forces, _ = contact_outputs(state, prepared)
        residual, tool_energies = self._tool_displacements(state, prepared)
        constraints = constraint_forces(self.body, state, prepared, work)
        held_energy = state.contact_state.held_energy if state.contact_state is not None else 0.0
        bonded = bonded_nodes(self.body.surface, state.contact_state, prepared)
        return Outputs(
            np.tensordot(state.coordinates, self.body.vectors, 1) + residual,
            self.velocity(state, prepared),
            reactions(self.body, state, prepared, constraints) | forces,
            float(0.5 * state.velocities @ self.body.mass @ state.velocities),
            self.body.energy(state.coordinates, state.history, work) + float(tool_energies.sum()) + held_energy,
            state.external_work,
            state.dissipated,
            moments,
            contact_forces,
            np.isin(contact_forces[:, 0], bonded) if len(bonded) else np.zeros(len(contact_forces), dtype=bool),
            float(error_indicators(self._measures(state, prepared, constraints, tool_energies), self.data.scales)),
        )

    def trust(self, state: State, prepared: PreparedLoads) -> float:
        """Return the error indicator of a state: above 1 the state is outside the training data.

        It is the largest of seven numbers, each a measure of `palpate.reduction.hyper.error_indicator` over
        its scale: the distance to the nearest training state, the residual norm of the forces on test fields,
        the share of the loads' static response that the coordinates cannot represent, the displacement of the
        surface compliance under tools, their touch speed, the nearness of tools to supports, and more tools in
        contact at once than in any held-out run. The scales make the error indicator at most 1 in all frames of 95 %
        of the held-out runs. Without such runs, they come from the training data.
        """
        _, energies = self._tool_displacements(state, prepared)
        measures = self._measures(state, prepared, constraint_forces(self.body, state, prepared), energies)
        return float(error_indicators(measures, self.data.scales))

    def _measures(self, state: State, prepared: PreparedLoads, constraints: Floats, tool_energies: Floats) -> Measures:
        """Return the measures of a state with constraint forces and energies (t,) [J] of the surface compliance."""
        forces, held = np.zeros((0, 0, 3)), np.zeros(0)
        if state.contact_state is not None:
            forces, held = state.contact_state.surface_forces, state.contact_state.held_pushes
        return Measures(
            np.array(training_distance(self.body, state)),
            np.array(residual_norm(self.data, constraints)),
            np.array(self.load_share(state, prepared)),
            np.zeros(1) if self.data.compliance is None else tool_energies,
            self.speeds(state, prepared),
            np.array(self.support_nearness(state)),
            np.array(float(np.count_nonzero(forces.any(axis=(1, 2)) | (held > 0.0)))),
        )

    def speeds(self, state: State, prepared: PreparedLoads) -> Floats:
        """Return the speeds (t,) [m/s] at which tools that touch the body move into it; 0 of others.

        Without a contact surface it is the root mean square speed over the body (1,).
        """
        if self.data.compliance is None:
            return rms_speeds(self.body.trained[1], state.velocities[None])
        if state.contact_state is None:
            return np.zeros(len(prepared.tools))
        forces = state.contact_state.surface_forces.sum(axis=1)
        return approach_speeds(prepared, np.array([state.time]), forces[None])[0]

    @cached_property
    def _nearness(self) -> Floats:
        """Nearness to supports of the nodes (k,) of the contact surface."""
        return nearness_to_supports(self.cloud, self.supports, self.body.surface.nodes)

    def support_nearness(self, state: State) -> float:
        """Return the nearness to supports of the nearest tool: the spacing over its distance, weighted by forces."""
        if state.contact_state is None:
            return 0.0
        return support_nearness(self._nearness, state.contact_state.surface_forces, state.contact_state.held_pushes)

    def load_share(self, state: State, prepared: PreparedLoads) -> float:
        """Return the share of the loads' static response that the coordinates cannot represent, 0 to 1."""
        loads = reduced_loads(self.body, prepared)
        return load_share(self.body, state, loads.responses, loads.amplitudes(state.time))

    @cached_property
    def _static_response(self) -> Callable[[Floats], Floats]:
        return static_response(self.data, np.zeros(len(self.cloud)))

    def expected_error(self, trust: float, of: str = "displacement") -> ExpectedError:
        """Return the error expected at an error indicator: the median, and a bound with its level.

        Parameters
        ----------
        trust : float
            The largest error indicator of a motion so far, because an error persists as a vibration.
        of : str
            ``"displacement"``: root mean square over the body. ``"force"``: of the force on a tool.

        Returns
        -------
        ExpectedError
            Both are infinite, which is unknown, from an error indicator of 2 on; of older models above those of
            the held-out runs.

        Raises
        ------
        InputError
            The model was trained without held-out runs, or for forces without tools.
        """
        return expected_error(self.report, trust, of)

    def error_bounds(self, run: Trajectory) -> tuple[Floats, Floats]:
        """Return the error bounds of a run's displacement [m] and of its tool forces [N], both (f,).

        Errors of displacement are root mean squares over the body. Bounds are infinite where the error is
        unknown. They are empty for a model without held-out runs, and those of forces without tools.
        """
        return error_bounds(self.data, run)

    def stress(self, displacements: Floats) -> Floats:
        """Return the first Piola-Kirchhoff stress [Pa] at the nodes of a solid, (n, 3, 3).

        Parameters
        ----------
        displacements : (n, 3) array [m]

        Raises
        ------
        InputError
            The model is a membrane.
        """
        if self.data.kinematics.sheet:
            raise InputError(
                "model must be a full model to return the stress at nodes, got a reduced membrane; use Membrane"
            )
        return self.data.tissue.stress(self.body.gradient(displacements) + np.eye(3))

    @property
    def quantities(self) -> tuple[str, ...]:
        return tuple(QUANTITY_UNITS)[:1] if self.data.kinematics.sheet else tuple(QUANTITY_UNITS)

    def cauchy_stress(self, displacements: Floats) -> Floats:
        F = self.body.gradient(displacements) + np.eye(3)
        return np.asarray(self.stress(displacements) @ np.swapaxes(F, 1, 2) / np.linalg.det(F)[:, None, None])

    def with_report(self, entries: Mapping[str, Any]) -> ReducedModel:
        """Return this model with some entries of its report replaced or added."""
        return self.with_data(report={**self.report, **entries})

    def with_data(self, **changes: Any) -> ReducedModel:
        """Return this model with some of its data replaced."""
        return ReducedModel(replace(self.data, **changes), step=self.step, single=self.single)

    def with_step(self, step: float | None) -> ReducedModel:
        """Return this model with the energy-conserving implicit rule of a step [s], or explicit steps (None)."""
        return ReducedModel(self.data, step=step, single=self.single)
