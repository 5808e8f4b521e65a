"""Advance of a cut with a blade: the path of its edge through the stress-free body, and its energy balance.

After some steps the points of the edge have moved on through the tissue. The triangles between their places before and
after, in the stress-free body, are cut at fixed displacements, a quarter of the spacing at a time. The front releases
the strain energy G dA: a part at once, and the rest in the motion after it. G follows from the stress around the front
before the cut (`palpate.dynamics.solid.cutting.energy_release`). The edge holds the tissue with at most (Gamma - G) l
(`palpate.dynamics.contact.blade`), so the work of the blade is

    W = Gamma A + friction + work on the tissue - released energy.

Parts of an edge that are outside the body, or in the present cut, cut nothing.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from palpate.core.arrays import Floats, Ints
from palpate.core.describe import Described, Fact
from palpate.dynamics.contact.blade import Blade
from palpate.dynamics.contact.blade_sites import EDGE_SITE, FACE_SITE, BladeSites
from palpate.dynamics.run.model import Evaluation
from palpate.dynamics.solid.cutting.energy_release import release_rate
from palpate.meshfree.cut.points import (
    MIN_VOLUME,
    SIGHT_DISTANCE,
    PointWeights,
    point_weights,
    reference_points,
    shares_inside,
)
from palpate.meshfree.cut.stencils import CutState
from palpate.meshfree.cut.surface import is_narrow, nearest_on_cut, swept, triangle_areas

EDGE_PIECE = 0.5  # longest piece of the edge, in spacings
LARGEST_ADVANCE, MIN_ADVANCE = 0.25, 0.05  # of the edge in one cut, in spacings
MIN_WAY = 0.02  # of a point of the edge in one cut, below which it stays, in spacings
IN_CUT = 0.3  # distance from the present cut below which the edge is in it, in spacings
NEAR_BODY = 3.0  # distance from the nearest node beyond which an edge cuts nothing, in spacings
AHEAD_OF_EDGE = 0.1  # from the edge to a point that is in the cut if the edge is not at a front, in spacings
NEW_DEPTH = 0.02  # of a face in the blade when its site is made, in spacings
NEAR_FACE = 1.5  # distance of a point of the blade's flat from the nearest node, in spacings
MIN_SHARE = 1e-3  # of a piece of the edge in the body, for it to hold tissue
LONGEST_STRIP, MAX_BEND = 1.0, 0.01  # of a strip of triangles, and its distance from the way of the edge, in spacings
MIN_HELD = 0.5  # of the edge in the body, which holds tissue, for it to be a front
LONGEST_RETREAT = 0.3  # of a piece of the edge behind the front, beyond which it holds no tissue, in spacings


class Strip(NamedTuple):
    """A strip of triangles behind an edge."""

    start: Floats  # (p, 3) array [m]: points of the edge where the strip begins
    pieces: NDArray[np.bool_]  # (p - 1,) bool array: pieces of the edge that cut
    triangles: int  # number of triangles


class HeldPieces(NamedTuple):
    """Pieces of an edge that hold tissue."""

    pieces: NDArray[np.int64]  # (m,) int array
    points: Floats  # (m, 3) array [m]: their middles in the stress-free body
    weights: PointWeights  # of the nodes there
    offsets: Floats  # (m, 3) array [m]: from the tissue there to the blade that are not counted as an advance
    normals: Floats  # (m, 3) array: in which they advance, in the tool's frame
    ahead: Floats  # (m, 3) array: the same in the stress-free body
    lengths: Floats  # (m,) array [m]: in the body
    areas: Floats  # (m,) array [m]: that they cut per advance
    limits: Floats  # (m,) array [N]: largest forces, which the compiled step reads
    # (m,) array [m]: how far the front has advanced since the sites were made; the compiled step writes them
    slips: Floats
    edge_length: float = 0.0  # [m]: length of the edge in the body, also of pieces that hold no tissue

    @property
    def is_front(self) -> bool:
        """Whether most of the edge in the body holds tissue; one that returns to its cut is not at the front."""
        return float(self.lengths.sum()) >= MIN_HELD * self.edge_length > 0.0


@dataclass(frozen=True)
class CutFront(Described):
    """Front of the cut that a blade makes: where the edge is, and the energies since the start."""

    edge: Floats  # (p, 3) [m] in the stress-free body
    strip: Strip  # last triangles of the cut, continued with the edge
    hold: HeldPieces | None = None
    area: float = 0.0  # that the blade has cut [m^2]
    released: float = 0.0  # strain energy that the front has released [J]
    release_rate: float = 0.0  # that the front releases per area now [J/m^2]
    largest_rate: float = 0.0  # while most of the edge in the body is a front [J/m^2]
    edge_work: float = 0.0  # dissipated at the edge [J]
    friction_work: float = 0.0  # dissipated by friction on the sides [J]

    @property
    def totals(self) -> Floats:
        """Cut area [m^2], released energy, and energies dissipated at the edge and by friction [J], shape (4,).

        Area and release include those of the way of the front since the last cut, of which the work at the edge is.
        """
        since = 0.0 if self.hold is None else float(self.hold.slips @ self.hold.areas)
        released = self.released + self.release_rate * since
        return np.array([self.area + since, released, self.edge_work, self.friction_work])

    def with_works(self, edge: float, friction: float) -> CutFront:
        """Return the cut front with further energies [J] dissipated at the edge and by friction."""
        return replace(self, edge_work=self.edge_work + edge, friction_work=self.friction_work + friction)

    def _facts(self) -> list[Fact]:
        return [
            ("cut area", float(self.totals[0]), "m^2"),
            ("released energy", float(self.totals[1]), "J"),
            ("energy dissipated at the edge", float(self.edge_work), "J"),
            ("energy dissipated by friction", float(self.friction_work), "J"),
        ]


def edge_points(blade: Blade, spacing: float) -> Floats:
    """Return points (p, 3) [m] along the edge, in the tool's frame, at most half a spacing apart."""
    corners = np.array(blade.edge, dtype=float)
    parts = []
    for a, b in pairwise(corners):
        count = int(np.ceil(np.linalg.norm(b - a) / (EDGE_PIECE * spacing)))
        parts.append(a + (b - a) * np.linspace(0.0, 1.0, count, endpoint=False)[:, None])
    return np.concatenate([*parts, corners[-1:]])


