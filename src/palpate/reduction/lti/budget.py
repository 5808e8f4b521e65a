"""Estimated cost of dense computations on this machine."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from time import perf_counter

import numpy as np
import scipy.linalg

from palpate.core.faults import InputError
from palpate.dynamics.run.rollout import machine_memory

TIMED_ORDER = 240  # order of the dense equation that is timed
SOLVER_ARRAYS = 8  # square arrays that a dense solver stores at a time: the Schur form, vectors and work


@dataclass(frozen=True)
class Estimate:
    """Estimated memory [bytes] and time [s] of a computation."""

    memory: float
    seconds: float

    def __str__(self) -> str:
        size = f"{self.memory / 1e9:.1f} GB" if self.memory >= 1e8 else f"{self.memory / 1e6:.0f} MB"
        minutes = f"{self.seconds / 60:.0f} minutes" if self.seconds >= 120 else f"{self.seconds:.0f} s"
        return f"about {size} and {minutes}"


@dataclass(frozen=True)
class Budget:
    """Limits on the cost of a reduction."""

    seconds: float = 600.0  # [s]
    memory: float | None = None  # float, optional [bytes]: by default half of the machine's memory

    def check(self, estimate: Estimate, what: str, instead: str) -> None:
        """Raise `InputError` if an estimate exceeds the budget."""
        memory = self.memory if self.memory is not None else 0.5 * machine_memory()
        if estimate.memory > memory or estimate.seconds > self.seconds:
            raise InputError(
                f"budget must cover {estimate} for {what}, got {memory / 1e9:.1f} GB and {self.seconds:g} s; {instead}"
            )


def dense_lyapunov(order: int) -> Estimate:
    """Estimate the two dense Lyapunov equations of a system of first order: O(N^2) numbers, O(N^3) operations."""
    return Estimate(8.0 * SOLVER_ARRAYS * order**2, 2 * _dense_seconds() * (order / TIMED_ORDER) ** 3)


@cache
def _dense_seconds() -> float:
    """Return the time [s] of one dense equation of order `TIMED_ORDER`, the shorter of two."""
    a = np.random.default_rng(0).standard_normal((TIMED_ORDER, TIMED_ORDER)) - 40 * np.eye(TIMED_ORDER)
    times = []
    for _ in range(2):
        start = perf_counter()
        scipy.linalg.solve_continuous_lyapunov(a, -np.eye(TIMED_ORDER))
        times.append(perf_counter() - start)
    return min(times)
