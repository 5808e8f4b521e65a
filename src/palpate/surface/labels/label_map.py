"""Label maps, their segments, and masks of one or several of them.

Indices (i, j, k) of a voxel are in the order of the file's axes; `affine` gives the middle of a voxel in metres. Bodies
are in LPS (x to the left of the patient, y to the rear, z to the head), the frame of DICOM, ITK and 3D Slicer's files.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatchcase
from functools import cached_property
from pathlib import PurePath
from typing import Any

import numpy as np
import scipy.ndimage as ndimage
from numpy.typing import NDArray

from palpate.core.arrays import Floats, Ints
from palpate.core.faults import FileFormatError, InputError
from palpate.core.files import shortened
from palpate.surface.parts import names_text
from palpate.surface.surface import MAX_COORDINATE

RAS_TO_LPS = np.diag([-1.0, -1.0, 1.0, 1.0])  # a turn by 180 degrees about z
Box = tuple[slice, slice, slice]


@dataclass(frozen=True)
class Segment:
    """Segment of a label map: an organ, or another region that has a number."""

    number: int  # number in the map, by which it can be chosen
    name: str  # name in the file; ``"label 5"`` without one
    layer: int  # layer of the map that holds it
    value: int  # value of its voxels there
    count: int  # number of its voxels
    label: int | None = None  # number in the file, where a segment of another layer has the same


@dataclass(frozen=True)
class LabelMap:
    """Label map: an image whose voxels hold the numbers of segments."""

    name: str  # name of the file, for messages
    # tuple of (nx, ny, nz) int array: values of the voxels, 0 outside of all segments. Segments that overlap are in
    # different layers.
    layers: tuple[NDArray[Any], ...]
    # (4, 4) array [m]: map from indices (i, j, k, 1) to the middle of a voxel, in LPS if `space` is ``"LPS"``
    affine: Floats
    segments: tuple[Segment, ...]  # those that have voxels, in the order of their numbers
    space: str = "LPS"  # ``"LPS"``, or empty where the file does not state how the patient lies
    notes: tuple[str, ...] = ()  # what was assumed in reading the file
    absent: tuple[str, ...] = ()  # names in the file of segments without voxels

    @property
    def shape(self) -> tuple[int, int, int]:
        """Number of voxels along each axis."""
        nx, ny, nz = self.layers[0].shape
        return nx, ny, nz

    @property
    def voxel_volume(self) -> float:
        """Volume of a voxel [m^3]."""
        return float(abs(np.linalg.det(self.affine[:3, :3])))

    @property
    def voxel_edges(self) -> Floats:
        """Lengths (3,) of the edges of a voxel [m]."""
        return np.asarray(np.linalg.norm(self.affine[:3, :3], axis=0))

    @cached_property
    def boxes(self) -> tuple[Box, ...]:
        """Bounding box of each segment, as slices of its layer."""
        by_layer = [ndimage.find_objects(layer.T) for layer in self.layers]  # the first axis is the fastest
        boxes = []
        for segment in self.segments:
            z, y, x = by_layer[segment.layer][segment.value - 1]
            boxes.append((x, y, z))
        return tuple(boxes)

    def scaled(self, factor: float) -> LabelMap:
        """Return the map with all lengths multiplied by a factor."""
        return replace(self, affine=in_metres(self.affine, factor))

    def with_names(self, names: dict[int, str]) -> LabelMap:
        """Return the map with other names of segments, by their numbers."""
        segments = tuple(replace(each, name=names.get(each.number, each.name)) for each in self.segments)
        present = {number for each in segments for number in (each.number, each.label)}
        absent = tuple(name for number, name in names.items() if number and number not in present)
        return replace(self, segments=segments, absent=tuple(dict.fromkeys((*self.absent, *absent))))


@dataclass(frozen=True)
class Mask:
    """Voxels of one or several segments, cropped to their bounding box."""

    name: str  # name in messages
    voxels: NDArray[np.bool_]  # (a, b, c) bool array
    start: Ints  # (3,) int array: indices of the first voxel in the image
    shape: tuple[int, int, int]  # voxels of the image along each axis
    affine: Floats  # (4, 4) array [m]: of the image, as in `LabelMap`
    space: str = "LPS"  # as in `LabelMap`
    warnings: tuple[str, ...] = field(default=())  # what was left out or filled

    @property
    def volume(self) -> float:
        """Volume of the voxels [m^3]."""
        return float(np.count_nonzero(self.voxels) * abs(np.linalg.det(self.affine[:3, :3])))

    @property
    def voxel_edges(self) -> Floats:
        """Lengths (3,) of the edges of a voxel [m]."""
        return np.asarray(np.linalg.norm(self.affine[:3, :3], axis=0))

    @property
    def at_edge(self) -> bool:
        """Whether the mask touches a face of the image, which may have cut it."""
        sides = zip(self.start, self.voxels.shape, strict=True)
        return touches_edge([slice(start, start + size) for start, size in sides], self.shape)

    def positions(self, indices: Floats | Ints) -> Floats:
        """Return the positions (k, 3) [m] of indices (k, 3) of the image."""
        return np.asarray(indices @ self.affine[:3, :3].T + self.affine[:3, 3])

    def boundary(self) -> Floats:
        """Return the middles (k, 3) [m] of the voxels that have a neighbour outside, across a face."""
        inner = ndimage.binary_erosion(self.voxels, border_value=0)
        return self.positions(np.argwhere(self.voxels & ~inner) + self.start)

    def contains(self, points: Floats) -> NDArray[np.bool_]:
        """Return the points (k, 3) [m] that lie in a voxel of the mask."""
        back = np.linalg.inv(self.affine)
        indices = np.rint(points @ back[:3, :3].T + back[:3, 3] - self.start)
        inside = np.all((indices >= 0) & (indices < self.voxels.shape), axis=1)
        inside[inside] = self.voxels[tuple(indices[inside].astype(np.int64).T)]
        return inside


def touches_edge(box: Sequence[slice], shape: Sequence[int]) -> bool:
    """Return True if a box ends at a face of an image; an axis of one voxel does not count."""
    return any(size > 1 and (side.start == 0 or side.stop == size) for side, size in zip(box, shape, strict=True))


def in_metres(affine: Floats, metres: float) -> Floats:
    """Return an affine map (4, 4) whose positions were in another unit of length, after `as_grid`."""
    return np.asarray(np.diag([metres, metres, metres, 1.0]) @ as_grid(affine))


def as_grid(affine: Floats) -> Floats:
    """Return an affine map (4, 4) of finite numbers whose voxels have a volume; raise `FileFormatError` for others."""
    axes = affine[:3, :3]
    with np.errstate(all="ignore"):
        edges = np.linalg.norm(axes, axis=0)
        regular = bool((np.abs(affine) <= MAX_COORDINATE).all() and (edges > 0).all())
        regular = regular and abs(np.linalg.det(axes / edges)) > 1e-3
    if not regular:
        raise FileFormatError(
            "the orientation in its header must be finite axes of three directions, got others; write the file again, "
            "such as with 3D Slicer"
        )
    return affine


def choose_segments(labels: LabelMap, part: str | Sequence[str] | None) -> tuple[Segment, ...]:
    """Return the segments of names, numbers or shell-style patterns, in the order of the map.

    Without any, the only segment of the map.
    """
    if part is None:
        if len(labels.segments) == 1:
            return labels.segments
        raise InputError(
            f"part must be given for a label map of {len(labels.segments)} labels, got none; choose one of "
            f"{names_text(part_names(labels))}"
        )
    chosen = set[int]()
    for text in [part] if isinstance(part, str) else part:
        chosen.update(_matches(labels, text))
    if not chosen:
        raise InputError(f"part must name at least one of {names_text(part_names(labels))}, got none")
    return tuple(labels.segments[k] for k in sorted(chosen))


def _matches(labels: LabelMap, text: str) -> list[int]:
    """Return the places of the segments that a name, a number or a pattern means."""
    same = [k for k, each in enumerate(labels.segments) if text in _words(each)]
    if len(same) > 1:
        matches = [labels.segments[k] for k in same]
        numbers = " and ".join(str(each.number) for each in matches)
        if all(each.name == text for each in matches):
            raise InputError(
                f"part must name one label, got {shortened(repr(text))}, which {numbers} have; give a number"
            )
        choices = names_text([part_names(labels)[k] for k in same])
        raise InputError(f"part must name one label, got {shortened(repr(text))}, which is of several: give {choices}")
    places = same or [k for k, each in enumerate(labels.segments) if fnmatchcase(each.name, text)]
    if places:
        return places
    if text in labels.absent:
        raise InputError(f"part must have voxels, got {shortened(repr(text))}, which has none in this file")
    raise InputError(f"part must be one of {names_text(part_names(labels))}, got {shortened(repr(text))}")


def _words(segment: Segment) -> set[str]:
    """Return the words that mean a segment: its name, its number, also after "label", and its number in the file."""
    words = {segment.name, str(segment.number), f"label {segment.number}"}
    return words if segment.label is None else words | {str(segment.label)}


def part_names(labels: LabelMap) -> list[str]:
    """Return what chooses each segment alone: its name, or its number where it has none, or others share it."""
    count = Counter(word for each in labels.segments for word in _words(each))
    chosen = []
    for each in labels.segments:
        number = str(each.number)
        unnamed = each.name in (f"label {number}", f"label {each.label}")
        words = (number, each.name) if unnamed else (each.name, number)
        chosen.append(next((word for word in words if count[word] == 1), f"label {number}"))
    return chosen


def mask_of(labels: LabelMap, part: str | Sequence[str] | None = None) -> Mask:
    """Return the union of the voxels of segments, with all pieces, as they are in the file.

    `part` has names, numbers or shell-style patterns; by default the only segment.
    """
    return segments_mask(labels, choose_segments(labels, part))


def segments_mask(labels: LabelMap, chosen: Sequence[Segment]) -> Mask:
    """Return the union of the voxels of given segments of a map."""
    boxes = [labels.boxes[labels.segments.index(each)] for each in chosen]
    start = np.array([[side.start for side in box] for box in boxes]).min(axis=0)
    stop = np.array([[side.stop for side in box] for box in boxes]).max(axis=0)
    voxels = np.zeros(stop - start, dtype=bool, order="F")
    for segment, box in zip(chosen, boxes, strict=True):
        inner = tuple(slice(s.start - a, s.stop - a) for s, a in zip(box, start, strict=True))
        voxels[inner] |= labels.layers[segment.layer][box] == segment.value
    name = PurePath(labels.name).name
    title = name if len(labels.segments) == 1 else f"{name}, part {names_text([each.name for each in chosen], 3)}"
    return Mask(title, voxels, start, labels.shape, labels.affine, labels.space)
