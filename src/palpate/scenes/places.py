"""Places of a scene: the nodes that a support, a region or a load takes."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from palpate.arrays import Floats
from palpate.faults import InputError, brief, number_in_range
from palpate.meshfree.attachment import painted
from palpate.meshfree.cloud import Cloud
from palpate.meshfree.nesting import inside_points
from palpate.meshfree.refining import refine_surface
from palpate.meshfree.surface_files import METRES_BY_UNIT, read_surface
from palpate.meshfree.surfaces import Surface
from palpate.scenes.description import Near, Painted, Place, Shape
from palpate.scenes.painted import read_painted

__all__ = ["PlaceFinder", "inside_surface", "place_of_text", "side_mask"]

PAINTED_PREFIX = "painted "  # begins the text of a painted place
CAMERA_SIDE = (0.277, -0.833, 0.479)  # direction from the body to the camera of the page at its start
SUPPORT_SHARE = 0.12  # of the extent along a direction, which a side holds
SIDE_AXES = {"x-": (0, 1), "x+": (0, -1), "y-": (1, 1), "y+": (1, -1), "z-": (2, 1), "z+": (2, -1)}
NUMBER_PATTERN = r"([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)"
LOWEST_PATTERN = re.compile(rf"lowest {NUMBER_PATTERN} ?%", re.ASCII)
NEAR_PATTERN = re.compile(rf"near {NUMBER_PATTERN}, ?{NUMBER_PATTERN}, ?{NUMBER_PATTERN}, ?{NUMBER_PATTERN}", re.ASCII)
MAX_EDGE_RATIO = 0.5  # longest edge of a near surface over the distance from it


@dataclass(frozen=True)
class PlaceFinder:
    """Search of the nodes of places in a body.

    Parameters
    ----------
    cloud : Cloud
    shape : Shape
        Surface of the body: its file, unit and scale.
    unit : float [m]
        Length of a unit of painted files.
    folder : path
        Folder of relative file names.
    """

    cloud: Cloud
    shape: Shape
    unit: float = 1.0
    folder: Path = Path()

    def mask(self, place: Place) -> NDArray[np.bool_]:
        """Return the nodes (n,) in a place.

        Raises
        ------
        InputError
            The place holds no node, its file cannot be used, or there is no such group or part.
        """
        mask = self._mask(place)
        if not mask.any():
            low, high = self.cloud.points.min(axis=0), self.cloud.points.max(axis=0)
            raise InputError(
                f"place must hold a node, got none at its {place.title}; the body extends from {_millimetres(low)} to "
                f"{_millimetres(high)} mm"
            )
        return mask

    def _mask(self, place: Place) -> NDArray[np.bool_]:
        points = np.pad(self.cloud.points, ((0, 0), (0, 3 - self.cloud.points.shape[1])))  # a sheet is at z = 0
        slack = 1e-9 * self.cloud.spacing
        if place.side:
            return side_mask(points, place.side)
        if place.group:
            mask = np.zeros(len(points), dtype=bool)
            mask[self.cloud.group(place.group)] = True
            return mask
        if place.plane:
            normal = np.array(place.plane.normal)
            if not normal.any():
                raise InputError("normal of a plane must not be zero, got zero; give a direction such as [0, 0, 1]")
            return np.asarray((points - place.plane.point) @ normal <= slack * np.linalg.norm(normal))
        if place.box:
            low, high = np.array(place.box.low), np.array(place.box.high)
            return np.asarray(np.all((points >= low - slack) & (points <= high + slack), axis=1))
        if place.ball:
            away = np.linalg.norm(points - place.ball.centre, axis=1)
            return np.asarray(away <= place.ball.radius + slack)
        if place.painted:
            return self._painted(place.painted)
        if place.near:
            return self._near(points, place.near)
        return self._inside(points, place.part)

    def _painted(self, paint: Painted) -> NDArray[np.bool_]:
        path = self.folder / paint.file
        places, values = read_painted(path, paint.field or None)
        mask = np.zeros(len(self.cloud), dtype=bool)
        try:
            mask[painted(self.cloud, self.unit * places, values, least=paint.least)] = True
        except InputError as error:
            raise InputError(f"{path} must have painted nodes of the body, got none: {error}") from error
        return mask

    def _near(self, points: Floats, near: Near) -> NDArray[np.bool_]:
        """Return the nodes within a distance of another surface."""
        distance = near.distance
        surface = read_surface(
            self.folder / near.file,
            part=list(near.parts) or None,
            units=self._units,
            scale=self.shape.scale,
            repair=False,
        )
        vertices, _ = refine_surface(
            surface.vertices, surface.triangles, lambda places: np.full(len(places), MAX_EDGE_RATIO * distance)
        )
        away, _ = cKDTree(vertices).query(points, distance_upper_bound=distance)
        return np.asarray(np.isfinite(away))

    def _inside(self, points: Floats, part: str) -> NDArray[np.bool_]:
        """Return the nodes inside a closed part of the surface file."""
        if not self.shape.file:
            raise InputError(
                f"part must be of a surface file, got {brief(part)} of a generated shape; use a box or ball"
            )
        surface = read_surface(
            self.folder / self.shape.file, part=part, units=self._units, scale=self.shape.scale, repair=True
        )
        return inside_surface(surface, points)

    @property
    def _units(self) -> str:
        """Unit of other files, which is that of the body's."""
        if self.shape.units:
            return self.shape.units
        return min(METRES_BY_UNIT, key=lambda name: abs(np.log(METRES_BY_UNIT[name] * self.shape.scale / self.unit)))


