"""The compiled stress of a solid of small strain: Hooke's law, linear in the displacements.

The functions replace those of the strong form and the energy form. cof(F) is the unit matrix and
J - 1 the trace of the strain.
"""

from __future__ import annotations

from typing import Any

from palpate.compiled.jit import law_njit
from palpate.compiled.lanes import LANES


def make_linear_stress(digest: str) -> Any:
    """Compile the shear stress of one point, as `energy_form.make_stress`."""

    @law_njit(digest, cached=False, fastmath={"contract"}, forceinline=True)
    def stress(d0, d1, d2, d3, d4, d5, d6, d7, d8, coefficients):
        mu = coefficients[0]
        a, b, c = mu * (d1 + d3), mu * (d2 + d6), mu * (d5 + d7)
        P = (2.0 * mu * d0, a, b, a, 2.0 * mu * d4, c, b, c, 2.0 * mu * d8)
        return P, (1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0), d0 + d4 + d8

    return stress


def make_linear_response(digest: str, law_first: Any, law_second: Any, volume: Any) -> Any:
    """Compile the response of one block, mu (lap u + grad div u) - P b, as in `strong_form`."""

    @law_njit(digest, inner=True, cached=False, fastmath={"contract"}, forceinline=True)
    def respond(b, nodes, d, boundary, coefficients, lame, cofactor, shear, pressure):
        mu = coefficients[0]
        for v in range(LANES):
            b0, b1, b2 = boundary[b, 0, v], boundary[b, 1, v], boundary[b, 2, v]
            trace = d[0, v] + d[4, v] + d[8, v]
            # gradient of the trace; second derivatives of a component are ordered 00 11 22 01 02 12
            k0 = d[9, v] + d[18, v] + d[25, v]
            k1 = d[12, v] + d[16, v] + d[26, v]
            k2 = d[13, v] + d[20, v] + d[23, v]
            s01, s02, s12 = mu * (d[1, v] + d[3, v]), mu * (d[2, v] + d[6, v]), mu * (d[5, v] + d[7, v])
            P00, P11, P22 = 2.0 * mu * d[0, v], 2.0 * mu * d[4, v], 2.0 * mu * d[8, v]
            shear[b, 0, v] = mu * (d[9, v] + d[10, v] + d[11, v] + k0) - P00 * b0 - s01 * b1 - s02 * b2
            shear[b, 1, v] = mu * (d[15, v] + d[16, v] + d[17, v] + k1) - s01 * b0 - P11 * b1 - s12 * b2
            shear[b, 2, v] = mu * (d[21, v] + d[22, v] + d[23, v] + k2) - s02 * b0 - s12 * b1 - P22 * b2
            for w in range(9):
                cofactor[b, w, v] = 0.0
            cofactor[b, 0, v], cofactor[b, 4, v], cofactor[b, 8, v] = 1.0, 1.0, 1.0
            d[0, v] = lame * trace
        for v in range(LANES):
            pressure[nodes[b, v]] = d[0, v]

    return respond
