"""Workers on this machine: processes of one thread each."""

from __future__ import annotations

import os
import signal
from collections import Counter, deque
from collections.abc import Generator, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from multiprocessing import get_context, parent_process
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from threading import Thread
from typing import Any

from palpate.app.train.folder import Folder, Job
from palpate.app.train.work import Outcome, Watch, perform, record_fault

__all__ = ["run_local"]

THREAD_VARIABLES = (
    "NUMBA_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "OMP_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)
WORKER_ENVIRONMENT = {
    **dict.fromkeys(THREAD_VARIABLES, "1"),
    "PYTHONSAFEPATH": "1",
}  # import no module from the working folder
AT, DONE, STOPPED, DIED = "at", "done", "stopped", "died"
MAX_TRIES = 2  # of a run whose worker dies


@dataclass
class _Worker:
    process: BaseProcess
    pipe: Connection
    job: Job

    def receive(self) -> tuple[str, Any]:
        """Return the next message of the process, or the exit code of a dead one."""
        try:
            said: tuple[str, Any] = self.pipe.recv()
            return said
        except (EOFError, ConnectionError):
            self.process.join()
            return DIED, self.process.exitcode

    def send_next(self, waiting: deque[Job]) -> bool:
        """Send the next run to the process, or its end if there is none."""
        job = waiting.popleft() if waiting else None
        with suppress(BrokenPipeError):  # it has died: the next message reports it
            self.pipe.send(job)
        if job is None:
            self.process.join()
            return False
        self.job = job
        return True


def run_local(folder: Folder, jobs: Sequence[Job], workers: int, watch: Watch) -> Generator[Outcome]:
    """Make runs in processes of this machine; yield the outcome of each when it is done.

    A process that dies is replaced, and its run tried once more.
    """
    waiting, deaths, busy = deque(jobs), Counter[Job](), list[_Worker]()
    try:
        while waiting or busy:
            while waiting and len(busy) < workers:
                busy.append(_start_worker(folder, waiting.popleft()))
            ready = wait([worker.pipe for worker in busy])
            for worker in [worker for worker in busy if worker.pipe in ready]:
                kind, said = worker.receive()
                if kind == AT:
                    watch(worker.job, said)
                elif kind == STOPPED:
                    raise OSError(said)
                elif kind == DONE:
                    yield said
                    if not worker.send_next(waiting):
                        busy.remove(worker)
                else:
                    busy.remove(worker)
                    folder.sweep(worker.job)
                    deaths[worker.job] += 1
                    if deaths[worker.job] < MAX_TRIES:
                        waiting.appendleft(worker.job)
                    else:
                        reason = f"its process died {MAX_TRIES} times (exit code {said}); out of memory?"
                        yield record_fault(folder, worker.job, reason, retry=True)
    finally:
        for worker in busy:
            worker.process.kill()
            worker.process.join()


def _start_worker(folder: Folder, job: Job) -> _Worker:
    """Start a process and give it a first run."""
    context = get_context("spawn")  # a fork would copy locks that other threads hold
    pipe_end, worker_end = context.Pipe()
    process = context.Process(target=_serve, args=(worker_end, folder), daemon=True)
    with _worker_settings():
        process.start()
    worker_end.close()  # so that its end is seen here
    with suppress(BrokenPipeError):  # it died already: seen when it is read
        pipe_end.send(job)
    return _Worker(process, pipe_end, job)


@contextmanager
def _worker_settings() -> Iterator[None]:
    """Limit new processes to one thread each, and to imports from outside the working folder."""
    before = {name: os.environ.get(name) for name in WORKER_ENVIRONMENT}
    os.environ.update(WORKER_ENVIRONMENT)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _serve(pipe: Connection, folder: Folder) -> None:
    """Make runs until the parent sends no more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent decides
    Thread(target=_end_with_parent, daemon=True).start()
    while (job := pipe.recv()) is not None:
        try:
            done = perform(str(folder.path), folder.manifest, job, lambda running_job, time: pipe.send((AT, time)))
        except OSError as error:
            pipe.send((STOPPED, str(error)))
            return
        pipe.send((DONE, done))


def _end_with_parent() -> None:
    """End this process with its parent, in every case."""
    parent = parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
