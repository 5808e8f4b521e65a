"""Bodies of known shape for tests of tool paths."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

import palpate as pt
from palpate.dynamics.loads.supports import supports_of
from palpate.meshfree.cloud import Cloud
from palpate.surface.isosurface import zero_surface
from palpate.surface.surface import Surface, weld


@dataclass(frozen=True)
class Body:
    """What tool paths read of a solid: its cloud and supports, without stencils and kernels."""

    cloud: Cloud
    fixed: tuple = ()

    @property
    def supports(self):
        return supports_of(self.fixed)


def filled(field, half, spacing):
    """Return the cloud inside the zero surface of a field of (x, y, z), within a box of half sizes [m]."""
    step, half = 0.35 * spacing, np.array(half) + spacing
    axes = [np.arange(-h, h + step, step) for h in half]
    x, y, z = np.meshgrid(*axes, indexing="ij")
    vertices, triangles = zero_surface(field(x, y, z), -half, step)
    surface = weld(Surface(vertices, triangles))
    if surface.volume < 0:
        surface = Surface(surface.vertices, surface.triangles[:, ::-1])
    return pt.fill(surface, spacing)


def block(x, y, z, centre, half):
    """Return the field of a box."""
    return np.max([np.abs(v - c) - h for v, c, h in zip((x, y, z), centre, half, strict=True)], axis=0)


def ball(x, y, z, radius):
    """Return the field of a ball at the origin."""
    return np.sqrt(x**2 + y**2 + z**2) - radius


def lobes(gap, spacing=0.005):
    """Return a U: two lobes of 20 mm width or more along z, with a gap [m] between them at x = 0 down to z = -0.01."""

    def field(x, y, z):
        return np.maximum(
            block(x, y, z, (0, 0, 0), (0.04, 0.025, 0.035)), -block(x, y, z, (0, 0, 0.02), (gap / 2, 0.1, 0.03))
        )

    return filled(field, (0.04, 0.025, 0.035), spacing)


def bean(spacing=0.005):
    """Return an ellipsoid with a round notch in its side at positive y."""

    def field(x, y, z):
        body = np.sqrt((x / 0.05) ** 2 + (y / 0.03) ** 2 + (z / 0.025) ** 2) - 1
        notch = np.sqrt((x / 0.018) ** 2 + ((y - 0.03) / 0.018) ** 2) - 1
        return np.maximum(0.03 * body, -0.018 * notch)

    return filled(field, (0.05, 0.03, 0.025), spacing)


def hollow(spacing=0.005):
    """Return a ball of 45 mm with a cavity of 28 mm, in which a tool has room."""
    return filled(lambda x, y, z: np.maximum(ball(x, y, z, 0.045), -ball(x, y, z, 0.028)), (0.045,) * 3, spacing)


def together(first, second, shift):
    """Return two clouds in one, the second moved by a shift (3,) [m]; groups of the first stay."""
    n = len(first)
    return replace(
        first,
        points=np.concatenate([first.points, second.points + shift]),
        volumes=np.concatenate([first.volumes, second.volumes]),
        face_nodes=np.concatenate([first.face_nodes, second.face_nodes + n]),
        face_normals=np.concatenate([first.face_normals, second.face_normals]),
        face_areas=np.concatenate([first.face_areas, second.face_areas]),
        triangles=np.concatenate([first.triangles, second.triangles + n]),
    )
