"""Contact surface of a reduced body, rigid tools, and the arrays of their contact."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.core.arrays import Floats, Ints
from palpate.dynamics.contact.geometry import HeldNodes, held_nodes, with_scratch
from palpate.dynamics.contact.tools import Forceps
from palpate.dynamics.loads.prepared import PreparedLoads
from palpate.meshfree.cloud import Cloud
from palpate.reduction.contact.compliance import (
    ActiveCompliance,
    ComplianceTable,
    SurfaceCompliance,
    active_compliance,
    compliance_table,
)

CLUSTER_SIZE = 32  # most surface nodes in a cluster
PAIRS, SWEEPS, UNCONVERGED = range(3)  # entries of `ContactScratch.numbers`: now, in the last step, steps so far
# Nearness of a fixed node itself, whose force is not that of the coordinates: more than twice that of any other. So the
# error is unknown of a tool on fixed nodes alone, unless held-out runs have such a tool.
HELD_NEARNESS = 10.0


class ContactSurface(NamedTuple):
    """Surface of a reduced body that tools may touch."""

    nodes: Ints  # (k,) surface nodes, by cluster
    points: Floats  # (k, 3) reference positions [m]
    columns: NDArray[np.float32]  # (k, 3, m) displacements by unit coordinates
    start: Ints  # (c + 1,) first node of each cluster
    leader: Ints  # (c,) a node in the middle of each cluster
    extent: Floats  # (c,) largest distance from it at rest [m]
    triangles: Ints  # (q, 3) of the surface, as numbers in `nodes`
    spacing: float  # of the nodes [m]
    compliance: ComplianceTable


class RigidTools(NamedTuple):
    """Rigid tools, and their forces and impulses on the body."""

    kind: Ints  # (t,) of their shapes
    sizes: Floats  # (t, 3) [m]
    friction: Floats  # (t,)
    origins: Floats  # (t, 3) origin of forceps on the body at rest [m]
    frames: Floats  # (t, 2, 3, 4) rotations and positions [m] before and after a step
    load: Floats  # (m,) forces on the coordinates
    own_load: Floats  # (m,) scratch: those of one tool
    impulses: Floats  # (t, 6) sums of impulses [N s] and moments about the origins [N m s] on the body
    nodal_impulses: Floats  # (k, 3) sums of impulses [N s] on the nodes
    held: HeldNodes
    path: Floats  # (t, 3, 3, 4) in real time: rotation from home and position before and after a period, and now


class ContactScratch(NamedTuple):
    """Contact forces and positions of the last step, and work arrays.

    A pair is a node in contact with a tool; e counts pairs.
    """

    force: Floats  # (t, k, 3) [N]
    place: Floats  # (t, k, 3) [m] positions of the nodes in contact
    busy: NDArray[np.bool_]  # (t, c) clusters near the tool in the last step
    node: Ints  # (e,) number of the pair's node in `ContactSurface.nodes`
    point: Ints  # (e,) row of its patch in the compliance, or of the node where it is bonded
    tool: Ints  # (e,)
    modal: Floats  # (e, 3) [m] position by the coordinates alone
    now: Floats  # (e, 3) [m] position with the surface compliance
    before: Floats  # (e, 3) [m] position before the step
    push: Floats  # (e, 3) [N]
    displacement: Floats  # (3,) scratch
    active: ActiveCompliance
    numbers: Ints  # (3,) see PAIRS, SWEEPS and UNCONVERGED
    pair_of: Ints  # (k,) scratch
    depth: Floats  # (t,) [m] of the surface's triangles in each tool, see `palpate.reduction.contact.penetration`


def contact_surface(compliance: SurfaceCompliance, cloud: Cloud, columns: Floats) -> ContactSurface:
    """Return the contact surface, in clusters, of a body's cloud and basis vectors (m, n, 3)."""
    points = cloud.points
    order, start = _clusters(points[compliance.nodes], CLUSTER_SIZE)
    nodes = compliance.nodes[order]
    number = np.full(len(points), -1)
    number[nodes] = np.arange(len(nodes))
    triangles = number[cloud.triangles].reshape(-1, 3)
    points, columns, table = points[nodes], columns[:, nodes], compliance_table(compliance, order)
    leader, extent = [], []
    for begin, end in pairwise(start):
        own_points = points[begin:end]
        middle = int(np.argmin(np.linalg.norm(own_points - own_points.mean(axis=0), axis=1)))
        leader.append(begin + middle)
        extent.append(np.linalg.norm(own_points - own_points[middle], axis=1).max())
    return ContactSurface(
        nodes=nodes,
        points=np.ascontiguousarray(points),
        columns=np.ascontiguousarray(columns.transpose(1, 2, 0), dtype=np.float32),
        start=start,
        leader=np.array(leader, dtype=np.int64),
        extent=np.array(extent, dtype=float),
        triangles=np.ascontiguousarray(triangles[(triangles >= 0).all(axis=1)], dtype=np.int64),
        spacing=cloud.spacing,
        compliance=table,
    )


def _clusters(points: Floats, size: int) -> tuple[Ints, Ints]:
    """Return an order of points, and the starts of clusters of at most `size`, by recursive bisection."""
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


def rigid_tools(prepared: PreparedLoads | None, contact_surface: ContactSurface) -> RigidTools:
    """Return the tools of prepared loads; none for None."""
    kind, sizes, friction, origins = np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3))
    held_record = held_nodes(np.zeros(0, dtype=np.int64), np.zeros((0, 3)), np.zeros(0), 0.0, np.zeros((0, 0), bool))
    if prepared is not None:
        held_record = with_scratch(prepared.contacts).held
        kind, sizes, friction = (
            prepared.contacts.tools.kind,
            prepared.contacts.tools.sizes,
            prepared.contacts.tools.friction,
        )
        shapes = [load.tool for load in prepared.tools]
        origins = np.array([s.point if isinstance(s, Forceps) else np.zeros(3) for s in shapes]).reshape(-1, 3)
    return RigidTools(
        kind=kind,
        sizes=sizes,
        friction=friction,
        origins=origins,
        frames=np.zeros((len(kind), 2, 3, 4)),
        load=np.zeros(contact_surface.columns.shape[2]),
        own_load=np.zeros(contact_surface.columns.shape[2]),
        impulses=np.zeros((len(kind), 6)),
        nodal_impulses=np.zeros((len(contact_surface.nodes), 3)),
        held=held_record,
        path=np.tile(np.eye(3, 4), (len(kind), 3, 1, 1)),
    )


def contact_scratch(contact_surface: ContactSurface, tools: int) -> ContactScratch:
    """Return zeroed work arrays for a number of tools, none of them in contact."""
    pairs, by_tool = tools * len(contact_surface.nodes), (tools, len(contact_surface.nodes), 3)
    modal, now, before, push = np.zeros((4, pairs, 3))
    node, point, tool = np.zeros((3, pairs), dtype=np.int64)
    return ContactScratch(
        force=np.zeros(by_tool),
        place=np.zeros(by_tool),
        busy=np.ones((tools, len(contact_surface.leader)), dtype=np.bool_),
        node=node,
        point=point,
        tool=tool,
        modal=modal,
        now=now,
        before=before,
        push=push,
        displacement=np.zeros(3),
        active=active_compliance(contact_surface.compliance, tools),
        numbers=np.zeros(3, dtype=np.int64),
        pair_of=np.zeros(len(contact_surface.nodes), dtype=np.int64),
        depth=np.zeros(tools),
    )
