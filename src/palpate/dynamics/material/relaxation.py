"""The compiled overstress of viscoelastic tissue (`palpate.tissue.prony.Prony`), and its history variables.

With an isochoric strain that changes linearly over an interval h between two evaluations,

    A(t + h) = exp(-h / tau) A(t) + (1 - exp(-h / tau)) tau / h (C̄(t + h) - C̄(t))

is exact for every h, and so is the dissipated energy. An evaluation with h = 0 is the limit of an
instantaneous change, and does not update the history. The overstress follows from the branches' energy,

    P = J^(-2/3) (F Q - (Q : C) / (3 J) cof F),     Q = sum of mu_i A_i.

F follows from its cofactor, cof(cof F) = J F, which all passes compute.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numba import prange

from palpate.compiled.jit import kernel_njit
from palpate.compiled.lanes import LANES
from palpate.core.arrays import Floats
from palpate.tissue.materials import Material

MIN_VOLUME_RATIO = 0.1  # volume ratio of a crushed point


class Relaxation(NamedTuple):
    """Branches of a Prony series."""

    moduli: Floats  # (k,) array [Pa]: shear moduli
    bulk: Floats  # (k,) array: bulk moduli over the law's volumetric coefficient
    times: Floats  # (k,) array [s]


class HistoryVariables(NamedTuple):
    """History variables of viscoelastic tissue, in blocks of lanes."""

    # (2,) array [s]: interval from the last update to the next evaluation, 0 for an evaluation without update; and the
    # time since the last update, if the steps count it
    interval: Floats
    strain: Floats  # (b, 6, LANES) array: c̄ of the last update: 00 11 22 01 02 12
    branches: Floats  # (b, k, 6, LANES) array: a_i
    # (v,) array: volumetric measure of the last update: theta of the nodes, or the moments of a reduced model
    dilatation: Floats
    volume: Floats  # (v, k) array: its branches
    effective: Floats  # (v,) array: volumetric measure plus its branches, as last evaluated
    factors: Floats  # (k, 5) array: factors of every branch for the interval
    stress: Floats  # (b, 9, LANES) array [Pa]: overstress, as last evaluated, row by row
    # energy, lost: (b, LANES) arrays [J/m^3]: energy in the branches as last evaluated, and energy dissipated since the
    # last restore
    energy: Floats
    lost: Floats
    # volume_energy, volume_lost: (v,) arrays: the same of the volumetric branches, over the bulk modulus
    volume_energy: Floats
    volume_lost: Floats


class HistoryCopy(NamedTuple):
    """Copies of the interval and the persistent arrays of `HistoryVariables`."""

    interval: Floats
    strain: Floats
    branches: Floats
    dilatation: Floats
    volume: Floats


def relaxation(material: Material) -> Relaxation:
    """Return the branches of a material; empty without relaxation."""
    series = material.prony
    if series is None:
        return Relaxation(np.zeros(0), np.zeros(0), np.zeros(0))
    moduli, times = np.array(series.shares) * material.shear_modulus, np.array(series.times)
    if not series.bulk_shares:
        return Relaxation(moduli, np.zeros(len(times)), times)
    return Relaxation(moduli, np.array(series.bulk_shares) * material.bulk_modulus / material.lame, times)


def history(branches: int, blocks: int, volumes: int) -> HistoryVariables:
    """Allocate the history variables of a body at rest."""
    if branches == 0:
        blocks = volumes = 0
    variables = HistoryVariables(
        interval=np.zeros(2),
        strain=np.zeros((blocks, 6, LANES)),
        branches=np.zeros((blocks, branches, 6, LANES)),
        dilatation=np.zeros(volumes),
        volume=np.zeros((volumes, branches)),
        effective=np.zeros(volumes),
        factors=np.zeros((branches, 5)),
        stress=np.zeros((blocks, 9, LANES)),
        energy=np.zeros((blocks, LANES)),
        lost=np.zeros((blocks, LANES)),
        volume_energy=np.zeros(volumes),
        volume_lost=np.zeros(volumes),
    )
    variables.strain[:, :3] = 1.0
    return variables


def _persistent(variables: HistoryVariables) -> tuple[Floats, ...]:
    """Return the arrays that a state stores."""
    return variables.strain, variables.branches, variables.dilatation, variables.volume


def restore_history(variables: HistoryVariables, saved: tuple[Floats, ...]) -> None:
    """Restore saved history variables, or those at rest for an empty tuple; reset the dissipated energy."""
    if not variables.branches.size:
        return
    if saved:
        for array, values in zip(_persistent(variables), saved, strict=True):
            array[:] = values
    else:
        reset_history(variables)
    variables.lost[:] = 0.0
    variables.volume_lost[:] = 0.0


def history_after(
    variables: HistoryVariables, saved: tuple[Floats, ...], interval: float, evaluate: Callable[[], object]
) -> tuple[Floats, ...]:
    """Return the history variables after a linear change over an interval [s] to the evaluated state."""
    restore_history(variables, saved)
    variables.interval[0] = interval
    evaluate()
    variables.interval[0] = 0.0
    return saved_history(variables)


def equilibrium_history(variables: HistoryVariables, evaluate: Callable[[], object]) -> tuple[Floats, ...]:
    """Return the history variables at equilibrium in the evaluated state; empty without relaxation."""
    if not variables.branches.size:
        return ()
    variables.interval[0] = 1.0  # any interval updates the strain; the branches are zero at equilibrium
    evaluate()
    variables.interval[:] = 0.0
    variables.branches[:] = 0.0
    variables.volume[:] = 0.0
    return saved_history(variables)


def saved_history(variables: HistoryVariables) -> tuple[Floats, ...]:
    """Return copies of the persistent history variables; empty without relaxation."""
    return tuple(array.copy() for array in _persistent(variables)) if variables.branches.size else ()


@kernel_njit()
def prepare(relaxation, history):
    """Write the decay, response and dissipation factors of every branch for the interval."""
    interval = history.interval[0]
    for k in range(relaxation.times.shape[0]):
        factors = history.factors[k]
        if interval == 0.0:
            factors[0], factors[1], factors[2:] = 1.0, 1.0, 0.0
            continue
        ratio = interval / relaxation.times[k]
        factors[0], factors[1] = np.exp(-ratio), -np.expm1(-ratio) / ratio
        factors[2], factors[3], factors[4] = -np.expm1(-ratio), -np.expm1(-2.0 * ratio), ratio


@kernel_njit(inner=True, fastmath={"contract"}, forceinline=True)
def _dissipation(a, change, factors):
    """Return the integral of A^2 / tau for a branch that starts at a and a linear strain change."""
    rate = change / factors[4]
    b = a - rate
    return 0.5 * b * b * factors[3] + 2.0 * b * rate * factors[2] + rate * rate * factors[4]


@kernel_njit(inner=True, fastmath={"contract"}, forceinline=True)
def _isochoric(c):
    """Return F, J, J^(-2/3) and C̄ from cof F (nine numbers, row by row)."""
    det = c[0] * (c[4] * c[8] - c[5] * c[7]) - c[1] * (c[3] * c[8] - c[5] * c[6]) + c[2] * (c[3] * c[7] - c[4] * c[6])
    J = np.sqrt(max(det, MIN_VOLUME_RATIO * MIN_VOLUME_RATIO))
    r = 1.0 / J
    F = (
        r * (c[4] * c[8] - c[5] * c[7]), r * (c[5] * c[6] - c[3] * c[8]), r * (c[3] * c[7] - c[4] * c[6]),
        r * (c[2] * c[7] - c[1] * c[8]), r * (c[0] * c[8] - c[2] * c[6]), r * (c[1] * c[6] - c[0] * c[7]),
        r * (c[1] * c[5] - c[2] * c[4]), r * (c[2] * c[3] - c[0] * c[5]), r * (c[0] * c[4] - c[1] * c[3]),
    )  # fmt: skip
    scale = J ** (-2.0 / 3.0)
    C = (
        scale * (F[0] * F[0] + F[3] * F[3] + F[6] * F[6]), scale * (F[1] * F[1] + F[4] * F[4] + F[7] * F[7]),
        scale * (F[2] * F[2] + F[5] * F[5] + F[8] * F[8]), scale * (F[0] * F[1] + F[3] * F[4] + F[6] * F[7]),
        scale * (F[0] * F[2] + F[3] * F[5] + F[6] * F[8]), scale * (F[1] * F[2] + F[4] * F[5] + F[7] * F[8]),
    )  # fmt: skip
    return F, J, scale, C


@kernel_njit(inner=True, fastmath={"contract"}, forceinline=True)
def update_history(relaxation, history, b, v, C):
    """Update the branches and the strain of one point."""
    for k in range(relaxation.times.shape[0]):
        factors, lost = history.factors[k], 0.0
        for q in range(6):
            old, change = history.branches[b, k, q, v], C[q] - history.strain[b, q, v]
            lost += (1.0 if q < 3 else 2.0) * _dissipation(old, change, factors)
            history.branches[b, k, q, v] = factors[0] * old + factors[1] * change
        history.lost[b, v] += 0.5 * relaxation.moduli[k] * lost
    for q in range(6):
        history.strain[b, q, v] = C[q]


@kernel_njit(inner=True, fastmath={"contract"}, forceinline=True)
def even_change(history, b, k, q, v, now):
    """Return component q of a point's branch k after a linear strain change over the interval."""
    return history.factors[k, 0] * history.branches[b, k, q, v] + history.factors[k, 1] * (
        now - history.strain[b, q, v]
    )


