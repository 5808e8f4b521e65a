"""Circular membranes of incompressible rubber, poked by a disc or inflated: static solutions by differential equations.

A stress-free flat disc of radius R / prestretch and thickness H is stretched evenly to the radius R and its rim fixed.
With the meridional stretch l1, the hoop stretch l2 = r / S and the energy w(l1, l2) of plane stress, the shape r(S),
z(S) makes 2 pi H int w S dS - pressure x volume stationary (Adkins and Rivlin 1952; Green and Adkins 1960, ch. 4):

    (S T1 cos(angle))' = T2 + pressure r z' / H,   (S T1 sin(angle))' = pressure r r' / H,

with the nominal stresses T1 = dw/dl1 and T2 = dw/dl2, r' = l1 cos(angle) and z' = -l1 sin(angle). `poke` and
`inflate` solve this boundary-value problem; axisymmetric_elements.py finds the same shapes as minima of the energy, and
axisymmetric_table.py compares the two. With ``tension_field`` the energy is relaxed (Pipkin 1986): a sheet narrower
than its natural width l1^(-1/2) wrinkles and bears no hoop stress. T1 > 0 follows from vertical equilibrium, so that no
other wrinkles arise. Slopes should exceed 1e-3: at smaller ones the strains drown in rounding. Nothing of palpate is
used.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_bvp
from scipy.interpolate import CubicHermiteSpline

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
