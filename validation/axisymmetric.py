"""Circular membranes of incompressible rubber, poked by a disc or inflated: two independent static solutions.

    python validation/axisymmetric.py

writes docs/validation/axisymmetric.json and prints it. Nothing of palpate is used.

A stress-free flat disc of radius R / prestretch and thickness H is stretched evenly to the radius R and its rim held.
With the meridional stretch l1, the hoop stretch l2 = r / S and the energy w(l1, l2) of plane stress, the shape r(S),
z(S) makes 2 pi H int w S dS - pressure x volume stationary (Adkins and Rivlin 1952; Green and Adkins 1960, ch. 4):

    (S T1 cos(angle))' = T2 + pressure r z' / H,   (S T1 sin(angle))' = pressure r r' / H,

with the nominal stresses T1 = dw/dl1 and T2 = dw/dl2, r' = l1 cos(angle) and z' = -l1 sin(angle). `poke` and
`inflate` solve this boundary-value problem; `minimise` finds the same shapes as minima of the energy among quadratic
finite elements. With ``tension_field`` the energy is relaxed (Pipkin 1986): a sheet narrower than its natural width
l1^(-1/2) wrinkles and bears no hoop stress. T1 > 0 follows from vertical equilibrium, so that no other wrinkles arise.
Slopes should exceed 1e-3: at smaller ones the strains drown in rounding.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
from scipy.integrate import quad, solve_bvp
from scipy.interpolate import CubicHermiteSpline
from scipy.optimize import brentq, minimize_scalar
from scipy.sparse import coo_array, diags_array
from scipy.sparse.linalg import splu

OUTPUT = Path(__file__).parents[1] / "docs" / "validation" / "axisymmetric.json"
RADIUS, THICKNESS, C1, DEPTH = 0.1, 1e-5, 0.17e6, 0.01  # the paper's membrane, and how far it is poked [m, m, Pa, m]
ELEMENTS, PLACES = 400, np.array([0.02, 0.05, 0.075])  # [-, m]
ABOUT = (
    "SI units. Membrane of radius 0.1 m, stress-free thickness 1e-5 m, W = C1 (I1 - 3) with C1 = 0.17e6 Pa. poke: by "
    "10 mm; energy: of the whole sheet, mounted_energy of it by prestretch alone; deflection: of what was mounted at "
    "0.02, 0.05 and 0.075 m from the axis, deflection_in_place of what is there now; elements_difference: largest "
    "relative difference of force, height, mean deflection and energy from 400 finite elements; work_difference: of "
    "the energy's slope from the force. small_strain: relative differences of forces and heights from closed forms."
)
GAUSS, WEIGHTS = np.polynomial.legendre.leggauss(4)


@dataclass(frozen=True)
class Law:
    """Incompressible W = a (I1 - 3) + b (I2 - 3) in plane stress, as a function of the principal stretches.

    Parameters
    ----------
    a, b : float
        Coefficients [Pa]; the shear modulus is 2 (a + b).
    tension_field : bool
        Relax the energy: no compression is borne.
    """

    a: float
    b: float = 0.0
    tension_field: bool = False

    def energy(self, l1, l2):
        """Energy [J/m^3] per stress-free volume."""
        l1, l2, _, _ = self._widened(l1, l2)
        m, n = l1**-2, l2**-2
        return self.a * (l1**2 + l2**2 + m * n - 3) + self.b * (l1**2 * l2**2 + m + n - 3)

    def derivatives(self, l1, l2):
        """Nominal stresses w_1, w_2 and moduli w_11, w_12, w_22 [Pa]."""
        l1, l2, narrow, short = self._widened(l1, l2)
        a, b, m, n = 2 * self.a, 2 * self.b, l1**-2, l2**-2
        w1, w2 = a * (l1 - m / l1 * n) + b * (l1 / n - m / l1), a * (l2 - n / l2 * m) + b * (l2 / m - n / l2)
        w11, w22 = a * (1 + 3 * m * m * n) + b * (1 / n + 3 * m * m), a * (1 + 3 * n * n * m) + b * (1 / m + 3 * n * n)
        w12 = 2 * a * m * n / (l1 * l2) + 2 * b * l1 * l2
        w11, w22 = np.where(narrow, w11 - w12**2 / w22, w11), np.where(short, w22 - w12**2 / w11, w22)
        w1, w11 = np.where(short, 0.0, w1), np.where(short, 0.0, w11)
        w2, w22 = np.where(narrow, 0.0, w2), np.where(narrow, 0.0, w22)
        return w1, w2, w11, np.where(narrow | short, 0.0, w12), w22

    def stretch(self, T1, l2):
        """Meridional stretch l1 at the stress T1 >= 0 [Pa], the largest with w_1(l1, l2) = T1."""
        a, b = 2 * self.a, 2 * self.b
        l1 = _rise(abs(l2) ** -0.5, T1, a + b * l2**2, 0.0, a / l2**2 + b)
        if not self.tension_field:
            return l1
        return np.where(l2 * np.sqrt(l1) < 1, _rise(1.0 + 0 * T1, T1 - b, a, a, b), l1)

    def _widened(self, l1, l2):
        """Stretches, those of wrinkled places replaced by the natural ones, and where l2 and l1 are replaced."""
        if not self.tension_field:
            return l1, l2, False, False
        narrow, short = l2 < np.maximum(l1, 1) ** -0.5, l1 < np.maximum(l2, 1) ** -0.5
        return (
            np.where(short, np.maximum(l2, 1) ** -0.5, l1),
            np.where(narrow, np.maximum(l1, 1) ** -0.5, l2),
            narrow,
            short,
        )


def _rise(x, T, p, q, s):
    """Root of p x - q / x^2 - s / x^3 = T by Newton's method: increasing and concave, hence safe from below."""
    for _ in range(60):
        step = (T - p * x + q / x**2 + s / x**3) / (p + 2 * q / x**3 + 3 * s / x**4)
        x = x + step
        if np.all(abs(step) < 1e-15 * x):
            break
    return x


