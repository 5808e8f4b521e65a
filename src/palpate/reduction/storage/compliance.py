"""Surface compliance in a model's file: its datasets and their validation.

Flexibilities are multiples of a power of two (`palpate.reduction.training.round_compliance`).
Such an array, k times a step, is stored as the unsigned integers k + `INTEGER_OFFSET`, whose high bytes
are equal for all small k. Other arrays, of models that were not rounded, are stored as they are. Of a
symmetric array the upper triangle is zero in the file. Both only make the file smaller: a loaded model
has the bits of the saved one.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from palpate.core.faults import InputError, number_in_range
from palpate.core.sealed import Array, check_arrays
from palpate.reduction.contact.compliance import SurfaceCompliance
from palpate.reduction.contact.interior import Interior
from palpate.reduction.storage.body import MAX_NUMBER

Arrays = Mapping[str, np.ndarray[Any, Any]]

COMPLIANCE_ARRAYS = {
    "compliance/nodes": Array(("touched",), "<i8", index_of="nodes"),
    "compliance/carriers": Array(("touched", "carried"), "<i8"),
    "compliance/weights": Array(("touched", "carried"), most=MAX_NUMBER),
    "compliance/flexibility": Array(("carriers", "carriers"), "<f4", most=MAX_NUMBER, unit="m/N"),
    "compliance/nearby": Array(("touched", "nearby"), "<i8", index_of="touched"),
    "compliance/near_field": Array(("touched", "nearby", 3, 3), "<f4", most=MAX_NUMBER, unit="m/N"),
    "compliance/patches": Array(("touched", "patched"), "<i8", index_of="touched"),
    "compliance/shares": Array(("touched", "patched"), most=MAX_NUMBER),
    "compliance/stiffening": Array((2,), most=MAX_NUMBER),
}
INTERIOR_ARRAYS = {
    "interior/nodes": Array(("followers",), "<i8", index_of="nodes"),
    "interior/flexibility": Array(("carriers", "moved"), "<f4", most=MAX_NUMBER, unit="m/N"),
    "interior/sources": Array(("followers", "followed"), "<i8"),
    "interior/shares": Array(("followers", "followed"), most=MAX_NUMBER),
    "interior/factor": Array((1,), most=MAX_NUMBER),
}
FLEXIBILITY_ARRAYS = ("compliance/flexibility", "compliance/near_field", "interior/flexibility")
STEPS_ARRAY = {"compliance/steps": Array((len(FLEXIBILITY_ARRAYS),))}
MAX_WEIGHT, ROW_TOLERANCE = 1e3, 1e-6  # of interpolations, whose rows sum to 1
INTEGER_OFFSET = (1 << 15) + (1 << 7)  # added to integers; those in -128..127 then have equal high bytes
MIN_EXPONENT = -100  # of a step; its multiples then have all digits in single precision


def pack_flexibilities(arrays: Arrays) -> dict[str, np.ndarray[Any, Any]]:
    """Return the arrays of a file with flexibilities as integers, and their steps; 0 for those stored as they are."""
    result, steps = dict(arrays), np.zeros(len(FLEXIBILITY_ARRAYS))
    result["compliance/flexibility"] = np.tril(arrays["compliance/flexibility"])
    for k, name in enumerate(FLEXIBILITY_ARRAYS):
        if name in arrays:
            result[name], steps[k] = _pack(result[name])
    return result | {"compliance/steps": steps}


def _pack(values: np.ndarray[Any, Any]) -> tuple[np.ndarray[Any, Any], float]:
    step = _common_step(values)
    if (
        not step
        or values.max() / step + INTEGER_OFFSET > np.iinfo(np.uint16).max
        or values.min() / step + INTEGER_OFFSET < 0
    ):
        return values, 0.0
    return (values / np.float32(step) + INTEGER_OFFSET).astype("<u2"), step


def _common_step(values: np.ndarray[Any, Any]) -> float:
    """Return the largest power of two of which all values are multiples; 0 if there is none."""
    if not values.any() or not np.isfinite(values).all():
        return 0.0
    bits = values.astype("<f4").view("<u4")
    exponents, digits = (bits >> 23) & 0xFF, bits & 0x7FFFFF | 0x800000
    if exponents[values != 0].min() == 0:  # subnormal
        return 0.0
    # exponent of the last digit that is not zero
    last = exponents.astype(np.int32) - 150 + np.frexp((digits & -digits.astype(np.int32)).astype(float))[1] - 1
    exponent = int(last[values != 0].min())
    return float(np.ldexp(1.0, exponent)) if exponent >= MIN_EXPONENT else 0.0


def unpack_flexibilities(arrays: Arrays) -> dict[str, np.ndarray[Any, Any]]:
    """Return the arrays of a file with flexibilities in single precision, and both triangles of that of the surface."""
    result = dict(arrays)
    steps = result.pop("compliance/steps", np.zeros(len(FLEXIBILITY_ARRAYS)))
    check_arrays({"compliance/steps": steps}, STEPS_ARRAY, {})
    fractions, exponents = np.frexp(steps)
    if not np.all((steps == 0) | ((fractions == 0.5) & (exponents > MIN_EXPONENT) & (exponents < -MIN_EXPONENT))):
        raise InputError("array compliance/steps must hold powers of two, or 0 for arrays without a step")
    for name, step in zip(FLEXIBILITY_ARRAYS, steps, strict=True):
        if step and name in result:
            if result[name].dtype != "<u2":
                raise InputError(f"array {name} has values of {result[name].dtype.str} with a step, expected <u2")
            result[name] = (result[name].astype("<f4") - np.float32(INTEGER_OFFSET)) * np.float32(step)
    flexibility = result["compliance/flexibility"]
    if flexibility.ndim == 2 and flexibility.shape[0] == flexibility.shape[1] and not np.triu(flexibility, 1).any():
        result["compliance/flexibility"] = flexibility + np.tril(flexibility, -1).T
    return result


def read_compliance(arrays: Arrays, bonded_scale: float) -> SurfaceCompliance | None:
    """Return the surface compliance; None for an empty contact surface."""
    values: dict[str, Any] = {name.removeprefix("compliance/"): arrays[name] for name in COMPLIANCE_ARRAYS}
    compliance = SurfaceCompliance(**values, bonded_scale=bonded_scale)
    if not len(compliance.nodes):
        return None
    if len(np.unique(compliance.nodes)) < len(compliance.nodes):
        raise InputError("array compliance/nodes names a node twice")
    diagonal = np.diagonal(compliance.flexibility)
    if not (np.all(diagonal >= 0) and diagonal.sum() > 0):
        raise InputError("array compliance/flexibility holds no positive compliance")
    if not np.array_equal(compliance.flexibility, compliance.flexibility.T):
        raise InputError("array compliance/flexibility must be symmetric, or zero above its diagonal")
    if not np.all((compliance.carriers >= 0) & (3 * compliance.carriers + 2 < len(diagonal))):
        raise InputError(f"array compliance/carriers names rows outside the {len(diagonal)} of compliance/flexibility")
    for name in ("weights", "shares"):
        rows = arrays[f"compliance/{name}"]
        if np.abs(rows).max() > MAX_WEIGHT or np.abs(rows.sum(axis=1) - 1).max() > ROW_TOLERANCE:
            raise InputError(f"array compliance/{name} must have rows of sum 1")
    if not (0 <= compliance.stiffening[0] < 1 and compliance.stiffening[1] > 0):
        raise InputError("array compliance/stiffening must hold an exponent in [0, 1) and a positive force")
    interior = _interior(arrays, compliance) if "interior/nodes" in arrays else None
    return compliance._replace(interior=interior)


def _interior(arrays: Arrays, compliance: SurfaceCompliance) -> Interior:
    nodes, flexibility, sources, shares, factor = (arrays[name] for name in INTERIOR_ARRAYS)
    count, more = divmod(flexibility.shape[1], 3)
    if more:
        raise InputError(f"array interior/flexibility holds {3 * count + more} columns, not 3 a node")
    carriers = len(compliance.flexibility) // 3
    if not np.all((sources >= 0) & (sources < count + carriers)):
        raise InputError(f"array interior/sources names more than {count} nodes inside and {carriers} carriers")
    interior_factor = number_in_range("interior/factor", float(factor[0]), 0.0, open_low=True)
    return Interior(nodes, flexibility, sources, shares, interior_factor)
