"""Consistency correction: least changes of the weights of cut nodes for which sums over the body remain.

A uniform stress along the faces of a cut must move no node. So the weights change as little as possible, in the norm
of g^2 / f with f = exp(-|X_IJ|^2 / 4 h^2), for the part along the cut of the sum over I of V_I g_IJ to keep its uncut
value, and for linear fields to remain exact. This is variationally consistent integration (Chen, Hillman and Rueter,
Int. J. Numer. Methods Eng. 95, 2013) without the component that a free face changes. The smoothing changes as little
as possible for the integrals of smoothed fields to remain.

Sums that no small change keeps, as in a slice between two cuts, are kept only in part: their multipliers are
regularized.
"""

from __future__ import annotations

import numpy as np

from palpate.compiled.code_cache import cached_njit
from palpate.core.arrays import Floats, Ints
from palpate.meshfree.cut.stencils import FittedRows
from palpate.meshfree.cut.surface import CutSurface, nearest_normals
from palpate.meshfree.cut.uncut import UncutStencils

MAX_ITERATIONS, RESIDUAL_TOLERANCE = 400, 1e-11  # of the iterations for the changes; relative to V / h
WINDOW_ITERATIONS, SLOWEST_DECREASE = 40, 0.5  # iterations after which the residual must have decreased by a factor
MIN_PROGRESS, MIN_SCALE = 1e-13, 1e-3
MAX_CHANGE = 1.5  # size q of a change above which the sums of its nodes need not be kept; 1 where they can be kept
REGULARIZATION_SHARES = (0.01, 0.1, 1.0)  # of the multipliers of such sums, relative to their diagonal, in attempts


def _local_numbers(rows: FittedRows, n: int) -> tuple[Ints, Ints, Ints]:
    """Return the nodes (l,) that rows contain, and the local numbers of the rows' nodes and of the neighbours."""
    used = np.zeros(n, dtype=np.bool_)
    used[rows.near[rows.freedom > 0.0]] = True
    used[rows.nodes] = True
    number = np.cumsum(used) - 1
    return np.flatnonzero(used), number[rows.nodes], number[rows.near]


def keep_uniform_stress(uncut: UncutStencils, surface: CutSurface, rows: FittedRows, missing: Floats) -> float:
    """Change weights of first derivatives in place, for uniform stress along a cut to move no node.

    `missing` (n, 3) [m^2] is by how much the sums of V_I g_IJ must change, at the nodes that the rows contain. Returns
    what remains of it along the cut, over h^2.
    """
    nodes, center, other = _local_numbers(rows, len(uncut.points))
    normals = np.zeros((len(nodes), 3))
    nearest_normals(uncut.points[nodes], surface.triangles, normals)
    volume = float(np.median(uncut.volumes))
    right = missing[nodes] * (uncut.spacing / volume)
    free = rows.freedom > 0.0
    start, first = np.concatenate([[0], np.cumsum(free)])[rows.start], rows.first[free]
    left = _balance(
        uncut.points, rows.nodes, start, rows.near[free], rows.freedom[free], uncut.volumes / volume, center,
        other[free], normals, right, uncut.spacing, uncut.limit, first,
    )  # fmt: skip
    rows.first[free] = first
    return float(left)


@cached_njit(nogil=True)
def _across(normals, field):
    """Remove the components of vectors (l, 3) along unit normals."""
    for k in range(field.shape[0]):
        along = field[k, 0] * normals[k, 0] + field[k, 1] * normals[k, 1] + field[k, 2] * normals[k, 2]
        for c in range(3):
            field[k, c] -= along * normals[k, c]


