"""Proper orthogonal decomposition of snapshots (section 4, equations 22 to 28).

The Hilbert space of the paper is the L2 of the body: (u, v) = sum over the nodes of V_I u_I . v_I, with
the nodal volumes V_I (`Solid.weights`). Without the volumes the reduced model is unstable.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.linalg

from palpate.core.arrays import Floats
from palpate.core.describe import Described, Fact
from palpate.core.faults import InputError, integer_in_range, number_in_range
from palpate.core.plotting import curve_svg, plot_singular_values
from palpate.reduction.basis.incremental_pod import allowance, block_size, decompose
from palpate.reduction.basis.snapshots import Run, Snapshots

NUMERICAL_RANK = 1e-12  # of the largest singular value, below which directions are rounding noise


@dataclass(frozen=True)
class Basis(Described):
    """Modes that are orthonormal in the nodal-volume inner product.

    Parameters
    ----------
    modes : (M, n, 3) array [m^-3/2]
        The phi_k of (24); their columns form Q of (28).
    singular_values : (r,) array [m^5/2]
        Of the snapshots, in descending order. Squared and divided by the number L of snapshots they are
        the eigenvalues lambda_j of (25). Values dropped in a decomposition block by block are not
        included.
    snapshots : int
        Number L of snapshots.
    weights : (n,) array [m^3]
        Of the inner product: nodal volumes.
    dropped : float [m^5]
        Sum of the squares of the singular values that are not included.

    Examples
    --------
    >>> import numpy as np
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> pull = pt.SurfaceForce("x+", force=lambda t: (20 * t, 0, 0))
    >>> full = pt.rollout(bar, [pull], duration=0.03, every=0.001)
    >>> basis = pt.pod(full, bar.weights, tolerance=0.01)
    >>> coordinates = basis.project(full.displacements)
    >>> coordinates.shape == (31, len(basis))
    True
    >>> difference = np.linalg.norm(basis.lift(coordinates) - full.displacements)
    >>> bool(difference < 0.05 * np.linalg.norm(full.displacements))
    True
    """

    modes: Floats
    singular_values: Floats
    snapshots: int
    weights: Floats
    dropped: float = 0.0

    def __len__(self) -> int:
        return len(self.modes)

    def _facts(self) -> list[Fact]:
        return [
            ("modes", len(self), ""),
            ("nodes", self.modes.shape[1], ""),
            ("snapshots", self.snapshots, ""),
            ("energy not held", 100 * self.lost_energy, "%"),
            ("largest singular value", float(self.singular_values[0]), "m^5/2"),
            ("smallest of the modes", float(self.singular_values[: len(self)][-1]), "m^5/2"),
        ]

    def _picture(self) -> str:
        relative = self.singular_values[self.singular_values > 0] / self.singular_values[0]
        numbers = np.arange(1.0, len(relative) + 1)
        return curve_svg(numbers, relative, "mode", "singular value over the first", logarithmic=True)

    def plot(self, axes: Any = None) -> Any:
        """Plot the singular values of the snapshots over the first one, those of the modes filled.

        Parameters
        ----------
        axes : matplotlib.axes.Axes, optional
            New ones by default.

        Returns
        -------
        matplotlib.axes.Axes

        Raises
        ------
        ImportError
            matplotlib is not installed.
        """
        return plot_singular_values(self.singular_values, len(self), axes)

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
        return replace(self, modes=self.modes[:modes])

    @property
    def lost_energy(self) -> float:
        """Share of the snapshots' squared norm outside the modes: the sum in (27) over the total."""
        squares = self.singular_values**2
        return float((squares[len(self) :].sum() + self.dropped) / (squares.sum() + self.dropped))


