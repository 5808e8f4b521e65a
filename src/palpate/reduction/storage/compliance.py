"""Surface compliance in a model's file: its datasets and their validation."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from palpate.faults import InputError, number_in_range
from palpate.reduction.contact.compliance import SurfaceCompliance
from palpate.reduction.contact.interior import Interior

__all__ = ["COMPLIANCE", "INTERIOR", "read_compliance"]

Arrays = Mapping[str, np.ndarray[Any, Any]]

COMPLIANCE = ("nodes", "carriers", "weights", "flexibility", "nearby", "near_field", "patches", "shares", "stiffening")
MAX_WEIGHT, ROW_TOLERANCE = 1e3, 1e-6  # of interpolations, whose rows sum to 1
# of the interior nodes: type, and shape in sizes that all datasets of the file share
INTERIOR: dict[str, tuple[str, tuple[str | int, ...]]] = {
    "interior/nodes": ("<i8", ("followers",)),
    "interior/flexibility": ("<f4", ("carriers", "moved")),
    "interior/sources": ("<i8", ("followers", "followed")),
    "interior/shares": ("<f8", ("followers", "followed")),
    "interior/factor": ("<f8", (1,)),
}


def read_compliance(arrays: Arrays, bonded_scale: float) -> SurfaceCompliance | None:
    """Return the surface compliance; None for an empty contact surface.

    Raises
    ------
    InputError
        The arrays do not describe a compliance.
    """
    known: dict[str, Any] = {name: arrays[f"compliance/{name}"] for name in COMPLIANCE}
    compliance = SurfaceCompliance(**known, bonded_scale=bonded_scale)
    if not len(compliance.nodes):
        return None
    if len(np.unique(compliance.nodes)) < len(compliance.nodes):
        raise InputError("array compliance/nodes names a node twice")
    diagonal = np.diagonal(compliance.flexibility)
    if not (np.all(diagonal >= 0) and diagonal.sum() > 0):
        raise InputError("array compliance/flexibility holds no positive compliance")
    if not np.all((compliance.carriers >= 0) & (3 * compliance.carriers + 2 < len(diagonal))):
        raise InputError(f"array compliance/carriers names rows outside the {len(diagonal)} of compliance/flexibility")
    for name in ("patches", "nearby"):
        if not np.all((arrays[f"compliance/{name}"] >= 0) & (arrays[f"compliance/{name}"] < len(compliance.nodes))):
            raise InputError(
                f"array compliance/{name} names rows outside the {len(compliance.nodes)} of compliance/nodes"
            )
    for name in ("weights", "shares"):
        rows = arrays[f"compliance/{name}"]
        if np.abs(rows).max() > MAX_WEIGHT or np.abs(rows.sum(axis=1) - 1).max() > ROW_TOLERANCE:
            raise InputError(f"array compliance/{name} must have rows of sum 1")
    if not (0 <= compliance.stiffening[0] < 1 and compliance.stiffening[1] > 0):
        raise InputError("array compliance/stiffening must hold an exponent in [0, 1) and a positive force")
    interior = _interior(arrays, compliance) if "interior/nodes" in arrays else None
    single = {name: getattr(compliance, name).astype(np.float32) for name in ("flexibility", "near_field")}
    return compliance._replace(**single, interior=interior)


def _interior(arrays: Arrays, compliance: SurfaceCompliance) -> Interior:
    nodes, flexibility, sources, shares, factor = (arrays[name] for name in INTERIOR)
    count, more = divmod(flexibility.shape[1], 3)
    if more:
        raise InputError(f"array interior/flexibility holds {3 * count + more} columns, not 3 a node")
    carriers = len(compliance.flexibility) // 3
    if not np.all((sources >= 0) & (sources < count + carriers)):
        raise InputError(f"array interior/sources names more than {count} nodes inside and {carriers} carriers")
    whole = number_in_range("interior/factor", float(factor[0]), 0.0, open_low=True)
    return Interior(nodes, flexibility.astype(np.float32), sources, shares, whole)