def inside_surface(surface: Surface, points: Floats) -> NDArray[np.bool_]:
    """Return the points (n,) inside a closed surface; raise `InputError` for an open one."""
    if not surface.closed:
        raise InputError(f"{surface.name} must be closed for a place inside it, got an open surface; use near instead")
    corners = surface.vertices[surface.triangles]
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    mask = np.all((points >= low) & (points <= high), axis=1)
    mask[mask] = inside_points(points[mask], corners)
    return mask


def side_mask(points: Floats, text: str) -> NDArray[np.bool_]:
    """Return the points (n,) on a side that a text names; see `palpate.scenes.description.Place`."""
    if text in SIDE_AXES:
        axis, sign = SIDE_AXES[text]
        return _far_share(sign * points[:, axis], SUPPORT_SHARE)
    if text == "back":
        return _far_share(points @ np.array(CAMERA_SIDE), SUPPORT_SHARE)
    lowest = LOWEST_PATTERN.fullmatch(text)
    if lowest:
        share = number_in_range("fixed", float(lowest[1]), 0.0, 100.0, open_low=True, unit="%")
        return _far_share(points[:, 2], share / 100)
    near = NEAR_PATTERN.fullmatch(text)
    if near:
        x, y, z, radius = (1e-3 * float(each) for each in near.groups())
        return np.asarray(np.linalg.norm(points - [x, y, z], axis=1) <= radius)
    raise InputError(
        f"fixed must be {', '.join(SIDE_AXES)}, back, 'lowest 15%', 'near X,Y,Z,R' in mm or 'painted FILE', got "
        f"{text!r:.60}; use one of them"
    )


def place_of_text(text: str) -> Place:
    """Return the place of a text on the command line: a side, ``painted FILE`` or ``painted FILE:FIELD``."""
    text = text.strip()
    if not text.startswith(PAINTED_PREFIX):
        return Place(side=text)
    text = text.removeprefix(PAINTED_PREFIX).strip()
    file, colon, field = text.rpartition(":")
    if not colon or Path(text).exists():
        file, field = text, ""
    return Place(painted=Painted(file=file, field=field))


def _far_share(heights: Floats, share: float) -> NDArray[np.bool_]:
    """Return True for the nodes in the lowest share of the extent."""
    return np.asarray(heights <= heights.min() + share * np.ptp(heights))


def _millimetres(point: Floats) -> str:
    return "(" + ", ".join(f"{1e3 * x:.3g}" for x in point) + ")"
