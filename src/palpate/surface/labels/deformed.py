"""Label maps of a deformed body: each voxel has the label of the point of the tissue that lies there.

The displacement at a place x of the deformed body is that of a linear function, fitted to the nodes near x by weighted
least squares. The place at rest is x minus it. Homogeneous deformations are exact; a body at rest gives the same map.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.ndimage as ndimage
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from palpate.core.arrays import Floats, Singles
from palpate.core.faults import InputError
from palpate.surface.labels.label_map import LabelMap, Segment
from palpate.surface.nesting import inside_points

FITTED_NODES = 24  # near a place, whose displacements a linear function fits
REACH_SPACINGS = 2.0  # of the nodes' displacements beyond the body, in spacings
STEPS_PER_SPACING = 4  # of the lattice on which displacements are fitted, then interpolated to the voxels
FITTED_AT_ONCE = 20_000  # places
INSIDE_SHARE, INSIDE_SAMPLES = 0.5, 2000  # of a segment's voxels in the body, which has it; voxels that are tried
MIN_CURVATURE = 1e-9  # of the normal equations, over their trace


def body_segments(labels: LabelMap, rest: Floats, triangles: NDArray[np.integer]) -> tuple[Segment, ...]:
    """Return the segments of which a body consists: most of their voxels lie in its surface at rest.

    `rest` (n, 3) [m] are its nodes, of which the triangles (t, 3) of its surface are.
    """
    corners, chosen = rest[triangles], []
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    for segment, box in zip(labels.segments, labels.boxes, strict=True):
        indices = np.argwhere(labels.layers[segment.layer][box] == segment.value) + [side.start for side in box]
        places = _positions(labels.affine, indices[:: len(indices) // INSIDE_SAMPLES + 1])
        near = places[np.all((places >= low) & (places <= high), axis=1)]
        if len(near) and inside_points(near, corners).sum() >= INSIDE_SHARE * len(places):
            chosen.append(segment)
    if not chosen:
        names = ", ".join(each.name for each in labels.segments[:20])
        raise InputError(
            f"labels must be the map of the recorded body, got {labels.name}, none of whose labels lies in it: {names}"
        )
    return tuple(chosen)


def resampling_field(labels: LabelMap, rest: Floats, displacements: Floats, spacing: float) -> tuple[Singles, Singles]:
    """Return the way from each voxel to its place at rest, and the distance of the nearest node of the deformed body.

    `rest` and `displacements` (n, 3) [m] are those of the nodes. The distance is (nx, ny, nz) [m]; the way
    (nx, ny, nz, 3) [m] is zero where no node is within two spacings.
    """
    shape, nodes = labels.shape, rest + displacements
    field = np.zeros((*shape, 3), dtype=np.float32)
    distance = np.full(shape, np.inf, dtype=np.float32)
    back = np.linalg.inv(labels.affine)
    margin = REACH_SPACINGS * spacing * np.linalg.norm(back[:3, :3], axis=1)  # voxels along each axis
    indices = _positions(back, nodes)
    low = np.maximum(np.floor(indices.min(axis=0) - margin), 0).astype(int)
    high = np.minimum(np.ceil(indices.max(axis=0) + margin) + 1, shape).astype(int)
    if (high <= low).any():
        raise InputError(f"labels must be the map of the recorded body, got {labels.name}, whose image is elsewhere")
    step = np.maximum(1, np.floor(spacing / STEPS_PER_SPACING / labels.voxel_edges)).astype(int)
    counts = -(-(high - low - 1) // step) + 1
    lattice = low + step * np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).reshape(-1, 3)
    values = np.empty((len(lattice), 4))
    for part in np.array_split(np.arange(len(lattice)), len(lattice) // FITTED_AT_ONCE + 1):
        values[part] = _fitted(nodes, displacements, spacing, _positions(labels.affine, lattice[part]))
    box = tuple(slice(a, b) for a, b in zip(low, high, strict=True))
    places = np.meshgrid(*(np.arange(b - a) / s for a, b, s in zip(low, high, step, strict=True)), indexing="ij")
    fine = [ndimage.map_coordinates(each.reshape(counts), places, order=1, mode="nearest") for each in values.T]
    distance[box] = fine[3]
    near = fine[3] <= REACH_SPACINGS * spacing
    field[box] = np.stack([np.where(near, -each, 0.0) for each in fine[:3]], axis=-1)
    return field, distance


def deform(
    labels: LabelMap, parts: Sequence[Segment], field: Singles, distance: Singles, spacing: float
) -> list[NDArray[np.uint32]]:
    """Return the numbers (nx, ny, nz) of the segments in the voxels of each layer of the deformed body, 0 outside all.

    `parts` are those of the body; field and distance are as from `resampling_field`. Segments that are not of the body
    stay where segments of the body in the same layer are not.
    """
    near = np.argwhere(distance <= REACH_SPACINGS * spacing)
    sources = _positions(labels.affine, near) + field[tuple(near.T)]
    indices = np.rint(_positions(np.linalg.inv(labels.affine), sources)).astype(int)
    inside = np.all((indices >= 0) & (indices < labels.shape), axis=1)
    near, indices = near[inside], indices[inside]
    layers = [np.zeros(labels.shape, dtype=np.uint32) for _ in labels.layers]
    for segment in sorted(labels.segments, key=lambda each: each in parts):
        layer, numbers = labels.layers[segment.layer], layers[segment.layer]
        if segment in parts:
            in_segment = layer[tuple(indices.T)] == segment.value
            numbers[tuple(near[in_segment].T)] = segment.number
        else:
            numbers[layer == segment.value] = segment.number
    return layers


def _positions(affine: NDArray[Any], indices: NDArray[Any]) -> Floats:
    return np.asarray(indices @ affine[:3, :3].T + affine[:3, 3])


def _fitted(nodes: Floats, displacements: Floats, spacing: float, places: Floats) -> Floats:
    """Return displacements at places (k, 3) of the deformed body, and the distance of the nearest node, as (k, 4)."""
    length, near = cKDTree(nodes).query(places, k=min(FITTED_NODES, len(nodes)))
    weight = np.exp((length[:, :1] ** 2 - length**2) / spacing**2)
    way = (nodes[near] - places[:, None]) / spacing
    basis = np.concatenate([np.ones((*length.shape, 1)), way], axis=2)
    weighted = weight[:, :, None] * basis
    normal = np.einsum("kni,knj->kij", weighted, basis)
    normal += MIN_CURVATURE * np.trace(normal, axis1=1, axis2=2)[:, None, None] * np.eye(4)
    moment = np.einsum("kni,knj->kij", weighted, displacements[near])
    return np.column_stack([np.linalg.solve(normal, moment)[:, 0], length[:, 0]])