@kernel_njit(inline="always")
def after(work, interval):
    """Set the interval [s] after which the next evaluation updates the history; 0 for no update."""
    work.history.interval[0] = interval


@kernel_njit(inner=True, fastmath={"contract"})
def _block_overstress(relaxation, history, cofactor, b, interval):
    """Write the overstress of the points of one block."""
    old, strain, stress = history.branches[b], history.strain[b], history.stress[b]
    for v in range(LANES):
        c = (cofactor[b, 0, v], cofactor[b, 1, v], cofactor[b, 2, v], cofactor[b, 3, v], cofactor[b, 4, v],
             cofactor[b, 5, v], cofactor[b, 6, v], cofactor[b, 7, v], cofactor[b, 8, v])  # fmt: skip
        F, J, scale, C = _isochoric(c)
        Q0, Q1, Q2, Q3, Q4, Q5, stored = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(relaxation.times.shape[0]):
            left, new, mu = history.factors[k, 0], history.factors[k, 1], relaxation.moduli[k]
            A0, A1 = (
                left * old[k, 0, v] + new * (C[0] - strain[0, v]),
                left * old[k, 1, v] + new * (C[1] - strain[1, v]),
            )
            A2, A3 = (
                left * old[k, 2, v] + new * (C[2] - strain[2, v]),
                left * old[k, 3, v] + new * (C[3] - strain[3, v]),
            )
            A4, A5 = (
                left * old[k, 4, v] + new * (C[4] - strain[4, v]),
                left * old[k, 5, v] + new * (C[5] - strain[5, v]),
            )
            Q0, Q1, Q2 = Q0 + mu * A0, Q1 + mu * A1, Q2 + mu * A2
            Q3, Q4, Q5 = Q3 + mu * A3, Q4 + mu * A4, Q5 + mu * A5
            stored += 0.25 * mu * (A0 * A0 + A1 * A1 + A2 * A2 + 2.0 * (A3 * A3 + A4 * A4 + A5 * A5))
        history.energy[b, v] = stored
        if interval > 0.0:
            update_history(relaxation, history, b, v, C)
        trace = Q0 * C[0] + Q1 * C[1] + Q2 * C[2] + 2.0 * (Q3 * C[3] + Q4 * C[4] + Q5 * C[5])
        trace /= 3.0 * J
        for i in range(3):
            x, y, z = scale * F[3 * i], scale * F[3 * i + 1], scale * F[3 * i + 2]
            stress[3 * i, v] = x * Q0 + y * Q3 + z * Q4 - trace * c[3 * i]
            stress[3 * i + 1, v] = x * Q3 + y * Q1 + z * Q5 - trace * c[3 * i + 1]
            stress[3 * i + 2, v] = x * Q4 + y * Q5 + z * Q2 - trace * c[3 * i + 2]


