"""Torsion of a cylinder and inflation of a thick sphere, against the differential equation of their radius.

    python validation/closed_forms.py [--cases torsion sphere] [--laws NeoHookean ...] [--poisson 0.49] [--levels 3]

A cylinder of radius and length a = 10 mm is twisted by 0.6 rad, its length kept: r(R), theta = Theta + psi Z, z = Z.
A hollow sphere, 10 mm inside and 20 mm outside, is blown up until its inner radius is 1.3 times as large: r(R). Both
radii obey

    dP_rR/dR = (P_tT - P_rR) / R + psi P_tZ,      dP_rR/dR = 2 (P_tT - P_rR) / R,

P of the printed energy (printed_laws.py), without stress outside: `solve_bvp` finds them for the same compressible law.
Next to them are the closed forms of the same law were it incompressible: Rivlin's torsion (Philos. Trans. R. Soc. A
242, 173, 1949), of which M = pi/2 mu psi a^4 for Mooney and Rivlin's law, and of the sphere (Green, Zerna, Theoretical
Elasticity, 1954, section 3.10)

    pressure = integral from l_b to l_a of dw/dl / (l^3 - 1) dl,      w(l) = W(l^-2, l, l),  l = r/R at B and A.

The full model, in its energy form, has the cylinder's ends moved as the equation says, and its moment and axial force
are those of the end nodes. Of the sphere it has an octant whose plane faces slide; the inner nodes are moved outwards,
and the pressure is their force over the area they then have. Rest is found by Newton's method.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from time import perf_counter
from typing import Any

import numpy as np
import result_files
from equilibrium import newton
from printed_laws import printed
from scipy.integrate import quad, solve_bvp

import palpate as pt
from palpate.tissue.catalogue import LAWS

MM = 1e-3
RADIUS, TWIST = 10 * MM, 0.6
INNER, OUTER, BLOWN = 10 * MM, 20 * MM, 1.3
RINGS, LAYERS = (4, 6, 8), (4, 6, 8)
KINDS = ("NeoHookean", "MooneyRivlin", "Fung", "Ogden", "Hyperelastic")
TEXT = "C1*(I1bar - 3) + C2*(exp(b*(I1bar - 3)) - 1)"

Stress = Callable[[np.ndarray], np.ndarray]


def law_of(name: str, poisson: float) -> pt.materials.Material:
    if name == "Hyperelastic":
        return pt.materials.Hyperelastic(TEXT, C1=4e3, C2=1e3, b=2.0, density=1000.0, poisson=poisson)
    found = next(law for law in LAWS if law.name == name)
    return found.kind(**found.example, density=1000.0, poisson=poisson)


# the differential equation of the radius, lengths over the outer radius


def twisted(R: Any, r: Any, p: Any, psi: float) -> np.ndarray:
    """F of the twisted cylinder along e_r, e_theta, e_z."""
    F = np.zeros((*np.shape(R), 3, 3))
    F[..., 0, 0], F[..., 1, 1], F[..., 1, 2], F[..., 2, 2] = p, r / R, psi * r, 1.0
    return F


def blown(R: Any, r: Any, p: Any) -> np.ndarray:
    """F of the sphere along e_r, e_theta, e_phi."""
    F = np.zeros((*np.shape(R), 3, 3))
    F[..., 0, 0], F[..., 1, 1], F[..., 2, 2] = p, r / R, r / R
    return F


def profile(stress: Stress, gradient: Any, balance: Any, start: float, inside: Any) -> Any:
    """Solution (r, r') over R from `start` to 1; `inside` is what vanishes at the start, of R, r and r'."""

    def along(R: Any, r: Any, p: Any) -> Any:
        return stress(gradient(R, r, p))[..., 0, 0]

    def slopes(R: Any, y: Any) -> Any:
        (r, p), d = y, 1e-5
        away = (along(R + d, r + d * p, p) - along(R - d, r - d * p, p)) / (2 * d)
        stiff = (along(R, r, p + d) - along(R, r, p - d)) / (2 * d)
        return np.stack([p, (balance(R, stress(gradient(R, r, p))) - away) / stiff])

    def ends(first: Any, last: Any) -> Any:
        size = along(np.array(1.0), np.array(1.0), np.array(1.01)) - along(np.array(1.0), np.array(1.0), np.array(0.99))
        return np.array([inside(start, *first), along(np.array(1.0), *last) / size])

    R = np.linspace(start, 1.0, 41)
    hollow = inside(start, 0.0, 0.0)  # minus the radius to which the hole grows; 0 where there is none
    grown = np.cbrt(R**3 + (-hollow) ** 3 - start**3) if hollow else R
    found = solve_bvp(slopes, ends, R, np.stack([grown, (R / grown) ** 2]), tol=1e-8, max_nodes=20_000)
    if not found.success:
        raise RuntimeError(found.message)
    return found.sol


def gauss(start: float, count: int = 400) -> tuple[np.ndarray, np.ndarray]:
    """Points and weights from `start` to 1."""
    s, w = np.polynomial.legendre.leggauss(count)
    return start + (1 - start) * (s + 1) / 2, w * (1 - start) / 2


def torsion_reference(law: pt.materials.Material) -> tuple[Any, dict[str, float], dict[str, float]]:
    """The radius over a, and moment [N m] and axial force [N]: of the law, and were it incompressible."""
    psi, stress, start = TWIST, printed(law).stress, 1e-4

    def balance(R: Any, P: Any) -> Any:
        return (P[..., 1, 1] - P[..., 0, 0]) / R + psi * P[..., 1, 2]

    radius = profile(stress, lambda R, r, p: twisted(R, r, p, psi), balance, start, lambda R, r, p: r - R * p)
    R, w = gauss(start)
    P = stress(twisted(R, *radius(R), psi))
    moment, force = (2 * np.pi * np.sum(w * R * each) for each in (radius(R)[0] * P[:, 1, 2], P[:, 2, 2]))
    F = twisted(R, R, 1.0, psi)
    sigma = stress(F) @ np.swapaxes(F, 1, 2)
    hoop, axial = (sigma[:, k, k] - sigma[:, 0, 0] for k in (1, 2))
    rivlin = 2 * np.pi * np.sum(w * R**2 * sigma[:, 1, 2]), 2 * np.pi * np.sum(w * R * (axial - hoop / 2))
    units = RADIUS**3, RADIUS**2
    both = [
        {name: float(x * unit) for name, x, unit in zip(("moment", "force"), each, units, strict=True)}
        for each in ((moment, force), rivlin)
    ]
    return radius, both[0], both[1]


def sphere_reference(law: pt.materials.Material) -> tuple[Any, dict[str, float], dict[str, float]]:
    """The radius over the outer one, and the pressure [Pa]: of the law, and were it incompressible."""
    stress, start = printed(law).stress, INNER / OUTER

    def balance(R: Any, P: Any) -> Any:
        return 2 * (P[..., 1, 1] - P[..., 0, 0]) / R

    radius = profile(stress, blown, balance, start, lambda R, r, p: r - BLOWN * start)
    P = stress(blown(start, *radius(start)))
    outside = np.cbrt(1 + (BLOWN**3 - 1) * start**3)

    def slope(stretch: float) -> float:
        P = stress(np.diag([stretch**-2, stretch, stretch]))
        return float((2 * P[1, 1] - 2 * P[0, 0] * stretch**-3) / (stretch**3 - 1))

    closed = quad(slope, outside, BLOWN, epsabs=0, epsrel=1e-10)[0]
    return radius, {"pressure": float(-P[0, 0] / BLOWN**2)}, {"pressure": closed}


# clouds


def cylinder(rings: int) -> pt.Cloud:
    """A cylinder along x: discs of rings, as far apart as the rings."""
    disc, step = pt.disc(RADIUS, RADIUS / rings), RADIUS / rings
    n, count, rim = len(disc), rings + 1, disc.group("rim")
    shares = np.full(count, step)
    shares[[0, -1]] /= 2
    places = np.repeat(np.arange(count) * step, n)
    everyone, contact_surface = np.arange(n), (n * np.arange(count)[:, None] + rim).ravel()
    outward = np.tile(np.insert(disc.face_normals, 0, 0.0, axis=1), (count, 1))
    ends = [np.tile([sign, 0.0, 0.0], (n, 1)) for sign in (-1, 1)]
    last = n * (count - 1)
    return pt.Cloud(
        points=np.column_stack([places, np.tile(disc.points, (count, 1))]),
        volumes=np.outer(shares, disc.volumes).ravel(),
        face_nodes=np.concatenate([contact_surface, everyone, last + everyone]),
        face_normals=np.concatenate([outward, *ends]),
        face_areas=np.concatenate([np.outer(shares, disc.face_areas).ravel(), disc.volumes, disc.volumes]),
        groups={"x-": everyone, "x+": last + everyone},
        triangles=np.concatenate([disc.triangles[:, ::-1], last + disc.triangles]),
        spacing=step,
    )


def octant(cells: int) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors (d, 3) over an octant of directions, three squares mapped, and the solid angle of each (d,)."""
    side = np.tan(np.pi / 4 * np.arange(cells + 1) / cells)
    first, second = np.meshgrid(side, side, indexing="ij")
    square = np.stack([np.ones_like(first), first, second], axis=-1).reshape(-1, 3)
    number = np.arange((cells + 1) ** 2).reshape(cells + 1, cells + 1)
    quads = np.stack([number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]], axis=-1).reshape(-1, 4)
    everything = np.concatenate([np.roll(square, k, axis=1) for k in range(3)])
    everything /= np.linalg.norm(everything, axis=1, keepdims=True)
    _, distinct, index = np.unique(np.round(everything, 9), axis=0, return_index=True, return_inverse=True)
    quads = index.ravel()[np.concatenate([quads + k * len(square) for k in range(3)])]
    directions, angles = everything[distinct], np.zeros(len(distinct))
    for a, b, c in ((0, 1, 2), (0, 2, 3)):  # Van Oosterom, Strackee, IEEE Trans. Biomed. Eng. 30, 125, 1983
        A, B, C = (directions[quads[:, k]] for k in (a, b, c))
        triple = np.abs(np.einsum("ni,ni->n", A, np.cross(B, C)))
        sums = 1 + sum(np.einsum("ni,ni->n", *pair) for pair in ((A, B), (B, C), (C, A)))
        for k in range(4):
            np.add.at(angles, quads[:, k], 2 * np.arctan2(triple, sums) / 4)
    return directions, angles


