"""One period of the engine: move the tool, advance the model, write the record, and clamp a tool without trust.

It reads no clock and exchanges nothing, so that exported libraries take the same period as the engine's loop.
"""

from __future__ import annotations

import inspect
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.arrays import Floats
from palpate.dynamics.compiled.cache import kernel_njit, law_digest, law_njit
from palpate.realtime.contract import FORCES, KINETIC, POSE_COLUMNS, STATUS, STEPS, STRAIN, TRUST
from palpate.realtime.pose import IDENTITY_POSE, follow_pose, pose_of_coordinates, tool_coordinates, wrench
from palpate.realtime.record import HEADER_SIZE, field_offset

WARN, CLAMP, STOP, IGNORE = range(4)  # responses to a trust number above 1
MAX_TRAIL = 256  # stored trusted poses
RETREAT_DIVISOR = 4  # the tool moves back by 1 / RETREAT_DIVISOR of its trail ...
SETTLING_TIME = 0.05  # [s] ... if trust does not return within this time, in which vibrations decay
REST_ENERGY = 1e-4  # energy of a body at rest, over the largest since it was at rest: 1 % of the amplitude
MODEL_TIME, TIME_SCALE, WAITED, LARGEST_ENERGY, WORST_SINCE_RESET = range(5)  # indices in `Work.clock`

TIME, PERIODS, FAILED, ITERATIONS = (field_offset(name) for name in ("time", "steps", "failed", "iterations"))
TRUSTED, WORST_TRUST, LARGEST_FORCE = (field_offset(name) for name in ("trust", "worst_trust", "largest_force"))
CLAMPED, LIMITED, ENERGIES, POSE = (field_offset(name) for name in ("clamped", "limited", "kinetic", "position"))
FORCE, MOMENT, STIFFNESS = (field_offset(name) for name in ("force", "moment", "stiffness"))


class Settings(NamedTuple):
    """Constants of a run: times in [ns]; `max_distance` [m] and `max_angle` [rad] of the tool in one period.

    `catch_up` is the number of periods by which the model may be late and still take them all.
    """

    period: int
    spin: int
    max_distance: float
    max_angle: float
    force_limit: float
    stiffness_every: int
    on_distrust: int
    catch_up: int


class Work(NamedTuple):
    """State of body and tool, and scratch arrays; owned by the loop."""

    # q, v: (m,): coordinates and velocities
    q: Floats
    v: Floats
    tool: Floats  # (l, 12): see `Realtime`
    # pose, wanted: (7,): present and requested pose of the tool
    pose: Floats
    wanted: Floats
    # trail, length: (MAX_TRAIL, 7), (1,): trusted poses, newest last, and their number. The first is where the tool was
    # put down. A full trail keeps every second pose.
    trail: Floats
    length: NDArray[np.int64]
    fetched: Floats  # (8,): copy of the newest pose and its sequence number
    # target, lost_at, last_trusted, wanted_coordinates: (l,): tool coordinates of `pose`, of the pose at which trust
    # was lost, of the last trusted pose, and of `wanted`
    target: Floats
    lost_at: Floats
    last_trusted: Floats
    wanted_coordinates: Floats
    # report, tangent: (8 + l,), (l, l): results of the model's functions
    report: Floats
    tangent: Floats
    record: Floats  # (HEADER_SIZE + 2 m,): record of the present period
    # (5,): model time [ns], model time per wall-clock time, the time [s] that a clamped tool has waited for trust, the
    # largest energy [J] since the body was at rest, and the largest trust number since the reset
    clock: Floats

    @classmethod
    def at_rest(cls, rest: Floats, tool: Floats) -> Work:
        """Make the state at rest."""
        m, tools = len(rest), len(tool)
        poses = {name: np.zeros(len(IDENTITY_POSE)) for name in ("pose", "wanted")}
        poses["trail"] = np.zeros((MAX_TRAIL, len(IDENTITY_POSE)))
        coordinates = {name: np.zeros(tools) for name in ("target", "lost_at", "last_trusted", "wanted_coordinates")}
        report, tangent, record = np.zeros(FORCES + tools), np.zeros((tools, tools)), np.zeros(HEADER_SIZE + 2 * m)
        clock = np.array([0.0, 1.0, 0.0, 0.0, 0.0])
        work = cls(
            np.zeros(m), np.zeros(m), tool, **poses, length=np.ones(1, dtype=np.int64),
            fetched=np.zeros(len(IDENTITY_POSE) + 1), **coordinates, report=report, tangent=tangent, record=record,
            clock=clock,
        )  # fmt: skip
        work.reset(rest)
        return work

    def reset(self, rest: Floats) -> None:
        """Set body and tool to rest."""
        reset_work(self, rest)

    def place_tool(self, pose: Floats) -> None:
        """Move the tool to a pose at once."""
        copy_to(pose, self.pose, 0)
        place_work(self)


