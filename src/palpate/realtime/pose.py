"""Rigid poses of a tool: arrays (7,) of a position (3,) [m] and a unit quaternion (4,), w x y z."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from palpate.compiled.jit import kernel_njit
from palpate.core.arrays import Floats
from palpate.core.faults import InputError
from palpate.core.files import shortened

IDENTITY_POSE = np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0])
MIN_ANGLE = 1e-9  # [rad] half of an angle below which a rotation is reached at once
MAX_JUMP = 1.0  # [m] between consecutive poses; a larger one is a device error
UNIT_TOLERANCE = 1e-12  # of the size of a quaternion that is kept as it is


def normalise_pose(
    position: Floats | Sequence[float], quaternion: Floats | Sequence[float], last: Floats | None
) -> Floats:
    """Return a pose (7,) with a unit quaternion."""
    position, quaternion = _finite_numbers("position", position, 3), _finite_numbers("quaternion", quaternion, 4)
    largest = float(np.abs(quaternion).max())
    if largest == 0:
        raise InputError(
            "quaternion must be non-zero, got (0, 0, 0, 0); use (1, 0, 0, 0) for no rotation; the last pose is kept"
        )
    jump = 0.0 if last is None else float(np.linalg.norm(position - last[:3]))
    if jump > MAX_JUMP:
        raise InputError(
            f"position must be within {MAX_JUMP:g} m of the last one, got a jump of {jump:.3g} m; pass positions in "
            "metres, relative to the tool at rest; the last pose is kept"
        )
    quaternion = quaternion / largest  # prevents overflow of the squares
    return np.concatenate([position, quaternion / np.linalg.norm(quaternion)])


def _finite_numbers(name: str, value: Any, count: int) -> Floats:
    """Return finite real numbers (count,)."""
    try:
        array = np.asarray(value)
    except ValueError:  # nested lists of unequal lengths
        array = np.array(None)
    if array.shape != (count,) or array.dtype.kind not in "fiu":
        raise InputError(
            f"{name} must be {count} real numbers, got {shortened(repr(value))}; pass an array; the last pose is kept"
        )
    numbers = array.astype(float)
    if not np.isfinite(numbers).all():
        raise InputError(f"{name} must be finite, got {numbers}; check the device; the last pose is kept")
    return numbers


@kernel_njit()
def request_pose(wanted, pose):
    """Take a pose (7,) with a unit quaternion as the wanted one; return False and keep it if the new is not valid.

    It is not valid if a number is not finite, the quaternion is zero, or the position is more than `MAX_JUMP` away.
    """
    total, largest, square, jump = 0.0, 0.0, 0.0, 0.0
    for i in range(7):
        total += 0.0 * pose[i]  # 0, or not a number
    for i in range(3):
        jump += (pose[i] - wanted[i]) ** 2
    for i in range(3, 7):
        largest = max(largest, abs(pose[i]))
    if total != 0.0 or largest == 0.0 or not jump <= MAX_JUMP * MAX_JUMP:
        return False
    for i in range(3, 7):
        square += (pose[i] / largest) ** 2
    size = largest * np.sqrt(square)
    if abs(size - 1.0) < UNIT_TOLERANCE:
        size = 1.0
    for i in range(7):
        wanted[i] = pose[i] if i < 3 else pose[i] / size
    return True


@kernel_njit()
def follow_pose(pose, target, max_distance, max_angle, periods):
    """Move a pose towards a target in place, evenly in a number of periods, by at most a distance [m] and angle [rad].

    The rotation follows the shortest great arc (K. Shoemake, Animating rotation with quaternion curves, 1985).
    """
    distance = np.sqrt((target[0] - pose[0]) ** 2 + (target[1] - pose[1]) ** 2 + (target[2] - pose[2]) ** 2)
    share = 1.0 if distance <= max_distance else max_distance / distance
    share = min(share, 1.0 / periods)
    for i in range(3):
        pose[i] = target[i] if share == 1.0 else pose[i] + share * (target[i] - pose[i])
    cosine = 0.0
    for i in range(3, 7):
        cosine += pose[i] * target[i]
    half = np.arccos(min(1.0, abs(cosine)))  # of the angle between them
    if half <= MIN_ANGLE or (2.0 * half <= max_angle and periods <= 1.0):
        for i in range(3, 7):
            pose[i] = target[i]
        return
    share = min(max_angle / (2.0 * half), 1.0 / periods)
    start_weight = np.sin((1.0 - share) * half) / np.sin(half)
    end_weight = np.copysign(np.sin(share * half) / np.sin(half), cosine)
    square = 0.0
    for i in range(3, 7):
        pose[i] = start_weight * pose[i] + end_weight * target[i]
        square += pose[i] ** 2
    for i in range(3, 7):
        pose[i] /= np.sqrt(square)


@kernel_njit(inner=True)
def _rotation(pose, i, j):
    """Return entry (i, j) of the rotation matrix of a pose."""
    w, axis = pose[3], pose[4:]
    if i == j:
        return w * w + 2.0 * axis[i] ** 2 - (axis[0] ** 2 + axis[1] ** 2 + axis[2] ** 2)
    third = 3 - i - j
    sign = 1.0 if (j - i) % 3 == 2 else -1.0
    return 2.0 * (axis[i] * axis[j] + sign * w * axis[third])


@kernel_njit()
def tool_coordinates(tool, poses, out):
    """Write the coordinates (t l,) of tools in poses (t, 7): tool @ concatenate([d, (R - I).ravel()]) of each."""
    count = tool.shape[1]
    for t in range(tool.shape[0]):
        pose = poses[t]
        for row in range(count):
            total = 0.0
            for i in range(3):
                total += tool[t, row, i] * pose[i]
                for j in range(3):
                    total += tool[t, row, 3 + 3 * i + j] * (_rotation(pose, i, j) - (1.0 if i == j else 0.0))
            out[t * count + row] = total


@kernel_njit()
def pose_of_coordinates(coordinates, pose):
    """Write the pose (7,) of tool coordinates (12,) that are displacement and R - I.

    The quaternion is from the largest of its components (S. W. Shepperd, J. Guidance and Control 1, 1978), and has the
    sign that is nearest to the quaternion before.
    """
    r = coordinates[3:]
    trace = r[0] + r[4] + r[8]  # of R - I
    best, largest = -1, trace + 4.0  # 4 w^2
    for i in range(3):
        if 2.0 * r[4 * i] - trace > largest:  # 4 x^2
            best, largest = i, 2.0 * r[4 * i] - trace
    if best < 0:
        w = 0.5 * np.sqrt(largest)
        x, y, z = (r[7] - r[5]) / (4.0 * w), (r[2] - r[6]) / (4.0 * w), (r[3] - r[1]) / (4.0 * w)
    else:
        i, j, k = best, (best + 1) % 3, (best + 2) % 3
        part = 0.5 * np.sqrt(largest)
        w = (r[3 * k + j] - r[3 * j + k]) / (4.0 * part)
        parts = (part, (r[3 * j + i] + r[3 * i + j]) / (4.0 * part), (r[3 * k + i] + r[3 * i + k]) / (4.0 * part))
        x, y, z = parts[(0 - i) % 3], parts[(1 - i) % 3], parts[(2 - i) % 3]
    sign = 1.0 if pose[3] * w + pose[4] * x + pose[5] * y + pose[6] * z >= 0.0 else -1.0
    length = sign * np.sqrt(w * w + x * x + y * y + z * z)
    for i in range(3):
        pose[i] = coordinates[i]
    pose[3], pose[4], pose[5], pose[6] = w / length, x / length, y / length, z / length


@kernel_njit()
def wrench(tool, pose, forces, force, moment):
    """Write the force (3,) [N] and moment (3,) [N m] of the body on the tool, about the reference point.

    `forces` (l,) are the generalised forces of the tool on the body. A small rotation theta changes R by [theta]x R.
    With G the derivative of the power by the rates of R, the tool's moment is the sum of R_j x G_j over the columns j.
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
