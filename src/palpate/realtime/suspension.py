"""The time for which the machine was suspended: the difference of a clock that goes on meanwhile and one that stops.

Both clocks go on alike while a program gets no processor time: such a stall does not count.
"""

from __future__ import annotations

import ctypes
import sys
import time
from typing import Any

# names of a clock that goes on while the machine is suspended, and of one that stops: they differ by system
CLOCK_NAMES = (
    ("CLOCK_MONOTONIC", "CLOCK_UPTIME_RAW") if sys.platform == "darwin" else ("CLOCK_BOOTTIME", "CLOCK_MONOTONIC")
)
IS_WINDOWS = sys.platform == "win32"
HAS_CLOCKS = IS_WINDOWS or all(hasattr(time, name) for name in CLOCK_NAMES)
TICKS_PER_SECOND, MILLISECONDS_PER_SECOND = 1e7, 1e3  # of the clocks of Windows
READING_TIME = 0.05  # [s] that a reading of both clocks takes without a stall


def suspended_time() -> float:
    """Return for how long [s] the machine was suspended since its start; 0 on a system without such clocks.

    The clocks are those of `time.clock_gettime`, and of Windows ``GetTickCount64`` and ``QueryUnbiasedInterruptTime``.
    """
    while HAS_CLOCKS:
        before = uptime()
        total = time_since_start()
        if uptime() - before < READING_TIME:  # else a stall came between
            return total - before
    return 0.0


def time_since_start() -> float:
    """Return a time [s] that goes on while the machine is suspended."""
    if not IS_WINDOWS:
        return time.clock_gettime(getattr(time, CLOCK_NAMES[0]))
    count = _kernel().GetTickCount64
    count.restype = ctypes.c_ulonglong
    return float(count()) / MILLISECONDS_PER_SECOND


def uptime() -> float:
    """Return a time [s] that stops while the machine is suspended."""
    if not IS_WINDOWS:
        return time.clock_gettime(getattr(time, CLOCK_NAMES[1]))
    ticks = ctypes.c_ulonglong()
    _kernel().QueryUnbiasedInterruptTime(ctypes.byref(ticks))
    return ticks.value / TICKS_PER_SECOND


def _kernel() -> Any:
    """Return the functions of the Windows kernel."""
    return getattr(ctypes, "windll").kernel32  # noqa: B009
