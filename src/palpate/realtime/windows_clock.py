"""Clocks and sleeps of Windows for compiled code. They were tested with functions that stand in for Windows' own only.

`now` reads the performance counter. Sleeps wait for a timer of high resolution (Windows 10 version 1803 or newer).
"""

from __future__ import annotations

import ctypes
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from palpate.compiled.jit import kernel_njit

NANOSECONDS_PER_SECOND = 10**9
TIMER_TICK = 100  # [ns], unit of a due time; a negative one is a duration
HIGH_RESOLUTION_TIMER, ALL_ACCESS, INFINITE_WAIT = 0x2, 0x1F0003, 0xFFFFFFFF

INT_TYPE, LONG_TYPE, POINTER_TYPE = ir.IntType(32), ir.IntType(64), ir.IntType(8).as_pointer()


def _emit_call(builder: Any, result: Any, name: str, *args: Any) -> Any:
    """Emit a call of a function of kernel32."""
    kind = ir.FunctionType(result, [argument.type for argument in args])
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, name), args)


def _make_counter(name: str) -> Any:
    """Make the intrinsic that reads a 64-bit counter."""

    def counter(typingctx):
        def codegen(context, builder, signature, args):
            value = cgutils.alloca_once(builder, LONG_TYPE)
            _emit_call(builder, INT_TYPE, name, value)
            return builder.load(value)

        return types.int64(), codegen

    counter.__name__ = counter.__qualname__ = name
    return intrinsic(counter)


_performance_counter = _make_counter("QueryPerformanceCounter")
_performance_frequency = _make_counter("QueryPerformanceFrequency")


@intrinsic
def _sleep_for(typingctx, ticks):
    """Sleep for a number of timer ticks."""

    def codegen(context, builder, signature, args):
        nothing, access = ir.Constant(POINTER_TYPE, None), INT_TYPE(ALL_ACCESS)
        flags = INT_TYPE(HIGH_RESOLUTION_TIMER)
        timer = _emit_call(builder, POINTER_TYPE, "CreateWaitableTimerExW", nothing, nothing, flags, access)
        due = cgutils.alloca_once(builder, LONG_TYPE)
        builder.store(builder.neg(args[0]), due)
        zero = INT_TYPE(0)
        _emit_call(builder, INT_TYPE, "SetWaitableTimer", timer, due, zero, nothing, nothing, zero)
        status = _emit_call(builder, INT_TYPE, "WaitForSingleObject", timer, INT_TYPE(INFINITE_WAIT))
        _emit_call(builder, INT_TYPE, "CloseHandle", timer)
        return status

    return types.int32(types.int64), codegen


@kernel_njit()
def now():
    """Return a monotonic time [ns], int64."""
    count, frequency = _performance_counter(), _performance_frequency()
    seconds = count // frequency
    return seconds * NANOSECONDS_PER_SECOND + (count - seconds * frequency) * NANOSECONDS_PER_SECOND // frequency


@kernel_njit()
def sleep_until(instant):
    """Sleep until `now` reaches about `instant` [ns]."""
    ticks = (instant - now()) // TIMER_TICK
    if ticks > 0:
        _sleep_for(ticks)


def use_precise_sleep() -> None:
    """Request a timer period of 1 ms, for versions of Windows without timers of high resolution."""
    windows: Any = ctypes
    windows.windll.winmm.timeBeginPeriod(1)
