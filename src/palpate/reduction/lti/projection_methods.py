"""Linear reductions by projection of the sparse equations: modal truncation, condensation and moment matching.

Each computes basis vectors V of displacements and test vectors W, and reduces to W^T M V, W^T D V,
W^T K V. With W = V (Galerkin) a symmetric, positive definite body remains so for any V, and the
reduced body is stable. The collocated stiffness of the strong form is not symmetric, and has no
such guarantee. Its modal truncation uses left eigenvectors as test vectors, which preserves the
poles.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.linalg import ArpackNoConvergence, LinearOperator, eigs, eigsh, splu

from palpate.core.arrays import Floats
from palpate.core.faults import InputError, integer_in_range
from palpate.reduction.lti.state_space import SecondOrder
from palpate.reduction.lti.system import LinearSystem

DEGENERACY_TOLERANCE = 1e-5  # relative distance of squared frequencies that count as equal
EXTRA_MODES = 12  # additional modes in the eigenvalue solver
DEFLATION_TOLERANCE = 1e-10  # relative norm of a vector's new part below which it is linearly dependent


def project(system: LinearSystem, columns: Floats, test: Floats | None = None) -> SecondOrder:
    """Return the system projected on basis vectors V (d, k), with test vectors W (d, k), by default the same."""
    w = columns if test is None else test
    return SecondOrder(
        w.T @ (system.mass @ columns), w.T @ (system.damping @ columns), w.T @ (system.stiffness @ columns),
        w.T @ system.input.toarray(), system.output @ columns, system.rate_output @ columns,
        system.feedthrough, system.fields(columns),
    )  # fmt: skip


def factorise(system: LinearSystem, s: complex = 0.0) -> Any:
    """Return the sparse factors of s^2 M + s D + K, which are real for real s."""
    try:
        return splu(system.stiffness if s == 0 else system.pencil(s.real if s.imag == 0 else s))
    except RuntimeError as error:
        raise InputError(
            "stiffness of the body at rest must be non-singular; fix a group, or give a sheet a prestretch"
        ) from error


def eigenvectors(system: LinearSystem, count: int) -> tuple[NDArray[np.complex128], Floats, Floats]:
    """Return squared frequencies (k,) [1/s^2] of the slowest modes, and real right and left vectors (d, k).

    Real and imaginary parts replace the vectors of a complex pair. The number of modes increases if
    `count` would separate a pair, or degenerate modes of a symmetric body in its strong form.
    """
    integer_in_range("modes", count, 1, system.order - 2)
    solver, order = factorise(system), system.stiffness.shape
    start = np.random.default_rng(0).standard_normal(system.order)
    ask = min(count + EXTRA_MODES, system.order - 2)
    try:
        if system.symmetric:
            inverse = LinearOperator(order, matvec=solver.solve)
            values, vectors = eigsh(system.stiffness, k=ask, M=system.mass, sigma=0.0, OPinv=inverse, v0=start)
            chosen = np.argsort(values)[:count]
            columns = np.ascontiguousarray(vectors[:, chosen])
            return values[chosen].astype(complex), columns, columns
        pairs = []
        for trans in "NT":
            inverse = LinearOperator(order, matvec=lambda x, t=trans: solver.solve(x, t))
            matrix = system.stiffness if trans == "N" else system.stiffness.T.tocsc()
            pairs.append(eigs(matrix, k=ask, M=system.mass, sigma=0.0, OPinv=inverse, v0=start))
    except ArpackNoConvergence as error:
        raise InputError(f"eigenvalue solver did not converge for the slowest {count} modes: {error}") from error
    (values, right), (others, left) = (_by_size(*pair) for pair in pairs)
    sizes = np.abs(values)
    while count < len(sizes) and sizes[count] - sizes[count - 1] < DEGENERACY_TOLERANCE * sizes[count]:
        count += 1  # left and right modes of a separated pair, complex or degenerate, need not match
    columns, tests = _real(values, right, count), _real(others, left, count)
    if columns.shape != tests.shape:
        raise InputError(f"modes must give matching left and right modes, got {count}; use a few more or fewer")
    return values[:count], columns, tests


def _by_size(values: NDArray[np.complex128], vectors: NDArray[np.complex128]) -> tuple[Any, Any]:
    order = np.argsort(np.abs(values))
    return values[order], vectors[:, order]


def _real(values: NDArray[np.complex128], vectors: NDArray[np.complex128], count: int) -> Floats:
    """Return real columns (d, count) with the span of the first eigenvectors and their conjugates."""
    columns = []
    for value, vector in zip(values[:count], vectors[:, :count].T, strict=True):
        if value.imag > 0:
            columns += [vector.real, vector.imag]
        elif value.imag == 0:
            columns.append(vector.real)
    stacked = np.stack(columns, axis=1)
    return np.asarray(stacked / np.linalg.norm(stacked, axis=0))


def modal(system: LinearSystem, modes: int) -> SecondOrder:
    """Return the system projected on the slowest modes, which preserve their poles."""
    _, right, left = eigenvectors(system, modes)
    return _balanced(system, right, left)


def _balanced(system: LinearSystem, right: Floats, left: Floats) -> SecondOrder:
    """Project with test columns for which the reduced mass is 1."""
    return project(system, right, left @ np.linalg.inv((left.T @ (system.mass @ right)).T))


def condense(system: LinearSystem, modes: int) -> SecondOrder:
    """Return the system projected on slow modes and residual static responses to the inputs.

    The modes preserve their poles, and the static responses the transfer function at s = 0. The
    static responses are left out if they make the condensed body of a strong form unstable.
    """
    _, right, left = eigenvectors(system, modes)
    left = left @ np.linalg.inv((left.T @ (system.mass @ right)).T)
    static = factorise(system).solve(system.input.toarray())
    static = static - right @ (left.T @ (system.mass @ static))
    more = _orthonormal(system, static, np.zeros((system.order, 0)))
    other = more if system.symmetric else more - left @ (right.T @ (system.mass @ more))
    reduced = project(system, np.hstack([right, more]), np.hstack([left, other]))
    if not system.symmetric and reduced.poles().real.max() >= 0:
        return project(system, right, left)
    return reduced


def moments(system: LinearSystem, modes: int, points: Sequence[complex] = (0.0,)) -> SecondOrder:
    """Match moments of the transfer function at some points s [1/s], by Krylov spaces.

    With D = alpha M + beta K, s^2 M + s D + K is a multiple of Q + d M, where Q is its value at a point. So
    all moments at the point lie in the Krylov space of Q^-1 M and Q^-1 B (Beattie and Gugercin,
    44th IEEE Conf. Decision and Control, 2005). This requires half as many columns as a
    second-order Arnoldi method. The points take turns, with a block of one column per input, until
    there are `modes` columns. Complex columns are replaced by their real and imaginary parts. The
    projection is one-sided (W = V): a symmetric body stays stable.
    """
    integer_in_range("modes", modes, 1, system.order)
    points = [complex(s) for s in points]
    if not points or any(s.real < 0 for s in points):
        raise InputError(f"points must be one or more numbers with real parts of at least 0, got {points}")
    solvers = [factorise(system, s) for s in points]
    basis, nothing = np.zeros((system.order, 0)), np.zeros((system.order, 0))
    bases = [nothing.astype(complex if s.imag != 0 else float) for s in points]
    fresh = [solver.solve(_typed(system.input.toarray(), s)) for solver, s in zip(solvers, points, strict=True)]
    while basis.shape[1] < modes:
        before = basis.shape[1]
        for at, s in enumerate(points):
            vectors = _orthonormal(system, fresh[at], bases[at])
            bases[at] = np.hstack([bases[at], vectors])
            fresh[at] = solvers[at].solve(_typed(system.mass @ vectors, s)) if vectors.shape[1] else vectors
            parts = np.hstack([vectors.real, vectors.imag]) if s.imag != 0 else vectors
            basis = np.hstack([basis, _orthonormal(system, parts, basis)])
        if basis.shape[1] == before:
            raise InputError(
                f"modes must be at most {before}, the number of independent columns of inputs and points, got {modes}"
            )
    return project(system, np.ascontiguousarray(basis[:, :modes]))


def _typed(block: Any, s: complex) -> Any:
    return block.astype(complex) if s.imag != 0 else np.ascontiguousarray(block.real)


def _orthonormal(system: LinearSystem, block: Any, basis: Any) -> Any:
    """Return the part of vectors (d, b) orthogonal to a basis, orthonormal with respect to the mass."""
    masses, accepted = system.mass.diagonal(), basis[:, :0]
    for column in block.T:
        vector, size = column.copy(), np.sqrt(np.vdot(column, masses * column).real)
        for _ in range(2):  # twice, against rounding errors
            for previous in (basis, accepted):
                vector = vector - previous @ (previous.conj().T @ (masses * vector))
        left = np.sqrt(np.vdot(vector, masses * vector).real)
        if left > DEFLATION_TOLERANCE * size:
            accepted = np.hstack([accepted, (vector / left)[:, None]])
    return accepted
