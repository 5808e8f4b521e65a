"""Stress and energy of the cubature points of a sampled body, compiled by blocks of LANES points.

At each point of a block, with the displacement gradient du/dX in its lane,

    P = dW_s/dF,      cof F,      J - 1,      or the energy w_s W_s(F),

of a law and its fibres. The terms of the volume follow from all blocks (`palpate.reduction.hyper.volume_terms`).
"""

from __future__ import annotations

from functools import cache
from typing import Any

from palpate.compiled.jit import law_digest, law_njit
from palpate.compiled.lanes import LANES
from palpate.reduction.hyper.material_point import MaterialPoint


@cache
def stress_block_function(law: MaterialPoint) -> Any:
    """Compile ``stress_block(cubature_points, scratch, b)``, the stresses of block b from its gradients."""
    digest = law_digest(__name__, "stress", law.digest)
    stress_of, add_stress, at = law.stress, law.fibres.add_stress, law.at

    @law_njit(digest, inner=True, fastmath={"contract"})
    def stress_block(cubature_points, scratch, b):
        """Replace the displacement gradients of a block by stresses; write cofactors and volumetric measures."""
        P, c = scratch.stress[b], scratch.cofactor[b]
        for v in range(LANES):
            stress, cofactor, volume = stress_of(
                P[0, v], P[1, v], P[2, v], P[3, v], P[4, v], P[5, v], P[6, v], P[7, v], P[8, v],
                at(cubature_points.coefficients, b, v),
            )  # fmt: skip
            stress = add_stress(
                stress, P[0, v], P[1, v], P[2, v], P[3, v], P[4, v], P[5, v], P[6, v], P[7, v], P[8, v],
                b, v, cubature_points.families,
            )  # fmt: skip
            P[0, v], P[1, v], P[2, v] = stress[0], stress[1], stress[2]
            P[3, v], P[4, v], P[5, v] = stress[3], stress[4], stress[5]
            P[6, v], P[7, v], P[8, v] = stress[6], stress[7], stress[8]
            c[0, v], c[1, v], c[2, v] = cofactor[0], cofactor[1], cofactor[2]
            c[3, v], c[4, v], c[5, v] = cofactor[3], cofactor[4], cofactor[5]
            c[6, v], c[7, v], c[8, v] = cofactor[6], cofactor[7], cofactor[8]
            scratch.dilatation[b, v] = volume

    return stress_block


@cache
def density_block_function(law: MaterialPoint) -> Any:
    """Compile ``density_block(cubature_points, scratch, b)``, the energy of block b from its gradients."""
    digest = law_digest(__name__, "density", law.digest)
    density_of, add_energy, at = law.density, law.fibres.add_energy, law.at

    @law_njit(digest, inner=True)
    def density_block(cubature_points, scratch, b):
        """Return the energy [J] of the points of a block by their displacement gradients; write volumetric measures."""
        total, d = 0.0, scratch.stress[b]
        for v in range(LANES):
            density, scratch.dilatation[b, v] = density_of(
                d[0, v], d[1, v], d[2, v], d[3, v], d[4, v], d[5, v], d[6, v], d[7, v], d[8, v],
                at(cubature_points.coefficients, b, v),
            )  # fmt: skip
            density = add_energy(
                density, d[0, v], d[1, v], d[2, v], d[3, v], d[4, v], d[5, v], d[6, v], d[7, v], d[8, v],
                b, v, cubature_points.families,
            )  # fmt: skip
            total += cubature_points.weights[b, v] * density
        return total

    return density_block