def shell(layers: int) -> pt.Cloud:
    """An octant of the hollow sphere, its plane faces ``"x"``, ``"y"`` and ``"z"``."""
    step = (OUTER - INNER) / layers
    directions, angles = octant(layers + 1)
    d, radii = len(directions), np.linspace(INNER, OUTER, layers + 1)
    edges = np.clip(np.concatenate([radii - step / 2, radii[-1:] + step / 2]), INNER, OUTER)
    everyone = np.arange(d)
    groups = {"inner": everyone, "outer": layers * d + everyone}
    nodes, normals = list(groups.values()), [-directions, directions]
    areas = [angles * INNER**2, angles * OUTER**2]
    for k, name in enumerate("xyz"):
        on = np.flatnonzero(directions[:, k] == 0)
        turn = np.sort(np.arctan2(directions[on][:, (k + 2) % 3], directions[on][:, (k + 1) % 3]))
        order = np.argsort(np.arctan2(directions[on][:, (k + 2) % 3], directions[on][:, (k + 1) % 3]))
        arcs = np.empty(len(on))
        arcs[order] = np.gradient(turn)
        arcs[order[[0, -1]]] /= 2
        groups[name] = (d * np.arange(layers + 1)[:, None] + on).ravel()
        nodes.append(groups[name])
        normals.append(np.tile(-np.eye(3)[k], (len(groups[name]), 1)))
        areas.append(np.outer(np.diff(edges**2) / 2, arcs).ravel())
    return pt.Cloud(
        points=(radii[:, None, None] * directions).reshape(-1, 3),
        volumes=np.outer(np.diff(edges**3) / 3, angles).ravel(),
        face_nodes=np.concatenate(nodes), face_normals=np.concatenate(normals), face_areas=np.concatenate(areas),
        groups={name: np.sort(members) for name, members in groups.items()}, triangles=np.zeros((0, 3), dtype=int),
        spacing=step,
    )  # fmt: skip


