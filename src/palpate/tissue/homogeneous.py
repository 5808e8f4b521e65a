"""Nominal stress of a law in the homogeneous deformations of a testing machine.

Except in simple shear, the specimen has a stretch l along the machine, and principal stretches

    uniaxial     (l, s, s)    tension and compression, free at the sides
    equibiaxial  (l, l, s)    free through the thickness
    planar       (l, 1, s)    a wide strip, also called pure shear
    shear        F = I + gamma e1 e2^T, simple shear, P12

where the free stretch s follows from P33 = 0. In an incompressible material s follows from det F =
1, and the stress is P = dW/dF - p cof F with an unknown pressure p. P33 = 0 gives the pressure, and

    P11 = (dW/dF)11 - (dW/dF)33 s / l,

Every function of J alone cancels: any compressible law with the same W on det F = 1 gives the same
stress. Holzapfel, Nonlinear Solid Mechanics, Wiley 2000, sections 6.3 and 6.5.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from palpate.core.arrays import Floats
from palpate.core.faults import InputError, brief
from palpate.tissue.materials import Material

# kind of test: exponents of l in the second and third principal stretch at constant volume
_STRETCH_EXPONENTS = {"uniaxial": (-0.5, -0.5), "equibiaxial": (1.0, -2.0), "planar": (0.0, -1.0)}
DEFORMATION_KINDS = (*_STRETCH_EXPONENTS, "shear")
MIN_HALF_BRACKET, MAX_HALF_BRACKET = 0.02, 6.0  # half widths of the bracket of the logarithm of the free stretch
MAX_ITERATIONS = 60  # about eight are usual
LOG_TOLERANCE = 1e-10  # of the last step in the logarithm; the error is much smaller


def rest(kind: str) -> float:
    """Return the deformation at rest: stretch 1 or shear 0."""
    return 0.0 if _check_kind(kind) == "shear" else 1.0


def compressible(material: Material) -> Material:
    """Return a compressible material with the same energy at constant volume."""
    return replace(material, poisson=0.25, bulk=None) if material.incompressible else material


def nominal_stress(material: Material, kind: str, deformation: ArrayLike) -> Floats:
    """Return the nominal stress (n,) [Pa], the force per undeformed area of the machine.

    The kind is ``"uniaxial"``, ``"equibiaxial"``, ``"planar"`` or ``"shear"``. `deformation` (n,) are stretches,
    positive; shears gamma where the kind is ``"shear"``. The stress is NaN where no free stretch within a factor of 400
    of the isochoric one gives P33 = 0.
    """
    return _machine_stress(compressible(material), kind, deformation_gradient(material, kind, deformation))


def isochoric_stress(material: Material, kind: str, deformation: ArrayLike) -> Floats:
    """Return the nominal stress [Pa] of the incompressible law; parameters as for `nominal_stress`."""
    return _machine_stress(
        compressible(material), kind, _isochoric_gradient(kind, _check_deformation(kind, deformation))
    )


def deformation_gradient(material: Material, kind: str, deformation: ArrayLike) -> Floats:
    """Return F of a specimen of `material`, (n, 3, 3); parameters and errors as for `nominal_stress`."""
    values = _check_deformation(kind, deformation)
    F = _isochoric_gradient(kind, values)
    if material.incompressible or kind == "shear":
        return F
    free = np.array([_STRETCH_EXPONENTS[kind][0] < 0, True])  # of the second and the third direction

    def with_free_stretch(logarithm: Floats) -> Floats:
        F[:, 1, 1] = np.where(free[0], np.exp(logarithm), F[:, 1, 1])
        F[:, 2, 2] = np.exp(logarithm)
        return F

    with np.errstate(all="ignore"):  # NaN where the law has no energy
        return with_free_stretch(
            _find_root(lambda y: material.stress(with_free_stretch(y))[:, 2, 2], np.log(F[:, 2, 2]))
        )


def _check_kind(kind: str) -> str:
    if kind not in DEFORMATION_KINDS:
        raise InputError(f"kind must be one of {', '.join(DEFORMATION_KINDS)}, got {brief(kind)}")
    return kind


def _check_deformation(kind: str, deformation: ArrayLike) -> Floats:
    values = np.atleast_1d(np.asarray(deformation, dtype=float))
    if _check_kind(kind) != "shear" and not np.all(values > 0):
        raise InputError(f"stretch must be in (0, inf), got {values[~(values > 0)][0]:g}")
    return values


def _isochoric_gradient(kind: str, values: Floats) -> Floats:
    F = np.tile(np.eye(3), (len(values), 1, 1))
    if kind == "shear":
        F[:, 0, 1] = values
        return F
    second, third = _STRETCH_EXPONENTS[kind]
    F[:, 0, 0], F[:, 1, 1], F[:, 2, 2] = values, values**second, values**third
    return F


def _machine_stress(material: Material, kind: str, F: Floats) -> Floats:
    with np.errstate(all="ignore"):
        P = material.stress(F)
        if kind == "shear":
            return np.asarray(P[:, 0, 1])
        return np.asarray(P[:, 0, 0] - P[:, 2, 2] * F[:, 2, 2] / F[:, 0, 0])


def _find_root(function: Callable[[Floats], Floats], start: Floats) -> Floats:
    """Return zeros of increasing functions by the Illinois method; NaN where none is found."""
    a, fa, b, fb = _bracket(function, start)
    for _ in range(MAX_ITERATIONS):
        slope = fb - fa
        step = np.where(slope == 0, 0.0, -fb * (b - a) / np.where(slope == 0, 1.0, slope))
        new = b + step
        value = function(new)
        crossed = np.signbit(value) != np.signbit(fb)
        a, fa = np.where(crossed, b, a), np.where(crossed, fb, fa / 2)
        b, fb = new, value
        if not np.any(np.abs(step) > LOG_TOLERANCE):
            break
    return b


def _bracket(function: Callable[[Floats], Floats], start: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Return brackets of the zeros of increasing functions, widened about a starting point."""
    low, high, half = start - MIN_HALF_BRACKET, start + MIN_HALF_BRACKET, MIN_HALF_BRACKET
    at_low, at_high = function(low), function(high)
    while half < MAX_HALF_BRACKET:
        left, right = at_low > 0, at_high < 0
        if not np.any(left | right):
            break
        half *= 4
        # the old end becomes the opposite end, so that the interval stays short
        low, high = (
            np.where(left, start - half, np.where(right, high, low)),
            np.where(right, start + half, np.where(left, low, high)),
        )
        at_low, at_high = function(low), function(high)
    bracketed = (at_low <= 0) & (at_high >= 0)
    return np.where(bracketed, low, np.nan), at_low, np.where(bracketed, high, np.nan), at_high
