"""The compliance of a surface in a model's file: its datasets, and what is refused in them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from palpate.faults import InputError, number_in_range
from palpate.reduction.contact.compliance import Dents
from palpate.reduction.contact.interior import Inside

__all__ = ["DENTS", "WITHIN", "stored_dents"]

Arrays = Mapping[str, np.ndarray[Any, Any]]

DENTS = ("nodes", "carriers", "weights", "flexibility", "close", "between", "patches", "shares", "hardening")
# where the nodes inside follow dents: type, and shape in sizes that all datasets of the file share
WITHIN: dict[str, tuple[str, tuple[str | int, ...]]] = {
    "inside/nodes": ("<i8", ("followers",)),
    "inside/flexibility": ("<f4", ("carriers", "moved")),
    "inside/sources": ("<i8", ("followers", "followed")),
    "inside/shares": ("<f8", ("followers", "followed")),
    "inside/factor": ("<f8", (1,)),
}


def stored_dents(arrays: Arrays, grip: float) -> Dents | None:
    """Make the compliance of the surface; none where no nodes may be touched.

    Raises
    ------
    InputError
        What no compliance has.
    """
    known: dict[str, Any] = {name: arrays[f"dents/{name}"] for name in DENTS}
    dents = Dents(**known, grip=grip)
    if not len(dents.nodes):
        return None
    if len(np.unique(dents.nodes)) < len(dents.nodes):
        raise InputError("array dents/nodes names a node twice")
    diagonal = np.diagonal(dents.flexibility)
    if not (np.all(diagonal >= 0) and diagonal.sum() > 0):
        raise InputError("array dents/flexibility holds no positive compliance")
    if not np.all((dents.carriers >= 0) & (3 * dents.carriers + 2 < len(diagonal))):
        raise InputError(f"array dents/carriers names rows outside the {len(diagonal)} of dents/flexibility")
    for name in ("patches", "close"):
        if not np.all((arrays[f"dents/{name}"] >= 0) & (arrays[f"dents/{name}"] < len(dents.nodes))):
            raise InputError(f"array dents/{name} names rows outside the {len(dents.nodes)} of dents/nodes")
    if not (dents.hardening[0] >= 0 and dents.hardening[1] > 0):
        raise InputError("array dents/hardening holds no exponent of at least 0 and positive force")
    inside = _inside(arrays, dents) if "inside/nodes" in arrays else None
    single = {name: getattr(dents, name).astype(np.float32) for name in ("flexibility", "between")}
    return dents._replace(**single, inside=inside)


def _inside(arrays: Arrays, dents: Dents) -> Inside:
    nodes, flexibility, sources, shares, factor = (arrays[name] for name in WITHIN)
    count, more = divmod(flexibility.shape[1], 3)
    if more:
        raise InputError(f"array inside/flexibility holds {3 * count + more} columns, not 3 a node")
    carriers = len(dents.flexibility) // 3
    if not np.all((sources >= 0) & (sources < count + carriers)):
        raise InputError(f"array inside/sources names more than {count} nodes inside and {carriers} carriers")
    whole = number_in_range("inside/factor", float(factor[0]), 0.0, open_low=True)
    return Inside(nodes, flexibility.astype(np.float32), sources, shares, whole)
