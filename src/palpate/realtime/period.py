"""One period of the engine: move the tools, advance the model, write the record, and clamp tools without trust.

It reads no clock and exchanges nothing, so that exported libraries take the same period as the engine's loop.
"""

from __future__ import annotations

import inspect
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.compiled.jit import kernel_njit, law_digest, law_njit
from palpate.core.arrays import Floats
from palpate.dynamics.contact.stiffness import limit_stiffness
from palpate.realtime.contract import FORCES, KINETIC, POSE_COLUMNS, STATUS, STEPS, STRAIN, TRUST, tool_maps
from palpate.realtime.pose import (
    IDENTITY_POSE,
    follow_pose,
    pose_of_coordinates,
    request_pose,
    tool_coordinates,
    wrench,
)
from palpate.realtime.record import HEADER_SIZE, TOOL_DTYPE, TOOL_SIZE, field_offset, record_size

WARN, CLAMP, STOP, IGNORE = range(4)  # responses to an error indicator above 1
MAX_TRAIL = 256  # stored trusted poses
RETREAT_DIVISOR = 4  # the tool moves back by 1 / RETREAT_DIVISOR of its trail ...
SETTLING_TIME = 0.05  # [s] ... if trust does not return within this time, in which vibrations decay
REST_ENERGY = 1e-4  # energy of a body at rest, over the largest since it was at rest: 1 % of the amplitude
# entries of `Work.time`, `Work.peaks` and `Work.follow`
MODEL_TIME, TIME_SCALE = range(2)
LARGEST_ENERGY, WORST_SINCE_RESET, FORGETTING_RATE = range(3)
MAX_PERIODS, LARGEST_WAY, PERIODS_SINCE, PERIODS_LEFT = range(4)
SAME_POSE = 1e-12  # difference of numbers of poses below which they are the same

TIME, PERIODS, FAILED, ITERATIONS = (field_offset(name) for name in ("time", "steps", "failed", "iterations"))
TRUSTED, WORST_TRUST, CLAMPED, ENERGIES = (
    field_offset(name) for name in ("trust", "worst_trust", "clamped", "kinetic")
)
POSE, FORCE, MOMENT, STIFFNESS, LARGEST_FORCE, LIMITED, SEQUENCE = (  # in the part of a tool
    field_offset(name, TOOL_DTYPE)
    for name in ("position", "force", "moment", "stiffness", "largest_force", "limited", "sequence")
)
FIRST_POSE, FIRST_LARGEST, FIRST_LIMITED, FIRST_SEQUENCE = (  # of the first tool, in the header
    field_offset(name) for name in ("position", "largest_force", "limited", "sequence")
)
POSE_NUMBERS = len(IDENTITY_POSE)


class Settings(NamedTuple):
    """Constants of a run: times in [ns]; `max_distance` [m] and `max_angle` [rad] of a tool in one period.

    `max_backlog` is the number of periods by which the model may be late and still take them all.
    """

    period: int
    spin: int
    max_distance: float
    max_angle: float
    force_limit: float
    stiffness_every: int
    out_of_training: int
    max_backlog: int


class Trail(NamedTuple):
    """Trusted poses of the tools, to which clamped tools return, and where trust was lost."""

    # poses, length: (MAX_TRAIL, t, 7), (1,): trusted poses, newest last, and their number. The first is where the tools
    # were put down. A full trail keeps every second pose.
    poses: Floats
    length: NDArray[np.int64]
    # lost_at, last_trusted: (t l,): tool coordinates of the poses at which trust was lost, and of the last trusted ones
    lost_at: Floats
    last_trusted: Floats
    waited: Floats  # (1,): time [s] that clamped tools have waited for trust

    @classmethod
    def zeros(cls, tools: int, coordinates: int) -> Trail:
        """Make the trail of tools that have a number of coordinates together."""
        poses, (lost_at, last_trusted) = np.zeros((MAX_TRAIL, tools, POSE_NUMBERS)), np.zeros((2, coordinates))
        return cls(poses, np.ones(1, dtype=np.int64), lost_at, last_trusted, waited=np.zeros(1))


