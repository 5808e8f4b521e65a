"""A coarser model of a body, for its vibration modes and the statics of its surface.

The surface that the boundary triangles of a body's cloud form is filled again with a larger spacing. Each node of the
new cloud takes the properties of the nearest node of the old one, surface nodes from surface nodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from palpate.core.arrays import Ints
from palpate.core.faults import CloudError, InputError, number_in_range
from palpate.dynamics.loads.supports import Roller, Support
from palpate.dynamics.nodal.model import NodalModel
from palpate.dynamics.solid.base import Solid
from palpate.dynamics.solid.model import EnergySolid
from palpate.meshfree.cloud import Cloud
from palpate.meshfree.fill_surface import fill_surface
from palpate.reduction.contact.residual_flexibility import MAX_NODES
from palpate.surface.surface import Surface, weld

COARSE_NODES = 3000  # of the coarser body: factorised in seconds, and fine enough for modes and statics
SURFACE_SHARE = 0.95  # surface nodes of `fill` over area / spacing^2, less the inner ones that they replace
FINER_FACTOR = 0.9  # factor on a spacing that is too coarse for thin parts of the body


def coarse_body(body: Solid, spacing: float | None = None, most: int = MAX_NODES) -> EnergySolid:
    """Return a model of the same body with a larger spacing [m], by default that of about 3,000 nodes.

    It is smaller where the body has thin parts. `most` is the largest number of nodes. The boundary triangles of the
    body's cloud form a closed surface, as `palpate.fill` and `palpate.box` return them.

    The law, regions, fibres, stiffness factors, density, relaxation and damping are those of the nearest nodes. So are
    the groups, hence supports and foundations; a group that is smaller than the new spacing takes the nearest new
    nodes.
    """
    cloud = body.cloud
    try:
        if body.planes:
            raise InputError("planes of symmetry cut the surface")
        if isinstance(body, EnergySolid) and len(body.cut_surface.triangles):
            raise InputError("the body is cut")
        if not len(cloud.triangles):
            raise InputError("its cloud has no boundary triangles")
        coarse = _refill(Surface(cloud.points, cloud.triangles, "body"), spacing, most)
        return _same_body(body, coarse)
    except InputError as error:
        raise InputError(
            f"coarse must be given for tools in contact with a body of more than {most} nodes, got none for "
            f"{len(cloud)} nodes, and its surface cannot be filled again: {error}; give the same body with a larger "
            "spacing"
        ) from error


def statics_body(body: NodalModel) -> EnergySolid | None:
    """Return the coarser model for the modes and statics of a large body that tools touch; None if the body serves.

    A sheet has no statics at rest. A body of up to 5,000 nodes serves itself: the force of one of 4,936 nodes errs by
    4.9 % with its own statics, and by 6.3 % with those of 3,000 nodes.
    """
    large = len(body.cloud) > MAX_NODES and not body.kinematics.sheet
    return coarse_body(cast(Solid, body), most=MAX_NODES) if large else None


def _refill(surface: Surface, spacing: float | None, most: int) -> Cloud:
    """Return a cloud that fills a surface with a spacing [m], by default of about `COARSE_NODES` nodes."""
    if spacing is not None:
        return fill_surface(weld(surface), number_in_range("spacing", spacing, 0.0, open_low=True, unit="m"))
    volume, area = abs(surface.volume), surface.area
    target = min(COARSE_NODES, 0.75 * most)
    roots = np.roots([target, 0.0, -SURFACE_SHARE * area, -volume])
    spacing = float(roots[np.abs(roots.imag) < 1e-9 * np.abs(roots.real)].real.max())
    while True:
        try:
            cloud = fill_surface(weld(surface), spacing)
        except CloudError as error:  # too coarse for thin parts
            fault: InputError = error
        else:
            if len(cloud) <= most:
                return cloud
            fault = InputError(f"a spacing of {spacing:.3g} m gives {len(cloud)} nodes")
        spacing *= FINER_FACTOR
        if volume / spacing**3 + SURFACE_SHARE * area / spacing**2 > most:
            raise fault


def _same_body(body: NodalModel, cloud: Cloud) -> EnergySolid:
    """Return a model in another cloud of the same body."""
    nearest, tissue = _nearest_nodes(body.cloud, cloud), body.tissue
    material = (
        tissue.material
        if tissue.regions is None
        else [tissue.regions.materials[which] for which in tissue.regions.which[nearest]]
    )
    return EnergySolid(
        _carry_groups(body.cloud, cloud, nearest),
        material,
        explicit_supports(body.cloud, body.supports),
        stiffness_damping=body.stiffness_damping,
        mass_damping=body.mass_damping,
        stiffness=tissue.stiffness[nearest] if len(tissue.stiffness) else None,
        fibres=None if tissue.fibres is None else tissue.fibres.of(nearest),
    )


def explicit_supports(cloud: Cloud, supports: Sequence[Support]) -> list[Support]:
    """Return supports whose directions do not depend on the faces of a cloud."""
    return [
        replace(support, normal=tuple(support.directions(cloud)[0])) if isinstance(support, Roller) else support
        for support in supports
    ]


def _nearest_nodes(fine: Cloud, coarse: Cloud) -> Ints:
    """Return the node of a fine cloud nearest to each of a coarse one, on the surface or inside as that."""
    nearest = np.zeros(len(coarse), dtype=np.int64)
    for fine_nodes, coarse_nodes in zip(_surface_and_interior(fine), _surface_and_interior(coarse), strict=True):
        fine_nodes = fine_nodes if len(fine_nodes) else np.arange(len(fine))
        nearest[coarse_nodes] = fine_nodes[cKDTree(fine.points[fine_nodes]).query(coarse.points[coarse_nodes])[1]]
    return nearest


def _surface_and_interior(cloud: Cloud) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    surface = np.unique(cloud.face_nodes)
    return surface, np.setdiff1d(np.arange(len(cloud)), surface)


def _carry_groups(fine: Cloud, coarse: Cloud, nearest: Ints) -> Cloud:
    """Return the coarse cloud with the groups of the fine one."""
    groups = dict(coarse.groups)
    for name, nodes in fine.groups.items():
        members = np.flatnonzero(np.isin(nearest, nodes))
        if not len(members):
            surface = np.unique(coarse.face_nodes)
            members = np.unique(surface[cKDTree(coarse.points[surface]).query(fine.points[nodes])[1]])
        groups[name] = members
    return replace(coarse, groups=groups)