def pod(
    snapshots: Floats | Run | Sequence[Run],
    weights: Floats,
    *,
    modes: int | None = None,
    tolerance: float | None = None,
) -> Basis:
    """Return the modes with the least projection error for displacement snapshots.

    Parameters
    ----------
    snapshots : (L, n, 3) array [m], a trajectory or the path of its file, or several
        If they exceed a block of memory, they are decomposed block by block
        (`palpate.reduction.basis.incremental_pod`).
    weights : (n,) array [m^3]
        Of the inner product: nodal volumes, or `Solid.weights`.
    modes : int, optional
        Number of modes M.
    tolerance : float, optional
        Alternative to `modes`: the least number of modes whose relative root-mean-square projection error
        is at most this.

    Raises
    ------
    InputError
        More modes than independent snapshots, snapshots that are all zero or not finite, or neither or
        both of `modes` and `tolerance`.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> pull = pt.SurfaceForce("x+", force=lambda t: (20 * t, 0, 0))
    >>> full = pt.rollout(bar, [pull], duration=0.03, every=0.001)
    >>> basis = pt.pod(full, bar.weights, modes=4)
    >>> basis.modes.shape, basis.lost_energy < 1e-4
    ((4, 112, 3), True)
    """
    if (modes is None) == (tolerance is None):
        raise InputError("modes or tolerance must be given, but not both; leave one of them out")
    if isinstance(snapshots, np.ndarray) and (snapshots.ndim != 3 or snapshots.shape[1:] != (len(weights), 3)):
        raise InputError(
            f"snapshots must have shape (L, {len(weights)}, 3), got {snapshots.shape}; use those of this body"
        )
    frames = Snapshots(snapshots)
    if frames.nodes != len(weights):
        raise InputError(f"snapshots must have {len(weights)} nodes, got {frames.nodes}; use those of this body")
    roots = np.repeat(np.sqrt(weights), 3)
    shapes, values, dropped = _decompose(frames, roots, modes or 0)
    rank = int(np.sum(values > NUMERICAL_RANK * values[0])) if values[0] > 0 else 0
    if rank == 0:
        raise InputError("snapshots must be non-zero, got zeros in all; train on a run with loads")
    if modes is None:
        squares = np.cumsum(values[::-1] ** 2)[::-1] + dropped  # squares[m]: squared error with m modes
        bound = number_in_range("tolerance", tolerance or 0.0, 0.0, 1.0, open_low=True) ** 2 * squares[0]
        modes = max(1, int(np.sum(squares > bound)))
    integer_in_range("modes", modes, 1)
    if modes > rank:
        raise InputError(
            f"modes must be at most {rank}, the independent shapes of {len(frames)} snapshots, got {modes}; "
            "use more runs"
        )
    rows = shapes(modes) / roots
    return Basis(rows.reshape(modes, -1, 3), values, len(frames), np.asarray(weights, dtype=float), dropped)


def _decompose(frames: Snapshots, roots: Floats, least: int) -> tuple[Callable[[int], Floats], Floats, float]:
    """Return modes, singular values, and the sum of squares dropped.

    The first is a function of the number of modes; it returns rows times the roots.
    """
    size = block_size(frames.nodes)
    if len(frames) <= size:
        left, values = _thin_svd(next(frames.blocks(size)).reshape(len(frames), -1) * roots)
        return lambda count: left[:count], values, 0.0
    weights = (roots**2).reshape(-1, 3)
    squares = sum(float(np.einsum("bnc,bnc,nc->", block, block, weights)) for block in frames.blocks(size))
    decomposition = decompose(frames.blocks(size), lambda u: u * weights, allowance(squares, len(frames), size), least)

    def shapes(count: int) -> Floats:
        # orthonormalise: products resolve the span better than small directions
        q, r = np.linalg.qr((decomposition.shapes(count).reshape(count, -1) * roots).T)
        return np.asarray((q * np.sign(np.diag(r))).T)

    return shapes, decomposition.values, decomposition.dropped


def _thin_svd(rows: Floats) -> tuple[Floats, Floats]:
    """Return right singular vectors (as rows) and singular values of a wide matrix, which is overwritten.

    A QR decomposition of the transpose precedes the SVD of its small factor. This is as accurate as a
    direct SVD, unlike the eigenvalues of the Gram matrix, and needs one additional copy of the snapshots.
    """
    if rows.shape[0] > rows.shape[1]:
        _, values, right = np.linalg.svd(rows, full_matrices=False)
        return right, values
    q, r = scipy.linalg.qr(rows.T, mode="economic", overwrite_a=True, check_finite=False)
    u, values, _ = np.linalg.svd(r)
    return (q @ u).T, values
