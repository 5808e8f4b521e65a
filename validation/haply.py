"""The adapter of Haply devices: passivity of its loop, and times until a hand is free when something fails.

    python validation/haply.py
    python validation/haply.py --parts passivity
    python validation/haply.py --parts times

No device takes part: the hand is a mass on a spring, and the service is `examples/haply_emulator.py`.

Passivity: a wall of 0.1 to 5 kN/m, whose readings are 0 to 5 ms late. The adapter samples the hand once in a period T,
and its force is held in the next one, so that it is late by 3 T / 2 on average, and by the delay of the reading. A
spring K that is late by t is passive on a device of damping b if b > K t (Colgate and Schenkel 1997, for small periods
against those of the motion). First, a hand that is moved by 1 mm at 5 Hz inside the wall measures the damping that
would take what the port generates in a cycle, E / (pi omega A^2). Then a free hand presses and releases, with the force
of the reading alone, with the local contact model, and with the passivity observer in addition, as the adapter works.

Times: a wall in place of a session stalls, falls silent or is killed, or the adapter is killed; the emulator notes when
the force on the hand has become zero.
"""

from __future__ import annotations

import argparse
import math
import os
import signal
import statistics
import subprocess
import sys
import time

import emulated_hand
import numpy as np
import result_files

from palpate.app.device.force import (
    MAX_STIFFNESS,
    PassivityObserver,
    ToolForce,
    contact_force,
    limited_force,
    stable_stiffness,
    stored_energy,
)
from palpate.app.device.options import DeviceOptions

PERIOD = 1e-3  # [s] of messages
STIFFNESSES = (100.0, 300.0, 1000.0, 2000.0, 5000.0)  # [N/m]
DELAYS = (0.0, 1e-3, 2e-3, 5e-3)  # [s]
AMPLITUDE, FREQUENCY, HELD_DEPTH = 1e-3, 5.0, 0.01  # [m], [Hz], [m] of a moved hand inside the wall
MASSES = (0.05, 0.1, 0.2)  # [kg] of a free hand with its device
HAND_STIFFNESS, HAND_DAMPING = 200.0, 1.2  # [N/m], [N s/m]: a light grip
PRESS_SECONDS, LONG_SECONDS = 3.0, 9.0  # [s] of three presses, and of nine
SUBSTEPS = 5  # of the hand in a period
LIMIT = DeviceOptions().device_limit
UP = np.array([0.0, 0.0, 1.0])
REPEATS = 20  # of each failure


class Port:
    """The adapter at a wall: takes the height of the hand once in a period, and returns the force until the next."""

    def __init__(self, stiffness: float, delay: float, local: bool, account: bool, bonded: bool = False) -> None:
        self.stiffness, self.late, self.local, self.bonded = stiffness, round(delay / PERIOD), local, bonded
        self.passivity = PassivityObserver() if account else None
        self.heights: list[float] = []
        self.held, self.next = 0.0, 0.0  # [N]: force that is held, and the one that is sent next

    def sample(self, height: float) -> float:
        """Take a height [m] at the beginning of a period; return the force [N] that is held in it."""
        self.heights.append(height)
        before, self.held = self.held, self.next
        step = height - self.heights[-2] if len(self.heights) > 1 else 0.0
        seen = self.heights[max(len(self.heights) - 1 - self.late, 0)]
        touches = self.bonded or seen < 0.0
        local = stable_stiffness(np.diag([0.0, 0.0, self.stiffness if touches else 0.0]), MAX_STIFFNESS)
        reading = ToolForce(
            -self.stiffness * seen * UP if touches else 0.0 * UP, local if self.local else 0.0 * local, seen * UP,
            self.bonded,
        )  # fmt: skip
        force = limited_force(contact_force(reading, height * UP), LIMIT if not self.bonded else math.inf)
        if self.passivity is not None:
            self.passivity.note_motion([before * UP], [step * UP])
            if force.any():
                self.passivity.limit_energy(stored_energy(force, local))
                force = limited_force(self.passivity.passive_forces([force], [step / PERIOD * UP], PERIOD)[0], LIMIT)
            else:
                self.passivity.limit_energy(0.0)
        self.next = float(force[2])
        return self.held


def needed_damping(stiffness: float, delay: float, local: bool) -> float:
    """Return the damping [N s/m] that takes what the port generates, measured at a hand that is moved in the wall."""
    port, cycles, omega = Port(stiffness, delay, local, account=False, bonded=True), 4, 2 * math.pi * FREQUENCY
    work, first = 0.0, round(1 / FREQUENCY / PERIOD)  # the first cycle begins with no force
    for k in range((cycles + 1) * first):
        start, end = (-HELD_DEPTH + AMPLITUDE * math.sin(omega * j * PERIOD) for j in (k, k + 1))
        force = port.sample(start)
        work += force * (end - start) if k >= first else 0.0
    return work / cycles / (math.pi * omega * AMPLITUDE**2)


