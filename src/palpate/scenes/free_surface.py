"""The free surface of a solid body: its surface nodes, areas and normals, and which supports hold."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from palpate.core.arrays import Floats, Ints
from palpate.core.faults import InputError
from palpate.dynamics.contact.tools import Contact, Grasp
from palpate.dynamics.loads.prepared import Load
from palpate.dynamics.loads.supports import FIXED, SymmetryPlane, supported_nodes
from palpate.dynamics.solid.model import Solid
from palpate.meshfree.cloud import MOVED_MARGIN
from palpate.reduction.hyper.model import ReducedModel

POSES_PER_PATH = 61  # of a path, between which a tool moves by a fraction of its radius


class FreeSurface:
    """The surface nodes of a solid or of its reduced model, of which supports hold some.

    A node that slides on a roller or rail, or lies on a foundation, is free. A node in a plane of symmetry is held: the
    tool would pass through its own mirror image there.

    - `nodes` (s,): surface nodes, ascending, the order of all other arrays over the surface
    - `points` (s, 3) [m]
    - `areas` (s,) [m^2]: share of the surface of each node, of all faces that it lies on
    - `vectors` (s, 3) [m^2]: area times outward normal, summed over these faces
    - `normals` (s, 3): unit vectors along these
    - `held` (s,)
    - `fixed_points` (f, 3) [m]: all held nodes, also those inside the body
    """

    def __init__(self, body: Solid | ReducedModel) -> None:
        cloud = body.cloud
        if cloud.points.shape[1] != 3 or not len(cloud.face_nodes):
            raise InputError("body must be a solid with a surface, got a membrane or nodes without faces; use a Solid")
        self.cloud = cloud
        self.nodes = np.unique(cloud.face_nodes)
        self.points = cloud.points[self.nodes]
        vectors = np.zeros_like(cloud.points)
        np.add.at(vectors, cloud.face_nodes, cloud.face_areas[:, None] * cloud.face_normals)
        self.vectors = vectors[self.nodes]
        self.areas = np.bincount(cloud.face_nodes, cloud.face_areas, len(cloud))[self.nodes]
        self.normals = _unit(self.vectors)
        held_mask = supported_nodes(cloud, body.supports).kind == FIXED
        for support in body.supports:
            if isinstance(support, SymmetryPlane):
                held_mask[cloud.group(support.group)] = True
        self.held, self.fixed_points = held_mask[self.nodes], cloud.points[held_mask]

    @cached_property
    def tree(self) -> cKDTree:
        """Of the surface nodes."""
        return cKDTree(self.points)

    def smoothed_normals(self, width: float) -> Floats:
        """Return normals (s, 3), means over the surface within a width [m] that does not face away."""
        pairs = self.tree.query_pairs(width, output_type="ndarray")
        ahead = np.einsum("pa,pa->p", self.vectors[pairs[:, 0]], self.vectors[pairs[:, 1]]) > 0
        i, j = pairs[ahead].T
        weights = 1.0 - np.sum((self.points[i] - self.points[j]) ** 2, axis=1) / width**2
        n = len(self.nodes)
        near = sparse.coo_matrix((weights, (i, j)), (n, n)).tocsr()
        return _unit(self.vectors + near @ self.vectors + near.T @ self.vectors)

    def share(self, mask: NDArray[np.bool_]) -> float:
        """Return the share of the free area that nodes of a mask (s,) have; 0 where nothing is free."""
        free = float(self.areas[~self.held].sum())
        return float(self.areas[mask & ~self.held].sum()) / free if free else 0.0

    def covered(self, loads: Sequence[Load], duration: float) -> NDArray[np.bool_]:
        """Return which surface nodes (s,) tools cover in a duration [s]: those near a place that they touch.

        A tool touches the surface node nearest to its origin as long as it overlaps the undeformed body there, and
        forceps the node nearest to the grasped point. A touch covers nodes within one radius of the tool that face the
        same way. Planes, and loads that are not tools, cover nothing.
        """
        mask = np.zeros(len(self.nodes), dtype=np.bool_)
        for load in loads:
            for node in self._touched(load, duration):
                radius = load.tool.sizes[0] if isinstance(load, Contact) else 0.0
                if isinstance(load, Grasp):
                    radius = load.radius + MOVED_MARGIN * self.cloud.spacing
                near = np.array(self.tree.query_ball_point(self.points[node], radius), dtype=np.int64)
                mask[near[self.normals[near] @ self.normals[node] > 0]] = True
        return mask & ~self.held

    def _touched(self, load: Load, duration: float) -> Ints:
        """Return the surface nodes that a tool touches."""
        if isinstance(load, Grasp):
            return np.atleast_1d(self.tree.query(np.asarray(load.point, dtype=float))[1])
        if not isinstance(load, Contact) or not load.tool.sizes[0]:
            return np.zeros(0, dtype=np.int64)
        places = load.poses(np.linspace(0.0, duration, POSES_PER_PATH))[:, :3]
        distances, nearest = self.tree.query(places)
        outward = np.einsum("ta,ta->t", places - self.points[nearest], self.normals[nearest])
        return np.unique(nearest[(distances < load.tool.sizes[0]) | (outward < 0)])


def _unit(vectors: Floats) -> Floats:
    """Return unit vectors; zero where a vector is zero."""
    return np.asarray(vectors / np.maximum(np.linalg.norm(vectors, axis=1), 1e-300)[:, None])
