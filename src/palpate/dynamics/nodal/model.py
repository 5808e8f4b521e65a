"""The common base of models with nodal unknowns: solids and membranes."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.arrays import Floats
from palpate.dynamics.compiled.lanes import Lanes
from palpate.dynamics.compiled.passes import Formulation, internal_force
from palpate.dynamics.contact.tools import surface_nodes
from palpate.dynamics.loads.prepared import FIXED, FREE, LoadHistory, PreparedLoads
from palpate.dynamics.material.fibres import always_taut
from palpate.dynamics.nodal.central_difference import (
    Damping,
    NodalData,
    foundation_force,
    full_step,
    step_scratch,
    surface_force,
)
from palpate.dynamics.nodal.stability import FrequencyTracker, StabilityReport, stable_step
from palpate.dynamics.run.contact_state import (
    check_initial_penetration,
    check_penetration,
    check_tool_step,
    initial_contact_state,
    next_contact_state,
)
from palpate.dynamics.run.model import Model, Nodes, Outputs, State, initial_field
from palpate.dynamics.run.reactions import evaluate, tool_power
from palpate.faults import number_in_range
from palpate.tissue.fibres import FibreLaw

__all__ = ["NodalModel"]


class NodalModel(Model):
    """A model with nodal displacements as unknowns.

    Attributes
    ----------
    body, work : NamedTuples
        Input and scratch arrays of the compiled passes.
    formulation : Formulation
    half_cell : float
        Half the c of the half-cell balance at the boundary.
    fixed_mask : (n,) bool array
        True for the nodes of the fixed groups.
    stability : StabilityReport
    wave_speed : float [m/s]
        Estimate of the fastest wave speed, and limit of prescribed velocities in the damping forces.
    highest_frequency : FrequencyTracker
    fibres : FibreLaw or None
        Fibres with a direction at every node.
    """

    body: Any
    work: Any
    formulation: Formulation
    half_cell: float
    fixed_mask: NDArray[np.bool_]
    stability: StabilityReport
    wave_speed: float
    highest_frequency: FrequencyTracker
    fibres: FibreLaw | None = None

    def _compile(self, formulation: Formulation, body: Any, work: Any, lanes: Lanes) -> None:
        """Set the compiled passes and their arrays; requires the cloud and the supports."""
        self.formulation, self.body, self.work = formulation, body, work
        self._always_taut = body if self.fibres is None else body._replace(families=always_taut(body.families))
        self._internal_force, self._advance = internal_force(formulation), full_step(formulation)
        self.slot = np.zeros(len(self.cloud), dtype=np.int64)
        self.slot[lanes.nodes.ravel()] = np.arange(lanes.nodes.size)
        self._scratch = step_scratch(len(self.cloud))
        self.fixed_mask = self.prepare(()).sites.kind != FREE
        self.highest_frequency = FrequencyTracker(self)
        self.wave_speed = np.inf

    def _set_stability(self, report: StabilityReport) -> None:
        """Set the damping and the wave speed of a stability report."""
        self.stability, self.stiffness_damping = report, report.used
        self.wave_speed = 0.5 * self.cloud.spacing * report.highest_frequency

    @property
    def weights(self) -> Floats:
        """Weights [m^3] of the inner product of virtual work, shape (n,)."""
        return self.volumes

    def force(self, displacements: Floats) -> Floats:
        """Return the nodal internal force density (n, 3) [N/m^3] for displacements (n, 3) [m]."""
        result = np.zeros((len(self.cloud), 3))
        self._internal_force(np.ascontiguousarray(displacements, dtype=float), self.body, self.work, result)
        return result

    def always_taut_force(self, displacements: Floats) -> Floats:
        """Return the internal force density [N/m^3] with fibres always taut, for the stable step."""
        result = np.zeros((len(self.cloud), 3))
        self._internal_force(np.ascontiguousarray(displacements, dtype=float), self._always_taut, self.work, result)
        return result

    def nodal_force(self, displacements: Floats) -> Floats:
        return self.force(displacements)

    def state(
        self,
        prepared: PreparedLoads,
        displacement: Floats | None = None,
        velocity: Floats | None = None,
        time: float = 0.0,
    ) -> State:
        self.highest_frequency.restart()
        fields: list[Floats] = []
        for name, given in (("displacement", displacement), ("velocity", velocity)):
            array = initial_field(name, given, len(self.cloud))
            array[self.fixed_mask] = 0.0
            fields.append(array)
        schedule = prepared.schedule(np.array([time]))
        constrained = schedule.constrained[0]
        fields[0][prepared.sites.prescribed[constrained]] = schedule.motion[0, constrained]
        check_initial_penetration(prepared, schedule, fields[0], self.cloud.spacing)
        bonded = len(prepared.sites.prescribed) if self.conservative and prepared.grasps else 0
        contact_state = None
        if prepared.tools or bonded:
            contact_state = initial_contact_state(len(prepared.tools), len(self.cloud), time, prescribed=bonded)
        return State(
            fields[0], fields[1], time, history=self._equilibrium_history(fields[0]), contact_state=contact_state
        )

    def _equilibrium_history(self, displacements: Floats) -> tuple[Floats, ...]:
        """Return the history variables at equilibrium; empty without relaxation."""
        return ()

    def _restore_history(self, state: State | None) -> None:
        """Restore the history variables of a state, or those at rest."""

    def stable_step(self, state: State, prepared: PreparedLoads) -> float:
        self._restore_history(state)
        frequency = self.highest_frequency(state.coordinates, prepared.constraint_mask(state.time))
        return self._step(frequency, prepared)

    def _step(self, frequency: float, prepared: PreparedLoads) -> float:
        """Return the stable step [s] for a highest frequency [rad/s], with foundations."""
        sites = prepared.sites
        if not len(sites.foundation_node):
            return stable_step(frequency, self.stiffness_damping)
        response = self.half_cell / (self.volumes[sites.foundation_node] * self.material.density)
        count = len(self.cloud)
        squares = np.bincount(sites.foundation_node, sites.foundation_spring * response, minlength=count).max()
        rates = np.bincount(sites.foundation_node, sites.foundation_dashpot * response, minlength=count).max()
        highest = float(np.sqrt(frequency**2 + squares))
        return stable_step(highest, self.stiffness_damping + rates / highest**2)

    def advance(self, state: State, prepared: PreparedLoads, step: float, steps: int) -> State:
        number_in_range("step", step, 0.0, open_low=True, unit="s")
        times: Floats = state.time + step * np.arange(steps + 1, dtype=float)
        u, v = state.coordinates.copy(), state.velocities.copy()
        schedule = prepared.schedule(times)
        check_tool_step(prepared, schedule, self.cloud.spacing)
        prepared.contacts.tool_impulses[:], prepared.contacts.nodal_impulses[:], prepared.sites.impulses[:] = (
            0.0,
            0.0,
            0.0,
        )
        self._scratch.surface[:] = 0.0  # values of another run's loads
        self._restore_history(state)
        before = 0.0 if self.conservative else tool_power(self, state, prepared)
        work, lost, tools = self._advance(
            u,
            v,
            step,
            Damping(self.stiffness_damping, self.wave_speed),
            (self.body, self.work),
            (prepared.sites, prepared.contacts, schedule),
            self._nodal_data(),
            self._scratch,
        )
        if prepared.tools:
            check_penetration(prepared, schedule, u, surface_nodes(self.cloud), self.cloud.spacing)
        relaxed, history = self._saved_history()
        dissipated = state.dissipated + lost + relaxed
        contact_state = (
            None
            if state.contact_state is None
            else next_contact_state(prepared, state.contact_state, 0.5 * step, schedule.constrained[-1])
        )
        new = State(u, v, float(times[-1]), state.external_work + work, dissipated, history, contact_state)
        if not self.conservative:  # trapezium rule for the power of the tools
            tools = 0.5 * step * steps * (before + tool_power(self, new, prepared))
        return replace(new, external_work=new.external_work + tools)

    def _nodal_data(self) -> NodalData:
        """Return the constants of the nodes for the compiled step."""
        return NodalData(
            volumes=self.volumes,
            mass=self.weights * self.material.density,
            density=self.material.density,
            slot=self.slot,
            half_cell=self.half_cell,
        )

    def _saved_history(self) -> tuple[float, tuple[Floats, ...]]:
        """Return the energy [J] dissipated by relaxation since the last restore, and the history variables."""
        return 0.0, ()

    def tractions(self, prepared: PreparedLoads, schedule: LoadHistory, state: State | None = None) -> Floats:
        """Return the surface loads per nodal volume [N/m^3] at the first time of a load history.

        Pressures act on the body as last evaluated. With a state, the forces of foundations and of
        tools in contact are included.
        """
        surface = np.zeros((len(self.cloud), 3))
        surface_force(prepared.sites, schedule, 0, self.volumes, self.slot, self.work.cofactor, surface)
        if state is not None:
            if len(prepared.sites.foundation_node):
                foundation_force(prepared.sites, state.coordinates, state.velocities, self.volumes, surface)
            if state.contact_state is not None:
                surface += state.contact_state.forces / self.volumes[:, None]
        return surface

    def outputs(self, state: State, prepared: PreparedLoads) -> Outputs:
        self._restore_history(state)
        return evaluate(self, state, prepared)

    def acceleration(self, state: State, prepared: PreparedLoads) -> Floats:
        self._restore_history(state)
        schedule = prepared.schedule(np.array([state.time]))
        force = self.force(state.coordinates + self.stiffness_damping * state.velocities)
        force += self.half_cell * self.tractions(prepared, schedule, state)
        acceleration = force / self.material.density + schedule.gravity[0]
        acceleration[prepared.sites.kind == FIXED] = 0.0
        constrained, prescribed = schedule.constrained[0], prepared.sites.prescribed
        if constrained.any():
            rates = prepared.rates(lambda t: prepared.schedule(t).motion, state.time)[1]
            acceleration[prescribed[constrained]] = rates[constrained]
        return acceleration

    def external_force(self, state: State, prepared: PreparedLoads) -> Floats:
        schedule = prepared.schedule(np.array([state.time]))
        if prepared.sites.pressure_node.size:
            self.force(state.coordinates)  # deforms the face of the pressure
        surface = self.tractions(prepared, schedule, state)
        return surface * self.volumes[:, None] + self.masses[:, None] * schedule.gravity[0]

    def displacement(self, state: State, prepared: PreparedLoads, nodes: Nodes = slice(None)) -> Floats:
        return state.coordinates[nodes]

    def velocity(self, state: State, prepared: PreparedLoads, nodes: Nodes = slice(None)) -> Floats:
        return state.velocities[nodes]
