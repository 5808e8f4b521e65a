"""Workers of a Dask cluster, which write to the campaign's folder."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from pathlib import Path
from typing import Any

from palpate.app.common.console import Console
from palpate.app.train.folder import Folder, Job
from palpate.app.train.work import Outcome, perform, record_fault
from palpate.core.extras import require
from palpate.core.faults import InputError

ANSWER_SECONDS = 20.0  # [s] within which a scheduler has to answer


def check_dask() -> None:
    """Raise `InputError` if dask.distributed is not installed."""
    require("distributed", "--cluster")


def run_on_cluster(folder: Folder, jobs: Sequence[Job], address: str, console: Console) -> Generator[Outcome]:
    """Make runs on the workers of a cluster; yield the outcome of each when it is done.

    The scheduler gives the runs of a worker that dies to others.
    """
    check_dask()
    from distributed import as_completed

    with _client(address) as client:
        if not client.scheduler_info()["workers"]:
            console.say(f"the cluster at {address} has no workers yet: waiting for some")
        place, waiting = str(folder.path.absolute()), {}
        for job in jobs:
            key = f"palpate {place} {job.name}"
            waiting[client.submit(perform, place, dict(folder.manifest), tuple(job), key=key, pure=False)] = job
        for future in as_completed(list(waiting), loop=client.loop):
            job = waiting.pop(future)
            yield _outcome(folder, job, future)


def _outcome(folder: Folder, job: Job, future: Any) -> Outcome:
    from distributed import KilledWorker

    try:
        return dict(future.result())
    except KilledWorker:
        return record_fault(folder, job, "its workers died again and again; out of memory?", retry=True)


def _client(address: str) -> Any:
    from distributed import Client

    where = {"scheduler_file": address} if Path(address).is_file() else {"address": address}
    try:
        return Client(**where, timeout=ANSWER_SECONDS, set_as_default=False)
    except (OSError, ValueError) as error:
        raise InputError(
            f"cluster must be the address of a Dask scheduler, got {address!r}; none answers there ({error})"
        ) from error
