"""Numbers that one thread writes and others read, without a lock.

A `Slot` is a sequence lock. Its version is odd while a write goes on; a reader that saw it odd, or changed, throws away
what it read. So the writer never waits, whatever its readers do. Orders are those of H.-J. Boehm, Can seqlocks get
along with programming language memory models?, MSPC 2012. One thread at a time may write.
"""

from __future__ import annotations

import time
from typing import Any, NamedTuple

import numpy as np
from numba import njit, types
from numba.extending import intrinsic
from numpy.typing import NDArray

__all__ = ["Slot", "fetch", "flags", "get_flag", "publish", "read_barrier", "set_flag", "snapshot", "write_barrier"]

ALIGNMENT = 8  # bytes
ALONE = 16  # numbers in an array of flags: no other data shares their line of the processor's cache


def _load(order: str) -> Any:
    """Make the intrinsic load(array, i), atomic with the given memory order."""

    def load(typingctx, array, i):  # type: ignore[no-untyped-def]
        def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
            address = builder.gep(context.make_array(signature.args[0])(context, builder, args[0]).data, [args[1]])
            return builder.load_atomic(address, order, ALIGNMENT)

        return array.dtype(array, types.intp), codegen

    load.__name__ = load.__qualname__ = f"load_{order}"
    return intrinsic(load)


def _store(order: str) -> Any:
    """Make the intrinsic store(array, i, value), atomic with the given memory order."""

    def store(typingctx, array, i, value):  # type: ignore[no-untyped-def]
        def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
            address = builder.gep(context.make_array(signature.args[0])(context, builder, args[0]).data, [args[1]])
            builder.store_atomic(args[2], address, order, ALIGNMENT)
            return context.get_dummy_value()

        return types.void(array, types.intp, array.dtype), codegen

    store.__name__ = store.__qualname__ = f"store_{order}"
    return intrinsic(store)


def _fence(order: str) -> Any:
    """Make the intrinsic fence() of the given memory order."""

    def fence(typingctx):  # type: ignore[no-untyped-def]
        def codegen(context, builder, signature, args):  # type: ignore[no-untyped-def]
            builder.fence(order)
            return context.get_dummy_value()

        return types.void(), codegen

    fence.__name__ = fence.__qualname__ = f"fence_{order}"
    return intrinsic(fence)


_load_relaxed, _load_acquire = _load("monotonic"), _load("acquire")  # LLVM calls relaxed order monotonic
_store_relaxed, _store_release = _store("monotonic"), _store("release")
_fence_acquire, _fence_release = _fence("acquire"), _fence("release")


class Slot(NamedTuple):
    """A set of numbers that is read whole.

    Parameters
    ----------
    version : (ALONE,) int64
        The first counts the beginnings and ends of writes.
    values : (n,) float64
    """

    version: NDArray[np.int64]
    values: NDArray[np.float64]

    @classmethod
    def of(cls, count: int) -> Slot:
        """Make a slot of `count` zeros."""
        return cls(flags(), np.zeros(count))


def flags() -> NDArray[np.int64]:
    """Make an array of flags, all 0."""
    return np.zeros(ALONE, dtype=np.int64)


@njit(cache=True)
def publish(slot, values):  # type: ignore[no-untyped-def]
    """Write the first numbers of a slot, as many as there are values; never waits."""
    version = _load_relaxed(slot.version, 0)
    _store_relaxed(slot.version, 0, version + 1)
    _fence_release()
    for i in range(values.shape[0]):
        _store_relaxed(slot.values, i, values[i])
    _store_release(slot.version, 0, version + 2)


@njit(cache=True)
def fetch(slot, out):  # type: ignore[no-untyped-def]
    """Read all numbers of a slot once; return whether they are of one write. If not, `out` means nothing."""
    version = _load_acquire(slot.version, 0)
    if version & 1:
        return False
    for i in range(slot.values.shape[0]):
        out[i] = _load_relaxed(slot.values, i)
    _fence_acquire()
    return _load_relaxed(slot.version, 0) == version


def snapshot(slot: Slot) -> NDArray[np.float64]:
    """Return numbers (n,) of one write, trying again while there are writes."""
    out = np.empty(len(slot.values))
    while not fetch(slot, out):
        time.sleep(0)  # the writer may have lost its processor to this thread
    return out


@njit(cache=True)
def set_flag(flags, i, value):  # type: ignore[no-untyped-def]
    """Write a flag; who reads it sees all that was written before."""
    _store_release(flags, i, value)


@njit(cache=True)
def get_flag(flags, i):  # type: ignore[no-untyped-def]
    """Read a flag, and with it all that was written before it was set."""
    return _load_acquire(flags, i)


@njit(cache=True)
def read_barrier():  # type: ignore[no-untyped-def]
    """Let no read that follows be made before one that went before."""
    _fence_acquire()


@njit(cache=True)
def write_barrier():  # type: ignore[no-untyped-def]
    """Let no write that follows be seen before one that went before."""
    _fence_release()