def neo_hookean(C1, tension_field=False):
    """W = C1 (I1 - 3), C1 in Pa: shear modulus 2 C1."""
    return Law(C1, 0.0, tension_field)


def mooney_rivlin(C1, C2, tension_field=False):
    """W = C1/2 (I1 - 3) + C2/2 (I2 - 3), C1 and C2 in Pa: shear modulus C1 + C2."""
    return Law(C1 / 2, C2 / 2, tension_field)


@dataclass(frozen=True)
class Membrane:
    """A static shape; arrays over the m points outside the tool, from there or the centre to the rim.

    Attributes
    ----------
    stress_free, mounted : (m,) array
        Distance from the axis before and after the prestretch [m].
    r, z : (m,) array
        Distance from the axis and height above the rim [m].
    l1, l2, angle : (m,) array
        Meridional and hoop stretch, and the angle [rad] by which the meridian falls outwards.
    force : float
        Vertical force on the tool, 2 pi S H T1 sin(angle) [N]; zero without a tool.
    force_spread : float
        Largest relative variation along the meridian of that force, or of 2 pi S H T1 sin(angle) / (pi r^2 pressure).
    height, mean_deflection : float
        Greatest height, and the mean of z over the mounted disc's area [m].
    energy, mounted_energy : float
        Strain energy of the whole sheet, and what the prestretch alone stores [J].
    least_hoop_stress : float
        Smallest T2 [Pa], negative where a sheet free to wrinkle would do so (l2 < l1^(-1/2)).
    least_width : float
        Smallest l2 l1^(1/2): below 1, the sheet is wrinkled or, without a tension field, hoop-compressed.
    """

    stress_free: np.ndarray
    mounted: np.ndarray
    r: np.ndarray
    z: np.ndarray
    l1: np.ndarray
    l2: np.ndarray
    angle: np.ndarray
    force: float
    force_spread: float
    height: float
    mean_deflection: float
    energy: float
    mounted_energy: float
    least_hoop_stress: float
    least_width: float

    def deflection(self, place, of="mounted"):
        """Heights [m] of what was mounted at these distances from the axis [m], or with of="r" of what is there now."""
        x = getattr(self, of)
        fall = np.tan(self.angle) if of == "r" else self.l1 * np.sin(self.angle) * self.stress_free / self.mounted
        return CubicHermiteSpline(x, self.z, -fall)(np.maximum(place, x[0]))


