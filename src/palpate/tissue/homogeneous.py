"""Nominal stress of a law in the homogeneous deformations of a testing machine.

Every deformation but simple shear is a stretch l along the machine, and principal stretches

    uniaxial     (l, s, s)    tension and compression, free at the sides
    equibiaxial  (l, l, s)    free through the thickness
    planar       (l, 1, s)    a wide strip, also called pure shear
    shear        F = I + gamma e1 e2^T, simple shear, P12

in which the free stretch s makes the stress P33 along it vanish. A material that keeps its volume has s from det F = 1,
and a stress known but for a pressure, P = dW/dF - p cof F. That P33 vanishes gives the pressure, and

    P11 = (dW/dF)11 - (dW/dF)33 s / l,

in which every function of J alone cancels: any compressible law with the same W on det F = 1 gives the same.
Holzapfel, Nonlinear Solid Mechanics, Wiley 2000, sections 6.3 and 6.5.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from palpate.arrays import Floats
from palpate.faults import InputError
from palpate.tissue.materials import Material

__all__ = ["KINDS", "compressible", "deformation_gradient", "isochoric_stress", "nominal_stress", "rest"]


# kind of test: the exponents of l in the second and the third principal stretch where the volume stays
_ISOCHORIC = {"uniaxial": (-0.5, -0.5), "equibiaxial": (1.0, -2.0), "planar": (0.0, -1.0)}
KINDS = (*_ISOCHORIC, "shear")
NARROWEST, WIDEST = 0.02, 6.0  # half a bracket, in logarithms of the free stretch
ROUNDS = 60  # of a root; eight or so are usual
ENOUGH = 1e-10  # the last step of a root in its logarithm: the error then is far below


def rest(kind: str) -> float:
    """Return the deformation of a specimen at rest: the stretch 1, or the shear 0."""
    return 0.0 if _known(kind) == "shear" else 1.0


def compressible(material: Material) -> Material:
    """Return the material itself, or one with the same energy wherever the volume stays if it is incompressible."""
    return replace(material, poisson=0.25, bulk=None) if material.incompressible else material


def nominal_stress(material: Material, kind: str, deformation: ArrayLike) -> Floats:
    """Return the force per undeformed area that a testing machine measures.

    Parameters
    ----------
    material : Material
        Compressible, or incompressible (Poisson's ratio 0.5).
    kind : str
        ``"uniaxial"``, ``"equibiaxial"``, ``"planar"`` or ``"shear"``.
    deformation : (n,) array
        Stretches, positive; shears gamma where the kind is ``"shear"``.

    Returns
    -------
    (n,) array [Pa]
        NaN where no free stretch within a factor of 400 of the isochoric one frees the sides of stress.

    Raises
    ------
    InputError
        The kind is unknown, or a stretch is not positive.
    """
    return _machine_stress(compressible(material), kind, deformation_gradient(material, kind, deformation))


def isochoric_stress(material: Material, kind: str, deformation: ArrayLike) -> Floats:
    """Return the nominal stress [Pa] of the same law, were it incompressible; as `nominal_stress`."""
    return _machine_stress(compressible(material), kind, _isochoric(kind, _checked(kind, deformation)))


def deformation_gradient(material: Material, kind: str, deformation: ArrayLike) -> Floats:
    """Return F of a specimen of `material`, (n, 3, 3); parameters and errors as for `nominal_stress`."""
    values = _checked(kind, deformation)
    F = _isochoric(kind, values)
    if material.incompressible or kind == "shear":
        return F
    free = np.array([_ISOCHORIC[kind][0] < 0, True])  # of the second and the third direction

    def released(logarithm: Floats) -> Floats:
        F[:, 1, 1] = np.where(free[0], np.exp(logarithm), F[:, 1, 1])
        F[:, 2, 2] = np.exp(logarithm)
        return F

    with np.errstate(all="ignore"):  # what a law has no energy for is NaN
        return released(_root(lambda y: material.stress(released(y))[:, 2, 2], np.log(F[:, 2, 2])))


def _known(kind: str) -> str:
    if kind not in KINDS:
        raise InputError(f"kind = {kind!r} is unknown: allowed are {', '.join(KINDS)}")
    return kind


def _checked(kind: str, deformation: ArrayLike) -> Floats:
    values = np.atleast_1d(np.asarray(deformation, dtype=float))
    if _known(kind) != "shear" and not np.all(values > 0):
        raise InputError(f"stretch = {values[~(values > 0)][0]:g} is out of range: allowed is (0, inf)")
    return values


def _isochoric(kind: str, values: Floats) -> Floats:
    F = np.tile(np.eye(3), (len(values), 1, 1))
    if kind == "shear":
        F[:, 0, 1] = values
        return F
    second, third = _ISOCHORIC[kind]
    F[:, 0, 0], F[:, 1, 1], F[:, 2, 2] = values, values**second, values**third
    return F


def _machine_stress(material: Material, kind: str, F: Floats) -> Floats:
    with np.errstate(all="ignore"):
        P = material.stress(F)
        if kind == "shear":
            return np.asarray(P[:, 0, 1])
        return np.asarray(P[:, 0, 0] - P[:, 2, 2] * F[:, 2, 2] / F[:, 0, 0])


def _root(function: Callable[[Floats], Floats], near: Floats) -> Floats:
    """Zeros of a function that rises through them, by the Illinois method; NaN where none is found."""
    a, fa, b, fb = _bracket(function, near)
    for _ in range(ROUNDS):
        slope = fb - fa
        step = np.where(slope == 0, 0.0, -fb * (b - a) / np.where(slope == 0, 1.0, slope))
        new = b + step
        value = function(new)
        crossed = np.signbit(value) != np.signbit(fb)
        a, fa = np.where(crossed, b, a), np.where(crossed, fb, fa / 2)
        b, fb = new, value
        if not np.any(np.abs(step) > ENOUGH):
            break
    return b


def _bracket(function: Callable[[Floats], Floats], near: Floats) -> tuple[Floats, Floats, Floats, Floats]:
    """Widen an interval about a point until a function is negative at its left and positive at its right end."""
    low, high, half = near - NARROWEST, near + NARROWEST, NARROWEST
    at_low, at_high = function(low), function(high)
    while half < WIDEST:
        left, right = at_low > 0, at_high < 0
        if not np.any(left | right):
            break
        half *= 4
        # the end that was passed is the other end now, so that the interval stays short
        low, high = (
            np.where(left, near - half, np.where(right, high, low)),
            np.where(right, near + half, np.where(left, low, high)),
        )
        at_low, at_high = function(low), function(high)
    found = (at_low <= 0) & (at_high >= 0)
    return np.where(found, low, np.nan), at_low, np.where(found, high, np.nan), at_high