def points_in_space(frame: Floats, points: Floats) -> Floats:
    """Return points (p, 3) of a frame (3, 4) in space."""
    return np.asarray(points @ frame[:, :3].T + frame[:, 3])


def cutting_directions(points: Floats) -> Floats:
    """Return the directions (p - 1, 3) in which the pieces of an edge cut, in the tool's frame."""
    along = np.diff(points, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    return np.column_stack([along[:, 2], np.zeros(len(along)), -along[:, 0]])


def start_cut_front(state: CutState, blade: Blade, frame: Floats, u: Floats) -> CutFront:
    """Return a blade that begins outside a body with displacements (n, 3), in a frame (3, 4)."""
    places = points_in_space(frame, edge_points(blade, state.uncut.spacing))
    edge = _edge_in_body(state, blade, frame, u, places)
    return CutFront(edge, Strip(edge, np.zeros(len(edge) - 1, dtype=np.bool_), 0))


def _edge_in_body(state: CutState, blade: Blade, frame: Floats, u: Floats, guesses: Floats) -> Floats:
    """Return the points of the edge in the stress-free body."""
    points = edge_points(blade, state.uncut.spacing)
    directions = cutting_directions(points)
    ahead = np.concatenate([directions[:1], directions]) + np.concatenate([directions, directions[-1:]])
    ahead /= np.linalg.norm(ahead, axis=1, keepdims=True)
    places = points_in_space(frame, points)
    return reference_points(state.uncut, state.surface, u, places, guesses, ahead @ frame[:, :3].T)[0]


def advance_edge(
    state: CutState, cut_front: CutFront, blade: Blade, frame: Floats, u: Floats, corners: Floats
) -> list[tuple[Floats, NDArray[np.bool_], float]]:
    """Return the cuts that bring the edge to its place: its points, the pieces that cut, and the area [m^2] of each.

    `frame` (3, 4) is that of the blade, `u` (n, 3) [m] the displacements; `corners` (s, 3, 3) [m] are those of the
    surface of the body.
    """
    spacing = state.uncut.spacing
    target = _edge_in_body(state, blade, frame, u, cut_front.edge)
    if cut_front.hold is not None:
        _follow_slip(cut_front, target, edge_points(blade, spacing), frame, u, spacing)
    way = target - cut_front.edge
    distance = (
        np.asarray(state.uncut.tree.query(np.concatenate([cut_front.edge, target]))[0]).reshape(2, -1).min(axis=0)
    )
    near = distance < NEAR_BODY * spacing
    longest = np.linalg.norm(way[near], axis=1).max(initial=0.0)
    if longest < MIN_ADVANCE * spacing:
        return []
    count = int(np.ceil(longest / (LARGEST_ADVANCE * spacing)))
    way[np.linalg.norm(way, axis=1) < count * MIN_WAY * spacing] = 0.0
    normals = _forward(cut_front.edge, frame, blade, spacing)
    cuts = []
    for k in range(count):
        edges = cut_front.edge + np.array([k / count, (k + 1) / count])[:, None, None] * way
        pieces = _cutting_pieces(state, edges, near, normals)
        cuts.append((edges[1], pieces, area_inside(state, edges, pieces, corners)))
    return cuts


def _slips(hold: HeldPieces, points: Floats, frame: Floats, u: Floats) -> tuple[Floats, Floats]:
    """Return how far (m, 3) [m] an edge of points (p, 3) has slipped from the tissue, and its normals, in space."""
    tissue = hold.points + np.einsum("pk,pkc->pc", hold.weights.values, u[hold.weights.nodes])
    middles = 0.5 * (points[hold.pieces] + points[hold.pieces + 1])
    return points_in_space(frame, middles) - tissue - hold.offsets, hold.normals @ frame[:, :3].T


def _follow_slip(cut_front: CutFront, target: Floats, points: Floats, frame: Floats, u: Floats, spacing: float) -> None:
    """Move the points of the target (p, 3) at pieces that hold tissue by as much as the tissue has slipped there.

    Fits about other points would count as a small advance where nothing slips. What is drawn along the edge cuts
    nothing, as in its work. A piece that has moved back from the front by more than a spacing holds no tissue.
    """
    hold = cut_front.hold
    assert hold is not None
    slip, normals = _slips(hold, points, frame, u)
    behind = hold.slips - np.sum(slip * normals, axis=1)  # of the edge behind the front
    slip += np.maximum(behind, 0.0)[:, None] * normals
    tangents = np.cross(normals, frame[:, 1])
    drawn = np.sum(slip * tangents, axis=1, keepdims=True) * tangents
    gradients, along = _gradients(hold, u), cut_front.edge[hold.pieces + 1] - cut_front.edge[hold.pieces]
    along /= np.maximum(np.linalg.norm(along, axis=1, keepdims=True), 1e-30)
    moved, drawn = (np.linalg.solve(gradients, way[:, :, None])[:, :, 0] for way in (slip - drawn, drawn))
    moved += np.sum(drawn * along, axis=1, keepdims=True) * along
    total, count = np.zeros_like(target), np.zeros(len(target))
    near = behind < LONGEST_RETREAT * spacing
    for k in range(2):
        np.add.at(total, hold.pieces[near] + k, moved[near])
        np.add.at(count, hold.pieces[near] + k, 1.0)
    held = count > 0
    target[held] = cut_front.edge[held] + total[held] / count[held, None]


def _forward(edge: Floats, frame: Floats, blade: Blade, spacing: float) -> Floats:
    """Return the directions (p - 1, 3) in which the pieces of the edge cut, roughly, in the stress-free body."""
    directions = cutting_directions(edge_points(blade, spacing)) @ frame[:, :3].T
    along = np.diff(edge, axis=0)
    square = np.maximum(np.sum(along**2, axis=1, keepdims=True), 1e-30)
    across = directions - np.sum(directions * along, axis=1, keepdims=True) / square * along
    return np.asarray(across / np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-30))