def poke(R, H, law, depth, tool_radius, prestretch=1.0, tolerance=1e-8):
    """Shape of a membrane whose part within `tool_radius` is glued to a rigid flat disc, moved by `depth`.

    Parameters
    ----------
    R, H : float
        Radius of the rim and stress-free thickness [m].
    law : Law
        The material.
    depth : float
        Displacement of the disc along the axis [m].
    tool_radius : float
        Radius of the disc [m] on the mounted sheet, whose stretch under the disc stays that of mounting.
    prestretch : float
        Equal-biaxial stretch of mounting.
    tolerance : float
        Relative residual of the differential equations.

    Returns
    -------
    Membrane
    """
    if not 0 < tool_radius < R or depth <= 0:
        raise ValueError(f"tool_radius={tool_radius} must lie in (0, {R}) and depth={depth} be positive")
    for steps in (1, 8):  # all at once, or if that fails from depth to depth
        shape = None
        try:
            for part in range(1, steps + 1):
                shape = _poke(R, H, law, depth * part / steps, tool_radius, prestretch, tolerance, shape)
        except RuntimeError:
            continue
        return shape
    raise RuntimeError(f"no shape found at depth={depth}")


def _poke(R, H, law, depth, tool_radius, prestretch, tolerance, start):
    """Shape near that of a smaller depth, `start`, if there is one."""
    slope = depth / R
    if start is None:
        x = np.log(np.geomspace(tool_radius, R, 101) / prestretch)
        angle = np.arctan(2 / 3 * slope * (R / prestretch / np.exp(x)) ** (1 / 3))  # that of a sheet poked at a point
        tight = max(prestretch, prestretch**-0.5) / np.cos(angle)  # in tension, slack though the mounted sheet may be
        stress = law.derivatives(tight, prestretch + 0 * x)[0]
        needle = (law.a + law.b) * slope**3 * R / np.exp(x)  # T1 sin(angle) near a needle, about
        height = depth * (1 - prestretch * np.exp(x) / R)
        down = np.maximum(stress * np.sin(angle), needle)
        guess = np.array([stress * np.cos(angle), down, 0 * x + prestretch, height])
    else:
        x, stress = np.log(start.stress_free), law.derivatives(start.l1, start.l2)[0]
        height = start.z * depth / start.height
        guess = np.array([stress * np.cos(start.angle), stress * np.sin(start.angle), start.l2, height])

    def ends(inner, rim):
        return np.array([inner[2] - prestretch, inner[3] - depth, rim[2] - prestretch, rim[3]])

    return _solve(R, H, law, 0.0, prestretch, x, guess, ends, slope, tolerance)


def inflate(R, H, law, pressure, prestretch=1.0, tolerance=1e-8):
    """Shape of a membrane under a pressure [Pa] on its deformed face; the other arguments are those of `poke`.

    Returns
    -------
    Membrane
    """
    if pressure <= 0:
        raise ValueError(f"pressure={pressure} must be positive")
    E = 6 * (law.a + law.b)
    tension = 2 * law.derivatives(prestretch, prestretch)[0] / prestretch
    # a shallow cap: pressure R^2 is about 2 H tension height + 3.5 E H height^3 / R^2, which has one positive root
    slope = float(np.roots([3.5 * E * H / R**2, 0, 2 * H * tension, -pressure * R**2]).real.max()) / R
    x = np.log(R / prestretch * np.geomspace(1e-5, 1, 101))
    s = np.exp(x) * prestretch / R
    hoop = prestretch * (1 + slope**2 / 2 * (1 - s**2))
    stress = law.derivatives(np.maximum(hoop, hoop**-0.5) + slope**2, hoop)[0]
    sine = np.minimum(pressure * hoop**2 * np.exp(x) / (2 * H * stress), 0.9)
    guess = np.array([stress * np.sqrt(1 - sine**2), stress * sine, hoop, slope * R * (1 - s**2)])

    def ends(inner, rim):
        even = law.derivatives(inner[2], inner[2])[0]
        shear = pressure * inner[2] ** 2 * np.exp(x[0]) / (2 * H)  # vertical balance of a cap
        return np.array([inner[0] - even, inner[1] - shear, rim[2] - prestretch, rim[3]])

    return _solve(R, H, law, pressure, prestretch, x, guess, ends, slope, tolerance)


