"""A programmable stand-in for a haptic device."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from palpate.core.arrays import Floats
from palpate.core.describe import Described, Fact
from palpate.core.faults import number_in_range

if TYPE_CHECKING:
    from palpate.realtime.engine import Engine

Path = Callable[[float], tuple[Sequence[float] | Floats, Sequence[float] | Floats]]


@dataclass(frozen=True)
class DeviceLog(Described):
    """Poses that a device sent and forces that it received, at k times.

    Parameters
    ----------
    times : (k,) array [s]
        Time since the device started.
    positions, quaternions : (k, 3) array [m], (k, 4) array
        Poses sent.
    forces : (k, 3) array [N]
        Force of the body on the tool, read right after the pose was sent. It does not yet include that pose.

    Examples
    --------
    >>> import numpy as np
    >>> import palpate as pt
    >>> log = pt.typing.DeviceLog(np.zeros(2), np.zeros((2, 3)), np.zeros((2, 4)), np.ones((2, 3)))
    >>> log.forces.mean(axis=0).tolist()
    [1.0, 1.0, 1.0]
    """

    times: Floats
    positions: Floats
    quaternions: Floats
    forces: Floats

    def _facts(self) -> list[Fact]:
        largest = float(np.linalg.norm(self.forces, axis=-1).max(initial=0.0))
        return [
            ("poses", len(self.times), ""),
            ("end", float(self.times.max(initial=0.0)), "s"),
            ("largest force", largest, "N"),
        ]


class DummyDevice(Described):
    """Replaces a haptic device: sends the poses of a path to an engine and records the forces.

    Parameters
    ----------
    path : function
        ``path(t)`` returns the position (3,) [m] and the quaternion (4,), w x y z, at a time t [s].

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.03, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1060, poisson=0.45)
    >>> block = pt.Solid(cloud, tissue, fixed="z-")
    >>> ball = pt.tools.Contact(pt.tools.Sphere(radius=0.01), (0.015, 0.015, 0.026))
    >>> device = pt.DummyDevice(lambda t: ((0, 0, -0.01 * t), (1, 0, 0, 0)))
    >>> with pt.Engine(pt.realtime_model(block, contact=ball)) as engine:
    ...     log = device.run(engine, 0.05)
    >>> log.forces.shape[1]
    3
    """

    def __init__(self, path: Path) -> None:
        self.path = path

    def _facts(self) -> list[Fact]:
        return [("path", self.path, "")]

    def run(self, engine: Engine, duration: float) -> DeviceLog:
        """Send poses and read forces for `duration` [s], once per period of the engine if Python is fast enough.

        Raises
        ------
        InputError
            The duration is not positive, or `Engine.set_pose` rejects a pose.
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
        return DeviceLog(np.array(times), np.array(positions), np.array(quaternions), np.array(forces))
