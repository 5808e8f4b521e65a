"""Folder of a campaign: its manifest, and the files of its runs.

``campaign.json`` identifies the campaign. ``recordings/`` holds the added recordings, and ``rounds.json``
the paths that a campaign with a tolerance has chosen. ``runs/`` holds a file for every finished run. For
a failed run it holds a ``.failed.json`` with the reason, and its frames, if any, in a ``.failed.h5``.
Every such file is complete. An unfinished file has a hidden name that ends in ``.partial``.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import IO, Any, NamedTuple

import numpy as np

from palpate import __version__
from palpate.core.faults import FileFormatError, InputError
from palpate.core.files import digest_of, read_sealed_json, regular_file, write_sealed_json
from palpate.core.sealed import loading
from palpate.dynamics.run.trajectory import StoredTrajectory
from palpate.scenes.load_case import CAMPAIGN_SEEDS, TRAINING_SEEDS, TrainingScene

FORMAT, VERSION = "palpate campaign", 2
MAX_RECORD_BYTES = 1 << 20  # bytes of a manifest, or of the record of a failed run
TRAINED, HELD_OUT, RECORDED = "train", "held_out", "recorded"
RECORDINGS_FOLDER = "recordings"  # folder of the recordings in that of a campaign
MAX_PATHS = TRAINING_SEEDS  # of either kind of run


class Job(NamedTuple):
    """A run: its purpose, its number from 0, and the seed of its path or its place in the recordings."""

    kind: str
    number: int
    seed: int

    @property
    def name(self) -> str:
        """Name of its file, less the suffix."""
        return f"{self.kind}_{self.number:06d}"


def jobs(seed: int, paths: Iterable[int], held_out: int) -> list[Job]:
    """Return the runs of a campaign: of training paths by number, and a number of held-out ones."""
    first = seed * CAMPAIGN_SEEDS
    return [Job(TRAINED, k, first + k) for k in paths] + [
        Job(HELD_OUT, k, first + MAX_PATHS + k) for k in range(held_out)
    ]


def manifest_of(name: str, scene: TrainingScene, seed: int) -> dict[str, Any]:
    """Return the manifest, which distinguishes one campaign's folder from another's."""
    return {
        "format": FORMAT,
        "version": VERSION,
        "palpate": __version__,
        "scene": name,
        "title": scene.title,  # of its paths, which may change from version to version
        "parameters": dict(scene.parameters),
        "seed": seed,
        "every": scene.every,
        "nodes": len(scene.model.cloud),
    }


@dataclass(frozen=True)
class Folder:
    """A folder that belongs to a campaign."""

    path: Path
    manifest: Mapping[str, Any]  # as `manifest_of` makes it

    @property
    def runs(self) -> Path:
        """Folder of the runs."""
        return self.path / "runs"

    def file(self, job: Job) -> Path:
        """Trajectory file of a finished run."""
        return self.runs / f"{job.name}.h5"

    def failed(self, job: Job) -> Path:
        """File of the frames of a failed run."""
        return self.runs / f"{job.name}.failed.h5"

    def reason(self, job: Job) -> Path:
        """File of the reason for a failed run."""
        return self.runs / f"{job.name}.failed.json"

    def partial(self, job: Job, token: str) -> Path:
        """Name of an unfinished file, with a unique token."""
        return self.runs / f".{job.name}.{token}.partial"

    def sweep(self, job: Job | None = None) -> None:
        """Remove unfinished files of stopped workers: of one run, or of all."""
        for partial in self.runs.glob(".*.partial" if job is None else f".{job.name}.*.partial"):
            partial.unlink(missing_ok=True)

    def fault(self, job: Job) -> dict[str, Any] | None:
        """Return the record of a run that failed and would fail again."""
        record = self.record(job)
        return None if record is None or record["retry"] else record

    def record(self, job: Job) -> dict[str, Any] | None:
        """Return the record of a run that failed."""
        path = self.reason(job)
        if not path.exists():
            return None
        with loading(path, "delete the file, and the same command runs it again"):
            record = read_sealed_json(path, "record of a failed run", MAX_RECORD_BYTES)
            if record.keys() != {"seed", "reason", "retry"} or not isinstance(record["reason"], str):
                raise InputError("this is not the record of a failed run")
        return record

    def label(self, job: Job) -> str:
        """Label of the run's trajectory, which distinguishes it from files of other campaigns and runs."""
        return f"{digest_of(dict(self.manifest))[:16]} {job.name}"

    def check_run(self, job: Job) -> None:
        """Raise `FileFormatError` unless the file of a finished run is a trajectory of this run."""
        path = self.file(job)
        run = StoredTrajectory(path)
        if run.label != self.label(job):
            raise FileFormatError(f"{path} is the file of another run; delete it, and the same command runs it again")
        expected_times = self.manifest["every"] * np.arange(len(run.times))
        if len(expected_times) < 2 or not np.allclose(run.times, expected_times, rtol=1e-6):
            raise FileFormatError(
                f"{path} has other times than the run's; delete it, and the same command runs it again"
            )

    def left(self, jobs: Sequence[Job]) -> list[Job]:
        """Return the runs that have no result yet."""
        return [job for job in jobs if not self.file(job).exists() and self.fault(job) is None]

    @property
    def recordings_folder(self) -> Path:
        """Folder of the recordings."""
        return self.path / RECORDINGS_FOLDER

    @property
    def recordings(self) -> list[Path]:
        """Recordings that were added to the campaign, in their order."""
        return sorted(self.recordings_folder.glob("[0-9]*.h5"))

    def rounds(self) -> list[list[int]]:
        """Return the numbers of the training paths that were chosen, round by round."""
        path = self.path / "rounds.json"
        if not path.exists():
            return []
        with loading(path, "delete the file, and the same command chooses paths again"):
            rounds = read_sealed_json(path, "record of chosen paths", MAX_RECORD_BYTES).get("rounds")
            if not isinstance(rounds, list) or not all(_are_numbers(each) for each in rounds):
                raise InputError("this is not a record of chosen paths")
        return rounds

    def write_rounds(self, rounds: Sequence[Sequence[int]]) -> None:
        """Record the numbers of chosen paths."""
        write_sealed_json(self.path / "rounds.json", {"rounds": [list(each) for each in rounds]})

    def check(self) -> None:
        """Raise `InputError` unless the manifest in the folder is this one."""
        _compare(self.path, _read(self.path / "campaign.json"), self.manifest)


