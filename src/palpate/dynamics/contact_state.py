"""Checks of tools that touch a body, and what a run keeps of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from palpate.dynamics.contact import gaps, patch_places
from palpate.dynamics.loads import Drive, Schedule
from palpate.dynamics.model import Touch
from palpate.dynamics.tools import PLANE
from palpate.faults import DivergenceError, InputError, first_few

__all__ = ["check_apart", "check_pierced", "check_way", "touched", "untouched"]

Floats = NDArray[np.float64]

INSIDE = 1e-2  # of the spacing: how far inside a tool a node may be when a run begins
PIERCED = 0.05  # of the spacing: how far inside a tool a node of the body's inside may come
SUNK = 0.5  # the same of a node of the surface, whose patch keeps out
WAY = 0.5  # of a tool's radius: how far it may move in a step


def check_apart(drive: Drive, schedule: Schedule, displacements: Floats, spacing: float) -> None:
    """Refuse tools that have nodes inside them at a schedule's first time.

    Raises
    ------
    InputError
        Names the tool, the nodes and the depth.
    """
    if not drive.tools:
        return
    contacts, depth, places = drive.contacts, np.zeros(len(displacements)), np.zeros((len(displacements), 3))
    patch_places(contacts, np.ascontiguousarray(displacements), places)
    for t, tool in enumerate(drive.tools):
        gaps(contacts.kind[t], contacts.sizes[t], schedule.poses[0, t], places, depth)
        free = schedule.times[0] > contacts.held_until
        if tool.group is not None:  # others may be inside by intention
            free &= np.isin(np.arange(len(free)), contacts.nodes[contacts.start[t] : contacts.start[t + 1]])
        inside = np.flatnonzero(free & (depth < -INSIDE * spacing))
        if inside.size:
            raise InputError(
                f"Contact {tool.name!r} starts {-depth[inside].min():.3g} m inside the body, at nodes "
                f"{first_few(inside)}: start it outside and move it in"
            )


def check_way(drive: Drive, schedule: Schedule, spacing: float) -> None:
    """Refuse tools that move so far in one step that they could pass a node.

    Raises
    ------
    InputError
        Names the tool, the time and the way.
    """
    for t, tool in enumerate(drive.tools):
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


def check_pierced(drive: Drive, schedule: Schedule, displacements: Floats, spacing: float) -> None:
    """Refuse tools that have slipped in between the nodes of the surface by a schedule's last time.

    Raises
    ------
    DivergenceError
        Names the tool, the time and a node that is inside it.
    """
    contacts, depth = drive.contacts, np.zeros(len(displacements))
    for t, tool in enumerate(drive.tools):
        if tool.group is not None:
            continue
        gaps(contacts.kind[t], contacts.sizes[t], schedule.poses[-1, t], contacts.points + displacements, depth)
        allowed = np.where(schedule.times[-1] > contacts.held_until, PIERCED * spacing, np.inf)
        surface = contacts.nodes[contacts.start[t] : contacts.start[t + 1]]
        allowed[surface] = np.maximum(allowed[surface], SUNK * spacing)
        worst = int(np.argmin(depth + allowed))
        if depth[worst] < -allowed[worst]:
            raise DivergenceError(
                f"Contact {tool.name!r} slipped in between the nodes of the surface by t = {schedule.times[-1]:.4g} s: "
                f"node {worst} is {-depth[worst]:.3g} m inside it. Use a larger tool, a finer spacing, or press less"
            )


def untouched(tools: int, nodes: int, time: float, surface: int = 0) -> Touch:
    """Return what tools do that do not touch, at a time [s]; `surface` is a reduced model's number of surface nodes."""
    nothing = np.zeros((tools, surface, 3))
    return Touch(np.zeros((nodes, 3)), np.zeros((tools, 6)), time, np.zeros((nodes, 3)), nothing, nothing)


def touched(drive: Drive, before: Touch, last: float) -> Touch:
    """Return what the tools do after a call of some steps, the last kick of which took a time `last` [s]."""
    contacts = drive.contacts
    impulses, given = before.impulses + contacts.total, before.given + contacts.given
    return before._replace(forces=contacts.impulse / last, impulses=impulses, given=given)