@kernel_njit()
def copy_to(values, out, first):  # type: ignore[no-untyped-def]
    """Copy numbers; an assignment of slices would take seconds to compile."""
    for i in range(values.shape[0]):
        out[first + i] = values[i]


@kernel_njit(inner=True)
def _fill(array, value):  # type: ignore[no-untyped-def]
    for i in range(array.size):
        array.flat[i] = value


@kernel_njit()
def reset_work(work, rest):  # type: ignore[no-untyped-def]
    """Set body and tool to rest."""
    for array in (work.v, work.target, work.lost_at, work.report, work.record):
        _fill(array, 0.0)
    _fill(work.tangent, 0.0)
    copy_to(rest, work.q, 0)
    work.clock[MODEL_TIME], work.clock[LARGEST_ENERGY], work.clock[WORST_SINCE_RESET] = 0.0, 0.0, 0.0
    _fill(work.pose, 0.0)
    work.pose[3] = 1.0
    place_work(work)
    copy_to(rest, work.record, HEADER_SIZE)


@kernel_njit()
def place_work(work):  # type: ignore[no-untyped-def]
    """Start again from the present pose of the tool, with no force on it."""
    copy_to(work.pose, work.wanted, 0)
    copy_to(work.pose, work.trail[0], 0)
    work.length[0], work.record[CLAMPED] = 1, 0.0
    copy_to(work.pose, work.record, POSE)
    for i in range(6):
        work.record[FORCE + i] = 0.0


@kernel_njit()
def move_tool(work, settings):  # type: ignore[no-untyped-def]
    """Move the tool towards the requested pose, or a clamped tool towards its last trusted pose."""
    goal = work.wanted
    if work.record[CLAMPED]:
        if work.record[TRUSTED] > 1.0 or _is_beyond(work):
            goal = work.trail[work.length[0] - 1]
        else:
            work.record[CLAMPED] = 0.0
    time_scale = work.clock[TIME_SCALE]
    follow_pose(work.pose, goal, time_scale * settings.max_distance, time_scale * settings.max_angle)
    tool_coordinates(work.tool, work.pose, work.target)


@kernel_njit(inner=True)
def _take_back(work):  # type: ignore[no-untyped-def]
    """Set the pose to that of a tool in contact that the model has held; it follows from there."""
    if work.tool.shape[0] != POSE_COLUMNS:
        return
    tool_coordinates(work.tool, work.pose, work.wanted_coordinates)
    if not _is_equal(work.target, work.wanted_coordinates):
        pose_of_coordinates(work.target, work.pose)


@kernel_njit(inner=True)
def _is_beyond(work):  # type: ignore[no-untyped-def]
    """Return whether the requested pose is beyond the last trusted one, in the direction that lost trust."""
    tool_coordinates(work.tool, work.wanted, work.wanted_coordinates)
    beyond = 0.0
    for k in range(work.wanted_coordinates.shape[0]):
        beyond += (work.lost_at[k] - work.last_trusted[k]) * (work.wanted_coordinates[k] - work.last_trusted[k])
    return beyond > 0.0


@kernel_njit()
def clamp_tool(work, seconds):  # type: ignore[no-untyped-def]
    """After a period [s], store a trusted pose, or clamp the tool to the last one."""
    if work.record[TRUSTED] > 1.0 and not work.record[CLAMPED]:
        work.record[CLAMPED], work.clock[WAITED] = 1.0, 0.0
        copy_to(work.target, work.lost_at, 0)
        tool_coordinates(work.tool, work.trail[work.length[0] - 1], work.last_trusted)
    elif work.record[TRUSTED] > 1.0:
        _retreat(work, seconds)
    elif work.record[CLAMPED]:
        work.clock[WAITED] = 0.0
    elif not _is_equal(work.pose, work.trail[work.length[0] - 1]):
        if work.length[0] == work.trail.shape[0]:
            work.length[0] = _thin(work.trail)
        copy_to(work.pose, work.trail[work.length[0]], 0)
        work.length[0] += 1


