"""Training scene of the paper's beam with a tool that moves its free end at random."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation

from palpate.arrays import Floats
from palpate.dynamics.loads.prepared import Load
from palpate.dynamics.loads.prescribed_motion import PrescribedMotion
from palpate.dynamics.solid.model import Solid
from palpate.faults import number_in_range
from palpate.meshfree.cloud import Cloud, box
from palpate.scenes.beam import MAX_SPACING, MIN_SPACING, SIZE
from palpate.scenes.scene import MAX_FRAMES, TrainingScene
from palpate.tissue.materials import MooneyRivlin

__all__ = ["GROUP", "Hand", "grasp", "grasped_beam"]


GROUP = "x+"  # nodes that the tool holds
# lower and upper bounds of one swing: displacement along x, y, z [m], rotation vector [rad]
SWING = np.array([(-0.001, 0.012), (-0.012, 0.012), (-0.012, 0.012), (-0.25, 0.25), (-0.15, 0.15), (-0.15, 0.15)])
SWINGS = 3  # in a motion


@dataclass(frozen=True)
class Hand:
    """Smooth random motion of the tool: a sum of swings out and back, with one to three periods in a motion.

    Parameters
    ----------
    seed : int
    lasting : float [s]
        Period of the motion, at the ends of which the tool is at rest.
    """

    seed: int
    lasting: float

    @cached_property
    def sizes(self) -> Floats:
        """Displacement [m] and rotation vector [rad] of every swing, shape (SWINGS, 6)."""
        low, high = SWING.T
        return np.asarray(np.random.default_rng(self.seed).uniform(low, high, size=(SWINGS, 6)))

    def pose(self, time: float) -> tuple[Floats, Rotation]:
        """Return the displacement (3,) [m] of the tool's reference point and the rotation about it at a time [s]."""
        shares = np.sin(np.pi * np.arange(1, SWINGS + 1) * time / self.lasting) ** 2
        moved = shares @ self.sizes
        return moved[:3], Rotation.from_rotvec(moved[3:])

    def __call__(self, time: float) -> tuple[Floats, Floats]:
        """Return the pose for `palpate.DummyDevice`: position [m] and quaternion, w x y z."""
        moved, turned = self.pose(time)
        return moved, np.roll(turned.as_quat(), 1)

    def load(self, cloud: Cloud) -> PrescribedMotion:
        """Return the motion as a load on the nodes that the tool holds."""
        centre = cloud.points[cloud.group(GROUP)].mean(axis=0)

        def displacement(points: Floats, time: float) -> Floats:
            moved, turned = self.pose(time)
            arms = points - centre
            return np.asarray(moved + turned.apply(arms) - arms)

        return PrescribedMotion(GROUP, displacement)


def grasp(spacing: float = MAX_SPACING, poisson: float = 0.45) -> Solid:
    """Return the beam of `palpate.scenes.beam.beam` in its energy form, for a tool that holds its free end."""
    material = MooneyRivlin(C1=60e3, C2=1.2e3, density=1120.0, poisson=poisson)
    return Solid(box(SIZE, spacing=spacing), material, fixed="x-", form="energy")


def grasped_beam(
    spacing: float = MAX_SPACING, poisson: float = 0.45, lasting: float = 0.4, every: float = 0.005
) -> TrainingScene:
    """Return the beam with a tool that moves its free end along random smooth paths, out and back.

    Parameters
    ----------
    spacing : float [m]
        Distance between nodes, from 0.5 mm to a third of the thickness.
    poisson : float
        Poisson's ratio at rest, in [0, 0.499].
    lasting : float [s]
        Duration of a path, at most 10.
    every : float [s]
        Time between snapshots, of which a path has at most 10,000.

    Raises
    ------
    InputError
        A parameter out of range; the message names it.
    """
    spacing = number_in_range("spacing", spacing, MIN_SPACING, MAX_SPACING, unit="m")
    lasting = number_in_range("lasting", lasting, 0.0, 10.0, open_low=True, unit="s")
    every = number_in_range("every", every, lasting / MAX_FRAMES, lasting, unit="s")
    model = grasp(spacing, poisson)

    def path(seed: int) -> tuple[tuple[Load, ...], float]:
        return (Hand(seed, lasting).load(model.cloud),), lasting

    parameters = {"spacing": spacing, "poisson": float(poisson), "lasting": lasting, "every": every}
    return TrainingScene(model, path, every, "Beam grasped at its end", parameters, (GROUP,))
