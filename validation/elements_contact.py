"""Equilibria of validation/elements.py under a rigid ball: a penalty, and Newton's method. SI units."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import scipy.sparse as sp
from elements_fe import Body, Factor, surface_rule
from scipy.sparse.linalg import LinearOperator, gmres

# steps of GMRES with the factors of an earlier tangent before new ones are made, and the residual they must leave
KRYLOV, REMAINDER = 14, 0.03


class Ball:
    """A rigid ball without friction, kept out of faces of the body by a penalty.

    Parameters
    ----------
    body : Body
    radius : float [m]
    faces : array
        Those that can touch it.
    """

    def __init__(self, body: Body, radius: float, faces: np.ndarray) -> None:
        self.radius = radius
        self.rule, self.areas = surface_rule(body, faces)
        self.points = self.rule @ body.X
        self.force, self.penetration = np.zeros(3), 0.0

    def push(self, u: np.ndarray, centre: np.ndarray, stiffness: float, definite: bool = False):
        """Return the penalty's energy, nodal forces and stiffness; keep the total force and the penetration.

        If `definite`, the stiffness lacks the part by the curvature of the ball, which is negative.
        """
        arm = self.points + self.rule @ u - centre
        length = np.linalg.norm(arm, axis=1)
        gap = np.maximum(self.radius - length, 0.0)
        on = np.flatnonzero(gap)
        n, k = arm[on] / length[on, None], stiffness * self.areas[on]
        pushes = (k * gap[on])[:, None] * n
        self.force, self.penetration = pushes.sum(axis=0), float(gap.max(initial=0.0))
        rule = self.rule[on]
        outer = n[:, :, None] * n[:, None, :]
        curved = 0.0 if definite else (gap[on] / length[on])[:, None, None] * (np.eye(3) - outer)
        blocks = k[:, None, None] * (outer - curved)
        middle = sp.bsr_matrix((blocks, np.arange(len(on)), np.arange(len(on) + 1)), shape=(3 * len(on),) * 2)
        spread = sp.kron(rule, sp.identity(3)).tocsr()
        return 0.5 * float(k @ gap[on] ** 2), rule.T @ pushes, (spread.T @ middle @ spread).tocsr()


class Newton:
    """Newton's method with a line search on the energy.

    Parameters
    ----------
    body : Body
    held : array of bool (nodes, 3)
    most : int
        Steps until it gives up.
    """

    def __init__(self, body: Body, held: np.ndarray, most: int = 40) -> None:
        self.body, self.most = body, most
        self.free = ~held
        self.iterations = self.factors = 0
        self.factor: Factor | None = None

    def solve(self, u: np.ndarray, push: Callable, tolerance: float) -> np.ndarray:
        """Return the equilibrium next to displacements u (nodes, 3).

        Parameters
        ----------
        u : array [m]
        push : function of u, and whether the stiffness must be definite
            Energy, nodal forces and stiffness of the load.
        tolerance : float
            Of the residual, relative to the load's nodal forces.
        """
        state = self._state(u, push)
        for _ in range(self.most):
            _, residual, stiffness, scale = state
            if np.linalg.norm(residual) < tolerance * scale:
                return u
            self.iterations += 1
            step = self._step(self.body.tangent(u) + stiffness, residual)
            if not np.sum(step * residual) > 0:  # no way down: the tangent is not definite, that at rest is
                self.release()
                step = self._step(self.body.tangent() + push(u, definite=True)[2], residual)
            u, state = self._search(u, step, state, push)
        raise RuntimeError("Newton's method did not converge")

    def energy(self, u: np.ndarray, push: Callable) -> float:
        """Return the energy of body and load [J]."""
        return self.body.force(u)[1] + push(u)[0]

    def _state(self, u: np.ndarray, push: Callable):
        """Return energy, residual, the load's stiffness, and the size of its forces."""
        forces, elastic = self.body.force(u)
        energy, pushes, stiffness = push(u)
        residual = np.where(self.free, pushes - forces, 0.0)
        return elastic + energy, residual, stiffness, max(float(np.linalg.norm(pushes)), 1e-12)

    def _step(self, matrix: sp.csr_matrix, residual: np.ndarray) -> np.ndarray:
        """Return the step by a tangent, with the last factors where they serve to precondition it."""
        free = np.flatnonzero(self.free.ravel())
        matrix, right = matrix[free][:, free], residual.ravel()[free]
        x = None
        if self.factor is not None:
            inverse = LinearOperator(matrix.shape, self.factor, dtype=float)
            x, failed = gmres(matrix, right, rtol=REMAINDER, restart=KRYLOV, maxiter=1, M=inverse)
            if failed:
                self.release()
        if self.factor is None:
            self.factors += 1
            self.factor = Factor(matrix, definite=False)
            x = self.factor(right)
        step = np.zeros(residual.size)
        step[free] = x
        return step.reshape(residual.shape)

    def _search(self, u: np.ndarray, step: np.ndarray, state, push: Callable):
        norm, share = np.linalg.norm(state[1]), 1.0
        while share > 1e-3:
            trial = self._state(u + share * step, push)
            down = trial[0] <= state[0] + 1e-10 * abs(state[0]) or np.linalg.norm(trial[1]) < 0.5 * norm
            if np.isfinite(trial[0]) and down:
                return u + share * step, trial
            share /= 2
        raise RuntimeError("Newton's method found no step down")

    def release(self) -> None:
        """Give the memory of the factors back."""
        if self.factor is not None:
            self.factor.free()
            self.factor = None
