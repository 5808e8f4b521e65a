"""The compiled force of a reduced model: an energy sampled at few nodes.

With the coordinates a of modes and lifting functions, F_s = I + B_s a at the sampled nodes s,

    E(a) = sum of w_s W_s(F_s) + 1/2 |c|^2 + 1/2 a . H a,      c = Z (J - 1),      force = -dE/da.

The weights w_s are positive. The c are few moments of the dilatations at the cubature points, one
per pressure mode, so the pressure is Z^T c. H is the constant stiffness of the hourglass residual.
Each term is an energy bounded from below for any w, Z and B, so the model cannot blow up. Below a
tenth of a point's volume, or where the point is inverted, W_s continues as a parabola in J. A law
with another volumetric form uses its measure g(J) in place of J - 1 (`palpate.tissue.volumetric`).
The cost depends on the numbers of cubature points and coordinates, not on the size of the body.

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
from palpate.dynamics.material.relaxation import HistoryVariables, Relaxation, history
from palpate.reduction.hyper.material_point import MaterialPoint
from palpate.reduction.hyper.point_blocks import density_block_function, stress_block_function
from palpate.reduction.hyper.volume_terms import volume_terms
from palpate.tissue.fibres import FibreLaw
from palpate.tissue.regions import Regions

NO_RELAXATION = Relaxation(np.zeros(0), np.zeros(0), np.zeros(0))  # elastic tissue


class CubaturePoints(NamedTuple):
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
    history: HistoryVariables  # of the cubature points, and of the moments


def cubature_points(
    gradients: Floats,
    weights: Floats,
    pressure: Floats,
    constant: Floats,
    law: tuple[float, ...] | Regions,
    dtype: Any = np.float32,
    relaxation: Relaxation = NO_RELAXATION,
    fibres: FibreLaw | None = None,
) -> CubaturePoints:
    """Return cubature points in blocks of LANES, with a table of a `dtype`.

    `gradients` (s, m, 9) are the derivatives of the basis vectors at the points, `weights` (s,) [m^3]; `pressure` is
    (k, s), `constant` (m, m). `law` has coefficients, or materials at the points; `fibres` have directions there.
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
    return CubaturePoints(
        table, lanes(weights), lanes(pressure.T), np.ascontiguousarray(constant), coefficients, relaxation,
        lay_out_fibres(fibres, point_numbers),
    )  # fmt: skip


class ProbeScratches(NamedTuple):
    """Work arrays of a state and of two next to it, which share their history variables."""

    here: Scratch
    along: Scratch
    aside: Scratch


def scratch(points: CubaturePoints, saved_history: HistoryVariables | None = None) -> Scratch:
    """Return work arrays for cubature points, with their own history variables or given ones."""
    (blocks, columns, _, _), pressures = points.table.shape, points.pressure.shape[1]
    stresses = np.zeros((2, blocks, 9, LANES))
    return Scratch(
        stresses[0], stresses[1], np.zeros((blocks, LANES)), np.ones((blocks, LANES)), np.zeros(pressures),
        np.zeros((columns, LANES)), np.zeros(columns),
        history(len(points.relaxation.times), blocks, pressures) if saved_history is None else saved_history,
    )  # fmt: skip


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


def shear_weights(points: CubaturePoints) -> Floats:
    """Return the weights [m^3] of the points times their modulus ratios, as the branches of a Prony series use them."""
    return points.weights if isinstance(points.coefficients, tuple) else points.weights * points.coefficients[:, -1]


class SampledEnergy(NamedTuple):
    """Compiled functions of a law.

    ``force(coordinates, cubature_points, scratch, result)`` writes -dE/da (m,); ``energy(coordinates, cubature_points,
    scratch)`` returns E [J].

    ``probe(rows, column, change, cubature_points, scratches, results)`` writes -dE/da (3, m) at two rows of coordinates
    (2, m), and at the first with one of them changed, and returns E [J] at the first. It reads the table once for all.
    The `scratches` are `ProbeScratches`.
    """

    force: Any
    energy: Any
    probe: Any


@cache
def sampled_energy(law: MaterialPoint, single: bool) -> SampledEnergy:
    """Compile force and energy of sampled bodies, for a table of single or double precision.

    Sums have double precision in either case.
    """
    return SampledEnergy(_force_function(law, single), _energy_function(law, single), _probe_function(law, single))


