"""Truths of validation/elements.py: what the cases of validation/elements_cases.py do, by finite elements.

Linear responses at rest: angular frequencies, sag (mean displacement along 1 m/s^2 in x, y, z), force per metre of
the patch, compliance under the smooth pressure (work over force squared, twice), tips of the beam; and forces of
balls at finite strain. Linear responses are extrapolated from two meshes, as borders of supports and patches ask for;
how far is the estimate of the truth's own error. Forces of balls are those of the finest mesh asked for, next to a
coarser one's.
Needs scikit-fem, tetgen (except for the cylinder and the block) and pypardiso.

    python validation/elements_truth.py [liver lobes ...] [--balls [0 1 ...]] [--linear] [--fine]

Results are added to docs/validation/elements_truth.json.
"""

from __future__ import annotations

import argparse
import importlib.metadata
from time import perf_counter
from typing import Any

import numpy as np
import result_files
from elements_bodies import Meshed, meshed
from elements_cases import NAMES, Case, case
from elements_contact import Ball, Newton
from elements_fe import Factor, frequencies, surface_rule

NAME = "elements_truth"
LEVELS = 1.0, 2.0  # of meshes for linear responses
# of these, by which they are extrapolated: a third mesh, half as fine again, gave 0.6 for the patch, 1.4 to 1.8 for
# frequencies and sag
ORDERS = {"patch": 1.0}
ORDER = 1.5
BALL_LEVELS = 1.0, 1.5
FREQUENCIES = 5
PENALTIES = 80.0, 320.0  # of a ball, in shear moduli over its radius
FIRST, STEP = 0.03, 0.125  # of the way of a ball, in radii
TOLERANCES = 1e-2, 3e-4  # of residuals on the way and at a depth
PACKAGES = "scikit-fem", "tetgen", "pypardiso", "mkl", "numpy", "scipy", "numba"


class Linear:
    """Linear responses of a meshed case at rest.

    Parameters
    ----------
    case : Case
    mesh : Meshed
    """

    def __init__(self, case: Case, mesh: Meshed) -> None:
        self.case, self.mesh, self.body = case, mesh, mesh.body
        self.K = self.body.tangent()
        self.inner = self.K[mesh.free][:, mesh.free]
        self.solve = Factor(self.inner)

    def response(self, load: np.ndarray) -> np.ndarray:
        """Return the displacements (nodes, 3) under nodal forces."""
        u = np.zeros(load.size)
        u[self.mesh.free] = self.solve(load.ravel()[self.mesh.free])
        return u.reshape(-1, 3)

    def frequencies(self) -> list[float]:
        """Lowest angular frequencies [rad/s]."""
        return frequencies(self.body, self.mesh.free, FREQUENCIES, self.solve, self.inner)[0].tolist()

    def sag(self) -> list[float]:
        """Mean displacements [m] along 1 m/s^2 in x, y and z."""
        means = []
        for i in range(3):
            load = np.zeros_like(self.body.X)
            load[:, i] = self.body.density * self.body.integral
            means.append(float(self.body.integral @ self.response(load)[:, i] / self.body.volume))
        return means

    def smooth(self) -> float:
        """Compliance [m/N] under the smooth pressure."""
        c, share = self.case, self.mesh.share
        rule, areas = surface_rule(self.body, self.mesh.near(c.point, 1.3 * c.smooth_radius))
        r = np.linalg.norm(rule @ self.body.X - c.point, axis=1)
        pressure = np.where(r < c.smooth_radius, 0.5 + 0.5 * np.cos(np.pi * r / c.smooth_radius), 0.0)
        load = np.outer(rule.T @ (pressure * areas), c.normal)
        return float(np.sum(load * self.response(load))) / share / float(pressure @ areas) ** 2

    def patch(self) -> float:
        """Force per displacement [N/m] of the patch, moved along the normal without turning."""
        c, surface = self.case, self.body.surface
        on = surface[np.linalg.norm(self.body.X[surface] - c.point, axis=1) <= c.patch_radius * (1 + 1e-6)]
        held = self.mesh.held.copy()
        held[on] = True
        free = np.flatnonzero(~held.ravel())
        u = np.zeros_like(self.body.X)
        u[on] = c.normal
        flat, factor = u.ravel(), Factor(self.K[free][:, free])
        flat[free] = -factor((self.K @ flat)[free])
        factor.free()
        return float((self.K @ flat).reshape(-1, 3)[on].sum(axis=0) @ c.normal)

    def beam(self) -> dict[str, float]:
        """Frequencies of the beam by kind [rad/s], and its tips' displacements along forces on its end [m/N]."""
        values, modes = frequencies(self.body, self.mesh.free, 10, self.solve, self.inner)
        shapes = np.zeros((self.body.X.size, 10))
        shapes[self.mesh.free] = modes
        u = shapes.reshape(len(self.body.X), 3, 10)
        X, weight = self.body.X, self.body.integral
        turn = np.abs(np.einsum("n,nm->m", weight, X[:, 1, None] * u[:, 2] - X[:, 2, None] * u[:, 1])) / 0.01
        axial = np.abs(np.einsum("n,nm->m", weight, u[:, 0]))
        found = {"bending": values[0], "torsion": values[np.argmax(turn)], "axial": values[np.argmax(axial)]}
        end = self.body.faces[(np.abs(X[self.body.faces[:, :3], 0] - self.case.end) < 1e-9).all(axis=1)]
        rule, areas = surface_rule(self.body, end)
        for name, i in (("tip sideways", 2), ("tip along", 0)):
            load = np.zeros_like(X)
            load[:, i] = rule.T @ areas / areas.sum()
            found[name] = np.sum(load * self.response(load))
        return {name: float(value) for name, value in found.items()}


