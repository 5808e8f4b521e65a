"""Meshes of validation/elements.py: surfaces whose triangles follow given borders, and tetrahedra in them (tetgen).

Subdivision is flat: it changes the triangles of a surface, not its shape. Lengths are in metres.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

Field = Callable[[np.ndarray], np.ndarray]  # of points (n, 3)
PASSES = 14  # of subdivision, each halves the longest edges
RADIUS_EDGE = 1.4  # largest radius of a tetrahedron's sphere over its shortest edge
DIHEDRAL = 5.0  # smallest angle between faces of a tetrahedron [degrees]


def edges_of(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the edges (e, 2) of triangles, lower vertex first, and which three each triangle has, (t, 3)."""
    each = np.sort(np.stack([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]], axis=1).reshape(-1, 2), axis=1)
    edges, of_face = np.unique(each, axis=0, return_inverse=True)
    return edges, of_face.reshape(-1, 3)


def subdivide(vertices: np.ndarray, faces: np.ndarray, size: Field) -> tuple[np.ndarray, np.ndarray]:
    """Split edges at their middles until none is longer than `size` there.

    Parameters
    ----------
    vertices : array (v, 3) [m]
    faces : array (t, 3)
    size : function of points (n, 3)
        Largest length of an edge [m] with its middle there.

    Returns
    -------
    vertices, faces : arrays
    """
    vertices, faces = np.array(vertices, float), np.array(faces)
    for _ in range(PASSES):
        edges, of_face = edges_of(faces)
        middle = vertices[edges].mean(axis=1)
        length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
        split = length > size(middle)
        if not split.any():
            break
        _add_longest(split, length, of_face)
        new = np.full(len(edges), -1)
        new[split] = len(vertices) + np.arange(split.sum())
        vertices = np.concatenate([vertices, middle[split]])
        faces = _cut(vertices, faces, new[of_face])
    return vertices, faces


def _add_longest(split: np.ndarray, length: np.ndarray, of_face: np.ndarray) -> None:
    """Mark the longest edge of every triangle that has a marked edge, too: so angles do not degrade."""
    longest = of_face[np.arange(len(of_face)), np.argmax(length[of_face], axis=1)]
    while True:
        need = longest[split[of_face].any(axis=1)]
        if split[need].all():
            return
        split[need] = True


def level_split(
    vertices: np.ndarray, faces: np.ndarray, level: Field, snap: float = 0.25
) -> tuple[np.ndarray, np.ndarray]:
    """Split triangles along the zeros of `level`.

    Parameters
    ----------
    vertices : array (v, 3) [m]
    faces : array (t, 3)
    level : function of points (n, 3)
    snap : float
        A vertex nearer to the zero than this share of an edge slides onto it instead.

    Returns
    -------
    vertices, faces : arrays
    """
    vertices = vertices.copy()
    value = level(vertices)
    edges = edges_of(faces)[0]
    for a, b in edges[value[edges[:, 0]] * value[edges[:, 1]] < 0]:
        if value[a] * value[b] >= 0:
            continue
        t = value[a] / (value[a] - value[b])
        if t < snap:
            vertices[a] = vertices[a] + t * (vertices[b] - vertices[a])
            value[a] = 0.0
        elif t > 1 - snap:
            vertices[b] = vertices[a] + t * (vertices[b] - vertices[a])
            value[b] = 0.0
    value[np.abs(value) < 1e-12] = 0.0
    edges, of_face = edges_of(faces)
    first, second = edges.T
    cross = value[first] * value[second] < 0
    first, second = first[cross], second[cross]
    t = value[first] / (value[first] - value[second])
    new = np.full(len(edges), -1)
    new[cross] = len(vertices) + np.arange(cross.sum())
    vertices = np.concatenate([vertices, vertices[first] + t[:, None] * (vertices[second] - vertices[first])])
    return vertices, _cut(vertices, faces, new[of_face])


