"""Workers on this machine: processes of one thread each."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Generator, Sequence
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Any

from palpate.app.train.folder import Folder, Job
from palpate.app.train.work import Outcome, Watch, perform, record_fault
from palpate.core.processes import Answer, Child, Receive

THREAD_VARIABLES = (
    "NUMBA_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "OMP_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)
# one thread each; and no module is imported from the working folder
WORKER_ENVIRONMENT = {**dict.fromkeys(THREAD_VARIABLES, "1"), "PYTHONSAFEPATH": "1"}
MAX_TRIES = 2  # of a run whose worker dies
INTERRUPT_SECONDS = 0.5  # in which an interrupt is seen where waiting cannot be interrupted


def run_local(folder: Folder, jobs: Sequence[Job], workers: int, watch: Watch) -> Generator[Outcome]:
    """Make runs in processes of this machine; yield the outcome of each when it is done.

    A process that dies is replaced, and its run tried once more.
    """
    waiting, deaths, busy = deque(jobs), Counter[Job](), dict[Child, Job]()
    answers: SimpleQueue[tuple[Child, str, Any]] = SimpleQueue()
    try:
        while waiting or busy:
            while waiting and len(busy) < workers:
                worker = Child(
                    serve_runs, [str(folder.path), dict(folder.manifest)], environment=WORKER_ENVIRONMENT, quiet=False
                )
                _start(worker, busy, waiting)
                Thread(target=_follow, args=(worker, answers), daemon=True).start()
            try:
                worker, kind, said = answers.get(timeout=INTERRUPT_SECONDS)
            except Empty:
                continue
            if kind == "at":
                watch(busy[worker], said)
            elif kind == "stopped":
                raise OSError(said)
            elif kind == "done":
                yield said | {"job": Job(*said["job"])}
                _start(worker, busy, waiting)
            elif worker in busy:
                job = busy.pop(worker)
                worker.stop()
                folder.sweep(job)
                deaths[job] += 1
                if deaths[job] < MAX_TRIES:
                    waiting.appendleft(job)
                else:
                    reason = f"its process died {MAX_TRIES} times (exit code {said}); out of memory?"
                    yield record_fault(folder, job, reason, retry=True)
    finally:
        for worker in busy:
            worker.stop()


def _start(worker: Child, busy: dict[Child, Job], waiting: deque[Job]) -> None:
    """Give a worker the next run, or end it if there is none."""
    if waiting:
        busy[worker] = waiting.popleft()
        worker.send(busy[worker])
    else:
        del busy[worker]
        worker.stop()


def _follow(worker: Child, answers: SimpleQueue[tuple[Child, str, Any]]) -> None:
    """Put the answers of a worker, and its end, to those of all."""
    for kind, said in worker.answers():
        answers.put((worker, kind, said))
    answers.put((worker, "died", worker.wait()))


def serve_runs(receive: Receive, answer: Answer) -> None:
    """Make runs until the parent ends this process."""
    folder, manifest = receive()
    while True:
        try:
            done = perform(folder, manifest, receive(), lambda _, time: answer(("at", time)))
        except OSError as error:
            answer(("stopped", str(error)))
            return
        answer(("done", done))
