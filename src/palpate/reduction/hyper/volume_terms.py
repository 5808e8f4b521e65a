"""The volumetric terms of a sampled energy: moments, pressure and overstresses, compiled.

With the dilatations J - 1 of all points, or another measure g(J), and the pressure modes Z,

    c = Z g,      P_s = w_s P_s + (Z^T c)_s g'(J) cof F,      E = 1/2 |c|^2 + 1/2 a . H a.

Tissue that relaxes adds the overstresses of its points, and has the moments of its branches in place of c.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

from palpate.compiled.jit import kernel_njit, law_digest, law_njit
from palpate.compiled.lanes import LANES
from palpate.dynamics.material.relaxation import overstress_alone, relax_volume
from palpate.reduction.hyper.material_point import MaterialPoint


@kernel_njit(inner=True, fastmath={"contract", "reassoc"})
def _moments(pressure, dilatation, moments):
    for k in range(pressure.shape[1]):
        total = 0.0
        for b in range(pressure.shape[0]):
            for lane in range(LANES):
                total += pressure[b, k, lane] * dilatation[b, lane]
        moments[k] = total


@kernel_njit(inner=True, fastmath={"contract", "reassoc"})
def _add_pressure(cubature_points, moments, scratch, curved):
    """Multiply the stresses by their weights and add the pressure times its volume."""
    weights, pressure, stress = cubature_points.weights, cubature_points.pressure, scratch.stress
    cofactor, dilatation, slope = scratch.cofactor, scratch.dilatation, scratch.slope
    dilatation[:] = 0.0
    for b in range(weights.shape[0]):
        for k in range(pressure.shape[1]):
            for lane in range(LANES):
                dilatation[b, lane] += pressure[b, k, lane] * moments[k]
        if curved:
            for lane in range(LANES):
                dilatation[b, lane] *= slope[b, lane]
        for q in range(9):
            for lane in range(LANES):
                stress[b, q, lane] = weights[b, lane] * stress[b, q, lane] + dilatation[b, lane] * cofactor[b, q, lane]


class VolumeTerms(NamedTuple):
    """Compiled functions of the volumetric terms of a law.

    - ``write_moments(cubature_points, scratch)`` replaces J - 1 by the law's measure, and writes the moments
    - ``add_stress(cubature_points, scratch)`` writes the moments, and adds overstress and pressure to stresses
    - ``energy(columns, cubature_points, scratch)`` returns the energy [J] of moments, hourglass residual and branches
    """

    write_moments: Any
    add_stress: Any
    energy: Any


@cache
def volume_terms(law: MaterialPoint) -> VolumeTerms:
    """Compile the volumetric terms of a law."""
    write_moments = _moments_function(law)
    return VolumeTerms(write_moments, _stress_function(law, write_moments), _energy_function(law))


def _moments_function(law: MaterialPoint) -> Any:
    """Compile `VolumeTerms.write_moments`."""
    measure_of, curved = law.measure, law.measure is not None

    @law_njit(law_digest(__name__, "moments", law.digest), inner=True)
    def write_moments(cubature_points, scratch):
        if curved:
            for b in range(scratch.dilatation.shape[0]):
                for v in range(LANES):
                    scratch.dilatation[b, v], scratch.slope[b, v] = measure_of(scratch.dilatation[b, v])
        _moments(cubature_points.pressure, scratch.dilatation, scratch.moments)

    return write_moments


def _stress_function(law: MaterialPoint, write_moments: Any) -> Any:
    """Compile `VolumeTerms.add_stress`."""
    digest = law_digest(__name__, "stress", law.digest)
    curved, relaxing, parameter_count = law.measure is not None, law.relaxing, law.parameter_count

    @law_njit(digest, inline="always")
    def relax(cubature_points, scratch):
        """Add the overstresses to the stresses, and update the branches of the moments."""
        overstress_alone(cubature_points.relaxation, scratch.history, scratch.cofactor)
        for b in range(scratch.stress.shape[0]):
            for q in range(9):
                for v in range(LANES):
                    modulus_ratio = cubature_points.coefficients[b, parameter_count, v] if parameter_count else 1.0
                    scratch.stress[b, q, v] += modulus_ratio * scratch.history.stress[b, q, v]
        relax_volume(cubature_points.relaxation, scratch.history, scratch.moments)

    @law_njit(digest, inner=True)
    def add_stress(cubature_points, scratch):
        write_moments(cubature_points, scratch)
        effective = scratch.moments
        if relaxing:
            relax(cubature_points, scratch)
            effective = scratch.history.effective
        _add_pressure(cubature_points, effective, scratch, curved)
        scratch.partial[:] = 0.0

    return add_stress


def _energy_function(law: MaterialPoint) -> Any:
    """Compile `VolumeTerms.energy`."""
    digest = law_digest(__name__, "energy", law.digest)
    relaxing, parameter_count = law.relaxing, law.parameter_count

    @law_njit(digest, inner=True, fastmath={"contract", "reassoc"})
    def volume_energy(columns, cubature_points, scratch):
        """Return the energy [J] of moments and hourglass residual, and of the branches after a force."""
        total = 0.0
        for k in range(scratch.moments.shape[0]):
            total += 0.5 * scratch.moments[k] * scratch.moments[k]
        if relaxing:
            for b in range(cubature_points.weights.shape[0]):
                for v in range(LANES):
                    ratio = cubature_points.coefficients[b, parameter_count, v] if parameter_count else 1.0
                    total += ratio * cubature_points.weights[b, v] * scratch.history.energy[b, v]
            for k in range(scratch.history.volume_energy.shape[0]):
                total += scratch.history.volume_energy[k]
        for m in range(columns.shape[0]):
            stiff = 0.0
            for k in range(columns.shape[0]):
                stiff += cubature_points.constant[m, k] * columns[k]
            total += 0.5 * columns[m] * stiff
        return total

    return volume_energy
