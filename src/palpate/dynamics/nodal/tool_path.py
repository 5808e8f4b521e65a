"""Path of the tool of a full body in a period of the engine, and its contact stiffness, compiled.

A path has the frames (3, 4) of the tool at the start and the end of a period, at zero displacement, before the
period's first step, where it cut the body last, and where the candidates near it were listed last.
"""

from __future__ import annotations

import numpy as np

from palpate.dynamics.compiled.cache import kernel_njit
from palpate.dynamics.material.relaxation import copy_values

START, END, HOME, SAVED, LAST_CUT, LISTED_AT = range(6)  # frames of a path
POSITION, FORCE = 3, 4  # rows of `NodalPeriodData.secant` after those of the matrix
LEAST_WAY = 1e-4  # [m] of the tool between two updates of the contact stiffness


@kernel_njit(inner=True)
def set_path(path, target, at_rest):  # type: ignore[no-untyped-def]
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
def limit_path(path, most):  # type: ignore[no-untyped-def]
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
def limit_to_cut(path, most):  # type: ignore[no-untyped-def]
    """Shorten a way of the tool that leads beyond `most` [m] from its last cut; return True if it did."""
    before, after = 0.0, 0.0
    for i in range(3):
        before += (path[START, i, 3] - path[LAST_CUT, i, 3]) ** 2
        after += (path[END, i, 3] - path[LAST_CUT, i, 3]) ** 2
    if after <= most * most or after <= before:
        return False
    return limit_path(path, max(0.0, most - np.sqrt(before)))


@kernel_njit(inner=True)
def place_tool(path, share, frames):  # type: ignore[no-untyped-def]
    """Move the frame of the tool to a share of its path; the last one becomes that before the step."""
    for i in range(3):
        for j in range(4):
            frames[0, i, j] = frames[1, i, j]
            frames[1, i, j] = path[START, i, j] + share * (path[END, i, j] - path[START, i, j])


@kernel_njit(inner=True)
def frame_way(before, after, reach):  # type: ignore[no-untyped-def]
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
def write_place(path, target):  # type: ignore[no-untyped-def]
    """Write displacement and R - I of the end of the path, from home, into a target (12,)."""
    for i in range(3):
        target[i] = path[END, i, 3] - path[HOME, i, 3]
        for j in range(3):
            value = -1.0 if i == j else 0.0
            for k in range(3):
                value += path[END, i, k] * path[HOME, j, k]
            target[3 + 3 * i + j] = value


@kernel_njit()
def contact_stiffness(data, q, out):  # type: ignore[no-untyped-def]
    """Write the contact stiffness into the first three rows and columns of (12, 12).

    It follows from changes of force and position between calls, by Powell's symmetric Broyden update (in Nonlinear
    Programming, Academic Press 1970): the matrix nearest to the last one that has the observed secant. It is zero
    without contact, and holds along the directions in which the tool has moved.
    """
    secant, position, force = data.secant, data.path[END, :, 3], data.tool_force
    touches = force[0] != 0.0 or force[1] != 0.0 or force[2] != 0.0
    touched = secant[FORCE, 0] != 0.0 or secant[FORCE, 1] != 0.0 or secant[FORCE, 2] != 0.0
    square, along = 0.0, 0.0
    for i in range(3):
        square += (position[i] - secant[POSITION, i]) ** 2
    if touches and touched and square > LEAST_WAY**2:
        for i in range(3):
            along += _excess(secant, position, force, i) * (position[i] - secant[POSITION, i])
        for i in range(3):
            for j in range(i, 3):
                way_i, way_j = position[i] - secant[POSITION, i], position[j] - secant[POSITION, j]
                change = _excess(secant, position, force, i) * way_j + way_i * _excess(secant, position, force, j)
                out[i, j] = secant[i, j] + (change - along * way_i * way_j / square) / square
        for i in range(3):
            for j in range(i, 3):
                secant[i, j], secant[j, i] = out[i, j], out[i, j]
    if not touches:
        for i in range(3):
            for j in range(3):
                secant[i, j] = 0.0
    if not touched or not touches or square > LEAST_WAY**2:
        for i in range(3):
            secant[POSITION, i], secant[FORCE, i] = position[i], force[i]
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = secant[i, j] if i < 3 and j < 3 else 0.0


@kernel_njit(inner=True)
def _excess(secant, position, force, i):  # type: ignore[no-untyped-def]
    """Return component i of the change of force that the present matrix does not explain."""
    value = force[i] - secant[FORCE, i]
    for j in range(3):
        value -= secant[i, j] * (position[j] - secant[POSITION, j])
    return value
