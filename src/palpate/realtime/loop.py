"""The compiled loop: wait, read the pose, advance the model, write the forces, count and keep."""

from __future__ import annotations

import inspect
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from palpate.dynamics.compiled.cache import law_digest, law_njit
from palpate.realtime.blackbox import Ring, keep
from palpate.realtime.clock import computing_time, now, sleep_until
from palpate.realtime.contract import FORCES, KINETIC, STATUS, STEPS, STRAIN, TRUST
from palpate.realtime.exchange import Slot, fetch, flags, get_flag, publish
from palpate.realtime.pose import IDENTITY, follow, tool_coordinates, wrench
from palpate.realtime.row import WIDTH, offset
from palpate.realtime.statistics import Tally, count_step

__all__ = [
    "CLAMP",
    "PAUSED",
    "RAN_AWAY",
    "RUNNING",
    "STOP",
    "STOPPED",
    "WARN",
    "Channels",
    "Settings",
    "Work",
    "loop_of",
]

Floats = NDArray[np.float64]

RUNNING, STOPPED, PAUSED, RAN_AWAY = range(4)  # what the loop is told to do, and why it ended
WARN, CLAMP, STOP = range(3)  # what to do where the model was not trained
LONGEST_SLEEP = 10_000_000  # [ns]: how long a command may wait
LONGEST_TRAIL = 256  # poses
STRIDE = 4  # the tool goes back by this part of its trail, and again, ...
SETTLING = 0.05  # [s] ... where trust does not return in so long: vibrations are to die away first

TIME, TAKEN, FAILED, ITERATIONS = (offset(name) for name in ("time", "steps", "failed", "iterations"))
COMPUTING, LATENESS, TRUSTED, WORST_TRUST = (offset(n) for n in ("computing", "lateness", "trust", "worst_trust"))
HELD, LIMITED, ENERGIES, POSE = (offset(name) for name in ("held", "limited", "kinetic", "position"))
SEQUENCE = offset("sequence")
FORCE, MOMENT, STIFFNESS = (offset(name) for name in ("force", "moment", "stiffness"))


class Settings(NamedTuple):
    """What does not change: times in [ns], `most_way` [m] and `most_angle` [rad] of the tool in a period."""

    period: int
    spin: int
    most_way: float
    most_angle: float
    force_limit: float
    stiffness_every: int
    on_distrust: int


class Channels(NamedTuple):
    """What the loop and other threads write to each other.

    Parameters
    ----------
    command : flags
        The first is RUNNING as long as the loop shall go on.
    pose, row : Slot
        The newest pose (7,) and its number, and the newest row.
    tally : Tally
    ring : Ring
    """

    command: NDArray[np.int64]
    pose: Slot
    row: Slot
    tally: Tally
    ring: Ring

    @classmethod
    def of(cls, coordinates: int, history: int) -> Channels:
        """Make channels for so many coordinates and rows of history."""
        row = Slot.of(WIDTH + 2 * coordinates)
        return cls(flags(), Slot.of(len(IDENTITY) + 1), row, Tally.new(), Ring.of(history, coordinates))


class Work(NamedTuple):
    """The state of body and tool, and room to work in; the loop's own.

    Parameters
    ----------
    q, v : (m,)
        Coordinates and velocities.
    tool : (l, 12)
        See `Realtime`.
    pose, wanted : (7,)
        Where the tool is, and where it is to go.
    trail, length : (LONGEST_TRAIL, 7), (1,)
        Where the model was trusted, the newest pose last, and how many poses these are. The first is where the tool was
        put; of a long way every second pose is kept, and of the oldest part ever fewer.
    fetched : (8,)
        What was read of a new pose, and its number.
    target, lost, before, there : (l,)
        Tool coordinates: of `pose`, of the pose at which trust was lost and of the one before, and of another one.
    report, tangent : (8 + l,), (l, l)
    row : (WIDTH + 2 m,)
    clock : (3,)
        The body's time [ns]; by how much slower it goes than the clock on the wall: 1 or less; and since when the tool
        waits where it was trusted for trust to return [s].
    """

    q: Floats
    v: Floats
    tool: Floats
    pose: Floats
    wanted: Floats
    trail: Floats
    length: NDArray[np.int64]
    fetched: Floats
    target: Floats
    lost: Floats
    before: Floats
    there: Floats
    report: Floats
    tangent: Floats
    row: Floats
    clock: Floats

    @classmethod
    def of(cls, rest: Floats, tool: Floats) -> Work:
        """Make the state at rest."""
        m, tools = len(rest), len(tool)
        poses = {name: np.zeros(len(IDENTITY)) for name in ("pose", "wanted")}
        poses["trail"] = np.zeros((LONGEST_TRAIL, len(IDENTITY)))
        coordinates = {name: np.zeros(tools) for name in ("target", "lost", "before", "there")}
        report, tangent, row = np.zeros(FORCES + tools), np.zeros((tools, tools)), np.zeros(WIDTH + 2 * m)
        clock = np.array([0.0, 1.0, 0.0])
        work = cls(
            np.zeros(m), np.zeros(m), tool, **poses, length=np.ones(1, dtype=np.int64),
            fetched=np.zeros(len(IDENTITY) + 1), **coordinates, report=report, tangent=tangent, row=row, clock=clock,
        )  # fmt: skip
        work.reset(rest)
        return work

    def reset(self, rest: Floats) -> None:
        """Put body and tool at rest."""
        for array in (self.v, self.target, self.lost, self.report, self.tangent, self.row):
            array[:] = 0.0
        self._begin_at(IDENTITY)
        self.q[:] = rest
        self.clock[0] = 0.0
        self.row[POSE : POSE + 7] = IDENTITY
        self.row[WIDTH : WIDTH + len(rest)] = rest

    def place(self, pose: Floats) -> None:
        """Put the tool somewhere at once, wherever it was."""
        self._begin_at(pose)
        self.row[HELD] = 0.0
        self.row[POSE : POSE + 7] = pose
        self.row[FORCE : FORCE + 6] = 0.0

    def _begin_at(self, pose: Floats) -> None:
        for own in (self.pose, self.wanted, self.trail[0]):
            own[:] = pose
        self.length[0] = 1