@cache
def _force_function(law: MaterialPoint, single: bool) -> Any:
    """Compile `SampledEnergy.force`."""
    digest = law_digest(__name__, "force", law.digest, single)
    sums, work = column_sums[single], column_work[single]
    stress_block, add_volume_stress = stress_block_function(law), volume_terms(law).add_stress

    @law_njit(digest, fastmath={"contract"})
    def force(columns, given_points, given_scratch, result):
        cubature_points, scratch = reference(given_points), reference(given_scratch)
        for b in range(cubature_points.table.shape[0]):
            sums(cubature_points.table[b].ctypes.data, columns.ctypes.data, scratch.stress[b].ctypes.data,
                 columns.shape[0])  # fmt: skip
            stress_block(cubature_points, scratch, b)
        add_volume_stress(cubature_points, scratch)
        for b in range(cubature_points.table.shape[0]):
            work(cubature_points.table[b].ctypes.data, scratch.stress[b].ctypes.data, scratch.partial.ctypes.data,
                 columns.shape[0])  # fmt: skip
        collect_forces(scratch.partial, cubature_points.constant, columns, result)

    return force


@cache
def _energy_function(law: MaterialPoint, single: bool) -> Any:
    """Compile `SampledEnergy.energy`."""
    digest = law_digest(__name__, "energy", law.digest, single)
    sums, relaxing, force = column_sums[single], law.relaxing, _force_function(law, single)
    density_block, volume = density_block_function(law), volume_terms(law)
    write_moments, volume_energy = volume.write_moments, volume.energy

    @law_njit(digest)
    def energy(columns, given_points, given_scratch):
        cubature_points, scratch = reference(given_points), reference(given_scratch)
        total = 0.0
        for b in range(cubature_points.table.shape[0]):
            sums(cubature_points.table[b].ctypes.data, columns.ctypes.data, scratch.stress[b].ctypes.data,
                 columns.shape[0])  # fmt: skip
            total += density_block(cubature_points, scratch, b)
        write_moments(cubature_points, scratch)
        if relaxing:
            force(columns, cubature_points, scratch, scratch.spare)
        return total + volume_energy(columns, cubature_points, scratch)

    return energy


@cache
def _probe_function(law: MaterialPoint, single: bool) -> Any:
    """Compile `SampledEnergy.probe`."""
    digest = law_digest(__name__, "probe", law.digest, single)
    two_sums, three_works = column_sums_2[single], column_work_3[single]
    stress_block, density_block, volume = stress_block_function(law), density_block_function(law), volume_terms(law)
    add_volume_stress, volume_energy = volume.add_stress, volume.energy

    @law_njit(digest, fastmath={"contract"})
    def probe(rows, column, change, cubature_points, scratches, results):
        here, along, aside = scratches.here, scratches.along, scratches.aside
        total, table, count = 0.0, cubature_points.table, rows.shape[1]
        for b in range(table.shape[0]):  # its part of the table stays in the fastest memory
            G, shifted, D = here.stress[b], aside.stress[b], table[b, column]
            two_sums(table[b].ctypes.data, rows[0].ctypes.data, rows[1].ctypes.data, G.ctypes.data,
                     along.stress[b].ctypes.data, count)  # fmt: skip
            for q in range(9):
                for v in range(LANES):
                    shifted[q, v] = G[q, v] + change * D[q, v]
            total += density_block(cubature_points, here, b)
            stress_block(cubature_points, here, b)
            stress_block(cubature_points, along, b)
            stress_block(cubature_points, aside, b)
        add_volume_stress(cubature_points, here)
        total += volume_energy(rows[0], cubature_points, here)
        add_volume_stress(cubature_points, along)
        add_volume_stress(cubature_points, aside)
        for b in range(table.shape[0]):
            three_works(
                table[b].ctypes.data, here.stress[b].ctypes.data, along.stress[b].ctypes.data,
                aside.stress[b].ctypes.data, here.partial.ctypes.data, along.partial.ctypes.data,
                aside.partial.ctypes.data, count,
            )  # fmt: skip
        collect_forces(here.partial, cubature_points.constant, rows[0], results[0])
        collect_forces(along.partial, cubature_points.constant, rows[1], results[1])
        collect_forces(aside.partial, cubature_points.constant, rows[0], results[2])
        for m in range(count):
            results[2, m] -= change * cubature_points.constant[m, column]
        return total

    return probe