@cached_njit(nogil=True)
def _change(m, start, freedom, size, center, other, offset, inverse, field, block):
    """Write the changes (k, 3) of the weights of row m for multipliers (l, 3) into `block`."""
    begin, i = start[m], center[m]
    fx, fy, fz = field[i, 0], field[i, 1], field[i, 2]
    xx, xy, xz, yx, yy, yz, zx, zy, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0  # sums of the changes times x'
    for p in range(begin, start[m + 1]):
        j, k, share = other[p], p - begin, freedom[p] * size
        ox, oy, oz = offset[p, 0], offset[p, 1], offset[p, 2]
        x, y, z = share * (field[j, 0] - fx), share * (field[j, 1] - fy), share * (field[j, 2] - fz)
        block[k, 0], block[k, 1], block[k, 2] = x, y, z
        xx, xy, xz = xx + x * ox, xy + x * oy, xz + x * oz
        yx, yy, yz = yx + y * ox, yy + y * oy, yz + y * oz
        zx, zy, zz = zx + z * ox, zy + z * oy, zz + z * oz
    ax, ay, az = _times(inverse, m, xx, xy, xz)
    bx, by, bz = _times(inverse, m, yx, yy, yz)
    cx, cy, cz = _times(inverse, m, zx, zy, zz)
    for p in range(begin, start[m + 1]):
        k, share, ox, oy, oz = p - begin, freedom[p], offset[p, 0], offset[p, 1], offset[p, 2]
        block[k, 0] -= share * (ax * ox + ay * oy + az * oz)
        block[k, 1] -= share * (bx * ox + by * oy + bz * oz)
        block[k, 2] -= share * (cx * ox + cy * oy + cz * oz)


@cached_njit(nogil=True)
def _times(inverse, m, x, y, z):
    """Return a vector times the inverse matrix of row m."""
    return (
        x * inverse[m, 0, 0] + y * inverse[m, 1, 0] + z * inverse[m, 2, 0],
        x * inverse[m, 0, 1] + y * inverse[m, 1, 1] + z * inverse[m, 2, 1],
        x * inverse[m, 0, 2] + y * inverse[m, 1, 2] + z * inverse[m, 2, 2],
    )


@cached_njit(nogil=True)
def _apply(rows, field, image, block):
    """Write the changes of the sums (l, 3) that multipliers (l, 3) cause."""
    start, freedom, sizes, center, other, offset, inverse = rows
    image[:] = 0.0
    for m in range(center.shape[0]):
        i, size = center[m], sizes[m]
        _change(m, start, freedom, size, center, other, offset, inverse, field, block)
        x, y, z = image[i, 0], image[i, 1], image[i, 2]
        for p in range(start[m], start[m + 1]):
            j, k = other[p], p - start[m]
            dx, dy, dz = size * block[k, 0], size * block[k, 1], size * block[k, 2]
            image[j, 0] += dx
            image[j, 1] += dy
            image[j, 2] += dz
            x, y, z = x - dx, y - dy, z - dz
        image[i, 0], image[i, 1], image[i, 2] = x, y, z


@cached_njit(nogil=True)
def _apply_scaled(rows, normals, scale, regularization, field, image, block):
    """Write the changes of the scaled sums across the normals that scaled multipliers cause, regularized."""
    for k in range(field.shape[0]):
        for c in range(3):
            field[k, c] *= scale[k]
    _apply(rows, field, image, block)
    _across(normals, image)
    for k in range(field.shape[0]):
        for c in range(3):
            field[k, c] /= scale[k]
            image[k, c] = scale[k] * image[k, c] + regularization[k] * field[k, c]


@cached_njit(nogil=True)
def _inverse_moments(start, freedom, offset, inverse):
    """Write the inverse of sum of f x x' of every row; zero for a row without bonds."""
    for m in range(start.shape[0] - 1):
        moment = np.zeros((3, 3))
        for p in range(start[m], start[m + 1]):
            for a in range(3):
                for b in range(3):
                    moment[a, b] += freedom[p] * offset[p, a] * offset[p, b]
        if moment[0, 0] + moment[1, 1] + moment[2, 2] > 0.0:
            inverse[m] = np.linalg.inv(moment)


