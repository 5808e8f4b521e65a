"""Headless sessions: messages from a script, each at its time, and a summary of the run."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import numpy as np

from palpate.app.session.messages import Message, validate_message
from palpate.app.session.session import Session
from palpate.dynamics.run.progress import progress_bar
from palpate.faults import FileFormatError, InputError
from palpate.files import json_of, read_text

__all__ = ["read_script", "run_script"]

SCRIPT_MESSAGES = ("pose", "tool", "release", "control", "speed", "material", "record")
MAX_TIME = 1e6  # [s] of a message
MESSAGE_INTERVAL = 0.002  # [s] between checks for due messages
SNAPSHOT_INTERVAL = 0.02  # [s] between snapshots


def read_script(path: Path) -> list[tuple[float, Message]]:
    """Return the messages of a script with their times [s], in order.

    Parameters
    ----------
    path : path
        Lines of JSON objects: messages of a client (docs/protocol.md) with a ``"time"`` [s] since the start.
    """
    script = []
    for k, line in enumerate(read_text(path, "script").split("\n")):
        if not line.strip():
            continue
        try:
            given = json_of(line)
            message = validate_message(given)
            at = given.get("time")
            if isinstance(at, bool) or not isinstance(at, int | float) or not 0 <= at < MAX_TIME:
                raise InputError(
                    f"time must be a number from 0 to {MAX_TIME:g}, got {at!r}; give seconds since the start"
                )
            if message["type"] not in SCRIPT_MESSAGES:
                raise InputError(
                    f"type must be one of {', '.join(SCRIPT_MESSAGES)} in a script, got {message['type']!r}; "
                    "remove the line"
                )
        except InputError as error:
            raise FileFormatError(f"{path}, line {k + 1}: {error}") from None
        script.append((float(at), message))
    return sorted(script, key=lambda pair: pair[0])


def run_script(session: Session, script: list[tuple[float, Message]], seconds: float) -> dict[str, Any]:
    """Drive a started session in real time.

    Parameters
    ----------
    script : list
        Result of `read_script`; messages after the end are ignored.
    seconds : float [s]
        Duration of the run.

    Returns
    -------
    dict
        Deadline statistics, the largest and the last force, the largest trust number, and the refused messages.
    """
    start, done, last_snapshot = time.monotonic(), 0, -SNAPSHOT_INTERVAL
    forces, trust, refused = [0.0], [0.0], []
    with progress_bar("headless", seconds, True) as show_progress:
        while (now := time.monotonic() - start) < seconds:
            while done < len(script) and script[done][0] <= now:
                try:
                    session.handle(script[done][1])
                except InputError as error:
                    refused.append({"time": script[done][0], "reason": str(error)})
                done += 1
            if now >= last_snapshot + SNAPSHOT_INTERVAL:
                last_snapshot, snapshot = now, session.snapshot()
                forces.append(float(np.linalg.norm(snapshot.force)))
                trust.append(snapshot.trust)
                session.tick()
                show_progress(now, now)
            time.sleep(MESSAGE_INTERVAL)
    return {
        **session.statistics(), "seconds": seconds, "verdict": session.engine.statistics().verdict,
        "state": session.engine.state, "largest_force": max(forces), "last_force": forces[-1],
        "largest_trust": max(trust), "messages": done, "refused": refused,
    }  # fmt: skip
