"""The additional stress of a membrane: viscoelastic overstress, and fibres in the plane of the sheet.

Both are energies of the strain of the incompressible sheet: of C in its plane and of C33 = 1 / det C
across it. With Q twice their derivative by that strain, and no stress across the sheet, the second
Piola-Kirchhoff stress is

    S = Q - Q33 / (det C)^2 adj(C).

The strain of a wrinkled sheet is that of simple tension, C* = c1 N N^T + w (1 - N N^T) with
w = c1^(-1/2), and that of a slack sheet is zero. The chain rule through C* yields

    S = (Q_NN - w^3 / 2 (Q_TT + Q_33)) N N^T + Q_NT (c1 - w) / (c1 - c2) (N T^T + T N^T),

with T normal to N and c2 the lesser eigenvalue of C. So forces are the derivative of an energy there too.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np

from palpate.compiled.jit import inline, kernel_njit, law_digest, law_njit
from palpate.core.arrays import Floats
from palpate.dynamics.material.relaxation import even_change, update_history
from palpate.dynamics.membrane.principal_moduli import axes
from palpate.tissue.fibres import FibreLaw

MIN_SQUARE_GAP = 1e-30  # least difference of squared stretches in quotients, whose numerators vanish too


class AdditionalStressData(NamedTuple):
    """Arrays of fibres, relaxation and history variables for `AdditionalStress`."""

    coefficients: Floats
    directions: Floats
    moduli: Floats
    times: Floats
    interval: Floats
    strain: Floats
    branches: Floats
    factors: Floats
    lost: Floats


@kernel_njit()
def flatten_additional(families, relaxation, history):
    """Return the arrays in one flat tuple; parallel loops do not support nested tuples."""
    return AdditionalStressData(
        families.coefficients, families.directions, relaxation.moduli, relaxation.times,
        history.interval, history.strain, history.branches, history.factors, history.lost,
    )  # fmt: skip


class AdditionalStress(NamedTuple):
    """The compiled additional stress of a sheet."""

    digest: str  # digest of its sources; empty without additional stress
    # ``response(C00, C11, C01, b, point, v, extras)`` returns the energy, then S as 00 11 01, of a point in lane v; `b`
    # is the block of the node, `point` that of the point. None without additional stress.
    response: Any


NO_ADDITIONAL_STRESS = AdditionalStress("", None)


def additional_stress(fibres: FibreLaw | None, relaxing: bool, relaxed: bool) -> AdditionalStress:
    """Return the additional stress of fibres and viscoelastic branches, of both or neither."""
    if fibres is None and not relaxing:
        return NO_ADDITIONAL_STRESS
    kind = (None, 0) if fibres is None else (type(fibres), len(fibres.directions))
    return _compiled(*kind, relaxing, relaxed)


@cache
def _compiled(law: type[FibreLaw] | None, count: int, relaxing: bool, relaxed: bool) -> AdditionalStress:
    respond_of = _no_fibres if law is None else law.respond
    digest = law_digest(__name__, "additional stress of a sheet", respond_of, count, relaxing, relaxed)
    respond = inline(digest, respond_of)

    @law_njit(digest, cached=False, fastmath={"contract"}, forceinline=True)
    def response(C00, C11, C01, b, point, v, extras):
        D = C00 * C11 - C01 * C01
        E = (C00, C11, 1.0 / D, C01, 0.0, 0.0)
        c1, c2, w, p, q = 1.0, 1.0, 0.0, 1.0, 0.0
        if relaxed:
            c1, c2, p, q = axes(C00, C11, C01)
            w = 1.0 / np.sqrt(max(c1, 1.0))
            if c2 < w:
                c = max(c1, 1.0)
                E = (w + (c - w) * p * p, w + (c - w) * q * q, w, (c - w) * p * q, 0.0, 0.0)
        W, Q0, Q1, Q2, Q3 = 0.0, 0.0, 0.0, 0.0, 0.0
        for f in range(count):
            a = extras.directions[b, f]
            energy, S = respond(E, (a[0, v], a[1, v], a[2, v]), extras.coefficients)
            W, Q0, Q1, Q2, Q3 = W + energy, Q0 + S[0], Q1 + S[1], Q2 + S[2], Q3 + S[3]
        if relaxing:
            stored, R0, R1, R2, R3 = _overstress(E, point, v, extras)
            W, Q0, Q1, Q2, Q3 = W + stored, Q0 + R0, Q1 + R1, Q2 + R2, Q3 + R3
        if relaxed and c2 < w:
            if c1 <= 1.0:
                return W, 0.0, 0.0, 0.0
            along = p * p * Q0 + q * q * Q1 + 2.0 * p * q * Q3
            across = q * q * Q0 + p * p * Q1 - 2.0 * p * q * Q3
            shear = (p * q * (Q1 - Q0) + (p * p - q * q) * Q3) * (c1 - w) / max(c1 - c2, MIN_SQUARE_GAP)
            along -= 0.5 * w * w * w * (across + Q2)
            both = 2.0 * p * q * shear
            return W, p * p * along - both, q * q * along + both, p * q * along + (p * p - q * q) * shear
        r = Q2 / (D * D)
        return W, Q0 - r * C11, Q1 - r * C00, Q3 + r * C01

    return AdditionalStress(digest, response)


def _no_fibres(C, a, c):
    return 0.0, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@kernel_njit(inner=True, fastmath={"contract"}, forceinline=True)
def _overstress(E, point, v, extras):
    """Return the energy of a point's branches and Q (00 11 33 01); update the history unless the interval is 0."""
    stored, Q0, Q1, Q2, Q3 = 0.0, 0.0, 0.0, 0.0, 0.0
    for k in range(extras.times.shape[0]):
        mu = extras.moduli[k]
        A0, A1 = even_change(extras, point, k, 0, v, E[0]), even_change(extras, point, k, 1, v, E[1])
        A2, A3 = even_change(extras, point, k, 2, v, E[2]), even_change(extras, point, k, 3, v, E[3])
        Q0, Q1, Q2, Q3 = Q0 + mu * A0, Q1 + mu * A1, Q2 + mu * A2, Q3 + mu * A3
        stored += 0.25 * mu * (A0 * A0 + A1 * A1 + A2 * A2 + 2.0 * A3 * A3)
    if extras.interval[0] > 0.0:
        update_history(extras, extras, point, v, E)
    return stored, Q0, Q1, Q2, Q3
