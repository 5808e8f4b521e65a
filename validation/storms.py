"""Storms of poses and tools on a full body at 1 kHz: whether it stays finite, and what it takes.

    python validation/storms.py [--minutes 10] [--seed 0] [--reduced]

A session of a block in real time gets random messages: jumps of a ball or capsule through the whole workspace, tools
changed, put away, left inside, pinned, forceps that tear and turn, moduli changed, recordings. Up to four tools act at
a time. A state that diverges would be counted and reset. Printed: messages, periods and how many were repeated with
shorter steps, gains of energy that shorter steps did not cure, faults, and the memory of the process. `--reduced`
trains and steps a reduced model.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

import palpate as pt
from palpate.app.session.messages import validate_message
from palpate.app.session.session import MODULUS_NAME, Session
from palpate.realtime.contract import MAX_TOOLS

SIZE, SPACING = (0.06, 0.06, 0.03), 0.006  # [m]
REACH = 0.03  # [m] of jumps beyond the body
PAUSE = 0.02  # [s] between messages, in the mean
WARM_UP = 20.0  # [s] before the memory counts as begun


def body() -> pt.Solid:
    """Return a soft block, held below."""
    law = pt.materials.NeoHookean(C1=1.1e3, density=1060.0, poisson=0.45)
    return pt.Solid(pt.box(SIZE, SPACING), law, "z-", mass_damping=8.0)


def random_message(rng: np.random.Generator) -> dict[str, Any]:
    """Return a message of a user who has lost patience."""
    place = rng.uniform(-REACH, np.array(SIZE) + REACH)
    turn, index = rng.standard_normal(4), {"index": int(rng.integers(MAX_TOOLS))}
    pose = {"position": place.tolist(), "quaternion": (turn / np.linalg.norm(turn)).tolist(), **index}
    kind = rng.choice(["pose", "tool", "grasp", "release", "material", "reset", "speed", "pin"], p=PROBABILITIES)
    if kind == "pose":
        return {"type": "pose", **pose}
    if kind == "tool":
        shape = str(rng.choice(["sphere", "capsule"]))
        return {"type": "tool", "kind": shape, "radius": float(rng.uniform(0.006, 0.02)), "friction": 0.3, **pose}
    if kind == "grasp":
        on = np.array([*rng.uniform(0, SIZE[:2]), SIZE[2]])
        return {"type": "tool", "kind": "grasp", "radius": 0.01, "position": on.tolist(), **index}
    if kind == "material":
        return {"type": "material", "name": MODULUS_NAME, "value": float(2.2 * rng.uniform(0.3, 3.5))}
    if kind == "reset":
        return {"type": "control", "action": "reset"}
    if kind == "speed":
        return {"type": "speed", "factor": float(rng.choice([0.25, 0.5, 1.0]))}
    if kind == "pin":
        return {"type": "pin", "pinned": bool(rng.integers(2)), **index}
    return {"type": "release", **index}


PROBABILITIES = [0.78, 0.08, 0.05, 0.04, 0.015, 0.005, 0.01, 0.02]


def storm(session: Session, seconds: float, seed: int) -> dict[str, Any]:
    """Send random messages for some seconds; return what happened."""
    from soak import memory

    rng, ends, begun, most = np.random.default_rng(seed), time.monotonic() + seconds, 0.0, 0.0
    found: dict[str, Any] = {"messages": 0, "refused": 0, "faults": 0, "largest_force": 0.0}
    start = time.monotonic()
    session.start()
    while time.monotonic() < ends:
        found["messages"] += 1
        try:
            session.handle(validate_message(random_message(rng)))
        except pt.InputError:
            found["refused"] += 1
        time.sleep(rng.exponential(PAUSE))
        seen = session.snapshot()
        if session.engine.state == "diverged":
            found["faults"] += 1
            session.reset()
        elif not np.isfinite(seen.coordinates).all():
            raise ArithmeticError("coordinates must be finite in a body that did not diverge")
        found["largest_force"] = max(found["largest_force"], seen.largest_force)
        if not begun and time.monotonic() > start + min(WARM_UP, 0.2 * seconds):
            begun = memory()
        most = max(most, memory())
    found |= session.statistics()
    session.close()
    return found | {"memory_begun_MB": begun, "memory_most_MB": most, "memory_end_MB": memory()}


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--reduced", action="store_true", help="step a reduced model")
    options = parser.parse_args()
    sys.path.append(str(Path(__file__).parent))
    from soak import block

    session = Session(block() if options.reduced else body(), "Storm")
    with TemporaryDirectory() as folder:
        session.recordings.start(Path(folder) / "storm.h5")
        session.recordings.finish(wait=True)
        found = storm(session, 60 * options.minutes, options.seed)
    for name, value in found.items():
        print(f"{name:18} {value:12.5g}" if isinstance(value, int | float) else f"{name:18} {value!s:>12}")


if __name__ == "__main__":
    main()
