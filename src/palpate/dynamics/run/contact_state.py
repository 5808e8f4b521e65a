"""Checks of rigid tools, and the contact state that a run carries from step to step."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from palpate.core.arrays import Floats, Ints
from palpate.core.faults import DivergenceError, InputError, first_few
from palpate.dynamics.contact.geometry import Contacts, compute_gaps, compute_patch_positions, rotation
from palpate.dynamics.contact.kinds import BLADE, BONDED, PLANE
from palpate.dynamics.contact.penetration import MAX_SURFACE_DEPTH, deepest_triangle
from palpate.dynamics.loads.prepared import LoadHistory, LoadSites, PreparedLoads
from palpate.dynamics.run.model import MANY_STEPS, ContactState

MAX_INITIAL_DEPTH = 1e-2  # penetration of a node at the start of a run, in spacings
MAX_INTERIOR_SHARE = 0.5  # share of a tool's force on interior nodes
MAX_TOOL_STEP = 0.5  # motion of a tool in a step, in its radii
MAX_UNCHECKED_DISTANCE = 0.5  # of a tool between two checks that it has not passed the surface, in spacings


def check_initial_penetration(
    prepared: PreparedLoads, schedule: LoadHistory, displacements: Floats, spacing: float
) -> None:
    """Check that no node is inside a tool at the first time of a load history."""
    if not prepared.tools:
        return
    contacts, depth, positions = prepared.contacts, np.zeros(len(displacements)), np.zeros((len(displacements), 3))
    compute_patch_positions(contacts, np.ascontiguousarray(displacements), positions)
    for t, tool in enumerate(prepared.tools):
        if tool.tool.kind in (BONDED, BLADE):
            continue
        compute_gaps(contacts.tools.kind[t], contacts.tools.sizes[t], schedule.poses[0, t], positions, depth)
        free = schedule.times[0] > contacts.patches.prescribed_until[: len(depth)]
        free[contacts.held.nodes] = True
        if tool.group is not None:  # other nodes may be inside on purpose
            free &= np.isin(
                np.arange(len(free)),
                contacts.candidates.patch[contacts.candidates.start[t] : contacts.candidates.start[t + 1]],
            )
        inside = np.flatnonzero(free & (depth < -MAX_INITIAL_DEPTH * spacing))
        if inside.size:
            raise InputError(
                f"motion of Contact {tool.name!r} must start outside the body, got a depth of "
                f"{-depth[inside].min():.3g} m at nodes {first_few(inside)}; start it outside and move it in"
            )


def check_tool_step(prepared: PreparedLoads, schedule: LoadHistory, spacing: float) -> None:
    """Check that no tool moves so far in one step that it could pass a node."""
    for t, tool in enumerate(prepared.tools):
        radius, half, _ = tool.tool.sizes
        allowed = spacing if tool.tool.kind in (PLANE, BLADE) else MAX_TOOL_STEP * radius
        poses = schedule.poses[:, t]
        angle = 2 * np.arccos(np.clip(np.abs(np.sum(poses[1:, 3:] * poses[:-1, 3:], axis=1)), 0.0, 1.0))
        distance = np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1) + half * angle
        if distance.max(initial=0.0) > allowed:
            worst = int(np.argmax(distance))
            raise InputError(
                f"motion of Contact {tool.name!r} must be at most {allowed:.3g} m in a step, got "
                f"{distance[worst]:.3g} m after t = {schedule.times[worst]:.4g} s; move it more slowly"
            )


def check_penetration(
    prepared: PreparedLoads,
    contacts: Contacts,
    schedule: LoadHistory,
    displacements: Floats,
    surface: tuple[NDArray[np.int64], Ints],
    spacing: float,
    step: float,
) -> None:
    """Check that no tool has passed between the nodes of the surface at the last time of a load history.

    No triangle of the surface may be deeper in a tool than `MAX_SURFACE_DEPTH`. A tool that presses deep also acts on
    interior nodes below a stretched surface; after passing through, it acts mostly on them.

    The displacements are (n, 3) [m]. `surface` has the nodes (s,) that tools can touch, and triangles (t, 3).
    """
    frame = np.zeros((3, 4))
    for t, tool in enumerate(prepared.tools):
        if tool.group is not None or tool.tool.kind in (BLADE, PLANE):
            continue
        of_tool = slice(contacts.candidates.start[t], contacts.candidates.start[t + 1])
        nodes, impulses = (
            contacts.candidates.patch[of_tool],
            np.linalg.norm(contacts.work.patch_impulses[of_tool, :3], axis=1),
        )
        below = ~np.isin(nodes, surface[0]) & (nodes < len(displacements))
        borne = float(np.linalg.norm(contacts.held.forces, axis=1).sum()) * step
        through = impulses[below].sum() > MAX_INTERIOR_SHARE * (impulses.sum() + borne)
        rotation(schedule.poses[-1, t], frame)
        depth, triangle = deepest_triangle(contacts, t, frame, surface[1], displacements, MAX_SURFACE_DEPTH * spacing)
        if through or triangle >= 0:
            node = nodes[below][np.argmax(impulses[below])] if through else surface[1][triangle, 0]
            deep = "" if through else f", where the surface is {1e3 * depth:.3g} mm inside it"
            raise DivergenceError(
                f"Contact {tool.name!r} passed between the nodes of the surface by t = {schedule.times[-1]:.4g} s at "
                f"node {node}{deep}; use a larger tool, a finer spacing, or press less"
            )


def steps_between_checks(prepared: PreparedLoads, time: float, step: float, spacing: float) -> int:
    """Return the most steps [s] of one call, in which no tool moves far enough to pass the surface unnoticed."""
    if not prepared.tools:
        return MANY_STEPS
    times = time + step * np.array([0.0, 1.0, 10.0, 50.0])
    poses = np.stack([tool.poses(times)[:, :3] for tool in prepared.tools])
    distances = np.linalg.norm(np.diff(poses, axis=1), axis=2).max(axis=0)
    distance = float((distances / np.diff(times)).max()) * step
    return max(1, int(MAX_UNCHECKED_DISTANCE * spacing / distance)) if distance > 0 else MANY_STEPS


def initial_contact_state(tools: int, nodes: int, time: float, surface: int = 0, prescribed: int = 0) -> ContactState:
    """Return the state of tools without contact at a time [s].

    `surface` is the number of surface nodes of a reduced model. `prescribed` is the number of nodes of prescribed
    motion, if a `Grasp` is among the loads.
    """
    return ContactState(
        forces=np.zeros((nodes, 3)),
        impulses=np.zeros((tools, 6)),
        start_time=time,
        nodal_impulses=np.zeros((nodes, 3)),
        surface_positions=np.zeros((tools, surface, 3)),
        surface_forces=np.zeros((tools, surface, 3)),
        constraint_impulses=np.zeros((prescribed, 3)),
    )


def next_contact_state(
    prepared: PreparedLoads,
    after_steps: tuple[LoadSites, Contacts],
    before: ContactState,
    kick: float,
    constrained: NDArray[np.bool_],
) -> ContactState:
    """Return the contact state after a call of some steps, the last of which had a kick of a length [s].

    The scratch arrays of `after_steps` are those that the steps have written. `constrained` (p,) are prescribed nodes
    that were constrained in that kick. Impulses of other tools on them act on the constraint.
    """
    (sites, contacts), after = after_steps, before
    if prepared.tools:
        held_record, forces = contacts.held, contacts.work.step_impulses / kick
        nodal_impulses = before.nodal_impulses + contacts.work.nodal_impulses
        forces[held_record.nodes] += held_record.forces
        nodal_impulses[held_record.nodes] += held_record.impulses
        after = before._replace(
            forces=forces,
            impulses=before.impulses + contacts.work.tool_impulses,
            nodal_impulses=nodal_impulses,
            held_energy=float(held_record.energy.sum()),
            held_pushes=held_record.pushes,
        )
    if not len(before.constraint_impulses):
        return after
    on_constraint = contacts.work.nodal_impulses[sites.prescribed] * constrained[:, None] if prepared.tools else 0.0
    return after._replace(constraint_impulses=before.constraint_impulses + sites.impulses - on_constraint)
