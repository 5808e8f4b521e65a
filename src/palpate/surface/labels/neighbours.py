"""What touches an organ of a label map."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from scipy.spatial import cKDTree

from palpate.core.arrays import Floats
from palpate.surface.labels.label_map import LabelMap, Mask, Segment, segments_mask

CONTACT_EDGES = 1.5  # largest voxel edges between the boundary voxels of segments that touch
CONTACT_SPACINGS = 0.5  # or as many spacings, if that is more


class TouchingSegment(NamedTuple):
    """A segment that touches an organ, and the share of the organ's surface that it touches."""

    segment: Segment
    share: float


class CutFace(NamedTuple):
    """A flat face of an organ at the edge of the image: a point [m], the unit normal inwards, share of the surface.

    The point is the middle of its voxels, half a voxel inside of the edge.
    """

    point: Floats
    normal: Floats
    share: float


def contact_distance(voxel_edges: Floats, spacing: float) -> float:
    """Return the distance [m] up to which boundary voxels of two segments touch."""
    return float(max(CONTACT_SPACINGS * spacing, CONTACT_EDGES * np.max(voxel_edges)))


def touching_segments(
    labels: LabelMap, organ: Mask, distance: float, without: tuple[Segment, ...] = ()
) -> list[TouchingSegment]:
    """Return the segments within a distance [m] of an organ's surface, those that touch most of it first.

    `without` are segments of the organ, and in it.
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
