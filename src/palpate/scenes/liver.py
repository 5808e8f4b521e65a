"""Training scene of a liver: presses of a ball and pulls of forceps on its free surface."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import PchipInterpolator

from palpate.arrays import Floats
from palpate.dynamics.contact.tools import Contact, Grasp, Sphere
from palpate.dynamics.solid.model import Solid
from palpate.faults import InputError, number_in_range
from palpate.meshfree.attachment import near_plane
from palpate.meshfree.cloud import Cloud
from palpate.meshfree.filling import fill
from palpate.scenes.organ import liver_surface
from palpate.scenes.scene import TrainingScene
from palpate.tissue.liver import DENSITY, MASS_DAMPING, SHEAR_MODULUS
from palpate.tissue.materials import NeoHookean

__all__ = ["ToolPaths", "pressed_liver"]


BED = 0.07  # [m] depth of the fixed back: the bare area, where a liver is attached to the diaphragm
MARGIN = 0.02  # [m] smallest distance of presses from it
CLEARANCE = 0.003  # [m] between ball and body before and after a press
MAX_SLIDE = 0.02  # [m]
MIN_DEPTH_RATIO = 0.3  # smallest depth of a press over the largest
EVERY = 0.01  # [s]
TIMES = (0.0, 0.02, 0.25, 0.45, 0.58, 0.6)  # [s] away, near, pressed, slid, near, away; of forceps: pulled, turned
GRASP_INTERVAL = 4  # every fourth seed is a grasp, the others are presses
REACH, WIDEST = 0.6, 2.0  # radius of forceps over the ball's; at least, in spacings, so that they hold some ten nodes
CONE, TURN = np.pi / 4, np.pi / 9  # [rad] largest angle of pulls to the normal; largest rotation
MAX_DRAWS = 1000  # of random presses until one is not obstructed by the body


def pressed_liver(
    spacing: float = 0.0045,
    poisson: float = 0.45,
    radius: float = 0.015,
    depth: float = 0.02,
    friction: float = 0.2,
    mass_damping: float = MASS_DAMPING,
) -> TrainingScene:
    """Return the generated liver (`palpate.liver_surface`) with random presses of a ball and pulls of forceps.

    Neo-Hookean with the mean shear modulus of healthy livers, 2.2 kPa; the back is fixed. In a
    press the ball moves along the normal at a random node, indents the surface by 0.3 to 1 times
    `depth`, slides up to 20 mm, and retracts. Every fourth seed, 3, 7 and so on, is a grasp.
    Forceps hold the surface nodes around a random one, and pull them by 0.3 to 1 times `depth` at
    up to 45 degrees to the normal. Half of them turn by up to 20 degrees. They return and release.

    Parameters
    ----------
    spacing : float [m]
        Distance between nodes, 2 to 12 mm; 4.5 mm are about 20,000 nodes.
    poisson : float
        Poisson's ratio at rest, in [0, 0.49].
    radius : float [m]
        Radius of the ball, at least 2.5 spacings, so that nodes resolve the surface under it. The
        radius of forceps is 0.6 times it, or 2 spacings if that is more.
    depth : float [m]
        Depth of the deepest press and length of the longest pull, up to 40 mm.
    friction : float
        Coulomb's coefficient.
    mass_damping : float [1/s]
        Rayleigh's alpha, 0 to 100. With 8 1/s a vibration of 26 rad/s, the slowest, has a damping ratio of 0.15,
        and one of 10 Hz 0.06. The ratio of the Zener law of healthy livers in Asbach et al., Magn. Reson. Med. 60,
        2008 (1.16 kPa, 1.97 kPa, 7.3 Pa s, measured at 25 to 62.5 Hz) is 0.08 and 0.17 there.

    Raises
    ------
    InputError
        A parameter out of range; the message names it.
    """
    spacing = number_in_range("spacing", spacing, 0.002, 0.012, unit="m")
    poisson = number_in_range("poisson", poisson, 0.0, 0.49)
    radius = number_in_range("radius", radius, 2.5 * spacing, 0.1, unit="m")
    depth = number_in_range("depth", depth, 0.0, 0.04, open_low=True, unit="m")
    friction = number_in_range("friction", friction, 0.0, 2.0)
    mass_damping = number_in_range("mass_damping", mass_damping, 0.0, 100.0, unit="1/s")
    model = _model(spacing, poisson, mass_damping)
    paths = ToolPaths(model.cloud, radius, depth, friction)
    parameters = {
        "spacing": spacing, "poisson": poisson, "radius": radius, "depth": depth, "friction": friction,
        "mass_damping": mass_damping,
    }  # fmt: skip
    return TrainingScene(model, paths, EVERY, "Liver pressed by a ball and pulled by forceps", parameters)


def _model(spacing: float, poisson: float, mass_damping: float) -> Solid:
    cloud = fill(liver_surface(), spacing)
    back = cloud.points[:, 1].max()
    cloud = cloud.with_group("back", near_plane(cloud, (0.0, back - BED, 0.0), (0.0, -1.0, 0.0)))
    material = NeoHookean(C1=SHEAR_MODULUS / 2, density=DENSITY, poisson=poisson)
    return Solid(cloud, material, "back", form="energy", mass_damping=mass_damping)


class ToolPaths:
    """Random presses of a ball and pulls of forceps on the free surface of a body; equal seeds give equal paths.

    Every fourth seed is a grasp, named ``"grasp"``, the others are presses, named ``"tool"``.

    Parameters
    ----------
    cloud : Cloud
        Cloud with a fixed group ``"back"``.
    radius, depth : float [m]
        Radius of the ball; depth of the deepest press and length of the longest pull.
    friction : float
    shallowest : float
        Depth of the shallowest press and length of the shortest pull, over `depth`.

    Raises
    ------
    InputError
        In a call, if the ball or the forceps are too large for the body.
    """

    def __init__(
        self, cloud: Cloud, radius: float, depth: float, friction: float, shallowest: float = MIN_DEPTH_RATIO
    ) -> None:
        self.cloud, self.radius, self.depth, self.friction = cloud, radius, depth, friction
        self.shallowest = shallowest
        self.normals = np.zeros_like(cloud.points)
        self.normals[cloud.face_nodes] = cloud.face_normals
        self.back = float(cloud.points[cloud.group("back"), 1].min())
        self.free = np.unique(cloud.face_nodes)
        self.free = self.free[cloud.points[self.free, 1] < self.back - MARGIN]

    def __call__(self, seed: int) -> tuple[tuple[Contact | Grasp], float]:
        """Return the loads of a path and its duration [s]."""
        return self.grasp(seed) if seed % GRASP_INTERVAL == GRASP_INTERVAL - 1 else self.press(seed)

    def grasp(self, seed: int) -> tuple[tuple[Grasp], float]:
        """Return the load of forceps that pull, turn, return and release, and its duration [s]."""
        random, points = np.random.default_rng(seed), self.cloud.points
        radius = max(REACH * self.radius, WIDEST * self.cloud.spacing)
        free = self.free[points[self.free, 1] < self.back - radius - self.cloud.spacing]
        if not len(free):
            raise InputError(
                f"radius must leave room for forceps of radius {radius:g} m on the body; use a smaller ball"
            )
        at = random.choice(free)
        pull = random.uniform(self.shallowest, 1.0) * self.depth * _draw_in_cone(random, self.normals[at], CONE)
        turn = random.choice([0.0, 1.0]) * random.uniform(0.0, TURN) * _draw_in_cone(random, self.normals[at], np.pi)
        still = np.zeros(6)
        pulled, turned = np.concatenate([pull, still[3:]]), np.concatenate([pull, turn])
        path = PchipInterpolator(TIMES, [still, still, pulled, turned, still, still])
        place = points[at]

        def motion(time: float) -> tuple[Floats, Floats]:
            moved = path(np.clip(time, TIMES[0], TIMES[-1]))
            return place + moved[:3], moved[3:]

        return (Grasp(place, radius, motion, until=TIMES[-2]),), TIMES[-1]

    def press(self, seed: int) -> tuple[tuple[Contact], float]:
        """Return the load of a ball that presses, slides and retracts, and its duration [s]."""
        random, points = np.random.default_rng(seed), self.cloud.points
        for _ in range(MAX_DRAWS):
            first = random.choice(self.free)
            deep = random.uniform(self.shallowest, 1.0) * self.depth
            aim = points[first] + random.uniform(-MAX_SLIDE, MAX_SLIDE, 3) / np.sqrt(3)
            last = self.free[np.argmin(np.linalg.norm(points[self.free] - aim, axis=1))]
            near, far = self.radius + CLEARANCE, self.radius + 2 * CLEARANCE
            heights = ((first, far), (first, near), (first, self.radius - deep), (last, self.radius - deep),
                       (last, near), (last, far))  # fmt: skip
            places = np.array([points[node] + height * self.normals[node] for node, height in heights])
            ends = np.linalg.norm(points[:, None] - places[None, [0, 1, 4, 5]], axis=2).min(axis=0)
            turned = float(self.normals[first] @ self.normals[last])
            if ends.min() > self.radius and turned > 0.5:
                path = PchipInterpolator(TIMES, places)
                motion = lambda time, path=path: path(np.clip(time, TIMES[0], TIMES[-1]))  # noqa: E731
                return (Contact(Sphere(self.radius), motion, friction=self.friction),), TIMES[-1]
        raise InputError(f"radius must leave room for a ball on the body, got {self.radius:g} m; use a smaller one")


def _draw_in_cone(random: np.random.Generator, axis: Floats, angle: float) -> Floats:
    """Return a random unit vector (3,) within an angle [rad] of an axis."""
    along = random.uniform(np.cos(angle), 1.0)
    across = np.cross(axis, random.standard_normal(3))
    return np.asarray(along * axis + np.sqrt(1.0 - along**2) * across / np.linalg.norm(across))
