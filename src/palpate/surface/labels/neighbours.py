"""What lies in an organ of a label map, and what touches it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import scipy.ndimage as ndimage
from scipy.spatial import cKDTree

from palpate.arrays import Floats
from palpate.surface.labels.label_map import LabelMap, Mask, Segment, segments_mask

MIN_ENCLOSED_SHARE = 0.6  # of the voxels round a segment, which belong to the organ in which it lies
CONTACT_EDGES = 1.5  # largest voxel edges between the boundary voxels of segments that touch
CONTACT_SPACINGS = 0.5  # or as many spacings, if that is more


class TouchingSegment(NamedTuple):
    """A segment that touches an organ, and the share of the organ's surface that it touches."""

    segment: Segment
    share: float


class CutFace(NamedTuple):
    """A flat face of an organ at the edge of the image: a point [m], the unit normal inwards, share of the surface."""

    point: Floats
    normal: Floats
    share: float


def contact_distance(voxel_edges: Floats, spacing: float) -> float:
    """Return the distance [m] up to which boundary voxels of two segments touch."""
    return float(max(CONTACT_SPACINGS * spacing, CONTACT_EDGES * np.max(voxel_edges)))


def enclosed_segments(labels: LabelMap, organ: Mask) -> list[Segment]:
    """Return the segments that lie in an organ: most of the voxels around them are its voxels."""
    enclosed = []
    for segment, box in zip(labels.segments, labels.boxes, strict=True):
        grown = tuple(slice(max(0, each.start - 1), each.stop + 1) for each in box)
        if not _meet(organ, grown):
            continue
        voxels = labels.layers[segment.layer][grown] == segment.value
        around = ndimage.binary_dilation(voxels) & ~voxels
        if not around.any():
            continue
        inside = _window(organ, grown)
        if (voxels & inside).sum() < voxels.sum() and (around & inside).sum() >= MIN_ENCLOSED_SHARE * around.sum():
            enclosed.append(segment)
    return enclosed


def touching_segments(
    labels: LabelMap, organ: Mask, distance: float, without: tuple[Segment, ...] = ()
) -> list[TouchingSegment]:
    """Return the segments within a distance [m] of an organ's surface, those that touch most of it first.

    Parameters
    ----------
    without : tuple of Segment
        Segments of the organ, and in it.
    """
    surface = organ.boundary()
    low, high = surface.min(axis=0) - distance, surface.max(axis=0) + distance
    contacts = []
    for segment in labels.segments:
        if segment in without:
            continue
        other = segments_mask(labels, [segment]).boundary()
        other = other[np.all((other >= low) & (other <= high), axis=1)]
        if len(other):
            near = np.isfinite(cKDTree(other).query(surface, distance_upper_bound=distance * (1 + 1e-9))[0])
            if near.any():
                contacts.append(TouchingSegment(segment, float(near.mean())))
    return sorted(contacts, key=lambda each: -each.share)


def cut_faces(organ: Mask) -> list[CutFace]:
    """Return the faces at which the edge of the image may have cut an organ; none along an axis of one voxel."""
    faces, surface = [], len(organ.boundary())
    for axis in range(3):
        for last in (False, True):
            index = organ.voxels.shape[axis] - 1 if last else 0
            at_edge = organ.start[axis] + index == (organ.shape[axis] - 1 if last else 0)
            if organ.shape[axis] == 1 or not at_edge:
                continue
            places = np.argwhere(np.take(organ.voxels, [index], axis))
            places[:, axis] = index
            others = np.delete(organ.affine[:3, :3], axis, axis=1)
            normal = np.cross(others[:, 0], others[:, 1])
            inward = (-1.0 if last else 1.0) * organ.affine[:3, axis]
            normal *= np.sign(normal @ inward) / np.linalg.norm(normal)
            point = organ.positions(places + organ.start).mean(axis=0)
            faces.append(CutFace(point, normal, len(places) / surface))
    return sorted(faces, key=lambda face: -face.share)


def _meet(organ: Mask, box: tuple[slice, ...]) -> bool:
    ends = zip(organ.start, organ.start + organ.voxels.shape, box, strict=True)
    return all(a < side.stop and side.start < b for a, b, side in ends)


def _window(organ: Mask, box: tuple[slice, ...]) -> np.ndarray:
    """Return the voxels of an organ in a box of the image, which may reach beyond them."""
    window = np.zeros([min(side.stop, size) - side.start for side, size in zip(box, organ.shape, strict=True)], bool)
    start = np.array([side.start for side in box])
    low, high = np.maximum(start, organ.start), np.minimum(start + window.shape, organ.start + organ.voxels.shape)
    into = tuple(slice(a, b) for a, b in zip(low - start, high - start, strict=True))
    window[into] = organ.voxels[tuple(slice(a, b) for a, b in zip(low - organ.start, high - organ.start, strict=True))]
    return window
