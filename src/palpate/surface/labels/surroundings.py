"""What a label map has around a body, for display: its other labels, and where the edge of the image cuts the body."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import scipy.ndimage as ndimage
from numpy.typing import NDArray

from palpate.core.arrays import Floats, Ints
from palpate.surface.isosurface import zero_surface
from palpate.surface.labels.label_map import LabelMap, Mask, Segment, choose_segments
from palpate.surface.labels.mask_surface import PIECE_PATTERN, chosen_mask
from palpate.surface.labels.neighbours import cut_faces
from palpate.surface.surface import Surface

MAX_SURROUNDING_TRIANGLES = 60_000  # of all surfaces
AIMED_SHARE = 0.8  # of the triangles; long labels have more than others of their volume
TRIANGLES_PER_SQUARE = 20.0  # over the square of the steps along the cube root of a label's volume
REACH_SHARE = 0.5  # distance between the boxes of a label and of the body, over the diagonal of the latter
MAX_SHAPES = 120  # the nearest
MAX_STEPS_OF_BODY = 90  # along the diagonal of the body's box
STEP_GROWTH = 1.1  # of a trial with too many triangles
BLOCKS_PER_STEP = 1.5  # blocks of voxels, over which their mean is taken
GAUSSIAN_WIDTH = 0.8  # standard deviation of the Gaussian over a step, or over the largest edge of a voxel
GAUSSIAN_REACH = 2.5  # of the Gaussian, in standard deviations
LEVEL_RANGE = (0.1, 0.5)  # of the isosurface
MIN_VOXELS = 8


class Surroundings(NamedTuple):
    """Surfaces around a body, and planes at which the edge of the image cuts the body off, both in its frame."""

    shapes: tuple[Surface, ...]
    edges: Floats  # (k, 2, 3) array: a point [m] and the unit normal inwards


NO_SURROUNDINGS = Surroundings((), np.zeros((0, 2, 3)))


def surroundings_in(labels: LabelMap, part: str | Sequence[str] | None) -> Surroundings:
    """Return what is around a body of some labels."""
    return Surroundings(surrounding_surfaces(labels, part), _edges_of(chosen_mask(labels, part)))


def _edges_of(mask: Mask) -> Floats:
    """Return the planes (k, 2, 3) at which the edge of its image cuts a mask: a point [m] and the normal inwards."""
    planes = []
    for face in cut_faces(mask):
        voxel = np.abs(face.normal @ mask.affine[:3, :3]).max()  # along the normal
        planes.append((face.point - 0.5 * voxel * face.normal, face.normal))
    return np.reshape(planes, (-1, 2, 3))


def surrounding_surfaces(
    labels: LabelMap, part: str | Sequence[str] | None, most: int = MAX_SURROUNDING_TRIANGLES
) -> tuple[Surface, ...]:
    """Return closed surfaces of the labels near a body, in its frame and unit, the nearest first.

    Labels count by the distance of their boxes from that of the body, whose own labels `part` are left out. Each has
    triangles in proportion to the square root of its length, `most` in all, and its name.
    """
    parts = [part] if isinstance(part, str) else list(part or ())
    names = {each.name for each in labels.segments}
    wholes = [text if text in names else PIECE_PATTERN.sub(r"\1", text) for text in parts]
    chosen = choose_segments(labels, wholes or None)
    low, high = _bounds(labels, chosen)
    diagonal = float(np.linalg.norm(high - low))
    near = list[tuple[float, int, Segment]]()
    for segment in labels.segments:
        if segment not in chosen and segment.count >= MIN_VOXELS:
            first, last = _bounds(labels, [segment])
            apart = float(np.linalg.norm(np.maximum(0.0, np.maximum(first - high, low - last))))
            if apart <= REACH_SHARE * diagonal:
                near.append((apart, -segment.count, segment))
    segments = [segment for *_, segment in sorted(near, key=lambda each: each[:2])][:MAX_SHAPES]
    if not segments:
        return ()
    lengths = np.cbrt([segment.count * labels.voxel_volume for segment in segments])
    weights = np.sqrt(lengths)
    shares = AIMED_SHARE * most * weights / weights.sum()
    steps = np.maximum(lengths * np.sqrt(TRIANGLES_PER_SQUARE / shares), diagonal / MAX_STEPS_OF_BODY)
    surfaces = [_surface(labels, each, step) for each, step in zip(segments, steps, strict=True)]
    total = sum(len(each.triangles) for each in surfaces)
    if total > most:
        steps *= STEP_GROWTH * float(np.sqrt(total / most))
        surfaces = [_surface(labels, each, step) for each, step in zip(segments, steps, strict=True)]
    around, count = list[Surface](), 0
    for surface in surfaces:
        if count + len(surface.triangles) <= most:
            around.append(surface)
            count += len(surface.triangles)
    return tuple(around)


def _bounds(labels: LabelMap, segments: Sequence[Segment]) -> tuple[Floats, Floats]:
    """Return the ends (3,), (3,) [m] of the box of segments, along the axes of the body's frame."""
    boxes = [labels.boxes[labels.segments.index(each)] for each in segments]
    ends = np.array([[[side.start - 0.5, side.stop - 0.5] for side in box] for box in boxes])
    low, high = ends[:, :, 0].min(axis=0), ends[:, :, 1].max(axis=0)
    corners = np.array(np.meshgrid(*zip(low, high, strict=True))).reshape(3, -1).T
    positions = corners @ labels.affine[:3, :3].T + labels.affine[:3, 3]
    return positions.min(axis=0), positions.max(axis=0)


