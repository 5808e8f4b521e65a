"""The tangent of a reduced model in the engine, which each period updates by one column, and its highest frequency.

A period evaluates the forces at three states: its own, one along the shape of the power iteration, and one along a
coordinate. The differences are an image of the power iteration, omega^2 ~ |w| / |d|, w = m^-1 (f(a) - f(a + d)), and a
column of -df/da.
"""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np

from palpate.compiled.jit import kernel_njit, law_digest, law_njit
from palpate.realtime.bodies.period_data import (
    ALONG_COLUMN,
    ALONG_SHAPE,
    AT_STATE,
    FREQUENCY,
    NEXT_COLUMN,
    POWER_SHAPE,
    RATE,
    WORK,
)
from palpate.reduction.hyper.material_point import MaterialPoint
from palpate.reduction.hyper.newton import cholesky_factor, cholesky_solve
from palpate.reduction.hyper.sampled_energy import sampled_energy


@kernel_njit(inner=True, fastmath={"contract", "reassoc"})
def update_tangent(data):
    """Do one power iteration for the highest frequency, and update one column of the tangent."""
    modes, count = data.modes, data.tangent.matrix.shape[0]
    shape, image, change = data.vectors[POWER_SHAPE], data.vectors[WORK], data.vectors[RATE]
    behind, ahead, along = (
        data.tangent.probes.forces[AT_STATE],
        data.tangent.probes.forces[ALONG_SHAPE],
        data.tangent.probes.forces[ALONG_COLUMN],
    )
    size, grown = 0.0, 0.0
    for m in range(modes):
        change[m] = behind[m] - ahead[m]
    for m in range(modes):
        value = 0.0
        for k in range(modes):
            value += data.body.constants.constrained_inverse_mass[m, k] * change[k]
        image[m] = value
    for m in range(modes):
        inertia, reference = 0.0, 0.0
        for k in range(modes):
            inertia += data.body.constants.mass[m, k] * image[k]
            reference += data.body.constants.mass[m, k] * shape[k]
        grown += inertia * image[m]
        size += reference * shape[m]
    for m in range(modes):
        shape[m] = image[m]
    if grown > 0.0 and size > 0.0:
        data.tracking[FREQUENCY] = np.sqrt(np.sqrt(grown / size))
    column = int(data.tracking[NEXT_COLUMN])
    data.tracking[NEXT_COLUMN] = (column + 1) % count
    for m in range(count):
        data.tangent.matrix[m, column] = (behind[m] - along[m]) / data.body.constants.differences[column]
        if data.body.springs.stiffness.shape[0] > 0:
            data.tangent.matrix[m, column] += data.body.springs.stiffness[m, column]


@kernel_njit(inline="always", fastmath={"contract"})
def static_stiffness(data, q, out):
    """Write the derivatives (l, l) of the static forces by the tool's coordinates, K_tt - K_tm K_mm^-1 K_mt."""
    modes, count = data.modes, q.shape[0]
    tangent, condensed, column = data.tangent.matrix, data.tangent.condensed, data.vectors[WORK]
    for m in range(count):
        for k in range(count):
            condensed[m, k] = 0.5 * (tangent[m, k] + tangent[k, m])
    definite = cholesky_factor(condensed, modes)
    for j in range(count - modes):
        for m in range(modes):
            column[m] = 0.5 * (tangent[m, modes + j] + tangent[modes + j, m]) if definite else 0.0
        if definite:
            cholesky_solve(condensed, modes, column)
        for i in range(count - modes):
            value = 0.5 * (tangent[modes + i, modes + j] + tangent[modes + j, modes + i])
            for m in range(modes):
                value -= 0.5 * (tangent[modes + i, m] + tangent[m, modes + i]) * column[m]
            out[i, j] = value


@cache
def probe_function(law: MaterialPoint, single: bool) -> Any:
    """Compile ``probe(data, q)``, which returns the strain energy [J] and writes the forces of `update_tangent`."""
    digest = law_digest(__name__, law.digest, single)
    probe_forces = sampled_energy(law, single).probe

    @law_njit(digest, inner=True, fastmath={"contract"})
    def probe(data, q):
        """Evaluate the forces that `update_tangent` requires, and return the strain energy [J] of the coordinates."""
        modes, count, shape, rows = data.modes, q.shape[0], data.vectors[POWER_SHAPE], data.tangent.probes.rows
        largest = 0.0
        for m in range(modes):
            largest = max(largest, abs(shape[m]) / data.body.constants.differences[m])
        if not 0.0 < largest < np.inf:  # also where the vector of a crushed body is not a number
            for m in range(modes):
                shape[m] = data.body.constants.differences[m]
            largest = 1.0
        for m in range(count):
            rows[AT_STATE, m], rows[ALONG_SHAPE, m] = q[m], q[m]
        for m in range(modes):
            shape[m] /= largest
            rows[ALONG_SHAPE, m] += shape[m]
        column, probes = int(data.tracking[NEXT_COLUMN]), data.tangent.probes
        change, points = data.body.constants.differences[column], data.body.constants.cubature_points
        return probe_forces(rows, column, change, points, probes.scratches, probes.forces)

    return probe
