"""Plane clouds for membranes: discs, and sheets of any polygonal outline.

Inside, nodes lie on rings or on a triangular lattice, where they share stencils. The rim has evenly
spaced nodes of its own. The lattice would leave gaps and near-duplicates there, so its outer nodes
are relaxed by repulsion.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import Delaunay, cKDTree

from palpate.core.arrays import Floats, Ints
from palpate.core.faults import CloudError, InputError, brief, integer_in_range, number_in_range
from palpate.meshfree.cloud import MAX_COORDINATE, MIN_SPACING, Cloud, warn_of_size
from palpate.meshfree.stencils import moving_least_squares

ROW_DISTANCE = np.sqrt(0.75)  # distance between rows of the lattice, in spacings
MIN_RINGS = 2  # a disc of 19 nodes
# In spacings:
MIN_RIM_DISTANCE = 0.5  # half a row: the strip of area of the rim nodes
MIN_RIM_SPACING = 0.4  # two nodes, across a sharp corner
MIN_PASSAGE_WIDTH = 1.3  # for three rows of nodes
MIN_GAP_WIDTH = 2.0  # about the reach of a stencil
MAX_SEGMENT = 1.25  # from rim node to rim node
RELAXED_DEPTH = 3.5  # depth of the relaxed layer
REPULSION_RADIUS = 1.5  # includes the first shell of the lattice only, so that a lattice is in equilibrium
MAX_SWEEPS = 40


def disc(radius: float, spacing: float, layout: str = "rings", jitter: float = 0.0, seed: int = 0) -> Cloud:
    """Fill a disc around the origin.

    Parameters
    ----------
    radius : float [m]
        Radius of the rim.
    spacing : float [m]
        Target distance between nodes, at most half the radius; rings use the nearest one that
        divides the radius.
    layout : str
        ``"rings"``: 6 k nodes on ring k, with six-fold symmetry. ``"hexagonal"``: a triangular
        lattice, relaxed towards a rim of evenly spaced nodes. Both have a node at the centre.
    jitter : float
        Random displacement of every inner node except the centre, as a share of the distance to its
        nearest neighbour (on a lattice, of the spacing), in [0, 0.3]. Nodes of the rim do not move.
    seed : int
        Seed of the random displacements.

    Returns
    -------
    Cloud
        Groups are ``"face"`` (all nodes), ``"rim"`` and ``"centre"`` (one node). A node's area is
        that of its Voronoi cell.

    Raises
    ------
    InputError
        A radius, spacing or jitter out of range, a spacing too coarse or too fine for the disc, an
        unknown layout.

    Warns
    -----
    UnitWarning
        A sheet of more than 10 m or less than 0.1 mm: sizes are in metres.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.disc(0.1, spacing=0.01)
    >>> len(cloud.points), sorted(cloud.groups)
    (331, ['centre', 'face', 'rim'])
    """
    radius = number_in_range("radius", radius, 0.0, MAX_COORDINATE, open_low=True, unit="m")
    spacing = number_in_range("spacing", spacing, MIN_SPACING, MAX_COORDINATE, unit="m")
    jitter = number_in_range("jitter", jitter, 0.0, 0.3)
    seed = integer_in_range("seed", seed, 0)
    layouts = {"rings": _rings, "hexagonal": _hexagonal_disc}
    if layout not in layouts:
        raise InputError(f"layout must be one of {', '.join(map(repr, layouts))}, got {brief(layout)}")
    if spacing > radius / MIN_RINGS * (1 + 1e-9):
        raise InputError(
            f"spacing must give at least {MIN_RINGS} rings in a disc of radius {radius:g} m, got {spacing:g} m; use at "
            f"most {radius / MIN_RINGS:g} m"
        )
    _check_count(np.pi * radius**2, 2 * np.pi * radius, spacing)
    warn_of_size(np.array([[-radius, -radius], [radius, radius]]))
    inner, rim, spacing = layouts[layout](radius, spacing)
    centre = int(np.argmin(np.linalg.norm(inner, axis=1)))
    points = np.concatenate([_jitter(inner, rim, jitter, seed), rim])
    points[centre] = 0.0
    triangles = _triangulate(points, rim, len(inner))
    members = np.arange(len(inner), len(points))
    sector = 2 * np.pi / len(rim)
    volumes = _voronoi_areas(points, triangles, len(inner))
    volumes[members] += radius**2 / 2 * (sector - np.sin(sector))  # between chord and arc
    return Cloud(
        points=points,
        volumes=volumes,
        face_nodes=members,
        face_normals=rim / np.linalg.norm(rim, axis=1, keepdims=True),
        face_areas=np.full(len(rim), radius * sector),
        groups={"face": np.arange(len(points)), "rim": members, "centre": np.array([centre])},
        triangles=triangles,
        spacing=spacing,
    )


def sheet(outline: ArrayLike, spacing: float, jitter: float = 0.0, seed: int = 0) -> Cloud:
    """Fill a closed polygon that does not cross itself.

    Parameters
    ----------
    outline : (m, 2) array [m]
        Corners in order, clockwise or anticlockwise; the first may be repeated at the end.
    spacing : float [m]
        Target distance between nodes. Every edge gets a whole number of segments of at most 1.25
        times this length. The lattice has the segment length and direction of the longest edge.
    jitter : float
        Random displacement of every inner node, as a share of the distance to its nearest
        neighbour, in [0, 0.3]. Nodes of the rim do not move.
    seed : int
        Seed of the random displacements.

    Returns
    -------
    Cloud
        Groups are ``"face"`` (all nodes), ``"rim"``, and ``"edge0"``, ``"edge1"`` ... from corner k
        to corner k + 1, both included. A node's area is that of its Voronoi cell.

    Raises
    ------
    InputError
        An outline that is not a simple polygon, or with an edge too short, a corner too sharp, or a
        passage or gap too narrow for the spacing; a spacing or jitter out of range.

    Warns
    -----
    UnitWarning
        A sheet of more than 10 m or less than 0.1 mm: sizes are in metres.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.sheet([(0, 0), (0.1, 0), (0.1, 0.05), (0, 0.05)], spacing=0.01)
    >>> sorted(cloud.groups)
    ['edge0', 'edge1', 'edge2', 'edge3', 'face', 'rim']
    >>> round(float(cloud.volumes.sum()), 6)
    0.005
    """
    spacing = number_in_range("spacing", spacing, MIN_SPACING, MAX_COORDINATE, unit="m")
    jitter = number_in_range("jitter", jitter, 0.0, 0.3)
    seed = integer_in_range("seed", seed, 0)
    corners = _check_outline(outline)
    along = np.roll(corners, -1, axis=0) - corners
    lengths = np.linalg.norm(along, axis=1)
    area = float(np.sum(_cross(corners - corners[0], along)) / 2)  # positive for an anticlockwise outline
    normals = np.sign(area) * np.stack([along[:, 1], -along[:, 0]], axis=1) / lengths[:, None]
    _check_count(abs(area), lengths.sum(), spacing)
    warn_of_size(corners)
    rim, starts = _edge_nodes(corners, lengths, spacing)
    _check_widths(rim, starts, corners, spacing)
    longest = int(np.argmax(lengths > lengths.max() * (1 - 1e-9)))  # the first of equal ones
    step = float(lengths[longest] / (starts[longest + 1] - starts[longest]))
    lattice = _lattice(corners, corners[longest], along[longest] / lengths[longest], step)
    inner = _relax_lattice(lattice, rim, corners, step)
    _check_stencils(np.concatenate([inner, rim]), spacing)
    points = np.concatenate([_jitter(inner, rim, jitter, seed), rim])
    triangles = _triangulate(points, corners, len(inner))
    edges = [len(inner) + np.arange(a, b + 1) % len(rim) for a, b in pairwise(starts)]
    segments = np.diff(starts)
    ends = [np.concatenate([[0.5], np.ones(count - 1), [0.5]]) for count in segments]
    groups = {f"edge{k}": np.sort(edge) for k, edge in enumerate(edges)}
    return Cloud(
        points=points,
        volumes=_voronoi_areas(points, triangles, len(inner)),
        face_nodes=np.concatenate(edges),
        face_normals=np.repeat(normals, segments + 1, axis=0),
        face_areas=np.concatenate(ends) * np.repeat(lengths / segments, segments + 1),
        groups={"face": np.arange(len(points)), "rim": np.arange(len(inner), len(points))} | groups,
        triangles=triangles,
        spacing=step,
    )


def _check_count(area: float, perimeter: float, spacing: float) -> None:
    if (nodes := area / (ROW_DISTANCE * spacing**2) + perimeter / spacing) > 5e7:
        raise InputError(
            f"spacing must give at most 5e7 nodes, got {spacing:g} m ({nodes:.2g} nodes); use a larger one"
        )


def _rings(radius: float, spacing: float) -> tuple[Floats, Floats, float]:
    """Return inner nodes, rim nodes and the spacing.

    Nodes that are aligned across one pair of rings are staggered across the next, which avoids
    spokes.
    """
    count = round(radius / spacing)
    ring = np.repeat(np.arange(1, count + 1), 6 * np.arange(1, count + 1))
    number = np.arange(len(ring)) - 3 * ring * (ring - 1)
    angle = 2 * np.pi / (6 * ring) * (number + ring * (ring + 1) / 4 % 1)
    points = (radius / count * ring)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    rim = ring == count
    return np.concatenate([np.zeros((1, 2)), points[~rim]]), points[rim], radius / count


def _hexagonal_disc(radius: float, spacing: float) -> tuple[Floats, Floats, float]:
    """Return inner nodes, rim nodes (a multiple of six, for the symmetry of the lattice) and the spacing."""
    angle = np.linspace(0, 2 * np.pi, 6 * round(2 * np.pi * radius / spacing / 6), endpoint=False)
    rim = radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    lattice = _lattice(rim, np.zeros(2), np.array([1.0, 0.0]), spacing)
    return _relax_lattice(lattice, rim, rim, spacing), rim, spacing


def _lattice(corners: Floats, origin: Floats, direction: Floats, step: float) -> Floats:
    """Return the triangular lattice through `origin` with rows along the unit vector `direction`, in a polygon."""
    turn = np.array([direction, [-direction[1], direction[0]]])
    turned = (corners - origin) @ turn.T
    low, high = turned.min(axis=0) / [step, ROW_DISTANCE * step], turned.max(axis=0) / [step, ROW_DISTANCE * step]
    rows, columns = np.arange(np.floor(low[1]), high[1] + 1), np.arange(np.floor(low[0]) - 1, high[0] + 1)
    j, i = np.meshgrid(rows, columns, indexing="ij")
    nodes = step * np.stack([i + j % 2 / 2, ROW_DISTANCE * j], axis=-1).reshape(-1, 2)
    return nodes[_inside(nodes, turned)] @ turn + origin


def _inside(points: Floats, corners: Floats) -> NDArray[np.bool_]:
    """Return a mask of points inside a polygon: a ray from them in +x crosses the outline an odd number of times."""
    order = np.argsort(points[:, 1])
    x, y = points[order].T
    odd = np.zeros(len(points), dtype=bool)
    for (ax, ay), (bx, by) in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        level = slice(*np.searchsorted(y, [min(ay, by), max(ay, by)]))
        odd[order[level]] ^= x[level] < ax + (y[level] - ay) * (bx - ax) / (by - ay)
    return odd


def _clearance(points: Floats, rim: Floats) -> Floats:
    """Return distances [m] to the nearest circle about a rim segment as diameter: negative inside, inf far away.

    If these circles contain no nodes, all segments of the rim are edges of the Delaunay
    triangulation.
    """
    ahead = np.roll(rim, -1, axis=0)
    radii = np.append(np.linalg.norm(ahead - rim, axis=1) / 2, 0)
    tree = cKDTree((rim + ahead) / 2)
    distance, near = tree.query(points, k=min(4, len(rim)), distance_upper_bound=5 * radii.max())
    return np.min(distance - radii[near], axis=1)


def _relax_lattice(lattice: Floats, rim: Floats, corners: Floats, spacing: float) -> Floats:
    """Return relaxed lattice nodes without those too near the rim; repeat once if some end on the rim."""
    tree = cKDTree(rim)
    for _ in range(2):
        far = tree.query(lattice, distance_upper_bound=spacing)[0] > MIN_RIM_DISTANCE * spacing * (1 - 1e-9)
        lattice = _relax(lattice[far & (_clearance(lattice, rim) > -1e-9 * spacing)], rim, tree, spacing)
        stray = (_clearance(lattice, rim) <= 0) | ~_inside(lattice, corners)
        if not stray.any():
            break
        lattice = lattice[~stray]
    return lattice


def _relax(inner: Floats, rim: Floats, tree: cKDTree, spacing: float) -> Floats:
    """Relax nodes near the rim by repulsion (1.5 - distance / spacing)^2 from neighbours, with decreasing steps."""
    deepest = RELAXED_DEPTH + REPULSION_RADIUS + 1
    depth = tree.query(inner, distance_upper_bound=deepest * spacing)[0] / spacing
    order = np.argsort(depth, kind="stable")
    free, end = np.searchsorted(depth[order], [RELAXED_DEPTH, deepest])
    nodes = np.concatenate([inner[order[:end]], rim])
    for k in range(MAX_SWEEPS):
        distance, other = cKDTree(nodes).query(nodes[:free], k=min(13, len(nodes)))
        apart = distance[:, 1:, None] / spacing
        push = np.maximum(REPULSION_RADIUS - apart, 0) ** 2 / apart
        step = np.sum(push * (nodes[:free, None] - nodes[other[:, 1:]]), axis=1) / 4
        longest = 0.15 * 0.97**k * spacing
        nodes[:free] += step * np.minimum(1, longest / np.maximum(np.linalg.norm(step, axis=1), longest))[:, None]
    return np.concatenate([nodes[:free], inner[order[free:]]])[np.argsort(order)]


def _jitter(inner: Floats, rim: Floats, jitter: float, seed: int) -> Floats:
    """Displace inner nodes at random, but none up to the rim and none near crowded rim nodes."""
    nearest = cKDTree(np.concatenate([inner, rim])).query(inner, k=2)[0][:, 1]
    most = np.minimum(jitter * nearest, 0.9 * np.maximum(_clearance(inner, rim), 0))
    longest = np.linalg.norm(np.roll(rim, -1, axis=0) - rim, axis=1).max()
    crowded = rim[_clearance(rim, rim) < -1e-9 * longest]
    if len(crowded):
        most[cKDTree(crowded).query(inner)[0] < 3 * longest] = 0
    generator = np.random.default_rng(seed)
    angle = generator.uniform(0, 2 * np.pi, len(inner))
    length = most * np.sqrt(generator.uniform(size=len(inner)))  # uniform in the area of a disc
    return inner + length[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _triangulate(points: Floats, corners: Floats, inner: int) -> Ints:
    """Return the Delaunay triangles inside the outline; the first `inner` points do not lie on it."""
    triangles = Delaunay(points - points.mean(axis=0)).simplices.astype(np.int64)  # anticlockwise, in the plane
    a, b, c = points[triangles].transpose(1, 0, 2)
    doubled = _cross(b - a, c - a)
    flat = doubled < 1e-9 * np.median(doubled)  # three nodes of one edge
    outside = (triangles >= inner).all(axis=1)
    outside[outside] = ~_inside(((a + b + c) / 3)[outside], corners)
    triangles = triangles[~(flat | outside)]
    pairs = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    keys, count = np.unique(pairs @ [len(points), 1], return_counts=True)
    rim = np.arange(inner, len(points))
    segments = np.sort(np.stack([rim, np.roll(rim, -1)], axis=1), axis=1) @ [len(points), 1]
    if not np.array_equal(keys[count == 1], np.sort(segments)):
        lost = np.append(rim[~np.isin(segments, keys[count == 1])], rim)[0]
        raise InputError(f"outline must be wider for its nodes near {points[lost]} m; use a smaller spacing")
    return triangles


def _voronoi_areas(points: Floats, triangles: Ints, inner: int) -> Floats:
    """Return the area [m^2] of every node's Voronoi cell, from cotangents.

    The method is that of Meyer, Desbrun, Schroder and Barr (2003), section 3.3. An obtuse triangle
    whose circumcentre lies beyond the rim is halved and quartered as there, so that cells end at
    the rim.
    """
    corner = points[triangles]
    side = np.roll(corner, -1, axis=1) - np.roll(corner, 1, axis=1)  # opposite each corner
    square = np.sum(side**2, axis=2)
    area = np.abs(_cross(side[:, 0], side[:, 1])) / 2
    cotangent = (square.sum(axis=1, keepdims=True) - 2 * square) / (4 * area[:, None])
    half = square * cotangent / 8
    share = half.sum(axis=1, keepdims=True) - half
    p, q = np.roll(triangles, -1, axis=1) - inner, np.roll(triangles, 1, axis=1) - inner
    on_rim = (np.minimum(p, q) >= 0) & np.isin(np.abs(p - q), [1, len(points) - inner - 1])
    beyond = np.any(on_rim & (cotangent < 0), axis=1)
    share[beyond] = area[beyond, None] * np.where(cotangent[beyond] < 0, 0.5, 0.25)
    return np.bincount(triangles.ravel(), share.ravel(), len(points)).astype(float)


def _cross(a: Floats, b: Floats) -> Floats:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def _check_outline(outline: ArrayLike) -> Floats:
    """Return the corners (m, 2) of a simple polygon, the first not repeated."""
    try:
        corners = np.array(outline, dtype=float)
    except (TypeError, ValueError, OverflowError):
        corners = np.empty(0)
    if corners.ndim != 2 or corners.shape[1] != 2:
        raise InputError(f"outline must be numbers of shape (m, 2) [m], one corner per row, got {brief(outline)}")
    bad = np.flatnonzero(~np.isfinite(corners).all(axis=1))
    if bad.size:
        raise InputError(f"outline must have finite corners, got {corners[bad[0]]} at corner {bad[0]}")
    far = np.flatnonzero(np.abs(corners).max(axis=1, initial=0.0) > MAX_COORDINATE)
    if far.size:
        raise InputError(f"outline must lie within {MAX_COORDINATE:g} m of the origin, got corner {corners[far[0]]}")
    if len(corners) > 1 and np.array_equal(corners[0], corners[-1]):
        corners = corners[:-1]
    if len(corners) < 3:
        raise InputError(f"outline must have at least 3 corners, got {len(corners)}")
    _, first, kind = np.unique(corners, axis=0, return_index=True, return_inverse=True)
    first = first[kind.ravel()]
    for k in np.flatnonzero(first != np.arange(len(corners))):
        raise InputError(
            f"outline must have different corners, got {corners[k]} m at corners {first[k]} and {k}; leave out one"
        )
    thickness = np.linalg.svd(corners - corners.mean(axis=0), compute_uv=False)
    if thickness[1] <= 1e-9 * thickness[0]:
        raise InputError(f"outline must have a positive area, got {len(corners)} corners on one line")
    _check_crossings(corners)
    return corners


def _check_crossings(corners: Floats) -> None:
    """Check that edges without a common corner do not meet; this includes adjacent edges that fold back."""
    ends = np.roll(corners, -1, axis=0)
    for k in range(len(corners) - 2):
        others = slice(k + 2, len(corners) - (k == 0))
        a, b, c, d = corners[k], ends[k], corners[others], ends[others]
        meet = (np.maximum(c, d) >= np.minimum(a, b)).all(axis=1) & (np.minimum(c, d) <= np.maximum(a, b)).all(axis=1)
        meet &= _cross(b - a, c - a) * _cross(b - a, d - a) <= 0
        meet &= _cross(d - c, a - c) * _cross(d - c, b - c) <= 0
        if meet.any():
            other = k + 2 + int(np.argmax(meet))
            where = f"edge {k} from {a} m that meets edge {other} from {corners[other]} m"
            raise InputError(f"outline must not cross or touch itself, got {where}; give its corners in order")


def _edge_nodes(corners: Floats, lengths: Floats, spacing: float) -> tuple[Floats, Ints]:
    """Return the rim nodes in order, and the index of the first one of every edge, with their count at the end."""
    k = int(np.argmin(lengths))
    if lengths[k] < spacing / 2:
        raise InputError(
            f"edge {k} of the outline must be at least half the spacing = {spacing:g} m long, got {lengths[k]:g} m; "
            f"leave out a corner or use a spacing of at most {2 * lengths[k]:g} m"
        )
    count = np.maximum(np.rint(lengths / spacing), np.ceil(lengths / (MAX_SEGMENT * spacing))).astype(np.int64)
    starts = np.concatenate([[0], np.cumsum(count)])
    edge = np.repeat(np.arange(len(corners)), count)
    share = ((np.arange(starts[-1]) - starts[edge]) / count[edge])[:, None]
    return corners[edge] + share * (np.roll(corners, -1, axis=0) - corners)[edge], starts


def _check_widths(rim: Floats, starts: Ints, corners: Floats, spacing: float) -> None:
    """Check that an outline is not too near to itself: over a corner, inside (a passage) or outside (a gap)."""
    i, j = cKDTree(rim).query_pairs(MIN_GAP_WIDTH * spacing * (1 - 1e-9), output_type="ndarray").T
    distance = np.linalg.norm(rim[i] - rim[j], axis=1)
    place = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.roll(rim, -1, axis=0) - rim, axis=1))])
    around = place[j] - place[i] > place[-1] / 2
    detour = np.where(around, place[-1] - place[j] + place[i], place[j] - place[i])
    turns = np.searchsorted(starts, j) - np.searchsorted(starts, i, side="right")  # corners passed on the way
    turns = np.where(around, len(corners) - turns - np.isin(i, starts) - np.isin(j, starts), turns)
    outside = ~_inside((rim[i] + rim[j]) / 2, corners)
    needed = np.where(outside, MIN_GAP_WIDTH, MIN_PASSAGE_WIDTH)
    needed = spacing * np.where((turns > 1) & (detour > 3 * distance), needed, MIN_RIM_SPACING)
    tight = np.flatnonzero((turns > 0) & (distance < needed * (1 - 1e-9)))
    if tight.size == 0:
        return
    worst = tight[np.argmin((distance / needed)[tight])]
    a, b = np.searchsorted(starts, [i[worst], j[worst]], side="right") - 1
    if turns[worst] == 1:
        b = (b if around[worst] else a) + 1
        a, b = b - 1, b % len(corners)
        advice = "sharp corner; cut it off, or leave 24 degrees between edges longer than the spacing"
    else:
        what = "gap, which stencils would reach across" if outside[worst] else "passage"
        most = distance[worst] / needed[worst] * spacing
        advice = f"narrow {what}; widen it or use a spacing of at most {most:.3g} m"
    near = f"{distance[worst]:.3g} m near {rim[i[worst]]} m"
    raise InputError(
        f"edges {a} and {b} of the outline must be farther apart for spacing = {spacing:g} m, got {near}: a {advice}"
    )


def _check_stencils(points: Floats, spacing: float) -> None:
    try:
        moving_least_squares(points, order=2, neighbours=18)
    except CloudError as fault:
        message = f"spacing must be smaller for a small or narrow outline, got {spacing:g} m"
        raise InputError(f"{message} ({fault})") from None