class Work(NamedTuple):
    """State of body and tools, and scratch arrays; owned by the loop."""

    # q, v: (m,): coordinates and velocities
    q: Floats
    v: Floats
    tool: Floats  # (t, l, 12): see `Realtime`
    # pose, wanted: (t, 7): present and requested poses of the tools
    pose: Floats
    wanted: Floats
    # (t, 4): most periods in which a tool reaches a new pose evenly, its largest way [m] in one, periods since its last
    # new pose, and periods until it is there
    follow: Floats
    fetched: Floats  # (8,): copy of the newest pose of a tool and its sequence number
    # target, wanted_coordinates: (t l,): tool coordinates of `pose` and of `wanted`
    target: Floats
    wanted_coordinates: Floats
    # report, tangent: (8 + t l,), (t l, l): results of the model's functions
    report: Floats
    tangent: Floats
    record: Floats  # record of the present period
    trail: Trail
    time: Floats  # (2,): model time [ns], and model time per wall-clock time
    # (3,): largest energy [J] since the body was at rest, largest error indicator since the reset, and the rate [1/s]
    # at which the largest one since rest decays
    peaks: Floats

    @classmethod
    def at_rest(cls, rest: Floats, tool: Floats, forgetting: float = 0.0) -> Work:
        """Make the state at rest; `tool` as that of `Realtime`, and a rate [1/s] of forgetting error indicators."""
        tool = tool_maps(tool)
        m, (tools, count, _) = len(rest), tool.shape
        pose, wanted = np.zeros((2, tools, POSE_NUMBERS))
        target, wanted_coordinates = np.zeros((2, tools * count))
        work = cls(
            np.zeros(m), np.zeros(m), tool, pose, wanted,
            follow=np.tile([0.0, np.inf, 0.0, 1.0], (tools, 1)),
            fetched=np.zeros(POSE_NUMBERS + 1),
            target=target,
            wanted_coordinates=wanted_coordinates,
            report=np.zeros(FORCES + tools * count),
            tangent=np.zeros((tools * count, count)),
            record=np.zeros(record_size(m, tools)),
            trail=Trail.zeros(tools, tools * count),
            time=np.array([0.0, 1.0]),
            peaks=np.array([0.0, 0.0, forgetting]),
        )  # fmt: skip
        work.reset(rest)
        return work

    def reset(self, rest: Floats) -> None:
        """Set body and tools to rest."""
        reset_work(self, rest)

    def place_tool(self, index: int, pose: Floats) -> None:
        """Move a tool to a pose at once."""
        copy_to(pose, self.pose[index], 0)
        place_work(self, index)


@kernel_njit()
def copy_to(values, out, first):
    """Copy numbers; an assignment of slices would take seconds to compile."""
    for i in range(values.shape[0]):
        out[first + i] = values[i]


@kernel_njit(inner=True)
def _fill(array, value):
    for i in range(array.size):
        array.flat[i] = value


@kernel_njit(inner=True)
def _coordinates_place(work):
    """Return the index in the record at which the coordinates begin."""
    return HEADER_SIZE + TOOL_SIZE * work.tool.shape[0]


@kernel_njit(inner=True)
def _repeat_first(record):
    """Write the fields of the first tool into the header."""
    for i in range(STIFFNESS + 9):
        record[FIRST_POSE + i] = record[HEADER_SIZE + i]
    record[FIRST_LARGEST], record[FIRST_LIMITED] = record[HEADER_SIZE + LARGEST_FORCE], record[HEADER_SIZE + LIMITED]
    record[FIRST_SEQUENCE] = record[HEADER_SIZE + SEQUENCE]


@kernel_njit()
def reset_work(work, rest):
    """Set body and tools to rest."""
    for array in (work.v, work.target, work.trail.lost_at, work.report, work.record):
        _fill(array, 0.0)
    _fill(work.tangent, 0.0)
    copy_to(rest, work.q, 0)
    work.time[MODEL_TIME], work.peaks[LARGEST_ENERGY], work.peaks[WORST_SINCE_RESET] = 0.0, 0.0, 0.0
    _fill(work.pose, 0.0)
    for t in range(work.pose.shape[0]):
        work.pose[t, 3] = 1.0
        place_work(work, t)
    copy_to(rest, work.record, _coordinates_place(work))


