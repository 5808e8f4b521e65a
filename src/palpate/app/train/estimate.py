"""Time of a training before it begins: of its runs, of the training on them, and of what has to be compiled.

A short run of a block of the tissue measures this machine, if the code of runs is compiled. Otherwise the pace is that
of an earlier command on this machine, or a guess.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from time import process_time
from typing import NamedTuple

import numpy as np

from palpate.app.common.compile_ahead import only_compiled_code
from palpate.app.common.compiled_code import code_digest
from palpate.app.common.console import Console, duration_text
from palpate.app.common.machine import keep, kept_seconds, kept_text
from palpate.app.common.sample_block import BLOCK_SIZE, BLOCK_SPACING, sample_block, wave_time
from palpate.app.train.folder import Folder, Job, jobs
from palpate.dynamics.contact.tools import Contact, Sphere
from palpate.dynamics.run.rollout import rollout
from palpate.dynamics.solid.model import EnergySolid
from palpate.scenes.description import Training
from palpate.scenes.scene import Scene
from palpate.scenes.scene_paths import HAND_DURATION
from palpate.scenes.spacing import expected_nodes
from palpate.scenes.tool_paths import MAX_DELAY, PHASE_TIMES, TOUCH_SECONDS
from palpate.tissue.materials import Material

BALL_RADIUS, PRESS_DEPTH = 0.03, 0.004  # [m] of a press on the sample block, which measures the machine
PRESS_WAVES, PRESS_FRAMES = 30, 8  # times of a wave over a spacing, and snapshots of that run
# of one core in docs/validation/first_start.json, until a machine is measured: a run per node and time of a wave over
# a spacing, and compiling of what runs and what the training call [s]
GUESSED_PACE, RUN_COMPILING, TRAINING_COMPILING = 8e-6, 60.0, 60.0
TRAINING_SHARE = 1.3  # time of the training over that of all its runs: 1.3 on a liver of 4,500 nodes
ASK_SECONDS = 120.0  # [s] from which on a command asks before it begins
PACE_NAME = "run, per node and time of a wave over a spacing"  # name of the kept time
RUNS_PART, TRAINING_PART, COMPILING_PART = "runs", "training", "compiling once"


class Estimate(NamedTuple):
    """What a command will do, and about how long its parts take [s] if nothing else runs on this machine."""

    what: str
    seconds: Mapping[str, float]
    is_guess: bool = False  # whether a part was never measured on this machine

    def followed_by(self, other: Estimate) -> Estimate:
        """Return the estimate of both."""
        return Estimate(
            f"{self.what}; then {other.what}", {**self.seconds, **other.seconds}, self.is_guess or other.is_guess
        )

    @property
    def total(self) -> float:
        """Time [s] of all parts."""
        return sum(self.seconds.values())

    def lines(self) -> list[str]:
        """Return the estimate in two lines."""
        parts = ", ".join(f"{name} {duration_text(seconds)}" for name, seconds in self.seconds.items() if seconds >= 1)
        basis = "a guess until all of it is measured here" if self.is_guess else "as measured here"
        return [self.what, f"takes about {duration_text(self.total)} if nothing else runs here ({basis}): {parts}"]


def confirm(console: Console, estimate: Estimate, question: str, yes: bool) -> None:
    """Print an estimate; where it is minutes, ask on a terminal, and raise `RunError` for a no."""
    for line in estimate.lines():
        console.say(line)
    if estimate.total >= ASK_SECONDS and not yes:
        console.confirm(question)


def estimate_training(scene: Scene, training: Training, path: Path, workers: int) -> Estimate:
    """Return the estimate of a training in a folder, whose finished runs stay, before the body is made."""
    planned = jobs(training.seed, range(training.paths), training.held_out)
    left = Folder(path, {}).left(planned)
    pace, is_compiled = measure_pace(scene.material), True
    if pace is not None:
        keep(PACE_NAME, pace)
    else:
        pace, is_compiled = kept_seconds(PACE_NAME), False
    waves = 1.0 / wave_time(scene.material, scene.description.body.spacing or np.inf)
    nodes = _count_nodes(scene)
    second = nodes * waves * (pace or GUESSED_PACE)  # of processor for a second of a run
    runs = [second * sum(_length(scene, training, job) for job in each) for each in (left, planned)]
    compiling = 0.0 if is_compiled else RUN_COMPILING
    if not is_compiled or kept_text(_trained_name(scene)) != code_digest():
        compiling += TRAINING_COMPILING
    most, kept = "at most " if training.tolerance else "", len(planned) - len(left)
    what = (
        f"{scene.title}: about {nodes:,.0f} nodes, {most}{len(planned)} runs of its full body"
        + (f" ({kept} of them kept from before)" if kept else "")
        + f", and a training of {training.modes} modes on them"
    )
    seconds = {RUNS_PART: runs[0] / max(min(workers, len(left)), 1), TRAINING_PART: TRAINING_SHARE * runs[1]}
    return Estimate(what, {**seconds, COMPILING_PART: compiling}, is_guess=pace is None)


def keep_trained(scene: Scene) -> None:
    """Keep that all that a training of a scene calls is compiled."""
    keep(_trained_name(scene), code_digest())


def _trained_name(scene: Scene) -> str:
    return f"code of a training: {type(scene.material).__name__}, {'held' if scene.held_group else 'touched'}"


def measure_pace(material: Material) -> float | None:
    """Return the processor time [s] of a run per node and time of a wave over a spacing; None if it would compile.

    The run is a press of a ball on a block.
    """
    results = list[float]()
    with only_compiled_code():
        body = sample_block(material)
        seconds = [press(body) for _ in range(2)]  # the first loads the code
        results.append(seconds[1] / (len(body.cloud) * PRESS_WAVES))
    return results[0] if results else None


def press(body: EnergySolid) -> float:
    """Press a ball on the sample block; return the processor time [s] of that run."""
    duration = PRESS_WAVES * wave_time(body.material, BLOCK_SPACING)
    top, middle = BLOCK_SIZE + BALL_RADIUS, BLOCK_SIZE / 2
    ball = Contact(Sphere(BALL_RADIUS), lambda t: (middle, middle, top - PRESS_DEPTH * t / duration))
    began = process_time()
    rollout(body, [ball], duration=duration, every=duration / PRESS_FRAMES, progress=False)
    return process_time() - began


def _count_nodes(scene: Scene) -> float:
    """Return about the number of nodes of a body; that of a generated box or disc exactly."""
    surface, spacing = scene.surface, scene.description.body.spacing
    if surface is None or spacing is None or "cloud" in vars(scene):
        return len(scene.cloud)
    return expected_nodes(abs(surface.volume), spacing)


def _length(scene: Scene, training: Training, job: Job) -> float:
    """Return the expected length [s] of a run."""
    is_trained_on = job.kind == "train"
    if scene.held_group:
        return training.duration * (1.0 if is_trained_on else HAND_DURATION)
    return PHASE_TIMES[-1] if is_trained_on else TOUCH_SECONDS + 0.5 * MAX_DELAY * training.pairs