@cached_njit(nogil=True)
def _balance(points, nodes, start, near, freedom, volumes, center, other, normals, right, spacing, limit, first):
    """Solve for the least change, and add it to `first`; return the largest residual.

    The method of conjugate residuals has the least residual after every iteration. A piece that is cut off has nodal
    volumes that need not fit the uncut sums at its faces; then a residual remains.
    """
    offset, inverse = np.zeros((near.shape[0], 3)), np.zeros((nodes.shape[0], 3, 3))
    sizes, longest = np.empty(nodes.shape[0]), 0
    for m in range(nodes.shape[0]):
        sizes[m] = volumes[nodes[m]]
        longest = max(longest, start[m + 1] - start[m])
        for p in range(start[m], start[m + 1]):
            for a in range(3):
                offset[p, a] = (points[near[p], a] - points[nodes[m], a]) / spacing
    _inverse_moments(start, freedom, offset, inverse)
    rows, block = (start, freedom, sizes, center, other, offset, inverse), np.zeros((longest, 3))
    count = right.shape[0]
    scale = np.zeros(count)
    for m in range(nodes.shape[0]):
        for p in range(start[m], start[m + 1]):
            scale[other[p]] += sizes[m] ** 2 * freedom[p]
            scale[center[m]] += sizes[m] ** 2 * freedom[p]
    for k in range(count):
        scale[k] = 1.0 / np.sqrt(max(scale[k], MIN_SCALE))
    _across(normals, right)
    solution, image, regularization = np.zeros((count, 3)), np.zeros((count, 3)), np.zeros(count)
    for attempt in range(len(REGULARIZATION_SHARES) + 1):
        _solve_regularized(rows, normals, scale, regularization, right, solution, image, block)
        if attempt == len(REGULARIZATION_SHARES):
            break
        soft = False
        for m in range(nodes.shape[0]):
            _change(m, start, freedom, sizes[m], center, other, offset, inverse, solution, block)
            if _square_change(m, start, block) > MAX_CHANGE:
                soft = True
                regularization[center[m]] = REGULARIZATION_SHARES[attempt]
                for p in range(start[m], start[m + 1]):
                    regularization[other[p]] = REGULARIZATION_SHARES[attempt]
        if not soft:
            break
    image[:] = 0.0
    for m in range(nodes.shape[0]):
        _change(m, start, freedom, sizes[m], center, other, offset, inverse, solution, block)
        share = _largest_share(m, start, limit[nodes[m]], spacing, first, block)
        for p in range(start[m], start[m + 1]):
            for c in range(3):
                value = share * block[p - start[m], c]
                first[p, c] += value / spacing
                image[other[p], c] += sizes[m] * value
                image[center[m], c] -= sizes[m] * value
    _across(normals, image)
    return np.abs(right - image).max()


@cached_njit(nogil=True)
def _solve_regularized(rows, normals, scale, regularization, right, solution, image, block):
    """Write the multipliers for which the sums change by `right`; those of nodes with a regularization change less."""
    count = right.shape[0]
    residual = np.zeros((count, 3))
    for k in range(count):
        for c in range(3):
            residual[k, c] = scale[k] * right[k, c]
    _apply_scaled(rows, normals, scale, regularization, residual, image, block)
    solution[:] = 0.0
    direction, moved = residual.copy(), image.copy()
    product, first_product, best = (residual * image).sum(), (residual * image).sum(), np.inf
    for iteration in range(MAX_ITERATIONS):
        largest = 0.0
        for k in range(count):
            for c in range(3):
                largest = max(largest, abs(residual[k, c]) / scale[k])
        if largest < RESIDUAL_TOLERANCE or not product > MIN_PROGRESS**2 * first_product:
            break
        if iteration % WINDOW_ITERATIONS == 0:
            if largest > SLOWEST_DECREASE * best:
                break
            best = largest
        step = product / (moved * moved).sum()
        for k in range(count):
            for c in range(3):
                solution[k, c] += step * direction[k, c] * scale[k]
                residual[k, c] -= step * moved[k, c]
        _apply_scaled(rows, normals, scale, regularization, residual, image, block)
        product_before = product
        product = (residual * image).sum()
        for k in range(count):
            for c in range(3):
                direction[k, c] = residual[k, c] + product / product_before * direction[k, c]
                moved[k, c] = image[k, c] + product / product_before * moved[k, c]


