"""Clocks and sleeps of the operating system for compiled code.

`now` reads CLOCK_MONOTONIC and `thread_time` reads CLOCK_THREAD_CPUTIME_ID, which excludes the time of other threads.
C functions are called by symbol, not by address, so that compiled code can be cached. Linux sleeps until a point in
time (clock_nanosleep). macOS sleeps for a duration (nanosleep): any delay between computing the duration and falling
asleep adds to the wake-up latency. Windows has its own functions (`windows_clock`).
"""

from __future__ import annotations

import ctypes
import sys
import time
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from palpate.compiled.jit import kernel_njit
from palpate.realtime.windows_clock import now as windows_now
from palpate.realtime.windows_clock import sleep_until as windows_sleep_until
from palpate.realtime.windows_clock import use_precise_sleep as windows_use_precise_sleep

IS_WINDOWS = sys.platform == "win32"
HAS_CLOCKS = IS_WINDOWS or (hasattr(time, "CLOCK_THREAD_CPUTIME_ID") and hasattr(time, "clock_gettime"))
HAS_ABSOLUTE_SLEEP = sys.platform.startswith("linux")  # clock_nanosleep until a point in time

MONOTONIC_CLOCK = getattr(time, "CLOCK_MONOTONIC", -1)
THREAD_CLOCK = getattr(time, "CLOCK_THREAD_CPUTIME_ID", -1)
TIMER_ABSTIME = 1
PR_SET_TIMERSLACK = 29
NANOSECONDS_PER_SECOND = 10**9  # in a second

INT_TYPE, LONG_TYPE = ir.IntType(32), ir.IntType(64)
TIMESPEC_TYPE = ir.LiteralStructType([LONG_TYPE, LONG_TYPE])  # seconds and nanoseconds, on every 64-bit system


def _emit_call(builder: Any, name: str, *args: Any) -> Any:
    """Emit a call of a C function that returns an int."""
    kind = ir.FunctionType(INT_TYPE, [argument.type for argument in args])
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, name), args)


@intrinsic
def _read_clock(typingctx, clock):
    """Return the time of a clock [ns]."""

    def codegen(context, builder, signature, args):
        spec = cgutils.alloca_once(builder, TIMESPEC_TYPE)
        _emit_call(builder, "clock_gettime", args[0], spec)
        seconds, rest = (builder.load(cgutils.gep_inbounds(builder, spec, 0, k)) for k in (0, 1))
        return builder.add(builder.mul(seconds, LONG_TYPE(NANOSECONDS_PER_SECOND)), rest)

    return types.int64(types.int32), codegen


def _emit_timespec(builder: Any, nanoseconds: Any) -> Any:
    """Emit a timespec of a non-negative number of nanoseconds."""
    spec = cgutils.alloca_once(builder, TIMESPEC_TYPE)
    builder.store(
        builder.sdiv(nanoseconds, LONG_TYPE(NANOSECONDS_PER_SECOND)), cgutils.gep_inbounds(builder, spec, 0, 0)
    )
    builder.store(
        builder.srem(nanoseconds, LONG_TYPE(NANOSECONDS_PER_SECOND)), cgutils.gep_inbounds(builder, spec, 0, 1)
    )
    return spec


@intrinsic
def _sleep_until(typingctx, instant):
    """Sleep until a time [ns] of CLOCK_MONOTONIC or until a signal."""

    def codegen(context, builder, signature, args):
        nothing = ir.Constant(TIMESPEC_TYPE.as_pointer(), None)
        return _emit_call(
            builder,
            "clock_nanosleep",
            INT_TYPE(MONOTONIC_CLOCK),
            INT_TYPE(TIMER_ABSTIME),
            _emit_timespec(builder, args[0]),
            nothing,
        )

    return types.int32(types.int64), codegen


@intrinsic
def _sleep_for(typingctx, duration):
    """Sleep for a duration [ns] or until a signal."""

    def codegen(context, builder, signature, args):
        nothing = ir.Constant(TIMESPEC_TYPE.as_pointer(), None)
        return _emit_call(builder, "nanosleep", _emit_timespec(builder, args[0]), nothing)

    return types.int32(types.int64), codegen


if IS_WINDOWS:
    now = thread_time = windows_now  # Windows counts the processor time of a thread in ticks of 16 ms

else:

    @kernel_njit()
    def now():
        """Return a monotonic time [ns], int64."""
        return _read_clock(MONOTONIC_CLOCK)

    @kernel_njit()
    def thread_time():
        """Return the processor time [ns] of this thread, int64; on Windows the time of `now`."""
        return _read_clock(THREAD_CLOCK)


if IS_WINDOWS:
    sleep_until = windows_sleep_until

elif HAS_ABSOLUTE_SLEEP:

    @kernel_njit()
    def sleep_until(instant):
        """Sleep until `now` reaches about `instant` [ns], or until a signal."""
        _sleep_until(instant)

else:

    @kernel_njit()
    def sleep_until(instant):
        """Sleep until `now` reaches about `instant` [ns], or until a signal."""
        left = instant - now()
        if left > 0:
            _sleep_for(left)


def use_precise_sleep() -> None:
    """Set the timer slack of the calling thread to 1 ns; by default Linux merges wake-ups within 50 us."""
    if IS_WINDOWS:
        windows_use_precise_sleep()
    elif HAS_ABSOLUTE_SLEEP:
        ctypes.CDLL(None).prctl(PR_SET_TIMERSLACK, ctypes.c_ulong(1), 0, 0, 0)