def _surface(labels: LabelMap, segment: Segment, step: float) -> Surface:
    """Return the surface of a segment with about a step [m] between its vertices."""
    box = labels.boxes[labels.segments.index(segment)]
    edges = labels.voxel_edges
    step = max(step, float(edges.min()))
    blocks = np.maximum(1, (step / (BLOCKS_PER_STEP * edges)).astype(int))
    widths = GAUSSIAN_WIDTH * max(step, float(edges.max())) / (edges * blocks)
    pads = np.ceil(GAUSSIAN_REACH * widths + step / (edges * blocks)).astype(int) + 1
    field = _block_means(labels.layers[segment.layer][box] == segment.value, blocks)
    field = np.pad(field, [(pad, pad) for pad in pads])
    field = ndimage.gaussian_filter(field, widths, mode="constant", truncate=GAUSSIAN_REACH)
    ratio = step / (edges * blocks)  # steps of the grid in blocks
    sizes = tuple((np.ceil((np.array(field.shape) - 1) / ratio) + 1).astype(int))
    grid = ndimage.affine_transform(field, ratio, output_shape=sizes, order=1, mode="constant")
    vertices, triangles = _isosurface(grid, segment.count * labels.voxel_volume / step**3)
    start = np.array([side.start for side in box])
    indices = start + blocks * (vertices * ratio - pads) + 0.5 * (blocks - 1)
    if np.linalg.det(labels.affine[:3, :3]) < 0:
        triangles = triangles[:, ::-1]
    positions = indices @ labels.affine[:3, :3].T + labels.affine[:3, 3]
    return Surface(positions, triangles, segment.name, space=labels.space)


def _block_means(voxels: NDArray[np.bool_], blocks: Ints) -> Floats:
    """Return the shares of blocks of voxels that are true; voxels beyond the end are false."""
    for axis, size in enumerate(blocks):
        if size > 1:
            ends = [(0, 0)] * 3
            ends[axis] = (0, -voxels.shape[axis] % size)
            padded = np.pad(voxels, ends)
            shape = (*padded.shape[:axis], -1, size, *padded.shape[axis + 1 :])
            voxels = padded.reshape(shape).mean(axis=axis + 1, dtype=np.float32)
    return voxels.astype(np.float32, copy=False)


def _isosurface(grid: Floats, cells: float) -> tuple[Floats, Ints]:
    """Return the isosurface of a field that encloses about a number of cells, in steps of its grid."""
    rank = min(max(round(cells), 1), grid.size)
    level = float(np.clip(np.partition(grid.ravel(), -rank)[-rank], *LEVEL_RANGE))
    return zero_surface(grid - np.float32(level), (0.0, 0.0, 0.0), 1.0)
