"""Lyapunov equations of pyMOR's models, solved by a dense method or, for large bodies, in low rank.

From 1,000 equations on, pyMOR uses its alternating-direction iteration by default. It converges
slowly for lightly damped bodies, because every resonance requires a shift of its own. So the
residual of its result is checked.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import scipy.sparse as sparse

from palpate.arrays import Floats
from palpate.faults import InputError
from palpate.reduction.lti.budget import Budget, sparse_lyapunov
from palpate.reduction.lti.state_space import FirstOrder
from palpate.reduction.lti.system import LinearSystem

__all__ = ["balance_in_low_rank", "dense_solver", "residual"]


MAX_ITERATIONS, ITERATION_TOLERANCE = 400, 1e-8  # of the iteration
MAX_RESIDUAL = 2e-2  # largest residual of a solution, relative to the right-hand side
RESIDUAL_PROBES = 4
LOW_RANK_REMEDY = "balance the body condensed to its slowest modes instead: method 'balanced'"


def dense_solver() -> Any:
    """Return a dense `LyapunovSolverLR`; callers check order and cost before."""
    from pymor.bindings.scipy import ScipyLyapunovSolverLR

    return ScipyLyapunovSolverLR()


def balance_in_low_rank(
    system: LinearSystem,
    modes: int,
    scales: tuple[Floats, Floats],
    budget: Budget,
    timed: Callable[[str, Callable[[], Any]], Any],
) -> FirstOrder:
    """Balance the whole, sparse body by pyMOR's low-rank solver.

    Parameters
    ----------
    system : LinearSystem
    modes : int
        Half the number of states.
    scales : (q,) and (p,) arrays
        Factors of outputs and inputs.
    budget : Budget
    timed : function
        Calls a named function, and returns its result.

    Raises
    ------
    InputError
        The cost exceeds the budget, or the iteration did not converge.
    """
    from pymor.models.iosys import SecondOrderModel
    from pymor.reductors.bt import BTReductor
    from pymor.solvers.matrix_equations.adi import ADILyapunovSolver
    from pymor.solvers.matrix_equations.default import MatrixEquationSolvers

    budget.check(sparse_lyapunov(system), "low-rank Lyapunov equations of this body", LOW_RANK_REMEDY)
    outputs, inputs = scales
    b = system.input.toarray() * inputs
    cp, cv = outputs[:, None] * system.output.toarray(), outputs[:, None] * system.rate_output.toarray()
    solver = ADILyapunovSolver(adi_tol=ITERATION_TOLERANCE, adi_maxiter=MAX_ITERATIONS)
    lti = SecondOrderModel.from_matrices(
        system.mass, system.damping, system.stiffness, b, cp, cv,
        matrix_equation_solvers=MatrixEquationSolvers(lyapunov_lr=solver), name="palpate",
    ).to_lti()  # fmt: skip
    factors = timed("low-rank", lambda: [_stacked(lti.gramian(kind)) for kind in ("c_lr", "o_lr")])
    a, e = first_order(system)
    b0, c0 = np.vstack([np.zeros_like(b), b]), np.hstack([cp, cv])
    missed = max(residual(a, e, b0, factors[0]), residual(a.T, e.T, c0.T, factors[1]))
    if not missed < MAX_RESIDUAL:
        raise InputError(
            f"residual of the low-rank Lyapunov solver must be below {MAX_RESIDUAL:g}, got {missed:.2g} after "
            f"{MAX_ITERATIONS} steps: the body is too lightly damped for it; {LOW_RANK_REMEDY}"
        )
    if 2 * modes > min(factor.shape[1] for factor in factors):
        raise InputError(f"modes must be at most half the number of columns of the Gramians, got {modes}")
    reductor = BTReductor(lti)
    a, b, c, _, e = reductor.reduce(2 * modes).to_matrices()
    if e is not None:
        a, b = np.linalg.solve(e, a), np.linalg.solve(e, b)
    fields = system.fields(np.asarray(reductor.V.blocks[0].to_numpy()))
    return FirstOrder(a, b / inputs, c / outputs[:, None], system.feedthrough, fields)


def first_order(system: LinearSystem) -> tuple[Any, Any]:
    """Return sparse A and E of E x' = A x + B f with x = (u, u')."""
    eye = sparse.identity(system.order)
    return (
        sparse.bmat([[None, eye], [-system.stiffness, -system.damping]]).tocsr(),
        sparse.block_diag([eye, system.mass]).tocsr(),
    )


def _stacked(vectors: Any) -> Floats:
    return np.vstack([np.asarray(block.to_numpy()) for block in vectors.blocks])


def residual(a: Any, e: Any, b: Floats, factor: Floats) -> float:
    """Return the norm of A Z Z^T E^T + E Z Z^T A^T + B B^T relative to B B^T, estimated with random vectors."""
    probes = np.random.default_rng(0).standard_normal((len(b), RESIDUAL_PROBES))
    source = b @ (b.T @ probes)
    left = a @ (factor @ (factor.T @ (e.T @ probes))) + e @ (factor @ (factor.T @ (a.T @ probes))) + source
    return float(np.linalg.norm(left) / np.linalg.norm(source))