def linear(name: str) -> dict[str, Any]:
    """Return the linear responses of a case on both meshes."""
    it = case(name)
    found: list[dict[str, Any]] = []
    meshes = []
    for level in LEVELS:
        begin = perf_counter()
        mesh = meshed(it, level)
        model = Linear(it, mesh)
        found.append({quantity: getattr(model, quantity)() for quantity in it.quantities})
        model.solve.free()
        meshes.append(_described(mesh, level, begin))
        print(name, meshes[-1], found[-1], flush=True)
    entry: dict[str, Any] = {"spacing": it.spacing, "poisson": it.poisson}
    for quantity in it.quantities:
        entry[quantity] = extrapolated(quantity, *(each[quantity] for each in found))
    return entry | {"meshes": meshes}


def extrapolated(quantity: str, fine: Any, coarse: Any) -> dict[str, Any]:
    """Return the extrapolated value of a quantity, those of two meshes, and its estimated error."""
    if isinstance(fine, dict):
        value = {name: extrapolated(quantity, fine[name], coarse[name])["value"] for name in fine}
    else:
        share = 1 / ((LEVELS[1] / LEVELS[0]) ** ORDERS.get(quantity, ORDER) - 1)
        value = (np.asarray(fine) + share * (np.asarray(fine) - np.asarray(coarse))).tolist()
    return {"value": value, "fine": fine, "coarse": coarse, "error": _difference(value, fine)}


def _described(mesh: Meshed, level: float, begin: float) -> dict[str, Any]:
    return {
        "level": level, "nodes": len(mesh.body.X), "tetrahedra": len(mesh.body.nodes), "share": mesh.share,
        "volume": mesh.body.volume * mesh.share, "seconds": round(perf_counter() - begin, 1),
    }  # fmt: skip


def _difference(fine: Any, coarse: Any) -> float:
    """Return the largest relative difference."""
    if isinstance(fine, dict):
        fine, coarse = list(fine.values()), list(coarse.values())
    return float(np.max(np.abs(np.asarray(coarse) / np.asarray(fine) - 1)))


class Press:
    """A ball pressed into a meshed case, to one depth after the other.

    Parameters
    ----------
    case : Case
    mesh : Meshed
    radius : float [m]
    """

    def __init__(self, case: Case, mesh: Meshed, radius: float) -> None:
        self.case, self.mesh, self.radius = case, mesh, radius
        self.ball = Ball(mesh.body, radius, mesh.near(case.point, 2.2 * radius))
        self.newton = Newton(mesh.body, mesh.held)
        self.u, self.at = np.zeros_like(mesh.body.X), 0.0
        self.before = self.done = self.u, self.at  # displacements and depth, of the step and the depth before

    def _to(self, depth: float, penalty: float, tolerance: float) -> float:
        """Find the equilibrium with the ball at a depth; return its force along the normal."""
        c = self.case
        centre, stiffness = c.point + c.normal * (depth - self.radius), penalty * 2 * c.c1 / self.radius

        def push(u, definite=False):
            return self.ball.push(u, centre, stiffness, definite)

        start, (last, since) = self.u, self.before
        if depth > self.at > since:  # go on as before, if that is nearer
            guess = start + (depth - self.at) / (self.at - since) * (start - last)
            if self.newton.energy(guess, push) < self.newton.energy(start, push):
                start = guess
        if depth > self.at:
            self.before, self.at = (self.u, self.at), depth
        self.u = self.newton.solve(start, push, tolerance)
        return self.mesh.share * float(self.ball.force @ c.normal)

    def force(self, depth: float) -> dict[str, float]:
        """Return the force at a depth, and how it was found."""
        begin, done, factors = perf_counter(), self.newton.iterations, self.newton.factors
        ways = np.arange(1, int(np.ceil(depth / (STEP * self.radius) - 1e-9))) * STEP * self.radius
        for way in [FIRST * self.radius, *ways]:
            if way > self.at:
                self._to(way, PENALTIES[0], TOLERANCES[0])
        soft, hard = (self._to(depth, penalty, TOLERANCES[1]) for penalty in PENALTIES)
        self.before, self.done = self.done, (self.u, depth)
        ratio = PENALTIES[1] / PENALTIES[0]
        rigid = (ratio - 1) / (ratio / hard - 1 / soft)  # the compliance goes with one over the penalty
        return {
            "radius": self.radius, "depth": depth, "force": rigid, "hard": hard, "soft": soft,
            "penetration": self.ball.penetration / self.radius, "iterations": self.newton.iterations - done,
            "factors": self.newton.factors - factors, "seconds": round(perf_counter() - begin, 1),
        }  # fmt: skip


