"""A programmable device: a hand that moves as told."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from palpate.faults import number_in_range

if TYPE_CHECKING:
    from palpate.realtime.engine import Engine

__all__ = ["DummyDevice", "Recording"]

Floats = NDArray[np.float64]
Path = Callable[[float], tuple[Sequence[float] | Floats, Sequence[float] | Floats]]


@dataclass(frozen=True)
class Recording:
    """What a device did and felt at k times.

    Parameters
    ----------
    times : (k,) array [s]
        Since the device began.
    positions, quaternions : (k, 3) array [m], (k, 4) array
        Poses sent.
    forces : (k, 3) array [N]
        Read right after: of the body on the tool, still without that pose.
    """

    times: Floats
    positions: Floats
    quaternions: Floats
    forces: Floats


class DummyDevice:
    """Stands for a haptic device: sends an engine poses of a given path and records the forces.

    Parameters
    ----------
    path : function
        ``path(t)`` returns the position (3,) [m] and the quaternion (4,), w x y z, at a time t [s].
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def prepare(self, engine: Engine, duration: float) -> Recording:
        """Send and read for `duration` [s], about once a period of the engine; as often as Python can, at most.

        Raises
        ------
        InputError
            The duration is not positive, or the path goes where `Engine.set_pose` refuses.
        """
        duration = number_in_range("duration", duration, 0, open_low=True, unit="s")
        times, positions, quaternions, forces = [], [], [], []
        start, now = time.perf_counter(), 0.0
        while now < duration:
            position, quaternion = self.path(now)
            engine.set_pose(position, quaternion)
            times.append(now)
            positions.append(np.array(position, dtype=float))
            quaternions.append(np.array(quaternion, dtype=float))
            forces.append(engine.read().force)
            ahead = (np.floor(now / engine.period) + 1) * engine.period - (time.perf_counter() - start)
            time.sleep(max(ahead, 0.0))
            now = time.perf_counter() - start
        return Recording(np.array(times), np.array(positions), np.array(quaternions), np.array(forces))
