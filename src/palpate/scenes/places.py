"""Places of a scene: the nodes that a support, a region or a load takes."""

from __future__ import annotations

import re
import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from palpate.core.arrays import Floats
from palpate.core.faults import InputError, brief, number_in_range
from palpate.meshfree.attachment import painted
from palpate.meshfree.cell_fractions import cell_fractions
from palpate.meshfree.cloud import Cloud
from palpate.scenes.description import Near, Painted, Place, Shape
from palpate.scenes.painted import read_painted
from palpate.surface.checks import METRES_BY_UNIT
from palpate.surface.files import read_surface
from palpate.surface.labels.label_map import LabelMap, Mask, mask_of
from palpate.surface.labels.neighbours import contact_distance
from palpate.surface.labels.reading import is_label_map, read_label_map
from palpate.surface.nesting import inside_points
from palpate.surface.refining import refine_surface
from palpate.surface.surface import Surface

PAINTED_PREFIX = "painted "  # begins the text of a painted place
CAMERA_SIDE = (0.277, -0.833, 0.479)  # direction from the body to the camera of the page at its start
SUPPORT_SHARE = 0.12  # of the extent along a direction, which a side holds
SIDE_AXES = {"x-": (0, 1), "x+": (0, -1), "y-": (1, 1), "y+": (1, -1), "z-": (2, 1), "z+": (2, -1)}
LPS_SIDES = {"right": "x-", "left": "x+", "front": "y-", "rear": "y+", "feet": "z-", "head": "z+"}  # of a patient
RAS_SIDES = {"right": "x+", "left": "x-", "front": "y+", "rear": "y-", "feet": "z-", "head": "z+"}
NUMBER_PATTERN = r"([-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?)"
LOWEST_PATTERN = re.compile(rf"lowest {NUMBER_PATTERN} ?%", re.ASCII)
NEAR_PATTERN = re.compile(rf"near {NUMBER_PATTERN}, ?{NUMBER_PATTERN}, ?{NUMBER_PATTERN}, ?{NUMBER_PATTERN}", re.ASCII)
MAX_EDGE_RATIO = 0.5  # longest edge of a near surface over the distance from it
MIN_WIDTH = 1e-6  # of a margin, in spacings


