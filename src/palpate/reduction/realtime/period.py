"""One period of a real-time loop, compiled: what `palpate.Engine` steps a reduced model with.

While the tool goes evenly from where it is to where it should be at the period's end, its coordinates have no
acceleration; what it takes to change their speed at the period's start is an impulse. Forces on the tool are means
over the period. Nothing here allocates or asks Python.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.arrays import Floats
from palpate.dynamics.compiled.cache import law_digest, law_njit
from palpate.dynamics.material.relaxation import reset_history
from palpate.reduction.contact.gauss_seidel import aim, compliance_energy, press
from palpate.reduction.contact.surface import ContactScratch, ContactSurface, RigidTools
from palpate.reduction.contact.tangent import ContactSystem
from palpate.reduction.hyper.foundation import Springs, draw_back
from palpate.reduction.hyper.implicit import Newton, cholesky_factor, cholesky_solve, implicit_step
from palpate.reduction.hyper.material_point import MaterialPoint
from palpate.reduction.hyper.sampled_energy import IntegrationPoints, Scratch, sampled_energy

__all__ = ["PeriodData", "period_functions"]


SAFETY = 0.8  # of the explicit step, whose frequency is followed by one power iteration a period
MOST_SUBSTEPS = 1000


class PeriodData(NamedTuple):
    """What the compiled period reads and keeps.

    Parameters
    ----------
    modes : int
    beta, step : float [s]
        Viscosity; step of the implicit rule, 0 for explicit steps.
    tolerance : float
        Of Newton's iterations.
    mass, held : (m, m), (M, M) arrays
        Mass matrix; inverse of its part for the modes.
    differences : (m,) array
        Of the coordinates, for tangents.
    samples, scratch, newton : tuples
    trained, root : (t, m), (m, m) arrays
        Training states times the root; root of the mass matrix over the body's mass, transposed.
    reach, leeway : float [m]
    watched, watch : tuples
        Samples with the witnesses behind the coordinates, and their scratch.
    witness_mass : (w, m) array
        Mass matrix of the witnesses and coordinates.
    wide : (2, m + w) array
    vectors : (8, m) array
    tangent : (m, m) array
        Of which every period takes one column anew.
    condensed : (m, m) array
    follow : (4,) array
        Frequency [rad/s] at rest and now; next column of the tangent; explicit step [s].
    path, holds, nothing : (s + 3, l), (s,), (s, m) arrays
        Of the implicit steps of a period: the tool's path, that it holds, and no loads.
    skin, touch, tools : tuples
        Of a tool that touches the body (`palpate.reduction.contact.gauss_seidel`); none where it holds a group.
    home : (3,) array [m]
        Where that tool stands when its pose is none.
    system : tuple
        Of the contact stiffness (`palpate.reduction.contact.tangent`).
    springs : tuple
        On the coordinates and the witnesses.
    """

    modes: int
    beta: float
    step: float
    tolerance: float
    mass: Floats
    constrained_inverse_mass: Floats
    differences: Floats
    integration_points: IntegrationPoints
    scratch: Scratch
    newton: Newton
    trained: Floats
    root: Floats
    distance_scale: float
    residual_scale: float
    watched: IntegrationPoints
    watch: Scratch
    residual_mass: Floats
    wide: Floats
    vectors: Floats
    tangent: Floats
    condense: Floats
    follow: Floats
    path: Floats
    holds: NDArray[np.bool_]
    nothing: Floats
    contact_surface: ContactSurface
    contact_state: ContactScratch
    tools: RigidTools
    home: Floats
    system: ContactSystem
    springs: Springs


@cache
def period_functions(law: MaterialPoint, single: bool) -> tuple[Any, Any]:
    """Compile the period of a law.

    Returns
    -------
    advance, stiffness : functions
        ``advance(data, q, v, target, period, report)`` advances coordinates and velocities (m,) by a period [s] while
        the tool's coordinates go evenly to `target` (l,). Its report (8 + l,) holds 0, or 1 where the state would not
        be finite (it is then unchanged), the trust number, the steps taken, kinetic and strain energy [J], and from the
        ninth entry on the mean forces of the tool on its coordinates. ``stiffness(data, q, out)`` writes how they
        change with the tool's coordinates (l, l) when the body has come to rest, from the tangents of the last m
        periods.
    """
    digest = law_digest(__name__, "period", law.digest, single)
    force, energy = sampled_energy(law, single)
    average, _ = implicit_step(law, single)

    @law_njit(digest, fastmath={"contract"})
    def follow(data, q):  # type: ignore[no-untyped-def]
        """One power iteration for the highest frequency, and one column of the tangent."""
        modes, count = data.modes, q.shape[0]
        shape, moved, ahead, behind = data.vectors[0], data.vectors[1], data.vectors[2], data.vectors[3]
        largest = 0.0
        for m in range(modes):
            largest = max(largest, abs(shape[m]) / data.differences[m])
        for m in range(count):
            moved[m] = q[m]
        for m in range(modes):
            shape[m] /= largest
            moved[m] += shape[m]
        force(q, data.integration_points, data.scratch, behind)
        force(moved, data.integration_points, data.scratch, ahead)
        size, grown = 0.0, 0.0
        for m in range(modes):
            value = 0.0
            for k in range(modes):
                value += data.constrained_inverse_mass[m, k] * (behind[k] - ahead[k])
            moved[m] = value
        for m in range(modes):
            image, given = 0.0, 0.0
            for k in range(modes):
                image += data.mass[m, k] * moved[k]
                given += data.mass[m, k] * shape[k]
            grown += image * moved[m]
            size += given * shape[m]
        for m in range(modes):
            shape[m] = moved[m]
        if grown > 0.0 and size > 0.0:
            data.follow[1] = np.sqrt(np.sqrt(grown / size))
        column = int(data.follow[2])
        data.follow[2] = (column + 1) % count
        for m in range(count):
            moved[m] = q[m]
        moved[column] += data.differences[column]
        force(moved, data.integration_points, data.scratch, ahead)
        for m in range(count):
            data.tangent[m, column] = (behind[m] - ahead[m]) / data.differences[column]
            if data.springs.stiffness.shape[0] > 0:
                data.tangent[m, column] += data.springs.stiffness[m, column]

    @law_njit(digest, fastmath={"contract"})
    def substeps(data, q, v, speeds, period, report):  # type: ignore[no-untyped-def]
        """Explicit steps over a period; return their number."""
        modes, count = data.modes, q.shape[0]
        at, result, rate = data.vectors[1], data.vectors[2], data.vectors[3]
        frequency = np.sqrt(max(data.follow[0], data.follow[1]) ** 2 + data.springs.square)
        z = data.beta * frequency + data.springs.rate / frequency
        stable = SAFETY * (np.sqrt(z * z + 4.0) - z) / frequency
        steps = min(MOST_SUBSTEPS, int(np.ceil(period / stable)))
        step = period / steps
        data.follow[3] = step
        for s in range(steps):
            for m in range(count):
                at[m] = q[m] + data.beta * v[m]
            clock = data.scratch.history.interval
            clock[0] = clock[1]
            force(at, data.integration_points, data.scratch, result)
            draw_back(data.springs, q, v, result)
            clock[0], clock[1] = 0.0, step
            for m in range(modes):
                value = 0.0
                for k in range(modes):
                    value += data.constrained_inverse_mass[m, k] * result[k]
                rate[m] = value
                v[m] += step * value
            for j in range(modes, count):
                value = -result[j]
                for m in range(modes):
                    value += data.mass[j, m] * rate[m]
                report[8 + j - modes] += value / steps
            if data.tools.kind.shape[0] > 0:
                press(data.contact_surface, data.contact_state, data.tools, q, v, data.constrained_inverse_mass, at, step, period,
                      (s + 1.0) / steps, report)  # fmt: skip
            for m in range(modes):
                q[m] += step * v[m]
            for j in range(modes, count):
                q[j] += step * speeds[j]
        return steps

    @law_njit(digest, fastmath={"contract"})
    def implicit(data, q, v, period, report, lifting, holds, loads):  # type: ignore[no-untyped-def]
        """Implicit steps over a period; return their number, or -1 where one did not converge."""
        steps, count = loads.shape[0], q.shape[0]
        step = period / steps
        for j in range(data.modes, count):
            for s in range(steps + 3):
                lifting[s, j - data.modes] = q[j] + (s - 1) * step * v[j]
        result, rate, load = data.newton.vectors[5], data.newton.vectors[6], data.newton.vectors[9]
        for s in range(steps):
            _, _, _, taken = average(
                q, v, lifting[s : s + 4], holds[s : s + 1], step, data.beta, loads[s : s + 1], data.mass,
                data.differences, data.tolerance, data.integration_points, data.scratch, data.springs, data.newton,
            )  # fmt: skip
            if taken < 1:
                return -1
            for j in range(data.modes, count):
                value = -result[j] - load[j]
                for m in range(data.modes):
                    value += data.mass[j, m] * rate[m]
                report[8 + j - data.modes] += value / steps
        return steps

    @law_njit(digest, fastmath={"contract"})
    def distance(data, q):  # type: ignore[no-untyped-def]
        """Distance to the nearest training state, over the reach."""
        place, count, nearest = data.vectors[1], q.shape[0], np.inf
        for m in range(count):
            value = 0.0
            for k in range(count):
                value += data.root[m, k] * q[k]
            place[m] = value
        for t in range(data.trained.shape[0]):
            square = 0.0
            for m in range(count):
                apart = place[m] - data.trained[t, m]
                square += apart * apart
            nearest = min(nearest, square)
        return np.sqrt(nearest) / data.distance_scale

    @law_njit(digest, fastmath={"contract"})
    def residual_norm(data, q, v):  # type: ignore[no-untyped-def]
        """What the forces on the witnesses miss of balance, over the leeway."""
        at, result, rate, count, total = data.wide[0], data.wide[1], data.vectors[1], q.shape[0], 0.0
        for m in range(count):
            at[m] = q[m] + data.beta * v[m]
        force(at, data.watched, data.watch, result)
        draw_back(data.springs, q, v, result)
        for m in range(data.modes):
            value = 0.0
            for k in range(data.modes):
                value += data.constrained_inverse_mass[m, k] * result[k]
            rate[m] = value
        for j in range(data.residual_mass.shape[0]):
            left = -result[count + j]
            for m in range(data.modes):
                left += data.residual_mass[j, m] * rate[m]
            total += left * left
        return np.sqrt(total) / data.residual_scale

    @law_njit(digest, fastmath={"contract"})
    def advance(data, q, v, target, period, report):  # type: ignore[no-untyped-def]
        modes, count = data.modes, q.shape[0]
        kept, before, speeds = data.vectors[5], data.vectors[6], data.vectors[7]
        report[:] = 0.0
        kept[:] = q
        before[:] = v
        still = not q.any() and not v.any()
        if still:  # at rest: begun, or begun again
            reset_history(data.scratch.history)
            data.contact_state.force[:] = 0.0
            data.system.numbers[:] = 0
        follow(data, q)
        change = data.vectors[4]  # of the velocities, at the start of the period
        for j in range(modes, count):
            speeds[j] = (target[j - modes] - q[j]) / period
            change[j] = speeds[j] - v[j]
        for m in range(modes):
            value = 0.0
            for k in range(modes):
                for j in range(modes, count):
                    value -= data.constrained_inverse_mass[m, k] * data.mass[k, j] * change[j]
            change[m] = value
        for m in range(count):
            v[m] += change[m]
        for j in range(modes, count):
            for k in range(count):
                report[8 + j - modes] += data.mass[j, k] * change[k] / period
        aim(data.tools, data.home, target, still)
        if data.step > 0.0:
            steps = max(1, int(np.round(period / data.step)))
            taken = implicit(
                data, q, v, period, report, data.path[: steps + 3], data.holds[:steps], data.nothing[:steps]
            )
        else:
            taken = substeps(data, q, v, speeds, period, report)
        good = taken > 0
        for m in range(count):
            good = good and np.isfinite(q[m]) and np.isfinite(v[m])
        if not good:
            q[:] = kept
            v[:] = before
            report[0] = 1.0
            return
        for j in range(modes, count):  # rounding
            q[j] = target[j - modes]
            v[j] = speeds[j]
        report[1], report[2] = max(distance(data, q), residual_norm(data, q, v)), taken
        for m in range(count):
            for k in range(count):
                report[3] += 0.5 * v[m] * data.mass[m, k] * v[k]
        report[4] = energy(q, data.integration_points, data.scratch) + compliance_energy(
            data.contact_surface, data.contact_state
        )
        if not np.isfinite(report[4]):
            q[:] = kept
            v[:] = before
            report[0] = 1.0

    @law_njit(digest, fastmath={"contract"})
    def stiffness(data, q, out):  # type: ignore[no-untyped-def]
        modes, count = data.modes, q.shape[0]
        for m in range(count):
            for k in range(count):
                data.condense[m, k] = 0.5 * (data.tangent[m, k] + data.tangent[k, m])
        firm = cholesky_factor(data.condense, modes)
        column = data.vectors[1]
        for j in range(count - modes):
            for m in range(modes):
                column[m] = 0.5 * (data.tangent[m, modes + j] + data.tangent[modes + j, m]) if firm else 0.0
            if firm:
                cholesky_solve(data.condense, modes, column)
            for i in range(count - modes):
                value = 0.5 * (data.tangent[modes + i, modes + j] + data.tangent[modes + j, modes + i])
                for m in range(modes):
                    value -= 0.5 * (data.tangent[modes + i, m] + data.tangent[m, modes + i]) * column[m]
                out[i, j] = value

    return advance, stiffness
