"""Compiled grip of forceps on the nodes of a full body in the engine.

The nodes that forceps hold move with the tool as parts of a rigid body, in the places that they have
when they are grasped. After the kick of all other forces, an impulse gives each node the velocity that
brings it to its place at the end of the step (`palpate.dynamics.loads.prescribed_motion` in runs).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from palpate.compiled.jit import kernel_njit
from palpate.core.arrays import Floats, Ints
from palpate.core.faults import InputError
from palpate.dynamics.contact.tools import Forceps, surface_nodes
from palpate.meshfree.cloud import MOVED_MARGIN, Cloud

COUNT, FRESH = range(2)  # entries of `Grip.numbers`


class Grip(NamedTuple):
    """Nodes that forceps hold, for each of t tools."""

    numbers: Ints  # (t, 2) array: number of nodes, and 1 until the first period has set their places
    node: Ints  # (t, n) array
    place: Floats  # (t, n, 3) array [m]: positions in the tool's frame
    before: Floats  # (t, n, 3) array [m/s]: velocities before the kick
    impulse: Floats  # (t, n, 3) array [N s]: of the tool on the nodes in the last step


def empty_grip(tools: int, nodes: int) -> Grip:
    """Return a grip of tools that hold nothing, of a body with a number of nodes."""
    numbers, node = np.zeros((tools, 2), dtype=np.int64), np.zeros((tools, nodes), dtype=np.int64)
    return Grip(numbers, node, *np.zeros((3, tools, nodes, 3)))


def nodes_in_grip(grip: Grip) -> Ints:
    """Return the nodes that any forceps hold."""
    return np.concatenate([node[:count] for node, (count, _) in zip(grip.node, grip.numbers, strict=True)])


def grasped_nodes(cloud: Cloud, forceps: Forceps, free: Ints) -> Ints:
    """Return the surface nodes within the radius of forceps, at rest.

    `free` (n,) is True for nodes that no support holds in any direction.
    """
    point = np.zeros(cloud.points.shape[1])
    point[:] = np.asarray(forceps.point, dtype=float)[: len(point)]
    near = np.linalg.norm(cloud.points - point, axis=1) <= forceps.radius * (1 + 1e-9) + MOVED_MARGIN * cloud.spacing
    nodes = np.intersect1d(np.flatnonzero(near), surface_nodes(cloud))
    if not nodes.size:
        raise InputError(
            f"point of forceps must be within {1e3 * forceps.radius:.3g} mm of a surface node, got none; "
            "move the point or use a larger radius"
        )
    if not free[nodes].all():
        raise InputError("point of forceps must be away from supports, got nodes that a support holds; move the point")
    return nodes


def set_grip(grip: Grip, tool: int, nodes: Ints) -> None:
    """Hold nodes with a tool from the next period on, in the places that they have then."""
    grip.numbers[tool] = len(nodes), 1
    grip.node[tool, : len(nodes)] = nodes


@kernel_njit(inner=True)
def begin_grip(grip, points, u, frames):
    """Set the places of nodes that were just grasped, for the present frames (t, 2, 3, 4) of the tools."""
    for t in range(grip.numbers.shape[0]):
        if grip.numbers[t, FRESH] == 0:
            continue
        grip.numbers[t, FRESH], frame, place = 0, frames[t, 1], grip.place[t]
        for k in range(grip.numbers[t, COUNT]):
            i = grip.node[t, k]
            for c in range(3):
                place[k, c] = 0.0
                for d in range(3):
                    place[k, c] += frame[d, c] * (points[i, d] + u[i, d] - frame[d, 3])


@kernel_njit(inner=True)
def store_velocities(grip, velocity):
    """Copy the velocities of the nodes before the kick."""
    for t in range(grip.numbers.shape[0]):
        for k in range(grip.numbers[t, COUNT]):
            for c in range(3):
                grip.before[t, k, c] = velocity[grip.node[t, k], c]


@kernel_njit(inner=True)
def hold_nodes(grip, contacts, nodes, surface, alpha, step, u, velocity):
    """Give the nodes the velocities that bring them to their places after their kick.

    Adds the impulses and their moments about the tools' origins to `contacts.work.tool_impulses`, and sets the nodes'
    impulses in this step to zero, so that those of other tools are added next.

    Returns two energies [J]: the work of the tools with the change of that of surface loads, and the change of the loss
    by alpha M. The kick counted both with its own velocities.
    """
    work, lost, points = 0.0, 0.0, contacts.patches.points
    for t in range(grip.numbers.shape[0]):
        frame, sums, place, before = (
            contacts.work.frames[t, 1],
            contacts.work.tool_impulses[t],
            grip.place[t],
            grip.before[t],
        )
        impulse = grip.impulse[t]
        for k in range(grip.numbers[t, COUNT]):
            i = grip.node[t, k]
            for c in range(3):
                arm = frame[c, 0] * place[k, 0] + frame[c, 1] * place[k, 1] + frame[c, 2] * place[k, 2]
                wanted = (arm + frame[c, 3] - points[i, c] - u[i, c]) / step
                push = nodes.mass[i] * (1.0 + 0.5 * alpha * step) * (wanted - velocity[i, c])
                # means of the velocities before the kick, and after it or after all impulses
                kicked, mean = 0.5 * (before[k, c] + velocity[i, c]), 0.5 * (before[k, c] + wanted)
                work += push * mean + step * nodes.volumes[i] * surface[i, c] * (mean - kicked)
                lost += alpha * step * nodes.mass[i] * (mean + kicked) * (mean - kicked)
                velocity[i, c] = wanted
                impulse[k, c] = push
                contacts.work.step_impulses[i, c] = 0.0
                sums[c] += push
            for c in range(3):
                a, b = (c + 1) % 3, (c + 2) % 3
                arm_a = points[i, a] + u[i, a] + step * velocity[i, a] - frame[a, 3]
                arm_b = points[i, b] + u[i, b] + step * velocity[i, b] - frame[b, 3]
                sums[3 + c] += arm_a * impulse[k, b] - arm_b * impulse[k, a]
    return work, lost


@kernel_njit(inner=True)
def bear_impulses(grip, contacts, step, u, velocity):
    """Let the forceps bear what other tools push on their nodes, and set the nodes' impulses in this step.

    Returns the work [J] of the forceps.
    """
    work, points, pushes = 0.0, contacts.patches.points, contacts.work.step_impulses
    for t in range(grip.numbers.shape[0]):
        frame, sums = contacts.work.frames[t, 1], contacts.work.tool_impulses[t]
        for k in range(grip.numbers[t, COUNT]):
            i = grip.node[t, k]
            for c in range(3):
                a, b = (c + 1) % 3, (c + 2) % 3
                arm_a = points[i, a] + u[i, a] + step * velocity[i, a] - frame[a, 3]
                arm_b = points[i, b] + u[i, b] + step * velocity[i, b] - frame[b, 3]
                sums[c] -= pushes[i, c]
                sums[3 + c] -= arm_a * pushes[i, b] - arm_b * pushes[i, a]
                work -= pushes[i, c] * velocity[i, c]
            for c in range(3):
                together = grip.impulse[t, k, c]
                grip.impulse[t, k, c] -= pushes[i, c]
                pushes[i, c] = together
    return work
