"""Static states of a full model, for the comparisons in this folder."""

from __future__ import annotations

import numpy as np
from scipy.linalg import lu_factor, lu_solve

import palpate as pt


def relax(model: pt.Solid, loads: list, u: np.ndarray, settle: float, damping: float) -> np.ndarray:
    """Return the state reached after `settle` seconds with velocities damped at the rate `damping` [1/s]."""
    prepared = model.prepare(loads)
    state = pt.State(u.copy(), np.zeros_like(u))
    while state.time < settle:
        step = model.stable_step(state, prepared)[0]
        state = model.advance(state, prepared, step, 50)[0]
        state = pt.State(state.coordinates, state.velocities * np.exp(-50 * step * damping), state.time)
    return state.coordinates


def newton(model: pt.Solid, u: np.ndarray, free: np.ndarray, tolerance: float = 1e-6) -> np.ndarray:
    """Return displacements (n, 3) [m] near `u` at which no force is left at the `free` components, (n, 3) bool.

    Newton's method with the dense tangent, which is kept as long as every step leaves half of the force or less.
    Forces count by the largest at the components that are not free.
    """
    where, u = np.flatnonzero(free), u.copy()

    def forces(displacements: np.ndarray) -> tuple[np.ndarray, float]:
        nodal = (model.volumes[:, None] * model.force(displacements)).ravel()
        return nodal[where], float(np.abs(np.delete(nodal, where)).max())

    left, scale = forces(u)
    factors = None
    for _ in range(60):
        size = np.linalg.norm(left)
        if not np.isfinite(size):
            break
        if np.abs(left).max() < tolerance * scale:
            return u
        fresh = factors is None
        if factors is None:
            factors = lu_factor(_tangent(model, u, where), overwrite_a=True, check_finite=False)
        step = np.zeros_like(u)
        step.ravel()[where] = lu_solve(factors, left, check_finite=False)
        for halvings in range(8):
            trial = u + 0.5**halvings * step
            after, scale = forces(trial)
            if np.linalg.norm(after) < size:
                break
        else:
            if fresh:
                break
            factors = None
            continue
        u, left = trial, after
        if np.linalg.norm(after) > 0.5 * size:
            factors = None
    raise RuntimeError(f"Newton's method found no rest; {np.abs(left).max() / scale:.1e} of the force is left")


def _tangent(model: pt.Solid, u: np.ndarray, where: np.ndarray) -> np.ndarray:
    """Minus the derivative of nodal forces by displacements [N/m], at some components."""
    u, step, matrix = u.copy(), 1e-6 * model.cloud.spacing, np.empty((len(where), len(where)), order="F")
    flat, weights = u.ravel(), np.repeat(model.volumes, 3)[where]
    before = model.force(u).ravel()[where]
    for column, k in enumerate(where):
        flat[k] += step
        matrix[:, column] = weights * (before - model.force(u).ravel()[where]) / step
        flat[k] -= step
    return matrix
