"""Sessions with a subdivided surface, which show the cost of drawing a finer body."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, identity, vstack

from palpate.arrays import Floats, Singles
from palpate.realtime.bodies.display_surface import Surface

__all__ = ["SubdividedSession", "subdivide", "subdivide_at_centroids"]


def subdivide(triangles: NDArray[np.uint32], count: int) -> tuple[NDArray[np.uint32], csr_array]:
    """Divide each triangle into four at the middles of its edges.

    Parameters
    ----------
    triangles : (t, 3) int array
    count : int
        Number of their vertices.

    Returns
    -------
    triangles : (4 t, 3) uint32 array
    weights : (n, count) sparse array
        New vertices as means of the old ones. The old vertices come first.
    """
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    ends, edge = np.unique(edges, axis=0, return_inverse=True)
    middle = count + edge.reshape(-1, 3)
    (a, b, c), (p, q, r) = triangles.T, middle.T
    parts = [(a, p, r), (b, q, p), (c, r, q), (p, q, r)]
    fine = np.concatenate([np.stack(part, axis=1) for part in parts]).astype(np.uint32)
    rows = np.repeat(np.arange(len(ends)), 2)
    halves = csr_array((np.full(2 * len(ends), 0.5), (rows, ends.ravel())), shape=(len(ends), count))
    return fine, csr_array(vstack([identity(count), halves]))


def subdivide_at_centroids(
    triangles: NDArray[np.uint32], count: int, more: int
) -> tuple[NDArray[np.uint32], csr_array]:
    """Divide the first `more` triangles into three each, at their centroids; returns as `subdivide`."""
    old, rest = triangles[:more], triangles[more:]
    middle = count + np.arange(more)
    (a, b, c) = old.T
    parts = [np.stack(part, axis=1) for part in ((a, b, middle), (b, c, middle), (c, a, middle))]
    rows = np.repeat(np.arange(more), 3)
    thirds = csr_array((np.full(3 * more, 1 / 3), (rows, old.ravel())), shape=(more, count))
    return np.concatenate([*parts, rest]).astype(np.uint32), csr_array(vstack([identity(count), thirds]))


class SubdividedSurface:
    """A surface with subdivided triangles and at least a number of vertices; replaces a `Surface` in the server.

    All triangles are divided into four as often as the number allows, and then the first ones into three.
    """

    def __init__(self, surface: Surface, vertices: int) -> None:
        self.model, self.scalars, self._coarse = surface.model, surface.scalars, surface
        triangles, weights = surface.triangles, csr_array(identity(len(surface.rest)))
        while (count := weights.shape[0]) < vertices:
            fine, more = subdivide(triangles, count)
            if more.shape[0] > vertices:
                fine, more = subdivide_at_centroids(triangles, count, min(vertices - count, len(triangles)))
            triangles, weights = fine, csr_array(more @ weights)
        self.triangles, self._weights = triangles, weights.astype(np.float32)
        self.rest: Singles = self._weights @ surface.rest
        self.fixed: NDArray[np.bool_] = self._weights @ surface.fixed.astype(np.float32) > 0.5

    def displacements(self, *arguments: Any) -> Singles:
        """Return displacements as `palpate.realtime.bodies.display_surface.Surface.displacements` does."""
        return np.asarray(self._weights @ self._coarse.displacements(*arguments))

    def scalar(self, name: str, coordinates: Floats, displacements: Singles) -> Singles:
        """Return a scalar as `palpate.realtime.bodies.display_surface.Surface.scalar` does."""
        if name == "displacement":
            return self._coarse.scalar(name, coordinates, displacements)
        coarse = displacements[: len(self._coarse.rest)]  # of the old vertices
        return np.asarray(self._weights @ self._coarse.scalar(name, coordinates, coarse))


class SubdividedSession:
    """A session with a subdivided surface; delegates all else to the session."""

    def __init__(self, session: Any, vertices: int) -> None:
        self._session, self.surface = session, SubdividedSurface(session.surface, vertices)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._session, name)
