"""Reduced linear systems of second or first order, and their displacement fields.

The reduced displacements are u = sum_k c_k Phi_k + L g, with the known coordinates g of the tools.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.linalg

from palpate.core.arrays import Complex, Floats
from palpate.core.describe import Described


@dataclass(frozen=True)
class SecondOrder(Described):
    """Second-order system M c'' + D c' + K c = B f, y = Cp c + Cv c' + Df f.

    Parameters
    ----------
    mass, damping, stiffness : (k, k) arrays
    input, output, rate_output, feedthrough : (k, p), (q, k), (q, k), (q, p) arrays
    fields : (k, n, 3) array

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> pull = pt.SurfaceForce("x+", force=lambda t: (20 * t, 0, 0))
    >>> system = pt.lti.linearise(bar, [pull], outputs=["x+"])
    >>> reduced = pt.lti.reduce_linear(system, "modal", 6).reduced
    >>> type(reduced).__name__, reduced.stiffness.shape
    ('SecondOrder', (6, 6))
    """

    mass: Floats
    damping: Floats
    stiffness: Floats
    input: Floats
    output: Floats
    rate_output: Floats
    feedthrough: Floats
    fields: Floats

    @property
    def states(self) -> int:
        """Number of first-order equations."""
        return 2 * len(self.mass)

    def state_space(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Return A, B, C, D of x' = A x + B f, y = C x + D f with x = (c, c')."""
        k = len(self.mass)
        solved = np.linalg.solve(self.mass, np.hstack([-self.stiffness, -self.damping, self.input]))
        lower = np.hstack([np.zeros((k, k)), np.eye(k)])
        a = np.vstack([lower, solved[:, : 2 * k]])
        b = np.vstack([np.zeros_like(self.input), solved[:, 2 * k :]])
        return a, b, np.hstack([self.output, self.rate_output]), self.feedthrough

    def transfer(self, points: Any) -> Complex:
        """Return the transfer function at complex frequencies s (t,) [1/s], shape (t, q, p)."""
        result = []
        for s in np.atleast_1d(np.asarray(points, dtype=complex)):
            solved = np.linalg.solve(s * s * self.mass + s * self.damping + self.stiffness, self.input.astype(complex))
            result.append((self.output + s * self.rate_output) @ solved + self.feedthrough)
        return np.array(result)

    def packed(self, coordinates: Floats, velocities: Floats) -> Floats:
        """Return the state x (2 k,) of the first-order equations."""
        return np.concatenate([coordinates, velocities])

    def rates(self, states: Floats, inputs: Floats) -> Floats:
        """Return c' (t, k) of states (t, 2 k)."""
        return states[:, len(self.mass) :]

    def accelerations(self, coordinates: Floats, velocities: Floats, inputs: Floats, slopes: Floats) -> Floats:
        """Return c'' (k,) of a motion under inputs (p,)."""
        a, b, _, _ = self.state_space()
        return np.asarray((a @ self.packed(coordinates, velocities) + b @ inputs)[len(self.mass) :])

    def poles(self) -> Complex:
        """Return the poles (2 k,) [1/s]."""
        return np.asarray(np.linalg.eigvals(self.state_space()[0]), dtype=complex)


@dataclass(frozen=True)
class FirstOrder(Described):
    """First-order system c' = A c + B f, y = C c + D f.

    Parameters
    ----------
    state, input, output, feedthrough : (k, k), (k, p), (q, k), (q, p) arrays
    fields : (k, n, 3) array

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> pull = pt.SurfaceForce("x+", force=lambda t: (20 * t, 0, 0))
    >>> system = pt.lti.linearise(bar, [pull], outputs=["x+"])
    >>> from pymor.reductors.bt import BTReductor
    >>> condensed = pt.lti.reduce_linear(system, "condensed", 40)
    >>> reductor = BTReductor(pt.lti.to_pymor(condensed).to_lti())
    >>> reduced = pt.lti.from_pymor(reductor.reduce(4), condensed, reductor).reduced
    >>> type(reduced).__name__, reduced.states
    ('FirstOrder', 4)
    """

    state: Floats
    input: Floats
    output: Floats
    feedthrough: Floats
    fields: Floats

    @property
    def states(self) -> int:
        """Number of first-order equations."""
        return len(self.state)

    def state_space(self) -> tuple[Floats, Floats, Floats, Floats]:
        """Return A, B, C, D."""
        return self.state, self.input, self.output, self.feedthrough

    def transfer(self, points: Any) -> Complex:
        """Return the transfer function at complex frequencies s (t,) [1/s], shape (t, q, p)."""
        eye, result = np.eye(len(self.state)), []
        for s in np.atleast_1d(np.asarray(points, dtype=complex)):
            result.append(self.output @ np.linalg.solve(s * eye - self.state, self.input) + self.feedthrough)
        return np.array(result)

    def packed(self, coordinates: Floats, velocities: Floats) -> Floats:
        """Return the state (k,)."""
        return coordinates.copy()

    def rates(self, states: Floats, inputs: Floats) -> Floats:
        """Return c' (t, k) of states (t, k) under the first inputs, without impulses of tools."""
        return np.asarray(states @ self.state.T + inputs @ self.input[:, : inputs.shape[1]].T)

    def accelerations(self, coordinates: Floats, velocities: Floats, inputs: Floats, slopes: Floats) -> Floats:
        """Return c'' (k,) of a motion under inputs (p,) with some slopes."""
        return np.asarray(self.state @ velocities + self.input @ slopes)

    def poles(self) -> Complex:
        """Return the poles (k,) [1/s]."""
        return np.asarray(np.linalg.eigvals(self.state), dtype=complex)


Reduced = SecondOrder | FirstOrder


def first_order_hold(a: Floats, b: Floats, step: float) -> tuple[Floats, Floats, Floats]:
    """Return E, G0, G1 of the exact step x1 = E x0 + G0 f0 + G1 f1 for inputs that are linear from f0 to f1.

    They follow from the exponential of one matrix (Van Loan, IEEE Trans. Autom. Control 23, 1978).
    """
    n, p = b.shape
    block_matrix = np.zeros((n + 2 * p, n + 2 * p))
    block_matrix[:n, :n], block_matrix[:n, n : n + p] = step * a, step * b
    block_matrix[n : n + p, n + p :] = np.eye(p)
    moved = scipy.linalg.expm(block_matrix)
    ramp = moved[:n, n + p :]
    return moved[:n, :n], moved[:n, n : n + p] - ramp, ramp