def _cutting_pieces(state: CutState, edges: Floats, near: Any, normals: Floats) -> NDArray[np.bool_]:
    """Return the pieces of an edge that cut between two places (2, p, 3): those that advance, and not in the cut."""
    middles = edges.mean(axis=0)
    centers = 0.5 * (middles[:-1] + middles[1:])
    way = 0.5 * ((edges[1] - edges[0])[:-1] + (edges[1] - edges[0])[1:])
    new = (near[:-1] | near[1:]) & (np.sum(way * normals, axis=1) > 0)
    return np.asarray(new & ~_in_cut(state, centers) & ~_in_removed(state, centers, normals))


def _in_removed(state: CutState, points: Floats, sights: Floats) -> NDArray[np.bool_]:
    """Return which points (p, 3), seen along unit vectors (p, 3), are in tissue that was removed."""
    if not state.removed.any() or not len(points):
        return np.zeros(len(points), dtype=np.bool_)
    weights = point_weights(state.uncut, state.surface, points, points + SIGHT_DISTANCE * state.uncut.spacing * sights)
    return np.asarray(np.sum(weights.values * state.removed[weights.nodes], axis=1) > 0.5)


def _in_cut(state: CutState, points: Floats) -> NDArray[np.bool_]:
    """Return which points (p, 3) are between the edges of the present cut."""
    distance, over = project_on_cut(state, points)[1:]
    return np.asarray(over & (distance < IN_CUT * state.uncut.spacing))


