"""Paths of the tools of a full body in a period of the engine, and their contact stiffness, compiled.

The path of a tool has its frames (3, 4) at the start and the end of a period, at zero displacement, before the period's
first step, where it cut the body last, and where the candidates near it were listed last.
"""

from __future__ import annotations

import numpy as np

from palpate.dynamics.compiled.cache import kernel_njit
from palpate.dynamics.material.relaxation import copy_values

START, END, HOME, SAVED, LAST_CUT, LISTED_AT = range(6)  # frames of a path
LAST_POSITIONS, LAST_FORCES, EXCESS_FORCES = range(3)  # rows of `MovingTools.secant` after those of the matrix
LEAST_WAY = 1e-4  # [m] of the tool between two updates of the contact stiffness


@kernel_njit(inner=True)
def set_path(path, target, at_rest):
    """Set the frames of the tool for a period that ends at a target (12,): displacement and R - I, from home."""
    copy_values(path[END], path[START])
    for i in range(3):
        for j in range(3):
            value = 0.0
            for k in range(3):
                value += (target[3 + 3 * i + k] + (1.0 if i == k else 0.0)) * path[HOME, k, j]
            path[END, i, j] = value
        path[END, i, 3] = path[HOME, i, 3] + target[i]
    if at_rest:
        copy_values(path[END], path[START])


@kernel_njit(inner=True)
def limit_path(path, most):
    """Shorten the way of the tool to `most` [m]; return True if it was longer."""
    square = 0.0
    for i in range(3):
        square += (path[END, i, 3] - path[START, i, 3]) ** 2
    if square <= most * most:
        return False
    share = most / np.sqrt(square)
    for i in range(3):
        for j in range(4):
            path[END, i, j] = path[START, i, j] + share * (path[END, i, j] - path[START, i, j])
    for j in range(3):  # a mean of rotations is none: orthonormal columns (Gram and Schmidt)
        for k in range(j):
            along = 0.0
            for i in range(3):
                along += path[END, i, j] * path[END, i, k]
            for i in range(3):
                path[END, i, j] -= along * path[END, i, k]
        length = 0.0
        for i in range(3):
            length += path[END, i, j] ** 2
        for i in range(3):
            path[END, i, j] /= np.sqrt(length)
    return True


@kernel_njit(inner=True)
def limit_to_cut(path, most):
    """Shorten a way of the tool that leads beyond `most` [m] from its last cut; return True if it did."""
    before, after = 0.0, 0.0
    for i in range(3):
        before += (path[START, i, 3] - path[LAST_CUT, i, 3]) ** 2
        after += (path[END, i, 3] - path[LAST_CUT, i, 3]) ** 2
    if after <= most * most or after <= before:
        return False
    return limit_path(path, max(0.0, most - np.sqrt(before)))


@kernel_njit(inner=True)
def place_tools(paths, share, frames):
    """Move the frames of the tools to a share of their paths; the last ones become those before the step."""
    for t in range(paths.shape[0]):
        for i in range(3):
            for j in range(4):
                frames[t, 0, i, j] = frames[t, 1, i, j]
                frames[t, 1, i, j] = paths[t, START, i, j] + share * (paths[t, END, i, j] - paths[t, START, i, j])


@kernel_njit(inner=True)
def frame_way(before, after, reach):
    """Return a bound of the way [m] of a tool's points up to a distance `reach` [m] from its origin.

    It is infinite for a tool of infinite reach that turns.
    """
    moved, turned = 0.0, 0.0
    for i in range(3):
        moved += (after[i, 3] - before[i, 3]) ** 2
        for j in range(3):
            turned += (after[i, j] - before[i, j]) ** 2
    return np.sqrt(moved) + (np.sqrt(turned) * reach if turned > 0.0 else 0.0)


@kernel_njit(inner=True)
def write_place(path, target):
    """Write displacement and R - I of the end of the path, from home, into a target (12,)."""
    for i in range(3):
        target[i] = path[END, i, 3] - path[HOME, i, 3]
        for j in range(3):
            value = -1.0 if i == j else 0.0
            for k in range(3):
                value += path[END, i, k] * path[HOME, j, k]
            target[3 + 3 * i + j] = value


@kernel_njit()
def contact_stiffness(data, q, out):
    """Write the contact stiffness of each tool into the first three rows and columns of its part of (12 t, 12).

    It follows from changes of forces and positions between calls, by Powell's symmetric Broyden update (in Nonlinear
    Programming, Academic Press 1970): the matrix of all tools nearest to the last one that has the observed secant. It
    is zero without contact, and holds along the directions in which the tools have moved.
    """
    secant, path, forces = data.tools.secant, data.tools.path, data.tools.force
    tools = path.shape[0]
    count, touches, same, square, along = 3 * tools, False, True, 0.0, 0.0
    for t in range(tools):
        last = secant[count + LAST_FORCES, 3 * t : 3 * t + 3]
        touched = last[0] != 0.0 or last[1] != 0.0 or last[2] != 0.0
        touches, same = touches or _touches(forces, t), same and touched == _touches(forces, t)
    for i in range(count):
        square += _way(secant, path, forces, i) ** 2
    if touches and same and square > LEAST_WAY**2:
        for i in range(count):  # the change of force that the present matrix does not explain
            secant[count + EXCESS_FORCES, i] = forces[12 * (i // 3) + i % 3] - secant[count + LAST_FORCES, i]
            for j in range(count):
                secant[count + EXCESS_FORCES, i] -= secant[i, j] * _way(secant, path, forces, j)
        for i in range(count):
            along += secant[count + EXCESS_FORCES, i] * _way(secant, path, forces, i)
        for i in range(count):
            for j in range(i, count):
                way_i, way_j = _way(secant, path, forces, i), _way(secant, path, forces, j)
                change = secant[count + EXCESS_FORCES, i] * way_j + way_i * secant[count + EXCESS_FORCES, j]
                secant[i, j] += (change - along * way_i * way_j / square) / square
        for i in range(count):
            for j in range(i):
                secant[i, j] = secant[j, i]
    for i in range(count):
        for j in range(count):
            if not (_touches(forces, i // 3) and _touches(forces, j // 3)):
                secant[i, j] = 0.0
    if not touches or not same or square > LEAST_WAY**2:
        for i in range(count):
            secant[count + LAST_POSITIONS, i] = path[i // 3, END, i % 3, 3]
            secant[count + LAST_FORCES, i] = forces[12 * (i // 3) + i % 3]
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            t, row = i // 12, i % 12
            out[i, j] = secant[3 * t + row, 3 * t + j] if row < 3 and j < 3 else 0.0


@kernel_njit(inner=True)
def _touches(forces, t):
    """Return whether a tool has a force on the body."""
    return forces[12 * t] != 0.0 or forces[12 * t + 1] != 0.0 or forces[12 * t + 2] != 0.0


@kernel_njit(inner=True)
def _way(secant, path, forces, i):
    """Return component i of the displacements of the tools since the last update; zero for those that do not touch."""
    if not _touches(forces, i // 3):
        return 0.0
    return path[i // 3, END, i % 3, 3] - secant[3 * path.shape[0] + LAST_POSITIONS, i]
