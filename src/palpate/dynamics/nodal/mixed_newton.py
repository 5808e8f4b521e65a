"""Newton's method for the static equilibrium of a full model, without a matrix.

The tangent acts on a direction by a difference of two forces, and preconditioned iterations solve every
step inexactly (Knoll and Keyes, J. Comput. Phys. 193, 2004): conjugate gradients where the forces derive
from an energy, otherwise GMRES. The stresses of the tangent are those of the mixed Newton method
(`palpate.dynamics.nodal.mixed_stress`). Steps have their full length.

With r(u) the unbalanced nodal forces, r(u) = (1 - s) r(u0) has the given displacements u0 as a solution
at s = 0, and equilibrium at s = 1 (a Newton homotopy: Allgower and Georg, Introduction to Numerical
Continuation Methods, SIAM 2003, section 1.1). The method takes s = 1 first, and smaller increments of
s where it fails. Prescribed displacements increase with s.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sparse
from scipy.sparse.linalg import LinearOperator, gmres

from palpate.core.arrays import Floats, euclidean_norm
from palpate.core.faults import DivergenceError
from palpate.dynamics.nodal.coarse_grid import two_level_preconditioner
from palpate.dynamics.nodal.equilibrium_residual import EquilibriumResidual
from palpate.dynamics.nodal.mixed_stress import (
    SplitStress,
    added_moduli,
    extrapolated_stress,
    split_stress,
    tangent_moduli,
)
from palpate.dynamics.nodal.model import NodalModel

DIFFERENCE_SPACINGS = 1e-6  # largest displacement of a difference of forces, in spacings
LINEAR_TOLERANCE = 1e-3  # relative error of the linear solution of a step
MAX_LINEAR_ITERATIONS = 500  # of conjugate gradients
RESTART_ITERATIONS, MAX_CYCLES = 150, 4  # of GMRES
MAX_STEPS = 20  # of Newton's method in one increment
STEPS_WITHOUT_DECREASE = 6  # steps after which the residual must decrease
INCREMENT_TOLERANCE = 1e-2  # of the residual between two increments, over the increment
MIN_INCREMENT = 1 / 256  # of the load
MAX_VOLUME_CHANGE = 4.0  # largest ratio of a node's volumes before and after a step
MIN_EXCESS = 1e-2  # smallest excess of stresses that counts in the tangent, over the shear modulus
MAX_STRAIN_CHANGE = 0.02  # largest change of F for which a preconditioner is used again


class MixedNewton:
    """Newton's method with increments of the load.

    The largest residual `tolerance`, and the last `residual`, are over `EquilibriumResidual.scale`. `iterations` counts
    steps.
    """

    def __init__(self, equations: EquilibriumResidual, tolerance: float, max_iterations: int) -> None:
        self.equations, self.tolerance, self.max_iterations = equations, tolerance, max_iterations
        self.iterations, self.residual = 0, np.inf
        self._tangent = Tangent(equations)

    def run(self) -> Floats:
        """Return displacements (n, 3) [m] in equilibrium; raise `DivergenceError` if none are found."""
        u, share, increment = self.equations.start, 0.0, 1.0
        self._offset = self.equations.residual(u)
        while share < 1.0:
            target = min(share + increment, 1.0)
            solution = self._increase(u, share, target)
            if solution is not None:
                u, share, increment = solution, target, 2 * increment
                continue
            increment /= 2
            if increment < MIN_INCREMENT or self.iterations >= self.max_iterations:
                raise DivergenceError(
                    f"no equilibrium was found: Newton's method converged up to {share:.1%} of the load, and not at "
                    f"{target:.1%} after {self.iterations} steps in all; use a smaller load, another displacement to "
                    "start from, or rollout"
                )
        return u

    def _increase(self, u: Floats, share: float, target: float) -> Floats | None:
        """Return displacements in equilibrium at a share of the load from those at a smaller one; None on failure."""
        equations = self.equations
        tolerance = self.tolerance if target == 1.0 else max(self.tolerance, INCREMENT_TOLERANCE * (target - share))
        jump = (target - share) * equations.jump
        mixed = present = split_stress(equations, u)
        volumes, least = equations.volume_ratios(u), np.inf
        for step in range(MAX_STEPS):
            unbalanced = equations.residual(u) - (1 - target) * self._offset
            self.residual = euclidean_norm(unbalanced) / equations.scale(u)
            if not jump.any() and self.residual <= tolerance:
                return u
            stuck = step > STEPS_WITHOUT_DECREASE and self.residual > least
            if not np.isfinite(self.residual) or stuck or self.iterations >= self.max_iterations:
                return None
            least = min(least, self.residual) if step else np.inf  # prescribed nodes have not moved before
            direction = self._tangent.solve(u, unbalanced, jump, present, mixed)
            self.iterations += 1
            if direction is None:
                return None
            mixed = extrapolated_stress(equations, u, present, direction)
            u, jump = u + direction, np.zeros_like(u)
            before, volumes = volumes, equations.volume_ratios(u)
            if not np.all((volumes > before / MAX_VOLUME_CHANGE) & (volumes < before * MAX_VOLUME_CHANGE)):
                return None
            present = split_stress(equations, u)
        return None


class Tangent:
    """The tangent stiffness of a body and its loads, with its preconditioner."""

    def __init__(self, equations: EquilibriumResidual) -> None:
        self.equations = equations
        self.gradient, self.transposed = _gradient_operator(equations.model)
        self._built_at: Floats | None = None
        self._precondition: Callable[[Floats], Floats] = np.copy

    def solve(
        self, u: Floats, residual: Floats, jump: Floats, present: SplitStress, mixed: SplitStress
    ) -> Floats | None:
        """Return Newton's step (n, 3) [m] from displacements u, or None if the linear iterations fail.

        `u` and `residual` are (n, 3) [m] and [N]. Prescribed nodes move by `jump` (n, 3) [m] in this step. `present`
        are the stresses of the law, `mixed` those of the tangent.
        """
        equations, model = self.equations, self.equations.model
        F, added = model.deformation_gradient(u), None
        modulus = model.material.shear_modulus
        excess = max(float(np.abs(b - a).max()) for a, b in zip(present, mixed, strict=True))
        if excess > MIN_EXCESS * modulus:
            added = added_moduli(F, present, mixed)
        if self._built_at is None or np.abs(F - self._built_at).max() > MAX_STRAIN_CHANGE:
            moduli = tangent_moduli(equations, u)
            if added is not None:
                moduli += added
            self._precondition = two_level_preconditioner(model, F, moduli, equations.constrained, equations.springs)
            self._built_at = F if added is None else None
        before, spacing = equations.residual(u), model.cloud.spacing

        def apply(direction: Floats) -> Floats:
            scale = DIFFERENCE_SPACINGS * spacing / max(float(np.abs(direction).max()), 1e-300)
            image = (before - equations.residual(u + scale * direction)) / scale
            if added is not None:
                image += self._added_force(added, direction)
            return image

        if jump.any():
            residual = residual - apply(jump)
        solver = conjugate_gradients if equations.symmetric else gmres_solution
        correction = solver(apply, self._precondition, residual)
        return None if correction is None else jump + correction

    def _added_force(self, moduli: Floats, direction: Floats) -> Floats:
        """Return the nodal forces (n, 3) [N] of additional moduli, without constrained parts."""
        n, d = len(direction), moduli.shape[1] // 3
        slopes = (self.gradient @ self.equations.model.mirror.vectors(direction)).reshape(d, n, 3).transpose(1, 2, 0)
        stress = self.equations.weights[:, :, None] * (moduli @ slopes.reshape(n, 3 * d, 1)).reshape(n, 3, d)
        force = self.transposed @ stress.transpose(2, 0, 1).reshape(d * n, 3)
        return self.equations.constrain(self.equations.model.mirror.fold(np.asarray(force)))


def _gradient_operator(model: NodalModel) -> tuple[Any, Any]:
    """Return the derivatives along all axes, one after the other, as a sparse (d n, n + g) array, and its transpose."""
    stencils, n, images = model.stencils, len(model.cloud), len(model.mirror.source)
    nodes = np.concatenate([np.arange(n)[:, None], stencils.neighbours], axis=1)
    weights = np.concatenate([stencils.own_first[stencils.row][:, None], stencils.first[stencils.row]], axis=1)
    starts = nodes.shape[1] * np.arange(n + 1)
    parts = [
        sparse.csr_array((weights[:, :, k].ravel(), nodes.ravel(), starts), shape=(n, n + images))
        for k in range(weights.shape[2])
    ]
    stacked = sparse.vstack(parts, format="csr")
    return stacked, stacked.T.tocsr()


def conjugate_gradients(
    tangent: Callable[[Floats], Floats], precondition: Callable[[Floats], Floats], forces: Floats
) -> Floats | None:
    """Return an approximate solution of K d = f for a symmetric K by conjugate gradients, or None.

    `tangent` returns K d of displacements (n, 3); `precondition` is an approximate inverse of K; `forces` are (n, 3)
    [N]. A direction of negative curvature does not end the iterations, since the solution of the linear equations is
    Newton's step nevertheless.
    """
    solution, left = np.zeros_like(forces), forces.copy()
    scaled = precondition(left)
    direction, product = scaled, float(np.vdot(left, scaled))
    goal = LINEAR_TOLERANCE**2 * product
    if product == 0.0:
        return solution
    for _ in range(MAX_LINEAR_ITERATIONS):
        image = tangent(direction)
        curvature = float(np.vdot(direction, image))
        if not abs(curvature) > 0:  # no stiffness, or NaN
            return None
        length = product / curvature
        solution += length * direction
        left -= length * image
        scaled = precondition(left)
        product, before = float(np.vdot(left, scaled)), product
        if product <= goal or not np.isfinite(product):
            break
        direction = scaled + (product / before) * direction
    return solution if np.isfinite(product) else None


def gmres_solution(
    tangent: Callable[[Floats], Floats], precondition: Callable[[Floats], Floats], forces: Floats
) -> Floats | None:
    """Return an approximate solution of K d = f for any K, or None; parameters as `conjugate_gradients`."""
    shape, size = forces.shape, forces.size

    def operator(function: Callable[[Floats], Floats]) -> Any:
        return LinearOperator((size, size), lambda x: function(x.reshape(shape)).ravel(), dtype=float)

    solution, _ = gmres(
        operator(tangent),
        forces.ravel(),
        rtol=LINEAR_TOLERANCE,
        restart=RESTART_ITERATIONS,
        maxiter=MAX_CYCLES,
        M=operator(precondition),
    )
    return None if not np.isfinite(solution).all() else np.asarray(solution).reshape(shape)