# the full model


def torsion(law: pt.materials.Material, rings: int, radius: Any) -> dict[str, float]:
    """Moment and axial force of the twisted cylinder, `radius` the exact one by which its ends move."""
    cloud = cylinder(rings)
    X = cloud.points
    R = np.linalg.norm(X[:, 1:], axis=1)
    safe = np.maximum(R / RADIUS, 1e-4)
    grown, turn = radius(safe)[0] / safe, TWIST * X[:, 0] / RADIUS
    exact = np.column_stack(
        [X[:, 0], grown * (np.cos(turn) * X[:, 1] - np.sin(turn) * X[:, 2]),
         grown * (np.sin(turn) * X[:, 1] + np.cos(turn) * X[:, 2])]
    )  # fmt: skip
    model = pt.Solid(cloud, law, ("x-", "x+"), form="energy", stiffness_damping=0.0)
    u = newton(model, exact - X, np.repeat(~model.fixed_mask[:, None], 3, axis=1))
    force, end = -model.volumes[:, None] * model.force(u), cloud.group("x+")
    return {
        "nodes": len(cloud),
        "moment": float(np.cross(X[end] + u[end], force[end])[:, 0].sum()),
        "force": float(force[end, 0].sum()),
        "displacement_error": float(np.abs(X + u - exact).max() / np.abs(exact - X).max()),
    }


