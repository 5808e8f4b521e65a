"""Training of a scene's reduced model in a separate process of low priority, with progress as lines of JSON.

The process ends with the one that started it. What it has computed stays in the scene's folder
(`palpate.app.models.trained`), from which the next one continues.
"""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from time import monotonic
from typing import IO, Any

import numpy as np

from palpate.app.common.console import Console
from palpate.app.common.exit_status import RunError
from palpate.app.models.touch import NODES_PER_CELL
from palpate.app.models.trained import MAX_WORKERS, held_out_means, model_file, trained_model
from palpate.app.train.local import THREAD_VARIABLES
from palpate.faults import DivergenceError, InputError
from palpate.scenes.names import SceneKind
from palpate.scenes.open_scene import described_scene, text_of_scene
from palpate.scenes.organ_scene import OrganScene

__all__ = ["Progress", "TrainingProcess", "refined_scene", "train_in_process"]

PROCESS_CODE = "from palpate.app.view.training_process import train_in_process; train_in_process()"
WORKER_NICENESS = 19  # the lowest priority
REFINED_NODES = 4500  # of a body without a spacing; statics of training take 5,000 at most
TRAINING_SHARE = 1.3  # time of the training over that of all its runs: 1.3 on a liver of 4,500 nodes
LEAST_SHARE = 0.02  # of the runs, from which their time is estimated
MIN_SECONDS_LEFT = 1.0  # [s]


def refined_scene(scene: OrganScene) -> OrganScene:
    """Return the scene of the reduced model: with its own spacing, or with one that gives about `REFINED_NODES`.

    That of a surface file depends on the file, and not on the folder from which it was opened.
    """
    about = scene.description
    if scene.kind is SceneKind.SURFACE_FILE:
        file = Path(scene.name).absolute()
        support = tuple(
            replace(each, place=replace(each.place, painted=replace(
                each.place.painted, file=str(Path(each.place.painted.file).absolute())
            ))) if each.place.painted else each
            for each in about.support
        )  # fmt: skip
        names = str(Path(about.surface.labels).absolute()) if about.surface.labels else ""
        about = replace(about, surface=replace(about.surface, file=file.name, labels=names), support=support)
        scene = OrganScene(about, file.parent, str(file), scene.kind)
    if about.body.spacing or scene.surface is None:
        return scene
    spacing = np.cbrt(NODES_PER_CELL * abs(scene.surface.volume) / REFINED_NODES)
    return scene.with_body(spacing=float(f"{spacing:.3g}"))


class TrainingProcess:
    """A process that trains the reduced model of a scene.

    Parameters
    ----------
    scene : OrganScene
        As of `refined_scene`.
    """

    def __init__(self, scene: OrganScene) -> None:
        workers = max(min((os.cpu_count() or 1) - 1, MAX_WORKERS), 1)  # the engine keeps a processor
        threads = dict.fromkeys(THREAD_VARIABLES, str(workers))
        idle = getattr(subprocess, "IDLE_PRIORITY_CLASS", 0)  # of Windows, where `os.nice` is not
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", PROCESS_CODE], stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL, env={**os.environ, **threads}, text=True, creationflags=idle,
        )  # fmt: skip
        given = {"name": scene.name, "description": text_of_scene(scene), "workers": workers}
        assert self._process.stdin is not None
        with suppress(OSError):  # it ended already, which is read next
            self._process.stdin.write(json.dumps(given) + "\n")
            self._process.stdin.flush()

    def events(self) -> Iterator[dict[str, Any]]:
        """Yield the reports of the process until it ends; the last is ``trained`` or ``failed``.

        ``phase`` has a text, and the time ``left`` [s] or None. ``trained`` has the file of the model, and its
        mean ``errors`` on held-out runs by name. ``failed`` has a reason.
        """
        assert self._process.stdout is not None
        last: dict[str, Any] = {}
        with self._process.stdout as lines:
            for line in lines:
                last = json.loads(line)
                yield last
        code = self._process.wait()
        if not last.keys() & {"trained", "failed"}:
            yield {"failed": f"the training ended early (exit code {code}); out of memory?"}

    def stop(self) -> None:
        """End the process and its workers."""
        self._process.kill()
        self._process.wait()
        assert self._process.stdin is not None
        with suppress(OSError):
            self._process.stdin.close()


class Progress:
    """Writes events of a training, with the time left by the durations so far.

    Parameters
    ----------
    clock : function
        Returns the time [s].
    """

    def __init__(self, stream: IO[str], clock: Any = monotonic) -> None:
        self._stream, self._clock = stream, clock
        self._runs_began: float | None = None
        self._runs_seconds = 0.0  # of all runs that this process makes, about

    def phase(self, text: str) -> None:
        """Report that a phase begins."""
        left = max(TRAINING_SHARE * self._runs_seconds, MIN_SECONDS_LEFT) if self._runs_seconds else None
        self.write(phase=text, left=left)

    def runs(self, share: float, text: str) -> None:
        """Report the share of the runs that is made."""
        now = self._clock()
        if self._runs_began is None:
            self._runs_began = now
        left = None
        if share > LEAST_SHARE:
            self._runs_seconds = (now - self._runs_began) / share
            left = max((1 - share + TRAINING_SHARE) * self._runs_seconds, MIN_SECONDS_LEFT)
        self.write(phase=text, left=left)

    def write(self, **event: Any) -> None:
        """Write an event."""
        self._stream.write(json.dumps(event) + "\n")
        self._stream.flush()


def train_in_process() -> None:
    """Train the scene that the standard input describes; end when that ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the first process ends this one
    if hasattr(os, "nice"):
        os.nice(WORKER_NICENESS)
    given = json.loads(sys.stdin.readline())

    def watch() -> None:
        while os.read(0, 1024):  # not of `sys.stdin`, whose lock the end of the interpreter would wait for
            pass
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
    progress, sys.stdout = Progress(sys.stdout), sys.stderr
    try:
        scene = described_scene(given["name"], given["description"])
        model = trained_model(scene, Console(progress.phase, progress.runs), given["workers"])
        progress.phase("compiling the engine")
        _compile_engine(model, scene)
        progress.write(trained=str(model_file(scene)), errors=held_out_means(model))
    except (InputError, RunError, DivergenceError, OSError) as error:
        progress.write(failed=" ".join(str(error).split()))
    except Exception as error:
        progress.write(failed=f"{type(error).__name__}: {error}")


def _compile_engine(model: Any, scene: OrganScene) -> None:
    """Run the model's engine for a moment, so that its code is in the cache of compiled functions."""
    from palpate.app.session.session import Session

    session = Session(model, scene.title, foundations=scene.foundations)
    session.start()
    session.close()
