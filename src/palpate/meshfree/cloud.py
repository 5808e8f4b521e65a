"""Clouds of points: discretised bodies without a material.

A `Cloud` consists of arrays: positions, volumes and boundary faces of the points, and named groups
of points for loads.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.spatial import cKDTree

from palpate.core.arrays import Floats, Ints
from palpate.core.describe import Described, Fact
from palpate.core.faults import (
    CloudError,
    InputError,
    brief,
    first_few,
    integer_in_range,
    number_in_range,
    warn_of_unit,
)
from palpate.core.plotting import body_svg, plot_body
from palpate.meshfree.visibility import hidden_pairs

MAX_NODES = 5e7  # of a box
MAX_COORDINATE = 1e9  # [m] of a coordinate
MIN_SPACING = 1e-9  # [m]; beyond these limits volumes and stiffnesses exceed the range of double precision
MIN_VOLUME_RATIO = 1e-12  # of the smallest cell: volume of a node
# widths beyond the border of a region, in spacings, in which nodes belong to its group: of supports, and of small
# regions that a tool moves (docs/claims/elements.md)
BORDER_MARGIN, MOVED_MARGIN = 0.2, 0.3
LATTICE_TOLERANCE = 1e-6  # of the distances of a lattice's nodes, in spacings
EXPECTED_SIZES = 1e-4, 10.0  # [m] of a body; other sizes are probably not in metres


@dataclass(frozen=True)
class Cloud(Described):
    """Nodes of a body with their volumes and surface areas.

    Parameters
    ----------
    points : (n, d) array [m]
        Reference positions, d = 2 or 3.
    volumes : (n,) array [m^3; m^2 in the plane]
        Nodal volumes; they sum to the volume of the body.
    face_nodes : (m,) array
        One entry for every pair of a boundary node and a face it lies on: an edge node has two, a
        corner node three.
    face_normals : (m, d) array
        Unit outward normal of that face.
    face_areas : (m,) array [m^2]
        The node's share of that face's area.
    groups : mapping of str to (g,) arrays
        Named sets of nodes, in ascending order.
    triangles : (t, 3) array
        Surface triangles for drawing, seen from outside counter-clockwise.
    spacing : float [m]
        Typical distance between neighbouring nodes.

    Raises
    ------
    CloudError
        Arrays of inconsistent shapes, or values that are not finite.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> round(float(cloud.volumes.sum()), 9)
    6.75e-06
    >>> len(cloud.group("x+"))
    16
    >>> pressed = cloud.within("spot", (0.015, 0.0075, 0.015), radius=0.004)
    >>> len(pressed.group("spot"))
    2
    """

    points: Floats
    volumes: Floats
    face_nodes: Ints
    face_normals: Floats
    face_areas: Floats
    groups: Mapping[str, Ints]
    triangles: Ints
    spacing: float

    def __post_init__(self) -> None:
        n, d = self.points.shape if self.points.ndim == 2 else (0, 0)
        if d not in (2, 3) or n == 0:
            raise CloudError(f"points must have shape (n, 2) or (n, 3) with n > 0, got {self.points.shape}")
        bad = np.flatnonzero(~np.isfinite(self.points).all(axis=1))
        if bad.size:
            raise CloudError(f"points must be finite, got other values at nodes {first_few(bad)}", bad)
        far = np.flatnonzero(np.abs(self.points).max(axis=1) > MAX_COORDINATE)
        if far.size:
            raise CloudError(
                f"points must lie within {MAX_COORDINATE:g} m of the origin, got {self.points[far[0]]} at node "
                f"{far[0]}; "
                "give them in metres",
                far,
            )
        if not MIN_SPACING <= self.spacing <= MAX_COORDINATE:
            raise CloudError(f"spacing must be from {MIN_SPACING:g} to {MAX_COORDINATE:g} m, got {self.spacing:g} m")
        if self.volumes.shape != (n,) or not np.all(self.volumes > 0):
            raise CloudError("volumes must be positive and one for every point")
        least, most = MIN_VOLUME_RATIO * MIN_SPACING**d, MAX_COORDINATE**d
        if not np.all((self.volumes >= least) & (self.volumes <= most)):
            raise CloudError(f"volumes must be from {least:g} to {most:g} m^{d}; give sizes in metres")
        m = len(self.face_nodes)
        if self.face_normals.shape != (m, d) or self.face_areas.shape != (m,):
            raise CloudError("face_nodes, face_normals and face_areas must have one row for every node-face pair")
        if not (np.isfinite(self.face_normals).all() and np.isfinite(self.face_areas).all()):
            raise CloudError("face_normals and face_areas must be finite")
        if (
            np.abs(self.face_normals).max(initial=0.0) > 1 + 1e-6
            or self.face_areas.max(initial=0.0) > MAX_COORDINATE**2
        ):
            raise CloudError(f"face_normals must be unit vectors, and face_areas at most {MAX_COORDINATE**2:g} m^2")
        for name, nodes in (*self.groups.items(), ("face_nodes", self.face_nodes)):
            if (len(nodes) == 0 and name in self.groups) or np.any((nodes < 0) | (nodes >= n)):
                raise CloudError(f"group {name!r} must hold nodes in [0, {n - 1}], got none or others")

    def __len__(self) -> int:
        return len(self.points)

    def _facts(self) -> list[Fact]:
        d = self.points.shape[1]
        return [
            ("nodes", len(self), ""),
            ("size", tuple(np.ptp(self.points, axis=0).tolist()), "m"),
            ("spacing", float(self.spacing), "m"),
            ("volume" if d == 3 else "area", float(self.volumes.sum()), f"m^{d}"),
            ("surface nodes", len(np.unique(self.face_nodes)), "") if d == 3 else ("", None, ""),
            ("groups", list(self.groups), ""),
        ]

    def _picture(self) -> str:
        return body_svg(*self._surface())

    def _surface(self) -> tuple[Floats, Ints]:
        """Return the points of surface triangles, and the triangles; all points if there are no triangles."""
        if not len(self.triangles):
            return self.points, np.zeros((0, 3), dtype=np.int64)
        used, corners = np.unique(self.triangles, return_inverse=True)
        return self.points[used], corners.reshape(-1, 3)

    def plot(self, axes: Any = None) -> Any:
        """Draw the surface of the body.

        Parameters
        ----------
        axes : matplotlib.axes.Axes, optional
            In three dimensions; new ones by default.

        Returns
        -------
        matplotlib.axes.Axes

        Raises
        ------
        ImportError
            matplotlib is not installed.
        """
        points, triangles = self._surface()
        return plot_body(np.pad(points, ((0, 0), (0, 3 - points.shape[1]))), triangles, axes)

    def group(self, name: str) -> Ints:
        """Return the nodes of a named group.

        Raises
        ------
        InputError
            The cloud has no such group.
        """
        if not isinstance(name, str) or name not in self.groups:
            names = ", ".join(map(repr, sorted(self.groups)))
            raise InputError(
                f"group must be one of {names}, got {brief(name)}; choose one of them, or add it by within"
            )
        return self.groups[name]

    def within(self, name: str, centre: Sequence[float], radius: float, *, margin: float = BORDER_MARGIN) -> Cloud:
        """Return a copy with an additional group: the nodes in a ball about `centre`, shape (d,) [m].

        Parameters
        ----------
        name : str
        centre : (d,) sequence [m]
        radius : float [m]
        margin : float
            Width beyond the ball, in spacings, in which nodes belong to the group, too. What holds or moves
            the nodes then acts on the ball, and not on the last nodes inside it.

        Raises
        ------
        InputError
            The name exists, `centre` is not a point, `radius` is not positive, or no node is within
            it.
        """
        if name in self.groups:
            raise InputError(f"group must be a new name, got {name!r}, which exists; choose another name")
        point = np.array([number_in_range("centre", x, -MAX_COORDINATE, MAX_COORDINATE, unit="m") for x in centre])
        if len(point) != self.points.shape[1]:
            raise InputError(f"centre must have {self.points.shape[1]} entries, got {len(point)}")
        radius = number_in_range("radius", radius, 0.0, open_low=True, unit="m")
        distance = np.linalg.norm(self.points - point, axis=1)
        margin = number_in_range("margin", margin, 0.0)
        nodes = np.flatnonzero(distance <= radius * (1 + 1e-9) + margin * self.spacing)
        if nodes.size == 0:
            raise InputError(
                f"radius must reach a node from {point} m, got {radius:g} m; the nearest is {distance.min():.3g} m away"
            )
        return replace(self, groups={**self.groups, name: nodes})

    def with_group(self, name: str, nodes: Sequence[int] | Ints | NDArray[np.bool_]) -> Cloud:
        """Return a copy with an additional group of nodes, given by indices or a mask (n,).

        `palpate.in_box`, `palpate.near_plane` and `palpate.painted` return such nodes.

        Raises
        ------
        InputError
            The name exists, the group is empty, or indices or a mask do not match this cloud.
        """
        if name in self.groups:
            raise InputError(f"group must be a new name, got {name!r}, which exists; choose another name")
        indices = np.asarray(nodes)
        if indices.dtype == bool and indices.shape == (len(self),):
            indices = np.flatnonzero(indices)
        integers = indices.ndim == 1 and indices.size > 0 and np.issubdtype(indices.dtype, np.integer)
        if not integers or indices.min() < 0 or indices.max() >= len(self):
            raise InputError(f"group {name!r} must be nodes in [0, {len(self) - 1}], or a mask of shape ({len(self)},)")
        return replace(self, groups={**self.groups, name: np.unique(indices).astype(np.int64)})

    def boundary_vectors(self) -> Floats:
        """Return sum over a node's faces of (area / volume) times normal, shape (n, d) [1/m].

        It is c/h N in the half-cell balance: c = 2 on a flat face of a lattice. It is zero inside
        the body.
        """
        vectors = np.zeros_like(self.points)
        np.add.at(vectors, self.face_nodes, self.face_areas[:, None] * self.face_normals)
        return vectors / self.volumes[:, None]

    @cached_property
    def is_lattice(self) -> bool:
        """Whether all nodes are equally far from their nearest neighbours, as those of `box` without jitter."""
        nearest = cKDTree(self.points).query(self.points, k=2)[0][:, 1]
        return bool(np.ptp(nearest) < LATTICE_TOLERANCE * self.spacing)

    @cached_property
    def hidden(self) -> csr_array:
        """Pairs of near nodes (n, n) with the outside between them, as across a cleft; stencils omit them."""
        if self.points.shape[1] == 2 or not len(self.triangles):
            return csr_array((len(self), len(self)), dtype=bool)
        return hidden_pairs(self.points, self.boundary_vectors() * self.volumes[:, None], self.triangles, self.spacing)

    def area_vectors(self, name: str) -> Floats:
        """Return each node's share [m^2] of the face that group `name` lies on, times its normal, shape (g, d).

        Raises
        ------
        InputError
            The group's nodes do not lie on one common face.
        """
        nodes = self.group(name)
        pairs = np.isin(self.face_nodes, nodes)
        normals = self.face_normals[self.face_nodes == nodes[len(nodes) // 2]]
        # a flat face has one normal; that of a curved face may vary, unless this includes adjacent faces
        for near, normal in product((1 - 1e-9, 0.5), normals):
            same = pairs & (self.face_normals @ normal > near)
            if np.array_equal(np.unique(self.face_nodes[same]), nodes):
                vectors = np.zeros_like(self.points)
                np.add.at(vectors, self.face_nodes[same], self.face_areas[same, None] * self.face_normals[same])
                return vectors[nodes]
        raise InputError(f"group {name!r} must lie on one face of the surface to carry a surface load")


def warn_of_size(points: Floats) -> None:
    """Warn of a body so large or small that its size was probably not given in metres."""
    low, high = EXPECTED_SIZES
    size = float(np.ptp(points, axis=0).max())
    warn_of_unit("the size of a body", size, low, high, "m", "lengths are in metres")


def box(size: Sequence[float], spacing: float, jitter: float = 0.0, seed: int = 0) -> Cloud:
    """Fill a box (a rectangle, for two sizes) with a lattice of nodes, faces included.

    Parameters
    ----------
    size : (d,) sequence [m]
        Edge lengths; the box reaches from the origin to `size`.
    spacing : float [m]
        Target distance between nodes; each edge gets the nearest whole number of cells, at least 3.
    jitter : float
        Random displacement of every node as a share of the spacing, in [0, 0.3]. Nodes stay on
        their faces and edges; corners do not move.
    seed : int
        Seed of the random displacements.

    Returns
    -------
    Cloud
        Groups ``"x-"``, ``"x+"``, ``"y-"`` ... are the faces. A node's volume is that of its cell:
        half a cell on a face, a quarter on an edge, an eighth in a corner.

    Raises
    ------
    InputError
        A size or spacing that is not positive, or a spacing that gives fewer than 4 nodes across.

    Warns
    -----
    UnitWarning
        A box of more than 10 m or less than 0.1 mm: sizes are in metres.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.2, 0.02, 0.02), spacing=0.005)
    >>> len(cloud.points), sorted(cloud.groups)
    (1025, ['x+', 'x-', 'y+', 'y-', 'z+', 'z-'])
    """
    d = len(size)
    if d not in (2, 3):
        raise InputError(f"size must have 2 or 3 entries, got {d}")
    lengths = np.array([number_in_range("size", s, 0.0, MAX_COORDINATE, open_low=True, unit="m") for s in size])
    spacing = number_in_range("spacing", spacing, MIN_SPACING, MAX_COORDINATE, unit="m")
    jitter = number_in_range("jitter", jitter, 0.0, 0.3)
    seed = integer_in_range("seed", seed, 0)
    wished = np.rint(lengths / spacing)
    count = np.prod(wished + 1)
    if np.any(wished < 3):
        raise InputError(
            f"spacing must give at least 4 nodes across the side of {lengths.min():g} m, got {spacing:g} m "
            f"({wished.min() + 1:.0f} nodes); use at most {lengths.min() / 3:g} m"
        )
    if count > MAX_NODES:
        raise InputError(f"spacing must give at most {MAX_NODES:.0e} nodes, got {spacing:g} m ({count:.2g} nodes)")
    warn_of_size(np.array([np.zeros(d), lengths]))
    cells = wished.astype(int)
    step = lengths / cells
    axes = [np.linspace(0.0, lengths[a], cells[a] + 1) for a in range(d)]
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, d)
    index = np.stack(np.meshgrid(*[np.arange(c + 1) for c in cells], indexing="ij"), axis=-1).reshape(-1, d)
    low, high = index == 0, index == cells
    halves = np.where(low | high, 0.5, 1.0) * step
    points += np.where(low | high, 0.0, jitter * step * np.random.default_rng(seed).uniform(-1, 1, points.shape))

    groups, nodes, normals, areas = {}, [], [], []
    for a, (side, on) in product(range(d), (("-", low), ("+", high))):
        members = np.flatnonzero(on[:, a])
        groups["xyz"[a] + side] = members
        nodes.append(members)
        normals.append(np.tile(np.eye(d)[a] * (1 if side == "+" else -1), (len(members), 1)))
        areas.append(np.prod(np.delete(halves[members], a, axis=1), axis=1))
    return Cloud(
        points=points,
        volumes=np.prod(halves, axis=1),
        face_nodes=np.concatenate(nodes),
        face_normals=np.concatenate(normals),
        face_areas=np.concatenate(areas),
        groups=groups,
        triangles=_box_triangles(cells),
        spacing=float(step.mean()),
    )


def _box_triangles(cells: Ints) -> Ints:
    """Return two triangles for every cell of the faces of a lattice, or of a plane lattice."""
    number = np.arange(np.prod(cells + 1)).reshape(cells + 1)
    if len(cells) == 2:
        return _sheet_triangles(number)
    sheets = []
    for a in range(3):
        for end in (0, -1):
            sheet = np.take(number, end, axis=a)
            # np.take keeps the order of the two other axes; their cross product is +a for a = 0, 2 and -a for a = 1
            outward = (end == -1) == (a != 1)
            sheets.append(_sheet_triangles(sheet if outward else sheet.T))
    return np.concatenate(sheets)


def _sheet_triangles(number: Ints) -> Ints:
    a, b = number[:-1, :-1].ravel(), number[1:, :-1].ravel()
    c, d = number[1:, 1:].ravel(), number[:-1, 1:].ravel()
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
