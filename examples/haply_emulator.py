"""A stand-in for the Haply Inverse Service and its devices, so that a person can try palpate without one.

    python examples/haply_emulator.py
    palpate view organ.stl --device haply

It answers on port 10001 as the documentation of the Inverse Service 3.5 says (docs.haply.co): a snapshot with the
configuration of every device first, then one state for each message. Every device is held by a simulated hand: a mass
on a spring and a damper to a target, which rests for a second and then presses every two. The force of the client acts
on the mass until the next message, and becomes zero when the client's connection ends. Positions are in metres; x is to
the right, y forward, z up.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import math
import time
from collections.abc import Callable
from typing import Any

from websockets.asyncio.server import serve
from websockets.exceptions import ConnectionClosed

PORT = 10001
MASS, HAND_STIFFNESS, HAND_DAMPING = 0.1, 200.0, 3.0  # [kg], [N/m], [N s/m]: a loose grip on a light arm
MAX_STEP = 2e-4  # [s] of the simulated hand
MAX_FORCE = 10.0  # [N] of the simulated motors
REST_SECONDS, PRESS_SECONDS, PRESS_DEPTH = 1.0, 2.0, 0.02  # [s], [s], [m]

Target = Callable[[float], list[float]]  # where the hand wants to be [m] at a time [s]


def pressing(depth: float) -> Target:
    """Return a target that goes down by a depth and up again, after a rest."""

    def target(now: float) -> list[float]:
        share = math.sin(math.pi * max(now - REST_SECONDS, 0.0) / PRESS_SECONDS) ** 2
        return [0.0, -0.12, 0.15 - depth * share]

    return target


class Device:
    """A device that a simulated hand holds; `force` is what a client set last, `work` [J] what it did to the hand."""

    def __init__(self, name: str, handedness: str, target: Target) -> None:
        self.name, self.handedness, self.target = name, handedness, target
        self.buttons = {"a": False, "b": False, "c": False}
        self.orientation = [1.0, 0.0, 0.0, 0.0]
        self.present = True
        self.status = dict.fromkeys(("calibrated", "in_use", "power_supply", "ready", "started"), True)
        self.force, self.work, self.velocity = [0.0] * 3, 0.0, [0.0] * 3
        self.position = list(target(0.0))
        self.restart()
        self.log: list[tuple[float, list[float], list[float]]] = []  # time [s], force [N], position [m] of each message

    def restart(self) -> None:
        """Begin the motion of the hand now."""
        self.began = self.time = time.perf_counter()

    def advance(self) -> None:
        """Move the hand up to the present: all forces are held since the last message."""
        now = time.perf_counter()
        steps = min(max(math.ceil((now - self.time) / MAX_STEP), 1), 5000)
        step = (now - self.time) / steps
        for k in range(steps):
            goal = self.target(self.time + (k + 1) * step - self.began)
            for i in range(3):
                pull = HAND_STIFFNESS * (goal[i] - self.position[i]) - HAND_DAMPING * self.velocity[i]
                self.velocity[i] += step * (pull + self.force[i]) / MASS
                self.position[i] += step * self.velocity[i]
                self.work += step * self.force[i] * self.velocity[i]
        self.time = now

    def set_force(self, force: list[float]) -> None:
        """Hold a force from now on."""
        self.advance()
        size = math.sqrt(sum(part * part for part in force))
        self.force = [part * min(1.0, MAX_FORCE / size) if size else 0.0 for part in force]
        self.log.append((self.time, self.force, list(self.position)))

    def state(self) -> dict[str, Any]:
        """Return the entry of a state message."""
        return {
            "device_id": self.name,
            "state": {"cursor_position": _vector(self.position), "cursor_velocity": _vector(self.velocity)},
            "status": dict(self.status),
        }

    def grip(self) -> dict[str, Any]:
        """Return the entry of its handle."""
        orientation = dict(zip("wxyz", self.orientation, strict=True))
        return {"device_id": f"{self.name}G", "state": {"orientation": orientation, "buttons": dict(self.buttons)}}


def _vector(numbers: list[float]) -> dict[str, float]:
    return dict(zip("xyz", numbers, strict=True))


class Emulator:
    """The service: answers clients for some devices. Tests change its devices while it runs."""

    def __init__(self, devices: list[Device]) -> None:
        self.devices, self.connections, self.closed_at = devices, 0, math.nan
        self.sockets: set[Any] = set()
        self.muted = False  # no answers
        self.disguise: Callable[[str], str | bytes] | None = None  # changes messages, for damaged ones

    async def answer(self, socket: Any) -> None:
        """Serve a client until it leaves; then no force acts."""
        self.connections += 1
        self.sockets.add(socket)
        for device in self.devices:
            device.restart()
        try:
            await self._send(socket, self._message(snapshot=True))
            async for text in socket:
                self._take(json.loads(text))
                if not self.muted:
                    await self._send(socket, self._message())
        except ConnectionClosed:
            pass
        finally:
            self.sockets.discard(socket)
            self.closed_at = time.perf_counter()
            for device in self.devices:
                device.set_force([0.0] * 3)

    async def _send(self, socket: Any, message: dict[str, Any]) -> None:
        text = json.dumps(message)
        await socket.send(text if self.disguise is None else self.disguise(text))

    def _take(self, message: dict[str, Any]) -> None:
        by_name = {device.name: device for device in self.devices if device.present}
        for entry in message["inverse3"]:
            command = entry["commands"]["set_cursor_force"]["vector"]
            if entry["device_id"] in by_name:
                by_name[entry["device_id"]].set_force([command[name] for name in "xyz"])

    def calibrate(self, done: bool = True) -> None:
        """State that all devices are calibrated, or are not."""
        for device in self.devices:
            device.status |= {"calibrated": done, "ready": done}

    def _message(self, snapshot: bool = False) -> dict[str, Any]:
        present = [device for device in self.devices if device.present]
        for device in present:
            device.advance()
        entries = [device.state() for device in present]
        if snapshot:
            for entry, device in zip(entries, present, strict=True):
                entry["config"] = {"type": "inverse3", "handedness": device.handedness}
        return {"inverse3": entries, "wireless_verse_grip": [device.grip() for device in present]}


async def emulate(emulator: Emulator, port: int, ready: Callable[[], None] = lambda: None) -> None:
    """Serve until cancelled."""
    async with serve(emulator.answer, "localhost", port, compression=None, ping_interval=None, close_timeout=0.1):
        ready()
        await asyncio.get_running_loop().create_future()


async def main(port: int, count: int, depth: float, calibrated_after: float) -> None:
    """Serve devices, and print once a second where they are and what they feel."""
    hands = ["right", "left"] if count > 1 else ["right"]
    emulator = Emulator([Device(f"E{k:03d}", hand, pressing(depth)) for k, hand in enumerate(hands)])
    if calibrated_after > 0.0:
        emulator.calibrate(False)
        asyncio.get_running_loop().call_later(calibrated_after, emulator.calibrate)
    serving = asyncio.create_task(emulate(emulator, port))
    print(f"devices {', '.join(each.name for each in emulator.devices)} at ws://localhost:{port}; stop with Ctrl-C")
    while not serving.done():
        await asyncio.sleep(1.0)
        for device in emulator.devices:
            largest = max((math.hypot(*force) for _, force, _ in device.log), default=0.0)
            height, count = 1e3 * device.position[2], len(device.log)
            print(f"{device.name}: {count} messages a second, height {height:.1f} mm, force up to {largest:.2f} N")
            device.log.clear()
    serving.result()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--port", type=int, default=PORT)
    parser.add_argument("--devices", type=int, choices=(1, 2), default=1)
    parser.add_argument("--depth", type=float, default=PRESS_DEPTH, help="depth of the press [m]")
    text = "time after which the devices are calibrated [s]"
    parser.add_argument("--calibrated-after", type=float, default=0.0, metavar="S", help=text)
    given = parser.parse_args()
    with contextlib.suppress(KeyboardInterrupt):
        asyncio.run(main(given.port, given.devices, given.depth, given.calibrated_after))
