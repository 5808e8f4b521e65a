"""A session at 1 kHz behind its server: first with honest clients alone, then with hostile ones of every kind, too.

    python validation/soak.py --seconds 300

The honest and the hostile run in a process each (`validation/hostile.py`). Of each part these are printed: the
computing time of a period, missed deadlines, the server's memory, and what the honest clients felt.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import subprocess
import sys
import threading
import time
from contextlib import nullcontext, suppress
from pathlib import Path
from typing import Any

import numpy as np

import palpate as pt
from palpate.app.session.session import Session
from palpate.app.view.server.host import Host
from palpate.reduction.hyper.model import ReducedModel

HERE = Path(__file__).parent
SIZE, SPACING, RUN_SECONDS, EVERY = (0.048, 0.048, 0.024), 0.006, 0.12, 0.005  # [m], [m], [s], [s]
BALL, DEPTH = 0.015, 0.004  # [m]


def block() -> ReducedModel:
    """Return a small block that a ball presses from above."""
    body = pt.Solid(
        pt.box(SIZE, SPACING),
        pt.materials.NeoHookean(C1=2e3, density=1000, poisson=0.4),
        "z-",
        form="energy",
        stiffness_damping=1e-4,
    )

    def press(x: float) -> tuple[pt.tools.Contact]:
        def motion(time: float) -> tuple[float, float, float]:
            share = np.sin(np.pi * min(time / RUN_SECONDS, 1.0)) ** 2
            return x, 0.024, SIZE[2] + BALL + 0.001 - share * (DEPTH + 0.001)

        return (pt.tools.Contact(pt.tools.Sphere(BALL), motion),)

    runs = [pt.rollout(body, press(x), duration=RUN_SECONDS, every=EVERY) for x in (0.022, 0.027)]
    return pt.hyper_reduce(body, runs, modes=0, enrichment=pt.vibration_modes(body, 12)[0])


class Served:
    """A session behind its server, in a thread; a context manager."""

    def __init__(self, model: ReducedModel) -> None:
        self.session = Session(model, "Block")
        self.host = Host(self.session, port=18800)
        self._loop = asyncio.new_event_loop()
        self._task: asyncio.Task[None] | None = None
        self._thread = threading.Thread(target=self._run, daemon=True)

    def _run(self) -> None:
        self._task = self._loop.create_task(self.host.run(lambda: None))
        with suppress(asyncio.CancelledError):
            self._loop.run_until_complete(self._task)
        self._loop.run_until_complete(self._loop.shutdown_default_executor())
        self._loop.close()

    def __enter__(self) -> Served:
        self.session.start()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._task is not None:
            self._loop.call_soon_threadsafe(self._task.cancel)
        self._thread.join(30.0)
        self.session.stop()
        if self._thread.is_alive():
            raise TimeoutError("the server did not end")


def memory() -> float:
    """Return the memory of this process [MB] (Linux)."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return 1e-6 * pages * os.sysconf("SC_PAGE_SIZE")


def _clients(served: Served, seconds: float, kinds: list[str]) -> subprocess.Popen[str]:
    command = [sys.executable, str(HERE / "hostile.py"), served.host.address, str(seconds), *kinds]
    return subprocess.Popen(command, stdout=subprocess.PIPE, text=True)


def measured(served: Served, seconds: float, kinds: list[str]) -> dict[str, Any]:
    """Let clients come for some seconds, and return how the server and its honest clients fared."""
    session, took = served.session, [memory()]
    session.engine.stop()
    session.engine.start()  # this resets the statistics
    with _clients(served, seconds, []) as honest, _clients(served, seconds, kinds) if kinds else nullcontext():
        while honest.poll() is None:
            time.sleep(0.5)
            took.append(memory())
        told = json.loads(honest.stdout.read() if honest.stdout else "")
    known = session.engine.statistics()
    return {
        "seconds": seconds, "hostile": len(kinds), "periods": known.count, "missed": known.missed,
        "median_ms": 1e3 * known.computing.percentile(50), "p99_ms": 1e3 * known.computing.percentile(99),
        "memory_begun_MB": took[0], "memory_most_MB": max(took), "memory_end_MB": took[-1], **told,
    }  # fmt: skip


def soak(model: ReducedModel, seconds: float, kinds: list[str]) -> list[dict[str, Any]]:
    """Return what was measured without hostile clients, and with them, of one server in this order."""
    with Served(model) as served:
        quiet = measured(served, seconds, [])
        hostile = measured(served, seconds, kinds)
        while served.session.pause_reason is None:  # all have left, and the server has seen it
            time.sleep(0.1)
    return [quiet, hostile]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seconds", type=float, default=300.0)
    sys.path.append(str(HERE))
    from hostile import KINDS

    quiet, hostile = soak(block(), parser.parse_args().seconds, list(KINDS))
    for name in quiet:
        print(f"{name:18} {quiet[name]:12.4g} {hostile[name]:12.4g}")


if __name__ == "__main__":
    main()
