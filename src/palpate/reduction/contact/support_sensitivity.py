"""Sensitivity of a tool's force to the place and the stiffness of supports, from statics at rest.

A press with nodal forces f moves the tool by f K^-1 f / |f|, with the stiffness K at rest of the body, its supports
and the springs of its foundations. So for a given depth the force is proportional to 1 / (f K^-1 f). It is compared
for several presses with that of other supports: every border one ring of surface nodes further out or in, and
springs of half and twice the stiffness. The statics are linear, which is what makes the ratio independent of the depth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve
from scipy.spatial import cKDTree

from palpate.core.arrays import Floats, Ints
from palpate.dynamics.loads.foundation import Foundation
from palpate.dynamics.loads.supports import (
    Support,
    SupportedNodes,
    SymmetryPlane,
    free_directions,
    free_rigid_motions,
    supported_nodes,
)
from palpate.dynamics.run.trajectory import StoredTrajectory
from palpate.dynamics.solid.model import EnergySolid
from palpate.meshfree.cloud import Cloud
from palpate.reduction.basis.linear_modes import rest_stiffness
from palpate.reduction.contact.coarse_body import explicit_supports

MAX_PRESSES = 6
MAX_HELD_SHARE = 0.1  # of the force of a press on nodes that a moved border would hold


class Press(NamedTuple):
    """Largest total force of tools in a run: nodes (k,) of the body, and forces (k, 3) [N] on them."""

    nodes: NDArray[np.int64]
    forces: Floats

    def place(self, points: Floats) -> Floats:
        """Return the mean position (3,) [m] of the nodes by force."""
        sizes = np.linalg.norm(self.forces, axis=1)
        return np.asarray(sizes @ points[self.nodes] / sizes.sum())


def select_presses(runs: Sequence[StoredTrajectory], most: int = MAX_PRESSES) -> list[Press]:
    """Return the strongest press of some runs whose presses are far from each other."""
    presses = [press for run in runs if (press := _strongest(run.contact_forces)) is not None]
    if not presses:
        return []
    places = np.array([press.place(runs[0].points) for press in presses])
    chosen, distance = [0], np.linalg.norm(places - places[0], axis=1)
    while len(chosen) < min(most, len(presses)) and distance.max() > 0:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.linalg.norm(places - places[chosen[-1]], axis=1))
    return [presses[k] for k in chosen]


def _strongest(contact_forces: Floats) -> Press | None:
    """Return the press of the frame with the largest total force, of rows (c, 5) of a run; None without a force."""
    if not len(contact_forces):
        return None
    frames = contact_forces[:, 0].astype(int)
    totals = np.zeros((frames.max() + 1, 3))
    np.add.at(totals, frames, contact_forces[:, 2:])
    sizes = np.linalg.norm(totals, axis=1)
    rows = contact_forces[frames == sizes.argmax()]
    return Press(rows[:, 1].astype(np.int64), rows[:, 2:]) if sizes.max() > 0 else None


def support_sensitivity(
    body: EnergySolid, points: Floats, presses: Sequence[Press], foundations: Sequence[Foundation] = ()
) -> dict[str, Any] | None:
    """Return changes of the force of tools, for given depths, by changes of the supports.

    The surface of the body has triangles. The stiffness of its 3 n degrees of freedom is factorised three to five
    times. `points` (N, 3) [m] are nodes of the presses, of the body or of a finer model of it. `foundations` are
    springs on groups of the body.

    ``"nodes"`` and ``"presses"`` are numbers. ``"border"`` has the ``"distance"`` [m] by which the borders move, and
    the changes ``"outward"`` and ``"inward"``; it is None if no support has one. ``"springs"`` has the changes
    ``"halved"`` and ``"doubled"``; it is None without foundations. Each change has the ``"median"`` and the
    ``"largest"`` relative change of the force over the presses, and the ``"place"`` [m] of the largest. It is None
    where nothing would hold the body.

    Returns None if there is no press away from the supports, or nothing whose support could change.
    """
    cloud, supports = body.cloud, explicit_supports(body.cloud, body.supports)
    outer, inner, distance = moved_borders(cloud, supports)
    forces, places = _on_body(body, points, presses)
    held_nodes = supported_nodes(_with_groups(cloud, outer), supports).kind != 0
    sizes = np.linalg.norm(forces, axis=2)
    usable = sizes[:, held_nodes].sum(axis=1) <= MAX_HELD_SHARE * sizes.sum(axis=1)
    forces, places = forces[usable], places[usable]
    sites = body.prepare(list(foundations)).sites
    springs = np.bincount(sites.foundation_node, sites.foundation_spring, minlength=len(cloud)).astype(float)
    if not len(forces) or not (outer or springs.any()):
        return None
    statics = _Statics(rest_stiffness(body), springs, forces, cloud.points)
    reference = statics.compliances(body.supported)
    if reference is None:
        return None

    def change(groups: dict[str, Ints] | None, factor: float = 1.0) -> dict[str, Any] | None:
        remaining = supports if groups is None else [each for each in supports if len(groups.get(each.group, (0,)))]
        used = _with_groups(cloud, {name: nodes for name, nodes in (groups or {}).items() if len(nodes)})
        other = statics.compliances(supported_nodes(used, remaining), factor)
        return None if other is None else _summary(reference / other - 1.0, places)

    return {
        "nodes": len(cloud),
        "presses": len(forces),
        "border": {"distance": distance, "outward": change(outer), "inward": change(inner)} if outer else None,
        "springs": {"halved": change(None, 0.5), "doubled": change(None, 2.0)} if springs.any() else None,
    }


class _Statics(NamedTuple):
    """Stiffness [N/m] of a body without supports, springs (n,) [N/m], and forces (p, n, 3) [N] of presses."""

    stiffness: Any
    springs: Floats
    forces: Floats
    points: Floats

    def compliances(self, supported: SupportedNodes, factor: float = 1.0) -> Floats | None:
        """Return f K^-1 f (p,) [N m] with some supports and a factor on springs; None if nothing holds the body."""
        if not self.springs.any() and free_rigid_motions(self.points, supported.project):
            return None
        free = free_directions(supported)[0]
        stiffness = (free.T @ self.stiffness @ free).toarray(order="F")
        # the springs are equal in all directions, so that they are diagonal in the free ones
        stiffness[np.diag_indices(len(stiffness))] += factor * (free.power(2).T @ np.repeat(self.springs, 3))
        loads = free.T @ self.forces.reshape(len(self.forces), -1).T
        try:
            factored = cho_factor(stiffness, lower=True, overwrite_a=True, check_finite=False)
        except LinAlgError:  # springs that do not hold it
            return None
        return np.asarray(np.sum(loads * cho_solve(factored, loads, check_finite=False), axis=0))


def _summary(changes: Floats, places: Floats) -> dict[str, Any]:
    largest = int(np.abs(changes).argmax())
    return {
        "median": float(np.median(changes)), "largest": float(changes[largest]), "place": places[largest].tolist()
    }  # fmt: skip


def moved_borders(cloud: Cloud, supports: Sequence[Support]) -> tuple[dict[str, Ints], dict[str, Ints], float]:
    """Return the groups of supports with one ring of surface nodes more and fewer, and the width of the ring [m].

    Planes of symmetry do not attach a body, and stay. Groups are empty where no surface is free next to a support.
    """
    edges = cloud.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    edges = np.concatenate([edges, edges[:, ::-1]])
    free = np.ones(len(cloud), dtype=bool)
    for support in supports:
        free[cloud.group(support.group)] = False
    outer, inner, widths = {}, {}, []
    for support in supports:
        nodes = cloud.group(support.group)
        crossing = edges[np.isin(edges[:, 0], nodes) & free[edges[:, 1]]]
        if isinstance(support, SymmetryPlane) or not len(crossing):
            continue
        border, ring = (np.unique(column) for column in crossing.T)
        outer[support.group], inner[support.group] = np.union1d(nodes, ring), np.setdiff1d(nodes, border)
        widths.append(cKDTree(cloud.points[nodes]).query(cloud.points[ring])[0])
    return outer, inner, float(np.concatenate(widths).mean()) if widths else 0.0


def _with_groups(cloud: Cloud, groups: dict[str, Ints]) -> Cloud:
    return replace(cloud, groups={**cloud.groups, **groups})


def _on_body(body: EnergySolid, points: Floats, presses: Sequence[Press]) -> tuple[Floats, Floats]:
    """Return the forces (p, n, 3) [N] of presses on the nodes of a body, and their places (p, 3) [m].

    On another cloud the force of a node acts on the patch about the nearest surface node.
    """
    cloud, forces = body.cloud, np.zeros((len(presses), len(body.cloud), 3))
    places = np.array([press.place(points) for press in presses]).reshape(-1, 3)
    surface = np.unique(cloud.face_nodes)
    for nodal_forces, press in zip(forces, presses, strict=True):
        if points is cloud.points:
            np.add.at(nodal_forces, press.nodes, press.forces)
            continue
        np.add.at(nodal_forces, surface[cKDTree(cloud.points[surface]).query(points[press.nodes])[1]], press.forces)
        nodal_forces[:] = body.patches.T @ nodal_forces
    return forces, places
