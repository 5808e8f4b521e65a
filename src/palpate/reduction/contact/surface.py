"""The surface of a reduced body, the tools on it, and what they keep from step to step."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.arrays import Floats, Ints
from palpate.dynamics.contact.tools import Forceps
from palpate.dynamics.loads.prepared import PreparedLoads
from palpate.reduction.contact.compliance import (
    ActiveCompliance,
    ComplianceTable,
    SurfaceCompliance,
    active_compliance,
    compliance_table,
)

__all__ = ["ContactScratch", "ContactSurface", "RigidTools", "contact_scratch", "contact_surface", "rigid_tools"]


CLUSTER = 32  # surface nodes in a cluster, about


class ContactSurface(NamedTuple):
    """The part of a reduced body that tools touch."""

    nodes: Ints  # (k,) surface nodes, by cluster
    points: Floats  # (k, 3) reference places [m]
    columns: NDArray[np.float32]  # (k, 3, m) their displacements by unit coordinates
    start: Ints  # (c + 1,) of the clusters
    leader: Ints  # (c,) a node in the middle of each
    extent: Floats  # (c,) how far from it others are at rest [m]
    compliance: ComplianceTable


class RigidTools(NamedTuple):
    """Rigid tools, and what they do."""

    kind: Ints  # (t,) of their shapes
    sizes: Floats  # (t, 3) [m]
    friction: Floats  # (t,)
    origins: Floats  # (t, 3) the point about which forceps hold the body at rest [m]
    frames: Floats  # (t, 2, 3, 4) rotations and places [m] before and after a step
    load: Floats  # (m,) forces on the coordinates
    impulses: Floats  # (t, 6) [N s] and moments about the origins [N m s] on the body, added up
    given: Floats  # (k, 3) impulses [N s] on the nodes, added up
    way: Floats  # (2, 3, 4) in real time: a tool's frames before and after a period


class ContactScratch(NamedTuple):
    """What one step hands to the next, and scratch."""

    force: Floats  # (t, k, 3) [N]
    place: Floats  # (t, k, 3) [m], of the nodes that are touched
    busy: NDArray[np.bool_]  # (t, c) clusters that were near the tool in the last step
    node: Ints  # (e,) touched: place in the skin, of each pair of a node and a tool
    point: Ints  # (e,) its patch, or the node itself where it is held, in the compliance
    tool: Ints  # (e,)
    modal: Floats  # (e, 3) [m]
    now: Floats  # (e, 3) [m]
    before: Floats  # (e, 3) [m]
    push: Floats  # (e, 3) [N]
    wide: Floats  # (3,)
    soft: Floats  # (t,) what hardening leaves of the compliance
    active: ActiveCompliance
    numbers: Ints  # (3,) pairs now, sweeps of the last step, steps whose sweeps did not end


def contact_surface(compliance: SurfaceCompliance, points: Floats, columns: Floats) -> ContactSurface:
    """Lay out the surface of a body with nodes at points (n, 3) and columns (m, n, 3), in clusters."""
    order, start = _clusters(points[compliance.nodes], CLUSTER)
    nodes = compliance.nodes[order]
    points, columns, laid = points[nodes], columns[:, nodes], compliance_table(compliance, order)
    leader, extent = [], []
    for begin, end in pairwise(start):
        own_points = points[begin:end]
        middle = int(np.argmin(np.linalg.norm(own_points - own_points.mean(axis=0), axis=1)))
        leader.append(begin + middle)
        extent.append(np.linalg.norm(own_points - own_points[middle], axis=1).max())
    return ContactSurface(
        nodes, np.ascontiguousarray(points), np.ascontiguousarray(columns.transpose(1, 2, 0), dtype=np.float32),
        start, np.array(leader, dtype=np.int64), np.array(extent, dtype=float), laid,
    )  # fmt: skip


def _clusters(points: Floats, size: int) -> tuple[Ints, Ints]:
    """Halve a set of points across its longest extent until no part has more than `size`."""
    parts, done = [np.arange(len(points))] if len(points) else [], [np.zeros(0, dtype=np.int64)]
    while parts:
        part = parts.pop()
        if len(part) <= size:
            done.append(part)
            continue
        axis = int(np.argmax(np.ptp(points[part], axis=0)))
        ordered = part[np.argsort(points[part, axis], kind="stable")]
        parts += [ordered[len(part) // 2 :], ordered[: len(part) // 2]]
    return np.concatenate(done), np.cumsum([len(part) for part in done], dtype=np.int64)


def rigid_tools(prepared: PreparedLoads | None, of: ContactSurface) -> RigidTools:
    """Make the tools of a drive ready; None for no tool."""
    kind, sizes, friction, origins = np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3))
    if prepared is not None:
        kind, sizes, friction = prepared.contacts.kind, prepared.contacts.sizes, prepared.contacts.friction
        shapes = [load.tool for load in prepared.tools]
        origins = np.array([s.point if isinstance(s, Forceps) else np.zeros(3) for s in shapes]).reshape(-1, 3)
    return RigidTools(
        kind, sizes, friction, origins, np.zeros((len(kind), 2, 3, 4)), np.zeros(of.columns.shape[2]),
        np.zeros((len(kind), 6)), np.zeros((len(of.nodes), 3)), np.zeros((2, 3, 4)),
    )  # fmt: skip


def contact_scratch(of: ContactSurface, tools: int) -> ContactScratch:
    """Allocate for a number of tools; none touches."""
    most, by_tool = tools * len(of.nodes), (tools, len(of.nodes), 3)
    modal, now, before, push = np.zeros((4, most, 3))
    kept = active_compliance(of.compliance, tools)
    node, point, tool = np.zeros((3, most), dtype=np.int64)
    return ContactScratch(
        np.zeros(by_tool), np.zeros(by_tool), np.ones((tools, len(of.leader)), dtype=np.bool_), node, point, tool,
        modal, now, before, push, np.zeros(3), np.ones(tools), kept, np.zeros(3, dtype=np.int64),
    )  # fmt: skip
