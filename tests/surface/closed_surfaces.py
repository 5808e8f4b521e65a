"""Surfaces that the tests of filling share."""

from __future__ import annotations

import numpy as np

from palpate.surface.refining import refine_surface
from palpate.surface.surface import Surface


def cube(side=0.1, edge=0.03, centre=(0.0, 0.0, 0.0)):
    """A closed cube with edges of its triangles no longer than `edge`."""
    corners = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = np.array([t for a, b, c, d in faces for t in ((a, b, c), (a, c, d))])
    vertices, triangles = refine_surface(corners * side, triangles, lambda points: np.full(len(points), edge))
    return Surface(vertices - side / 2 + np.array(centre), triangles, "cube")


def ball(radius=0.05, edge=0.008, centre=(0.0, 0.0, 0.0)):
    """A closed ball made of a cube."""
    coarse = cube(1.0, edge / radius)
    vertices = radius * coarse.vertices / np.linalg.norm(coarse.vertices, axis=1)[:, None]
    return Surface(vertices + np.array(centre), coarse.triangles, "ball")


def joined(*parts):
    """Several surfaces as one."""
    shift = np.cumsum([0, *(len(part.vertices) for part in parts)])
    vertices = np.concatenate([part.vertices for part in parts])
    return Surface(vertices, np.concatenate([part.triangles + k for part, k in zip(parts, shift, strict=False)]))


def inverted(surface):
    """The same surface inside out."""
    return Surface(surface.vertices, surface.triangles[:, ::-1], surface.name)