def sphere(law: pt.materials.Material, layers: int, radius: Any) -> dict[str, float]:
    """Pressure of the octant of the sphere."""
    cloud = shell(layers)
    X, inner = cloud.points, cloud.group("inner")
    R = np.linalg.norm(X, axis=1)
    r = radius(R / OUTER)[0] * OUTER
    free = np.ones(X.shape, dtype=bool)
    free[inner] = False
    for k, name in enumerate("xyz"):
        free[cloud.group(name), k] = False
    model = pt.Solid(cloud, law, "inner", form="energy", stiffness_damping=0.0)
    u = newton(model, X * (r / R - 1)[:, None], free)
    outward = X[inner] / INNER
    push = np.sum(-model.volumes[inner, None] * model.force(u)[inner] * outward)
    outside = cloud.group("outer")
    return {
        "nodes": len(cloud),
        "pressure": float(push / (np.pi / 2 * (BLOWN * INNER) ** 2)),
        "outer_error": float(np.linalg.norm(X + u, axis=1)[outside].mean() - r[-1]) / float(r[-1] - OUTER),
    }


CASES = {
    "torsion": (torsion_reference, torsion, RINGS, RADIUS),
    "sphere": (sphere_reference, sphere, LAYERS, OUTER - INNER),
}


def solve(case: str, name: str, poisson: float, levels: int) -> list[dict[str, Any]]:
    """Rows of a case and a law over the spacing."""
    reference, solved, counts, length = CASES[case]
    law, rows = law_of(name, poisson), []
    radius, exact, incompressible = reference(law)
    for count in counts[:levels]:
        begin = perf_counter()
        found = solved(law, count, radius)
        errors = {f"{key}_error": found[key] / value - 1 for key, value in exact.items()}
        spacing = length / count
        rows.append(
            {"case": case, "law": name, "poisson": poisson, "spacing": spacing, **found, **errors, "exact": exact,
             "incompressible": incompressible, "seconds": round(perf_counter() - begin, 1)}
        )  # fmt: skip
        print(rows[-1], flush=True)
    return rows


def keep(found: list[dict[str, Any]]) -> None:
    """Write rows in place of older ones of the same case, law, Poisson's ratio and spacing."""

    def key(row: dict[str, Any]) -> tuple[Any, ...]:
        return row["case"], row["law"], row["poisson"], round(row["spacing"], 9)

    rows = {key(row): row for row in result_files.read("closed_forms", {"rows": []})["rows"]}
    rows |= {key(row): row for row in found}
    result_files.write("closed_forms", {"rows": list(rows.values())})


def main() -> None:
    """Solve, and keep the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cases", nargs="+", choices=list(CASES), default=list(CASES))
    parser.add_argument("--laws", nargs="+", choices=KINDS, default=list(KINDS))
    parser.add_argument("--poisson", type=float, default=0.49)
    parser.add_argument("--levels", type=int, choices=(1, 2, 3), default=3, help="how many spacings")
    args = parser.parse_args()
    for case in args.cases:
        for name in args.laws:
            keep(solve(case, name, args.poisson, args.levels))


if __name__ == "__main__":
    main()