def press(
    stiffness: float, delay: float, mass: float, local: bool, account: bool, seconds: float = PRESS_SECONDS
) -> dict[str, float]:
    """Press with a free hand once a second; return the energy [J] that went out of the port, at most and at the end."""
    port, height, speed, work, most = Port(stiffness, delay, local, account), 0.005, 0.0, 0.0, 0.0
    step, accelerations = PERIOD / SUBSTEPS, []
    for k in range(round(seconds / PERIOD)):
        force = port.sample(height)
        for i in range(SUBSTEPS):
            goal = -0.004 + 0.006 * math.cos(2 * math.pi * (k * PERIOD + i * step))
            acceleration = (HAND_STIFFNESS * (goal - height) - HAND_DAMPING * speed + force) / mass
            speed += step * acceleration
            height += step * speed
            work += step * force * speed
        most = max(most, work)
        accelerations.append(acceleration)
    return {"most": most, "end": work, "acceleration": float(np.sqrt(np.mean(np.square(accelerations[-1000:]))))}


def passivity() -> list[dict]:
    """Return a row for each stiffness and delay."""
    rows = []
    for stiffness in STIFFNESSES:
        for delay in DELAYS:
            row = {"stiffness": stiffness, "delay": delay}
            row |= {"limit": stiffness * (1.5 * PERIOD + delay), "local_limit": stiffness * 1.5 * PERIOD}
            row |= {"measured": needed_damping(stiffness, delay, False)}
            row |= {"local_measured": needed_damping(stiffness, delay, True)}
            for name, local, account in (("reading", False, False), ("local", True, False), ("whole", True, True)):
                row[name] = press(stiffness, delay, 0.1, local, account)
            row["masses"] = {
                f"{mass:g}": press(stiffness, delay, mass, True, True, LONG_SECONDS)["most"] for mass in MASSES
            }
            rows.append(row)
            print(f"{stiffness:g} N/m, {1e3 * delay:g} ms:", {name: row[name]["most"] for name in ("reading", "whole")})
    return rows


def _pressed(service: emulated_hand.Service, started: float = 20.0) -> bool:
    """Press with the hand, and wait until it feels the wall; return whether it did."""
    device, end = service.devices[0], time.perf_counter() + started
    while len(device.log) < 200 and time.perf_counter() < end:
        time.sleep(0.01)
    service.move(0.014)
    while math.hypot(*device.force) < 0.3 and time.perf_counter() < end:
        time.sleep(0.01)
    return time.perf_counter() < end


def _until_zero(service: emulated_hand.Service, since: float) -> float:
    """Return the time [s] from a moment until the force was zero."""
    while True:
        for moment, force, _ in service.devices[0].log[-2000:]:
            if moment > since and not any(force):
                return moment - since
        time.sleep(0.02)


def time_until_free(failure: str) -> float | None:
    """Return the time [s] from a failure until the hand was free; None if it was never pressed (too busy a machine)."""
    service = emulated_hand.Service("049D")
    wall = parent = None
    if failure == "session killed":
        parent = subprocess.Popen([sys.executable, emulated_hand.__file__, str(service.port)])
    else:
        wall = emulated_hand.Wall(service.port)
    try:
        if not _pressed(service):
            return None
        since = time.perf_counter()
        if failure == "engine stalls":
            wall.stalled = True
        elif failure == "session stalls":
            wall.silent = True
        else:
            os.kill(parent.pid if parent else wall.child.pid, signal.SIGKILL)
        return _until_zero(service, since)
    finally:
        if parent:
            parent.kill()
            parent.wait()
        else:
            wall.close()
        service.close()


def intervals(seconds: float = 5.0) -> dict[str, float]:
    """Return percentiles of the time [s] between two messages of the adapter."""
    service = emulated_hand.Service("049D")
    wall = emulated_hand.Wall(service.port)
    _pressed(service)
    time.sleep(seconds)
    times = np.diff([moment for moment, _, _ in service.devices[0].log[200:]])
    wall.close()
    service.close()
    return {f"{percent:g}": float(np.percentile(times, percent)) for percent in (50, 99, 100)}


def times() -> dict:
    """Return times until a hand is free, for each failure, and the rate of messages."""
    found = {}
    for failure in ("engine stalls", "session stalls", "session killed", "adapter killed"):
        taken = [each for _ in range(REPEATS) if (each := time_until_free(failure)) is not None]
        found[failure] = {"count": len(taken), "median": statistics.median(taken), "largest": max(taken)}
        print(failure, found[failure])
    return {"failures": found, "intervals": intervals()}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--parts", nargs="+", choices=("passivity", "times"), default=["passivity", "times"])
    given = parser.parse_args()
    results = result_files.read("haply", {})
    for part in given.parts:
        results[part] = {"passivity": passivity, "times": times}[part]()
        result_files.write("haply", results, f"python validation/haply.py --parts {part}")