def project_on_cut(state: CutState, points: Floats) -> tuple[Floats, Floats, NDArray[np.bool_]]:
    """Return the results of `nearest_on_cut` for points (p, 3); all are far from a body without a cut."""
    count = len(points)
    projections, distance, over = points.copy(), np.full(count, np.inf), np.zeros(count, dtype=np.bool_)
    if len(state.surface.triangles):
        nearest_on_cut(np.ascontiguousarray(points), state.surface.triangles, projections, distance, over)
    return projections, distance, over


def area_inside(state: CutState, edges: Floats, pieces: NDArray[np.bool_], corners: Floats) -> float:
    """Return the area [m^2] inside the body between two places (2, p, 3) of the pieces of an edge."""
    segments = np.stack([edges[:, :-1], edges[:, 1:]], axis=2)[:, pieces]
    shares = shares_inside(state.uncut, corners, segments.reshape(-1, 2, 3)).reshape(2, -1)
    areas = triangle_areas(swept(edges)).reshape(-1, 2).sum(axis=1)[pieces]
    return float(np.sum(areas * shares.mean(axis=0)))


def next_strip(strip: Strip, before: Floats, edge: Floats, pieces: NDArray[np.bool_], spacing: float) -> Any:
    """Return the strip up to the next place of an edge, its triangles, and how many of the cut's last they replace.

    A strip that is straight and short goes on; else a new one begins at the last place of the edge (p, 3).
    """
    way = edge - strip.start
    square = np.maximum(np.sum(way**2, axis=1, keepdims=True), np.finfo(float).tiny)
    chord = strip.start + np.clip(np.sum((before - strip.start) * way, axis=1, keepdims=True) / square, 0, 1) * way
    is_straight = np.linalg.norm(before - chord, axis=1).max() < MAX_BEND * spacing
    is_short = np.sqrt(square.max()) <= LONGEST_STRIP * spacing
    goes_on = is_straight and is_short and np.array_equal(pieces, strip.pieces)
    start = strip.start if goes_on else before
    quads = swept(np.stack([start, edge])).reshape(-1, 2, 3, 3)[pieces].reshape(-1, 3, 3)
    triangles = quads[~is_narrow(quads, spacing)]
    return Strip(start, pieces, len(triangles)), triangles, strip.triangles if goes_on else 0


def after_cut(cut_front: CutFront, edge: Floats, strip: Strip, area: float) -> CutFront:
    """Return the cut front after a cut of an area [m^2]."""
    released = cut_front.released + cut_front.release_rate * area
    return replace(cut_front, edge=edge, strip=strip, area=cut_front.area + area, released=released)


def front_release_rate(body: Any, cut_front: CutFront, u: Floats, evaluation: Evaluation) -> float:
    """Return the energy release rate [J/m^2] of the pieces of an edge that hold tissue, at displacements (n, 3)."""
    hold = cut_front.hold
    if hold is None or not len(hold.pieces):
        return 0.0
    segments = np.stack([cut_front.edge[hold.pieces], cut_front.edge[hold.pieces + 1]], axis=1)
    return release_rate(body, u, evaluation, segments, hold.ahead, hold.lengths)


def edge_limits(blade: Blade, rate: float, areas: Floats) -> Floats:
    """Return the largest forces (m,) [N] of pieces of an edge that cut areas (m,) [m] per advance."""
    return max(blade.toughness - max(rate, 0.0), 0.0) * areas


