"""Poked and inflated circular membranes: differential equations against finite elements and closed forms.

    python validation/axisymmetric_table.py

writes docs/validation/axisymmetric.json and prints it. Nothing of palpate is used.
"""

from __future__ import annotations

import json
from itertools import product

import numpy as np
import result_files
from axisymmetric import inflate, neo_hookean, poke
from axisymmetric_elements import minimise
from scipy.integrate import quad
from scipy.optimize import brentq, minimize_scalar

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
    the fixed rim 2 n' + (1 - poisson) n = 0. The rim gives the series' first coefficient, the first gives the others.
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
    result_files.write("axisymmetric", tables)
    print(json.dumps(tables, indent=1))


if __name__ == "__main__":
    main()
