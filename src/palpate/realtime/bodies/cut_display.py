"""Display surface of a cut body: its surface opened along the cut, both faces of the cut, and the line of the opening.

An edge of the surface that the cut crosses gets two new vertices, one for each side, and its triangles are divided.
The faces are the triangles of the cut inside the body, once for each side. The displacement of a new vertex is a fit
over the nodes that it sees from its side (`palpate.meshfree.cut.points`). The line is drawn on the triangles, so that
a cut that is closed is seen, too.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from palpate.core.arrays import Floats, Ints, Singles
from palpate.dynamics.solid.model import EnergySolid
from palpate.meshfree.cut.crossings import first_crossings
from palpate.meshfree.cut.opening import Opening, cut_measures, cut_opening
from palpate.meshfree.cut.points import SIGHT_DISTANCE, point_weights
from palpate.realtime.bodies.display_surface import CutLine, fixed_nodes
from palpate.realtime.bodies.full_surface import FullSurface
from palpate.surface.nesting import inside_points

MERGED_DISTANCE = 1e-6  # of corners of the cut that are one vertex, in spacings
ON_SIDE = 1e-3  # share of a triangle's height within which a line on one of its sides is drawn on it


class NewVertices(NamedTuple):
    """Vertices that a cut adds: points (v, 3) [m], unit vectors (v, 3) to their side, and triangles (t, 3) of all."""

    points: Floats
    sides: Floats
    triangles: Ints


class CutFullSurface(FullSurface):
    """The display surface of a cut full body, by that of the uncut body."""

    def __init__(self, model: Any, uncut: FullSurface) -> None:
        self.model, self._kept_vertices = model, len(uncut.nodes)
        opened, parents = _opened(model, uncut)
        faces = _faces(model, len(uncut.nodes) + len(opened.points))
        points, sides = (np.concatenate(each) for each in zip(opened[:2], faces[:2], strict=True))
        state = model.cut_state
        sight = points + SIGHT_DISTANCE * model.cloud.spacing * sides
        weights = point_weights(state.uncut, state.surface, points, sight)
        rows = np.repeat(np.arange(len(points)), weights.nodes.shape[1])
        entries = weights.values.ravel(), (rows, weights.nodes.ravel())
        new = sparse.csr_array(entries, shape=(len(points), len(model.cloud)))
        nearest = weights.nodes[np.arange(len(points)), np.argmax(weights.values, axis=1)]
        self.nodes = np.concatenate([uncut.nodes, nearest])
        self.rest = np.concatenate([uncut.rest, points.astype(np.float32)])
        triangles = np.concatenate([opened.triangles, faces.triangles])
        is_there = ~state.removed[self.nodes][triangles].any(axis=1)
        self.triangles = np.ascontiguousarray(triangles[is_there], dtype=np.uint32)
        corners, places = uncut.rest.astype(float)[uncut.triangles], np.concatenate([uncut.rest, points])
        opening = cut_opening(model.cut_surface.triangles, corners, model.cloud.spacing)
        on_surface = is_there[: len(parents)]
        self.cut_line = _line(opening, opened.triangles[on_surface], parents[on_surface], places)
        first = faces.triangles[: len(faces.triangles) // 2]  # of both faces
        self.cut_measures = cut_measures(opening, corners, places[first], model.cloud.spacing)
        self.fixed = np.concatenate([fixed_nodes(model)[uncut.nodes], np.zeros(len(points), dtype=np.bool_)])
        self._patches = sparse.vstack([model.patches[uncut.nodes], new], format="csr").astype(np.float32)

    def displacements(
        self, coordinates: Floats, nodes: Ints, forces: Floats, bonded: NDArray[np.bool_], tools: Ints
    ) -> Singles:
        """Return the displacements (n, 3) [m] of the vertices; see `FullSurface.displacements`."""
        moved, count = coordinates.reshape(-1, 3).astype(np.float32), self._kept_vertices
        result: Singles = np.ascontiguousarray(self._patches @ moved)
        held = np.isin(self.nodes[:count], nodes[bonded]) | (len(bonded) > 0 and bonded.all())
        result[:count][held] = moved[self.nodes[:count][held]]
        return result


def _opened(model: EnergySolid, uncut: FullSurface) -> tuple[NewVertices, Ints]:
    """Return the surface with its triangles divided where the cut crosses their edges, and the new vertices.

    The second result (t,) has the numbers of the triangles that were divided.
    """
    points, triangles = uncut.rest.astype(float), uncut.triangles.astype(np.int64)
    sides = triangles[:, [[0, 1], [1, 2], [2, 0]]]
    edges, which = np.unique(np.sort(sides.reshape(-1, 2), axis=1), axis=0, return_inverse=True)
    number = which.reshape(-1, 3)
    touched = model.cut_state.touched[uncut.nodes]
    shares = np.full(len(edges), np.inf)
    near = np.flatnonzero(touched[edges].any(axis=1))
    found_shares = np.empty(len(near))
    first_crossings(np.ascontiguousarray(points[edges[near]]), model.cut_surface.triangles, found_shares)
    shares[near] = found_shares
    crossed = np.flatnonzero(np.isfinite(shares))
    place = np.full(len(edges), -1)
    place[crossed] = len(points) + 2 * np.arange(len(crossed))
    ends = points[edges[crossed]]
    at = ends[:, 0] + shares[crossed, None] * (ends[:, 1] - ends[:, 0])
    along = ends[:, 1] - ends[:, 0]
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    new_points = np.repeat(at, 2, axis=0)
    new_sides = np.stack([-along, along], axis=1).reshape(-1, 3)

    def new_vertex(triangle: int, side: int, corner: int) -> int:
        """Return the vertex on a side of a triangle that belongs to a corner."""
        edge = number[triangle, side]
        return int(place[edge] + (edges[edge, 1] == corner))

    count = np.sum(place[number] >= 0, axis=1)
    result, parents = [triangles[count == 0]], [np.flatnonzero(count == 0)]
    for t in np.flatnonzero(count > 0):
        corners, cut_sides = triangles[t], np.flatnonzero(place[number[t]] >= 0)
        result.append(np.array(_divided(int(t), corners, cut_sides, new_vertex)))
        parents.append(np.full(len(result[-1]), t))
    return NewVertices(new_points, new_sides, np.concatenate(result)), np.concatenate(parents)


def _line(opening: Opening, triangles: Ints, parents: Ints, points: Floats) -> CutLine:
    """Return an opening on triangles (t, 3) of points (n, 3), parts of the triangles with the numbers `parents` (t,).

    A piece is drawn on the part that holds its middle, and on both if it is on their common side: then on both rims.
    """
    order = np.argsort(parents, kind="stable")
    start, end = (np.searchsorted(parents[order], opening.triangles, side) for side in ("left", "right"))
    counts = end - start
    piece = np.repeat(np.arange(len(start)), counts)
    part = order[np.arange(len(piece)) + np.repeat(start - np.cumsum(counts) + counts, counts)]
    a, b, c = (points[triangles[part, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    square = np.maximum(np.sum(normals**2, axis=1, keepdims=True), np.finfo(float).tiny)
    places = opening.pieces[piece] - a[:, None]
    second = np.einsum("pec,pc->pe", places, np.cross(c - a, normals) / square)
    third = np.einsum("pec,pc->pe", places, np.cross(normals, b - a) / square)
    shares = np.stack([1.0 - second - third, second, third], axis=2)
    within = shares.mean(axis=1).min(axis=1)
    best = np.full(len(start), -np.inf)
    np.maximum.at(best, piece, within)
    selected = (within > -ON_SIDE) | (within == best[piece])
    shares = np.maximum(shares[selected], 0.0)
    shares /= shares.sum(axis=2, keepdims=True)
    ends = shares[:, :, 1:].astype(np.float32)
    return CutLine(triangles[part[selected]].astype(np.uint32), ends.reshape(-1, 4))


def _divided(t: int, corners: Ints, cut_sides: Ints, vertex: Any) -> list[tuple[int, int, int]]:
    """Return the triangles into which crossed sides divide a triangle."""
    if len(cut_sides) == 1:
        k = cut_sides[0]
        a, b, c = (int(corners[(k + m) % 3]) for m in range(3))
        return [(a, vertex(t, k, a), c), (vertex(t, k, b), b, c)]
    if len(cut_sides) == 2:
        k = ({0, 1, 2} - set(cut_sides.tolist())).pop()  # the side that is not crossed; the corner opposite is alone
        b, c, a = (int(corners[(k + m) % 3]) for m in range(3))
        ab, ca = (k + 2) % 3, (k + 1) % 3
        p, q = vertex(t, ab, b), vertex(t, ca, c)
        return [(a, vertex(t, ab, a), vertex(t, ca, a)), (p, b, c), (p, c, q)]
    a, b, c = (int(corner) for corner in corners)
    return [
        (a, vertex(t, 0, a), vertex(t, 2, a)), (b, vertex(t, 1, b), vertex(t, 0, b)),
        (c, vertex(t, 2, c), vertex(t, 1, c)),
    ]  # fmt: skip


def _faces(model: EnergySolid, first: int) -> NewVertices:
    """Return both faces of the cut inside the body, whose vertices have numbers from `first` on."""
    surface, cloud = model.cut_surface, model.cloud
    corners = cloud.points[cloud.triangles]
    flat = surface.triangles.reshape(-1, 3)
    keys = np.rint(flat / (MERGED_DISTANCE * cloud.spacing)).astype(np.int64)
    _, one, which = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    vertices, triangles = flat[one], which.reshape(-1, 3)
    inside = inside_points(vertices, corners)
    points, clipped = _clipped(vertices, triangles, inside, corners)
    if not len(clipped):
        return NewVertices(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros((0, 3), dtype=np.int64))
    a, b, c = (points[clipped[:, k]] for k in range(3))
    area, normals = np.cross(b - a, c - a), np.zeros_like(points)
    for k in range(3):
        np.add.at(normals, clipped[:, k], area)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), np.finfo(float).tiny)
    both = np.concatenate([clipped[:, ::-1], clipped + len(points)])  # the tissue above looks down, and that below up
    return NewVertices(np.tile(points, (2, 1)), np.concatenate([normals, -normals]), both + first)


def _clipped(vertices: Floats, triangles: Ints, inside: Any, corners: Floats) -> tuple[Floats, Ints]:
    """Return triangles without their parts outside the body, and all points."""
    count = inside[triangles].sum(axis=1)
    result, points = [triangles[count == 3]], [vertices]
    partial = triangles[(count > 0) & (count < 3)]
    total = len(vertices)
    if len(partial):
        # the corners in the order in which the first is inside or outside alone
        alone = inside[partial].sum(axis=1) == 1
        odd = np.argmax(inside[partial] == alone[:, None], axis=1)
        turned = np.take_along_axis(partial, (odd[:, None] + np.arange(3)) % 3, axis=1)
        crossings = []
        for k in (1, 2):
            ends = vertices[np.stack([turned[:, 0], turned[:, k]], axis=1)]
            shares = np.empty(len(ends))
            first_crossings(np.ascontiguousarray(ends), corners, shares)
            missed = np.flatnonzero(~np.isfinite(shares))  # one end is on the surface
            shares[missed] = inside_points(ends[missed].mean(axis=1), corners) == alone[missed]
            points.append(ends[:, 0] + shares[:, None] * (ends[:, 1] - ends[:, 0]))
            crossings.append(total + np.arange(len(ends)))
            total += len(ends)
        a, (p, q) = turned[:, 0], crossings
        result.append(np.stack([a, p, q], axis=1)[alone])
        b, c = turned[:, 1], turned[:, 2]
        result += [np.stack([p, b, c], axis=1)[~alone], np.stack([p, c, q], axis=1)[~alone]]
    return np.concatenate(points), np.concatenate(result)
