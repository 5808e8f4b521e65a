"""The compiled loop of the engine: wait, read the pose, take a period, publish its record, count."""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.compiled.jit import kernel_njit, law_njit
from palpate.compiled.reference import StoredRecord
from palpate.realtime.black_box import RingBuffer, append_record
from palpate.realtime.calls import call_advance, call_stiffness, model_calls
from palpate.realtime.channel import POSE_NUMBERS, SharedSlots
from palpate.realtime.clock import now, sleep_until, thread_time
from palpate.realtime.period import SEQUENCE, STOP, TRUSTED, compile_period, functions_digest, take_pose
from palpate.realtime.record import HEADER_SIZE, TOOL_SIZE, field_offset, record_size
from palpate.realtime.seqlock import FLAGS_LENGTH, Slot, fetch, get_flag, make_flags, publish, stamp
from palpate.realtime.statistics import Histograms, count_step

RUNNING, STOPPED, PAUSED, DIVERGED = range(4)  # commands to the loop, and reasons for its end
MAX_RECORD_AGE, MAX_RECORD_PERIODS = 20_000_000, 4  # [ns], or in periods: then readers take its force as zero
MAX_SLEEP = 10_000_000  # [ns], which bounds the delay of a command
COMPUTING, WAKEUP_LATENCY = (field_offset(name) for name in ("computing", "lateness"))


class Channels(NamedTuple):
    """Exchange between the loop and other threads."""

    command: NDArray[np.int64]  # element 0 is RUNNING while the loop shall continue
    pose: Slot  # the newest pose (7,) of the first tool with its sequence number
    more_poses: Slot  # those of the other tools: versions (t - 1, FLAGS_LENGTH) and values (t - 1, 8)
    record: Slot  # the newest record
    histograms: Histograms  # deadline statistics
    ring_buffer: RingBuffer  # records of the last seconds

    @classmethod
    def allocate(cls, coordinates: int, tools: int, history: int, shared: SharedSlots | None = None) -> Channels:
        """Make channels for numbers of coordinates, tools and stored records; the slots may be shared."""
        if shared is None:
            pose, record = Slot.zeros(POSE_NUMBERS), Slot.zeros(record_size(coordinates, tools))
            more = Slot(np.zeros((tools - 1, FLAGS_LENGTH), np.int64), np.zeros((tools - 1, POSE_NUMBERS)))
        else:
            pose, more, record = shared.pose, shared.more_poses, shared.record
        return cls(make_flags(), pose, more, record, Histograms.zeros(), RingBuffer.empty(history, coordinates, tools))

    def pose_slot(self, tool: int) -> Slot:
        """Return the slot of a tool's pose."""
        return self.pose if tool == 0 else Slot(self.more_poses.version[tool - 1], self.more_poses.values[tool - 1])


@kernel_njit(inner=True)
def _wait(deadline, spin, command):
    """Sleep until shortly before the deadline [ns], then poll the clock; return whether to continue."""
    while get_flag(command, 0) == RUNNING:
        time = now()
        if time >= deadline - spin:
            while now() < deadline:
                pass
            return True
        sleep_until(min(deadline - spin, time + MAX_SLEEP))
    return False


@kernel_njit()
def _fetch_pose(work, t, slot):
    """Read the newest pose of a tool; another program may have written one that is not valid."""
    is_complete = fetch(slot, work.fetched)  # during a write, the next period reads it
    if is_complete and take_pose(work, t, work.fetched[:7]):
        work.record[HEADER_SIZE + TOOL_SIZE * t + SEQUENCE] = work.fetched[7]


@cache
def compile_loop(advance: Any, stiffness: Any) -> Any:
    """Compile the loop around a model's functions.

    ``loop(data, work, channels, settings)`` runs until the command changes, the state diverges, or trust is lost with
    `out_of_training` STOP. It returns the command, DIVERGED or PAUSED.
    """
    digest, cached = functions_digest(__name__, advance, stiffness)
    take_period = compile_period(advance, stiffness)

    @law_njit(digest, cached=cached, nogil=True)
    def loop(data, work, channels, settings):
        period, record = settings.period, work.record
        deadline = now() + period
        while _wait(deadline, settings.spin, channels.command):
            began, thread_began, trusted = now(), thread_time(), record[TRUSTED] <= 1.0
            _fetch_pose(work, np.int64(0), channels.pose)
            for t in range(1, work.pose.shape[0]):
                more = channels.more_poses
                _fetch_pose(work, t, Slot(more.version[t - 1], more.values[t - 1]))
            valid = take_period(data, work, settings)
            record[COMPUTING], record[WAKEUP_LATENCY] = 1e-9 * (thread_time() - thread_began), 1e-9 * (began - deadline)
            ended = now()
            if valid:
                publish(channels.record, record)
                stamp(channels.record, ended, max(MAX_RECORD_AGE, MAX_RECORD_PERIODS * period))
            append_record(channels.ring_buffer, record)
            deadline = count_step(
                channels.histograms,
                record[COMPUTING],
                record[WAKEUP_LATENCY],
                ended,
                deadline,
                period,
                settings.max_backlog,
            )
            if not valid:
                return DIVERGED
            if settings.out_of_training == STOP and trusted and record[TRUSTED] > 1.0:
                return PAUSED
        return get_flag(channels.command, 0)

    return loop


def loop_arguments(advance: Any, stiffness: Any, data: Any) -> tuple[Any, Any, Any]:
    """Return functions and data of a model as the loop takes them: by their addresses, unless they are a user's.

    A loop that calls functions by their addresses is compiled once for all models. The functions of a user may index
    their data, or take a tuple apart.
    """
    functions = [function for function in (advance, stiffness) if function is not None]
    if not all(function.py_func.__module__.startswith("palpate.") for function in functions):
        return advance, stiffness, data
    called = model_calls(advance, stiffness, data)
    return call_advance, None if stiffness is None else call_stiffness, StoredRecord(called)