@kernel_njit()
def place_work(work, t):
    """Start again from the present pose of a tool, with no force on it; others go on."""
    copy_to(work.pose[t], work.wanted[t], 0)
    work.follow[t, PERIODS_LEFT] = 1.0
    for s in range(work.pose.shape[0]):
        copy_to(work.pose[s], work.trail.poses[0, s], 0)
    work.trail.length[0], work.record[CLAMPED] = 1, 0.0
    at = HEADER_SIZE + TOOL_SIZE * t
    copy_to(work.pose[t], work.record, at + POSE)
    for i in range(6):
        work.record[at + FORCE + i] = 0.0
    _repeat_first(work.record)


@kernel_njit()
def take_pose(work, t, pose):
    """Request a pose (7,) of a tool as `request_pose`, to reach it evenly in the time since the one before it."""
    different = 0
    for i in range(POSE_NUMBERS):
        different += abs(pose[i] - work.wanted[t, i]) > SAME_POSE
    is_taken = request_pose(work.wanted[t], pose)
    if is_taken and different > 0:
        follow = work.follow[t]
        follow[PERIODS_LEFT], follow[PERIODS_SINCE] = max(1.0, min(follow[PERIODS_SINCE], follow[MAX_PERIODS])), 0.0
    return is_taken


@kernel_njit(inline="always")
def _last_trusted_poses(trail):
    """Return the newest poses (t, 7) of a trail."""
    return trail.poses[trail.length[0] - 1]


@kernel_njit()
def move_tools(work, settings):
    """Move the tools towards the requested poses, or clamped tools towards their last trusted poses."""
    goal = work.wanted
    if work.record[CLAMPED]:
        if work.record[TRUSTED] > 1.0 or _is_beyond(work):
            goal = _last_trusted_poses(work.trail)
        else:
            work.record[CLAMPED] = 0.0
    time_scale, follow = work.time[TIME_SCALE], work.follow
    for t in range(goal.shape[0]):
        way = time_scale * min(settings.max_distance, follow[t, LARGEST_WAY])
        follow_pose(work.pose[t], goal[t], way, time_scale * settings.max_angle, follow[t, PERIODS_LEFT])
        follow[t, PERIODS_SINCE], follow[t, PERIODS_LEFT] = (
            follow[t, PERIODS_SINCE] + 1.0,
            max(follow[t, PERIODS_LEFT] - 1.0, 1.0),
        )
    tool_coordinates(work.tool, work.pose, work.target)


@kernel_njit(inner=True)
def _take_back(work):
    """Set the pose to that of a tool in contact that the model has held; it follows from there."""
    count = work.tool.shape[1]
    if count != POSE_COLUMNS:
        return
    tool_coordinates(work.tool, work.pose, work.wanted_coordinates)
    for t in range(work.tool.shape[0]):
        reached, wanted = work.target[count * t : count * (t + 1)], work.wanted_coordinates[count * t : count * (t + 1)]
        if not _is_equal(reached, wanted):
            pose_of_coordinates(reached, work.pose[t])


@kernel_njit(inner=True)
def _is_beyond(work):
    """Return whether the requested poses are beyond the last trusted ones, in the direction that lost trust."""
    tool_coordinates(work.tool, work.wanted, work.wanted_coordinates)
    beyond, lost_at, last_trusted = 0.0, work.trail.lost_at, work.trail.last_trusted
    for k in range(work.wanted_coordinates.shape[0]):
        beyond += (lost_at[k] - last_trusted[k]) * (work.wanted_coordinates[k] - last_trusted[k])
    return beyond > 0.0