@dataclass(frozen=True)
class PlaceFinder:
    """Search of the nodes of places in a body."""

    cloud: Cloud
    shape: Shape  # surface of the body: its file, unit and scale
    unit: float = 1.0  # [m]: length of a unit of painted files
    folder: Path = Path()  # folder of relative file names
    space: str = ""  # frame that the file of the body states: ``"LPS"``, ``"RAS"`` or none

    def mask(self, place: Place, *, margin: float = 0.0) -> NDArray[np.bool_]:
        """Return the nodes (n,) in a place, and those up to a margin [spacings] beyond its border.

        A group is taken as it is.
        """
        points = np.pad(self.cloud.points, ((0, 0), (0, 3 - self.cloud.points.shape[1])))  # a sheet is at z = 0
        if place.group:
            mask = np.zeros(len(points), dtype=bool)
            mask[self.cloud.group(place.group)] = True
        elif place.painted:
            mask = self._painted(place.painted, margin)
        else:
            mask = self._contains(place, (margin + 1e-9) * self.cloud.spacing)(points)
        if not mask.any():
            low, high = self.cloud.points.min(axis=0), self.cloud.points.max(axis=0)
            raise InputError(
                f"place must hold a node, got none at its {place.title}; the body extends from {_millimetres(low)} to "
                f"{_millimetres(high)} mm"
            )
        return mask

    def fractions(self, place: Place) -> Floats:
        """Return the share of every node's cell that lies in a place, shape (n,); 0 or 1 in groups and in paint."""
        mask = self.mask(place)
        if place.group or place.painted:
            return mask.astype(float)
        return cell_fractions(self.cloud, self._contains(place, 1e-9 * self.cloud.spacing))

    def _contains(self, place: Place, width: float) -> Callable[[Floats], NDArray[np.bool_]]:
        """Return the function of points (k, 3) that is True up to a width [m] beyond the border of a place."""
        if place.side:
            body = np.pad(self.cloud.points, ((0, 0), (0, 3 - self.cloud.points.shape[1])))
            return lambda points: side_mask(points, place.side, width, body, self.space)
        if place.plane:
            normal, origin = np.array(place.plane.normal), np.array(place.plane.point)
            if not normal.any():
                raise InputError("normal of a plane must not be zero, got zero; give a direction such as [0, 0, 1]")
            return lambda points: (points - origin) @ normal <= width * np.linalg.norm(normal)
        if place.box:
            ends = np.array(place.box.low) - width, np.array(place.box.high) + width
            return lambda points: np.all((points >= ends[0]) & (points <= ends[1]), axis=1)
        if place.ball:
            centre, radius = np.array(place.ball.centre), place.ball.radius + width
            return lambda points: np.linalg.norm(points - centre, axis=1) <= radius
        return self._near(place.near, width) if place.near else self._inside(place.part, width)

    def _painted(self, paint: Painted, margin: float) -> NDArray[np.bool_]:
        path = self.folder / paint.file
        places, values = read_painted(path, paint.field or None)
        mask = np.zeros(len(self.cloud), dtype=bool)
        try:
            mask[painted(self.cloud, self.unit * places, values, least=paint.least, margin=margin)] = True
        except InputError as error:
            raise InputError(f"{path} must have painted nodes of the body, got none: {error}") from error
        return mask

    def _near(self, near: Near, width: float) -> Callable[[Floats], NDArray[np.bool_]]:
        """Return the function that is True within a distance of another surface."""
        distance, path = near.distance, self.folder / near.file
        if is_label_map(path):
            mask = mask_of(self._label_map(path), list(near.parts) or None)
            if distance is None:
                distance = contact_distance(mask.voxel_edges, self.cloud.spacing)
            tree = cKDTree(in_frame(mask.boundary(), mask.space, self.space, mask.name))
        elif distance is None:
            raise InputError(f'near must have a distance from a surface, got none from {path}; give distance = "3 mm"')
        else:
            surface = read_surface(path, part=list(near.parts) or None, units=self._units, scale=self.shape.scale)
            vertices = in_frame(surface.vertices, surface.space, self.space, surface.name)
            tree = _vertices(replace(surface, vertices=vertices), MAX_EDGE_RATIO * distance)
        return lambda points: np.isfinite(tree.query(points, distance_upper_bound=distance + width)[0])

    def _inside(self, part: str, width: float) -> Callable[[Floats], NDArray[np.bool_]]:
        """Return the function that is True inside a closed part of the surface file, and within a width of it."""
        if not self.shape.file:
            raise InputError(
                f"part must be of a surface file, got {brief(part)} of a generated shape; use a box or ball"
            )
        path = self.folder / self.shape.file
        if is_label_map(path):
            return self._in_voxels(mask_of(self._label_map(path), part), width)
        surface = read_surface(path, part=part, units=self._units, scale=self.shape.scale, repair=True)
        if width < MIN_WIDTH * self.cloud.spacing:
            return lambda points: inside_surface(surface, points)
        tree = _vertices(surface, MAX_EDGE_RATIO * width)
        return lambda points: (
            inside_surface(surface, points) | np.isfinite(tree.query(points, distance_upper_bound=width)[0])
        )

    def _label_map(self, path: Path) -> LabelMap:
        """Return a label map in the lengths of the body."""
        names = self.folder / self.shape.labels if self.shape.labels else None
        return read_label_map(path, names).scaled(self.shape.scale)

    def _in_voxels(self, mask: Mask, width: float) -> Callable[[Floats], NDArray[np.bool_]]:
        """Return the function that is True in the voxels of a mask, and within a width of their middles."""
        if width < MIN_WIDTH * self.cloud.spacing:
            return mask.contains
        tree = cKDTree(mask.boundary())
        return lambda points: mask.contains(points) | np.isfinite(tree.query(points, distance_upper_bound=width)[0])

    @property
    def _units(self) -> str:
        """Unit of other files, which is that of the body's."""
        if self.shape.units:
            return self.shape.units
        return min(METRES_BY_UNIT, key=lambda name: abs(np.log(METRES_BY_UNIT[name] * self.shape.scale / self.unit)))


