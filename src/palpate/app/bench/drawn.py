"""A session whose body is drawn with more vertices than its surface has: what a finer body would cost to show."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array, identity, vstack

from palpate.reduction.realtime.display_surface import Surface

__all__ = ["FinelyDrawn", "centred", "divided"]

Floats = NDArray[np.float64]
Singles = NDArray[np.float32]


def divided(triangles: NDArray[np.uint32], count: int) -> tuple[NDArray[np.uint32], csr_array]:
    """Divide each triangle into four at the middles of its edges.

    Parameters
    ----------
    triangles : (t, 3) int array
    count : int
        Of their vertices.

    Returns
    -------
    triangles : (4 t, 3) uint32 array
    weights : (n, count) sparse array
        New vertices as means of the old ones, which come first.
    """
    edges = np.sort(triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    own, edge = np.unique(edges, axis=0, return_inverse=True)
    middle = count + edge.reshape(-1, 3)
    (a, b, c), (p, q, r) = triangles.T, middle.T
    parts = [(a, p, r), (b, q, p), (c, r, q), (p, q, r)]
    fine = np.concatenate([np.stack(part, axis=1) for part in parts]).astype(np.uint32)
    rows = np.repeat(np.arange(len(own)), 2)
    halves = csr_array((np.full(2 * len(own), 0.5), (rows, own.ravel())), shape=(len(own), count))
    return fine, csr_array(vstack([identity(count), halves]))


def centred(triangles: NDArray[np.uint32], count: int, more: int) -> tuple[NDArray[np.uint32], csr_array]:
    """Divide the first so many triangles into three each, at their centroids; what is returned is as of `divided`."""
    old, rest = triangles[:more], triangles[more:]
    middle = count + np.arange(more)
    (a, b, c) = old.T
    parts = [np.stack(part, axis=1) for part in ((a, b, middle), (b, c, middle), (c, a, middle))]
    rows = np.repeat(np.arange(more), 3)
    thirds = csr_array((np.full(3 * more, 1 / 3), (rows, old.ravel())), shape=(more, count))
    return np.concatenate([*parts, rest]).astype(np.uint32), csr_array(vstack([identity(count), thirds]))


class FineSurface:
    """A surface with its triangles divided until it has so many vertices, or its own; to the server it is a `Surface`.

    They are divided into four as often as there is room for that, the first ones of them then into three.
    """

    def __init__(self, surface: Surface, vertices: int) -> None:
        self.model, self.scalars, self._coarse = surface.model, surface.scalars, surface
        triangles, weights = surface.triangles, csr_array(identity(len(surface.rest)))
        while (count := weights.shape[0]) < vertices:
            fine, more = divided(triangles, count)
            if more.shape[0] > vertices:
                fine, more = centred(triangles, count, min(vertices - count, len(triangles)))
            triangles, weights = fine, csr_array(more @ weights)
        self.triangles, self._weights = triangles, weights.astype(np.float32)
        self.rest: Singles = self._weights @ surface.rest

    def displacements(self, *arguments: Any) -> Singles:
        """As `palpate.reduction.realtime.display_surface.Surface.displacements`."""
        return np.asarray(self._weights @ self._coarse.displacements(*arguments))

    def scalar(self, name: str, coordinates: Floats, displacements: Singles) -> Singles:
        """As `palpate.reduction.realtime.display_surface.Surface.scalar`."""
        if name == "displacement":
            return self._coarse.scalar(name, coordinates, displacements)
        coarse = displacements[: len(self._coarse.rest)]  # the old vertices come first
        return np.asarray(self._weights @ self._coarse.scalar(name, coordinates, coarse))


class FinelyDrawn:
    """A session that is drawn finely; all else is the session's own."""

    def __init__(self, session: Any, vertices: int) -> None:
        self._session, self.surface = session, FineSurface(session.surface, vertices)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._session, name)
