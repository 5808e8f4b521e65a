"""Models whose unknowns are the displacements of the nodes: what solids and membranes share."""

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
from palpate.dynamics.nodal.central_difference import foundation_force, full_step, surface_force
from palpate.dynamics.nodal.stability import FrequencyTracker, StabilityReport, stable_step
from palpate.dynamics.run.contact_state import check_apart, check_pierced, check_way, contact_after, no_contact
from palpate.dynamics.run.model import Model, Nodes, Outputs, State, initial_field
from palpate.dynamics.run.reactions import evaluate, tool_power
from palpate.faults import number_in_range
from palpate.tissue.fibres import FibreLaw

__all__ = ["NodalModel"]


class NodalModel(Model):
    """A body stepped node by node.

    Attributes
    ----------
    body, work : NamedTuples
        What the compiled passes read, and where they write.
    formulation : Formulation
    half_cell : float
        Half the c of the half-cell balance at the boundary.
    held : (n,) bool array
        Nodes of the fixed groups.
    stability : StabilityReport
    fastest : float [m/s]
        About the speed of the fastest waves: a tool that jumps counts as no faster in the viscous forces.
    highest_frequency : FrequencyTracker
    fibres : FibreLaw or None
        With a direction for every node.
    """

    body: Any
    work: Any
    formulation: Formulation
    half_cell: float
    held: NDArray[np.bool_]
    stability: StabilityReport
    wave_speed: float
    highest_frequency: FrequencyTracker
    fibres: FibreLaw | None = None

    def _compile(self, formulation: Formulation, body: Any, work: Any, lanes: Lanes) -> None:
        """Take the compiled passes with what they read and write; called once the cloud and the supports are known."""
        self.formulation, self.body, self.work = formulation, body, work
        self._firm = body if self.fibres is None else body._replace(families=always_taut(body.families))
        self._internal_force, self._advance = internal_force(formulation), full_step(formulation)
        self.slot = np.zeros(len(self.cloud), dtype=np.int64)
        self.slot[lanes.nodes.ravel()] = np.arange(lanes.nodes.size)
        self._scratch = tuple(np.zeros((len(self.cloud), 3)) for _ in range(4))
        self.fixed_mask = self.prepare(()).places.kind != FREE
        self.highest_frequency = FrequencyTracker(self)
        self.wave_speed = np.inf

    def _examined(self, report: StabilityReport) -> None:
        """Take what the examination at rest has found."""
        self.stability, self.stiffness_damping = report, report.used
        self.wave_speed = 0.5 * self.cloud.spacing * report.highest_frequency

    @property
    def weights(self) -> Floats:
        """Weights [m^3] of the inner product in which the nodal forces do their virtual work, shape (n,)."""
        return self.volumes

    def force(self, displacements: Floats) -> Floats:
        """Return the internal force density [N/m^3] at every node for displacements (n, 3) [m]."""
        result = np.zeros((len(self.cloud), 3))
        self._internal_force(np.ascontiguousarray(displacements, dtype=float), self.body, self.work, result)
        return result

    def always_taut_force(self, displacements: Floats) -> Floats:
        """Return the internal force density [N/m^3] by which a stable step is found: that of fibres never slack."""
        result = np.zeros((len(self.cloud), 3))
        self._internal_force(np.ascontiguousarray(displacements, dtype=float), self._firm, self.work, result)
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
        holds = schedule.holds[0]
        fields[0][prepared.places.prescribed[holds]] = schedule.motion[0, holds]
        check_apart(prepared, schedule, fields[0], self.cloud.spacing)
        grasped = len(prepared.places.prescribed) if self.conservative and prepared.grasps else 0
        contact_state = None
        if prepared.tools or grasped:
            contact_state = no_contact(len(prepared.tools), len(self.cloud), time, held=grasped)
        return State(
            fields[0], fields[1], time, history=self._equilibrium_history(fields[0]), contact_state=contact_state
        )

    def _equilibrium_history(self, displacements: Floats) -> tuple[Floats, ...]:
        """Memory of a body that has long been where it is; nothing where it does not relax."""
        return ()

    def _restore_history(self, state: State | None) -> None:
        """Let evaluations start from what a state remembers, or from rest."""

    def stable_step(self, state: State, prepared: PreparedLoads) -> float:
        self._restore_history(state)
        frequency = self.highest_frequency(state.coordinates, prepared.held(state.time))
        return self._step(frequency, prepared)

    def _step(self, frequency: float, prepared: PreparedLoads) -> float:
        """Stable step [s] of a body with a highest frequency [rad/s], with its foundations."""
        places = prepared.places
        if not len(places.foundation_node):
            return stable_step(frequency, self.stiffness_damping)
        response = self.half_cell / (self.volumes[places.foundation_node] * self.material.density)
        count = len(self.cloud)
        squares = np.bincount(places.foundation_node, places.foundation_spring * response, minlength=count).max()
        rates = np.bincount(places.foundation_node, places.foundation_dashpot * response, minlength=count).max()
        highest = float(np.sqrt(frequency**2 + squares))
        return stable_step(highest, self.stiffness_damping + rates / highest**2)

    def advance(self, state: State, prepared: PreparedLoads, step: float, steps: int) -> State:
        number_in_range("step", step, 0.0, open_low=True, unit="s")
        times: Floats = state.time + step * np.arange(steps + 1, dtype=float)
        u, v = state.coordinates.copy(), state.velocities.copy()
        force, previous, surface, at = self._scratch
        schedule = prepared.schedule(times)
        check_way(prepared, schedule, self.cloud.spacing)
        prepared.contacts.total[:], prepared.contacts.given[:], prepared.places.impulses[:] = 0.0, 0.0, 0.0
        surface[:] = 0.0  # of another run's loads
        self._restore_history(state)
        before = 0.0 if self.conservative else tool_power(self, state, prepared)
        work, lost, tools = self._advance(
            u, v, step, self.stiffness_damping, self.wave_speed, self.body, self.work, prepared.places,
            prepared.contacts, schedule,
            self.volumes, self.weights * self.material.density, self.material.density, self.slot, self.half_cell,
            force, previous, surface, at,
        )  # fmt: skip
        if prepared.tools:
            check_pierced(prepared, schedule, u, surface_nodes(self.cloud), self.cloud.spacing)
        relaxed, history = self._saved_history()
        dissipated = state.dissipated + lost + relaxed
        contact_state = (
            None
            if state.contact_state is None
            else contact_after(prepared, state.contact_state, 0.5 * step, schedule.holds[-1])
        )
        new = State(u, v, float(times[-1]), state.external_work + work, dissipated, history, contact_state)
        if not self.conservative:  # trapezium rule for the power of the tools
            tools = 0.5 * step * steps * (before + tool_power(self, new, prepared))
        return replace(new, external_work=new.external_work + tools)

    def _saved_history(self) -> tuple[float, tuple[Floats, ...]]:
        """Energy [J] lost to relaxation since the last recall, and what the body remembers now."""
        return 0.0, ()

    def tractions(self, prepared: PreparedLoads, schedule: LoadHistory, state: State | None = None) -> Floats:
        """Return tractions per nodal volume [N/m^3] at a schedule's first time, on the body as last evaluated.

        With a state, those of foundations and of tools that touch the body, too.
        """
        surface = np.zeros((len(self.cloud), 3))
        surface_force(prepared.places, schedule, 0, self.volumes, self.slot, self.work.cofactor, surface)
        if state is not None:
            if len(prepared.places.foundation_node):
                foundation_force(prepared.places, state.coordinates, state.velocities, self.volumes, surface)
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
        acceleration[prepared.places.kind == FIXED] = 0.0
        holds, prescribed = schedule.holds[0], prepared.places.prescribed
        if holds.any():
            rates = prepared.rates(lambda t: prepared.schedule(t).motion, state.time)[1]
            acceleration[prescribed[holds]] = rates[holds]
        return acceleration

    def external_force(self, state: State, prepared: PreparedLoads) -> Floats:
        schedule = prepared.schedule(np.array([state.time]))
        if prepared.places.pressure_node.size:
            self.force(state.coordinates)  # the body that a pressure follows
        surface = self.tractions(prepared, schedule, state)
        return surface * self.volumes[:, None] + self.masses[:, None] * schedule.gravity[0]

    def displacement(self, state: State, prepared: PreparedLoads, nodes: Nodes = slice(None)) -> Floats:
        return state.coordinates[nodes]

    def velocity(self, state: State, prepared: PreparedLoads, nodes: Nodes = slice(None)) -> Floats:
        return state.velocities[nodes]