def in_frame(points: Floats, space: str, body_space: str, name: str) -> Floats:
    """Return the points (k, 3) of a file in the frame of a body, LPS or RAS, with a warning about what is assumed.

    Where only one of the two files states its frame, the other one's is LPS, as in 3D Slicer.
    """
    stated = space or ("LPS" if body_space else "")
    if stated == (body_space or ("LPS" if space else "")):
        if space != body_space:
            which = "the file of the body" if space else name
            warnings.warn(f"{which} does not state its frame: taken as LPS, as 3D Slicer does", stacklevel=2)
        return points
    warnings.warn(
        f"{name} is in {stated} and the body in {body_space or 'LPS'}: it is turned by 180 degrees about z, into the "
        "frame of the body",
        stacklevel=2,
    )
    return points * np.array([-1.0, -1.0, 1.0])


def _vertices(surface: Surface, edge: float) -> cKDTree:
    """Return the vertices of a surface whose edges are split to a largest length [m], for searches."""
    return cKDTree(refine_surface(surface.vertices, surface.triangles, lambda places: np.full(len(places), edge))[0])


def inside_surface(surface: Surface, points: Floats) -> NDArray[np.bool_]:
    """Return the points (n,) inside a closed surface; raise `InputError` for an open one."""
    if not surface.closed:
        raise InputError(f"{surface.name} must be closed for a place inside it, got an open surface; use near instead")
    corners = surface.vertices[surface.triangles]
    low, high = surface.vertices.min(axis=0), surface.vertices.max(axis=0)
    mask = np.all((points >= low) & (points <= high), axis=1)
    mask[mask] = inside_points(points[mask], corners)
    return mask


def side_mask(
    points: Floats, text: str, width: float = 0.0, body: Floats | None = None, space: str = ""
) -> NDArray[np.bool_]:
    """Return the points (n,) up to a width [m] beyond a side of a body that a text names.

    See `palpate.scenes.description.Place`. Points (k, 3) `body` give the extent, by default the same points. Sides of
    a patient require the frame of the body's file, `space`.
    """
    body = points if body is None else body
    if text in LPS_SIDES:
        if not space:
            raise InputError(
                f"fixed must be one of {', '.join(SIDE_AXES)} where the file does not state how the patient lies, got "
                f"{text!r}; or add SPACE=LPS to its header, as 3D Slicer writes it"
            )
        text = (LPS_SIDES if space == "LPS" else RAS_SIDES)[text]
    if text in SIDE_AXES:
        axis, sign = SIDE_AXES[text]
        return _far_share(sign * points[:, axis], sign * body[:, axis], SUPPORT_SHARE, width)
    if text == "back":
        towards = np.array(CAMERA_SIDE) / np.linalg.norm(CAMERA_SIDE)
        return _far_share(points @ towards, body @ towards, SUPPORT_SHARE, width)
    lowest = LOWEST_PATTERN.fullmatch(text)
    if lowest:
        share = number_in_range("fixed", float(lowest[1]), 0.0, 100.0, open_low=True, unit="%")
        return _far_share(points[:, 2], body[:, 2], share / 100, width)
    near = NEAR_PATTERN.fullmatch(text)
    if near:
        x, y, z, radius = (1e-3 * float(each) for each in near.groups())
        return np.asarray(np.linalg.norm(points - [x, y, z], axis=1) <= radius + width)
    raise InputError(
        f"fixed must be {', '.join([*SIDE_AXES, *LPS_SIDES])}, back, 'lowest 15%', 'near X,Y,Z,R' in mm or 'painted "
        f"FILE', got {text!r:.60}; use one of them"
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


def _far_share(heights: Floats, body: Floats, share: float, width: float) -> NDArray[np.bool_]:
    """Return True for heights in the lowest share of a body's, and up to a width beyond it."""
    return np.asarray(heights <= body.min() + share * np.ptp(body) + width)


def _millimetres(point: Floats) -> str:
    return "(" + ", ".join(f"{1e3 * x:.3g}" for x in point) + ")"
