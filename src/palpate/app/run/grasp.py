"""A reduced model of the grasped beam, trained on a few short motions of the hand."""

from __future__ import annotations

from palpate.dynamics.full import FullModel
from palpate.dynamics.loads import PrescribedMotion
from palpate.dynamics.rollout import rollout
from palpate.dynamics.trajectory import Trajectory
from palpate.reduction.reduced import ReducedModel
from palpate.reduction.training import reduce
from palpate.scenes.grasp import GROUP, Hand

__all__ = ["train"]

LASTING, EVERY = 0.4, 0.005  # [s] of a training run
TRAINING, HELD_OUT = 6, 2  # runs


def train(full: FullModel, modes: int) -> ReducedModel:
    """Train a reduced model of a grasped beam on a few short motions, and try it on others."""
    trials = [_trial(full, seed) for seed in range(TRAINING + HELD_OUT)]
    runs = [run for _, run in trials[:TRAINING]]
    return reduce(full, runs, modes=modes, driven=GROUP, held_out=trials[TRAINING:])


def _trial(full: FullModel, seed: int) -> tuple[list[PrescribedMotion], Trajectory]:
    loads = [Hand(seed, LASTING).load(full.cloud)]
    return loads, rollout(full, loads, duration=LASTING, every=EVERY)