@kernel_njit()
def clamp_tools(work, seconds):
    """After a period [s], store the trusted poses, or clamp the tools to the last ones."""
    trail = work.trail
    if work.record[TRUSTED] > 1.0 and not work.record[CLAMPED]:
        work.record[CLAMPED], trail.waited[0] = 1.0, 0.0
        copy_to(work.target, trail.lost_at, 0)
        tool_coordinates(work.tool, _last_trusted_poses(trail), trail.last_trusted)
    elif work.record[TRUSTED] > 1.0:
        _retreat(work, seconds)
    elif work.record[CLAMPED]:
        trail.waited[0] = 0.0
    elif not _is_equal_pose(work.pose, _last_trusted_poses(trail)):
        if trail.length[0] == trail.poses.shape[0]:
            trail.length[0] = _thin(trail.poses)
        _copy_poses(work.pose, trail.poses[trail.length[0]])
        trail.length[0] += 1


@kernel_njit(inner=True)
def _retreat(work, seconds):
    """Move clamped tools back along their trail if trust does not return."""
    trail, length = work.trail, work.trail.length[0]
    if length > 1 and _is_equal_pose(work.pose, _last_trusted_poses(trail)):
        trail.waited[0] += seconds
        if trail.waited[0] >= SETTLING_TIME:
            trail.waited[0] = 0.0
            trail.length[0] = length - max(1, length // RETREAT_DIVISOR)
            if _is_equal(trail.lost_at, trail.last_trusted):  # the tool stood still when trust was lost
                tool_coordinates(work.tool, _last_trusted_poses(trail), trail.last_trusted)


@kernel_njit(inner=True)
def _is_equal(numbers, others):
    different = 0
    for i in range(numbers.shape[0]):
        different += numbers[i] != others[i]
    return different == 0


@kernel_njit(inner=True)
def _is_equal_pose(poses, others):
    different = 0
    for t in range(poses.shape[0]):
        for i in range(POSE_NUMBERS):
            different += poses[t, i] != others[t, i]
    return different == 0


@kernel_njit(inner=True)
def _copy_poses(poses, out):
    for t in range(poses.shape[0]):
        for i in range(POSE_NUMBERS):
            out[t, i] = poses[t, i]


@kernel_njit(inner=True)
def _thin(trail):
    """Keep every second pose, including the first; return their number."""
    count = (trail.shape[0] + 1) // 2
    for k in range(1, count):
        _copy_poses(trail[2 * k], trail[k])
    return count


@kernel_njit(inner=True)
def _is_finite(array):
    total = 0.0
    for i in range(array.size):
        total += 0.0 * array.flat[i]  # 0, or not a number
    return total == 0.0


@kernel_njit(inner=True)
def _forget_at_rest(work):
    """Forget the largest error indicator and forces of a motion when the body is at rest again."""
    energy, peaks = work.report[KINETIC] + work.report[STRAIN], work.peaks
    peaks[LARGEST_ENERGY] = max(peaks[LARGEST_ENERGY], energy)
    if peaks[LARGEST_ENERGY] > 0.0 and energy <= REST_ENERGY * peaks[LARGEST_ENERGY]:
        peaks[LARGEST_ENERGY], work.record[WORST_TRUST] = 0.0, 0.0
        for t in range(work.tool.shape[0]):
            work.record[HEADER_SIZE + TOOL_SIZE * t + LARGEST_FORCE] = 0.0


@kernel_njit()
def write_record(work, settings):
    """Write the model's report to the record; return whether the state is finite."""
    report, record = work.report, work.record
    valid = report[STATUS] == 0.0 and _is_finite(report) and _is_finite(work.q) and _is_finite(work.v)
    record[FAILED] = 0.0 if valid else 1.0
    if valid:
        record[PERIODS] += 1.0
        work.time[MODEL_TIME] += work.time[TIME_SCALE] * settings.period
    record[TIME] = 1e-9 * work.time[MODEL_TIME]
    record[ITERATIONS], record[TRUSTED] = report[STEPS], report[TRUST]
    _forget_at_rest(work)
    seconds = 1e-9 * work.time[TIME_SCALE] * settings.period
    remembered = np.exp(-work.peaks[FORGETTING_RATE] * seconds) * record[WORST_TRUST]
    record[WORST_TRUST] = max(remembered, report[TRUST])
    work.peaks[WORST_SINCE_RESET] = max(work.peaks[WORST_SINCE_RESET], report[TRUST])
    record[ENERGIES], record[ENERGIES + 1] = report[KINETIC], report[STRAIN]
    for t in range(work.tool.shape[0]):
        _write_tool(work, settings, t)
    _repeat_first(record)
    place = _coordinates_place(work)
    copy_to(work.q, record, place)
    copy_to(work.v, record, place + work.q.shape[0])
    return valid


@kernel_njit(inner=True)
def _write_tool(work, settings, t):
    """Write pose, force and moment of a tool to its part of the record."""
    at, count, record = HEADER_SIZE + TOOL_SIZE * t, work.tool.shape[1], work.record
    copy_to(work.pose[t], record, at + POSE)
    force, moment = record[at + FORCE : at + FORCE + 3], record[at + MOMENT : at + MOMENT + 3]
    forces = work.report[FORCES + count * t : FORCES + count * (t + 1)]
    wrench(work.tool[t], work.pose[t], forces, force, moment)
    size = np.sqrt(force[0] ** 2 + force[1] ** 2 + force[2] ** 2)
    record[at + LARGEST_FORCE] = max(record[at + LARGEST_FORCE], size)
    record[at + LIMITED] = 1.0 if size > settings.force_limit else 0.0
    if size > settings.force_limit:
        for i in range(3):
            force[i] *= settings.force_limit / size
            moment[i] *= settings.force_limit / size


@kernel_njit(inner=True)
def _write_stiffness(work):
    """Write the contact stiffness (3, 3) of every tool to the record if it is finite, without negative eigenvalues."""
    count = work.tool.shape[1]
    if not _is_finite(work.tangent):
        return
    for t in range(work.tool.shape[0]):
        tool, tangent = work.tool[t], work.tangent[count * t : count * (t + 1)]
        first = HEADER_SIZE + TOOL_SIZE * t + STIFFNESS
        rows = work.record[first : first + 3], work.record[first + 3 : first + 6], work.record[first + 6 : first + 9]
        for i in range(3):
            for j in range(3):
                total = 0.0
                for a in range(count):
                    for b in range(count):
                        total += tool[a, i] * tangent[a, b] * tool[b, j]
                rows[i][j] = total
        limit_stiffness(rows, np.inf)
    _repeat_first(work.record)


def function_key(function: Any) -> str | None:
    """Return a key that identifies a compiled function in all processes, or None if there is none."""
    digest = getattr(function._cache, "_digest", None)  # of `law_njit`
    python = function.py_func
    if digest is None and python.__closure__:
        return None
    try:
        source = digest or Path(inspect.getsourcefile(python) or "").read_text(encoding="utf-8")
    except (TypeError, OSError):
        return None
    return f"{python.__module__} {python.__qualname__} {source}"


@cache
def compile_period(advance: Any, stiffness: Any) -> Any:
    """Compile a period around a model's functions.

    ``take_period(data, work, settings)`` moves the tools towards `Work.wanted`, advances body and tools by a period,
    and writes the record. It returns False if the state is not finite; the record then keeps its time.
    """
    has_stiffness = stiffness is not None
    digest, cached = functions_digest(__name__, advance, stiffness)

    @law_njit(digest, cached=cached, inline="always")
    def take_period(data, work, settings):
        seconds = 1e-9 * settings.period * work.time[TIME_SCALE]
        move_tools(work, settings)
        advance(data, work.q, work.v, work.target, seconds, work.report)
        _take_back(work)
        valid = write_record(work, settings)
        if has_stiffness:  # a constant of the compiled period
            due = settings.stiffness_every > 0 and (int(work.record[PERIODS]) - 1) % settings.stiffness_every == 0
            if valid and due:
                stiffness(data, work.q, work.tangent)
                _write_stiffness(work)
        if settings.out_of_training == CLAMP:
            clamp_tools(work, seconds)
        return valid

    return take_period


def functions_digest(module: str, *functions: Any) -> tuple[str, bool]:
    """Return the digest of a module's kernels and of compiled functions or None, and whether it holds elsewhere."""
    names = [function_key(function) for function in functions if function is not None]
    cached = None not in names
    return law_digest(module, *(names if cached else map(repr, functions))), cached
