"""Rigid poses of a tool: a position (3,) [m] and a unit quaternion (4,), w x y z, in one array (7,)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.faults import InputError
from palpate.files import shortened

__all__ = ["FARTHEST", "IDENTITY", "checked_pose", "follow", "tool_coordinates", "wrench"]

Floats = NDArray[np.float64]

IDENTITY = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
FARTHEST = 1.0  # [m], between one pose and the next: more is a device that lost its place


def checked_pose(
    position: Floats | Sequence[float], quaternion: Floats | Sequence[float], last: Floats | None
) -> Floats:
    """Return a pose (7,), the quaternion made a unit one.

    Raises
    ------
    InputError
        An entry is not a finite real number, the quaternion has no length, or the position is more than `FARTHEST` from
        the last one, if there is one.
    """
    place, turn = _numbers("position", position, 3), _numbers("quaternion", quaternion, 4)
    length = float(np.abs(turn).max())
    if length == 0:
        raise InputError("a quaternion of length 0 is no rotation; (1, 0, 0, 0) turns nothing; the last pose is kept")
    jump = 0.0 if last is None else float(np.linalg.norm(place - last[:3]))
    if jump > FARTHEST:
        raise InputError(
            f"the pose jumps by {jump:.3g} m at once: allowed is {FARTHEST:g} m; the last pose is kept. "
            "Positions are in metres, from where the tool stands at rest"
        )
    turn = turn / length  # first by the largest, lest squares overflow
    return np.concatenate([place, turn / np.linalg.norm(turn)])


def _numbers(name: str, given: Any, count: int) -> Floats:
    """Return finite real numbers (count,)."""
    try:
        found = np.asarray(given)
    except ValueError:  # lists of several lengths
        found = np.array(None)
    if found.shape != (count,) or found.dtype.kind not in "fiu":
        raise InputError(f"{name} must be {count} real numbers, got {shortened(repr(given))}; the last pose is kept")
    numbers = found.astype(float)
    if not np.isfinite(numbers).all():
        raise InputError(f"{name} must be finite, got {numbers}; the last pose is kept")
    return numbers


@njit(cache=True)
def follow(pose, aim, most_way, most_angle):  # type: ignore[no-untyped-def]
    """Move a pose towards another one, in place, by no more than a way [m] and an angle [rad].

    The rotation goes along the shortest great arc (K. Shoemake, Animating rotation with quaternion curves, 1985).
    """
    way = np.sqrt((aim[0] - pose[0]) ** 2 + (aim[1] - pose[1]) ** 2 + (aim[2] - pose[2]) ** 2)
    share = 1.0 if way <= most_way else most_way / way
    for i in range(3):
        pose[i] = aim[i] if share == 1.0 else pose[i] + share * (aim[i] - pose[i])
    cosine = 0.0
    for i in range(3, 7):
        cosine += pose[i] * aim[i]
    half = np.arccos(min(1.0, abs(cosine)))  # of the angle between them
    if 2.0 * half <= most_angle:
        for i in range(3, 7):
            pose[i] = aim[i]
        return
    share = most_angle / (2.0 * half)
    here = np.sin((1.0 - share) * half) / np.sin(half)
    there = np.copysign(np.sin(share * half) / np.sin(half), cosine)
    square = 0.0
    for i in range(3, 7):
        pose[i] = here * pose[i] + there * aim[i]
        square += pose[i] ** 2
    for i in range(3, 7):
        pose[i] /= np.sqrt(square)


@njit(cache=True)
def _rotation(pose, i, j):  # type: ignore[no-untyped-def]
    """Entry (i, j) of the rotation matrix of a pose."""
    w, axis = pose[3], pose[4:]
    if i == j:
        return w * w + 2.0 * axis[i] ** 2 - (axis[0] ** 2 + axis[1] ** 2 + axis[2] ** 2)
    third = 3 - i - j
    sign = 1.0 if (j - i) % 3 == 2 else -1.0
    return 2.0 * (axis[i] * axis[j] + sign * w * axis[third])


@njit(cache=True)
def tool_coordinates(tool, pose, out):  # type: ignore[no-untyped-def]
    """Write tool @ concatenate([d, (R - I).ravel()]), (l,)."""
    for row in range(tool.shape[0]):
        total = 0.0
        for i in range(3):
            total += tool[row, i] * pose[i]
            for j in range(3):
                total += tool[row, 3 + 3 * i + j] * (_rotation(pose, i, j) - (1.0 if i == j else 0.0))
        out[row] = total


@njit(cache=True)
def wrench(tool, pose, forces, force, moment):  # type: ignore[no-untyped-def]
    """Write the force (3,) [N] and moment (3,) [N m] about the reference point of the body on the tool.

    `forces` (l,) are the tool's generalised ones on the body. A small rotation theta changes R by [theta]x R, so that
    with G the derivative of the power by the rates of R, the tool's moment is the sum over j of R_j x G_j (columns).
    """
    force[:] = 0.0
    moment[:] = 0.0
    for row in range(tool.shape[0]):
        for i in range(3):
            force[i] -= tool[row, i] * forces[row]
            k, m = (i + 1) % 3, (i + 2) % 3
            for j in range(3):
                turn = (
                    _rotation(pose, k, j) * tool[row, 3 + 3 * m + j] - _rotation(pose, m, j) * tool[row, 3 + 3 * k + j]
                )
                moment[i] -= turn * forces[row]
