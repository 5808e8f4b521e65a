"""Bases: the main modes of runs, and fields that join them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from palpate.dynamics.full import FullModel
from palpate.dynamics.membrane import Membrane
from palpate.faults import InputError

__all__ = ["joined", "main_modes"]

Floats = NDArray[np.float64]

MOST_SNAPSHOTS = 800  # that modes are found from
SMALLEST = 1e-3  # of the largest snapshot: the size below which one counts less
SINGLE = 1e-10  # of the largest eigenvalue of products in single precision: what is below is noise


def main_modes(body: FullModel | Membrane, snapshots: Floats, modes: int, spare: int = 0) -> Floats:
    """Return modes (M, n, 3) that hold most of some snapshots (t, n, 3), orthonormal in the volumes.

    Of a solid, the proper orthogonal decomposition of du/dX instead of u: what it leaves out is small in energy, not
    only in displacement, so that the reduced body is softer and truer. A snapshot counts by the root of its size, so
    that small motions are not lost beside large ones. Of a membrane, which is slack at first, that of u, and all
    snapshots count the same: waves begin small. Behind them come up to `spare` further ones, as many as there are.

    Raises
    ------
    InputError
        More modes than independent snapshots, or snapshots that are all zero or not finite.
    """
    if not np.isfinite(snapshots).all():
        raise InputError("snapshots are not finite")
    chosen = snapshots[np.unique(np.linspace(0, len(snapshots) - 1, MOST_SNAPSHOTS).astype(int))]
    sheet, roots = isinstance(body, Membrane), np.sqrt(body.volumes)
    fields = (u if sheet else body.stencils.gradient(u).reshape(-1, 9) for u in chosen)
    rows = np.array([(field * roots[:, None]).reshape(-1) for field in fields], dtype=np.float32)
    gram = np.asarray(rows @ rows.T, dtype=float)
    sizes = np.sqrt(np.diag(gram))
    if sizes.max() == 0:
        raise InputError("all snapshots are zero: there is nothing to find modes in")
    scale = np.maximum(sizes, SMALLEST * sizes.max()) ** (-1.0 if sheet else -0.5)
    values, vectors = np.linalg.eigh(gram * scale[:, None] * scale)
    rank = int(np.sum(values > SINGLE * values[-1]))
    if modes > rank:
        raise InputError(f"modes = {modes}: the {len(chosen)} snapshots hold only {rank} independent shapes")
    count = min(modes + spare, rank)
    shapes = (vectors[:, ::-1][:, :count].T * scale) @ chosen.reshape(len(chosen), -1)
    return _orthonormal(body, shapes.reshape(count, -1, 3))


def _orthonormal(body: FullModel | Membrane, fields: Floats) -> Floats:
    """Fields (m, n, 3) with the same span, orthonormal in the volumes."""
    weights = np.repeat(np.sqrt(body.volumes), 3)
    orthonormal, _ = np.linalg.qr((fields.reshape(len(fields), -1) * weights).T)
    return np.asarray((orthonormal / weights[:, None]).T.reshape(fields.shape))


def joined(body: FullModel | Membrane, modes: Floats | None, enrichment: Floats | None) -> Floats:
    """Modes and enrichment, orthonormal together."""
    if enrichment is None:
        return np.zeros((0, len(body.cloud), 3)) if modes is None else modes
    if enrichment.ndim != 3 or enrichment.shape[1:] != (len(body.cloud), 3) or not np.isfinite(enrichment).all():
        raise InputError(f"enrichment has shape {enrichment.shape}; this body needs (e, {len(body.cloud)}, 3), finite")
    if np.abs(enrichment[:, body.held]).max(initial=0.0) > 0:
        raise InputError("enrichment moves nodes of the supports")
    sizes = np.linalg.norm(enrichment, axis=2).max(axis=1)[:, None, None]
    return _orthonormal(body, enrichment / sizes if modes is None else np.concatenate([modes, enrichment / sizes]))
