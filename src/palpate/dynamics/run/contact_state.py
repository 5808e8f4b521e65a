"""Checks of tools that touch a body, and what a run keeps of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from palpate.arrays import Floats
from palpate.dynamics.contact.geometry import gaps, patch_places
from palpate.dynamics.contact.tools import BONDED, PLANE
from palpate.dynamics.loads.prepared import LoadHistory, PreparedLoads
from palpate.dynamics.run.model import ContactState
from palpate.faults import DivergenceError, InputError, first_few

__all__ = ["check_apart", "check_pierced", "check_way", "contact_after", "no_contact"]


INSIDE = 1e-2  # of the spacing: how far inside a tool a node may be when a run begins
PIERCED = 0.5  # of a tool's force: more of it on nodes of the body's inside, and it is no longer on the surface
SUNK = 0.5  # of the spacing: how far inside a tool a node of the surface may be, whose patch keeps out
WAY = 0.5  # of a tool's radius: how far it may move in a step


def check_apart(prepared: PreparedLoads, schedule: LoadHistory, displacements: Floats, spacing: float) -> None:
    """Refuse tools that have nodes inside them at a schedule's first time.

    Raises
    ------
    InputError
        Names the tool, the nodes and the depth.
    """
    if not prepared.tools:
        return
    contacts, depth, places = prepared.contacts, np.zeros(len(displacements)), np.zeros((len(displacements), 3))
    patch_places(contacts, np.ascontiguousarray(displacements), places)
    for t, tool in enumerate(prepared.tools):
        if tool.tool.kind == BONDED:
            continue
        gaps(contacts.kind[t], contacts.sizes[t], schedule.poses[0, t], places, depth)
        free = schedule.times[0] > contacts.prescribed_until
        if tool.group is not None:  # others may be inside by intention
            free &= np.isin(np.arange(len(free)), contacts.nodes[contacts.start[t] : contacts.start[t + 1]])
        inside = np.flatnonzero(free & (depth < -INSIDE * spacing))
        if inside.size:
            raise InputError(
                f"Contact {tool.name!r} starts {-depth[inside].min():.3g} m inside the body, at nodes "
                f"{first_few(inside)}: start it outside and move it in"
            )


def check_way(prepared: PreparedLoads, schedule: LoadHistory, spacing: float) -> None:
    """Refuse tools that move so far in one step that they could pass a node.

    Raises
    ------
    InputError
        Names the tool, the time and the way.
    """
    for t, tool in enumerate(prepared.tools):
        radius, half, _ = tool.tool.sizes
        most = spacing if tool.tool.kind == PLANE else WAY * radius
        poses = schedule.poses[:, t]
        turned = 2 * np.arccos(np.clip(np.abs(np.sum(poses[1:, 3:] * poses[:-1, 3:], axis=1)), 0.0, 1.0))
        way = np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1) + half * turned
        if way.max(initial=0.0) > most:
            worst = int(np.argmax(way))
            raise InputError(
                f"Contact {tool.name!r} moves {way[worst]:.3g} m in the step after t = {schedule.times[worst]:.4g} s: "
                f"allowed is {most:.3g} m; move it without a jump, or slower"
            )


def check_pierced(
    prepared: PreparedLoads, schedule: LoadHistory, displacements: Floats, surface: NDArray[np.int64], spacing: float
) -> None:
    """Refuse tools that have slipped in between the nodes of the surface by a schedule's last time.

    A tool that presses deep meets nodes below a stretched surface too; one that is through meets mostly them, or has
    nodes of the surface far inside it, though the patches about them are not.

    Raises
    ------
    DivergenceError
        Names the tool, the time and a node.
    """
    contacts, depth = prepared.contacts, np.zeros(len(displacements))
    for t, tool in enumerate(prepared.tools):
        if tool.group is not None:
            continue
        own = slice(contacts.start[t], contacts.start[t + 1])
        nodes, sizes = contacts.nodes[own], np.linalg.norm(contacts.pushes[own, :3], axis=1)
        below = ~np.isin(nodes, surface)
        gaps(contacts.kind[t], contacts.sizes[t], schedule.poses[-1, t], contacts.points + displacements, depth)
        depth[schedule.times[-1] <= contacts.prescribed_until] = 0.0
        deepest = int(np.argmin(depth))
        through = sizes[below].sum() > PIERCED * sizes.sum()
        if through or depth[deepest] < -SUNK * spacing:
            node = nodes[below][np.argmax(sizes[below])] if through else deepest
            raise DivergenceError(
                f"Contact {tool.name!r} slipped in between the nodes of the surface by t = {schedule.times[-1]:.4g} s: "
                f"node {node} is beside or inside it. Use a larger tool, a finer spacing, or press less"
            )


def no_contact(tools: int, nodes: int, time: float, surface: int = 0, held: int = 0) -> ContactState:
    """Return what tools do that do not touch, at a time [s].

    `surface` is a reduced model's number of surface nodes, `held` how many nodes are driven where a `Grasp` holds some.
    """
    forces, given, nothing = np.zeros((nodes, 3)), np.zeros((nodes, 3)), np.zeros((tools, surface, 3))
    return ContactState(forces, np.zeros((tools, 6)), time, given, nothing, nothing, np.zeros((held, 3)))


def contact_after(prepared: PreparedLoads, before: ContactState, last: float, holds: NDArray[np.bool_]) -> ContactState:
    """Return what the tools do after a call of some steps, the last kick of which took a time `last` [s].

    In it, `holds` tells which of the driven nodes were held: what tools gave those, the others had to bear.
    """
    contacts, places, after = prepared.contacts, prepared.places, before
    if prepared.tools:
        impulses, given = before.impulses + contacts.total, before.given + contacts.given
        after = before._replace(forces=contacts.impulse / last, impulses=impulses, given=given)
    if not len(before.constraint_impulses):
        return after
    borne = contacts.given[places.prescribed] * holds[:, None] if prepared.tools else 0.0
    return after._replace(constraint_impulses=before.constraint_impulses + places.impulses - borne)
