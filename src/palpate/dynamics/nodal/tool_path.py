"""Paths of the tools of a full body in a period of the engine, compiled.

The path of a tool has its frames (3, 4) at the start and the end of a period, at zero displacement, before the period's
first step, where it cut the body last, and where the candidates near it were listed last.
"""

from __future__ import annotations

import numpy as np

from palpate.compiled.jit import kernel_njit
from palpate.dynamics.material.relaxation import copy_values

START, END, HOME, SAVED, LAST_CUT, LISTED_AT = range(6)  # frames of a path


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
