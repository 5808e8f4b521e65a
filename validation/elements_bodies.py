"""Meshed bodies of the cases of validation/elements_cases.py, refined where their loads and supports need it.

Sizes are relative to the case's spacing, and multiplied by `level`: 1 for the truth, more to estimate its own error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from elements_cases import BONE, LIMB, LIMB_LENGTH, MUSCLE, Case
from elements_fe import Body
from elements_mesh import graded, icosphere, join, subdivide, tetrahedra
from skfem import MeshTet

BORDER, PATCH = 0.17, 0.20  # edges at the borders of support and patch [spacings], for linear responses
EDGE = 3.0  # how much coarser at a clamp that ends at an edge
BALL_BORDER, AROUND = 0.5, 5.3  # for a ball: edges at the support's border [spacings]; radius over edges below it
GROWTH = 0.35, 0.5  # of edges, per distance from patch and ball, and from the support's border
REACH = 1.2  # of a ball, within which it can touch


@dataclass
class Meshed:
    """A body with its held degrees of freedom.

    Attributes
    ----------
    body : Body
    held : array of bool (nodes, 3)
    share : int
        Of how many equal parts the mesh is one, by symmetry.
    """

    body: Body
    held: np.ndarray
    share: int = 1

    @property
    def free(self) -> np.ndarray:
        """Degrees of freedom that are not held."""
        return np.flatnonzero(~self.held.ravel())

    def near(self, point: np.ndarray, distance: float) -> np.ndarray:
        """Return the surface's faces with the first corner within a distance of a point [m]."""
        faces = self.body.faces
        return faces[np.linalg.norm(self.body.X[faces[:, 0]] - point, axis=1) < distance]


def meshed(case: Case, level: float = 1.0, radius: float | None = None) -> Meshed:
    """Return a case's body, with a mesh for a ball of that radius, or for linear responses."""
    if case.limb:
        return _limb(case, level, radius)
    if case.end is not None:
        return _beam(case, level)
    if case.name == "slab" and radius:
        return _quarter_slab(case, level, radius)
    size = _ball_sizes(case, level, radius) if radius else _sizes(case, level)
    vertices, faces = subdivide(case.vertices, case.faces, size)
    if case.inclusion is not None:
        centre, inner, _ = case.inclusion
        vertices, faces = join([(vertices, faces), icosphere(centre, inner, 2 if level > 1 or radius else 3)])
    points, tets = tetrahedra(vertices, faces)
    body = Body(points, tets, case.c1, case.poisson, case.density, case.factor)
    held = np.zeros((len(body.X), 3), bool)
    held[body.surface] = (case.support(body.X[body.surface]) <= 1e-9)[:, None]
    return Meshed(body, held)


def _sizes(case: Case, level: float):
    """Return the size of edges for linear responses."""
    finest = BORDER * case.spacing
    if case.plane <= case.vertices[:, case.axis].min():  # the clamp ends at an edge of the body, where less happens
        finest *= EDGE

    def size(x):
        r = np.linalg.norm(x - case.point, axis=1)
        border = level * finest + GROWTH[1] * np.abs(case.support(x))
        return np.minimum(border, level * PATCH * case.spacing + GROWTH[0] * np.abs(r - case.patch_radius))

    return size


def _ball_sizes(case: Case, level: float, radius: float):
    """Return the size of edges for a ball."""

    def size(x):
        r = np.linalg.norm(x - case.point, axis=1)
        border = level * BALL_BORDER * case.spacing + GROWTH[1] * np.abs(case.support(x))
        return np.minimum(border, level * radius / AROUND + GROWTH[1] * np.maximum(r - REACH * radius, 0))

    return size


def _quarter_slab(case: Case, level: float, radius: float) -> Meshed:
    """Return a quarter of the slab: x and y positive, elements graded to the spot in the middle of its top."""
    half, height = case.vertices[:, 0].max(), case.vertices[:, 2].max()
    count, down = round(12 / level), round(9 / level)
    power = np.log(radius / half) / np.log(0.4)  # two fifths of the cells across lie below the ball
    across = graded(half, count, max(1.0, power))
    mesh = MeshTet.init_tensor(across, across, height - graded(height, down, 1.5)[::-1])
    body = Body(mesh.p.T, mesh.t.T, case.c1, case.poisson, case.density)
    held = np.repeat(body.X[:, 2:] < 1e-9, 3, axis=1)
    held[body.X[:, 0] < 1e-9, 0] = True
    held[body.X[:, 1] < 1e-9, 1] = True
    return Meshed(body, held, share=4)


def _limb(case: Case, level: float, radius: float | None) -> Meshed:
    """Return a quarter of the limb: y and z positive, elements graded to the spot at (60 mm, 0, 0)."""
    count = np.round(np.array([5, 12, 12] if radius else [7, 20, 16]) / level).astype(int)
    around, along = (2.0, 1.9) if radius else (1.5, 1.5)
    fat = LIMB - graded(LIMB - MUSCLE, count[0], 1.5)[::-1]
    muscle = MUSCLE - graded(MUSCLE - BONE, count[0], 1.3)[::-1]
    radii = np.concatenate([muscle[:-1], fat])
    mesh = MeshTet.init_tensor(radii, graded(np.pi, count[1], around), graded(LIMB_LENGTH / 2, count[2], along))
    r, angle, z = mesh.p
    points = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
    body = Body(points, mesh.t.T, case.c1, case.poisson, case.density)
    inside = r[mesh.t].mean(axis=0) < MUSCLE  # by the elements' own layers: their sides are flat
    body.set_factor(lambda _: np.where(inside, 3.0, 1.0) if case.layers else np.ones(len(inside)))
    corners = np.hypot(*body.X[body.faces[:, :3], :2].transpose(2, 0, 1))
    held = np.zeros((len(body.X), 3), bool)
    held[body.faces[(corners < BONE + 1e-9).all(axis=1)]] = True
    held[np.abs(body.X[:, 1]) < 1e-9, 1] = True
    held[np.abs(body.X[:, 2]) < 1e-9, 2] = True
    return Meshed(body, held, share=4)


def _beam(case: Case, level: float) -> Meshed:
    """Return the block, graded to its clamp and to its edges."""
    across, along = round(8 / level), round(36 / level)
    s = np.linspace(-1, 1, across + 1)
    across_places = 0.01 * (0.7 * np.sin(np.pi / 2 * s) + 0.3 * s)
    mesh = MeshTet.init_tensor(graded(case.end, along, 1.6), across_places, across_places)
    body = Body(mesh.p.T, mesh.t.T, case.c1, case.poisson, case.density)
    held = np.repeat(body.X[:, :1] < 1e-9, 3, axis=1)
    return Meshed(body, held)
