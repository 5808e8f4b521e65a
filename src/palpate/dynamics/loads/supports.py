"""Supports: groups of nodes that cannot move in some directions (equation 5).

A kind of support is a class with the directions that it constrains. Models work with the directions of every
node, so that no other module depends on the kind.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, ClassVar, NamedTuple

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from palpate.core.arrays import Floats, Ints
from palpate.core.describe import Described
from palpate.core.faults import InputError, brief
from palpate.meshfree.cloud import Cloud
from palpate.meshfree.mirror import MirrorPlane

FREE, FIXED, PRESCRIBED, SLIDING = 0, 1, 2, 3  # kinds of nodes
SAME_DIRECTION = 1e-6  # sine of the angle below which two directions are one


@dataclass(frozen=True)
class Support(Described, ABC):
    """A group of nodes that cannot move in some directions.

    Parameters
    ----------
    group : str

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed=["x-", pt.Roller("y-")])
    >>> all(isinstance(support, pt.typing.Support) for support in bar.supports)
    True
    >>> [type(support).__name__ for support in bar.supports]
    ['Clamp', 'Roller']
    """

    kinds: ClassVar[dict[str, type[Support]]] = {}
    group: str

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        Support.kinds[cls.__name__] = cls

    @abstractmethod
    def directions(self, cloud: Cloud) -> Floats:
        """Return orthonormal directions (k, 3) in which the nodes cannot move."""

    @property
    def label(self) -> str:
        """The group, with the kind of support unless it is a clamp."""
        return self.group if isinstance(self, Clamp) else f"{self.group} ({type(self).__name__.lower()})"

    def values(self) -> dict[str, Any]:
        """Return the kind and the parameters, as names, numbers and lists."""
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return {"kind": type(self).__name__} | {k: list(v) if isinstance(v, tuple) else v for k, v in values.items()}


@dataclass(frozen=True)
class Clamp(Support):
    """A group that cannot move."""

    def directions(self, cloud: Cloud) -> Floats:
        return np.eye(3)


@dataclass(frozen=True)
class Roller(Support):
    """A group that slides freely in a plane.

    Parameters
    ----------
    group : str
    normal : (3,) sequence, optional
        Normal of the plane, of any length; by default the mean normal of the face that the group forms.

    Raises
    ------
    InputError
        The normal is zero or not finite; or none is given, and the group does not form a face.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> rollers = [pt.Roller("x-"), pt.Roller("y-"), pt.Roller("z-")]
    >>> bar = pt.Solid(cloud, tissue, fixed=rollers)
    >>> rest = pt.equilibrium(bar, [pt.SurfaceForce("x+", force=(0.2, 0, 0))])
    >>> bool(abs(rest.displacements[cloud.group("y-"), 1]).max() < 1e-12)
    True
    >>> bool(rest.displacements[cloud.group("y+"), 1].max() < 0)
    True
    """

    normal: Sequence[float] | None = None

    def __post_init__(self) -> None:
        if self.normal is not None:
            _keep_direction(self, "normal")

    def directions(self, cloud: Cloud) -> Floats:
        if self.normal is not None:
            return np.array(self.normal)[None] / np.linalg.norm(self.normal)
        try:
            mean = cloud.area_vectors(self.group).sum(axis=0)
        except InputError:
            mean = np.zeros(3)
        if mean.shape != (3,) or not np.linalg.norm(mean):
            raise InputError(f"normal of Roller on {self.group!r} must be given, as the group does not form a face")
        return np.asarray(mean / np.linalg.norm(mean))[None]


@dataclass(frozen=True)
class SymmetryPlane(Roller):
    """A group in a plane of symmetry, in which it slides freely.

    The stencils of the body contain its mirror images, so that the body moves as one part of the whole
    one. Loads and tools act on this part and, mirrored, on the images. Several planes must be at right
    angles. Solids take planes of symmetry.

    Parameters
    ----------
    group : str
        All nodes in the plane.
    normal : (3,) sequence, optional
        As for `Roller`.

    Raises
    ------
    InputError
        As for `Roller`.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed=["x-", pt.SymmetryPlane("y-")])
    >>> [plane.name for plane in bar.planes]
    ['y-']
    """


def symmetry_planes(cloud: Cloud, supports: Sequence[Support]) -> tuple[MirrorPlane, ...]:
    """Return the planes of symmetry among supports."""
    planes = [support for support in supports if isinstance(support, SymmetryPlane)]
    return tuple(MirrorPlane(each.group, cloud.group(each.group), each.directions(cloud)[0]) for each in planes)


@dataclass(frozen=True)
class Rail(Support):
    """A group that slides freely along a line.

    Parameters
    ----------
    group : str
    axis : (3,) sequence
        Direction of the line, of any length.

    Raises
    ------
    InputError
        The axis is zero or not finite.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed=["x-", pt.Rail("x+", axis=(1, 0, 0))])
    >>> rest = pt.equilibrium(bar, [pt.Gravity((0, 0, -9.81))])
    >>> bool(abs(rest.displacements[cloud.group("x+"), 1:]).max() < 1e-12)
    True
    """

    axis: Sequence[float]

    def __post_init__(self) -> None:
        _keep_direction(self, "axis")

    def directions(self, cloud: Cloud) -> Floats:
        return np.asarray(np.linalg.svd(np.array(self.axis)[None])[2][1:])


def _keep_direction(support: Support, name: str) -> None:
    """Store a direction as a tuple of floats; raise `InputError` if it is zero or not finite."""
    value = getattr(support, name)
    try:
        vector = np.array(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        vector = np.zeros(0)
    if vector.shape != (3,) or not 0.0 < float(np.linalg.norm(vector)) < np.inf:
        raise InputError(
            f"{name} of {type(support).__name__} on {support.group!r} must be three finite numbers that are not all 0, "
            f"got {brief(value)}"
        )
    object.__setattr__(support, name, tuple(vector.tolist()))


def supports_of(fixed: str | Support | Iterable[str | Support]) -> tuple[Support, ...]:
    """Return the supports of the argument `fixed` of a model, whose group names are clamps."""
    entries = (fixed,) if isinstance(fixed, str | Support) else tuple(fixed)
    supports = []
    for entry in entries:
        if not isinstance(entry, str | Support):
            raise InputError(f"fixed must list group names and supports such as Roller('y-'), got {brief(entry)}")
        supports.append(Clamp(entry) if isinstance(entry, str) else entry)
    names = [support.group for support in supports]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"fixed must name each group once, got {name!r} {names.count(name)} times; keep one")
    return tuple(supports)


def support_from(values: Mapping[str, Any]) -> Support:
    """Return the support of `Support.values`, as a file has them."""
    record = dict(values)
    name = record.pop("kind", None)
    kind = Support.kinds.get(name) if isinstance(name, str) else None
    if kind is None or record.keys() != {field.name for field in fields(kind)} or not isinstance(record["group"], str):
        raise InputError(f"support must be one of {', '.join(Support.kinds)} with its parameters, got {brief(values)}")
    return kind(**record)


class SupportedNodes(NamedTuple):
    """Constraints of the nodes by supports."""

    kind: NDArray[np.uint8]  # (n,) array: FREE, FIXED or SLIDING
    sliding: NDArray[np.int64]  # (r,) array: nodes that slide
    slide: Floats  # (r, 3, 3) array: their projections on the directions in which they are free

    def project(self, field: Floats) -> Floats:
        """Remove the constrained components of a field (n, 3) or fields (..., n, 3) in place, and return it."""
        field[..., self.kind == FIXED, :] = 0.0
        if len(self.sliding):
            field[..., self.sliding, :] = np.einsum("rcd,...rd->...rc", self.slide, field[..., self.sliding, :])
        return field


def supported_nodes(cloud: Cloud, supports: Sequence[Support]) -> SupportedNodes:
    """Return the constraints of the nodes of a cloud; directions of several supports at a node add up."""
    kind = np.full(len(cloud), FREE, dtype=np.uint8)
    by_node: dict[int, list[Floats]] = {}
    for support in supports:
        nodes, directions = cloud.group(support.group), support.directions(cloud)
        if len(directions) == 3:
            kind[nodes] = FIXED
            continue
        for node in nodes:
            by_node.setdefault(int(node), []).append(directions)
    sliding, slide = [], []
    for node, spans in sorted(by_node.items()):
        _, sizes, rows = np.linalg.svd(np.concatenate(spans))
        held_directions = rows[: np.count_nonzero(sizes > SAME_DIRECTION)]
        if len(held_directions) == 3:
            kind[node] = FIXED
        elif kind[node] == FREE:
            kind[node] = SLIDING
            sliding.append(node)
            slide.append(np.eye(3) - held_directions.T @ held_directions)
    return SupportedNodes(kind, np.array(sliding, dtype=np.int64), np.array(slide).reshape(-1, 3, 3))


def constrained_directions(cloud: Cloud, supports: Sequence[Support]) -> dict[str, Floats]:
    """Return the directions (k, 3) of the supports that leave their groups free in others."""
    by_group = {support.group: support.directions(cloud) for support in supports}
    return {group: directions for group, directions in by_group.items() if len(directions) < 3}


def free_rigid_motions(points: Floats, constrain: Callable[[Floats], Floats]) -> int:
    """Return the number of independent rigid motions, at most 6, that constraints leave to a body of points (n, d) [m].

    `constrain` removes the constrained parts of fields (..., n, 3) in place, and returns them.
    """
    arms = np.pad(points - points.mean(axis=0), ((0, 0), (0, 3 - points.shape[1])))
    arms /= np.abs(arms).max(initial=1e-300)
    fields = np.array(
        [np.broadcast_to(axis, arms.shape) for axis in np.eye(3)] + [np.cross(a, arms) for a in np.eye(3)]
    )
    blocked = (fields - constrain(fields.copy())).reshape(6, -1)
    return 6 - int(np.linalg.matrix_rank(blocked @ blocked.T, hermitian=True))


def free_directions(nodes: SupportedNodes, held: Ints | None = None) -> tuple[Any, Ints]:
    """Return an orthonormal basis (3 n, f) of the displacements that supports allow, and numbers (f,) of its columns.

    Rows are 3 i + c of node i; numbers are 3 i + k, ascending. There k is the axis of a node without supports, and
    counts the free directions of a sliding node. Nodes `held` do not move in addition.
    """
    kind = nodes.kind.copy()
    if held is not None:
        kind[held] = FIXED
    n, free = len(kind), np.flatnonzero(kind == FREE)
    rows = [(3 * free[:, None] + np.arange(3)).ravel()]
    columns, values = [rows[0]], [np.ones(rows[0].size)]
    for node, projection in zip(nodes.sliding, nodes.slide, strict=True):
        if kind[node] == SLIDING:
            squares, axes = np.linalg.eigh(projection)
            for k, axis in enumerate(axes.T[squares > 0.5]):
                rows.append(3 * node + np.arange(3))
                columns.append(np.full(3, 3 * node + k))
                values.append(axis)
    places, order = np.unique(np.concatenate(columns), return_inverse=True)
    entries = (np.concatenate(values), (np.concatenate(rows), order))
    return sparse.csc_matrix(entries, (3 * n, len(places))), places
