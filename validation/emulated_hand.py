"""A rig for the adapter of Haply devices: an emulated service, and a wall in place of a session.

The wall is a spring below z = 0 for each tool, which answers poses at once. `haply.py` and tests/app/device use both.
"""

from __future__ import annotations

import asyncio
import contextlib
import importlib.util
import socket
import sys
import threading
from dataclasses import asdict
from pathlib import Path

import numpy as np

from palpate.app.device.haply import serve_devices
from palpate.app.device.options import DeviceOptions
from palpate.app.device.statistics import add_statistics
from palpate.core.processes import Child

PATH = Path(__file__).parents[1] / "examples" / "haply_emulator.py"
STIFFNESS = 300.0  # [N/m] of the wall
START = 0.004  # [m] of the tools above it at first
ABOVE = [0.0, -0.12, 0.15]  # [m] of a hand at first
PATIENCE = 20.0  # [s] for the start of a thread


def _load_emulator():
    found = importlib.util.spec_from_file_location("haply_emulator", PATH)
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    return module


EMULATOR = _load_emulator()


class Service:
    """An emulated service in a thread: the hands at its devices stay where they are told.

    Devices whose names begin with R or L are for the right or the left hand.
    """

    def __init__(self, *names: str) -> None:
        hands = {"R": "right", "L": "left"}
        self.devices = [EMULATOR.Device(name, hands.get(name[0], ""), self.hand(ABOVE)) for name in names]
        self.emulator = EMULATOR.Emulator(self.devices)
        with socket.create_server(("localhost", 0)) as probe:
            self.port = probe.getsockname()[1]
        self._loop, ready = asyncio.new_event_loop(), threading.Event()
        self._task = self._loop.create_task(EMULATOR.emulate(self.emulator, self.port, ready.set))
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()
        assert ready.wait(PATIENCE)

    def _run(self) -> None:
        with contextlib.suppress(asyncio.CancelledError):
            self._loop.run_until_complete(self._task)
        self._loop.close()

    @staticmethod
    def hand(place):
        """Return the target of a hand that stays at a place [m]."""
        return lambda now: list(place)

    def move(self, down: float, k: int = 0) -> None:
        """Let a hand go below its first height [m]."""
        self.devices[k].target = self.hand([ABOVE[0], ABOVE[1], ABOVE[2] - down])

    def close_sockets(self) -> None:
        """Abort all connections."""

        async def close() -> None:
            for each in list(self.emulator.sockets):
                each.transport.abort()

        asyncio.run_coroutine_threadsafe(close(), self._loop).result(PATIENCE)

    def close(self) -> None:
        """End the service."""
        self._loop.call_soon_threadsafe(self._task.cancel)
        self._thread.join(PATIENCE)


class Wall:
    """Answers the poses of an adapter as a session does; `poses` are the newest by tool.

    While it is stalled, its readings do not change, as those of an engine that waits; while it is silent, none come.
    """

    def __init__(self, port: int, tools: int = 1, **options: object) -> None:
        self.said, self.devices, self.poses, self.hands = [], {}, {}, {}
        self.steps, self.epoch, self.stalled, self.silent = 0, 1, False, False
        self.tools, self._starts = tools, [np.array([0.1 * k, 0.0, START]) for k in range(tools)]
        request = {"options": asdict(DeviceOptions(**options, port=port)), "tools": tools}
        self.child = Child(serve_devices, request, quiet=False)
        self.thread = threading.Thread(target=self._run, daemon=True)
        self.thread.start()

    def _run(self) -> None:
        for answer in self.child.answers():
            if "say" in answer:
                self.said.append(answer["say"])
            elif "devices" in answer:
                self.devices = answer["devices"]
            elif "hands" in answer:
                add_statistics(self.hands, answer["hands"])
            else:
                self._answer(answer["poses"])

    def _answer(self, poses: list) -> None:
        for index, epoch, pose in poses:
            if pose is not None and epoch == self.epoch:
                self.poses[index] = np.array(pose[0]), np.array(pose[1])
        if self.silent:
            return
        self.steps += not self.stalled
        self.child.send({"period": 1e-3, "tools": [self._contact(k) for k in range(self.tools)]})

    def _contact(self, k: int) -> dict:
        position, quaternion = self.poses.get(k, (self._starts[k], np.array([1.0, 0.0, 0.0, 0.0])))
        depth = max(-position[2], 0.0)
        return {
            "steps": self.steps, "running": True, "epoch": self.epoch, "bonded": False,
            "force": [0.0, 0.0, STIFFNESS * depth], "position": position.tolist(), "quaternion": quaternion.tolist(),
            "stiffness": np.diag([0.0, 0.0, STIFFNESS if depth else 0.0]).ravel().tolist(),
        }  # fmt: skip

    def close(self) -> None:
        """End the adapter."""
        self.child.send({"stop": True})
        self.thread.join(2.0)
        self.child.stop()


if __name__ == "__main__":  # a session that another process can kill
    Wall(int(sys.argv[1])).thread.join()