@njit(cache=True)
def _wait(deadline, spin, command):  # type: ignore[no-untyped-def]
    """Sleep until shortly before the deadline [ns], then watch the clock; return whether to go on."""
    while get_flag(command, 0) == RUNNING:
        time = now()
        if time >= deadline - spin:
            while now() < deadline:
                pass
            return True
        sleep_until(min(deadline - spin, time + LONGEST_SLEEP))
    return False


@njit(cache=True)
def _put(values, out, first):  # type: ignore[no-untyped-def]
    """Copy numbers; an assignment of slices takes seconds to compile."""
    for i in range(values.shape[0]):
        out[first + i] = values[i]


@njit(cache=True)
def _move_tool(work, slot, settings):  # type: ignore[no-untyped-def]
    """Move the tool towards the newest pose; one that is held stays, or goes back, where the model was trusted."""
    if fetch(slot, work.fetched):  # else it is just being written, and the next period will read it
        _put(work.fetched[:7], work.wanted, 0)
        work.row[SEQUENCE] = work.fetched[7]
    aim = work.wanted
    if work.row[HELD]:
        if work.row[TRUSTED] > 1.0 or _is_beyond(work):
            aim = work.trail[work.length[0] - 1]
        else:
            work.row[HELD] = 0.0
    slower = work.clock[1]
    follow(work.pose, aim, slower * settings.most_way, slower * settings.most_angle)
    tool_coordinates(work.tool, work.pose, work.target)


@njit(cache=True)
def _is_beyond(work):  # type: ignore[no-untyped-def]
    """Return whether the wanted pose lies on that side of the last trusted one on which trust was lost."""
    tool_coordinates(work.tool, work.wanted, work.there)
    beyond = 0.0
    for k in range(work.there.shape[0]):
        beyond += (work.lost[k] - work.before[k]) * (work.there[k] - work.before[k])
    return beyond > 0.0


@njit(cache=True)
def _hold_tool(work, seconds):  # type: ignore[no-untyped-def]
    """After a period [s], remember where the model is trusted, or hold the tool there."""
    if work.row[TRUSTED] > 1.0 and not work.row[HELD]:
        work.row[HELD], work.clock[2] = 1.0, 0.0
        _put(work.target, work.lost, 0)
        tool_coordinates(work.tool, work.trail[work.length[0] - 1], work.before)
    elif work.row[TRUSTED] > 1.0:
        _go_back(work, seconds)
    elif work.row[HELD]:
        work.clock[2] = 0.0
    elif not _is_same(work.pose, work.trail[work.length[0] - 1]):
        if work.length[0] == work.trail.shape[0]:
            work.length[0] = _thin(work.trail)
        _put(work.pose, work.trail[work.length[0]], 0)
        work.length[0] += 1


