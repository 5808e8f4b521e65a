"""Bases from the main modes of runs and additional fields."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from palpate.core.arrays import Floats
from palpate.core.faults import InputError
from palpate.dynamics.nodal.energy_model import EnergyModel
from palpate.reduction.basis.incremental_pod import allowance, block_size, decompose
from palpate.reduction.basis.snapshots import Snapshots

MIN_SIZE = 1e-3  # of the largest snapshot, below which one has reduced weight
SUPPORT_TOLERANCE = 1e-9  # largest displacement of an enrichment across a support, relative to its largest one
RANK_TOLERANCE = 1e-10  # of the largest eigenvalue, below which shapes are rounding noise


def main_modes(
    body: EnergyModel,
    snapshots: Snapshots | Floats,
    modes: int,
    spare: int = 0,
    prepared: Callable[[Floats], Floats] | None = None,
) -> tuple[Floats, float]:
    """Return main modes (M, n, 3) of snapshots (t, n, 3), orthonormal in the volumes, and the truncation error.

    For a solid it is the proper orthogonal decomposition of du/dX instead of u. Its error is small in
    energy, and not only in displacement, which makes the reduced body more compliant and more accurate.
    Snapshots have weights of 1 over the root of their size, so that small motions count. A membrane is
    initially slack: it has the decomposition of u, with equal weights, because waves begin small. Up to
    `spare` further modes follow the first ones.

    The snapshots are read twice, a block at a time (`palpate.reduction.basis.incremental_pod`). The
    function `prepared`, if given, maps every block before the decomposition. The truncation error is the
    root of the sum of squares dropped between blocks over that of the weighted snapshots. The projection
    error exceeds the optimum by at most this.
    """
    frames = snapshots if isinstance(snapshots, Snapshots) else Snapshots(snapshots)
    prepare = prepared or (lambda block: block)
    image = body.inner_product()
    size = block_size(frames.nodes)
    sizes = np.concatenate([_sizes(prepare(block), image) for block in frames.blocks(size)])
    if sizes.max() == 0:
        raise InputError("snapshots must be non-zero, got zeros in all; train on a run with loads")
    scale = np.maximum(sizes, MIN_SIZE * sizes.max()) ** (-1.0 if body.kinematics.sheet else -0.5)
    parts = np.split(scale, range(size, len(frames), size))
    scaled = (prepare(u) * part[:, None, None] for u, part in zip(frames.blocks(size), parts, strict=True))
    squares = float(np.sum((sizes * scale) ** 2))
    decomposition = decompose(scaled, image, allowance(squares, len(frames), size), least=modes + spare)
    rank = int(np.sum(decomposition.values**2 > RANK_TOLERANCE * decomposition.values[0] ** 2))
    if modes > rank:
        raise InputError(
            f"modes must be at most {rank}, the independent shapes of {len(frames)} snapshots, got {modes}; "
            "use more runs"
        )
    lost = float(np.sqrt(decomposition.dropped / squares))
    return _orthonormal(body, decomposition.shapes(min(modes + spare, rank))), lost


def _sizes(fields: Floats, image: Callable[[Floats], Floats]) -> Floats:
    return np.sqrt(np.maximum(np.einsum("bnc,bnc->b", fields, image(fields)), 0.0))


def _orthonormal(body: EnergyModel, fields: Floats) -> Floats:
    """Return fields (m, n, 3) with the same span, orthonormal in the volumes."""
    weights = np.repeat(np.sqrt(body.volumes), 3)
    orthonormal, _ = np.linalg.qr((fields.reshape(len(fields), -1) * weights).T)
    return np.asarray((orthonormal / weights[:, None]).T.reshape(fields.shape))


def join(body: EnergyModel, modes: Floats | None, enrichment: Floats | None) -> Floats:
    """Return modes and enrichment, orthonormal together."""
    if enrichment is None:
        return np.zeros((0, len(body.cloud), 3)) if modes is None else modes
    if enrichment.ndim != 3 or enrichment.shape[1:] != (len(body.cloud), 3) or not np.isfinite(enrichment).all():
        raise InputError(f"enrichment must have shape (e, {len(body.cloud)}, 3) and be finite, got {enrichment.shape}")
    blocked = enrichment - body.supported.project(enrichment.copy())
    if np.abs(blocked).max(initial=0.0) > SUPPORT_TOLERANCE * np.abs(enrichment).max(initial=0.0):
        raise InputError("enrichment must vanish at the supports, got displacements across them; set them to 0")
    sizes = np.linalg.norm(enrichment, axis=2).max(axis=1)[:, None, None]
    return _orthonormal(body, enrichment / sizes if modes is None else np.concatenate([modes, enrichment / sizes]))