@kernel_njit(inner=True)
def _retreat(work, seconds):  # type: ignore[no-untyped-def]
    """Move a clamped tool back along its trail if trust does not return."""
    length = work.length[0]
    if length > 1 and _is_equal(work.pose, work.trail[length - 1]):
        work.clock[WAITED] += seconds
        if work.clock[WAITED] >= SETTLING_TIME:
            work.clock[WAITED] = 0.0
            work.length[0] = length - max(1, length // RETREAT_DIVISOR)
            if _is_equal(work.lost_at, work.last_trusted):  # the tool stood still when trust was lost
                tool_coordinates(work.tool, work.trail[work.length[0] - 1], work.last_trusted)


@kernel_njit(inner=True)
def _is_equal(numbers, others):  # type: ignore[no-untyped-def]
    different = 0
    for i in range(numbers.shape[0]):
        different += numbers[i] != others[i]
    return different == 0


@kernel_njit(inner=True)
def _thin(trail):  # type: ignore[no-untyped-def]
    """Keep every second pose, including the first; return their number."""
    kept = (trail.shape[0] + 1) // 2
    for k in range(1, kept):
        copy_to(trail[2 * k], trail[k], 0)
    return kept


@kernel_njit(inner=True)
def _is_finite(array):  # type: ignore[no-untyped-def]
    total = 0.0
    for i in range(array.size):
        total += 0.0 * array.flat[i]  # 0, or not a number
    return total == 0.0


@kernel_njit(inner=True)
def _forget_at_rest(work):  # type: ignore[no-untyped-def]
    """Forget the largest trust number and force of a motion when the body is at rest again."""
    energy, clock = work.report[KINETIC] + work.report[STRAIN], work.clock
    clock[LARGEST_ENERGY] = max(clock[LARGEST_ENERGY], energy)
    if clock[LARGEST_ENERGY] > 0.0 and energy <= REST_ENERGY * clock[LARGEST_ENERGY]:
        clock[LARGEST_ENERGY], work.record[WORST_TRUST], work.record[LARGEST_FORCE] = 0.0, 0.0, 0.0


@kernel_njit()
def write_record(work, settings):  # type: ignore[no-untyped-def]
    """Write the model's report to the record; return whether the state is finite."""
    report, record = work.report, work.record
    valid = report[STATUS] == 0.0 and _is_finite(report) and _is_finite(work.q) and _is_finite(work.v)
    record[FAILED] = 0.0 if valid else 1.0
    if valid:
        record[PERIODS] += 1.0
        work.clock[MODEL_TIME] += work.clock[TIME_SCALE] * settings.period
    record[TIME] = 1e-9 * work.clock[MODEL_TIME]
    record[ITERATIONS], record[TRUSTED] = report[STEPS], report[TRUST]
    _forget_at_rest(work)
    record[WORST_TRUST] = max(record[WORST_TRUST], report[TRUST])
    work.clock[WORST_SINCE_RESET] = max(work.clock[WORST_SINCE_RESET], report[TRUST])
    record[ENERGIES], record[ENERGIES + 1] = report[KINETIC], report[STRAIN]
    copy_to(work.pose, record, POSE)
    force, moment = record[FORCE : FORCE + 3], record[MOMENT : MOMENT + 3]
    wrench(work.tool, work.pose, report[FORCES:], force, moment)
    size = np.sqrt(force[0] ** 2 + force[1] ** 2 + force[2] ** 2)
    record[LARGEST_FORCE] = max(record[LARGEST_FORCE], size)
    record[LIMITED] = 1.0 if size > settings.force_limit else 0.0
    if size > settings.force_limit:
        for i in range(3):
            force[i] *= settings.force_limit / size
            moment[i] *= settings.force_limit / size
    copy_to(work.q, record, HEADER_SIZE)
    copy_to(work.v, record, HEADER_SIZE + work.q.shape[0])
    return valid


@kernel_njit(inner=True)
def _write_stiffness(work):  # type: ignore[no-untyped-def]
    """Write the contact stiffness (3, 3) to the record if it is finite."""
    tool, tools = work.tool, work.tool.shape[0]
    if not _is_finite(work.tangent):
        return
    for i in range(3):
        for j in range(3):
            total = 0.0
            for a in range(tools):
                for b in range(tools):
                    total += tool[a, i] * work.tangent[a, b] * tool[b, j]
            work.record[STIFFNESS + 3 * i + j] = total


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

    Returns
    -------
    function
        ``take_period(data, work, settings)`` moves the tool towards `Work.wanted`, advances body and tool by a period,
        and writes the record. It returns False if the state is not finite; the record then keeps its time.
    """
    has_stiffness = stiffness is not None
    digest, cached = functions_digest(__name__, advance, stiffness)

    @law_njit(digest, cached=cached, inline="always")
    def take_period(data, work, settings):  # type: ignore[no-untyped-def]
        seconds = 1e-9 * settings.period * work.clock[TIME_SCALE]
        move_tool(work, settings)
        advance(data, work.q, work.v, work.target, seconds, work.report)
        _take_back(work)
        valid = write_record(work, settings)
        if has_stiffness:  # a constant of the compiled period
            due = settings.stiffness_every > 0 and (int(work.record[PERIODS]) - 1) % settings.stiffness_every == 0
            if valid and due:
                stiffness(data, work.q, work.tangent)
                _write_stiffness(work)
        if settings.on_distrust == CLAMP:
            clamp_tool(work, seconds)
        return valid

    return take_period


def functions_digest(module: str, *functions: Any) -> tuple[str, bool]:
    """Return the digest of a module's kernels and of compiled functions or None, and whether it holds elsewhere."""
    names = [function_key(function) for function in functions if function is not None]
    cached = None not in names
    return law_digest(module, *(names if cached else map(repr, functions))), cached
