"""Named parts of a surface file: choice by name or pattern, and patches joined where their borders coincide.

Organs of atlases come as patches of their surface, closed only together. Vertices of borders that are each other's
nearest, within a tolerance, become one; patches that share at least half of their borders form one body.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase

import numpy as np
import scipy.sparse as sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from palpate.core.arrays import Floats, Ints
from palpate.core.faults import InputError
from palpate.core.files import shortened
from palpate.surface.checks import METRES_BY_UNIT, guessed_units, shape_problems
from palpate.surface.surface import Surface, SurfaceProblem, coincident_vertices, directed_edges, weld

MAX_PARTS = 1000  # of a file, which are joined or compared
MAX_LISTED_NAMES = 40  # of parts, in a message
BORDER_TOLERANCE = 1e-3  # distance of border vertices that are joined, over the size
BORDER_EDGE_SHARE = 0.4  # of the shortest border edge next to a vertex, which that distance may be at most
MAX_ROUNDS = 8  # of joining nearest border vertices
MIN_SHARED_BORDER = 0.5  # of the border edges of a patch, which it shares with others of its body
SAME_ORGAN = 0.1  # relative difference of the volumes of bodies that describe one organ
BOX_SLACK = 0.02  # of the size, by which an enclosed body may exceed the bounding box of the one around it


@dataclass(frozen=True)
class Body:
    """Closed body of a file: the names of its parts and its repaired surface, in a unit of so many metres."""

    names: tuple[str, ...]
    surface: Surface
    metres: float = 1.0

    def __str__(self) -> str:
        return f"{names_text(self.names, 3)} ({1e3 * abs(self.surface.volume) * self.metres**3:.3g} litres)"


def names_text(names: Sequence[str], most: int = MAX_LISTED_NAMES) -> str:
    """Return names of parts for a message."""
    plain = [shortened(name if name.isprintable() else repr(name)) for name in names[:most]]
    if most < len(names) <= MAX_LISTED_NAMES:
        return f"{', '.join(plain)} and {len(names) - most} more"
    return ", ".join(plain) + ", ..." * (len(names) > most)


def matching_parts(names: Sequence[str], part: str | Sequence[str]) -> list[str]:
    """Return the names that equal or match one of several shell-style patterns, in the order of the file."""
    patterns = [part] if isinstance(part, str) else list(part)
    chosen = set[str]()
    for pattern in patterns:
        matches = [pattern] if pattern in names else [name for name in names if fnmatchcase(name, pattern)]
        if not matches:
            raise InputError(
                f"part must be one of {names_text(sorted(names)) or 'none'}, got {shortened(repr(pattern))}"
            )
        chosen.update(matches)
    if not chosen:
        raise InputError(f"part must name at least one of {names_text(sorted(names)) or 'none'}, got none")
    return [name for name in names if name in chosen]


# ---- joining


def join_parts(parts: Mapping[str, Surface], name: str) -> Surface:
    """Return several parts as one welded surface; borders that coincide are joined, walls between parts removed.

    The name is for messages.
    """
    if len(parts) == 1:
        return replace(weld(next(iter(parts.values()))), name=name)
    vertices, triangles, owner = _concatenate(list(parts.values()))
    vertices, label, gap = _match_borders(vertices, triangles)
    joined = label[triangles]
    places = _shared_borders(vertices, joined, owner)[0]
    outer = _without_inner_walls(joined, owner)
    repairs = list[SurfaceProblem]()
    if len(places):
        size = float(np.linalg.norm(np.ptp(vertices, axis=0)))
        what = (
            f"borders of {len(parts)} parts joined along {len(places)} edges, with gaps of up to {gap / size:.1g} of "
            f"the size: {names_text(list(parts), 12)}"
        )
        repairs.append(SurfaceProblem("repair", "joined parts", what, places))
    if not outer.all():
        walls = vertices[joined[~outer]].mean(axis=1)
        what = f"walls between parts were removed, with {int((~outer).sum())} triangles"
        repairs.append(SurfaceProblem("repair", "inner walls", what, walls))
    return weld(Surface(vertices, joined[outer], name, repairs=tuple(repairs)))


def _concatenate(surfaces: Sequence[Surface]) -> tuple[Floats, Ints, Ints]:
    """Return vertices, those that coincide merged, triangles with area, and the surface of each triangle."""
    before = np.cumsum([0, *(len(each.vertices) for each in surfaces)])
    triangles = np.concatenate([each.triangles + k for each, k in zip(surfaces, before, strict=False)])
    vertices = np.concatenate([each.vertices for each in surfaces])
    owner = np.repeat(np.arange(len(surfaces)), [len(each.triangles) for each in surfaces])
    first, label = coincident_vertices(vertices, float(np.linalg.norm(np.ptp(vertices, axis=0))))
    triangles = label[triangles]
    apart = (triangles != np.roll(triangles, 1, axis=1)).all(axis=1)
    return vertices[first], triangles[apart], owner[apart]


def _edge_keys(triangles: Ints, n: int) -> Ints:
    """Return a number for each edge (3 t,) of triangles, equal in both directions."""
    edges = np.sort(directed_edges(triangles)[0], axis=1)
    return edges[:, 0] * n + edges[:, 1]


def _border_edges(triangles: Ints, n: int) -> Ints:
    """Return the edges (b, 2) of one triangle only."""
    key, count = np.unique(_edge_keys(triangles, n), return_counts=True)
    return np.column_stack(np.divmod(key[count == 1], n))


def _match_borders(vertices: Floats, triangles: Ints) -> tuple[Floats, Ints, float]:
    """Return vertices, the one that takes the place of each, and the largest distance of two that were joined [m]."""
    n, size = len(vertices), float(np.linalg.norm(np.ptp(vertices, axis=0)))
    vertices, label = vertices.copy(), np.arange(n)
    joined = 0.0
    for _ in range(MAX_ROUNDS):
        edges = _border_edges(label[triangles], n)
        edges = edges[edges[:, 0] != edges[:, 1]]
        rim = np.unique(edges)
        if len(rim) < 2:
            break
        length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
        reach = np.full(n, BORDER_TOLERANCE * size)
        for column in edges.T:
            np.minimum.at(reach, column, BORDER_EDGE_SHARE * length)
        distance, near = (each[:, 1] for each in cKDTree(vertices[rim]).query(vertices[rim], k=2))
        mutual = (near[near] == np.arange(len(rim))) & (np.arange(len(rim)) < near)
        mutual &= distance <= np.minimum(reach[rim], reach[rim[near]])
        if not mutual.any():
            break
        kept, dropped = rim[mutual], rim[near[mutual]]
        joined = max(joined, float(distance[mutual].max()))
        vertices[kept] = 0.5 * (vertices[kept] + vertices[dropped])
        place = np.arange(n)
        place[dropped] = kept
        label = place[label]
    return vertices, label, joined


def _shared_borders(vertices: Floats, triangles: Ints, owner: Ints) -> tuple[Floats, Ints, Ints]:
    """Return the edge midpoints at which borders of different parts meet, and the pairs (k, 2) of parts there.

    Also the numbers of border edges of each part.
    """
    n, count = len(vertices), int(owner.max()) + 1
    key, part = _edge_keys(triangles, n), np.tile(owner, 3)
    once = np.unique(np.column_stack([key, part]), axis=0, return_counts=True)
    border = once[0][once[1] == 1]  # edges of one triangle of their part
    total = np.bincount(border[:, 1], minlength=count)
    same = border[1:, 0] == border[:-1, 0]
    pairs = np.column_stack([border[:-1, 1][same], border[1:, 1][same]])
    ends = np.unique(border[:-1, 0][same])
    return vertices[np.column_stack(np.divmod(ends, n))].mean(axis=1), pairs, total


def _without_inner_walls(triangles: Ints, owner: Ints) -> Ints:
    """Return a mask (t,) without the pairs of opposite triangles of different parts."""
    turn = np.argmin(triangles, axis=1)
    forward = np.take_along_axis(triangles, (np.arange(3) + turn[:, None]) % 3, axis=1)
    low = np.column_stack([forward[:, 0], np.sort(forward[:, 1:], axis=1)])
    _, number = np.unique(low, axis=0, return_inverse=True)
    number = number.ravel()
    turned = forward[:, 1] > forward[:, 2]
    total, reversed_ = np.bincount(number), np.bincount(number, turned)
    lowest = np.full(len(total), len(owner))
    highest = np.full(len(total), -1)
    np.minimum.at(lowest, number, owner)
    np.maximum.at(highest, number, owner)
    wall = (total == 2) & (reversed_ == 1) & (lowest < highest)
    return np.asarray(~wall[number])


# ---- choice


def choose_body(
    parts: Mapping[str, Surface], name: str, finish: Callable[[Surface], Surface], units: str | None = None
) -> Surface:
    """Return the body of a file of several parts that plainly is the organ, with a warning that names it.

    `parts` are all parts of the file, without unused vertices. `finish` welds or repairs a surface. `units` are by
    default those of the largest body, if it is an organ.
    """
    bodies, hollow = list[Body](), list[str]()
    for names in _groups(parts):
        together = _body(parts, names, name, finish, hollow)
        alone = [] if together or len(names) == 1 else [_body(parts, (each,), name, finish, hollow) for each in names]
        bodies += [body for body in (together, *alone) if body]
    bodies.sort(key=lambda body: -body.surface.volume)
    if not bodies:
        why = f"; {names_text(hollow)} is a double shell, not a solid" if hollow else ""
        raise InputError(
            f"part must be given for a file of {len(parts)} parts, none of which is closed by itself{why}; choose one "
            f"of {names_text(sorted(parts))}, or several that are closed together"
        )
    metres = METRES_BY_UNIT[units or guessed_units(bodies[0].surface)]
    bodies = [replace(body, metres=metres) for body in bodies]
    chosen = _enclosing(bodies, np.concatenate([each.vertices for each in parts.values()]))
    if chosen is None:
        listed = "; ".join(map(str, bodies[:12])) + "; ..." * (len(bodies) > 12)
        raise InputError(
            f"part must be given for a file of {len(parts)} parts; choose one of {names_text(sorted(parts))}; "
            f"closed are: {listed}"
        )
    why = "the largest that is closed, around all others"
    if hollow:
        why += f"; {names_text(hollow, 3)} is a double shell, not a solid"
    guess = f"{name} has {len(parts)} parts: {chosen} chosen, {why}; give part= to choose"
    surface = chosen.surface
    return replace(surface, warnings=(*surface.warnings, guess))


def _body(
    parts: Mapping[str, Surface],
    names: Sequence[str],
    file: str,
    finish: Callable[[Surface], Surface],
    hollow: list[str],
) -> Body | None:
    """Return a body of parts, or None if it is not closed; add its name to `hollow` if it is a double shell."""
    chosen = {each: parts[each] for each in names}
    try:
        surface = finish(join_parts(chosen, f"{file}, part {names_text(names, 3)}"))
    except InputError:  # without area, or of no size
        return None
    errors = [problem.name for problem in shape_problems(surface) if problem.kind == "error"]
    if errors == ["hollow"]:
        hollow.append(names_text(names, 3))
    return None if errors or surface.volume <= 0 else Body(tuple(names), surface)


def _groups(parts: Mapping[str, Surface]) -> list[tuple[str, ...]]:
    """Return the names of patches that share their borders; every other part by itself."""
    names = list(parts)
    vertices, triangles, owner = _concatenate(list(parts.values()))
    vertices, label, _ = _match_borders(vertices, triangles)
    _, pairs, total = _shared_borders(vertices, label[triangles], owner)
    members = np.ones(len(names), dtype=bool)
    while True:  # drops the patch with the least shared border, until each shares enough
        pairs = pairs[members[pairs].all(axis=1)]
        shared = np.bincount(pairs.ravel(), minlength=len(names)) / np.maximum(total, 1)
        shared[~members | (total == 0)] = np.inf
        worst = int(np.argmin(shared))
        if shared[worst] >= MIN_SHARED_BORDER:
            break
        members[worst] = False
    _, group = connected_components(sparse.coo_matrix((np.ones(len(pairs)), pairs.T), (len(names),) * 2), False)
    return [tuple(names[k] for k in np.flatnonzero(group == g)) for g in range(int(group.max()) + 1)]


def _enclosing(bodies: Sequence[Body], vertices: Floats) -> Body | None:
    """Return the largest body, if all vertices of the file lie in its box: of equal ones that of the fewest parts."""
    largest = bodies[0].surface
    slack = BOX_SLACK * largest.size
    low, high = largest.vertices.min(axis=0) - slack, largest.vertices.max(axis=0) + slack
    if np.any(vertices < low) or np.any(vertices > high):
        return None
    same = [body for body in bodies if body.surface.volume > (1 - SAME_ORGAN) * largest.volume]
    return min(same, key=lambda body: len(body.names))
