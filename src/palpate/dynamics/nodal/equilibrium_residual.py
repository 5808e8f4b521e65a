"""Equilibrium residual: nodal forces of a full model and its loads at rest, at one time."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from palpate.core.arrays import Floats, euclidean_norm
from palpate.core.faults import InputError
from palpate.dynamics.loads.prepared import PreparedLoads
from palpate.dynamics.loads.supports import free_rigid_motions
from palpate.dynamics.nodal.model import NodalModel

MIN_STRAIN = 1e-8  # smallest strain whose forces are resolved by the largest residual


class EquilibriumResidual:
    """Unbalanced nodal forces of a body at rest as a function of its displacements.

    Relaxing tissue is fully relaxed at all displacements. The displacements before the load at a time [s] are `start`
    (n, 3) [m], zero at fixed nodes; those of prescribed nodes grow by `jump` (n, 3) [m]. `constrained` (n,) are fixed
    and prescribed nodes. `constrain` removes the parts of a field (n, 3) that supports and prescribed motions
    constrain, in place. `weights` are (n, 1) [m^3], `springs` (n,) [N/m] those of foundations. It is `symmetric` if the
    forces are the derivative of an energy.
    """

    def __init__(self, model: NodalModel, prepared: PreparedLoads, time: float, start: Floats) -> None:
        self.model, self.prepared, self.time = model, prepared, time
        self._schedule, sites = prepared.schedule(np.array([time])), prepared.sites
        self.constrained: NDArray[np.bool_] = prepared.constraint_mask(time)
        self.weights: Floats = model.weights[:, None]
        springs = np.bincount(sites.foundation_node, sites.foundation_spring, minlength=len(start))
        self.springs: Floats = model.half_cell * springs * model.weights / model.volumes
        self.constrain = model.constrain(self.constrained)
        moving = 0 if self.springs.any() else free_rigid_motions(model.cloud.points, self.constrain)
        if moving:
            raise InputError(
                f"model must be supported for an equilibrium, got a body with {moving} free rigid motions and no "
                "Foundation; use fixed= or add a PrescribedMotion"
            )
        self._follows = bool(len(sites.pressure_node))
        self.symmetric = model.conservative and not self._follows
        self.start, self.jump = start.copy(), np.zeros_like(start)
        model.supported.project(self.start)
        active = self._schedule.constrained[0]
        nodes = sites.prescribed[active]
        self.jump[nodes] = self._schedule.motion[0, active] - self.start[nodes]
        self._work = model.workspace()
        self.internal(self.start)
        self._dead: Floats = self._load_density()

    def _load_density(self) -> Floats:
        """Return the loads without foundations [N/m^3]; pressures act on the body as last evaluated."""
        surface = self.model.tractions(self.prepared, self._schedule, self._work.passes.cofactor)
        return self.model.half_cell * surface + self.model.material.density * self._schedule.gravity[0]

    def history(self, u: Floats) -> tuple[Floats, ...]:
        """Return the history variables of fully relaxed tissue; empty without relaxation."""
        return self.model.equilibrium_history(u)

    def internal(self, u: Floats) -> Floats:
        """Return the internal force density (n, 3) [N/m^3]."""
        return self.model.force(u, self.history(u), self._work)

    def stress(self, u: Floats) -> Floats:
        """Return the nodal first Piola-Kirchhoff stress (n, 3, d) [Pa]."""
        return self.model.stress(u, self.history(u), self._work)

    def residual(self, u: Floats) -> Floats:
        """Return the unbalanced forces (n, 3) [N], without constrained parts."""
        density = self.internal(u)
        density += self._load_density() if self._follows else self._dead
        forces = density * self.weights - self.springs[:, None] * u
        return self.constrain(forces)

    def scale(self, u: Floats) -> float:
        """Return the norm [N] of the loads without constrained parts, and of the constrained internal forces.

        It is at least that of a strain of `MIN_STRAIN`, so that rounding does not count.
        """
        internal = self.internal(u) * self.weights
        loads = (self._load_density() if self._follows else self._dead) * self.weights - self.springs[:, None] * u
        blocked = internal - self.constrain(internal.copy())
        least = MIN_STRAIN * self.model.material.shear_modulus / self.model.cloud.spacing * self.weights
        parts = (self.constrain(loads), blocked, least)
        return euclidean_norm(np.array([euclidean_norm(part) for part in parts]))

    def volume_ratios(self, u: Floats) -> Floats:
        """Return det F (n,) of a solid, or the ratios of areas of a sheet."""
        F = self.model.deformation_gradient(u)
        if F.shape[2] == 3:
            return np.asarray(np.linalg.det(F))
        return np.asarray(np.linalg.norm(np.cross(F[:, :, 0], F[:, :, 1]), axis=1))
