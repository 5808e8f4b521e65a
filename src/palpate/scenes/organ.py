"""Generated liver surface without patient data: a smooth implicit surface.

Smoothly joined ellipsoids form the lobes. The impressions of adjacent organs on the underside are
subtracted smoothly: kidney and colon, stomach, gallbladder, the porta hepatis, the spine with the
vena cava, and the notch of the round ligament.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from palpate.core.arrays import Floats
from palpate.core.faults import number_in_range
from palpate.surface.isosurface import zero_surface
from palpate.surface.surface import Surface, weld

Vector = Sequence[float]

LIVER_VOLUME = 1.5e-3  # [m^3] of an adult liver
GRID_LOW, GRID_HIGH = np.array([-0.15, -0.11, -0.13]), np.array([0.17, 0.12, 0.12])  # [m] of the grid


def liver_surface(resolution: float = 0.003, volume: float = LIVER_VOLUME) -> Surface:
    """Return a closed liver-like surface: right lobe at negative x, front at negative y, dome up along z.

    Parameters
    ----------
    resolution : float [m]
        Spacing of the grid for the isosurface, from 1 to 8 mm, for a volume of 1.5 litres.
    volume : float [m^3]
        Volume to which the shape is scaled.

    Raises
    ------
    InputError
        A parameter out of range.

    Examples
    --------
    >>> import palpate as pt
    >>> surface = pt.liver_surface(resolution=0.008, volume=0.0015)
    >>> surface.closed, round(surface.volume, 6)
    (True, 0.0015)
    """
    resolution = number_in_range("resolution", resolution, 0.001, 0.008, unit="m")
    volume = number_in_range("volume", volume, 1e-6, 1e-2, unit="m^3")
    cells = np.ceil((GRID_HIGH - GRID_LOW) / resolution).astype(int)
    axes = [GRID_LOW[a] + resolution * np.arange(cells[a] + 1) for a in range(3)]
    x, y, z = np.meshgrid(*axes, indexing="ij", sparse=True)
    vertices, triangles = zero_surface(_liver(x, y, z), GRID_LOW, resolution)
    surface = weld(Surface(vertices, triangles, "liver"))
    if surface.volume < 0:
        surface = Surface(surface.vertices, surface.triangles[:, ::-1], "liver")
    scale = np.cbrt(volume / surface.volume)
    return Surface(scale * surface.vertices, surface.triangles, "liver")


def _liver(x: Floats, y: Floats, z: Floats) -> Floats:
    """Return the approximate signed distance to the liver surface [m], negative inside."""
    right = _ellipsoid(x, y, z, (-0.054, 0.016, -0.006), (0.076, 0.088, 0.100))
    front = _ellipsoid(x, y, z, (-0.016, -0.022, -0.016), (0.116, 0.066, 0.090), tilt=-0.25)
    left = _ellipsoid(x, y, z, (0.074, -0.026, 0.030), (0.092, 0.050, 0.046), tilt=-0.10)
    body = _union(_union(right, front, 0.03), left, 0.05)
    below = 0.42 * x - 0.9 * z + 0.0 * y - 0.072  # the inferior margin rises from the right to the left
    body = _cut(body, -below, 0.03)
    viscera = _ellipsoid(x, y, z, (0.045, 0.115, -0.125), (0.150, 0.150, 0.150))
    body = _cut(body, viscera, 0.012)
    stomach = _ellipsoid(x, y, z, (0.120, 0.050, -0.062), (0.095, 0.085, 0.085))
    body = _cut(body, stomach, 0.014)
    spine = _capsule(x, y, z, (0.034, 0.105, -0.2), (0.034, 0.105, 0.2), 0.054)
    body = _cut(body, spine, 0.03)
    kidney = _ellipsoid(x, y, z, (-0.050, 0.085, -0.090), (0.036, 0.045, 0.055))
    body = _cut(body, kidney, 0.02)
    gallbladder = _capsule(x, y, z, (-0.034, -0.030, -0.115), (-0.006, 0.014, -0.036), 0.0135)
    body = _cut(body, gallbladder, 0.012)
    porta = _capsule(x, y, z, (-0.008, 0.016, -0.024), (0.038, 0.012, -0.012), 0.010)
    body = _cut(body, porta, 0.012)
    ligament = _ellipsoid(x, y, z, (0.036, -0.030, -0.088), (0.009, 0.090, 0.048), tilt=0.1)
    return _cut(body, ligament, 0.014)


def _ellipsoid(x: Floats, y: Floats, z: Floats, centre: Vector, radii: Vector, tilt: float = 0.0) -> Floats:
    """Return the field of an ellipsoid, rotated about y by `tilt` [rad]."""
    cosine, sine = np.cos(tilt), np.sin(tilt)
    a, b, c = x - centre[0], y - centre[1], z - centre[2]
    a, c = cosine * a + sine * c, cosine * c - sine * a
    scaled = np.sqrt((a / radii[0]) ** 2 + (b / radii[1]) ** 2 + (c / radii[2]) ** 2)
    steep = np.sqrt((a / radii[0] ** 2) ** 2 + (b / radii[1] ** 2) ** 2 + (c / radii[2] ** 2) ** 2)
    return np.asarray(scaled * (scaled - 1) / np.maximum(steep, 1e-9))


def _capsule(x: Floats, y: Floats, z: Floats, start: Vector, end: Vector, radius: float) -> Floats:
    """Return the field of a capsule."""
    axis = np.subtract(end, start)
    along = ((x - start[0]) * axis[0] + (y - start[1]) * axis[1] + (z - start[2]) * axis[2]) / (axis @ axis)
    along = np.clip(along, 0.0, 1.0)
    away = [p - start[k] - along * axis[k] for k, p in enumerate((x, y, z))]
    return np.asarray(np.sqrt(away[0] ** 2 + away[1] ** 2 + away[2] ** 2) - radius)


def _union(a: Floats, b: Floats, width: float) -> Floats:
    """Return the polynomial smooth minimum of two fields over a width [m]."""
    blend = np.maximum(width - np.abs(a - b), 0.0) / width
    return np.asarray(np.minimum(a, b) - blend**3 * width / 6)


def _cut(body: Floats, tool: Floats, width: float) -> Floats:
    """Return the difference of two bodies, with edges rounded over a width [m]."""
    return -_union(-body, tool, width)