@njit(cache=True)
def _go_back(work, seconds):  # type: ignore[no-untyped-def]
    """Where the tool is held and trust does not return, hold it further back on its way."""
    length = work.length[0]
    if length > 1 and _is_same(work.pose, work.trail[length - 1]):
        work.clock[2] += seconds
        if work.clock[2] >= SETTLING:
            work.clock[2] = 0.0
            work.length[0] = length - max(1, length // STRIDE)
            if _is_same(work.lost, work.before):  # trust was lost by a tool that stood still
                tool_coordinates(work.tool, work.trail[work.length[0] - 1], work.before)


@njit(cache=True)
def _is_same(numbers, others):  # type: ignore[no-untyped-def]
    different = 0
    for i in range(numbers.shape[0]):
        different += numbers[i] != others[i]
    return different == 0


@njit(cache=True)
def _thin(trail):  # type: ignore[no-untyped-def]
    """Keep every second pose, the first of all among them; return how many these are."""
    kept = (trail.shape[0] + 1) // 2
    for k in range(1, kept):
        _put(trail[2 * k], trail[k], 0)
    return kept


@njit(cache=True)
def _is_finite(array):  # type: ignore[no-untyped-def]
    total = 0.0
    for i in range(array.size):
        total += 0.0 * array.flat[i]  # 0, or not a number
    return total == 0.0


@njit(cache=True)
def _write_row(work, settings):  # type: ignore[no-untyped-def]
    """Write what the model reported into the row; return whether it is fine."""
    report, row = work.report, work.row
    fine = report[STATUS] == 0.0 and _is_finite(report) and _is_finite(work.q) and _is_finite(work.v)
    row[FAILED] = 0.0 if fine else 1.0
    if fine:
        row[TAKEN] += 1.0
        work.clock[0] += work.clock[1] * settings.period
    row[TIME] = 1e-9 * work.clock[0]
    row[ITERATIONS], row[TRUSTED] = report[STEPS], report[TRUST]
    row[WORST_TRUST] = max(row[WORST_TRUST], report[TRUST])
    row[ENERGIES], row[ENERGIES + 1] = report[KINETIC], report[STRAIN]
    _put(work.pose, row, POSE)
    force, moment = row[FORCE : FORCE + 3], row[MOMENT : MOMENT + 3]
    wrench(work.tool, work.pose, report[FORCES:], force, moment)
    size = np.sqrt(force[0] ** 2 + force[1] ** 2 + force[2] ** 2)
    row[LIMITED] = 1.0 if size > settings.force_limit else 0.0
    if size > settings.force_limit:
        for i in range(3):
            force[i] *= settings.force_limit / size
            moment[i] *= settings.force_limit / size
    _put(work.q, row, WIDTH)
    _put(work.v, row, WIDTH + work.q.shape[0])
    return fine


@njit(cache=True)
def _write_stiffness(work):  # type: ignore[no-untyped-def]
    """Write the derivative (3, 3) of the force on the body by the tool's displacement, if it is finite."""
    tool, tools = work.tool, work.tool.shape[0]
    if not _is_finite(work.tangent):
        return
    for i in range(3):
        for j in range(3):
            total = 0.0
            for a in range(tools):
                for b in range(tools):
                    total += tool[a, i] * work.tangent[a, b] * tool[b, j]
            work.row[STIFFNESS + 3 * i + j] = total


@njit(cache=True)
def _no_stiffness(data, q, out):  # type: ignore[no-untyped-def]
    out[:] = 0.0


def _name(function: Any) -> str | None:
    """What tells a compiled function from all others, in other processes too; None if nothing does."""
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
def _sources() -> tuple[str, ...]:
    return tuple(path.read_text(encoding="utf-8") for path in sorted(Path(__file__).parent.glob("*.py")))


@cache
def loop_of(advance: Any, stiffness: Any) -> Any:
    """Compile the loop of a model's functions, which it holds inside.

    Returns
    -------
    function
        ``loop(data, work, channels, settings)`` goes on until told otherwise by the command, or the state runs away,
        or the model is no longer trusted and is to stop there. It returns the command, RAN_AWAY or PAUSED.
    """
    stiffness = _no_stiffness if stiffness is None else stiffness
    names = [_name(function) for function in (advance, stiffness)]
    cached = None not in names
    digest = law_digest(*(names if cached else (repr(advance), repr(stiffness))), *_sources())

    @law_njit(digest, cached=cached, nogil=True)
    def loop(data, work, channels, settings):  # type: ignore[no-untyped-def]
        period, row = settings.period, work.row
        deadline = now() + period
        while _wait(deadline, settings.spin, channels.command):
            began, computed, trusted = now(), computing_time(), row[TRUSTED] <= 1.0
            _move_tool(work, channels.pose, settings)
            advance(data, work.q, work.v, work.target, 1e-9 * period * work.clock[1], work.report)
            fine = _write_row(work, settings)
            if fine and settings.stiffness_every > 0 and (row[TAKEN] - 1) % settings.stiffness_every == 0:
                stiffness(data, work.q, work.tangent)
                _write_stiffness(work)
            if settings.on_distrust == CLAMP:
                _hold_tool(work, 1e-9 * period * work.clock[1])
            row[COMPUTING], row[LATENESS] = 1e-9 * (computing_time() - computed), 1e-9 * (began - deadline)
            ended = now()
            if fine:
                publish(channels.row, row)
            keep(channels.ring, row)
            deadline = count_step(channels.tally, row[COMPUTING], row[LATENESS], ended, deadline, period)
            if not fine:
                return RAN_AWAY
            if settings.on_distrust == STOP and trusted and row[TRUSTED] > 1.0:
                return PAUSED
        return get_flag(channels.command, 0)

    return loop
