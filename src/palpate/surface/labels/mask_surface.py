"""Closed surface of a mask of voxels, with their volume.

The mask is averaged over blocks of voxels finer than a step, interpolated between coarser ones, and smoothed by a
Gaussian. The level of the isosurface is that whose volume is that of the voxels. Fields of voxels that touch along an
edge or in a corner are so kept apart, where surface nets branch.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import scipy.ndimage as ndimage
from numpy.typing import NDArray

from palpate.core.arrays import Floats, Ints
from palpate.core.faults import InputError
from palpate.core.files import shortened
from palpate.surface.isosurface import zero_surface
from palpate.surface.labels.label_map import LabelMap, Mask, mask_of
from palpate.surface.labels.voxels import counts_of_values, equal_share
from palpate.surface.surface import Surface, part_volumes, select_triangles, vertex_components

MAX_POINTS = 1 << 20  # of the grid
STEPS_ACROSS = 32  # steps of the grid along the cube root of the volume, at least
GAUSSIAN_WIDTH = 0.7  # standard deviation of the Gaussian over the largest edge of a voxel
GAUSSIAN_REACH = 3.5  # of the Gaussian, in standard deviations
BLOCK_SLACK = 0.25  # of a voxel, by which a block may exceed a step
COARSE_EDGE = 1.5  # steps of the grid, from which an edge is divided
VOLUME_ERROR, MAX_SECANTS = 2e-4, 8
MIN_VALUE = 1e-4  # distance of the field from the level: triangles have an area
SPECK_SHARE = 0.01  # of the volume: smaller pieces and cavities of the smoothed field are left out
MIN_VOXELS, FEW_VOXELS = 30, 200  # of a body; below the second one the surface is coarse
MIN_SHARE = 0.9  # of the voxels in the largest piece, which is taken without a choice
MANY_PIECES = 100  # of a label, which may be a texture: less than half of its voxels then have neighbours in it
MIN_EQUAL_SHARE = 0.5
LISTED_PIECES = 4
EDGE_RANGE = (1e-6, 0.1)  # [m] of a voxel
PIECE_PATTERN = re.compile(r"(.+)#(\d{1,6})", re.DOTALL)


def label_surface(labels: LabelMap, part: str | Sequence[str] | None = None) -> Surface:
    """Return the closed surface of one or several labels, as one body, with the volume of its voxels.

    `part` has names, numbers or patterns of labels, whose voxels are united; by default the only label. ``"liver#2"``
    is the second largest piece. A label in several pieces of which none is plainly the organ is refused. The surface
    has warnings about what was left out.
    """
    edges = labels.voxel_edges
    if edges.max() > EDGE_RANGE[1] or edges.min() < EDGE_RANGE[0]:
        factor = 1e-3 if edges.max() > EDGE_RANGE[1] else 1e3
        raise InputError(
            f"voxels of {labels.name} must have edges of 0.001 to 100 mm, got {_times(1e3 * edges)} mm; give "
            f"scale={factor:g} if its header has a wrong unit"
        )
    return mask_surface(chosen_mask(labels, part))


def chosen_mask(labels: LabelMap, part: str | Sequence[str] | None = None) -> Mask:
    """Return the mask of the piece of which `label_surface` returns the surface."""
    part, piece = _split_piece(labels, part)
    return largest_piece(mask_of(labels, part), piece)


def _split_piece(labels: LabelMap, part: str | Sequence[str] | None) -> tuple[str | Sequence[str] | None, int]:
    """Return the parts without the number of a piece, and that number; 0 where none is given."""
    parts = [part] if isinstance(part, str) else list(part or ())
    for text in parts:
        if is_piece(labels, text):
            if len(parts) > 1:
                raise InputError(f"part must be one label where a piece is chosen, got {len(parts)} of them; give one")
            label, _, number = text.rpartition("#")
            return label, int(number)
    return part, 0


def is_piece(labels: LabelMap, text: str) -> bool:
    """Return True for a text that chooses a piece of a label, such as ``"liver#2"``."""
    return PIECE_PATTERN.fullmatch(text) is not None and all(each.name != text for each in labels.segments)


def piece_sizes(mask: Mask) -> Ints:
    """Return the numbers of voxels of the pieces of a mask, the largest first; pieces touch across faces."""
    return np.asarray(-np.sort(-_pieces(mask.voxels)[1]))


def _pieces(voxels: NDArray[np.bool_]) -> tuple[NDArray[np.int32], Ints]:
    """Return the number of the piece of each voxel, from 1, and the sizes of the pieces."""
    number = ndimage.label(voxels.T)[0].T  # the first axis is the fastest
    return number, counts_of_values(number)[1:]


def largest_piece(mask: Mask, number: int = 0) -> Mask:
    """Return the largest piece of a mask with its small cavities filled, cropped to it.

    `number` is that of a piece by size, from 1; 0 is the largest, if it plainly is the organ, with at least 90 % of the
    voxels. A texture, and a piece of too few voxels, are refused.
    """
    label, sizes = _pieces(mask.voxels)
    order = np.argsort(-sizes, kind="stable")
    if number > len(sizes):
        raise InputError(f"part must be one of {len(sizes)} pieces of {mask.name}, got {number}; give a smaller one")
    if number == 0:
        _check_pieces(mask, sizes[order])
    chosen = order[max(number, 1) - 1]
    size = int(sizes[chosen])
    if size < MIN_VOXELS:
        raise InputError(f"{mask.name} must have at least {MIN_VOXELS} voxels in one piece, got {size}; choose another")
    box = ndimage.find_objects(label.T)[chosen][::-1]
    voxels = label[box] == chosen + 1
    warnings = list(mask.warnings)
    if len(sizes) > 1:
        left = 1.0 - size / sizes.sum()
        which = f"piece {number}" if number else "the largest"
        warnings.append(
            f"{mask.name} has {len(sizes)} pieces: {which} chosen, {100 * left:.2g} % of its volume left out"
        )
    voxels, filled = _without_pores(voxels)
    if filled:
        warnings.append(f"{mask.name}: small cavities of {filled} voxel{'s' * (filled > 1)} in all filled")
    start = mask.start + [side.start for side in box]
    piece = replace(mask, voxels=voxels, start=start, warnings=())
    if piece.at_edge:
        warnings.append(f"{mask.name} touches the edge of the image, which may have cut it: its face there is flat")
    if size < FEW_VOXELS:
        warnings.append(f"{mask.name} has {size} voxels only: its surface is coarse")
    return replace(piece, warnings=tuple(warnings))


def _check_pieces(mask: Mask, sizes: Ints) -> None:
    """Raise `InputError` unless the first of pieces plainly is the organ."""
    share = sizes[0] / sizes.sum()
    if share >= MIN_SHARE and (len(sizes) <= MANY_PIECES or equal_share(mask.voxels) >= MIN_EQUAL_SHARE):
        return
    part = mask.name.partition(", part ")[2] or "1"
    voxel = mask.volume / sizes.sum()
    listed = ", ".join(f"{k + 1} of {1e6 * each * voxel:.3g} ml" for k, each in enumerate(sizes[:LISTED_PIECES]))
    raise InputError(
        f"part must be one piece, got {shortened(mask.name)} of {len(sizes)} pieces, the largest with {share:.0%} of "
        f"the voxels: {listed}{', ...' * (len(sizes) > LISTED_PIECES)}; choose one, such as "
        f"part='{shortened(part)}#1', or other labels"
    )


def _without_pores(voxels: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], int]:
    """Return a piece without small cavities, and how many voxels these have."""
    number, count = ndimage.label(np.pad(~voxels, 1, constant_values=True).T)
    number, filled = number.T, voxels.copy(order="K")
    size = int(np.count_nonzero(voxels))
    for k, box in enumerate(ndimage.find_objects(number.T)[1:] if count > 1 else [], 2):  # the first is around it
        cavity = number[box[::-1]] == k
        if is_pore(cavity, size):
            inner = tuple(slice(side.start - 1, side.stop - 1) for side in box[::-1])
            filled[inner] |= cavity
    return filled, int(np.count_nonzero(filled)) - size


def is_pore(cavity: NDArray[np.bool_], size: int) -> bool:
    """Return True for a closed cavity that is filled in a piece of so many voxels.

    It has less than 1 % of them, or is one or two voxels thick everywhere.
    """
    return bool(np.count_nonzero(cavity) < SPECK_SHARE * size or not ndimage.binary_erosion(cavity).any())


def mask_surface(mask: Mask) -> Surface:
    """Return the closed surface of a mask of one piece, in metres, whose volume is that of its voxels.

    The mask is as of `largest_piece`.
    """
    field, origin, scale = _smooth_field(mask)
    target = np.count_nonzero(mask.voxels) / float(np.prod(scale))  # in cells of the grid
    flat = field.ravel()
    level = float(np.partition(flat, -round(target))[-round(target)])
    vertices, triangles = _surface_of_volume(field, level, target)
    indices = vertices * scale + origin
    if np.linalg.det(mask.affine[:3, :3]) < 0:
        triangles = triangles[:, ::-1]
    return Surface(mask.positions(indices), triangles, mask.name, warnings=mask.warnings, unit=1e-3, space=mask.space)


def _smooth_field(mask: Mask) -> tuple[Floats, Floats, Floats]:
    """Return the smoothed share of the mask on a grid, the index of its first point, and its steps in voxels."""
    edges = mask.voxel_edges
    sigma = GAUSSIAN_WIDTH * float(edges.max())
    blocks, parts, pads = _grid_of(mask, sigma)
    field: Any = mask.voxels
    for axis in range(3):
        field = np.pad(field, _ends(axis, 0, -field.shape[axis] % blocks[axis]))
        shape = (*field.shape[:axis], -1, int(blocks[axis]), *field.shape[axis + 1 :])
        field = field.reshape(shape).mean(axis=axis + 1, dtype=np.float32)
    for axis in range(3):
        field = _divided(np.pad(field, _ends(axis, pads[axis], pads[axis])), axis, int(parts[axis]))
    scale = blocks / parts
    field = ndimage.gaussian_filter(field, sigma / (edges * scale), mode="constant", truncate=GAUSSIAN_REACH)
    return field, mask.start + 0.5 * (blocks - 1) - pads * blocks, scale


def _grid_of(mask: Mask, sigma: float) -> tuple[Ints, Ints, Ints]:
    """Return the voxels in a block, the steps in a block and the blocks around the mask, along each axis.

    Steps grow until the grid has a bounded number of points.
    """
    edges, sizes = mask.voxel_edges, np.array(mask.voxels.shape)
    step = max(float(edges.min()), float(np.cbrt(mask.volume)) / STEPS_ACROSS)
    while True:
        blocks = np.maximum(1, (step / edges + BLOCK_SLACK).astype(np.int64))
        coarse = blocks * edges > COARSE_EDGE * step
        parts = np.where(coarse, np.rint(blocks * edges / step), 1).astype(np.int64)
        pads = np.ceil(GAUSSIAN_REACH * sigma / (edges * blocks)).astype(np.int64) + 1
        if np.prod((-(-sizes // blocks) + 2.0 * pads) * parts) <= MAX_POINTS:
            return blocks, parts, pads
        step *= 1.25


def _ends(axis: int, before: int, after: int) -> list[tuple[int, int]]:
    """Return how many zeros `numpy.pad` adds at the ends of one axis of three."""
    return [(int(before), int(after)) if a == axis else (0, 0) for a in range(3)]


def _divided(field: Floats, axis: int, parts: int) -> Floats:
    """Return a field interpolated linearly along an axis, with so many steps in place of one."""
    if parts == 1:
        return field
    at = np.arange((field.shape[axis] - 1) * parts + 1) / parts
    low = np.minimum(at.astype(np.int64), field.shape[axis] - 2)
    share = np.expand_dims((at - low).astype(np.float32), tuple(a for a in range(3) if a != axis))
    return (1 - share) * np.take(field, low, axis) + share * np.take(field, low + 1, axis)


def _surface_of_volume(field: Floats, level: float, target: float) -> tuple[Floats, Ints]:
    """Return the isosurface of a field with a volume, in steps of its grid, by the secant method from a level."""
    mesh = _main_surface(field, level)
    before, change = level, 0.05 * level
    error = _volume(*mesh) / target - 1
    for _ in range(MAX_SECANTS):
        if abs(error) <= VOLUME_ERROR:
            break
        level, last = before + change, error
        mesh = _main_surface(field, level)
        error = _volume(*mesh) / target - 1
        slope = (error - last) / change
        before, change = level, -error / slope if slope else -change / 2
        change = float(np.clip(change, -0.5 * level, 0.5 * (1.0 - level)))
    return mesh


def _main_surface(field: Floats, level: float) -> tuple[Floats, Ints]:
    """Return the surface of a field at a level without specks."""
    values = field - np.float32(level)
    near = np.abs(values) < MIN_VALUE
    values[near] = np.where(values[near] >= 0, MIN_VALUE, -MIN_VALUE)
    vertices, triangles = zero_surface(values, (0.0, 0.0, 0.0), 1.0)
    surface = Surface(vertices, triangles)
    part = vertex_components(triangles, len(vertices))[triangles[:, 0]]
    if part.max() > 0:
        part = np.unique(part, return_inverse=True)[1]
        volumes = np.abs(part_volumes(surface, part))
        surface = select_triangles(surface, (volumes >= SPECK_SHARE * volumes.max())[part])
    return surface.vertices, surface.triangles


def _volume(vertices: Floats, triangles: Ints) -> float:
    return Surface(vertices, triangles).volume


def _times(lengths: Floats) -> str:
    return " x ".join(f"{each:.3g}" for each in lengths)
