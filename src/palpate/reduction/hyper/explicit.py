"""The compiled explicit step of a sampled reduced model.

With the coordinates a of modes and lifting functions, the mass matrix m, the sampled force f and the
loads g,

    m (a'' + alpha a') = f(a + beta a') + g(t).

The coordinates of the lifting functions are prescribed until their tool releases the body. The step is
that of `palpate.dynamics.nodal.central_difference`. The implicit step is in
`palpate.reduction.hyper.implicit`.
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

from palpate.compiled.jit import kernel_njit, law_digest, law_njit
from palpate.compiled.reference import reference
from palpate.core.arrays import Floats
from palpate.dynamics.contact.geometry import rotation
from palpate.reduction.contact.gauss_seidel import solve_contact
from palpate.reduction.contact.surface import ContactScratch, ContactSurface, RigidTools
from palpate.reduction.galerkin.central_difference import (
    damping_work,
    drift,
    kick_coordinates,
    mass_damping_loss,
    prescribe,
    prescribed_work,
    trial_coordinates,
)
from palpate.reduction.hyper.constants import ReducedConstants
from palpate.reduction.hyper.foundation import Springs, add_spring_forces
from palpate.reduction.hyper.material_point import MaterialPoint
from palpate.reduction.hyper.sampled_energy import Scratch, sampled_energy

TRIAL, FORCE, PREVIOUS, RATE, LOAD, MEAN = range(6)  # rows of `ExplicitData.work`


class ExplicitData(NamedTuple):
    """Constants and work arrays of the explicit step."""

    constants: ReducedConstants
    wave_speed: Floats  # (l,) largest rates of the lifting coordinates in the damping forces
    scratch: Scratch
    springs: Springs  # on the coordinates
    work: Floats  # (6 or more, m + l)


class ContactData(NamedTuple):
    """Rigid tools in contact during some steps."""

    poses: Floats  # (s, t, 7) at the times of the loads
    surface: ContactSurface
    scratch: ContactScratch
    tools: RigidTools


@kernel_njit(inline="always")
def _no_push(data, contact, a, v, lifting, s, step, kick, response, moving, total, lost):
    """Do nothing, for runs without tools in contact; return as `_push`."""
    return total, lost


@kernel_njit(inline="always", fastmath={"contract"})
def _push(data, contact, a, v, lifting, s, step, kick, response, moving, total, lost):
    """Accelerate the coordinates by rigid tools in contact during step s.

    Returns work and dissipation [J] with those of the step.
    """
    tools, alpha, first = contact.tools, data.constants.mass_damping, a.shape[0] - lifting.shape[1]
    at, rate, load, mean = data.work[TRIAL], data.work[RATE], data.work[LOAD], data.work[MEAN]
    for t in range(tools.kind.shape[0]):
        rotation(contact.poses[s, t], tools.frames[t, 0])
        rotation(contact.poses[s + 1, t], tools.frames[t, 1])
    for m in range(a.shape[0]):
        at[m] = a[m] + step * v[m] if m < moving else lifting[s + 2, m - first]
    works = solve_contact(contact.surface, contact.scratch, tools, at, v, step, response, moving)
    total, lost = total + works[0], lost + works[1]
    drag = 1.0 + 0.5 * alpha * kick  # as that of the other forces in `kick_coordinates`
    for m in range(moving):
        value = 0.0
        for k in range(moving):
            value += step / drag * response[m, k] * tools.load[k]
        v[m] += value
        total += 0.5 * kick * load[m] * value  # loads work at the mean velocity
        lost += alpha * kick * step / drag * tools.load[m] * (mean[m] + 0.25 * value)
    for j in range(moving, a.shape[0]):
        rate[j] += tools.load[j]
    return total, lost


@cache
def _forces_function(law: MaterialPoint, single: bool) -> Any:
    """Compile ``write_forces(data, a, v, load_of_step, held, interval)``.

    It writes the forces of the body, of loads and of springs, and returns the energy [J] that damping dissipates in
    the step before. History variables advance by the interval [s].
    """
    force = sampled_energy(law, single).force

    @law_njit(law_digest(__name__, "forces", law.digest, single), inline="always", fastmath={"contract"})
    def write_forces(data, a, v, load_of_step, held, interval):
        at, result, rate, load = data.work[TRIAL], data.work[FORCE], data.work[RATE], data.work[LOAD]
        trial_coordinates(a, v, data.constants.stiffness_damping, data.wave_speed, held, at)
        data.scratch.history.interval[0] = interval
        force(at, data.constants.cubature_points, data.scratch, result)
        for m in range(a.shape[0]):
            load[m] = load_of_step[m]
        add_spring_forces(data.springs, a, v, load)
        change = damping_work(at, a, result, data.work[PREVIOUS])
        for m in range(a.shape[0]):
            rate[m] = result[m] + load[m]
        return change

    return write_forces


@cache
def explicit_step(law: MaterialPoint, single: bool, touched: bool) -> Any:
    """Compile the explicit step of sampled models of a law, without contact for runs that are not `touched`.

    ``explicit(a, v, lifting, holds, step, loads, data, contact)`` advances coordinates and velocities (m + l,) in
    place. `lifting` (s + 2, l) has one time before and one after those of the loads (s, m + l), and `holds` (s,) is
    True while tools prescribe the lifting coordinates. `data` is an `ExplicitData`, `contact` a `ContactData`.
    """
    digest = law_digest(__name__, "explicit step", law.digest, single, touched)
    write_forces, push = _forces_function(law, single), _push if touched else _no_push

    @law_njit(digest, nogil=True, fastmath={"contract"})
    def explicit(a, v, lifting, holds, step, loads, given, given_contact):
        """Advance by one step less than there are loads; return three energies [J].

        They are the work of the loads, the dissipation, and the work of prescribed tools.

        The work of rigid tools in contact is part of that of the loads, and their friction part of
        the dissipation. The forces of springs are added to the loads.
        """
        data, contact = reference(given), reference(given_contact)
        count, first, steps = a.shape[0], a.shape[0] - lifting.shape[1], loads.shape[0] - 1
        total, lost, tool_work = 0.0, 0.0, 0.0
        rate, load, mean, alpha = data.work[RATE], data.work[LOAD], data.work[MEAN], data.constants.mass_damping
        for s in range(steps + 1):
            if holds[s]:
                prescribe(a, v, lifting, s, step)
            change = write_forces(data, a, v, loads[s], holds[s], step if s > 0 else 0.0)
            if s > 0:
                lost += change
            kick = 0.5 * step if s in (0, steps) else step
            prescribed = holds[min(s + 1, steps)]
            moving = first if prescribed else count
            response = data.constants.constrained_inverse_mass if prescribed else data.constants.inverse_mass
            total += kick_coordinates(
                v, rate, load, lifting, s, step, kick, prescribed, data.constants.mass, response, alpha, mean
            )  # fmt: skip
            lost += mass_damping_loss(alpha, data.constants.mass, mean, kick)
            if s < steps:
                total, lost = push(data, contact, a, v, lifting, s, step, kick, response, moving, total, lost)
            if prescribed:
                works = prescribed_work(rate, load, lifting, s, step, kick, 1.0)
                total += works[0]
                if s < steps:  # the next call evaluates the last time
                    tool_work += works[1]
            if s < steps:
                drift(a, v, moving, step)
        data.scratch.history.interval[0] = 0.0
        return total, lost, tool_work

    return explicit
