"""The stress-free shape of a body whose shape was taken under loads, as a scan of a patient is under gravity.

With X the stress-free places of the nodes and x those of the scan, the unbalanced forces f(X) of the body at X with
displacements x - X vanish. Newton's method for a change of x at the same X would move the nodes by K^-1 f; here x is
given, and X moves by the opposite. It is a simplified Newton's method on the inverse problem (Govindjee and Mihalic,
Comput. Methods Appl. Mech. Eng. 136, 1996): its tangent omits that X changes the cells, so errors decrease by about
the strain in a step. It requires no equilibrium of a body of the wrong shape, unlike the iteration of Sellier (J. Eng.
Math. 70, 2011).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from palpate.core.arrays import Floats, euclidean_norm
from palpate.core.describe import Described, Fact
from palpate.core.faults import CloudError, DivergenceError, integer_in_range, number_in_range
from palpate.dynamics.loads.body_force import Gravity
from palpate.dynamics.loads.dead_load import DeadLoad
from palpate.dynamics.loads.foundation import Foundation
from palpate.dynamics.loads.prepared import Load, check_kinds, listed
from palpate.dynamics.loads.pressure import Pressure
from palpate.dynamics.nodal.equilibrium import equilibrium
from palpate.dynamics.nodal.equilibrium_residual import EquilibriumResidual
from palpate.dynamics.nodal.mixed_newton import Tangent
from palpate.dynamics.nodal.mixed_stress import extrapolated_stress, split_stress
from palpate.dynamics.solid.model import EnergySolid, Solid, energy_solid

UNLOADING_LOADS = (DeadLoad, Pressure, Gravity, Foundation)
MIN_INCREMENT = 1 / 64  # of the loads
STAGE_TOLERANCE = 3e-2  # of corrections before the loads have increased fully, over the largest shift
STEPS_WITHOUT_DECREASE = 6  # steps after which corrections must decrease


@dataclass(frozen=True)
class UnloadedBody(Described):
    """A body without loads, and its equilibrium under them, which has the shape that was given.

    Parameters
    ----------
    body : Solid
        Its nodes are at their stress-free places.
    displacements : (n, 3) array [m]
        From there to the equilibrium under the loads: the start of a run, ``rollout(displacement=...)``.
    distance : float [m]
        Largest distance of a node in equilibrium from the shape that was given.
    iterations : int

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.NeoHookean(C1=1e3, density=1000, poisson=0.45)
    >>> scan = pt.Solid(cloud, tissue, fixed="x-")
    >>> rest = pt.unloaded(scan, [pt.Gravity()])
    >>> bool(rest.distance < 1e-3 * abs(rest.displacements).max())
    True
    """

    body: Solid
    displacements: Floats
    distance: float
    iterations: int

    def _facts(self) -> list[Fact]:
        return [
            ("nodes", len(self.displacements), ""),
            ("largest displacement", float(np.linalg.norm(self.displacements, axis=1).max(initial=0.0)), "m"),
            ("distance from the given shape", float(self.distance), "m"),
            ("iterations", self.iterations, ""),
        ]


def unloaded(
    body: Solid,
    loads: Load | Sequence[Load],
    *,
    time: float = 0.0,
    tolerance: float = 1e-3,
    max_iterations: int = 100,
) -> UnloadedBody:
    """Find the stress-free shape of a body whose shape was taken under loads, such as gravity in a scanner.

    Parameters
    ----------
    body : Solid
        In the energy form, without cuts and planes of symmetry, with the shape under the loads. It does not change.
    loads : load or sequence of loads
        Loads that acted: gravity, forces, pressures, and foundations, which had no force before the other loads.
    time : float [s]
        Time at which the loads are taken.
    tolerance : float
        Largest distance from the given shape, over the largest displacement.
    max_iterations : int

    Returns
    -------
    UnloadedBody

    Raises
    ------
    DivergenceError
        No such shape was found: the loads are too large for the tissue.
    InputError
        The body is in another form or not supported, a load is of another kind, or an argument is out of range.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.NeoHookean(C1=1e3, density=1000, poisson=0.45)
    >>> rest = pt.unloaded(pt.Solid(cloud, tissue, fixed="x-"), [pt.Gravity()])
    >>> weight = pt.equilibrium(rest.body, [pt.Gravity()])
    >>> bool(abs(rest.body.cloud.points + weight.displacements - cloud.points).max() < 1e-5)
    True
    """
    body = energy_solid(body)
    time = number_in_range("time", time, unit="s")
    number_in_range("tolerance", tolerance, 1e-8, 1e-1)
    integer_in_range("max_iterations", max_iterations, 1)
    loads = listed(loads)
    check_kinds(loads, UNLOADING_LOADS, "loads of unloaded")
    with np.errstate(all="ignore"):  # trial shapes may have no energy
        return _iterate(body, loads, time, tolerance, max_iterations)


def _iterate(body: EnergySolid, loads: Sequence[Load], time: float, tolerance: float, most: int) -> UnloadedBody:
    """Increase the share of the loads until all of them balance, as `palpate.dynamics.nodal.mixed_newton` does."""
    shift, share, increment, iterations = np.zeros_like(body.cloud.points), 0.0, 1.0, 0
    slope = np.zeros_like(shift)  # of the shift over the share
    offset = _unbalanced(body, loads, time, shift)[1]
    while True:
        target = min(share + increment, 1.0)
        goal = tolerance if target == 1.0 else STAGE_TOLERANCE
        guess = shift + (target - share) * slope
        moved, steps = _corrected(body, loads, time, guess, (1 - target) * offset, goal, most - iterations)
        iterations += steps
        if moved is None:
            increment /= 2
            if increment < MIN_INCREMENT or iterations >= most:
                raise DivergenceError(
                    f"no stress-free shape was found: one exists up to {share:.1%} of the loads, and none was found at "
                    f"{target:.1%} after {iterations} steps in all; use smaller loads, a stiffer tissue, or more "
                    "supports"
                )
            continue
        slope = (moved - shift) / (target - share)
        shift, share, increment = moved, target, 2 * increment
        if share == 1.0:
            present = body.moved(shift)
            rest = equilibrium(present, loads, time=time, displacement=-shift)
            distance = float(np.linalg.norm(rest.displacements + shift, axis=1).max())
            if distance > tolerance * float(np.linalg.norm(rest.displacements, axis=1).max(initial=0.0)):
                raise DivergenceError(
                    f"no stress-free shape was found: the body has another equilibrium, {distance:.3g} m from the "
                    "given shape; use smaller loads or more supports"
                )
            return UnloadedBody(present, rest.displacements, distance, iterations)


def _corrected(
    body: EnergySolid, loads: Sequence[Load], time: float, shift: Floats, offset: Floats, tolerance: float, most: int
) -> tuple[Floats | None, int]:
    """Return a shift (n, 3) [m] to places at which only the forces `offset` (n, 3) [N] are unbalanced, and the steps.

    The shift is None where corrections do not decrease.
    """
    mixed, least = None, np.inf
    for k in range(1, most + 1):
        try:
            equations, unbalanced = _unbalanced(body.moved(shift), loads, time, shift)
        except CloudError:
            return None, k
        u = equations.start
        present = split_stress(equations, u)
        step = Tangent(equations).solve(u, unbalanced - offset, np.zeros_like(u), present, mixed or present)
        if step is None or (k > STEPS_WITHOUT_DECREASE and euclidean_norm(step) > least):
            return None, k
        mixed = extrapolated_stress(equations, u, present, step)
        least, shift = min(least, euclidean_norm(step)), shift - step
        if np.abs(step).max() <= tolerance * np.abs(shift).max():
            return shift, k
    return None, most


def _unbalanced(
    body: EnergySolid, loads: Sequence[Load], time: float, shift: Floats
) -> tuple[EquilibriumResidual, Floats]:
    """Return the balance of a body, and its unbalanced forces (n, 3) [N] at displacements -shift."""
    equations = EquilibriumResidual(body, body.prepare(loads), time, -shift)
    return equations, equations.residual(equations.start)
