"""Proper orthogonal decomposition of snapshots (section 4, equations 22 to 28).

The Hilbert space of the paper is the L2 of the body: (u, v) = sum over the nodes of V_I u_I . v_I, with the nodal
volumes V_I (`FullModel.weights`). The inner product decides: without the volumes the reduced model is unstable.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from palpate.dynamics.trajectory import Trajectory
from palpate.faults import InputError, integer_in_range, number_in_range

__all__ = ["Basis", "pod"]

Floats = NDArray[np.float64]

NUMERICAL_RANK = 1e-12  # of the largest singular value; below it directions are rounding noise


@dataclass(frozen=True)
class Basis:
    """Modes that are orthonormal in the nodal-volume inner product.

    Parameters
    ----------
    modes : (M, n, 3) array [m^-3/2]
        The phi_k of (24); their columns form Q of (28).
    singular_values : (r,) array [m^5/2]
        All of the snapshots, in descending order; squared and divided by their number L they are the eigenvalues
        lambda_j of (25).
    snapshots : int
        Number L of snapshots.
    weights : (n,) array [m^3]
        Of the inner product: nodal volumes.
    """

    modes: Floats
    singular_values: Floats
    snapshots: int
    weights: Floats

    def __len__(self) -> int:
        return len(self.modes)

    def project(self, fields: Floats) -> Floats:
        """Return the coordinates (..., M) of nodal fields (..., n, 3)."""
        weighted = (fields * self.weights[:, None]).reshape(*fields.shape[:-2], -1)
        return weighted @ self.modes.reshape(len(self), -1).T

    def lift(self, coordinates: Floats) -> Floats:
        """Return the nodal fields (..., n, 3) of coordinates (..., M) (equation 24)."""
        flat = coordinates @ self.modes.reshape(len(self), -1)
        return np.asarray(flat.reshape(*coordinates.shape[:-1], -1, 3))

    def truncated(self, modes: int) -> Basis:
        """Return the basis of the first few modes."""
        integer_in_range("modes", modes, 1, len(self))
        return Basis(self.modes[:modes], self.singular_values, self.snapshots, self.weights)

    @property
    def lost_energy(self) -> float:
        """Share of the snapshots' squared norm that the modes do not hold: the sum in (27) over the whole."""
        squares = self.singular_values**2
        return float(squares[len(self) :].sum() / squares.sum())


def pod(
    snapshots: Floats | Trajectory | Sequence[Trajectory],
    weights: Floats,
    *,
    modes: int | None = None,
    tolerance: float | None = None,
) -> Basis:
    """Find the modes that hold most of some displacement snapshots.

    Parameters
    ----------
    snapshots : (L, n, 3) array [m], a trajectory, or several
    weights : (n,) array [m^3]
        Of the inner product: nodal volumes, or `FullModel.weights`.
    modes : int, optional
        Number of modes M.
    tolerance : float, optional
        Instead: the fewest modes whose root-mean-square projection error is at most this share of the snapshots'.

    Raises
    ------
    InputError
        More modes than independent snapshots, snapshots that are all zero or not finite, or not one choice of size.
    """
    if (modes is None) == (tolerance is None):
        raise InputError("give either modes or tolerance")
    if isinstance(snapshots, Trajectory):
        snapshots = [snapshots]
    fields = snapshots if isinstance(snapshots, np.ndarray) else np.concatenate([t.displacements for t in snapshots])
    if fields.ndim != 3 or fields.shape[1:] != (len(weights), 3):
        raise InputError(f"snapshots have shape {fields.shape}; this body needs (L, {len(weights)}, 3)")
    if not np.isfinite(fields).all():
        raise InputError("snapshots are not finite")
    roots = np.repeat(np.sqrt(weights), 3)
    left, values = _thin_svd(fields.reshape(len(fields), -1) * roots)
    rank = int(np.sum(values > NUMERICAL_RANK * values[0])) if values[0] > 0 else 0
    if rank == 0:
        raise InputError("all snapshots are zero: there is nothing to find modes in")
    if modes is None:
        squares = np.cumsum(values[::-1] ** 2)[::-1]  # squares[m] is what m modes leave
        bound = number_in_range("tolerance", tolerance or 0.0, 0.0, 1.0, open_low=True) ** 2 * squares[0]
        modes = max(1, int(np.sum(squares > bound)))
    integer_in_range("modes", modes, 1)
    if modes > rank:
        raise InputError(f"modes = {modes}: the {len(fields)} snapshots hold only {rank} independent shapes")
    shapes = left[:modes] / roots
    return Basis(shapes.reshape(modes, -1, 3), values, len(fields), np.asarray(weights, dtype=float))


def _thin_svd(rows: Floats) -> tuple[Floats, Floats]:
    """Right singular vectors (as rows) and singular values of a wide matrix, which is overwritten.

    By a QR decomposition of the tall transpose and the SVD of its small factor: as accurate as a direct SVD, unlike
    the eigenvalues of the Gram matrix, and with one copy of the snapshots beside them.
    """
    if rows.shape[0] > rows.shape[1]:
        _, values, right = np.linalg.svd(rows, full_matrices=False)
        return right, values
    q, r = scipy.linalg.qr(rows.T, mode="economic", overwrite_a=True, check_finite=False)
    u, values, _ = np.linalg.svd(r)
    return (q @ u).T, values
