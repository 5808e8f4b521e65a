"""Compilation of the engine of a full body in a separate process, while this one fills the surface.

Both processes read what the other has kept in the cache of compiled functions.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator

from palpate.parameters import read_section, written_section
from palpate.scenes.description import Tissue

__all__ = ["compile_ahead", "compile_for_tissue"]

PROCESS_CODE = "from palpate.app.view.compile_ahead import compile_for_tissue; compile_for_tissue()"
BLOCK_SIZE, BLOCK_SPACING = 0.1, 0.02  # [m] of a body whose engine has the same types


@contextlib.contextmanager
def compile_ahead(tissue: Tissue) -> Iterator[Callable[[], object]]:
    """Compile for a tissue in another process within a context, if there is a second processor.

    Yields
    ------
    function
        Waits until that process has ended. What it has not compiled is compiled when it is called.
    """
    if _processors() < 2:
        yield lambda: None
        return
    words = json.dumps(written_section(tissue))
    process = subprocess.Popen(
        [sys.executable, "-P", "-c", PROCESS_CODE, words], stdin=subprocess.PIPE, stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )  # fmt: skip
    try:
        yield process.wait
    finally:
        process.kill()
        process.communicate()


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def compile_for_tissue() -> None:
    """Make a session of a block, with a tissue from the command line; end when the standard input does."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the first process ends this one

    def watch() -> None:
        sys.stdin.read()
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()
    from palpate.app.session.session import Session
    from palpate.dynamics.solid.model import EnergySolid
    from palpate.meshfree.cloud import box
    from palpate.scenes.tissue import fibres_of, material_of

    tissue: Tissue = read_section(Tissue, json.loads(sys.argv[1]))
    cloud = box((BLOCK_SIZE,) * 3, BLOCK_SPACING, jitter=0.2)
    fibres = None if tissue.fibres is None else fibres_of(tissue.fibres)
    body = EnergySolid(cloud, material_of(tissue), "z-", mass_damping=1.0, fibres=fibres)
    session = Session(body, "block")
    session.start()  # compiles the loop
    session.close()
