"""Mirror images of a cloud at planes of symmetry.

A body that is symmetric about planes moves as the part on one side of them does, if the stencils of
that part contain the mirror images of its nodes. The displacement of an image is the reflection of
its source's, u' = R u with R = I - 2 n n^T, and so are its forces. Images at several planes, which
must be at right angles, have products of reflections.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from palpate.core.arrays import Floats, Ints
from palpate.core.faults import InputError
from palpate.meshfree.cloud import Cloud
from palpate.meshfree.stencils import Stencils

ON_PLANE = 1e-6  # largest distance of a plane's nodes from it, in spacings
MIN_DISTANCE = 0.1  # least distance of all other nodes, in spacings
MAX_FACE_COSINE = 1e-6  # cosine, or 1 minus a cosine, below which a face is at right angles to a plane, or in it
MAX_NORMAL_COSINE = 1e-9  # largest cosine between the normals of two planes


class MirrorPlane(NamedTuple):
    """A plane of symmetry."""

    name: str
    nodes: Ints  # (k,) int array: all nodes in the plane
    normal: Floats  # (3,) array: unit normal


class Mirror(NamedTuple):
    """Images that stencils use, numbered after the n nodes of a cloud."""

    source: NDArray[np.int64]  # (g,) int array: the node that each image reflects
    reflection: Floats  # (g, 3, 3) array: matrices that turn the vectors of the source into those of the image

    def vectors(self, field: Floats) -> Floats:
        """Append the images' vectors to fields (..., n, 3); return the fields themselves without images."""
        if not len(self.source):
            return field
        return np.concatenate([field, np.einsum("gcd,...gd->...gc", self.reflection, field[..., self.source, :])], -2)

    def scalars(self, values: Floats) -> Floats:
        """Append the images' values to values (n, ...)."""
        return np.concatenate([values, values[self.source]]) if len(self.source) else values

    def fold(self, vectors: Floats) -> Floats:
        """Return the transpose of `vectors`, (n, 3), for forces (n + g, 3) on nodes and images."""
        if not len(self.source):
            return vectors
        first = len(vectors) - len(self.source)
        result = vectors[:first].copy()
        np.add.at(result, self.source, np.einsum("gcd,gc->gd", self.reflection, vectors[first:]))
        return result

    def matrix(self, nodes: int) -> Any:
        """Return `vectors` as a sparse array (3 (n + g), 3 n), rows 3 i + c of node or image i."""
        g = len(self.source)
        rows = 3 * np.arange(g)[:, None, None] + np.arange(3)[None, :, None] + np.zeros((1, 1, 3), dtype=int)
        columns = 3 * self.source[:, None, None] + np.arange(3)[None, None, :] + np.zeros((1, 3, 1), dtype=int)
        entries = (self.reflection.ravel(), (rows.ravel(), columns.ravel()))
        return sparse.vstack([sparse.identity(3 * nodes), sparse.csr_matrix(entries, (3 * g, 3 * nodes))]).tocsr()


NO_MIRROR = Mirror(np.zeros(0, dtype=np.int64), np.zeros((0, 3, 3)))


class Images(NamedTuple):
    """A cloud together with all of its mirror images."""

    cloud: Cloud  # the nodes of the part, and after them the images. Without planes it is the part's own cloud.
    source: NDArray[np.int64]  # (N,) int array: node of the part for each node of the cloud
    reflection: Floats  # (N, 3, 3) array
    # (n,) array: volume of every node in the cloud over that in the part: 1, or 2 in a plane, 4 in two planes
    copies: Floats

    @property
    def nodes(self) -> int:
        """Number of nodes of the part."""
        return len(self.copies)

    def own(self, stencils: Stencils) -> tuple[Mirror, Stencils]:
        """Return the part's rows of stencils of the whole cloud, with the images that they contain."""
        if len(self.cloud) == self.nodes:
            return NO_MIRROR, stencils
        near, number = stencils.neighbours[: self.nodes], np.arange(len(self.cloud), dtype=np.int32)
        images = np.unique(near[near >= self.nodes])
        number[images] = self.nodes + np.arange(len(images), dtype=np.int32)
        mirror = Mirror(self.source[images], np.ascontiguousarray(self.reflection[images]))
        return mirror, replace(stencils, neighbours=number[near], row=stencils.row[: self.nodes])

    def folded(
        self, near: NDArray[np.int32], weights: Floats, diagonal: Floats
    ) -> tuple[NDArray[np.int32], Floats, Floats]:
        """Return the part's rows of weights (N, k) of scalars, with images replaced by their sources.

        The weight on a node's own image is added to the node's weight on itself, `diagonal` (N,). Its entry
        becomes padding and moves to the end of the row, where the compiled passes stop reading.
        """
        if len(self.cloud) == self.nodes:
            return near, weights, diagonal
        n = self.nodes
        every = np.arange(n)[:, None]
        sources = self.source[near[:n]].astype(np.int32)
        itself = (sources == every) & (near[:n] != every)
        rest = np.where(itself, 0.0, weights[:n])
        order = np.argsort(sources == every, axis=1, kind="stable")
        total = diagonal[:n] + np.sum(weights[:n] - rest, axis=1)
        return np.take_along_axis(sources, order, axis=1), np.take_along_axis(rest, order, axis=1), total


