"""Work of a worker, on this machine or in a cluster: build the scene once, and make runs."""

from __future__ import annotations

import json
import platform
from collections.abc import Callable, Mapping
from functools import lru_cache
from pathlib import Path
from threading import Lock
from time import perf_counter
from typing import Any
from uuid import uuid4

import numba

from palpate.app.train.folder import Folder, Job
from palpate.app.train.paths import path_of
from palpate.app.train.scene_folder import scene_in_folder
from palpate.core.faults import DivergenceError, InputError
from palpate.core.files import flush_and_rename, write_sealed_json
from palpate.dynamics.run.rollout import rollout
from palpate.scenes.load_case import TrainingScene
from palpate.scenes.training import open_training

Outcome = dict[str, Any]  # "job", "seconds", and if it failed "failed" with the reason
Watch = Callable[[Job, float], None]  # takes a run and the simulated time that it has reached [s]

_one_at_a_time = Lock()  # a model is stepped in place


@lru_cache(maxsize=1)
def _scene(name: str, parameters: str) -> TrainingScene:
    return open_training(name, json.loads(parameters))


def perform(folder: str, manifest: Mapping[str, Any], job: tuple[str, int, int], watch: Watch | None = None) -> Outcome:
    """Make a run; write its file, or a record of its failure, to the campaign's folder.

    The folder must hold the same manifest.
    """
    campaign_job, campaign_folder = Job(*job), Folder(Path(folder), manifest)
    try:
        campaign_folder.check()
    except InputError as error:
        raise OSError(
            f"worker on {platform.node()}: {error}; workers write to the folder, so all must see it"
        ) from error
    with _one_at_a_time:
        threads = numba.get_num_threads()
        numba.set_num_threads(1)  # as everywhere else
        try:
            scene = _scene(scene_in_folder(manifest["scene"], campaign_folder.path), json.dumps(manifest["parameters"]))
            return _run(campaign_folder, scene, campaign_job, watch)
        finally:
            numba.set_num_threads(threads)


def _run(place: Folder, scene: TrainingScene, job: Job, watch: Watch | None) -> Outcome:
    partial, began = place.partial(job, uuid4().hex), perf_counter()

    def progress(time: float, _wall: float) -> None:
        if watch is not None:
            watch(job, time)

    try:
        loads, duration = path_of(place, scene, job)
        options: dict[str, Any] = {"file": partial, "label": place.label(job), "progress": progress}
        rollout(scene.model, loads, duration=duration, every=scene.every, **options)
    except OSError:
        partial.unlink(missing_ok=True)
        raise
    except Exception as error:  # of any kind: the other runs continue
        if partial.exists():
            flush_and_rename(partial, place.failed(job))
        reason = str(error) if isinstance(error, DivergenceError | InputError) else f"{type(error).__name__}: {error}"
        return record_fault(place, job, " ".join(reason.split()), retry=False)
    flush_and_rename(partial, place.file(job))
    place.reason(job).unlink(missing_ok=True)  # of a worker that died
    return {"job": job, "seconds": perf_counter() - began}


def record_fault(place: Folder, job: Job, reason: str, *, retry: bool) -> Outcome:
    """Record the reason for a failed run, and whether a continued campaign repeats it."""
    write_sealed_json(place.reason(job), {"seed": job.seed, "reason": reason, "retry": retry})
    return {"job": job, "failed": reason}