def blade_sites(
    state: CutState, cut_front: CutFront, blade: Blade, frame: Floats, u: Floats, corners: Floats, tool: int
) -> tuple[BladeSites, CutFront, float]:
    """Return the sites of a blade, the cut front with the pieces that hold tissue, and the length [m] in the body."""
    spacing = state.uncut.spacing
    points = edge_points(blade, spacing)
    middles, directions = 0.5 * (points[:-1] + points[1:]), cutting_directions(points)
    segments = np.stack([cut_front.edge[:-1], cut_front.edge[1:]], axis=1)
    shares = shares_inside(state.uncut, corners, segments)
    lengths = shares * np.linalg.norm(np.diff(points, axis=0), axis=1)
    seen = _forward(cut_front.edge, frame, blade, spacing)
    in_cut = _in_cut(state, segments.mean(axis=1) + AHEAD_OF_EDGE * spacing * seen)
    shares[_in_removed(state, segments.mean(axis=1), seen)] = 0.0
    held = np.flatnonzero((shares > MIN_SHARE) & ~in_cut)
    edge_at, sights = segments.mean(axis=1)[held], seen[held]
    edge_weights = point_weights(state.uncut, state.surface, edge_at, edge_at + SIGHT_DISTANCE * spacing * sights)
    ways = segments[held, 1] - segments[held, 0]
    inside = shares[held] * np.linalg.norm(ways, axis=1)
    hold = _held_pieces(state, cut_front, blade, frame, u, held, edge_at, edge_weights, sights, inside)
    areas = shares[held] * _area_rates(hold, ways, directions[held] @ frame[:, :3].T, u)
    faces, face_weights = _faces(state, blade, frame, u, points, cut_front.edge, corners)
    kinds = np.repeat([EDGE_SITE, FACE_SITE], [len(held), len(faces[0])])
    parts = zip([edge_at, sights, middles[held], directions[held], np.zeros(len(held))], faces, strict=True)
    at, _, places, normals, limits = (np.concatenate(each) for each in parts)
    weights = PointWeights(*(np.concatenate(each) for each in zip(edge_weights, face_weights, strict=True)))
    limits[: len(held)] = edge_limits(blade, cut_front.release_rate, areas)
    slips = np.zeros(len(kinds))
    used = weights.values != 0.0
    start = np.concatenate([[0], np.cumsum(used.sum(axis=1))]).astype(np.int64)
    sites = BladeSites(
        tool=np.full(len(kinds), tool, dtype=np.int64), kind=kinds.astype(np.int64), start=start,
        nodes=weights.nodes[used], weights=weights.values[used], points=np.ascontiguousarray(at),
        places=np.ascontiguousarray(places), directions=np.ascontiguousarray(normals),
        limits=np.ascontiguousarray(limits), impulses=np.zeros((len(kinds), 3)), works=np.zeros(2),
        offsets=np.concatenate([hold.offsets, np.zeros((len(kinds) - len(held), 3))]), slips=slips,
    )  # fmt: skip
    edge_length = float(shares @ np.linalg.norm(segments[:, 1] - segments[:, 0], axis=1))
    return sites, replace(cut_front, hold=hold._replace(areas=areas, edge_length=edge_length)), float(lengths.sum())


def _area_rates(hold: HeldPieces, ways: Floats, normals: Floats, u: Floats) -> Floats:
    """Return the areas (m,) [m] of the stress-free body that pieces of ways (m, 3) cut per advance along normals."""
    moved = np.linalg.solve(_gradients(hold, u), normals[:, :, None])[:, :, 0]
    return np.asarray(np.linalg.norm(np.cross(ways, moved), axis=1))


def _gradients(hold: HeldPieces, u: Floats) -> Floats:
    """Return the deformation gradients (m, 3, 3) at pieces; unity where the fit is too much compressed."""
    gradient = np.eye(3) + np.einsum("pkd,pkc->pcd", hold.weights.slopes, u[hold.weights.nodes])
    gradient[~(np.linalg.det(gradient) > MIN_VOLUME)] = np.eye(3)
    return gradient


