"""Choice of the training paths on which a reduced model errs most, by the model alone.

POD-greedy (Haasdonk and Ohlberger, ESAIM: M2AN 42, 2008): the reduced model runs along candidate paths, and the full
model along those with the largest trust numbers. Several are chosen at a time. So the states of those already chosen
count as trained, and two similar paths are not chosen together.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np

from palpate.app.train.folder import Folder, Job
from palpate.app.train.paths import path_of
from palpate.dynamics.run.rollout import rollout
from palpate.dynamics.run.trajectory import Trajectory
from palpate.faults import DivergenceError, TrustWarning
from palpate.reduction.hyper.error_indicator import distances_to_nearest
from palpate.reduction.hyper.model import ReducedModel
from palpate.scenes.scene import TrainingScene

__all__ = ["CANDIDATES_PER_RUN", "FIRST_RUNS", "choose", "next_count"]

FIRST_RUNS = 4  # before the first model
ROUND_GROWTH = 0.5  # further runs of a round, over those before
MIN_ROUND = 2
CANDIDATES_PER_RUN = 4  # paths that the reduced model tries for every path that is chosen


def next_count(runs: int, most: int) -> int:
    """Return the number of further runs of the next round."""
    return min(max(MIN_ROUND, int(np.ceil(ROUND_GROWTH * runs))), most - runs)


def choose(
    model: ReducedModel, folder: Folder, scene: TrainingScene, candidates: Sequence[Job], count: int
) -> list[Job]:
    """Return the paths with the largest trust numbers of a reduced model, each unlike those before it.

    A path on which the reduced model diverges counts as the worst.
    """
    runs = [_reduced_run(model, folder, scene, job) for job in candidates]
    trust = [np.full(1, np.inf) if run is None else run.trust for run in runs]
    mass = model.body.mass / model.body.masses.sum()
    states = [np.zeros((1, len(mass))) if run is None else model.body.project(run.displacements) for run in runs]
    nearest = [np.full(len(own), np.inf) for own in trust]  # distance to the chosen paths, over the scale of trust
    chosen: list[int] = []
    while len(chosen) < min(count, len(candidates)):
        scores = [float(np.max(np.minimum(own, near))) for own, near in zip(trust, nearest, strict=True)]
        scores = [-1.0 if k in chosen else score for k, score in enumerate(scores)]
        chosen.append(int(np.argmax(scores)))
        for k, own in enumerate(states):
            if runs[chosen[-1]] is not None:
                apart = distances_to_nearest(own, states[chosen[-1]], mass) / model.data.distance_scale
                nearest[k] = np.minimum(nearest[k], apart)
    return [candidates[k] for k in chosen]


def _reduced_run(model: ReducedModel, folder: Folder, scene: TrainingScene, job: Job) -> Trajectory | None:
    loads, duration = path_of(folder, scene, job)
    with warnings.catch_warnings(action="ignore", category=TrustWarning):  # it is what counts here
        try:
            return rollout(model, loads, duration=duration, every=scene.every, progress=False)
        except DivergenceError:
            return None
