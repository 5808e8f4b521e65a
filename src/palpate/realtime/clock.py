"""The clocks of the operating system, read and waited for in compiled code.

`now` is CLOCK_MONOTONIC, `computing_time` CLOCK_THREAD_CPUTIME_ID: what the scheduler gives to other threads counts in
the first only. The calls are made by symbol, not by address, so that compiled code can be cached. Linux waits for a
point in time (clock_nanosleep); macOS has no such call and waits for a duration (nanosleep), which lets what happens
between computing the duration and falling asleep add to the lateness. Windows has neither.
"""

from __future__ import annotations

import ctypes
import sys
import time
from typing import Any

from llvmlite import ir
from numba import njit, types
from numba.core import cgutils
from numba.extending import intrinsic

__all__ = ["ABSOLUTE", "SUPPORTED", "computing_time", "now", "sharpen_sleep", "sleep_until"]

SUPPORTED = hasattr(time, "CLOCK_THREAD_CPUTIME_ID") and hasattr(time, "clock_gettime")
ABSOLUTE = sys.platform.startswith("linux")  # whether it can be waited for a point in time

MONOTONIC = getattr(time, "CLOCK_MONOTONIC", -1)
THREAD = getattr(time, "CLOCK_THREAD_CPUTIME_ID", -1)
TIMER_ABSTIME = 1
PR_SET_TIMERSLACK = 29
SECOND = 10**9  # [ns]

INT, LONG = ir.IntType(32), ir.IntType(64)
TIMESPEC = ir.LiteralStructType([LONG, LONG])  # seconds and nanoseconds, on every 64-bit system


def _call(builder: Any, name: str, *args: Any) -> Any:
    """Emit the call of a C function that returns an int."""
    kind = ir.FunctionType(INT, [argument.type for argument in args])
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, name), args)


@intrinsic
def _read_clock(typingctx, clock):  # type: ignore[no-untyped-def]
    """Time of a clock [ns]."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        spec = cgutils.alloca_once(builder, TIMESPEC)
        _call(builder, "clock_gettime", args[0], spec)
        seconds, rest = (builder.load(cgutils.gep_inbounds(builder, spec, 0, k)) for k in (0, 1))
        return builder.add(builder.mul(seconds, LONG(SECOND)), rest)

    return types.int64(types.int32), codegen


def _timespec(builder: Any, nanoseconds: Any) -> Any:
    """Emit a timespec of nanoseconds, not negative."""
    spec = cgutils.alloca_once(builder, TIMESPEC)
    builder.store(builder.sdiv(nanoseconds, LONG(SECOND)), cgutils.gep_inbounds(builder, spec, 0, 0))
    builder.store(builder.srem(nanoseconds, LONG(SECOND)), cgutils.gep_inbounds(builder, spec, 0, 1))
    return spec


@intrinsic
def _sleep_until(typingctx, instant):  # type: ignore[no-untyped-def]
    """Sleep until a time [ns] of CLOCK_MONOTONIC; a signal may end it early."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        nothing = ir.Constant(TIMESPEC.as_pointer(), None)
        return _call(
            builder, "clock_nanosleep", INT(MONOTONIC), INT(TIMER_ABSTIME), _timespec(builder, args[0]), nothing
        )

    return types.int32(types.int64), codegen


@intrinsic
def _sleep_for(typingctx, duration):  # type: ignore[no-untyped-def]
    """Sleep for a duration [ns]; a signal may end it early."""

    def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
        nothing = ir.Constant(TIMESPEC.as_pointer(), None)
        return _call(builder, "nanosleep", _timespec(builder, args[0]), nothing)

    return types.int32(types.int64), codegen


@njit(cache=True)
def now():  # type: ignore[no-untyped-def]
    """Return the time [ns] since some start, int64; never goes back."""
    return _read_clock(MONOTONIC)


@njit(cache=True)
def computing_time():  # type: ignore[no-untyped-def]
    """Return the time [ns] that a processor has spent on this thread, int64."""
    return _read_clock(THREAD)


if ABSOLUTE:

    @njit(cache=True)
    def sleep_until(instant):  # type: ignore[no-untyped-def]
        """Sleep until `now` is about `instant` [ns], or a signal comes."""
        _sleep_until(instant)

else:

    @njit(cache=True)
    def sleep_until(instant):  # type: ignore[no-untyped-def]
        """Sleep until `now` is about `instant` [ns], or a signal comes."""
        left = instant - now()
        if left > 0:
            _sleep_for(left)


def sharpen_sleep() -> None:
    """Let the calling thread's sleeps end on time: by default Linux joins wake-ups within 50 us."""
    if ABSOLUTE:
        ctypes.CDLL(None).prctl(PR_SET_TIMERSLACK, ctypes.c_ulong(1), 0, 0, 0)