def mirror_images(cloud: Cloud, planes: Sequence[MirrorPlane]) -> Images:
    """Return a cloud in space with its images at some planes."""
    n, spacing = len(cloud), cloud.spacing
    points, volumes = cloud.points, cloud.volumes
    source, reflection = np.arange(n), np.tile(np.eye(3), (n if planes else 0, 1, 1))
    faces, triangles = (cloud.face_nodes, cloud.face_normals, cloud.face_areas), cloud.triangles
    for k, (name, nodes, normal) in enumerate(planes):
        for other in planes[:k]:
            if abs(normal @ other.normal) > MAX_NORMAL_COSINE:
                raise InputError(
                    f"planes of symmetry must be at right angles, got {other.name!r} and {name!r}; use Roller for one"
                )
        depth = (cloud.points[nodes[0]] - points) @ normal / spacing
        _check_side(name, np.delete(depth[:n], nodes), depth[nodes])
        on, away = np.abs(depth) <= ON_PLANE, np.flatnonzero(np.abs(depth) > ON_PLANE)
        number = np.arange(len(points))
        number[away] = len(points) + np.arange(len(away))
        volumes = np.concatenate([np.where(on, 2.0, 1.0) * volumes, volumes[away]])
        points = np.concatenate([points, points[away] + 2 * spacing * depth[away, None] * normal])
        source = np.concatenate([source, source[away]])
        reflection = np.concatenate([reflection, _reflection(normal) @ reflection[away]])
        faces = _reflected_faces(faces, on, number, normal)
        triangles = triangles[~on[triangles].all(axis=1)]
        triangles = np.concatenate([triangles, number[triangles][:, ::-1]])
    if not planes:
        return Images(cloud, source, reflection, np.ones(n))
    mirrored = Cloud(points, volumes, *faces, {}, triangles, spacing)
    return Images(mirrored, source, reflection, volumes[:n] / cloud.volumes)


def _reflection(normal: Floats) -> Floats:
    return np.asarray(np.eye(3) - 2 * np.outer(normal, normal))


def _reflected_faces(
    faces: tuple[Ints, Floats, Floats], on: NDArray[np.bool_], number: Ints, normal: Floats
) -> tuple[Ints, Floats, Floats]:
    """Return nodes, normals and areas of the faces of a body and its image; a plane of symmetry is not a face."""
    cosine = np.where(on[faces[0]], np.abs(faces[1] @ normal), 0.5)
    at, normals, areas = (array[cosine < 1 - MAX_FACE_COSINE] for array in faces)
    cosine = cosine[cosine < 1 - MAX_FACE_COSINE]
    # faces that the plane cuts at right angles: their nodes there have half of their areas
    crossing = cosine < MAX_FACE_COSINE
    areas = np.where(crossing, 2.0, 1.0) * areas
    images = number[at], normals @ _reflection(normal), areas
    new_nodes, new_normals, new_areas = (array[~crossing] for array in images)
    return (
        np.concatenate([at, new_nodes]),
        np.concatenate([normals, new_normals]),
        np.concatenate([areas, new_areas]),
    )


def _check_side(name: str, others: Floats, in_plane: Floats) -> None:
    """Raise `InputError` unless the plane's own depths are 0 and all others are on one side, in spacings."""
    if np.abs(in_plane).max() > ON_PLANE:
        raise InputError(
            f"nodes of the plane of symmetry {name!r} must be in one plane, got one "
            f"{np.abs(in_plane).max():.2g} spacings away; give its normal, or use Roller"
        )
    if len(others) and max(others.min(), -others.max()) < MIN_DISTANCE:
        raise InputError(
            f"all nodes outside the plane of symmetry {name!r} must be on one side of it and {MIN_DISTANCE:g} spacings "
            "away, got others; use Roller, or cut the body there"
        )