@cached_njit(nogil=True)
def _square_change(m, start, block):
    """Return the size q of the changes (k, 3) of row m."""
    square = 0.0
    for c in range(3):
        total = 0.0
        for p in range(start[m], start[m + 1]):
            square += block[p - start[m], c] ** 2
            total += block[p - start[m], c]
        square += total**2
    return square


@cached_njit(nogil=True)
def _largest_share(m, start, limit, spacing, first, block):
    """Return the share of the changes (k, 3) of row m, at most 1, for which its size q is below the limit.

    q is a + 2 b x + c x^2 for a share x.
    """
    a, b, c = 0.0, 0.0, 0.0
    for d in range(3):
        total, total_change = 0.0, 0.0
        for p in range(start[m], start[m + 1]):
            weight = spacing * first[p, d]
            change = block[p - start[m], d]
            total, total_change = total + weight, total_change + change
            a, b, c = a + weight**2, b + weight * change, c + change**2
        a, b, c = a + total**2, b + total * total_change, c + total_change**2
    if a + 2.0 * b + c <= limit:
        return 1.0
    return max((np.sqrt(max(b * b + c * (limit - a), 0.0)) - b) / c, 0.0)


def conserve_integrals(uncut: UncutStencils, rows: FittedRows, missing: Floats) -> float:
    """Change weights of the smoothing in place, for the integrals of smoothed fields to remain.

    `missing` (n,) [m^3] is by how much the sums of V_I s_IJ must change, at the nodes that the rows contain. Returns
    what remains of it, over the median volume.
    """
    bonds = rows._replace(freedom=(rows.smoothing != 0.0).astype(float))
    nodes, center, other = _local_numbers(bonds, len(uncut.points))
    volume = float(np.median(uncut.volumes))
    return float(
        _share(rows.start, center, other, uncut.volumes[rows.nodes] / volume, missing[nodes] / volume, rows.smoothing)
    )


@cached_njit(nogil=True)
def _share_scaled(start, center, other, sizes, used, scale, field, image):
    """Write the changes of the scaled sums that scaled multipliers cause."""
    image[:] = 0.0
    for m in range(center.shape[0]):
        i = center[m]
        for p in range(start[m], start[m + 1]):
            if used[p]:
                j = other[p]
                value = sizes[m] ** 2 * (scale[j] * field[j] - scale[i] * field[i])
                image[j] += value
                image[i] -= value
    for k in range(field.shape[0]):
        image[k] *= scale[k]


@cached_njit(nogil=True)
def _share(start, center, other, sizes, right, weights):
    """Solve for the least change of the weights that are not zero, and add it; return the largest residual."""
    count = right.shape[0]
    used, scale = weights != 0.0, np.zeros(count)
    for m in range(center.shape[0]):
        for p in range(start[m], start[m + 1]):
            if used[p]:
                scale[other[p]] += sizes[m] ** 2
                scale[center[m]] += sizes[m] ** 2
    for k in range(count):
        scale[k] = 1.0 / np.sqrt(max(scale[k], MIN_SCALE))
    residual, image, solution = scale * right, np.zeros(count), np.zeros(count)
    _share_scaled(start, center, other, sizes, used, scale, residual, image)
    direction, moved = residual.copy(), image.copy()
    product, first_product, largest = (residual * image).sum(), (residual * image).sum(), 0.0
    for _ in range(MAX_ITERATIONS):
        largest = 0.0
        for k in range(count):
            largest = max(largest, abs(residual[k]) / scale[k])
        if largest < RESIDUAL_TOLERANCE or not product > MIN_PROGRESS**2 * first_product:
            break
        step = product / (moved * moved).sum()
        solution += step * direction
        residual -= step * moved
        _share_scaled(start, center, other, sizes, used, scale, residual, image)
        product_before = product
        product = (residual * image).sum()
        direction = residual + product / product_before * direction
        moved = image + product / product_before * moved
    for m in range(center.shape[0]):
        for p in range(start[m], start[m + 1]):
            if used[p]:
                i, j = center[m], other[p]
                weights[p] += sizes[m] * (scale[j] * solution[j] - scale[i] * solution[i])
    return largest
