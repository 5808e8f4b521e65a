"""The membranes of axisymmetric.py as minima of their energy among quadratic finite elements along the meridian.

Nothing but the law of the material, an argument, is shared with the differential equations there.
"""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array, diags_array
from scipy.sparse.linalg import splu

GAUSS, WEIGHTS = np.polynomial.legendre.leggauss(4)


def minimise(R, H, law, elements, depth=None, tool_radius=0.0, pressure=0.0, prestretch=1.0, tolerance=1e-10):
    """Energy minimum among quadratic finite elements; without tool if `depth` is None, others as in `axisymmetric`.

    Returns
    -------
    dict
        ``force`` [N] (the tool's, from the nodal forces), ``height``, ``mean_deflection`` [m], ``energy`` [J] and the
        nodal ``mounted``, ``r`` and ``z`` [m].
    """
    rim, tool = R / prestretch, tool_radius / prestretch
    edges = np.linspace(0, rim, elements + 1) if depth is None else np.geomspace(tool, rim, elements + 1)
    S = np.sort(np.concatenate([edges, (edges[1:] + edges[:-1]) / 2]))
    free = np.ones((len(S), 2), bool)
    free[-1] = False
    free[0] = [False, depth is None]
    start = 0.6 * R * (pressure * R / (6 * (law.a + law.b) * H)) ** (1 / 3) if depth is None else depth
    power = 2 if depth is None else 2 / 3 if prestretch >= 1 else 1  # a loose sheet is taut all along a cone
    fall = (S**power - S[0] ** power) / (rim**power - S[0] ** power)
    bulge = max(0.0, 1.1 - prestretch) if depth is None else 0.0  # a loose sheet's centre starts taut
    q = np.stack([S * (prestretch + bulge * (1 - fall)), start * (1 - fall)], axis=1)
    held = np.flatnonzero(free)
    noise = 1e-15 * np.pi * rim**2 * H * 2 * (law.a + law.b)  # of the energy, by rounding
    value, gradient, stiffness = _assemble(S, q, law, H, pressure)
    for _ in range(100):
        step = np.zeros(q.size)
        step[held] = _descent(stiffness[held][:, held], gradient[held])
        size, gain = 1.0, -gradient @ step
        while True:
            trial = q + size * step.reshape(q.shape)
            found = _assemble(S, trial, law, H, pressure)
            if gain < noise or found[0] <= value - 1e-4 * size * gain + noise:
                break
            size /= 2
        q, (value, gradient, stiffness) = trial, found
        if np.abs(step).max() < tolerance * np.abs(q).max():
            return _discrete_summary(S, q, law, H, pressure, prestretch, float(gradient[1]))
    raise RuntimeError("Newton's method did not converge")


def _descent(stiffness, gradient):
    """Newton's step, made a descent by a multiple of the diagonal where the stiffness is not definite enough."""
    diagonal = np.abs(stiffness.diagonal())
    diagonal += 1e-3 * diagonal.mean()  # slack places have no stiffness
    for shift in (0.0, 1e-3, 1e-2, 1e-1, 1.0, 10.0):
        try:
            step = -splu((stiffness + shift * diags_array(diagonal)).tocsc()).solve(gradient)
        except RuntimeError:  # exactly singular
            continue
        if step @ gradient <= 0:
            return step
    raise RuntimeError("no direction lowers the energy")


def _at_points(S, q):
    """Of each element: weights, places S, shape functions' values and slopes, and r, r', z' at its Gauss points."""
    ends = S[::2]
    half = np.diff(ends)[:, None] / 2
    g = GAUSS
    N = np.stack([g * (g - 1) / 2, 1 - g * g, g * (g + 1) / 2], axis=1)
    dN = np.stack([g - 0.5, -2 * g, g + 0.5], axis=1) / half[:, :, None]
    nodes = 2 * np.arange(len(half))[:, None] + np.arange(3)
    r, z = q[nodes, 0], q[nodes, 1]
    at = np.einsum("gi,ei->eg", N, r), np.einsum("egi,ei->eg", dN, r), np.einsum("egi,ei->eg", dN, z)
    return half * WEIGHTS, S[nodes] @ N.T, N, dN, nodes, at


def _assemble(S, q, law, H, pressure):
    """Potential energy [J] of the sheet outside the tool, its gradient [N] and its second derivatives [N/m]."""
    weights, X, N, dN, nodes, (r, dr, dz) = _at_points(S, q)
    l1, l2 = np.hypot(dr, dz), r / X
    c, s = dr / l1, dz / l1
    w1, w2, w11, w12, w22 = law.derivatives(l1, l2)
    load = np.pi * pressure
    density = 2 * np.pi * H * X * law.energy(l1, l2) + load * r**2 * dz  # the volume is the integral of -pi r^2 z'
    k, bend = 2 * np.pi * H, w1 / l1
    first = [k * X * w1 * c, k * X * w1 * s + load * r**2, k * w2 + 2 * load * r * dz]
    rz, rr, zr = k * X * (w11 - bend) * c * s, k * w12 * c, k * w12 * s + 2 * load * r
    second = [
        [k * X * (w11 * c * c + bend * s * s), rz, rr],
        [rz, k * X * (w11 * s * s + bend * c * c), zr],
        [rr, zr, k * w22 / X + 2 * load * dz],
    ]
    B = np.zeros((*X.shape, 3, 6))  # (r', z', r) from (r1, z1, r2, z2, r3, z3)
    B[..., 0, 0::2], B[..., 1, 1::2], B[..., 2, 0::2] = dN, dN, N
    forces = np.einsum("eg,keg,egki->ei", weights, np.array(first), B)
    blocks = np.einsum("eg,kleg,egki,eglj->eij", weights, np.array(second), B, B, optimize=True)
    unknowns = (2 * nodes[:, :, None] + np.arange(2)).reshape(-1, 6)
    gradient = np.bincount(unknowns.ravel(), forces.ravel(), q.size)
    at = np.repeat(unknowns, 6, axis=1).ravel(), np.tile(unknowns, 6).ravel()
    value = float(np.sum(weights * density)) if r.min() > 0 else np.inf  # no sheet passes through the axis
    return value, gradient, coo_array((blocks.ravel(), at), (q.size, q.size)).tocsr()


def _discrete_summary(S, q, law, H, pressure, prestretch, force):
    weights, X, N, _, nodes, (r, dr, dz) = _at_points(S, q)
    z, disc = q[nodes, 1] @ N.T, np.pi * S[0] ** 2
    strain = np.sum(weights * 2 * np.pi * X * law.energy(np.hypot(dr, dz), r / X))
    return {
        "force": 0.0 if pressure else force,
        "height": float(q[0, 1]),
        "mean_deflection": float((2 * np.pi * np.sum(weights * X * z) + disc * q[0, 1]) / (np.pi * S[-1] ** 2)),
        "energy": float(H * (strain + disc * law.energy(prestretch, prestretch))),
        "mounted": prestretch * S,
        "r": q[:, 0],
        "z": q[:, 1],
    }
