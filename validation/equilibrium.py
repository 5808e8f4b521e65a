"""Static states of a full model, for the comparisons in this folder."""

from __future__ import annotations

import numpy as np

import palpate as pt


def relax(model: pt.FullModel, loads: list, u: np.ndarray, settle: float, damping: float) -> np.ndarray:
    """Return the state reached after `settle` seconds with velocities damped at the rate `damping` [1/s]."""
    drive = model.drive(loads)
    state = pt.State(u.copy(), np.zeros_like(u))
    while state.time < settle:
        step = model.stable_step(state, drive)
        state = model.advance(state, drive, step, 50)
        state = pt.State(state.coordinates, state.velocities * np.exp(-50 * step * damping), state.time)
    return state.coordinates
