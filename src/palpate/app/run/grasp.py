"""``palpate run beam --realtime``: the beam, grasped by a moving hand, reduced on a few short motions of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from palpate.app.console import Console
from palpate.app.run.quick import trained
from palpate.app.run.realtime import Poses, run_realtime
from palpate.faults import integer_in_range
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.storage.models import load
from palpate.scenes.beam import COARSEST
from palpate.scenes.grasp import Hand, grasped_beam
from palpate.scenes.scene import TrainingScene

__all__ = ["run_grasp"]

LASTING, EVERY = 0.4, 0.005  # [s] of a training run
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

    def scene() -> TrainingScene:
        return grasped_beam(spacing, poisson, LASTING, EVERY)

    def made(console: Console) -> tuple[ReducedModel, Poses, None]:
        body = load(model) if model is not None else trained(scene, modes, console)
        return body, Hand(SEED, SLOW), None

    return run_realtime(made, title="Beam in real time", about={"file": model and str(model)}, **options)
