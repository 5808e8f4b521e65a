"""The engine of a full body, compiled before its surface is filled."""

from __future__ import annotations

import os

from palpate.core.parameters import read_section
from palpate.core.processes import LOWEST_PRIORITY, Answer, Receive
from palpate.scenes.description import Tissue

BLOCK_SIZE, BLOCK_SPACING = 0.1, 0.02  # [m] of a body whose engine has the same types


def compile_engine(receive: Receive, answer: Answer) -> None:
    """Make a session of a block of a tissue, which is received, and answer; then one whose block a blade cuts."""
    from palpate.app.session.session import Session
    from palpate.dynamics.contact.blade import Blade
    from palpate.dynamics.contact.tools import Contact
    from palpate.dynamics.solid.model import EnergySolid
    from palpate.meshfree.cloud import box
    from palpate.realtime.bodies.model import realtime_model
    from palpate.scenes.tissue import fibres_of, material_of

    tissue: Tissue = read_section(Tissue, receive())
    cloud = box((BLOCK_SIZE,) * 3, BLOCK_SPACING, jitter=0.2)
    fibres = None if tissue.fibres is None else fibres_of(tissue.fibres)
    body = EnergySolid(cloud, material_of(tissue), "z-", mass_damping=1.0, fibres=fibres)
    session = Session(body, "block")
    session.start()  # compiles the loop
    session.close()
    answer(True)
    if hasattr(os, "nice"):
        os.nice(LOWEST_PRIORITY)  # the engine of the body runs now
    blade, middle = Blade([(-BLOCK_SPACING, 0, 0), (BLOCK_SPACING, 0, 0)], 1.0), BLOCK_SIZE / 2
    realtime_model(body, contact=Contact(blade, (middle, middle, 2 * BLOCK_SIZE)))  # compiles what a blade calls
