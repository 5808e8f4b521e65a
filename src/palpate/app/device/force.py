"""Force on a hand between two readings of the engine: local contact model, limit, ramp, age, and passivity.

The local contact model is the force of the newest reading, minus the contact stiffness times the displacement of the
tool since that reading's pose (Y. Adachi, T. Kumano, K. Ogino, Intermediate representation for stiff virtual objects,
VRAIS 1995). A linear body then answers at the present position, however late its reading is.

A force that is held for a period T at a device is that of a spring which is late by T / 2 and more. A spring k that is
late by a time t generates energy: a wall of it is passive on a device of damping b if b > k t (J. E. Colgate and
G. G. Schenkel, Passivity of a class of sampled-data systems, J. Robotic Systems 14, 1997). The energy that goes out
through the port of a device is the sum of F_k . (x_k+1 - x_k), because the service holds each force until the next, and
answers each with the position at that moment. A passivity observer adds up the energy that came in, and the force may
not take more (B. Hannaford and J.-H. Ryu, Time-domain passivity control of haptic interfaces, IEEE Trans.
Robotics and Automation 18, 2002). Where it would, a damper takes the difference. All devices of a session share one
observer, because one hand may move the other through the body.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.core.arrays import Floats

MAX_READING_PERIODS = 4  # periods of the engine after which a reading is old, if they are longer than its age
RAMP_SECONDS = 0.5  # [s] from no force to the whole
MAX_PREDICTION = 0.005  # [m] of the tool from the pose of a reading
MAX_STIFFNESS = 5e3  # [N/m] of the local contact model at the hand
MAX_DAMPING = 30.0  # [N s/m] of the passivity controller, with which a mass of 0.05 kg is stable at 1 kHz
MAX_PULL = 1.0  # [N] of the controller on a hand that leaves, to pay back the energy that is missing
STILL_SPEED = 1e-6  # [m/s]


@dataclass(frozen=True)
class ToolForce:
    """The force of a reading in the frame of the body, and what the local contact model needs with it."""

    force: Floats  # (3,) array [N]: of the body on the tool
    stiffness: Floats  # (3, 3) array [N/m]: symmetric, without negative eigenvalues
    position: Floats  # (3,) array [m]: of the tool
    bonded: bool  # whether the tool can also pull, as forceps do


def stable_stiffness(stiffness: Floats, largest: float) -> Floats:
    """Return the symmetric part (3, 3) of a contact stiffness, with eigenvalues from 0 to the largest [N/m]."""
    if not np.isfinite(stiffness).all():
        return np.zeros((3, 3))
    values, vectors = np.linalg.eigh(0.5 * (stiffness + stiffness.T))
    return np.asarray((vectors * np.clip(values, 0.0, largest)) @ vectors.T)


def contact_force(reading: ToolForce, position: Floats) -> Floats:
    """Return the force (3,) [N] on a tool at a position near that of the reading, by the local contact model."""
    moved = position - reading.position
    distance = math.sqrt(moved @ moved)
    if distance > MAX_PREDICTION:
        moved = moved * (MAX_PREDICTION / distance)
    force = reading.force - reading.stiffness @ moved
    if not reading.bonded and force @ reading.force <= 0.0:  # a tool that only touches does not pull
        return np.zeros(3)
    return np.asarray(force)


def limited_force(force: Floats, limit: float) -> Floats:
    """Return a force (3,) scaled down to a limit [N]; zero if it is not finite."""
    size = math.sqrt(force @ force)
    if not math.isfinite(size):
        return np.zeros(3)
    return force if size <= limit else force * (limit / size)


class Watchdog:
    """Watchdog with a ramp: share of the force, 0 while readings are old or the tool is not coupled, then up to 1.

    A reading is old after `max_age` [s], or after four periods of the engine, if they are longer.
    """

    def __init__(self, max_age: float) -> None:
        self._max_age = max_age
        self._steps, self._changed, self._since = -1, -math.inf, math.inf

    def note_reading(self, steps: int, now: float) -> None:
        """Note the number of periods of a reading that arrived at a time [s]; one that does not change is old."""
        if steps != self._steps:
            self._steps, self._changed = steps, now

    def restart(self) -> None:
        """Begin the ramp again: after a connection, a clutch, or another tool."""
        self._since = math.inf

    def age(self, now: float) -> float:
        """Return the age [s] of the newest reading at a time [s]."""
        return now - self._changed

    def is_old(self, now: float, period: float) -> bool:
        """Return whether the newest reading of an engine of a period [s] gives no force at a time [s]."""
        return self.age(now) > max(self._max_age, MAX_READING_PERIODS * period)

    def share(self, now: float, period: float, coupled: bool = True) -> float:
        """Return the share at a time [s] for an engine of a period [s]."""
        if not coupled or self.is_old(now, period):
            self.restart()
            return 0.0
        if self._since == math.inf:
            self._since = now
        return min((now - self._since) / RAMP_SECONDS, 1.0)


class PassivityObserver:
    """Passivity observer and controller: the energy [J] that hands put into a body, from which its forces may take."""

    def __init__(self) -> None:
        self.energy = 0.0

    def note_motion(self, forces: Sequence[Floats], steps: Sequence[Floats]) -> None:
        """Subtract the work of forces (3,) [N] that were held while their devices moved by steps (3,) [m]."""
        for force, step in zip(forces, steps, strict=True):
            self.energy -= float(force @ step)

    def limit_energy(self, most: float) -> None:
        """Keep at most an energy [J]: what the body stores for its present forces; the rest has become heat in it."""
        self.energy = min(self.energy, most)

    def passive_forces(self, forces: Sequence[Floats], velocities: Sequence[Floats], interval: float) -> list[Floats]:
        """Return forces that, at velocities (3,) [m/s] for an interval [s], take no more than there is."""
        left, passive = self.energy, []
        for force, velocity in zip(forces, velocities, strict=True):
            square, taken = float(velocity @ velocity), interval * float(force @ velocity)
            if taken > left and square > STILL_SPEED**2:
                damping = min((taken - left) / (interval * square), MAX_DAMPING)
                if taken > 0.0:  # a hand that leaves is hardly held back: that would feel like glue
                    pull = MAX_PULL if left < 0.0 else 0.0
                    damping = min(damping, taken / (interval * square) + pull / math.sqrt(square))
                force = force - damping * velocity
                taken -= damping * interval * square
            left -= taken
            passive.append(force)
        return passive


def stored_energy(force: Floats, stiffness: Floats) -> float:
    """Return the most energy [J] that a body stores for a force (3,) [N] with a stiffness (3, 3) [N/m] along it.

    A body whose force grows as a power p of the depth stores F^2 (p / (p + 1)) / k for its tangent stiffness k: less
    than F^2 / k for every p, and half of that if it is linear. Infinite where the stiffness is not known.
    """
    square = float(force @ force)
    if square == 0.0:
        return 0.0
    along = float(force @ stiffness @ force) / square
    return square / along if along > 0.0 else math.inf
