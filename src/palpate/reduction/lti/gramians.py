"""Lyapunov equations of pyMOR's models, solved densely whatever pyMOR's own threshold is.

pyMOR turns to its alternating-direction iteration from 1,000 equations on. For lightly damped bodies that converges
slowly: every resonance wants a shift of its own.
"""

from __future__ import annotations

from typing import Any

__all__ = ["dense_solver"]


def dense_solver() -> Any:
    """Return a `LyapunovSolverLR` that solves densely: order and cost have been checked before."""
    from pymor.bindings.scipy import ScipyLyapunovSolverLR

    return ScipyLyapunovSolverLR()
