"""Training and test motions of the paper's beam, for a second at a time: pulls, bends and twists of its end "x+"."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

import palpate as pt
from palpate.scenes.beam import DURATION

# lower and upper bounds by kind: axial force [N], magnitudes of the transverse force [N] and twisting moment [N m];
# Euler's load of the pushed beam is 0.15 N
LIMITS_BY_KIND = {
    "inside": ((0.0, 10.0), (0.0, 0.1), (0.0, 5e-3)),
    "outside": ((13.0, 20.0), (0.13, 0.2), (6.5e-3, 0.01)),
    "buckling": ((-0.5, -0.2), (0.0, 0.02), (0.0, 1e-3)),
}
# axial force, transverse force along y and z, twisting moment, as shares of the largest of kind "inside"
SINGLE_LOADS = (
    (1.0, 0.0, 0.0, 0.0),
    (0.0, 1.0, 0.0, 0.0),
    (0.0, 0.0, 1.0, 0.0),
    (0.0, 0.0, 0.0, 1.0),
    (1.0, -np.sqrt(0.5), -np.sqrt(0.5), 0.0),
    (0.0, -np.sqrt(0.5), np.sqrt(0.5), -1.0),
)
TRAINING_SEED = 1_000_000  # seeds from here on are those of training


class Course(NamedTuple):
    """Load factor over time [s]: zero until `start`, a ramp up to 1, a hold, and a ramp back to zero."""

    start: float
    rise: float
    hold: float
    fall: float

    def __call__(self, time: float) -> float:
        end = self.start + self.rise + self.hold + self.fall
        return max(0.0, min(1.0, (time - self.start) / self.rise, (end - time) / self.fall))


def random_motion(seed: int, kind: str = "inside") -> tuple[pt.SurfaceForce]:
    """Return loads of a kind of `LIMITS_BY_KIND`, each of the three with a course of its own."""
    random = np.random.default_rng([seed, list(LIMITS_BY_KIND).index(kind)])
    axial, transverse, twist = (float(random.uniform(low, high)) for low, high in LIMITS_BY_KIND[kind])
    angle = random.uniform(0.0, 2 * np.pi)
    sign = random.choice([-1.0, 1.0])
    courses = [_random_course(random) for _ in range(3)]
    return _motion(courses, axial, transverse * np.cos(angle), transverse * np.sin(angle), sign * twist)


def training_motions(count: int) -> list[tuple[pt.SurfaceForce]]:
    """Return up to six single loads at the limits "inside", and then random ones."""
    largest = np.array([LIMITS_BY_KIND["inside"][part][1] for part in (0, 1, 1, 2)])
    courses = [Course(start=0.05, rise=0.25, hold=0.2, fall=0.2)] * 3
    single = [_motion(courses, *(largest * shares)) for shares in SINGLE_LOADS[:count]]
    return single + [random_motion(TRAINING_SEED + k) for k in range(count - len(single))]


def _random_course(random: np.random.Generator) -> Course:
    start, rise, fall = random.uniform((0.0, 0.05, 0.05), (0.2, 0.4, 0.3)).tolist()
    return Course(start, rise, random.uniform(0.05, min(0.4, DURATION - start - rise - fall)), fall)


def _motion(courses: Sequence[Course], axial: float, y: float, z: float, twist: float) -> tuple[pt.SurfaceForce]:
    """Return an axial force, a transverse force (y, z) [N] and a twisting moment [N m] with their courses."""
    pull, bend, turn = courses

    def force(time: float) -> tuple[float, float, float]:
        return axial * pull(time), y * bend(time), z * bend(time)

    return (pt.SurfaceForce("x+", force=force, moment=lambda time: (twist * turn(time), 0.0, 0.0)),)
