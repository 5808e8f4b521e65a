"""Scales of the error indicator from the training runs, which held-out runs replace."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from palpate.core.arrays import Floats
from palpate.dynamics.nodal.energy_model import EnergyModel
from palpate.reduction.basis.snapshots import Snapshots
from palpate.reduction.hyper.data import UNLIMITED_SCALE, Scales
from palpate.reduction.hyper.error_indicator import (
    nearness_to_supports,
    rms_speeds,
    support_nearness,
)

ERROR_QUANTILE = 0.95  # of errors, and of runs with an error indicator of at most 1
FRAME_SPEED_MARGIN = 1.5  # of a scale from differences of frames, which miss the peaks between


def scales_of_training(
    body: EnergyModel, snapshots: Snapshots, states: Floats, chosen: Floats, mass: Floats, of_tools: bool
) -> Scales:
    """Return the scales of distance, speed and nearness; the others have their defaults.

    `states` (t, m) are coordinates of all snapshots, `chosen` (c, m) those of training states evenly spaced over them.
    The mass matrix (m, m) is divided by the mass of the body. `of_tools` is True for the speed of tools in contact.
    """
    return Scales(
        distance_scale=_distance_scale(chosen, mass, snapshots),
        speed_scale=_speed_scale(states, mass, snapshots, of_tools),
        nearness_scale=_nearness_scale(body, snapshots),
    )


def distances_to_nearest(states: Floats, others: Floats, mass: Floats) -> Floats:
    """Return the distance [m] of each state (s, m) to the nearest of other states (t, m).

    The distance is the root mean square displacement over the body; `mass` (m, m) is the mass matrix
    divided by the mass of the body.
    """
    root = np.linalg.cholesky(mass)
    one, two = states @ root, others @ root
    square = np.sum(one**2, axis=1)[:, None] + np.sum(two**2, axis=1) - 2 * one @ two.T
    return np.sqrt(np.maximum(square.min(axis=1), 0.0))


def _distance_scale(chosen: Floats, mass: Floats, snapshots: Snapshots) -> float:
    """Return the distance that most training states keep to other runs, or to the next frame with one run."""
    runs = len(snapshots.lengths)
    owner = np.repeat(np.arange(runs), snapshots.lengths)[snapshots.evenly_spaced(len(chosen))]
    distances = []
    for run in range(runs):
        of_run = owner == run
        if of_run.any() and (~of_run).any():
            distances.append(distances_to_nearest(chosen[of_run], chosen[~of_run], mass))
    if not distances:
        distances = [np.asarray(np.linalg.norm(np.diff(chosen, axis=0) @ np.linalg.cholesky(mass), axis=1))]
    return max(float(np.quantile(np.concatenate(distances), ERROR_QUANTILE)), 1e-300)


def _speed_scale(states: Floats, mass: Floats, snapshots: Snapshots, of_tools: bool) -> float:
    """Return the largest speed [m/s] that most runs do not exceed; unlimited without times.

    It is that of the tools in contact, or of the body, as in `palpate.ReducedModel.speeds`.
    """
    fastest, parts = [], np.split(states, np.cumsum(snapshots.lengths)[:-1])
    root = np.asarray(np.linalg.cholesky(mass), dtype=float)
    for run, coordinates in zip(snapshots.runs, parts, strict=True):
        if not (len(run.times) == len(coordinates) > 1 and np.all(np.diff(run.times) > 0)):
            continue
        if of_tools:
            fastest.append(_speed_in_contact(run))
            continue
        velocities = np.diff(coordinates, axis=0) / np.diff(run.times)[:, None]
        fastest.append(float(rms_speeds(root, velocities).max()))
    return FRAME_SPEED_MARGIN * _upper_quantile(fastest)


def _speed_in_contact(run: Any) -> float:
    """Return the largest mean speed [m/s] between frames of the nodes that tools touch, weighted by their forces."""
    rows, times = np.asarray(run.contact_forces), np.asarray(run.times)
    frames, fastest = rows[:, 0].astype(int), 0.0
    for frame in np.unique(frames[frames > 0]):
        nodes, forces = rows[frames == frame, 1].astype(int), np.linalg.norm(rows[frames == frame, 2:], axis=1)
        moved = np.asarray(run.displacements[int(frame)])[nodes] - np.asarray(run.displacements[int(frame) - 1])[nodes]
        if forces.any():
            speeds = np.linalg.norm(moved, axis=1) / (times[frame] - times[frame - 1])
            fastest = max(fastest, float(np.average(speeds, weights=forces)))
    return fastest


def _nearness_scale(body: EnergyModel, snapshots: Snapshots) -> float:
    """Return the largest nearness of tools to supports that most runs do not exceed; unlimited without contact."""
    nearness, nearest = nearness_to_supports(body.cloud, body.supports, np.arange(len(body.cloud))), []
    for run in snapshots.runs:
        rows = np.asarray(run.contact_forces)
        if len(rows):
            frames, near = rows[:, 0], nearness[rows[:, 1].astype(int)]
            in_frames = (frames == frame for frame in np.unique(frames))
            nearest.append(max(support_nearness(near[active], rows[None, active, 2:]) for active in in_frames))
    return _upper_quantile(nearest)


def _upper_quantile(values: Sequence[float]) -> float:
    """Return the value that most runs do not exceed; unlimited without values, or where they are zero."""
    scale = float(np.quantile(values, ERROR_QUANTILE, method="higher")) if len(values) else 0.0
    return scale if scale > 0.0 else UNLIMITED_SCALE
