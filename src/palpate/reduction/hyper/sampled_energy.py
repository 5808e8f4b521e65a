"""The compiled force of a reduced model: an energy sampled at few nodes.

With the coordinates a of modes and lifting vectors, F_s = I + B_s a at the sampled nodes s,

    E(a) = sum of w_s W_s(F_s) + 1/2 |c|^2 + 1/2 a . H a,      c = Z (J - 1),      force = -dE/da.

The weights w_s are positive. The c are few moments of the dilatations at the integration points, one
per pressure mode, so the pressure is Z^T c. H is the constant stiffness of the hourglass residual.
Each term is an energy bounded from below for any w, Z and B, so the model cannot blow up. Below a
tenth of a point's volume, or where the point is inverted, W_s continues as a parabola in J. A law
with another volumetric form uses its measure g(J) in place of J - 1 (`palpate.tissue.volumetric`).
The cost depends on the numbers of integration points and coordinates, not on the size of the body.

The energy is a subset of the terms of `palpate.dynamics.solid.energy_form`. With all nodes, their
volumes, and the smoothed dilatations as moments it equals the Galerkin model. A membrane is sampled
at the points of `palpate.dynamics.membrane.passes`, six per node, and has no moments.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.compiled.jit import kernel_njit, law_digest, law_njit
from palpate.compiled.lanes import LANES, column_sums, column_sums_2, column_work, column_work_3
from palpate.compiled.reference import reference
from palpate.core.arrays import Floats
from palpate.dynamics.material.fibres import Families, lay_out_fibres
from palpate.dynamics.material.material_fields import spread
from palpate.dynamics.material.relaxation import HistoryVariables, Relaxation, history, overstress_alone, relax_volume
from palpate.reduction.hyper.material_point import MaterialPoint
from palpate.tissue.fibres import FibreLaw
from palpate.tissue.regions import Regions

NO_RELAXATION = Relaxation(np.zeros(0), np.zeros(0), np.zeros(0))  # elastic tissue


class IntegrationPoints(NamedTuple):
    """Constants of the sampled energy."""

    # (b, m, 9, LANES) float32 or float64 array [1/m times the unit of the basis vectors]: derivatives of every basis
    # vector at the points, row by row of du/dX, in blocks of LANES points
    table: NDArray[np.float32] | Floats
    weights: Floats  # (b, LANES) array [m^3]: zero where a block is not filled
    pressure: Floats  # (b, k, LANES) array: z, which includes the root of the bulk modulus
    constant: Floats  # (m, m) array: h
    # tuple, or (b, p + 1, LANES) array: of the law. Where they differ, by lane; the last entry is the ratio of the
    # shear modulus at rest to that of the body.
    coefficients: tuple[float, ...] | Floats
    relaxation: Relaxation  # of tissue that relaxes
    families: Families  # of fibres


class Scratch(NamedTuple):
    """Work arrays of the passes, so that a step allocates nothing."""

    stress: Floats  # (b, 9, LANES)
    cofactor: Floats  # (b, 9, LANES)
    dilatation: Floats  # (b, LANES): J - 1, or g(J)
    slope: Floats  # (b, LANES): 1, or g'(J)
    moments: Floats  # (k,)
    partial: Floats  # (m, LANES)
    spare: Floats  # (m,)
    history: HistoryVariables  # of the integration points, and of the moments


def integration_points(
    gradients: Floats,
    weights: Floats,
    pressure: Floats,
    constant: Floats,
    law: tuple[float, ...] | Regions,
    dtype: Any = np.float32,
    relaxation: Relaxation = NO_RELAXATION,
    fibres: FibreLaw | None = None,
) -> IntegrationPoints:
    """Return integration points in blocks of LANES.

    Parameters
    ----------
    gradients : (s, m, 9) array
        Derivatives of the basis vectors at the points.
    weights : (s,) array [m^3]
    pressure : (k, s) array
    constant : (m, m) array
    law : tuple or Regions
        Coefficients, or materials at the points.
    dtype : type
        Of the table.
    fibres : FibreLaw, optional
        With directions at the points.
    """
    count = len(gradients)
    padding = -count % LANES
    blocks = (count + padding) // LANES

    def lanes(values: Floats) -> Floats:
        filled = np.concatenate([values, np.zeros((padding, *values.shape[1:]))])
        return np.ascontiguousarray(np.moveaxis(filled.reshape(blocks, LANES, *values.shape[1:]), 1, -1))

    table = np.ascontiguousarray(lanes(gradients), dtype=dtype)
    point_numbers = np.minimum(np.arange(blocks * LANES), count - 1).reshape(blocks, LANES)
    coefficients = spread(law, point_numbers) if isinstance(law, Regions) else law
    return IntegrationPoints(
        table, lanes(weights), lanes(pressure.T), np.ascontiguousarray(constant), coefficients, relaxation,
        lay_out_fibres(fibres, point_numbers),
    )  # fmt: skip


class ProbeScratches(NamedTuple):
    """Work arrays of a state and of two next to it, which share their history variables."""

    here: Scratch
    along: Scratch
    aside: Scratch


def scratch(points: IntegrationPoints, saved_history: HistoryVariables | None = None) -> Scratch:
    """Return work arrays for integration points, with their own history variables or given ones."""
    (blocks, columns, _, _), pressures = points.table.shape, points.pressure.shape[1]
    stresses = np.zeros((2, blocks, 9, LANES))
    return Scratch(
        stresses[0], stresses[1], np.zeros((blocks, LANES)), np.ones((blocks, LANES)), np.zeros(pressures),
        np.zeros((columns, LANES)), np.zeros(columns),
        history(len(points.relaxation.times), blocks, pressures) if saved_history is None else saved_history,
    )  # fmt: skip


@kernel_njit(inner=True, fastmath={"contract", "reassoc"})
def _moments(pressure, dilatation, moments):
    for k in range(pressure.shape[1]):
        total = 0.0
        for b in range(pressure.shape[0]):
            for lane in range(LANES):
                total += pressure[b, k, lane] * dilatation[b, lane]
        moments[k] = total


@kernel_njit(inner=True, fastmath={"contract", "reassoc"})
def _add_pressure(integration_points, moments, scratch, curved):
    """Multiply the stresses by their weights and add the pressure times its volume."""
    weights, pressure, stress = integration_points.weights, integration_points.pressure, scratch.stress
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


@kernel_njit(inner=True, fastmath={"contract", "reassoc"})
def collect_forces(partial, constant, columns, force):
    """Write forces (w,) by their work in lanes (w, LANES) and a constant stiffness (w, m) of coordinates (m,)."""
    for m in range(partial.shape[0]):
        total = 0.0
        for lane in range(LANES):
            total += partial[m, lane]
        for k in range(columns.shape[0]):
            total += constant[m, k] * columns[k]
        force[m] = -total


def shear_weights(points: IntegrationPoints) -> Floats:
    """Return the weights [m^3] of the points times their modulus ratios, as the branches of a Prony series use them."""
    return points.weights if isinstance(points.coefficients, tuple) else points.weights * points.coefficients[:, -1]


class SampledEnergy(NamedTuple):
    """Compiled functions of a law.

    Parameters
    ----------
    force : function
        ``force(coordinates, integration_points, scratch, result)`` writes -dE/da (m,).
    energy : function
        ``energy(coordinates, integration_points, scratch)`` returns E [J].
    probe : function
        ``probe(rows, column, change, integration_points, scratches, results)`` writes -dE/da (3, m) at two rows of
        coordinates (2, m), and at the first with one of them changed, and returns E [J] at the first. It reads the
        table once for all. The `scratches` are `ProbeScratches`.
    """

    force: Any
    energy: Any
    probe: Any


@cache
def sampled_energy(law: MaterialPoint, single: bool) -> SampledEnergy:
    """Compile force and energy of sampled bodies.

    Parameters
    ----------
    single : bool
        Whether the table has single precision. Sums have double precision in either case.
    """
    digest = law_digest(__name__, "sampled energy", law.digest, single)
    sums, work, stress_of, density_of = column_sums[single], column_work[single], law.stress, law.density
    two_sums, three_works = column_sums_2[single], column_work_3[single]
    measure_of, curved, relaxing = law.measure, law.measure is not None, law.relaxing
    add_stress, add_energy, at, parameter_count = (
        law.fibres.add_stress,
        law.fibres.add_energy,
        law.at,
        law.parameter_count,
    )

    @law_njit(digest, fastmath={"contract"})
    def measure(scratch):
        """Replace J - 1 at the points by g, and write g'."""
        if curved:
            for b in range(scratch.dilatation.shape[0]):
                for v in range(LANES):
                    scratch.dilatation[b, v], scratch.slope[b, v] = measure_of(scratch.dilatation[b, v])

    @law_njit(digest, fastmath={"contract"})
    def relax(integration_points, scratch):
        """Add the overstresses to the stresses, and update the branches of the moments."""
        overstress_alone(integration_points.relaxation, scratch.history, scratch.cofactor)
        for b in range(scratch.stress.shape[0]):
            for q in range(9):
                for v in range(LANES):
                    modulus_ratio = integration_points.coefficients[b, parameter_count, v] if parameter_count else 1.0
                    scratch.stress[b, q, v] += modulus_ratio * scratch.history.stress[b, q, v]
        relax_volume(integration_points.relaxation, scratch.history, scratch.moments)

    @law_njit(digest, inner=True, fastmath={"contract"})
    def stress_block(integration_points, scratch, b):
        """Replace the displacement gradients of a block by stresses; write cofactors and volumetric measures."""
        P, c = scratch.stress[b], scratch.cofactor[b]
        for v in range(LANES):
            stress, cofactor, volume = stress_of(
                P[0, v], P[1, v], P[2, v], P[3, v], P[4, v], P[5, v], P[6, v], P[7, v], P[8, v],
                at(integration_points.coefficients, b, v),
            )  # fmt: skip
            stress = add_stress(
                stress, P[0, v], P[1, v], P[2, v], P[3, v], P[4, v], P[5, v], P[6, v], P[7, v], P[8, v],
                b, v, integration_points.families,
            )  # fmt: skip
            P[0, v], P[1, v], P[2, v] = stress[0], stress[1], stress[2]
            P[3, v], P[4, v], P[5, v] = stress[3], stress[4], stress[5]
            P[6, v], P[7, v], P[8, v] = stress[6], stress[7], stress[8]
            c[0, v], c[1, v], c[2, v] = cofactor[0], cofactor[1], cofactor[2]
            c[3, v], c[4, v], c[5, v] = cofactor[3], cofactor[4], cofactor[5]
            c[6, v], c[7, v], c[8, v] = cofactor[6], cofactor[7], cofactor[8]
            scratch.dilatation[b, v] = volume

    @law_njit(digest, inner=True, fastmath={"contract"})
    def add_volume_stress(integration_points, scratch):
        """Compute the moments, and add overstress and pressure to the stresses."""
        measure(scratch)
        _moments(integration_points.pressure, scratch.dilatation, scratch.moments)
        effective = scratch.moments
        if relaxing:
            relax(integration_points, scratch)
            effective = scratch.history.effective
        _add_pressure(integration_points, effective, scratch, curved)
        scratch.partial[:] = 0.0

    @law_njit(digest, fastmath={"contract"})
    def force(columns, given_points, given_scratch, result):
        integration_points, scratch = reference(given_points), reference(given_scratch)
        for b in range(integration_points.table.shape[0]):
            sums(integration_points.table[b].ctypes.data, columns.ctypes.data, scratch.stress[b].ctypes.data,
                 columns.shape[0])  # fmt: skip
            stress_block(integration_points, scratch, b)
        add_volume_stress(integration_points, scratch)
        for b in range(integration_points.table.shape[0]):
            work(integration_points.table[b].ctypes.data, scratch.stress[b].ctypes.data, scratch.partial.ctypes.data,
                 columns.shape[0])  # fmt: skip
        collect_forces(scratch.partial, integration_points.constant, columns, result)

    @law_njit(digest, inner=True)
    def density_block(integration_points, scratch, b):
        """Return the energy [J] of the points of a block by their displacement gradients; write volumetric measures."""
        total, d = 0.0, scratch.stress[b]
        for v in range(LANES):
            density, scratch.dilatation[b, v] = density_of(
                d[0, v], d[1, v], d[2, v], d[3, v], d[4, v], d[5, v], d[6, v], d[7, v], d[8, v],
                at(integration_points.coefficients, b, v),
            )  # fmt: skip
            density = add_energy(
                density, d[0, v], d[1, v], d[2, v], d[3, v], d[4, v], d[5, v], d[6, v], d[7, v], d[8, v],
                b, v, integration_points.families,
            )  # fmt: skip
            total += integration_points.weights[b, v] * density
        return total

    @law_njit(digest, inner=True, fastmath={"contract", "reassoc"})
    def volume_energy(columns, integration_points, scratch):
        """Return the energy [J] of moments and hourglass residual, and of the branches after a force."""
        total = 0.0
        for k in range(scratch.moments.shape[0]):
            total += 0.5 * scratch.moments[k] * scratch.moments[k]
        if relaxing:
            for b in range(integration_points.weights.shape[0]):
                for v in range(LANES):
                    ratio = integration_points.coefficients[b, parameter_count, v] if parameter_count else 1.0
                    total += ratio * integration_points.weights[b, v] * scratch.history.energy[b, v]
            for k in range(scratch.history.volume_energy.shape[0]):
                total += scratch.history.volume_energy[k]
        for m in range(columns.shape[0]):
            stiff = 0.0
            for k in range(columns.shape[0]):
                stiff += integration_points.constant[m, k] * columns[k]
            total += 0.5 * columns[m] * stiff
        return total

    @law_njit(digest)
    def energy(columns, given_points, given_scratch):
        integration_points, scratch = reference(given_points), reference(given_scratch)
        total = 0.0
        for b in range(integration_points.table.shape[0]):
            sums(integration_points.table[b].ctypes.data, columns.ctypes.data, scratch.stress[b].ctypes.data,
                 columns.shape[0])  # fmt: skip
            total += density_block(integration_points, scratch, b)
        measure(scratch)
        _moments(integration_points.pressure, scratch.dilatation, scratch.moments)
        if relaxing:
            force(columns, integration_points, scratch, scratch.spare)
        return total + volume_energy(columns, integration_points, scratch)

    @law_njit(digest, fastmath={"contract"})
    def probe(rows, column, change, integration_points, scratches, results):
        here, along, aside = scratches.here, scratches.along, scratches.aside
        total, table, count = 0.0, integration_points.table, rows.shape[1]
        for b in range(table.shape[0]):  # its part of the table stays in the fastest memory
            G, shifted, D = here.stress[b], aside.stress[b], table[b, column]
            two_sums(table[b].ctypes.data, rows[0].ctypes.data, rows[1].ctypes.data, G.ctypes.data,
                     along.stress[b].ctypes.data, count)  # fmt: skip
            for q in range(9):
                for v in range(LANES):
                    shifted[q, v] = G[q, v] + change * D[q, v]
            total += density_block(integration_points, here, b)
            stress_block(integration_points, here, b)
            stress_block(integration_points, along, b)
            stress_block(integration_points, aside, b)
        add_volume_stress(integration_points, here)
        total += volume_energy(rows[0], integration_points, here)
        add_volume_stress(integration_points, along)
        add_volume_stress(integration_points, aside)
        for b in range(table.shape[0]):
            three_works(
                table[b].ctypes.data, here.stress[b].ctypes.data, along.stress[b].ctypes.data,
                aside.stress[b].ctypes.data, here.partial.ctypes.data, along.partial.ctypes.data,
                aside.partial.ctypes.data, count,
            )  # fmt: skip
        collect_forces(here.partial, integration_points.constant, rows[0], results[0])
        collect_forces(along.partial, integration_points.constant, rows[1], results[1])
        collect_forces(aside.partial, integration_points.constant, rows[0], results[2])
        for m in range(count):
            results[2, m] -= change * integration_points.constant[m, column]
        return total

    return SampledEnergy(force, energy, probe)
