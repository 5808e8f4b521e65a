"""Training and test motions of the paper's beam: pulls, bends and twists."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.dynamics.loads.prepared import Load
from palpate.dynamics.loads.surface_force import SurfaceForce
from palpate.faults import InputError, brief, integer_in_range
from palpate.scenes.beam import DURATION

__all__ = ["LIMITS_BY_KIND", "Course", "random_motion", "training_motions"]

# lower and upper bounds by kind: axial force [N], magnitudes of the transverse force [N] and twisting moment [N m]
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


@dataclass(frozen=True)
class Course:
    """Load factor over time: zero until `start`, a ramp up to 1, a hold, and a ramp back to zero.

    Parameters
    ----------
    start, rise, hold, fall : float [s]
        Start of the ramp up, and durations of the ramp up, the hold and the ramp down.
    """

    start: float
    rise: float
    hold: float
    fall: float

    @property
    def end(self) -> float:
        """Time [s] after which the factor is zero again."""
        return self.start + self.rise + self.hold + self.fall

    def __call__(self, time: float) -> float:
        """Return the factor, in [0, 1], at a time [s]."""
        return max(0.0, min(1.0, (time - self.start) / self.rise, (self.end - time) / self.fall))


def random_motion(seed: int, kind: str = "inside") -> tuple[Load, ...]:
    """Return loads on the beam's end ``"x+"`` that pull, bend and twist it at random for a second.

    Each of the three has its own `Course`, which ends within the second.

    Parameters
    ----------
    seed : int
        At least 0.
    kind : str
        ``"inside"``: an axial force of 0 to 10 N, a transverse force of up to 0.1 N in any
        direction and a twisting moment of up to 5 mN m in either direction. ``"outside"``: each 1.3
        to 2 times those limits. ``"buckling"``: the beam is pushed with 0.2 to 0.5 N, beyond
        Euler's 0.15 N, and slightly bent and twisted.

    Raises
    ------
    InputError
        A seed that is not an integer of at least 0, or an unknown kind.
    """
    if kind not in LIMITS_BY_KIND:
        raise InputError(f"kind must be one of {', '.join(map(repr, LIMITS_BY_KIND))}, got {brief(kind)}")
    random = np.random.default_rng([integer_in_range("seed", seed, 0), list(LIMITS_BY_KIND).index(kind)])
    axial, transverse, twist = (float(random.uniform(low, high)) for low, high in LIMITS_BY_KIND[kind])
    angle = random.uniform(0.0, 2 * np.pi)
    sign = random.choice([-1.0, 1.0])
    courses = [_random_course(random) for _ in range(3)]
    return _motion(courses, axial, transverse * np.cos(angle), transverse * np.sin(angle), sign * twist)


def training_motions(count: int = 8) -> list[tuple[Load, ...]]:
    """Return a few pulls, bends and twists within the limits ``"inside"``, each a tuple of loads for a run of a second.

    The first six are at the limits: a pull, a bend along y, one along z, a twist, a diagonal bend
    with a pull, and one with a reverse twist. The others are random.

    Raises
    ------
    InputError
        A count that is not an integer of at least 1.
    """
    count = integer_in_range("count", count, 1)
    largest = np.array([LIMITS_BY_KIND["inside"][part][1] for part in (0, 1, 1, 2)])
    courses = [Course(start=0.05, rise=0.25, hold=0.2, fall=0.2)] * 3
    single = [_motion(courses, *(largest * shares)) for shares in SINGLE_LOADS[:count]]
    return single + [random_motion(TRAINING_SEED + k) for k in range(count - len(single))]


def _random_course(random: np.random.Generator) -> Course:
    start, rise, fall = random.uniform((0.0, 0.05, 0.05), (0.2, 0.4, 0.3)).tolist()
    hold = random.uniform(0.05, min(0.4, DURATION - start - rise - fall))
    return Course(start, rise, hold, fall)


def _motion(courses: Sequence[Course], axial: float, y: float, z: float, twist: float) -> tuple[Load, ...]:
    """Return loads of an axial force, a transverse force (y, z) [N] and a twisting moment [N m] with their courses."""
    pull, bend, turn = courses

    def force(time: float) -> tuple[float, float, float]:
        share = bend(time)
        return axial * pull(time), y * share, z * share

    def moment(time: float) -> tuple[float, float, float]:
        return twist * turn(time), 0.0, 0.0

    return (SurfaceForce("x+", force=force, moment=moment),)