def _solve(R, H, law, pressure, prestretch, x, guess, ends, slope, tolerance):
    """Solve for T1 cos(angle), T1 sin(angle), l2 and z over x = log(S), scaled by their sizes at small slopes.

    Unlike those of the stretches, the slopes of these four have no jump where wrinkles begin.
    """
    strain = slope**2 + 1e-3 * abs(prestretch - 1)  # smaller changes of a stretch would drown in rounding
    stiff = 2 * (law.a + law.b)
    scale = np.array([stiff * strain, stiff * strain * slope, strain, slope * R])[:, None]
    shift = np.array([law.derivatives(prestretch, prestretch)[0], 0.0, prestretch, 0.0])[:, None]

    def slopes(x, y):
        along, down, l2, _ = shift + scale * y
        S, T1 = np.exp(x), np.hypot(along, down)
        l1 = law.stretch(T1, l2)
        T2 = law.derivatives(l1, l2)[1]
        dr, dz = S * l1 * along / T1, -S * l1 * down / T1
        load = pressure * l2 / H
        return np.array([T2 - along + load * dz, -down + load * dr, dr / S - l2, dz]) / scale

    def conditions(inner, rim):
        return ends(shift[:, 0] + scale[:, 0] * inner, shift[:, 0] + scale[:, 0] * rim) / sizes

    sizes = scale[[0, 1, 2, 3] if pressure else [2, 3, 2, 3], 0]
    found = solve_bvp(slopes, conditions, x, (guess - shift) / scale, tol=tolerance, bc_tol=tolerance, max_nodes=20_000)
    if not found.success:
        raise RuntimeError(found.message)
    if (shift + scale * found.y)[2].min() <= 0 or found.y[3, 0] <= 0:
        raise RuntimeError("the sheet passes through the axis or bulges against its load")
    half = np.diff(found.x) / 2
    inside = (found.x[:-1, None] + half[:, None] * (1 + GAUSS)).ravel()
    states = [shift + scale * found.sol(where) for where in (inside, found.x)]
    return _summary(R, H, law, pressure, prestretch, found.x, inside, (half[:, None] * WEIGHTS).ravel(), states)


def _summary(R, H, law, pressure, prestretch, x, inside, weights, states):
    """Results from the states at the points `inside`, of the given quadrature weights, and at the nodes x."""
    (along, down, l2, z), (n_along, n_down, n2, height) = states
    l1, n1 = law.stretch(np.hypot(along, down), l2), law.stretch(np.hypot(n_along, n_down), n2)
    area = 2 * np.pi * np.exp(2 * inside) * weights  # S dS of the rings
    S = np.exp(x)
    vertical = 2 * np.pi * S * H * n_down
    level = vertical / (np.pi * pressure * (n2 * S) ** 2) if pressure else vertical
    disc, mounted_density = np.pi * S[0] ** 2, law.energy(prestretch, prestretch)
    under_tool = law.energy(n1[0], n2[0]) if pressure else mounted_density
    return Membrane(
        stress_free=S,
        mounted=prestretch * S,
        r=n2 * S,
        z=height,
        l1=n1,
        l2=n2,
        angle=np.arctan2(n_down, n_along),
        force=0.0 if pressure else float(vertical.mean()),
        force_spread=float(np.ptp(level) / level.mean()),
        height=float(height[0]),
        mean_deflection=float((area @ z + disc * height[0]) * prestretch**2 / (np.pi * R**2)),
        energy=float(H * (area @ law.energy(l1, l2) + disc * under_tool)),
        mounted_energy=float(np.pi * (R / prestretch) ** 2 * H * mounted_density),
        least_hoop_stress=float(law.derivatives(n1, n2)[1].min()),
        least_width=float((n2 * np.sqrt(n1)).min()),
    )


