"""Timing: medians of several rounds, with compiled loops that run inside compiled code."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from functools import cache
from time import perf_counter
from typing import Any

import numpy as np

from palpate.dynamics.loads.prepared import PreparedLoads
from palpate.dynamics.run.model import State
from palpate.reduction.hyper.model import ReducedModel

Call = Callable[[], Any]

LOOP_SECONDS = 0.02  # [s] least time of a compiled loop, so that the time of its call is negligible
READING_PARTS = 64  # that are read side by side


def median_seconds(*calls: Call, repeats: int = 15) -> list[float]:
    """Return the median wall time of each call [s] over some rounds in which they take turns, after one to warm up."""
    times = np.empty((repeats + 1, len(calls)))
    for k in range(repeats + 1):
        for i, call in enumerate(calls):
            start = perf_counter()
            call()
            times[k, i] = perf_counter() - start
    return [float(seconds) for seconds in np.median(times[1:], axis=0)]


@cache
def _repeated_force() -> Any:
    from numba import njit

    @njit
    def repeat(force, columns, samples, scratch, result, count):
        for _ in range(count):
            force(columns, samples, scratch, result)

    return repeat


@cache
def _reader(parallel: bool) -> Any:
    from numba import njit, prange

    @njit(parallel=parallel, fastmath=True)
    def read(table, count):
        parts, size = np.zeros(READING_PARTS, dtype=table.dtype), table.shape[0] // READING_PARTS
        for _ in range(count):
            for p in prange(READING_PARTS):
                total = parts[p]
                for k in range(p * size, (p + 1) * size):
                    total += table[k]
                parts[p] = total
        return parts.sum()

    return read


def _enough(once: float) -> int:
    return max(1, int(np.ceil(LOOP_SECONDS / once)))


def _per_count(call: Callable[[int], Any]) -> tuple[Call, int]:
    """Return a call that repeats `call` for a measurable time, and its number of repetitions."""
    call(1)  # compiles
    start = perf_counter()
    call(1)
    count = _enough(perf_counter() - start)
    return lambda: call(count), count


def read_seconds(table: np.ndarray[Any, Any], *, parallel: bool = False, repeats: int = 15) -> float:
    """Return the median time [s] of summing a table in compiled code, repeatedly, by one thread or all."""
    flat, read = table.reshape(-1), _reader(parallel)
    call, count = _per_count(lambda times: read(flat, times))
    return median_seconds(call, repeats=repeats)[0] / count


def force_seconds(model: ReducedModel, repeats: int = 15) -> tuple[float, float]:
    """Return the median times [s] of a force evaluation and of reading its operator table once, one thread, in turn."""
    columns = 1e-2 * model.cloud.spacing / model.body.sizes
    repeat, read, flat = _repeated_force(), _reader(False), model.body.points.table.reshape(-1)
    result = np.zeros(model.count)
    force, evaluations = _per_count(
        lambda times: repeat(
            model.body.sampled.force, columns, model.body.points, model.workspace().coordinates, result, times
        )
    )
    table, readings = _per_count(lambda times: read(flat, times))
    evaluating, reading = median_seconds(force, table, repeats=repeats)
    return evaluating / evaluations, reading / readings


def step_seconds(*runs: tuple[ReducedModel, PreparedLoads, State], steps: int = 2000, repeats: int = 15) -> list[float]:
    """Return the median times [s] of an explicit step of some models, all steps in one compiled call, in turn."""
    return [
        seconds / steps for seconds in median_seconds(*(_compile_loop(*run, steps) for run in runs), repeats=repeats)
    ]


def _compile_loop(model: ReducedModel, prepared: PreparedLoads, state: State, steps: int) -> Call:
    """Return a call of the compiled steps, with the arguments of `ReducedModel.advance`."""
    (step, _), calls = model.stable_step(state, prepared), []
    explicit = model._explicit(len(prepared.tools) > 0)

    def record(*arguments: Any) -> Any:
        calls.append(arguments)
        return explicit(*arguments)

    watched = copy(model)
    vars(watched)["_explicit"] = lambda touched: record
    watched.advance(state, prepared, step, steps)
    _, _, *others = calls[0]
    return lambda: explicit(state.coordinates.copy(), state.velocities.copy(), *others)
