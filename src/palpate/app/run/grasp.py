"""``palpate run beam --realtime``: the beam, grasped by a moving hand, reduced on a few short motions of it."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter
from typing import Any

from palpate.app.console import Console, count_nodes
from palpate.app.run.realtime import Poses, run_realtime
from palpate.dynamics.full import FullModel
from palpate.dynamics.loads import PrescribedMotion
from palpate.dynamics.rollout import rollout
from palpate.dynamics.trajectory import Trajectory
from palpate.faults import integer_in_range
from palpate.reduction.reduced import ReducedModel
from palpate.reduction.storage import load
from palpate.reduction.training import reduce
from palpate.scenes.beam import COARSEST
from palpate.scenes.grasp import GROUP, Hand, grasp

__all__ = ["run_grasp", "train", "trained"]

LASTING, EVERY = 0.4, 0.005  # [s] of a training run
TRAINING, HELD_OUT = 6, 2  # runs
MOST_MODES = 96
SEED, SLOW = 1000, 3.0  # of the hand's motion, which was not trained on, [s]


def run_grasp(
    *,
    modes: int = 24,
    spacing: float = COARSEST,
    poisson: float = 0.45,
    model: Path | None = None,
    **options: Any,
) -> int:
    """Train or load a reduced beam, let a hand move its free end for some seconds, and report how the rate was kept.

    Parameters
    ----------
    modes : int
        Of the model that is trained.
    spacing : float [m]
    poisson : float
        As for `palpate.scenes.beam.beam`; 0.45 takes larger steps than the paper's 0.49.
    model : path, optional
        File of a reduced model to take instead, of which one group is driven.
    options : mapping
        ``seconds``, ``rate``, ``out`` and ``as_json``: see `palpate.app.run.realtime.run_realtime`.

    Returns
    -------
    int
        0, whether the rate was held or not.

    Raises
    ------
    InputError, FileFormatError
        A parameter out of range; a file that holds no reduced model that a tool holds.
    ReproduceError
        The state ran away; the black box is kept.
    OSError
        A file could not be read or written.
    """
    modes = integer_in_range("modes", modes, 1, MOST_MODES)

    def made(console: Console) -> tuple[ReducedModel, Poses, None]:
        body = load(model) if model is not None else trained(spacing, poisson, modes, console)
        return body, Hand(SEED, SLOW), None

    return run_realtime(made, title="Beam in real time", about={"file": model and str(model)}, **options)


def trained(spacing: float, poisson: float, modes: int, console: Console) -> ReducedModel:
    """Return a reduced model of a grasped beam, trained now; say how it does."""
    start = perf_counter()
    with console.status("making the full model ready (the first run on a machine compiles it: a minute or two)"):
        full = grasp(spacing, poisson)
    console.say(f"training {modes} modes on short runs of {len(full.cloud)} nodes whose end a tool moves ...")
    body = train(full, modes)
    error = body.report["held_out"]["mean"]
    console.say(
        f"trained in {perf_counter() - start:.3g} s, {count_nodes(body.report['nodes'])} sampled; on motions not "
        f"trained on displacements err by {error['displacement']:.2%}, reaction forces by {error['reaction']:.2%}"
    )
    return body


def train(full: FullModel, modes: int) -> ReducedModel:
    """Train a reduced model of a grasped beam on a few short motions, and try it on others."""
    trials = [_trial(full, seed) for seed in range(TRAINING + HELD_OUT)]
    runs = [run for _, run in trials[:TRAINING]]
    return reduce(full, runs, modes=modes, driven=GROUP, held_out=trials[TRAINING:])


def _trial(full: FullModel, seed: int) -> tuple[list[PrescribedMotion], Trajectory]:
    loads = [Hand(seed, LASTING).load(full.cloud)]
    return loads, rollout(full, loads, duration=LASTING, every=EVERY)
