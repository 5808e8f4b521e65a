"""Rigid tools on the contact surface of a reduced body: their poses, contact states and forces in a run."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from palpate.core.arrays import Floats, Ints
from palpate.core.faults import DivergenceError
from palpate.dynamics.contact.tools import Forceps
from palpate.dynamics.loads.prepared import PreparedLoads
from palpate.dynamics.run.contact_state import check_initial_penetration, check_tool_step, initial_contact_state
from palpate.dynamics.run.model import ContactState
from palpate.reduction.contact.compliance import SurfaceCompliance, contact_displacements
from palpate.reduction.contact.penetration import MAX_DEPTH_BETWEEN_NODES, store_depths
from palpate.reduction.contact.surface import ContactScratch, ContactSurface, RigidTools, contact_scratch, rigid_tools


class ContactTools:
    """Tools on the contact surface of a reduced model."""

    def __init__(self, contact_surface: ContactSurface, prepared: PreparedLoads) -> None:
        self.contact_surface, self.prepared = contact_surface, prepared
        self.tools: RigidTools = rigid_tools(prepared, contact_surface)
        self.scratch: ContactScratch = contact_scratch(contact_surface, len(prepared.tools))

    def initial_state(self, displacements: Callable[[], Floats], time: float, spacing: float) -> ContactState | None:
        """Return the contact state at the start of a run, without forces; refuse tools inside the body."""
        if not self.prepared.tools:
            return None
        schedule = self.prepared.schedule(np.array([time]))
        moved = displacements()
        check_initial_penetration(self.prepared, schedule, moved, spacing)
        return initial_contact_state(len(self.prepared.tools), len(moved), time, len(self.contact_surface.nodes))

    def poses(self, times: Floats, before: ContactState | None, spacing: float) -> Floats:
        """Return the poses (s, t, 7) of the tools at the times of some steps, and load the contact state."""
        if before is None:
            return np.zeros((0, 0, 7))
        schedule = self.prepared.schedule(times)
        check_tool_step(self.prepared, schedule, spacing)
        scratch = self.scratch
        scratch.force[:], scratch.place[:], scratch.busy[:] = before.surface_forces, before.surface_positions, True
        self.tools.impulses[:], self.tools.nodal_impulses[:], self.tools.held.impulses[:] = 0.0, 0.0, 0.0
        for t, tool in enumerate(self.prepared.tools):
            if isinstance(tool.tool, Forceps):
                schedule.poses[times > tool.tool.until * (1 + 1e-9), t] = np.nan
        return schedule.poses

    def check_penetration(self, time: float) -> None:
        """Check that no tool has passed between the nodes in the last step, which ended at a time [s]."""
        store_depths(self.contact_surface, self.scratch, self.tools)
        for tool, depth in zip(self.prepared.tools, self.scratch.depth, strict=True):
            if depth > MAX_DEPTH_BETWEEN_NODES * self.contact_surface.spacing:
                raise DivergenceError(
                    f"Contact {tool.name!r} passed between the nodes of the surface by t = {time:.4g} s, where the "
                    f"surface is {1e3 * depth:.3g} mm inside it; use a larger tool, a finer spacing, or press less"
                )

    def final_state(self, before: ContactState | None) -> ContactState | None:
        """Return the contact state after some steps."""
        if before is None:
            return None
        nodes = self.contact_surface.nodes
        forces, nodal_impulses = np.zeros_like(before.forces), before.nodal_impulses.copy()
        forces[nodes] = self.scratch.force.sum(axis=0)
        nodal_impulses[nodes] += self.tools.nodal_impulses
        pressed = self.tools.held
        forces[pressed.nodes] += pressed.forces
        nodal_impulses[pressed.nodes] += pressed.impulses
        return ContactState(
            forces, before.impulses + self.tools.impulses, before.start_time, nodal_impulses,
            self.scratch.place.copy(), self.scratch.force.copy(), before.constraint_impulses,
            float(pressed.energy.sum()), pressed.pushes.copy(),
        )  # fmt: skip


def tool_displacements(
    compliance: SurfaceCompliance | None,
    points: Floats,
    contact_surface: ContactSurface,
    contact_state: ContactState | None,
    prepared: PreparedLoads,
) -> tuple[Floats, Floats]:
    """Return displacements (n, 3) [m] of the surface compliance, and its energies (t,) [J] under tools, of a state."""
    if contact_state is None or compliance is None:
        return np.zeros((len(points), 3)), np.zeros(len(prepared.tools))
    pushes = np.zeros((len(contact_state.surface_forces), len(points), 3))
    pushes[:, contact_surface.nodes] = contact_state.surface_forces
    bonded = [isinstance(tool.tool, Forceps) for tool in prepared.tools]
    return contact_displacements(compliance, points, pushes[:, compliance.nodes], bonded)


def bonded_nodes(contact_surface: ContactSurface, contact_state: ContactState | None, prepared: PreparedLoads) -> Ints:
    """Return the nodes that forceps hold."""
    if contact_state is None:
        return contact_surface.nodes[:0]
    forceps = np.array([isinstance(tool.tool, Forceps) for tool in prepared.tools], dtype=bool)
    return np.asarray(contact_surface.nodes[contact_state.surface_forces[forceps].any(axis=(0, 2))])