@kernel_njit(inner=True)
def overstress_alone(relaxation, history, cofactor):
    """Compute `overstress` on one thread."""
    prepare(relaxation, history)
    for b in range(cofactor.shape[0]):
        _block_overstress(relaxation, history, cofactor, b, history.interval[0])


@kernel_njit()
def reset_history(history):
    """Reset the history variables to those of a body at rest."""
    for b in range(history.strain.shape[0]):
        for q in range(6):
            for v in range(LANES):
                history.strain[b, q, v] = 1.0 if q < 3 else 0.0
    history.branches[:] = 0.0
    history.dilatation[:] = 0.0
    history.volume[:] = 0.0
    history.interval[:] = 0.0


@kernel_njit(inner=True, parallel=True)
def overstress(relaxation, history, cofactor):
    """Write the overstress of all points into `history.stress`; update the history unless the interval is 0.

    `cofactor` is cof F, (b, 9, LANES), row by row.
    """
    prepare(relaxation, history)
    for block in prange(cofactor.shape[0]):
        b = np.int64(block)
        _block_overstress(relaxation, history, cofactor, b, history.interval[0])


@kernel_njit(inner=True)
def relax_volume(relaxation, history, values):
    """Write volumetric measures (v,) plus their branches into `history.effective`."""
    interval = history.interval[0]
    for i in range(values.shape[0]):
        total, stored, dissipated = values[i], 0.0, 0.0
        change = values[i] - history.dilatation[i]
        for k in range(relaxation.times.shape[0]):
            share = relaxation.bulk[k]
            old = history.volume[i, k]
            now = history.factors[k, 0] * old + history.factors[k, 1] * change
            total += share * now
            stored += 0.5 * share * now * now
            if interval > 0.0:
                dissipated += share * _dissipation(old, change, history.factors[k])
                history.volume[i, k] = now
        history.effective[i] = total
        history.volume_energy[i] = stored
        if interval > 0.0:
            history.volume_lost[i] += dissipated
            history.dilatation[i] = values[i]


@kernel_njit(inner=True)
def copy_values(source, target):
    """Copy the numbers of an array; an assignment of slices would take seconds to compile."""
    for i in range(source.size):
        target.flat[i] = source.flat[i]


@kernel_njit(inner=True)
def copy_field(source, target):
    """Copy a field (n, 3), in a fifth of the time of `copy_values`."""
    for i in range(source.shape[0]):
        for c in range(3):
            target[i, c] = source[i, c]


@kernel_njit(inner=True)
def copy_history(source, target):
    """Copy the interval and the persistent arrays of history variables, as `HistoryVariables` or `HistoryCopy`."""
    copy_values(source.interval, target.interval)
    copy_values(source.strain, target.strain)
    copy_values(source.branches, target.branches)
    copy_values(source.dilatation, target.dilatation)
    copy_values(source.volume, target.volume)


def history_copy(variables: HistoryVariables) -> HistoryCopy:
    """Return copies of the interval and the persistent arrays."""
    return HistoryCopy(variables.interval.copy(), *(array.copy() for array in _persistent(variables)))
