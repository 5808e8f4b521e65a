"""``palpate run beam --realtime``: the beam, whose end a tool moves, reduced on a few short motions of it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from palpate.app.common.console import Console
from palpate.app.models.quick_training import train_quickly
from palpate.app.run.realtime import Poses, run_realtime
from palpate.faults import integer_in_range
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.storage.models import load
from palpate.scenes.beam import MAX_SPACING
from palpate.scenes.grasp import Hand, grasped_beam
from palpate.scenes.scene import TrainingScene

__all__ = ["run_grasp"]

RUN_SECONDS, EVERY = 0.4, 0.005  # [s] of a training run
MAX_MODES = 96
SEED, SLOW = 1000, 3.0  # seed and duration [s] of a motion of the tool that was not trained on


def run_grasp(
    *,
    modes: int = 24,
    spacing: float = MAX_SPACING,
    poisson: float = 0.45,
    model: Path | None = None,
    **options: Any,
) -> int:
    """Train or load a reduced beam, move its free end for some seconds, and report how the rate was kept.

    Parameters
    ----------
    modes : int
        Of the model that is trained.
    spacing : float [m]
    poisson : float
        As for `palpate.scenes.beam.beam`; 0.45 takes larger steps than the paper's 0.49.
    model : path, optional
        File of a reduced model to take instead, of which one group is prescribed.
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
    RunError
        The state ran away; the black box is kept.
    OSError
        A file could not be read or written.
    """
    modes = integer_in_range("modes", modes, 1, MAX_MODES)

    def scene() -> TrainingScene:
        return grasped_beam(spacing, poisson, RUN_SECONDS, EVERY)

    def make(console: Console) -> tuple[ReducedModel, Poses, None]:
        body = load(model) if model is not None else train_quickly(scene, modes, console)
        return body, Hand(SEED, SLOW), None

    return run_realtime(make, title="Beam in real time", about={"file": model and str(model)}, **options)
