"""The compliance of a surface in a model's file: its datasets, and what is refused in them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from palpate.faults import InputError, number_in_range
from palpate.reduction.compliance import Dents
from palpate.reduction.inside import Inside

__all__ = ["DENTS", "WITHIN", "stored_dents"]

Arrays = Mapping[str, np.ndarray[Any, Any]]

DENTS = ("nodes", "lengths", "compliances", "carriers", "weights", "flexibility", "patches", "shares", "hardening")
# where the nodes inside follow dents: type, and shape in sizes that all datasets of the file share
WITHIN: dict[str, tuple[str, tuple[str | int, ...]]] = {
    "inside/nodes": ("<i8", ("followers",)),
    "inside/flexibility": ("<f4", ("carriers", "moved")),
    "inside/sources": ("<i8", ("followers", "followed")),
    "inside/shares": ("<f8", ("followers", "followed")),
    "inside/factor": ("<f8", (1,)),
}


def stored_dents(arrays: Arrays, own: float) -> Dents | None:
    """Make the compliance of the surface; none where no nodes may be touched.

    Raises
    ------
    InputError
        What no compliance has.
    """
    dents = Dents(**{name: arrays[f"dents/{name}"] for name in DENTS}, own=own)
    if not len(dents.nodes):
        return None
    diagonal = np.diagonal(dents.flexibility)
    if not (np.all(dents.lengths > 0) and np.all(dents.compliances >= 0) and np.all(diagonal >= 0)):
        raise InputError("datasets dents/lengths, compliances and flexibility hold a compliance that is not positive")
    if not own + dents.compliances.sum() + diagonal.sum() > 0:
        raise InputError("datasets dents/compliances and flexibility hold no compliance")
    if not np.all((dents.carriers >= 0) & (3 * dents.carriers + 2 < len(diagonal))):
        raise InputError(f"dataset dents/carriers names rows outside the {len(diagonal)} of dents/flexibility")
    if not np.all((dents.patches >= 0) & (dents.patches < len(dents.nodes))):
        raise InputError(f"dataset dents/patches names rows outside the {len(dents.nodes)} of dents/nodes")
    if not (dents.hardening[0] >= 0 and dents.hardening[1] > 0):
        raise InputError("dataset dents/hardening holds no exponent of at least 0 and positive force")
    inside = _inside(arrays, dents) if "inside/nodes" in arrays else None
    return dents._replace(flexibility=dents.flexibility.astype(np.float32), inside=inside)


def _inside(arrays: Arrays, dents: Dents) -> Inside:
    nodes, flexibility, sources, shares, factor = (arrays[name] for name in WITHIN)
    count, more = divmod(flexibility.shape[1], 3)
    if more:
        raise InputError(f"dataset inside/flexibility holds {3 * count + more} columns, not 3 a node")
    carriers = len(dents.flexibility) // 3
    if not np.all((sources >= 0) & (sources < count + carriers)):
        raise InputError(f"dataset inside/sources names more than {count} nodes inside and {carriers} carriers")
    whole = number_in_range("inside/factor", factor[0], 0.0, open_low=True)
    return Inside(nodes, flexibility.astype(np.float32), sources, shares, whole)
