"""Sequence lock (seqlock): lock-free transfer of numbers between one writing thread and any number of readers.

A `Slot` is a sequence lock. Its version is odd during a write. A reader discards its copy if the version was odd or has
changed, so the writer never waits for readers. The memory orders are those of H.-J. Boehm, Can seqlocks get along with
programming language memory models?, MSPC 2012. Only one thread at a time may write.
"""

from __future__ import annotations

import time
from typing import Any, NamedTuple

import numpy as np
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from palpate.compiled.jit import kernel_njit

ALIGNMENT_BYTES = 8  # bytes
FLAGS_LENGTH = 16  # int64 in an array of flags: fills its cache lines, so that no other data shares them


def _make_load(order: str) -> Any:
    """Make the intrinsic load(array, i), atomic with a memory order."""

    def load(typingctx, array, i):
        def codegen(context, builder, signature, args):
            address = builder.gep(context.make_array(signature.args[0])(context, builder, args[0]).data, [args[1]])
            return builder.load_atomic(address, order, ALIGNMENT_BYTES)

        return array.dtype(array, types.intp), codegen

    load.__name__ = load.__qualname__ = f"load_{order}"
    return intrinsic(load)


def _make_store(order: str) -> Any:
    """Make the intrinsic store(array, i, value), atomic with a memory order."""

    def store(typingctx, array, i, value):
        def codegen(context, builder, signature, args):
            address = builder.gep(context.make_array(signature.args[0])(context, builder, args[0]).data, [args[1]])
            builder.store_atomic(args[2], address, order, ALIGNMENT_BYTES)
            return context.get_dummy_value()

        return types.void(array, types.intp, array.dtype), codegen

    store.__name__ = store.__qualname__ = f"store_{order}"
    return intrinsic(store)


def _make_fence(order: str) -> Any:
    """Make the intrinsic fence() of a memory order."""

    def fence(typingctx):
        def codegen(context, builder, signature, args):
            builder.fence(order)
            return context.get_dummy_value()

        return types.void(), codegen

    fence.__name__ = fence.__qualname__ = f"fence_{order}"
    return intrinsic(fence)


_load_relaxed, _load_acquire = _make_load("monotonic"), _make_load("acquire")  # LLVM calls relaxed order monotonic
_store_relaxed, _store_release = _make_store("monotonic"), _make_store("release")
_fence_acquire, _fence_release = _make_fence("acquire"), _make_fence("release")


class Slot(NamedTuple):
    """Numbers that readers receive from one complete write."""

    # (FLAGS_LENGTH,) int64: element 0 counts the starts and ends of writes; 1 and 2 are those of `stamp`
    version: NDArray[np.int64]
    values: NDArray[np.float64]  # (n,) float64

    @classmethod
    def zeros(cls, count: int) -> Slot:
        """Make a slot of `count` zeros."""
        return cls(make_flags(), np.zeros(count))


def make_flags() -> NDArray[np.int64]:
    """Make an array of flags, all 0."""
    return np.zeros(FLAGS_LENGTH, dtype=np.int64)


@kernel_njit()
def publish(slot, values):
    """Write values to the front of a slot; never waits."""
    version = _load_relaxed(slot.version, 0)
    _store_relaxed(slot.version, 0, version + 1)
    _fence_release()
    for i in range(values.shape[0]):
        _store_relaxed(slot.values, i, values[i])
    _store_release(slot.version, 0, version + 2)


@kernel_njit()
def stamp(slot, time, max_age):
    """Write the time of a slot's values and the age at which they are stale, both [ns], for other programs."""
    _store_relaxed(slot.version, 2, max_age)
    _store_relaxed(slot.version, 1, time)


@kernel_njit()
def fetch(slot, out):
    """Copy a slot to `out` once; return False if a write interfered, in which case `out` is invalid."""
    version = _load_acquire(slot.version, 0)
    if version & 1:
        return False
    for i in range(slot.values.shape[0]):
        out[i] = _load_relaxed(slot.values, i)
    _fence_acquire()
    return _load_relaxed(slot.version, 0) == version


def snapshot(slot: Slot) -> NDArray[np.float64]:
    """Return the numbers (n,) of one write; retries while writes interfere."""
    out = np.empty(len(slot.values))
    while not fetch(slot, out):
        time.sleep(0)  # yields the processor to the writer
    return out


@kernel_njit()
def set_flag(flags, i, value):
    """Write a flag with release order: its readers see all earlier writes."""
    _store_release(flags, i, value)


@kernel_njit()
def get_flag(flags, i):
    """Read a flag with acquire order: later reads see all writes before it was set."""
    return _load_acquire(flags, i)


@kernel_njit()
def acquire_fence():
    """Acquire fence."""
    _fence_acquire()


@kernel_njit(inner=True)
def release_fence():
    """Release fence."""
    _fence_release()