def _held_pieces(
    state: CutState,
    cut_front: CutFront,
    blade: Blade,
    frame: Floats,
    u: Floats,
    pieces: Any,
    points: Floats,
    weights: PointWeights,
    ahead: Floats,
    lengths: Floats,
) -> HeldPieces:
    """Return the pieces (m,) that hold tissue, at points (m, 3); an edge behind the front stays behind it."""
    edge, count = edge_points(blade, state.uncut.spacing), len(pieces)
    none = np.zeros(count)
    normals = cutting_directions(edge)[pieces]
    hold = HeldPieces(
        pieces, points, weights, np.zeros((count, 3)), normals, ahead, lengths, areas=none, limits=none, slips=none
    )
    offsets, normals = _slips(hold, edge, frame, u)
    before = cut_front.hold
    if before is not None:
        slip, normals_before = _slips(before, edge, frame, u)
        behind = np.zeros(len(edge) - 1)
        behind[before.pieces] = np.maximum(before.slips - np.sum(slip * normals_before, axis=1), 0.0)
        offsets = offsets + behind[pieces, None] * normals
    return hold._replace(offsets=offsets)


def _faces(
    state: CutState, blade: Blade, frame: Floats, u: Floats, points: Floats, edge: Floats, corners: Floats
) -> tuple[list[Floats], PointWeights]:
    """Return the sites on the faces of the cut at both sides of the blade, and the weights of nodes there.

    The sites are points, unit vectors to where they are seen from, places and directions on the blade, and limits.
    """
    spacing, surface = state.uncut.spacing, state.surface
    rows = max(1, int(np.ceil(blade.height / spacing)))
    heights = blade.height * (np.arange(rows) + 0.5) / rows
    middles = 0.5 * (points[:-1] + points[1:])
    flat = (middles[:, None] + heights[None, :, None] * np.array([0.0, 0.0, 1.0])).reshape(-1, 3)
    areas = np.repeat(np.diff(points[:, 0]) * blade.height / rows, rows)
    along = np.repeat(np.diff(edge, axis=0), rows, axis=0)
    sides = np.repeat([1.0, -1.0], len(flat))
    normals = sides[:, None] * np.array([0.0, 1.0, 0.0])
    targets = np.tile(flat, (2, 1)) + 0.5 * blade.wedge * normals
    areas, along, places = np.tile(areas, 2), np.tile(along, (2, 1)), points_in_space(frame, targets)
    nearest, close = _nearest_nodes(state.uncut.points + u, places, NEAR_FACE * spacing)
    close &= len(surface.triangles) > 0
    places, targets, normals, areas, along = (each[close] for each in (places, targets, normals, areas, along))
    sight = normals @ frame[:, :3].T
    at, seen = reference_points(state.uncut, surface, u, places, places - u[nearest[close]], sight)
    projections, distance, over = project_on_cut(state, at)
    used, shares = over & (distance < spacing), np.zeros(len(at))
    segments = projections[used, None] + np.array([-0.5, 0.5])[:, None] * along[used, None]
    shares[used] = shares_inside(state.uncut, corners, segments)
    used &= (shares > 0) & ~_in_removed(state, projections, seen)
    at, seen, places, targets, normals = (each[used] for each in (projections, seen, places, targets, normals))
    weights = point_weights(state.uncut, surface, at, at + SIGHT_DISTANCE * spacing * seen)
    moved = at + np.einsum("pk,pkc->pc", weights.values, u[weights.nodes])
    depth = np.minimum(0.0, np.sum((moved - places) * sight[used], axis=1))
    targets = targets + np.minimum(0.0, NEW_DEPTH * spacing + depth)[:, None] * normals
    return [at, seen, targets, normals, blade.friction * (shares * areas)[used]], weights


def _nearest_nodes(nodes: Floats, places: Floats, reach: float) -> tuple[Ints, NDArray[np.bool_]]:
    """Return the nodes (p,) of (n, 3) nearest to places (p, 3), and whether one is within reach."""
    low, high = places.min(axis=0) - reach, places.max(axis=0) + reach
    near = np.flatnonzero(np.all((nodes > low) & (nodes < high), axis=1))
    if not len(near):
        return np.zeros(len(places), dtype=np.int64), np.zeros(len(places), dtype=np.bool_)
    distance, nearest = cKDTree(nodes[near]).query(places)
    return near[nearest], np.asarray(distance < reach)