def _are_numbers(paths: Any) -> bool:
    return isinstance(paths, list) and all(type(k) is int and 0 <= k < MAX_PATHS for k in paths)


@contextmanager
def open_campaign(path: Path, manifest: Mapping[str, Any]) -> Iterator[Folder]:
    """Make the folder of a campaign, or continue the campaign in it; lock it against other processes."""
    folder, manifest_path = Folder(path, manifest), path / "campaign.json"
    if manifest_path.exists():
        folder.check()
    elif folder.runs.exists():
        raise InputError(f"{path} holds runs, but no campaign.json; choose another folder")
    folder.runs.mkdir(parents=True, exist_ok=True)
    with _open_lock(path / ".lock") as lock:
        _lock(lock, path)
        if not manifest_path.exists():
            write_sealed_json(manifest_path, dict(manifest))
        folder.sweep()
        yield folder
        folder.sweep()  # files of killed workers


def _open_lock(path: Path) -> IO[str]:
    """Open the file that is locked; refuse a link, which would create a file elsewhere, and a pipe."""
    if path.is_symlink():
        raise InputError(f"{path} must be a regular file, got a link; remove it")
    if path.exists():
        regular_file(path, "lock")  # opening a pipe would wait
    flags = os.O_WRONLY | os.O_CREAT | os.O_APPEND | getattr(os, "O_NOFOLLOW", 0)
    return os.fdopen(os.open(path, flags, 0o666), "a")


def _read(path: Path) -> dict[str, Any]:
    if not path.exists():
        raise InputError(f"{path} does not exist")
    with loading(path, "choose another folder"):
        manifest = read_sealed_json(path, FORMAT, MAX_RECORD_BYTES)
        if manifest.get("format") != FORMAT or not isinstance(manifest.get("parameters"), dict):
            raise InputError(f"this is not a {FORMAT}")
    return manifest


def _compare(path: Path, stored: Mapping[str, Any], expected: Mapping[str, Any]) -> None:
    differing = [
        f"{name} is {stored.get(name)!r} there, {expected.get(name)!r} here"
        for name in dict.fromkeys((*expected, *stored))
        if name != "parameters" and stored.get(name) != expected.get(name)
    ]
    old, new = stored["parameters"], expected["parameters"]
    differing += [
        f"{name} is {old.get(name)!r} there, {new.get(name)!r} here"
        for name in dict.fromkeys((*new, *old))
        if old.get(name) != new.get(name)
    ]
    if differing:
        raise InputError(
            f"{path} is the folder of another campaign: {'; '.join(differing)}. Choose another folder, or continue "
            "that campaign with its own parameters; nothing was changed"
        )


def _lock(file: Any, path: Path) -> None:
    """Lock a file for as long as it is open and this process lives."""
    try:
        if sys.platform == "win32":
            import msvcrt

            msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
        else:
            import fcntl

            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except (BlockingIOError, PermissionError):
        raise InputError(f"{path} is in use by a campaign that runs: wait for it, or choose another folder") from None
