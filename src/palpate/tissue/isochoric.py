"""Isochoric laws: any law of the invariants or stretches as a function of C̄ = J^(-2/3) C.

A *coupled* law W_s(I1, I2, J) also resists a change of volume. Its *isochoric* counterpart is

    W_s(I1 J^(-2/3), I2 J^(-4/3), 1),      of stretches W_s(l1 J^(-1/3), l2 J^(-1/3), l3 J^(-1/3)).

It does not resist a change of volume: only the volumetric part U(J) does, with lame = bulk (Flory,
Trans. Faraday Soc. 57, 829, 1961; Simo, Taylor, Pister, Comput. Methods Appl. Mech. Eng. 51, 1985).
Both agree at constant volume. The isochoric law is free of stress at rest for every W_s.

The isochoric law follows from the functions of the coupled one by the chain rule. In the logarithms
of the stretches the chain rule is a projection. With t_i = l_i dW/dl_i, their derivatives H and D =
I - 1 1^T / 3, the derivatives of the isochoric law are D t and D H D.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from palpate.core.faults import InputError, brief

COUPLED, ISOCHORIC = "coupled", "isochoric"


def check_split(name: str) -> str:
    """Return the name of a split."""
    if name not in (COUPLED, ISOCHORIC):
        raise InputError(f"split must be {COUPLED!r} or {ISOCHORIC!r}, got {brief(name)}")
    return name


@cache
def isochoric(law: type[Any]) -> type[Any]:
    """Return the isochoric counterpart of a law."""
    make = _of_stretches if law.variables == "stretches" else _of_invariants
    names, functions = ("energy", "first", "second"), make(law.energy, law.first, law.second)
    return type(law.__name__, (law,), {n: staticmethod(f) for n, f in zip(names, functions, strict=True)})


def _of_invariants(energy_of: Any, first_of: Any, second_of: Any) -> tuple[Any, Any, Any]:
    def energy(I1, I2, J, c):
        a = 1.0 / np.cbrt(J * J)
        return energy_of(a * I1, a * a * I2, 1.0, c)

    def first(I1, I2, J, c):
        a = 1.0 / np.cbrt(J * J)
        x, y = a * I1, a * a * I2
        V1, V2, _ = first_of(x, y, 1.0, c)
        return a * V1, a * a * V2, -(2.0 * x * V1 + 4.0 * y * V2) / (3.0 * J)

    def second(I1, I2, J, c):
        a = 1.0 / np.cbrt(J * J)
        x, y = a * I1, a * a * I2
        V1, V2, _ = first_of(x, y, 1.0, c)
        V11, V12, V22, _, _, _ = second_of(x, y, 1.0, c)
        # derivatives by x and y of g = p V1 + q V2, where p = 2/3 x and q = 4/3 y are -J dx/dJ and -J dy/dJ
        p, q = 2.0 / 3.0 * x, 4.0 / 3.0 * y
        gx, gy = 2.0 / 3.0 * V1 + p * V11 + q * V12, 4.0 / 3.0 * V2 + p * V12 + q * V22
        WJJ = (p * V1 + q * V2 + p * gx + q * gy) / (J * J)
        return a * a * V11, a**3 * V12, a**4 * V22, -a * gx / J, -a * a * gy / J, WJJ

    return energy, first, second


def _of_stretches(energy_of: Any, first_of: Any, second_of: Any) -> tuple[Any, Any, Any]:
    def energy(l1, l2, l3, c):
        s = 1.0 / np.cbrt(l1 * l2 * l3)
        return energy_of(s * l1, s * l2, s * l3, c)

    def first(l1, l2, l3, c):
        s = 1.0 / np.cbrt(l1 * l2 * l3)
        w1, w2, w3 = first_of(s * l1, s * l2, s * l3, c)
        t1, t2, t3 = s * l1 * w1, s * l2 * w2, s * l3 * w3
        mean = (t1 + t2 + t3) / 3.0
        return (t1 - mean) / l1, (t2 - mean) / l2, (t3 - mean) / l3

    def second(l1, l2, l3, c):
        s = 1.0 / np.cbrt(l1 * l2 * l3)
        a, b, d = s * l1, s * l2, s * l3
        w1, w2, w3 = first_of(a, b, d, c)
        w11, w22, w33, w12, w13, w23 = second_of(a, b, d, c)
        t1, t2, t3 = a * w1, b * w2, d * w3
        H11, H22, H33 = a * a * w11 + t1, b * b * w22 + t2, d * d * w33 + t3
        H12, H13, H23 = a * b * w12, a * d * w13, b * d * w23
        r1, r2, r3 = (H11 + H12 + H13) / 3.0, (H12 + H22 + H23) / 3.0, (H13 + H23 + H33) / 3.0
        mean, mean_rise = (t1 + t2 + t3) / 3.0, (r1 + r2 + r3) / 3.0
        return (
            (H11 - 2.0 * r1 + mean_rise - t1 + mean) / (l1 * l1),
            (H22 - 2.0 * r2 + mean_rise - t2 + mean) / (l2 * l2),
            (H33 - 2.0 * r3 + mean_rise - t3 + mean) / (l3 * l3),
            (H12 - r1 - r2 + mean_rise) / (l1 * l2),
            (H13 - r1 - r3 + mean_rise) / (l1 * l3),
            (H23 - r2 - r3 + mean_rise) / (l2 * l3),
        )

    return energy, first, second
