"""The compiled stress and energy of fibres (`palpate.tissue.fibres`), added to those of a law.

Both take F - I at a point, nine numbers row by row, and the point's lane in its block. The functions
for bodies without fibres return their argument at no cost.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from palpate.compiled.jit import law_digest, law_njit, rename_for
from palpate.compiled.lanes import LANES
from palpate.core.arrays import Floats
from palpate.core.faults import InputError
from palpate.tissue.fibres import MIN_VOLUME_RATIO, FibreLaw
from palpate.tissue.materials import Material


class Families(NamedTuple):
    """Coefficients of the fibre law, and directions (b, f, 3, LANES) in blocks of lanes."""

    coefficients: Floats
    directions: Floats


class FibrePoints(NamedTuple):
    """Compiled functions of fibres at a point."""

    digest: str  # digest of their sources; empty without fibres
    add_stress: Any  # ``add_stress(P, d0, ..., d8, b, v, families)`` returns P, nine numbers, plus the fibres' stress
    add_energy: Any  # ``add_energy(W, d0, ..., d8, b, v, families)`` returns W plus their energy


def prepare_fibres(fibres: FibreLaw | None, material: Material, form: str, points: Floats) -> FibreLaw | None:
    """Return the fibres with a direction at every node; raise `InputError` for unsupported bodies."""
    if fibres is None:
        return None
    if not isinstance(fibres, FibreLaw):
        raise InputError(f"fibres must be palpate.materials.Fibres or palpate.materials.Guccione, got {fibres!r:.200}")
    if form != "energy" or material.variables == "small strain":
        raise InputError("fibres must be None unless form='energy' with a law of finite strain; use form='energy'")
    return fibres.at(points)


def tension_compression_fibres(families: Families) -> Families:
    """Return tension-compression fibres, which carry compression too, for the stable step."""
    coefficients = families.coefficients.copy()
    coefficients[-1:] = 1.0
    return families._replace(coefficients=coefficients)


def lay_out_fibres(fibres: FibreLaw | None, nodes: NDArray[np.integer[Any]]) -> Families:
    """Lay out the fibres of nodes (b, LANES); empty for None."""
    if fibres is None:
        return Families(np.zeros(0), np.zeros((0, 0, 3, LANES)))
    directions = np.ascontiguousarray(fibres.directions[:, nodes].transpose(1, 0, 3, 2))
    return Families(np.array(fibres.coefficients), directions)


@register_jitable
def _unchanged(value, d0, d1, d2, d3, d4, d5, d6, d7, d8, b, v, families):
    return value


@register_jitable
def _isochoric_strain(d0, d1, d2, d3, d4, d5, d6, d7, d8):
    """Return F, cof F, C (00 11 22 01 02 12), and J^(-2/3) with its derivative."""
    F = (1.0 + d0, d1, d2, d3, 1.0 + d4, d5, d6, d7, 1.0 + d8)
    cofactor = (
        F[4] * F[8] - F[5] * F[7], F[5] * F[6] - F[3] * F[8], F[3] * F[7] - F[4] * F[6],
        F[2] * F[7] - F[1] * F[8], F[0] * F[8] - F[2] * F[6], F[1] * F[6] - F[0] * F[7],
        F[1] * F[5] - F[2] * F[4], F[2] * F[3] - F[0] * F[5], F[0] * F[4] - F[1] * F[3],
    )  # fmt: skip
    C = (
        F[0] * F[0] + F[3] * F[3] + F[6] * F[6], F[1] * F[1] + F[4] * F[4] + F[7] * F[7],
        F[2] * F[2] + F[5] * F[5] + F[8] * F[8], F[0] * F[1] + F[3] * F[4] + F[6] * F[7],
        F[0] * F[2] + F[3] * F[5] + F[6] * F[8], F[1] * F[2] + F[4] * F[5] + F[7] * F[8],
    )  # fmt: skip
    J = F[0] * cofactor[0] + F[1] * cofactor[1] + F[2] * cofactor[2]
    large = max(J, MIN_VOLUME_RATIO)
    root = np.cbrt(large)
    power = 1.0 / (root * root)
    slope = -2.0 / 3.0 * power / large
    return F, cofactor, C, power + slope * (J - large), slope


NO_FIBRES = FibrePoints("", _unchanged, _unchanged)


def fibre_points(fibres: FibreLaw | None) -> FibrePoints:
    """Return the compiled functions of fibres, or those for None."""
    if fibres is None:
        return NO_FIBRES
    return _compiled(type(fibres), len(fibres.directions))


@cache
def _compiled(law: type[FibreLaw], count: int) -> FibrePoints:
    """Compile the functions of a fibre law with `count` families."""
    digest = law_digest(__name__, "fibres", law.respond, count, MIN_VOLUME_RATIO)
    respond = register_jitable(rename_for(digest, law.respond))

    @law_njit(digest, cached=False, fastmath={"contract"}, forceinline=True)
    def add_stress(P, d0, d1, d2, d3, d4, d5, d6, d7, d8, b, v, families):
        F, c, C, s, slope = _isochoric_strain(d0, d1, d2, d3, d4, d5, d6, d7, d8)
        isochoric = (s * C[0], s * C[1], s * C[2], s * C[3], s * C[4], s * C[5])
        S0, S1, S2, S3, S4, S5 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for f in range(count):
            a = families.directions[b, f]
            _, S = respond(isochoric, (a[0, v], a[1, v], a[2, v]), families.coefficients)
            S0, S1, S2, S3, S4, S5 = S0 + S[0], S1 + S[1], S2 + S[2], S3 + S[3], S4 + S[4], S5 + S[5]
        p = 0.5 * slope * (S0 * C[0] + S1 * C[1] + S2 * C[2] + 2.0 * (S3 * C[3] + S4 * C[4] + S5 * C[5]))
        return (
            P[0] + s * (F[0] * S0 + F[1] * S3 + F[2] * S4) + p * c[0],
            P[1] + s * (F[0] * S3 + F[1] * S1 + F[2] * S5) + p * c[1],
            P[2] + s * (F[0] * S4 + F[1] * S5 + F[2] * S2) + p * c[2],
            P[3] + s * (F[3] * S0 + F[4] * S3 + F[5] * S4) + p * c[3],
            P[4] + s * (F[3] * S3 + F[4] * S1 + F[5] * S5) + p * c[4],
            P[5] + s * (F[3] * S4 + F[4] * S5 + F[5] * S2) + p * c[5],
            P[6] + s * (F[6] * S0 + F[7] * S3 + F[8] * S4) + p * c[6],
            P[7] + s * (F[6] * S3 + F[7] * S1 + F[8] * S5) + p * c[7],
            P[8] + s * (F[6] * S4 + F[7] * S5 + F[8] * S2) + p * c[8],
        )

    @law_njit(digest, cached=False, fastmath={"contract"}, forceinline=True)
    def add_energy(W, d0, d1, d2, d3, d4, d5, d6, d7, d8, b, v, families):
        _, _, C, s, _ = _isochoric_strain(d0, d1, d2, d3, d4, d5, d6, d7, d8)
        isochoric = (s * C[0], s * C[1], s * C[2], s * C[3], s * C[4], s * C[5])
        for f in range(count):
            a = families.directions[b, f]
            w, _ = respond(isochoric, (a[0, v], a[1, v], a[2, v]), families.coefficients)
            W += w
        return W

    return FibrePoints(digest, add_stress, add_energy)
