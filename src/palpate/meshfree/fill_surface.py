"""Nodes in a closed surface: on it by remeshing, inside from a lattice, with the volumes of Voronoi cells."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from palpate.core.arrays import Floats
from palpate.core.faults import CloudError, InputError, first_few, number_in_range
from palpate.meshfree.cloud import Cloud, warn_of_size
from palpate.meshfree.gate import STENCIL_NODES, faulty_nodes
from palpate.meshfree.relaxing import (
    MIN_DEPTH,
    DepthQuery,
    body_centred_lattice,
    cubic_lattice,
    relax,
    scattered_inside,
    voronoi_volumes,
)
from palpate.meshfree.visibility import is_pair
from palpate.surface.checks import check_surface
from palpate.surface.nesting import body_numbers, enclosures
from palpate.surface.refining import refine_surface
from palpate.surface.remeshing import SurfaceNodes, remesh
from palpate.surface.surface import (
    Surface,
    components,
    part_centroids,
    part_volumes,
    select_triangles,
    vertex_components,
)

Region = tuple[Sequence[float], float, float]  # centre [m], radius [m], spacing [m]

SURFACE_SPACING = 0.8  # distance of surface nodes, in spacings
MAX_EDGE = 0.42  # longest edge of the refined surface, in spacings
SPACING_GROWTH = 0.35  # growth of the spacing with the distance from a refined region
MAX_NODES = 500_000
MAX_REPAIRS = 4  # rounds of removing nodes that the stencil check rejects
MIN_INTERIOR_NODES = 40
BODY_PREFIX = "body"  # beginning of the names of groups, of several bodies
MIN_CAVITY_DIAMETER = 2.0  # in spacings; smaller cavities are filled


def fill_surface(
    body: Surface, spacing: float, *, lattice: str = "bcc", refine: Sequence[Region] = (), seed: int = 0
) -> Cloud:
    """Fill a surface, whose vertices are joined, with nodes; see `palpate.fill`."""
    sizing = Sizing.of(spacing, refine)
    report = check_surface(body)
    if report.errors:
        problems = "; ".join(problem.what for problem in report.errors)
        raise InputError(f"{body.name} must be a closed surface of a solid body; {problems}")
    body = _without_small_cavities(body, sizing)
    _check_size(body, spacing, sizing)
    warn_of_size(body.vertices)
    vertices, triangles = refine_surface(body.vertices, body.triangles, lambda points: MAX_EDGE * sizing(points))
    inside = DepthQuery.of(vertices, triangles)
    nodes = remesh(vertices, triangles, SURFACE_SPACING * sizing(vertices), seed)
    inner = _interior_nodes(body, inside, nodes, sizing, lattice if not refine else "scattered", seed)
    cloud = _repair_cloud(body, inside, nodes, inner, sizing)
    return _label_bodies(body, inside, cloud)


@dataclass(frozen=True)
class Sizing:
    """Target spacing as a function of position."""

    spacing: float  # [m]: spacing far from all regions
    regions: tuple[Region, ...] = ()  # tuple of (centre, radius, spacing)

    @classmethod
    def of(cls, spacing: float, refine: Sequence[Region]) -> Sizing:
        """Return the sizing of a spacing and checked regions."""
        regions = []
        for k, region in enumerate(refine):
            if len(region) != 3 or np.shape(region[0]) != (3,):
                raise InputError(
                    f"refine[{k}] must be (centre, radius, spacing) with a centre of three coordinates [m]"
                )
            centre = tuple(number_in_range(f"refine[{k}] centre", x, unit="m") for x in region[0])
            radius = number_in_range(f"refine[{k}] radius", region[1], 0.0, unit="m")
            finer = number_in_range(f"refine[{k}] spacing", region[2], spacing / 8, spacing, unit="m")
            regions.append((centre, radius, finer))
        return cls(spacing, tuple(regions))

    @property
    def min_spacing(self) -> float:
        """Smallest spacing [m]."""
        return min([self.spacing, *(finer for _, _, finer in self.regions)])

    def __call__(self, points: Floats) -> Floats:
        """Return the target spacing [m] at points (k, 3)."""
        wished = np.full(len(points), self.spacing)
        for centre, radius, finer in self.regions:
            away = np.maximum(np.linalg.norm(points - np.array(centre), axis=1) - radius, 0.0)
            wished = np.minimum(wished, finer + SPACING_GROWTH * away)
        return wished


def _without_small_cavities(body: Surface, sizing: Sizing) -> Surface:
    """Return the body without cavities that are finer than the spacing; warn of them."""
    label = components(body)
    volumes = part_volumes(body, label)
    area = np.bincount(label, np.linalg.norm(body.area_vectors, axis=1))
    local = sizing(part_centroids(body, label))
    small = (volumes < 0) & (
        6 * np.abs(volumes) < MIN_CAVITY_DIAMETER * local * area
    )  # 6 V / A of a ball: its diameter
    if not small.any():
        return body
    warnings.warn(
        f"cavities finer than the spacing are filled with tissue: {int(small.sum())} of together "
        f"{1e6 * np.abs(volumes[small]).sum():.3g} ml in {body.name}; use a smaller spacing to keep them",
        stacklevel=4,
    )
    small |= enclosures(body, label)[:, small].any(axis=1)  # with what is inside them
    return select_triangles(body, ~small[label])


def _label_bodies(body: Surface, inside: DepthQuery, cloud: Cloud) -> Cloud:
    """Return the cloud with a group for each of several bodies; check that their stencils do not overlap."""
    label = components(body)
    enclosed = enclosures(body, label)
    bodies = body_numbers(enclosed)
    if bodies.max() == 0:
        return cloud
    # a refined vertex has the component of the body's triangle next to it; no wall lies between a node and its nearest
    wall = vertex_components(inside.triangles, len(inside.vertices))
    component = np.zeros(int(wall.max()) + 1, dtype=np.int64)
    component[wall[body.triangles[:, 0]]] = label  # the first refined vertices are those of the body
    owner = bodies[component[wall[inside.tree.query(cloud.points, workers=-1)[1]]]]
    # stencils reach farther where they omit nodes
    near = cKDTree(cloud.points).query(cloud.points, k=min(2 * STENCIL_NODES, len(cloud)), workers=-1)[1]
    seen = ~is_pair(cloud.hidden, np.repeat(np.arange(len(cloud)), near.shape[1]), near.ravel()).reshape(near.shape)
    mixed = np.flatnonzero((seen & (owner[near] != owner[:, None])).any(axis=1))
    if mixed.size:
        raise CloudError(
            f"spacing must be finer for the {int(bodies.max()) + 1} separate bodies of {body.name}, got "
            f"{cloud.spacing:g} m: stencils of {len(mixed)} nodes would reach from one to another, the first at "
            f"{cloud.points[mixed[0]]} m; use a finer spacing, or choose one body",
            mixed,
        )
    for k in range(int(bodies.max()) + 1):
        cloud = cloud.with_group(f"{BODY_PREFIX} {k}", owner == k)
    return cloud


def _check_size(body: Surface, spacing: float, sizing: Sizing) -> None:
    """Check that a spacing gives a feasible number of nodes, before expensive steps."""
    across = 2 * abs(body.volume) / body.area
    expected = abs(body.volume) / spacing**3 + body.area / (0.55 * spacing**2)
    for _, radius, finer in sizing.regions:
        expected += 4.2 * radius**3 / finer**3
    if expected > MAX_NODES:
        raise InputError(
            f"spacing must give at most {MAX_NODES} nodes, got {spacing:g} m (about {expected:.2g} nodes); "
            f"use at least {spacing * (expected / MAX_NODES) ** (1 / 3):.2g} m"
        )
    if abs(body.volume) < MIN_INTERIOR_NODES * spacing**3:
        raise CloudError(
            f"spacing must be at most {across / 5:.2g} m, got {spacing:g} m; it is too coarse for a body of "
            f"{1e3 * abs(body.volume):.3g} litres, {1e3 * across:.3g} mm thick on average"
        )


def _interior_nodes(
    body: Surface, inside: DepthQuery, nodes: SurfaceNodes, sizing: Sizing, lattice: str, seed: int
) -> Floats:
    """Return relaxed interior nodes."""
    if lattice == "scattered":
        points = scattered_inside(inside, sizing.min_spacing, sizing, seed)
    else:
        points = (body_centred_lattice if lattice == "bcc" else cubic_lattice)(inside, sizing.spacing)
    points = points[inside.depth(points, sizing.spacing)[0] >= MIN_DEPTH * sizing(points)]
    if len(points) < MIN_INTERIOR_NODES:
        thickness = 2 * body.volume / body.area
        raise CloudError(
            f"spacing must leave at least {MIN_INTERIOR_NODES} nodes inside the body, got {sizing.spacing:g} m "
            f"({len(points)} nodes, walls {1e3 * thickness:.2g} mm thick on average); use at most "
            f"{0.4 * thickness:.2g} m"
        )
    return relax(points, nodes.points, sizing(points), sizing(nodes.points), inside)


def _repair_cloud(body: Surface, inside: DepthQuery, nodes: SurfaceNodes, inner: Floats, sizing: Sizing) -> Cloud:
    """Return a cloud that passes the stencil check, without the interior nodes that fail it."""
    for _ in range(MAX_REPAIRS):
        cloud = _cloud(body, inside, nodes, inner, sizing)
        bad, why = faulty_nodes(cloud)
        if not len(bad):
            return cloud
        spoilt = bad[bad >= len(nodes.points)] - len(nodes.points)
        if not len(spoilt):
            break
        inner = np.delete(inner, spoilt, axis=0)
        inner = relax(inner, nodes.points, sizing(inner), sizing(nodes.points), inside)
    raise CloudError(
        f"spacing must be finer for {body.name}, got {sizing.spacing:g} m: {why} at nodes {first_few(bad)}, the first "
        f"at {cloud.points[bad[0]]} m, where the body is thin; use a finer spacing, or refine near it"
    )


def _cloud(body: Surface, inside: DepthQuery, nodes: SurfaceNodes, inner: Floats, sizing: Sizing) -> Cloud:
    points = np.concatenate([nodes.points, inner])
    s = len(nodes.points)
    volumes = voronoi_volumes(points, inside, sizing.min_spacing)
    # a node on a sharp edge may not be the nearest one of any sample
    volumes = np.maximum(volumes, 0.02 * sizing(points) ** 3)
    sizes = np.linalg.norm(nodes.vectors, axis=1)
    return Cloud(
        points=points,
        volumes=volumes * (body.volume / volumes.sum()),
        face_nodes=np.arange(s),
        face_normals=nodes.vectors / sizes[:, None],
        face_areas=sizes,
        groups={"surface": np.arange(s), "inside": np.arange(s, len(points))},
        triangles=nodes.triangles,
        spacing=sizing.spacing,
    )