def press(it: Case, level: float, radius: float, depths: tuple[float, ...]) -> tuple[list[dict[str, Any]], dict]:
    """Return the forces of a ball, fewer where no equilibrium is found, and the mesh."""
    begin, found = perf_counter(), []
    mesh = meshed(it, level, radius)
    tool = Press(it, mesh, radius)
    try:
        for depth in depths:
            found.append(tool.force(depth))
            print(it.name, level, len(mesh.body.X), found[-1], flush=True)
    except RuntimeError as error:
        print(it.name, radius, depth, error, flush=True)
    tool.newton.release()
    return found, {"radius": radius} | _described(mesh, level, begin)


def balls(name: str, wanted: list[int] | None = None, levels: tuple[float, ...] = BALL_LEVELS) -> None:
    """Add the forces of a case's balls, with the coarser mesh's next to them."""
    it = case(name)
    for k, (radius, depths) in enumerate(it.balls):
        if wanted and k not in wanted:
            continue
        for level in levels:
            rows, mesh = press(it, level, radius, depths)
            add_balls(name, rows, mesh, "force" if level == levels[0] else "coarse")


def add_balls(name: str, rows: list[dict[str, Any]], mesh: dict[str, Any], key: str) -> None:
    """Put the forces of one ball among the results; under "coarse", with their difference, next to what is there."""
    entry = result_files.read(NAME, {"cases": {}})["cases"].get(name, {})
    radius, present = mesh["radius"], entry.get("balls", [])
    if key == "force":
        present = [row for row in present if row["radius"] != radius] + rows
    for row in rows if key == "coarse" else []:
        for other in present:
            if (other["radius"], other["depth"]) == (row["radius"], row["depth"]):
                other["coarse"], other["error"] = row["force"], _difference(other["force"], row["force"])
    meshes = [m for m in entry.get("ball_meshes", []) if (m["radius"], m["level"]) != (radius, mesh["level"])]
    present.sort(key=lambda row: (row["radius"], row["depth"]))
    add(name, {"balls": present, "ball_meshes": [*meshes, mesh]})


def add(name: str, entry: dict[str, Any]) -> None:
    """Put what was found for a case among the results."""
    results = result_files.read(NAME, {"versions": {}, "cases": {}})
    results["versions"] = {package: importlib.metadata.version(package) for package in PACKAGES}
    results["cases"][name] = results["cases"].get(name, {}) | entry
    results["cases"] = {each: results["cases"][each] for each in NAMES if each in results["cases"]}
    result_files.write(NAME, results, None if "balls" in entry else "python validation/elements.py --truth")


def main() -> None:
    """Find the truths asked for and add them to the results."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", default=list(NAMES), metavar="case")
    parser.add_argument("--linear", action="store_true", help="linear responses only")
    parser.add_argument("--balls", type=int, nargs="*", help="balls only, of these numbers")
    parser.add_argument("--fine", action="store_true", help="no coarser meshes for balls")
    parser.add_argument("--coarse", action="store_true", help="the coarser meshes alone for balls")
    parser.add_argument("--list", action="store_true", help="list the cases")
    options = parser.parse_args()
    if options.list:
        print("\n".join(NAMES))
        return
    for name in options.names:
        if options.balls is None:
            add(name, linear(name))
        if not options.linear:
            balls(name, options.balls, BALL_LEVELS[options.coarse : 1 if options.fine else 2])


if __name__ == "__main__":
    main()