def minimise(R, H, law, elements, depth=None, tool_radius=0.0, pressure=0.0, prestretch=1.0, tolerance=1e-10):
    """Energy minimum among quadratic finite elements; without tool if `depth` is None, other arguments as above.

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


def point_load_small_strain(R, H, E, force, tool_radius=0.0):
    """Depth [m] of a force on a linear-elastic membrane without bending, mounted without tension; Poisson ratio 1/2.

    With x = r^2 and y = r^2 N, N [N/m] the meridional force, Foeppl's equations read y'' = -E H / 2 (force / 4 pi y)^2,
    solved by x = B (sinh t - t) + const, y = A (cosh t - 1). Fixed edges ask for y' = 3/4 y / x, that is x = B g(t).
    The depth rises as t. For a needle the solution is that of Schwerin (1929), which `komaragiri` fits.

    Parameters
    ----------
    R, H, E : float
        Radius, thickness [m] and Young's modulus [Pa].
    force : float
        Force on the tool [N].
    tool_radius : float
        Radius of the rigid disc glued to the sheet [m]; 0 for a needle.
    """

    def g(t):
        return 1.5 * np.sinh(t / 2) ** 3 / np.cosh(t / 2)

    def offset(t):  # of x / B from sinh t - t
        return g(t) - (np.sinh(t) - t if t > 0.1 else t**3 / 6 * (1 + t**2 / 20 * (1 + t**2 / 42)))

    peak = minimize_scalar(lambda t: -offset(t), bounds=(0.1, 3), method="bounded").x
    rim = brentq(offset, peak, 10)
    tool = 0.0
    if tool_radius:

        def rim_of(t):
            return brentq(lambda s: offset(s) - offset(t), peak, rim)

        tool = brentq(
            lambda t: np.cbrt(g(t) / g(rim_of(t))) - (tool_radius / R) ** (2 / 3), 1e-4, 0.999 * peak, xtol=1e-14
        )
        rim = rim_of(tool)
    return (rim - tool) / (4 * np.pi) * np.cbrt(32 * np.pi**2 * R**2 * force / (g(rim) * E * H))


def komaragiri(poisson):
    """Depth at the centre over R (force / (E H R))^(1/3), fitted by Komaragiri, Begley and Simmonds (2005)."""
    return 1.0491 - 0.1462 * poisson - 0.15827 * poisson**2


def hencky(poisson, terms=80):
    """Height of the centre over R (pressure R / (E H))^(1/3) at small strain, by Hencky's series (1915).

    With x = (r / R)^2, the meridional force is E H (pressure R / (E H))^(2/3) n(x) / 4, where (x n)'' n^2 = -2 and at
    the held rim 2 n' + (1 - poisson) n = 0. The rim gives the series' first coefficient, the first gives the others.
    The load is vertical, pressure per mounted area; the follower pressure of `inflate` differs in higher order.
    """

    def series(first):
        b, square, bent = np.zeros(terms), np.zeros(terms), np.zeros(terms)  # of n, n^2 and (x n)''
        b[0], square[0], bent[0] = first, first**2, -2 / first**2
        for m in range(1, terms):
            b[m] = bent[m - 1] / (m * (m + 1))
            square[m] = b[: m + 1] @ b[m::-1]
            bent[m] = -(square[m:0:-1] @ bent[:m]) / square[0]
        return b

    def rim(first):
        return series(first) @ (2 * np.arange(terms) + 1 - poisson)

    b = series(brentq(rim, 1.5, 2.5, xtol=1e-14))
    return quad(lambda x: 1 / np.polynomial.polynomial.polyval(x, b), 0, 1, epsabs=1e-13)[0]


def _row(shape, elements):
    """What is recorded of a shape, and the largest relative differences of the finite elements' results from it."""
    gaps = [
        elements[k] / getattr(shape, k) - 1 for k in ("force", "height", "mean_deflection", "energy") if elements[k]
    ]
    profile = abs(shape.deflection(elements["mounted"]) - elements["z"]).max() / shape.height
    return {
        "height": shape.height,
        "force": shape.force,
        "mean_deflection": shape.mean_deflection,
        "energy": shape.energy,
        "mounted_energy": shape.mounted_energy,
        "deflection": shape.deflection(PLACES).tolist(),
        "deflection_in_place": shape.deflection(PLACES, of="r").tolist(),
        "least_hoop_stress": shape.least_hoop_stress,
        "wrinkled": bool(shape.least_width < 1 - 1e-9),
        "force_spread": shape.force_spread,
        "elements_difference": float(max(abs(np.array(gaps)))),
        "elements_profile_difference": float(profile),
    }


