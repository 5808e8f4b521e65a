"""The hyper-reduced model: an energy sampled at few nodes, in the coordinates of modes and tools.

`palpate.hyper_reduce` makes it from a full model and its runs. The result does not depend on the full
model any more. The cost of a step depends on the numbers of integration points and coordinates, not
on the number of nodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from palpate.arrays import Floats
from palpate.describe import Fact
from palpate.dynamics.loads.prepared import Load, PreparedLoads
from palpate.dynamics.material.fibres import always_taut
from palpate.dynamics.material.relaxation import equilibrium_history, history_after, restore_history, saved_history
from palpate.dynamics.nodal.stability import stable_step
from palpate.dynamics.run.model import Model, Nodes, Outputs, State, StepReport, initial_field
from palpate.dynamics.run.reactions import contact_outputs
from palpate.faults import InputError
from palpate.meshfree.stencils import moving_least_squares
from palpate.reduction.contact.tools import ContactTools, bonded_nodes, tool_displacements
from palpate.reduction.hyper.data import ReducedData
from palpate.reduction.hyper.error_indicator import distances_to_nearest, expected_error
from palpate.reduction.hyper.explicit import ContactData, ExplicitData, explicit_step
from palpate.reduction.hyper.foundation import add_spring_forces
from palpate.reduction.hyper.generalised_forces import GeneralisedForces, generalised_forces, load_forces, pose_map
from palpate.reduction.hyper.implicit import FACTOR_STEP, ImplicitData, NewtonScratch, implicit_step, newton_scratch
from palpate.reduction.hyper.loads import lifting_coordinates, prepare_reduced_loads
from palpate.reduction.hyper.material_point import material_point
from palpate.reduction.hyper.sampled_energy import IntegrationPoints, Scratch, sampled_energy, scratch, shear_weights

__all__ = ["ReducedData", "ReducedModel"]


REFRESH_DISPLACEMENT = 0.1  # displacement after which the stable step is updated, as a fraction of the largest so far
NEWTON_TOLERANCE = 1e-7  # largest displacement of the last Newton update, in spacings
MAX_ENERGY_ERROR = 0.05  # largest gain of energy in accepted steps, relative to the energy
DIFFERENCE_STEP = 1e-5  # displacements for difference quotients of the tangent, in spacings
STENCIL_NEIGHBOURS = {2: 14, 3: 42}  # by dimension of the cloud: a sheet, a solid


@dataclass
class ReducedWork:
    """Scratch arrays of a reduced model, for one thread at a time.

    Parameters
    ----------
    coordinates, all : Scratch
        Of the forces on the coordinates, and on all basis vectors; they share the history variables.
    newton : NewtonScratch
    force, all_forces : arrays [N]
    tools : ContactTools, optional
        Rigid tools of the loads that were used last.
    """

    coordinates: Scratch
    all: Scratch
    newton: NewtonScratch
    force: Floats
    all_forces: Floats
    tools: ContactTools | None = None


class ReducedModel(Model):
    """A body in few coordinates, with forces from few integration points.

    Parameters
    ----------
    data : ReducedData
    step : float, optional [s]
        Of the energy-conserving implicit rule. By default steps are explicit, at the stable step of the
        reduced body.
    single : bool
        Whether the derivatives at the integration points have single precision.

    Attributes
    ----------
    count : int
        Number of coordinates: modes and lifting vectors.
    report : dict
        Figures measured in training.
    """

    name = "reduced"
    conservative = True
    tolerance = NEWTON_TOLERANCE / DIFFERENCE_STEP  # of Newton's method

    def __init__(self, data: ReducedData, *, step: float | None = None, single: bool = True) -> None:
        if step is not None and data.material.prony is not None:
            raise InputError(
                "step must be None for tissue that relaxes (prony), which is stepped explicitly; leave it out"
            )
        self.data, self.step, self.single, self.volumes = data, step, single, data.volumes
        self.cloud, self.material, self.supports = data.cloud, data.material, data.supports
        self.stiffness_damping, self.report = data.stiffness_damping, data.report
        self.min_steps_per_frame = 20 if step is None else 1  # the implicit step is the user's choice
        self.count = count = data.modes + data.lifting_count
        several = data.regions is not None
        self._law, self._coefficients = material_point(data.material, data.kinematics, data.fibres, several)
        flat = data.basis_vectors.reshape(len(data.basis_vectors), -1)
        self._all_mass = (flat * np.repeat(self.masses, 3)) @ flat.T
        self.mass = np.ascontiguousarray(self._all_mass[:count, :count])
        self._constrained_inverse_mass = np.asarray(np.linalg.inv(self.mass[: data.modes, : data.modes]), dtype=float)
        self._inverse_mass = np.asarray(np.linalg.inv(self.mass), dtype=float)
        self.integration_points = partial(data.integration_points, coefficients=self._coefficients, single=single)
        self._all = self.integration_points(np.arange(len(flat)))
        self._integration_points = self.integration_points(np.arange(count))
        self._taut_points = self._integration_points._replace(families=always_taut(self._integration_points.families))
        self._force, self._energy = sampled_energy(self._law, single)
        self._explicit = explicit_step(self._law, single)
        self._implicit, self._tangent = implicit_step(self._law, single)
        # largest displacement [m] of a unit coordinate
        self.sizes = np.linalg.norm(data.basis_vectors[:count], axis=2).max(axis=1)
        self._differences = DIFFERENCE_STEP * self.cloud.spacing / self.sizes
        self._contact_surface = data.surface

    def _own_facts(self) -> list[Fact]:
        data, found = self.data, self.report.get("held_out", {}).get("mean", {}).get("displacement")
        return [
            ("modes", data.modes, ""),
            ("lifting columns", data.lifting_count or None, ""),
            ("sampled nodes", len(data.cubature.nodes), ""),
            (
                "held-out displacement error",
                "not measured" if found is None else 100 * found,
                "" if found is None else "%",
            ),
            ("driven", data.prescribed or None, ""),
            ("step", "explicit" if self.step is None else self.step, "" if self.step is None else "s"),
        ]

    def workspace(self) -> ReducedWork:
        own, count = scratch(self._integration_points), self.count
        forces = np.zeros(count), np.zeros(len(self.data.basis_vectors))
        return ReducedWork(own, scratch(self._all, own.history), newton_scratch(count), *forces)

    def force(self, coordinates: Floats, history: tuple[Floats, ...] = (), work: ReducedWork | None = None) -> Floats:
        """Return the internal forces on the coordinates, -dE/da, shape (m + l,).

        Relaxing tissue responds to the change since its history variables, by default those at rest, as to
        an instantaneous one.
        """
        work = self.workspace() if work is None else work
        restore_history(work.coordinates.history, history)
        return self._instant_force(coordinates, work)

    def _instant_force(self, coordinates: Floats, work: ReducedWork) -> Floats:
        """Return the forces on the coordinates for the history variables in a workspace."""
        a = np.ascontiguousarray(coordinates, dtype=float)
        self._force(a, self._integration_points, work.coordinates, work.force)
        return work.force.copy()

    def forces(self, coordinates: Floats, history: tuple[Floats, ...] = (), work: ReducedWork | None = None) -> Floats:
        """Return the internal forces on all basis vectors, test fields included, shape (m + l + 3 g + w,)."""
        work = self.workspace() if work is None else work
        restore_history(work.all.history, history)
        padded = np.zeros(len(self.data.basis_vectors))
        padded[: self.count] = coordinates
        self._force(padded, self._all, work.all, work.all_forces)
        return work.all_forces.copy()

    def project(self, fields: Floats) -> Floats:
        """Return the coordinates (t, m + l) of the best approximations of fields (t, n, 3), in the mass norm."""
        flat = self.data.basis_vectors[: self.count].reshape(self.count, -1) * np.repeat(self.masses, 3)
        return np.asarray((fields.reshape(len(fields), -1) @ flat.T) @ self._inverse_mass)

    def energy(self, coordinates: Floats, history: tuple[Floats, ...] = (), work: ReducedWork | None = None) -> float:
        """Return the strain energy [J]."""
        work = self.workspace() if work is None else work
        restore_history(work.coordinates.history, history)
        a = np.ascontiguousarray(coordinates, dtype=float)
        return float(self._energy(a, self._integration_points, work.coordinates))

    def stiffness(
        self, coordinates: Floats, history: tuple[Floats, ...] = (), work: ReducedWork | None = None
    ) -> Floats:
        """Return the tangent -d(force)/d(coordinates), shape (m + l, m + l)."""
        work = self.workspace() if work is None else work
        restore_history(work.coordinates.history, history)
        return self._stiffness(coordinates, self._integration_points, work)

    def _stiffness(self, coordinates: Floats, of: IntegrationPoints, work: ReducedWork) -> Floats:
        matrix = np.zeros((self.count, self.count))
        a, vectors = np.ascontiguousarray(coordinates, dtype=float), np.zeros((3, self.count))
        self._tangent(a, self._differences, of, work.coordinates, vectors, self.count, matrix)
        return matrix

    # loads

    def prepare(self, loads: Sequence[Load]) -> PreparedLoads:
        return prepare_reduced_loads(self.data, loads, implicit=self.step is not None)

    def _project_loads(self, ready: PreparedLoads) -> GeneralisedForces:
        known = ready.derived.get(id(self))
        if known is None:  # it keeps the model, whose id no other object has then
            projected = generalised_forces(ready, self.data.basis_vectors, self.masses, self.mass)
            ready.derived[id(self)] = known = (self, projected)
        return cast(GeneralisedForces, known[1])

    def _contact_tools(self, ready: PreparedLoads, work: ReducedWork) -> ContactTools:
        if work.tools is None or work.tools.prepared is not ready:
            work.tools = ContactTools(self._contact_surface, ready)
        return work.tools

    @staticmethod
    def _holds(ready: PreparedLoads, times: Floats) -> NDArray[np.bool_]:
        """Return whether the tools prescribe the motion at some times, shape (t,)."""
        return ready.motions[0][0].is_active(times) if ready.motions else np.ones(len(times), dtype=np.bool_)

    # stepping

    def state(
        self,
        prepared: PreparedLoads,
        displacement: Floats | None = None,
        velocity: Floats | None = None,
        time: float = 0.0,
    ) -> State:
        work, flat = self.workspace(), self.data.basis_vectors[: self.count].reshape(self.count, -1)
        projected = []
        for name, given in (("displacement", displacement), ("velocity", velocity)):
            array = initial_field(name, given, len(self.cloud))
            projected.append(flat @ (array * self.masses[:, None]).reshape(-1))
        coordinates, velocities = np.array(projected)
        modes = slice(self.data.modes)
        if self._holds(prepared, np.array([time]))[0]:
            lifting = lifting_coordinates(self.data, prepared, np.array([time]))[0]
            rates = prepared.rates(lambda times: lifting_coordinates(self.data, prepared, times), time)[0]
            for vector, known in ((coordinates, lifting), (velocities, rates)):
                vector[modes] = self._constrained_inverse_mass @ (
                    vector[modes] - self.mass[modes, self.data.modes :] @ known
                )
                vector[self.data.modes :] = known
        else:
            coordinates, velocities = self._inverse_mass @ coordinates, self._inverse_mass @ velocities
        history = self.equilibrium_history(coordinates, work)
        rest = State(coordinates, velocities, time, history=history)
        tools = self._contact_tools(prepared, work)
        contact = tools.initial_state(lambda: self.displacement(rest, prepared), time, self.cloud.spacing)
        return replace(rest, contact_state=contact)

    def history_after(
        self, coordinates: Floats, history: tuple[Floats, ...], interval: float, work: ReducedWork | None = None
    ) -> tuple[Floats, ...]:
        """Return the history variables after a linear change over an interval [s] to coordinates (m + l,)."""
        work = self.workspace() if work is None else work
        variables = work.coordinates.history
        return history_after(variables, history, interval, lambda: self._instant_force(coordinates, work))

    def equilibrium_history(self, coordinates: Floats, work: ReducedWork | None = None) -> tuple[Floats, ...]:
        """Return the history variables at equilibrium; empty without relaxation."""
        work = self.workspace() if work is None else work
        return equilibrium_history(work.coordinates.history, lambda: self._instant_force(coordinates, work))

    def stable_step(
        self, state: State, prepared: PreparedLoads, work: ReducedWork | None = None
    ) -> tuple[float, State]:
        """As `Model.stable_step`; the estimate is updated where the body has moved far enough.

        The estimate of the state is the highest frequency, the displacements at which it was computed, and
        the largest displacement of the run, in the sizes of the coordinates.
        """
        if self.step is not None:
            return self.step, state
        moved = state.coordinates * self.sizes
        largest = float(np.abs(moved).max(initial=0.0))
        frequency, at = None, moved
        if state.estimate:
            largest = max(largest, float(state.estimate[2]))
            if np.abs(moved - state.estimate[1]).max() <= REFRESH_DISPLACEMENT * largest:
                frequency, at = float(state.estimate[0]), state.estimate[1]
        if frequency is None:
            prescribed = bool(self._holds(prepared, np.array([state.time * (1 + 1e-8) + 1e-12]))[0])
            frequency = self._highest_frequency(state.coordinates, prescribed, state.history, work)
        state = replace(state, estimate=(np.array(frequency), at, np.array(largest)))
        springs = self._project_loads(prepared).coordinate_springs
        highest = float(np.hypot(max(frequency, self.data.taut_frequency), np.sqrt(springs.highest_squared)))
        if not highest:  # no stiffness
            return np.inf, state
        return stable_step(highest, self.stiffness_damping + springs.decay_rate / highest / highest), state

    def _highest_frequency(
        self,
        coordinates: Floats,
        prescribed: bool = True,
        history: tuple[Floats, ...] = (),
        work: ReducedWork | None = None,
    ) -> float:
        """Return the highest frequency [rad/s], with the lifting coordinates prescribed or free."""
        work = self.workspace() if work is None else work
        restore_history(work.coordinates.history, history)
        moving = slice(self.data.modes if prescribed else None)
        tangent = self._stiffness(coordinates, self._taut_points, work)[moving, moving]
        if not np.isfinite(tangent).all():
            return np.inf
        inverse_mass = self._constrained_inverse_mass if prescribed else self._inverse_mass
        return float(np.sqrt(np.abs(np.linalg.eigvals(inverse_mass @ tangent)).max()))

    def frequencies(self, coordinates: Floats | None = None) -> Floats:
        """Return the circular frequencies [rad/s] of the modes with the tools fixed, in ascending order.

        They are those at rest by default, and NaN where the body is unstable.
        """
        modes = slice(self.data.modes)
        tangent = self.stiffness(np.zeros(self.count) if coordinates is None else coordinates)[modes, modes]
        squares = np.sort(np.linalg.eigvals(self._constrained_inverse_mass @ (0.5 * (tangent + tangent.T))).real)
        return np.sqrt(np.where(squares >= 0, squares, np.nan))

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
        a, v, count, history = state.coordinates.copy(), state.velocities.copy(), self.count, work.coordinates.history
        restore_history(history, state.history)
        times: Floats = state.time + step * np.arange(-1.0, steps + 2)
        contact, projected = self._contact_tools(prepared, work), self._project_loads(prepared)
        lifting, estimate = lifting_coordinates(self.data, prepared, times), state.estimate
        if self.step is None:
            loads = np.ascontiguousarray(projected.at(times[1:-1])[:, :count] + added_forces)
            explicit_data = ExplicitData(
                stiffness_damping=self.stiffness_damping,
                wave_speed=self.data.wave_speed / self.sizes[self.data.modes :],
                mass=self.mass,
                constrained_inverse_mass=self._constrained_inverse_mass,
                inverse_mass=self._inverse_mass,
                integration_points=self._integration_points,
                scratch=work.coordinates,
                springs=projected.coordinate_springs,
                work=work.newton.vectors,
            )
            contact_data = ContactData(
                poses=contact.poses(times[1:-1], state.contact_state, self.cloud.spacing),
                surface=self._contact_surface,
                scratch=contact.contact_state,
                tools=contact.tools,
            )
            holds = self._holds(prepared, times[1:-1])
            done, lost, tool_work = self._explicit(a, v, lifting, holds, step, loads, explicit_data, contact_data)
        else:
            middles = times[1:-2] + 0.5 * step
            loads = np.ascontiguousarray(projected.at(middles)[:, :count])
            implicit_data = ImplicitData(
                stiffness_damping=self.stiffness_damping,
                mass=self.mass,
                differences=self._differences,
                tolerance=self.tolerance,
                integration_points=self._integration_points,
                scratch=work.coordinates,
                springs=projected.coordinate_springs,
                newton=work.newton,
            )
            holds = self._holds(prepared, times[2:-1])
            factor, factored = work.newton.factor, work.newton.factored
            factored[FACTOR_STEP] = 0.0
            if estimate:  # the factor of the last step, which Newton's method starts with
                factor[:], factored[:] = estimate
            done, lost, tool_work, taken = self._implicit(a, v, lifting, holds, step, loads, implicit_data)
            estimate = factor.copy(), factored.copy()
            if taken < steps:
                a[:] = np.nan
        if history.branches.size:
            lost += float(np.sum(shear_weights(self._integration_points) * history.lost) + history.volume_lost.sum())
        after = contact.final_state(state.contact_state)
        new = State(
            coordinates=a,
            velocities=v,
            time=float(times[-2]),
            external_work=state.external_work + done + tool_work,
            dissipated=state.dissipated + lost,
            history=saved_history(history),
            contact_state=after,
            estimate=estimate,
        )
        return new, StepReport(done + tool_work, lost, tool_impulses=contact.tools.impulses.copy())

    def accept_step(self, before: State, after: State, report: StepReport, work: ReducedWork | None = None) -> bool:
        """Return True to accept the last steps, False if explicit steps gained energy.

        Coordinates outside training can stiffen so fast that a step, stable at its estimate, becomes
        unstable. The energy is not checked while tools touch the body, nor of models with prescribed groups:
        a jump of a tool misses part of its work at any step.
        """
        if not super().accept_step(before, after, report):
            return False
        if self.step is not None or self.data.lifting_count:
            return True
        for state in (before, after):
            if state.contact_state is not None and state.contact_state.surface_forces.any():
                return True
        with np.errstate(all="ignore"):  # an unstable body
            first, last = (self._total_energy(state, work) for state in (before, after))
        error = last - first - (report.external_work - report.dissipated)
        return bool(error <= MAX_ENERGY_ERROR * max(first, last))  # False for NaN

    def _total_energy(self, state: State, work: ReducedWork | None) -> float:
        """Return the kinetic and strain energy [J] of a state."""
        kinetic = 0.5 * state.velocities @ self.mass @ state.velocities
        return float(kinetic) + self.energy(state.coordinates, state.history, work)

    # results of a state

    def displacement(self, state: State, prepared: PreparedLoads, nodes: Nodes = slice(None)) -> Floats:
        """Return the displacements [m] of some nodes."""
        modal = np.tensordot(state.coordinates, self.data.basis_vectors[: self.count, nodes], 1)
        return modal if state.contact_state is None else modal + self._tool_displacements(state, prepared)[0][nodes]

    def _tool_displacements(self, state: State, prepared: PreparedLoads) -> tuple[Floats, float]:
        """Return displacements (n, 3) [m] and energy [J] of the surface compliance."""
        surface, points = self._contact_surface, self.cloud.points
        return tool_displacements(self.data.compliance, points, surface, state.contact_state, prepared)

    def velocity(self, state: State, prepared: PreparedLoads, nodes: Nodes = slice(None)) -> Floats:
        """Return the velocities [m/s] of some nodes."""
        return np.tensordot(state.velocities, self.data.basis_vectors[: self.count, nodes], 1)

    def _accelerations(
        self, state: State, prepared: PreparedLoads, work: ReducedWork | None = None
    ) -> tuple[Floats, Floats]:
        """Return the accelerations of the coordinates, and internal forces plus loads on all basis vectors."""
        forces = self.forces(state.coordinates + self.stiffness_damping * state.velocities, state.history, work)
        forces += self._project_loads(prepared).at(np.array([state.time]))[0]
        add_spring_forces(self._project_loads(prepared).springs, state.coordinates, state.velocities, forces)
        if state.contact_state is not None:
            forces += np.tensordot(self.data.basis_vectors, state.contact_state.forces, 2)
        modes = slice(self.data.modes)
        if self._holds(prepared, np.array([state.time]))[0]:
            lifting_rates = prepared.rates(lambda times: lifting_coordinates(self.data, prepared, times), state.time)[1]
            free = forces[modes] - self.mass[modes, self.data.modes :] @ lifting_rates
            return np.concatenate([self._constrained_inverse_mass @ free, lifting_rates]), forces
        return self._inverse_mass @ forces[: self.count], forces

    def required_forces(self, state: State, prepared: PreparedLoads, work: ReducedWork | None = None) -> Floats:
        """Return the constraint forces on all basis vectors, shape (m + l + 3 g + w,).

        They are the inertial forces minus internal forces and loads.
        """
        rates, forces = self._accelerations(state, prepared, work)
        return np.asarray(self._all_mass[:, : self.count] @ rates - forces)

    def reactions(self, state: State, prepared: PreparedLoads, work: ReducedWork | None = None) -> dict[str, Floats]:
        """Return the force [N] of every support and tool on the body, from the constraint forces."""
        required_forces, first = self.required_forces(state, prepared, work), self.count
        result = {name: required_forces[first + 3 * g : first + 3 * g + 3] for g, name in enumerate(self.fixed)}
        holds, tools = self._holds(prepared, np.array([state.time]))[0], required_forces[self.data.modes : self.count]
        for name in self.data.prescribed:
            result[name] = self.tool_map(name)[:, :3].T @ tools if holds else np.zeros(3)
        return result

    def tool_map(self, group: str) -> Floats:
        """Return the map (l, 12) from the pose of a rigid tool to the lifting coordinates.

        The coordinates are the map times the translation (3) and the entries of R - I (9, row by row). R is
        the rotation about the mean position of the group's nodes.
        """
        nodes = self.cloud.group(group)
        return pose_map(self.cloud.points[nodes], self.data.basis_vectors[self.data.modes : self.count, nodes])

    def outputs(self, state: State, prepared: PreparedLoads, work: ReducedWork | None = None) -> Outputs:
        forces, moments, contact_forces, _ = contact_outputs(state, prepared)
        residual, energy = self._tool_displacements(state, prepared)
        bonded = bonded_nodes(self._contact_surface, state.contact_state, prepared)
        return Outputs(
            np.tensordot(state.coordinates, self.data.basis_vectors[: self.count], 1) + residual,
            self.velocity(state, prepared),
            self.reactions(state, prepared, work) | forces,
            float(0.5 * state.velocities @ self.mass @ state.velocities),
            self.energy(state.coordinates, state.history, work) + energy,
            state.external_work,
            state.dissipated,
            moments,
            contact_forces,
            np.isin(contact_forces[:, 0], bonded) if len(bonded) else np.zeros(len(contact_forces), dtype=bool),
        )

    def trust(self, state: State, prepared: PreparedLoads) -> float:
        """Return the trust number of a state: above 1 the state is outside the training data.

        It is the larger of two numbers: the distance to the nearest training state, and the residual norm of
        the forces on test fields (`palpate.reduction.hyper.error_indicator`). Both are lengths, divided by
        their scales. The scales make the trust number at most 1 on 95 % of the frames of the held-out runs.
        Without such runs, they are quantiles of the training data: of the distances between runs, and of the
        residual norms after projection.
        """
        return max(
            self.distance(state) / self.data.distance_scale,
            self.residual_norm(state, prepared) / self.data.residual_scale,
        )

    def distance(self, state: State) -> float:
        """Return the root mean square displacement [m] over the body from a state to the nearest training state."""
        return float(
            distances_to_nearest(state.coordinates[None], self.data.training_states, self.mass / self.masses.sum())[0]
        )

    def residual_norm(self, state: State, prepared: PreparedLoads) -> float:
        """Return the root mean square displacement [m] that the unbalanced forces would cause at rest.

        The unbalanced forces act on the residual fields (`palpate.reduction.training.residual_fields`), and
        the displacement is in their shapes. The norm is 0 without residual fields.
        """
        return float(
            np.linalg.norm(
                self.required_forces(state, prepared)[len(self.data.basis_vectors) - self.data.residual_fields :]
            )
        )

    def expected_error(self, trust: float) -> tuple[float, float]:
        """Return the displacement errors of the held-out runs at a trust number: median and 95th percentile.

        Parameters
        ----------
        trust : float
            The largest trust number of a motion so far, because an error persists as a vibration.

        Returns
        -------
        median, percentile : float
            Root mean square over the body, divided by the largest such displacement of the run. Infinite
            above all trust numbers of the held-out runs.

        Raises
        ------
        InputError
            The model was trained without held-out runs.
        """
        return expected_error(self.report, trust)

    def acceleration(self, state: State, prepared: PreparedLoads) -> Floats:
        return np.tensordot(self._accelerations(state, prepared)[0], self.data.basis_vectors[: self.count], 1)

    def external_force(self, state: State, prepared: PreparedLoads) -> Floats:
        forces = load_forces(prepared, self.masses, self.data.basis_vectors, state)
        return forces if state.contact_state is None else forces + state.contact_state.forces

    @cached_property
    def stencils(self) -> Any:  # type: ignore[override]
        """Stencils of the cloud, computed at the first use."""
        stretch, space = self.data.kinematics.prestretch, self.cloud.points.shape[1]
        return moving_least_squares(self.cloud.points / stretch, order=2, neighbours=STENCIL_NEIGHBOURS[space])

    def deformation_gradient(self, displacements: Floats) -> Floats:
        rest = self.data.kinematics.prestretch * np.eye(3, self.cloud.points.shape[1])
        return np.asarray(self.stencils.gradient(displacements) + rest)

    def stress(self, displacements: Floats) -> Floats:
        if self.data.kinematics.sheet:
            raise InputError(
                "model must be a full model to return the stress at nodes, got a reduced membrane; use Membrane"
            )
        return self.data.stress(self.deformation_gradient(displacements))

    def strain_energy(self, displacements: Floats) -> float:
        """Return the strain energy [J] of nodal displacements, projected on the coordinates."""
        return self.energy(self.project(displacements[None])[0])

    def with_step(self, step: float | None) -> ReducedModel:
        """Return this model with the energy-conserving implicit rule of a step [s], or explicit steps (None)."""
        return ReducedModel(self.data, step=step, single=self.single)
