"""A session without a browser: messages from a file, each at its time, and what came of it."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from palpate.app.view.messages import Message, checked
from palpate.app.view.session import Session
from palpate.dynamics.run.progress import progress_bar
from palpate.faults import FileFormatError, InputError
from palpate.files import json_of, read_text

__all__ = ["read_script", "run_script"]

SENT = ("pose", "tool", "release", "control", "speed", "material", "record")
BEAT = 0.002  # [s] between two looks at the clock
SEEN = 0.02  # [s] between two looks at the body


def read_script(path: Path) -> list[tuple[float, Message]]:
    """Return the messages of a script with their times [s], in order.

    Parameters
    ----------
    path : path
        Of lines that are JSON objects: what a client sends (docs/protocol.md), with ``"time"`` [s] since the start.

    Raises
    ------
    FileNotFoundError
        There is no such file.
    FileFormatError
        It is no text, or a line is no such message; names it.
    """
    found = []
    for k, line in enumerate(read_text(path, "script").split("\n")):
        if not line.strip():
            continue
        try:
            given = json_of(line)
            message = checked(given)
            at = given.get("time")
            if isinstance(at, bool) or not isinstance(at, int | float) or not 0 <= at < 1e6:
                raise InputError(f"time = {at!r}: needed is a time of at least 0 s")
            if message["type"] not in SENT:
                raise InputError(f"type = {message['type']!r}: a script knows {', '.join(SENT)}")
        except InputError as error:
            raise FileFormatError(f"{path}, line {k + 1}: {error}") from None
        found.append((float(at), message))
    return sorted(found, key=lambda pair: pair[0])


def run_script(session: Session, script: list[tuple[float, Message]], seconds: float) -> dict[str, Any]:
    """Drive a session that is started, in real time.

    Parameters
    ----------
    session : Session
    script : list
        Of `read_script`; what comes after the end is left out.
    seconds : float [s]

    Returns
    -------
    dict
        How the deadlines were kept, the largest and last force, the largest trust number, and what was refused.
    """
    began, at, looked = time.monotonic(), 0, -SEEN
    forces, trust, refused = [0.0], [0.0], []
    with progress_bar("headless", seconds, True) as shown:
        while (now := time.monotonic() - began) < seconds:
            while at < len(script) and script[at][0] <= now:
                try:
                    session.handle(script[at][1])
                except InputError as error:
                    refused.append({"time": script[at][0], "reason": str(error)})
                at += 1
            if now >= looked + SEEN:
                looked, moment = now, session.snapshot()
                forces.append(float(np.linalg.norm(moment.force)))
                trust.append(moment.trust)
                session.tick()
                shown(now, now)
            time.sleep(BEAT)
    return {
        **session.statistics(), "seconds": seconds, "verdict": session.engine.statistics().verdict,
        "state": session.engine.state, "largest_force": max(forces), "last_force": forces[-1],
        "largest_trust": max(trust), "messages": at, "refused": refused,
    }  # fmt: skip
