"""Training of a scene's reduced model in a separate process of low priority.

The process ends with the one that started it. What it has computed stays in the scene's folder
(`palpate.app.models.trained`), from which the next one continues.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from time import monotonic
from typing import Any

from palpate.app.common.console import Console
from palpate.app.common.exit_status import RunError
from palpate.app.models.trained import (
    MAX_WORKERS,
    compared_file,
    compared_modes,
    held_out_means,
    model_file,
    train_compared,
    trained_model,
    training_needed,
)
from palpate.app.train.local import THREAD_VARIABLES
from palpate.core.faults import DivergenceError, InputError
from palpate.core.processes import Answer, Child, Receive
from palpate.reduction.storage.models import load
from palpate.scenes.open_scene import json_of_scene, open_description
from palpate.scenes.scene import Scene

TRAINING_SHARE = 1.3  # time of the training over that of all its runs: 1.3 on a liver of 4,500 nodes
MIN_SHARE = 0.02  # of the runs, from which their time is estimated
MIN_SECONDS_LEFT = 1.0  # [s]


class TrainingProcess:
    """A process that trains the reduced model of a scene, one of `complete_for_training`.

    With `compared`, it trains those of `palpate.app.models.trained.train_compared`, for which somebody waits: its
    priority is the usual one.
    """

    def __init__(self, scene: Scene, compared: bool = False) -> None:
        workers = max(min((os.cpu_count() or 1) - 1, MAX_WORKERS), 1)  # the engine keeps a processor
        threads = dict.fromkeys(THREAD_VARIABLES, str(workers))
        request = {"name": scene.name, "description": json_of_scene(scene), "workers": workers}
        function = train_compared_in_process if compared else train_in_process
        self._child = Child(function, request, environment=threads, idle=not compared)

    def events(self) -> Iterator[dict[str, Any]]:
        """Yield the reports of the process until it ends; the last is ``trained`` or ``failed``.

        ``phase`` has a text, and the time ``left`` [s] or None; that before a training also lines of an ``estimate``.
        ``trained`` has the file of the model, and its mean ``errors`` on held-out runs by name. ``failed`` has a
        reason.
        """
        last: dict[str, Any] = {}
        for last in self._child.answers():
            yield last
        code = self._child.wait()
        if not last.keys() & {"trained", "failed"}:
            yield {"failed": f"the training ended early (exit code {code}); out of memory?"}

    def stop(self) -> None:
        """End the process and its workers."""
        self._child.stop()


class Progress:
    """Reports events of a training, with the time left by the durations so far; `clock` returns the time [s]."""

    def __init__(self, report: Callable[[dict[str, Any]], None], clock: Any = monotonic) -> None:
        self._report, self._clock = report, clock
        self._runs_began: float | None = None
        self._runs_seconds = 0.0  # of all runs that this process makes, about

    def phase(self, text: str) -> None:
        """Report that a phase begins."""
        left = max(TRAINING_SHARE * self._runs_seconds, MIN_SECONDS_LEFT) if self._runs_seconds else None
        self._report({"phase": text, "left": left})

    def runs(self, share: float, text: str) -> None:
        """Report the share of the runs that is made."""
        now = self._clock()
        if self._runs_began is None:
            self._runs_began = now
        left = None
        if share > MIN_SHARE:
            self._runs_seconds = (now - self._runs_began) / share
            left = max((1 - share + TRAINING_SHARE) * self._runs_seconds, MIN_SECONDS_LEFT)
        self._report({"phase": text, "left": left})


def train_in_process(receive: Receive, answer: Answer) -> None:
    """Train the scene of a description."""

    def train(scene: Scene, progress: Progress, workers: int) -> dict[str, Any]:
        estimate = training_needed(scene, Console(progress.phase), workers)
        if estimate is not None:
            answer({"phase": "starting", "left": estimate.total, "estimate": estimate.lines()})
        model = trained_model(scene, Console(progress.phase, progress.runs), workers)
        progress.phase("compiling the engine")
        _compile_engine(model, scene)
        return {"trained": str(model_file(scene)), "errors": held_out_means(model)}

    _answer_training(train, receive(), answer)


def train_compared_in_process(receive: Receive, answer: Answer) -> None:
    """Train the models of a scene's description that are compared with its full body."""

    def train(scene: Scene, progress: Progress, workers: int) -> dict[str, Any]:
        train_compared(scene, Console(progress.phase, progress.runs), workers)
        progress.phase("compiling the engine, once for this computer")
        file = compared_file(scene, compared_modes(scene)[0])
        _compile_engine(load(file), scene)
        return {"trained": str(file), "errors": {}}

    _answer_training(train, receive(), answer)


def _answer_training(
    train: Callable[[Scene, Progress, int], dict[str, Any]], request: dict[str, Any], answer: Answer
) -> None:
    """Train the scene of a request by a function of it, the progress and a number of processes; answer its result."""
    progress = Progress(answer)
    try:
        scene = open_description(request["name"], request["description"])
        answer(train(scene, progress, request["workers"]))
    except (InputError, RunError, DivergenceError, OSError) as error:
        answer({"failed": " ".join(str(error).split())})
    except Exception as error:
        answer({"failed": f"{type(error).__name__}: {error}"})


def _compile_engine(model: Any, scene: Scene) -> None:
    """Run the model's engine for a moment, so that its code is in the cache of compiled functions."""
    from palpate.app.session.session import Session

    session = Session(model, scene.title, foundations=scene.foundations)
    session.start()
    session.close()
