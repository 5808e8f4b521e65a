"""Frictionless contact of a rigid paraboloid with a bonded layer and with a solid ball, in linear elasticity.

Both use rings of uniform pressure around the axis. The displacement of a layer is that of a half-space
(Johnson, Contact Mechanics, 1985, section 3.4), plus a smooth integral over its kernel (Sneddon, Fourier
Transforms, 1951; Popov, Contact Mechanics and Friction, 2010). That of a ball under equal pressures on both poles is
Lur'e's series (Three-Dimensional Problems of the Theory of Elasticity, 1964).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import nnls
from scipy.special import ellipe, ellipk, eval_legendre, j0, j1

RING_COUNT = 40  # in the circle where an undeformed body would be inside of the tool
LARGEST_WAVE, WAVE_COUNT = 20.0, 4000  # of the layer's kernel, times its thickness, and number of waves
LARGEST_DEGREE = 2000  # of Legendre's polynomials
CONTACT_RIDGE = 1e-9  # of a compliance, relative to its mean diagonal


def signorini(compliance: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """Return the forces (n,) [N] >= 0 of frictionless contact that displace points by at least a depth (n,) [m].

    They minimise f . C f / 2 - f . depth: non-negative least squares with the Cholesky factor of C (n, n) [m/N].
    """
    ridge = CONTACT_RIDGE * np.trace(compliance) / len(depth) * np.eye(len(depth))
    lower = np.linalg.cholesky(0.5 * (compliance + compliance.T) + ridge)
    return nnls(lower.T, np.linalg.solve(lower, depth), maxiter=50 * len(depth))[0]


def hertz_force(radius: float, depth: float, shear_modulus: float, poisson: float) -> float:
    """Return Hertz's force [N] of a paraboloid on a half-space."""
    return 4 / 3 * _contact_modulus(shear_modulus, poisson) * np.sqrt(radius) * depth**1.5


def layer_forces(
    radius: float, depths: Sequence[float], thickness: float, shear_modulus: float, poisson: float
) -> np.ndarray:
    """Return the forces (n,) [N] of a paraboloid with a radius [m] at depths (n,) [m] in a bonded layer."""
    forces = []
    for depth in depths:
        edges = np.linspace(0.0, np.sqrt(2 * radius * depth), RING_COUNT + 1)
        middles = 0.5 * (edges[1:] + edges[:-1])
        compliance = _layer_compliance(edges, middles, thickness, shear_modulus, poisson)
        forces.append(signorini(compliance, depth - middles**2 / (2 * radius)).sum())
    return np.array(forces)


def ball_forces(
    radius: float, depths: Sequence[float], ball_radius: float, shear_modulus: float, poisson: float
) -> np.ndarray:
    """Return the forces (n,) [N] of a paraboloid at each pole of a ball at depths (n,) [m]: sums of radial ones."""
    forces, fine = [], np.linspace(0.0, 0.5 * np.pi, 10000)
    for depth in depths:
        edges = np.linspace(0.0, np.interp(depth, ball_gap(fine, radius, ball_radius), fine), RING_COUNT + 1)
        gap = ball_gap(0.5 * (edges[1:] + edges[:-1]), radius, ball_radius)
        compliance = _ball_compliance(edges, ball_radius, shear_modulus, poisson)
        forces.append(signorini(compliance, depth - gap).sum())
    return np.array(forces)


def ball_gap(angle: np.ndarray, radius: float, ball_radius: float) -> np.ndarray:
    """Return the gaps [m] along the axis at polar angles between a ball and a paraboloid that touches its pole."""
    return ball_radius * (1 - np.cos(angle)) + (ball_radius * np.sin(angle)) ** 2 / (2 * radius)


def ball_compliances(degrees: np.ndarray, ball_radius: float, shear_modulus: float, poisson: float) -> np.ndarray:
    """Return a ball's radial displacements [m/Pa] under pressures of Legendre's polynomials, of degrees 0 or >= 2."""
    n = np.where(degrees == 0, 2.0, degrees)  # the first is replaced below
    ratio = n * (n**2 + 2 * n - 1 + 2 * poisson) / (n - 1)
    displacement = (n + 1) * (n - 2 + 4 * poisson) - ratio
    stress = 2 * shear_modulus * ((n + 1) * (n**2 - n - 2 - 2 * poisson) - (n - 1) * ratio)
    uniform = (1 - 2 * poisson) / (2 * shear_modulus * (1 + poisson))
    return ball_radius * np.where(degrees == 0, uniform, displacement / stress)


def _contact_modulus(shear_modulus: float, poisson: float) -> float:
    """Return E / (1 - nu^2) [Pa]."""
    return 2 * shear_modulus / (1 - poisson)


def _layer_compliance(
    edges: np.ndarray, places: np.ndarray, thickness: float, shear_modulus: float, poisson: float
) -> np.ndarray:
    """Return displacements (m, n) [m/N] at distances (m,) under unit forces on the rings between edges (n + 1,)."""
    modulus, kappa = _contact_modulus(shear_modulus, poisson), 3 - 4 * poisson
    wave = (np.arange(WAVE_COUNT) + 0.5) * LARGEST_WAVE / WAVE_COUNT
    kernel = (2 * kappa * np.sinh(2 * wave) - 4 * wave) / (
        2 * kappa * np.cosh(2 * wave) + 4 * wave**2 + 1 + kappa**2
    ) - 1
    k = wave / thickness
    discs = edges * j1(k[:, None] * edges) / k[:, None]
    smooth = (j0(places[:, None] * k) * kernel) @ np.diff(discs, axis=1) * (LARGEST_WAVE / WAVE_COUNT / thickness)
    whole = np.diff(np.stack([_disc_displacement(places, edge) for edge in edges], axis=1), axis=1)
    return 2 / modulus * (smooth + whole) / (np.pi * np.diff(edges**2))


def _disc_displacement(places: np.ndarray, edge: float) -> np.ndarray:
    """Return displacements [m] of a half-space under a unit pressure on a disc, times half of its contact modulus."""
    if edge == 0:
        return np.zeros(len(places))
    inside, outside = np.minimum(places / edge, 1.0) ** 2, np.minimum(edge / places, 1.0) ** 2
    beyond = places * (ellipe(outside) - (1 - outside) * ellipk(np.minimum(outside, 1 - 1e-15)))
    return 2 / np.pi * np.where(places < edge, edge * ellipe(inside), beyond)


def _ball_compliance(edges: np.ndarray, ball_radius: float, shear_modulus: float, poisson: float) -> np.ndarray:
    """Return mean displacements (n, n) [m/N] of the rings between angles (n + 1,) under unit forces on both poles."""
    degrees = np.arange(0, LARGEST_DEGREE, 2)
    cosine = np.cos(edges)[:, None]
    above = eval_legendre(degrees + 1, cosine)
    below = np.where(degrees == 0, 1.0, eval_legendre(np.maximum(degrees - 1, 0), cosine))
    integrals = -np.diff((above - below) / (2 * degrees + 1), axis=0)  # of the polynomials over the cosine
    areas = -2 * np.pi * ball_radius**2 * np.diff(np.cos(edges))
    factors = (2 * degrees + 1) * ball_compliances(degrees, ball_radius, shear_modulus, poisson)
    return 2 * np.pi * ball_radius**2 * (integrals * factors) @ integrals.T / (areas[:, None] * areas)
