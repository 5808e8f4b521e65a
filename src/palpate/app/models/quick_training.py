"""Training of a reduced model at once, on a few short motions of the tool that moves a group of the body."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter

from palpate.app.common.console import Console, count_nodes
from palpate.dynamics.loads.prepared import Load
from palpate.dynamics.run.rollout import rollout
from palpate.dynamics.run.trajectory import Trajectory
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.training.reduce import hyper_reduce
from palpate.scenes.scene import TrainingScene

__all__ = ["train", "train_quickly"]

TRAINING, HELD_OUT = 6, 2  # runs


def train_quickly(build: Callable[[], TrainingScene], modes: int, console: Console) -> ReducedModel:
    """Return a reduced model of a scene, trained at once; print its errors on other motions."""
    start = perf_counter()
    with console.status("making the full model ready (the first run on a machine compiles it: a minute or two)"):
        scene = build()
    console.say(
        f"training {modes} modes on short runs of {len(scene.model.cloud)} nodes of which a tool moves some ..."
    )
    body = train(scene, modes)
    error = body.report["held_out"]["mean"]
    console.say(
        f"trained in {perf_counter() - start:.3g} s, {count_nodes(body.report['nodes'])} sampled; on motions not "
        f"trained on displacements err by {error['displacement']:.2%}, reaction forces by {error['reaction']:.2%}"
    )
    return body


def train(scene: TrainingScene, modes: int) -> ReducedModel:
    """Train a reduced model of a scene on a few short motions, and measure its errors on others."""
    trials = [_trial(scene, seed) for seed in range(TRAINING + HELD_OUT)]
    runs = [run for _, run in trials[:TRAINING]]
    return hyper_reduce(
        scene.model, runs, modes=modes, prescribed=scene.tools, held_out=trials[TRAINING:], cubature=scene.cubature
    )


def _trial(scene: TrainingScene, seed: int) -> tuple[list[Load], Trajectory]:
    loads, lasting = scene.path(seed)
    return list(loads), rollout(scene.model, list(loads), duration=lasting, every=scene.every)
