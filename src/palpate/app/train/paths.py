"""Paths of a campaign's runs: by seed from its scene, or from recordings of sessions that were added to it."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np

from palpate.app.recordings.recorded_paths import RecordedPath, recorded_paths
from palpate.app.recordings.recording import Recording, load_recording
from palpate.app.train.folder import RECORDED, Folder, Job
from palpate.core.faults import InputError
from palpate.core.files import read_bytes, whole_file
from palpate.dynamics.loads.prepared import Load
from palpate.reduction.hyper.model import ReducedModel
from palpate.scenes.load_case import TrainingScene

SEEDS_PER_RECORDING = 100_000  # seeds of one recording
SAME_POINT = 1e-6  # distance between points of one body, over the spacing


def path_of(folder: Folder, scene: TrainingScene, job: Job) -> tuple[Sequence[Load], float]:
    """Return the loads of a run and its duration [s]."""
    if job.kind != RECORDED:
        return scene.path(job.seed)
    path = _untrusted(folder.recordings[job.seed // SEEDS_PER_RECORDING])[job.seed % SEEDS_PER_RECORDING]
    return (path.load,), max(1, round(path.duration / scene.every)) * scene.every


def recorded_jobs(folder: Folder) -> list[Job]:
    """Return the runs along the recorded paths beyond trust, of all recordings in a folder."""
    seeds = [
        SEEDS_PER_RECORDING * r + k for r, file in enumerate(folder.recordings) for k in range(len(_untrusted(file)))
    ]
    return [Job(RECORDED, number, seed) for number, seed in enumerate(seeds)]


def add_recording(folder: Folder, scene: TrainingScene, path: Path) -> None:
    """Copy a recording into a campaign's folder, unless it is there already."""
    content = read_bytes(path, "recording")
    if any(content == read_bytes(file, "recording") for file in folder.recordings):
        return
    recording = load_recording(path)
    _check(recording, scene, path)
    paths = recorded_paths(recording)
    if not any(tool_path.trust > 1 for tool_path in paths):
        largest = f", the largest error indicator is {max(tool_path.trust for tool_path in paths):.3g}" if paths else ""
        raise InputError(
            f"{path} must have a path beyond trust, got {len(paths)} paths within{largest}; nothing would be learned"
        )
    folder.recordings_folder.mkdir(exist_ok=True)
    with whole_file(folder.recordings_folder / f"{len(folder.recordings):06d}.h5") as partial:
        partial.write_bytes(content)


def _check(recording: Recording, scene: TrainingScene, path: Path) -> None:
    """Raise `InputError` for a recording of another body, or with tools that hold other groups."""
    if not isinstance(recording.model, ReducedModel):
        raise InputError(
            f"{path} must be a recording of a reduced model, got one of a full body; record a session with a model of "
            "this campaign"
        )
    recorded, cloud = recording.model.cloud.points, scene.model.cloud
    if recorded.shape != cloud.points.shape or not np.allclose(recorded, cloud.points, atol=SAME_POINT * cloud.spacing):
        raise InputError(
            f"{path} must be a recording of the campaign's body, got {len(recorded)} other points; "
            "record a session with a model of this campaign"
        )
    if tuple(recording.model.data.prescribed) != tuple(scene.tools):
        groups = ", ".join(recording.model.data.prescribed) or "none"
        raise InputError(
            f"{path} must be of a model whose tools hold {', '.join(scene.tools) or 'none'}, got {groups}; "
            "record a session with a model of this campaign"
        )


@lru_cache(maxsize=2)
def _untrusted(file: Path) -> list[RecordedPath]:
    return [path for path in recorded_paths(load_recording(file)) if path.trust > 1]