def poked(law, tool_radius, prestretch=1.0):
    """Row of a membrane poked by DEPTH, with the slope of the energy relative to the force."""
    arguments = RADIUS, THICKNESS, law
    shape = poke(*arguments, DEPTH, tool_radius, prestretch)
    step = 1e-2 * DEPTH
    e = [poke(*arguments, DEPTH + k * step, tool_radius, prestretch).energy for k in (-2, -1, 1, 2)]
    work = (e[0] - 8 * e[1] + 8 * e[2] - e[3]) / (12 * step) / shape.force - 1
    found = minimise(*arguments, ELEMENTS, DEPTH, tool_radius, prestretch=prestretch)
    return {"tool_radius": tool_radius, "prestretch": prestretch, **_row(shape, found), "work_difference": work}


def needles(law):
    """Force at ever thinner tools, and the constant c of its fall.

    Within length = force / (4 pi H C1) of the axis, stretches are large, T1 = 2 C1 l1, and z changes as a logarithm:
    depth = Schwerin's + length (log(length / tool_radius) + c). A needle without thickness thus meets no force.
    """
    rows = []
    for tool_radius in RADIUS * 10.0 ** -np.array([3, 4, 5, 6, 7, 9, 11, 13]):
        force = poke(RADIUS, THICKNESS, law, DEPTH, tool_radius).force
        length = force / (4 * np.pi * THICKNESS * C1)
        rest = DEPTH - point_load_small_strain(RADIUS, THICKNESS, 6 * C1, force)
        c = rest / length - np.log(length / tool_radius)
        rows.append({"tool_radius": float(tool_radius), "force": force, "length": length, "c": float(c)})
    return rows


def small_strain(law):
    """How near poked and inflated sheets come to the closed forms: relative differences of force and height."""
    E, rows = 6 * C1, []
    for slope, thin in product((1e-3, 1e-2, 1e-1), (1e-1, 1e-2, 1e-3)):
        force = poke(RADIUS, THICKNESS, law, slope * RADIUS, thin * RADIUS).force
        disc, needle = (point_load_small_strain(RADIUS, THICKNESS, E, force, a * RADIUS) for a in (thin, 0.0))
        gaps = {
            f"{k}_difference": float((w / slope / RADIUS) ** 3 - 1) for k, w in (("disc", disc), ("needle", needle))
        }
        rows.append({"slope": slope, "tool_radius": thin * RADIUS, **gaps})
    for pressure in (1e-4, 1e-3, 1e-2, 1e-1, 1.0, 10.0):
        expected = hencky(0.5) * RADIUS * (pressure * RADIUS / (E * THICKNESS)) ** (1 / 3)
        height = inflate(RADIUS, THICKNESS, law, pressure).height
        rows.append({"pressure": pressure, "height": height, "hencky_difference": float(height / expected - 1)})
    return rows


def main():
    """Compute and print the tables."""
    law = neo_hookean(C1)
    poking = [poked(law, 1e-3 * a) for a in (0.25, 0.5, 1, 2.5, 5, 10, 20)]
    poking += [poked(law, 0.01, prestretch) for prestretch in (1.01, 1.1)]
    inflation = []
    for pressure in (1.0, 10.0, 50.0):
        shape = inflate(RADIUS, THICKNESS, law, pressure)
        found = minimise(RADIUS, THICKNESS, law, ELEMENTS, pressure=pressure)
        inflation.append({"pressure": pressure, **_row(shape, found)})
    coefficients = {
        "hencky": hencky(0.5),
        "needle": point_load_small_strain(1.0, 1.0, 1.0, 1.0),
        "needle_komaragiri": komaragiri(0.5),
    }
    tables = {"about": ABOUT, "poke": poking, "inflate": inflation, "coefficients": coefficients}
    tables |= {"needle": needles(law), "small_strain": small_strain(law)}
    OUTPUT.parent.mkdir(parents=True, exist_ok=True)
    OUTPUT.write_text(json.dumps(tables, indent=1) + "\n")
    print(json.dumps(tables, indent=1))


if __name__ == "__main__":
    main()
