"""Choice of training paths by their gain in covered surface and by the expected error.

The method is POD-greedy (Haasdonk and Ohlberger, ESAIM: M2AN 42, 2008). The reduced model runs along
candidate paths, and the full model along those with the largest scores. Several are chosen at a time.
The states of those already chosen count as trained, so that two similar paths are not chosen together.

The score of a path has two terms. The first is the error expected at its error indicator, at most 1, and 1
if it is unknown. The second is the newly covered share of the surface under its tools. An uncovered
place counts as an error of 100 %, and comes first; on a covered surface the error decides. Equal scores
are ordered by the error indicator.
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence

import numpy as np

from palpate.app.train.coverage import Coverage
from palpate.app.train.folder import Folder, Job
from palpate.app.train.paths import path_of
from palpate.core.faults import DivergenceError, TrustWarning
from palpate.dynamics.run.rollout import rollout
from palpate.dynamics.run.trajectory import Trajectory
from palpate.reduction.hyper.error_indicator import expected_error
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.training.scales import distances_to_nearest
from palpate.scenes.load_case import TrainingScene

FIRST_RUNS = 4  # before the first model
ROUND_GROWTH = 0.5  # further runs of a round, over those before
MIN_ROUND = 2
CANDIDATES_PER_RUN = 4  # paths that the reduced model tries for every path that is chosen


def next_count(runs: int, most: int) -> int:
    """Return the number of further runs of the next round."""
    return min(max(MIN_ROUND, int(np.ceil(ROUND_GROWTH * runs))), most - runs)


def choose(
    model: ReducedModel,
    folder: Folder,
    scene: TrainingScene,
    candidates: Sequence[Job],
    count: int,
    trained: Sequence[Job] = (),
) -> list[Job]:
    """Return the paths with the largest scores, each after those before it count as trained.

    The tools of the runs `trained` cover the surface already. A path on which the reduced model diverges has an unknown
    error.
    """
    runs = [_reduced_run(model, folder, scene, job) for job in candidates]
    trust = [np.full(1, np.inf) if run is None else run.trust for run in runs]
    mass = model.body.mass / model.body.masses.sum()
    states = [np.zeros((1, len(mass))) if run is None else model.body.project(run.displacements) for run in runs]
    # distances to the chosen paths, over the scale of trust
    nearest = [np.full(len(path_trust), np.inf) for path_trust in trust]
    paths = [path_of(folder, scene, job) for job in candidates]
    before = [path_of(folder, scene, job) for job in trained]
    covered = None if scene.model.kinematics.sheet else Coverage(scene, before)
    chosen: list[int] = []
    while len(chosen) < min(count, len(candidates)):
        left = [k for k in range(len(candidates)) if k not in chosen]
        numbers = {k: float(np.max(np.minimum(trust[k], nearest[k]))) for k in left}
        added = {k: 0.0 if covered is None else covered.added(paths[k]) for k in left}
        chosen.append(max(left, key=lambda k: (added[k] + _expected_error(model, numbers[k]), numbers[k])))
        if covered is not None:
            covered.add(paths[chosen[-1]])
        for k, path_states in enumerate(states):
            if runs[chosen[-1]] is not None:
                apart = distances_to_nearest(path_states, states[chosen[-1]], mass) / model.data.scales.distance_scale
                nearest[k] = np.minimum(nearest[k], apart)
    return [candidates[k] for k in chosen]


def _expected_error(model: ReducedModel, trust: float) -> float:
    """Return the larger of the median errors of displacement and force at an error indicator, at most 1."""
    curves = model.report.get("held_out", {}).get("expected_error", {})
    quantities = [quantity for quantity in ("displacement", "force") if quantity in curves]
    if not quantities or not np.isfinite(trust):
        return 1.0
    return min(1.0, max(expected_error(model.report, trust, quantity).median for quantity in quantities))


def _reduced_run(model: ReducedModel, folder: Folder, scene: TrainingScene, job: Job) -> Trajectory | None:
    loads, duration = path_of(folder, scene, job)
    with warnings.catch_warnings(action="ignore", category=TrustWarning):  # it is what counts here
        try:
            return rollout(model, loads, duration=duration, every=scene.every, progress=False)
        except DivergenceError:
            return None