def _cut(vertices: np.ndarray, faces: np.ndarray, middles: np.ndarray) -> np.ndarray:
    """Replace triangles by those between their corners and the new vertices (-1: none) on their edges."""
    inside = faces[(middles < 0).all(axis=1)]
    some = (middles >= 0).any(axis=1)
    out = []
    for (a, b, c), (ab, bc, ca) in zip(faces[some].tolist(), middles[some].tolist(), strict=True):
        count = (ab >= 0) + (bc >= 0) + (ca >= 0)
        if count == 3:
            out += [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
            continue
        while not (ab >= 0 and (count == 1 or bc >= 0)):  # turn it so that ab is split, and for two, bc also
            a, b, c, ab, bc, ca = b, c, a, bc, ca, ab
        if count == 1:
            out += [(a, ab, c), (ab, b, c)]
            continue
        out.append((ab, b, bc))
        if np.linalg.norm(vertices[a] - vertices[bc]) < np.linalg.norm(vertices[ab] - vertices[c]):
            out += [(a, ab, bc), (a, bc, c)]
        else:
            out += [(a, ab, c), (ab, bc, c)]
    return np.concatenate([inside, np.array(out, inside.dtype)]) if out else inside


def collapse_short(vertices: np.ndarray, faces: np.ndarray, least: float) -> tuple[np.ndarray, np.ndarray]:
    """Join the ends of edges shorter than `least` [m] at their middles, as far as the surface stays a manifold.

    Isosurfaces have triangles thousands of times smaller than their grid, which elements cannot be built on.
    """
    vertices, faces = np.array(vertices, float), np.array(faces)
    while True:
        edges = edges_of(faces)[0]
        length = np.linalg.norm(vertices[edges[:, 0]] - vertices[edges[:, 1]], axis=1)
        short = np.flatnonzero(length < least)
        neighbours: list[set[int]] = [set() for _ in vertices]
        for a, b in edges.tolist():
            neighbours[a].add(b)
            neighbours[b].add(a)
        target, touched = np.arange(len(vertices)), set()
        for a, b in edges[short[np.argsort(length[short])]].tolist():
            around = neighbours[a] | neighbours[b]
            if around & touched or len(neighbours[a] & neighbours[b]) != 2:
                continue
            target[b] = a
            vertices[a] = 0.5 * (vertices[a] + vertices[b])
            touched |= around
        if not touched:
            break
        faces = target[faces]
        faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    used, faces = np.unique(faces, return_inverse=True)
    return vertices[used], faces.reshape(-1, 3)


def tetrahedra(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return points (n, 3) and tetrahedra (m, 4) inside a closed surface, whose triangles stay as they are."""
    from tetgen import TetGen

    mesher = TetGen(np.ascontiguousarray(vertices), np.ascontiguousarray(faces.astype(np.int32)))
    result = mesher.tetrahedralize(
        plc=True, quality=True, minratio=RADIUS_EDGE, mindihedral=DIHEDRAL, nobisect=True, verbose=0, quiet=True
    )
    return np.asarray(result[0]), np.asarray(result[1])


def icosphere(centre: np.ndarray, radius: float, level: int = 2) -> tuple[np.ndarray, np.ndarray]:
    """Return a subdivided icosahedron (20 times 4^level triangles) with the volume of a ball [m]."""
    import trimesh

    sphere = trimesh.creation.icosphere(subdivisions=level, radius=1.0)
    scale = radius * (4 / 3 * np.pi / sphere.volume) ** (1 / 3)
    return np.asarray(sphere.vertices) * scale + centre, np.asarray(sphere.faces)


def join(parts: Iterable[tuple[np.ndarray, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Return several surfaces as one."""
    vertices, faces, count = [], [], 0
    for v, f in parts:
        vertices.append(v)
        faces.append(f + count)
        count += len(v)
    return np.concatenate(vertices), np.concatenate(faces)


def graded(end: float, cells: int, power: float) -> np.ndarray:
    """Return places from 0 to `end` [m], the denser near 0 the higher the power."""
    return end * np.linspace(0, 1, cells + 1) ** power
