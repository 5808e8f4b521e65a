"""Compilation of the engine of a full body in a separate process, while this one fills the surface.

Both processes read what the other has kept in the cache of compiled functions.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Iterator

from palpate.parameters import read_section, written_section
from palpate.processes import Answer, Child, Receive
from palpate.scenes.description import Tissue

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
    child = Child(compile_for_tissue, written_section(tissue))
    try:
        yield child.wait
    finally:
        child.stop()


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def compile_for_tissue(receive: Receive, _answer: Answer) -> None:
    """Make a session of a block of a tissue."""
    from palpate.app.session.session import Session
    from palpate.dynamics.solid.model import EnergySolid
    from palpate.meshfree.cloud import box
    from palpate.scenes.tissue import fibres_of, material_of

    tissue: Tissue = read_section(Tissue, receive())
    cloud = box((BLOCK_SIZE,) * 3, BLOCK_SPACING, jitter=0.2)
    fibres = None if tissue.fibres is None else fibres_of(tissue.fibres)
    body = EnergySolid(cloud, material_of(tissue), "z-", mass_damping=1.0, fibres=fibres)
    session = Session(body, "block")
    session.start()  # compiles the loop
    session.close()
