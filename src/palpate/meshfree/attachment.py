"""Selection of nodes by position, for `Cloud.with_group`.

The nodes lie on the body's surface, unless `surface` is False. `Cloud.within` selects nodes near a
point.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from palpate.core.arrays import Floats, Ints
from palpate.core.faults import InputError, number_in_range
from palpate.meshfree.cloud import BORDER_MARGIN, Cloud


def in_box(
    cloud: Cloud, low: Sequence[float], high: Sequence[float], *, surface: bool = True, margin: float = BORDER_MARGIN
) -> Ints:
    """Return the nodes in a closed axis-aligned box.

    Parameters
    ----------
    cloud : Cloud
    low, high : (d,) sequences [m]
        Opposite corners.
    surface : bool
        Whether to select surface nodes only.
    margin : float
        Width beyond the border, in spacings, in which nodes are selected, too. What holds or moves the nodes
        then acts on the region, and not on the last nodes inside it. Choose 0 for a region of tissue.

    Raises
    ------
    InputError
        Corners that are not points or are in the wrong order, or a box without a node.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> nodes = pt.in_box(cloud, (0.0, 0.0, 0.0), (0.01, 0.015, 0.0))
    >>> cloud = cloud.with_group("bed", nodes)
    >>> len(cloud.group("bed"))
    12
    """
    corners = [_check_point(cloud, name, value) for name, value in (("low", low), ("high", high))]
    if np.any(corners[0] > corners[1]):
        raise InputError(f"low must be below high, got {corners[0]} m and {corners[1]} m")
    slack = _width(cloud, margin)
    inside = np.all((cloud.points >= corners[0] - slack) & (cloud.points <= corners[1] + slack), axis=1)
    return _select_nodes(cloud, inside, surface, f"the box from {corners[0]} to {corners[1]} m")


def near_plane(
    cloud: Cloud,
    point: Sequence[float],
    normal: Sequence[float],
    distance: float = 0.0,
    *,
    surface: bool = True,
    margin: float = BORDER_MARGIN,
) -> Ints:
    """Return the nodes behind a plane, or at most a distance in front of it.

    Parameters
    ----------
    cloud : Cloud
    point : (d,) sequence [m]
        A point of the plane.
    normal : (d,) sequence
        Normal towards the front, of any length.
    distance : float [m]
        Largest distance of a node in front of the plane.
    surface : bool
        Whether to select surface nodes only.
    margin : float
        Width beyond the border, in spacings, in which nodes are selected, too. What holds or moves the nodes
        then acts on the region, and not on the last nodes inside it. Choose 0 for a region of tissue.

    Raises
    ------
    InputError
        An invalid point or normal, or no node behind the plane.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> nodes = pt.near_plane(cloud, point=(0.01, 0, 0), normal=(1, 0, 0))
    >>> round(float(cloud.points[nodes, 0].max()), 6)
    0.01
    """
    place, direction = _check_point(cloud, "point", point), _check_point(cloud, "normal", normal)
    length = np.linalg.norm(direction)
    if length == 0:
        raise InputError("normal must have a positive length, got zero; give a direction")
    distance = number_in_range("distance", distance, unit="m")
    height = (cloud.points - place) @ (direction / length)
    return _select_nodes(
        cloud, height <= distance + _width(cloud, margin), surface, f"the plane through {place} m towards {direction}"
    )


def painted(
    cloud: Cloud,
    points: Floats,
    values: Floats,
    *,
    least: float = 0.5,
    farthest: float | None = None,
    surface: bool = True,
    margin: float = BORDER_MARGIN,
) -> Ints:
    """Return the nodes whose nearest painted point has a value of at least `least`.

    Parameters
    ----------
    cloud : Cloud
    points : (k, d) array [m]
        Painted points, such as a mesh's vertices: see `palpate.io.read_painted`.
    values : (k,) array
        Painted values: labels or weights.
    least : float
        Smallest value of a point that counts as painted.
    farthest : float, optional [m]
        Largest distance of the nearest painted point; by default two spacings.
    surface : bool
        Whether to select surface nodes only.
    margin : float
        Width beyond the border, in spacings, in which nodes are selected, too. What holds or moves the nodes
        then acts on the region, and not on the last nodes inside it. Choose 0 for a region of tissue.

    Raises
    ------
    InputError
        Arrays of inconsistent shapes or that are not finite, or no painted node.

    Examples
    --------
    >>> import numpy as np
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> vertices = np.array([[0.0, 0.0, 0.015], [0.03, 0.0, 0.015]])
    >>> nodes = pt.painted(cloud, vertices, np.array([1.0, 0.0]))
    >>> round(float(cloud.points[nodes, 0].max()), 6)
    0.01
    """
    places, paint = np.asarray(points, dtype=float), np.asarray(values, dtype=float)
    if places.ndim != 2 or places.shape[1] != cloud.points.shape[1] or paint.shape != (len(places),) or not len(paint):
        raise InputError(
            f"painted points and values must have shapes (k, d) and (k,), k > 0, got {places.shape} and {paint.shape}"
        )
    if not (np.isfinite(places).all() and np.isfinite(paint).all()):
        raise InputError("painted points and values must be finite")
    number_in_range("least", least)
    reach = 2 * cloud.spacing if farthest is None else number_in_range("farthest", farthest, 0.0, unit="m")
    distance, nearest = cKDTree(places).query(cloud.points)
    chosen = (distance <= reach) & (paint[nearest] >= least)
    width = _width(cloud, margin)
    if margin > 0.0 and (paint >= least).any():
        chosen |= cKDTree(places[paint >= least]).query(cloud.points, distance_upper_bound=width)[0] < width
    return _select_nodes(cloud, chosen, surface, f"paint of at least {least:g}")


def _width(cloud: Cloud, margin: float) -> float:
    """Return the width [m] of a margin in spacings, with the rounding of nodes that lie on a border."""
    return (number_in_range("margin", margin, 0.0) + 1e-9) * cloud.spacing


def _check_point(cloud: Cloud, name: str, value: Sequence[float]) -> Floats:
    point = np.array([number_in_range(name, x, unit="m") for x in value])
    if len(point) != cloud.points.shape[1]:
        raise InputError(f"{name} must have {cloud.points.shape[1]} entries, got {len(point)}")
    return point


def _select_nodes(cloud: Cloud, mask: NDArray[np.bool_], surface: bool, where: str) -> Ints:
    """Return the nodes in a mask, optionally on the surface only; a plane cloud is all surface."""
    nodes = np.flatnonzero(mask)
    if surface and cloud.points.shape[1] == 3:
        nodes = np.intersect1d(nodes, cloud.face_nodes)
    if nodes.size == 0:
        what = "node of the surface" if surface else "node"
        low, high = cloud.points.min(axis=0), cloud.points.max(axis=0)
        raise InputError(f"{where} must hold a {what}, got none; the body extends from {low} to {high} m")
    return nodes
