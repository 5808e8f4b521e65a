"""Every law in a block between clamps, against finite elements of the same printed energy: tension, compression, shear.

    python validation/law_elements.py [--laws NeoHookean ...] [--spacings 0.005 ...] [--forms energy strong] [--jobs 2]

A block of 40 x 20 x 20 mm with Poisson's ratio 0.45 is clamped at both ends, and one end is moved: pulled by a fifth of
the length, pushed by a tenth, or moved sideways by a quarter. The force on that end is compared with FElupe's 27-node
hexahedra, whose stress is SymPy's derivative of the printed energy (printed_laws.py). Rest is found by Newton's method.
The strong form takes the first two spacings only.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import cache
from multiprocessing import get_context
from time import perf_counter
from typing import Any

import numpy as np
import result_files
from equilibrium import newton
from incompressible import moment_and_force
from printed_laws import printed
from scipy.interpolate import RegularGridInterpolator

import palpate as pt
from palpate.tissue.catalogue import LAWS

SIZE = (0.04, 0.02, 0.02)
GIVEN = {"density": 1000.0, "poisson": 0.45}
CASES = {"tension": (0, 0.2), "compression": (0, -0.1), "shear": (2, 0.25)}  # axis and share of the length
MESHES = ((6, 3, 3), (10, 5, 5))
SPACINGS = (0.005, 0.01 / 3, 0.0025)
PARTS = 4  # of the motion
TEXT = "C1*(I1bar - 3) + C2*(exp(b*(I1bar - 3)) - 1)"


def bodies() -> dict[str, tuple[Callable[[], pt.materials.Material], Callable[[], pt.materials.FibreLaw] | None]]:
    """Every law with its example's parameters, one that is written down, and fibres."""
    everything: dict[str, Any] = {law.name: (lambda law=law: law.kind(**law.example, **GIVEN), None) for law in LAWS}
    everything["Hyperelastic"] = (lambda: pt.materials.Hyperelastic(TEXT, C1=4e3, C2=1e3, b=2.0, **GIVEN), None)
    crossed = [(0.8, 0.6, 0.0), (0.8, -0.6, 0.0)]
    everything["Fibres"] = (
        lambda: pt.materials.NeoHookean(C1=5e3, **GIVEN),
        lambda: pt.materials.Fibres(k1=10e3, k2=3.0, dispersion=0.1, directions=crossed),
    )
    everything["Guccione"] = (
        lambda: pt.materials.VolumeOnly(mu=2e3, **GIVEN),
        lambda: pt.materials.Guccione(C=2e3, bf=8.0, bt=2.0, bfs=4.0, directions=(0.8, 0.6, 0.0)),
    )
    return everything


def felupe_material(law: Any) -> Any:
    """A material of FElupe's with a law's stress, and its tangent by central differences."""
    import felupe as fem

    def stress(fields: list[Any]) -> list[Any]:
        P = law.stress(np.moveaxis(fields[0], (0, 1), (-2, -1)))
        return [np.moveaxis(P, (-2, -1), (0, 1)), fields[-1]]

    def tangent(fields: list[Any]) -> list[Any]:
        F, step = fields[0], 1e-6
        A = np.empty((3, 3, *F.shape))
        for k, m in np.ndindex(3, 3):
            change = np.zeros_like(F)
            change[k, m] = step
            A[:, :, k, m] = (stress([F + change, None])[0] - stress([F - change, None])[0]) / (2 * step)
        return [A]

    return fem.Material(stress=stress, elasticity=tangent)


def element_force(law: Any, case: str, cells: tuple[int, int, int]) -> float:
    """Force [N] on the moved end by the elements."""
    import felupe as fem
    from incompressible_elements import hexahedra, quadratic

    mesh = quadratic(hexahedra(SIZE, cells))
    field = fem.FieldContainer([fem.Field(fem.RegionTriQuadraticHexahedron(mesh), dim=3)])
    solid = fem.SolidBody(felupe_material(law), field)
    end = np.isclose(mesh.points[:, 0], SIZE[0])
    held = np.repeat(end | np.isclose(mesh.points[:, 0], 0), 3)
    axis, share = CASES[case]
    for part in np.linspace(0, 1, PARTS + 1)[1:]:
        values = np.zeros_like(mesh.points)
        values[end, axis] = part * share * SIZE[0]
        fem.newtonraphson(
            items=[solid], dof0=np.flatnonzero(held), dof1=np.flatnonzero(~held), ext0=values.ravel()[held], verbose=0
        )
    forces = solid.assemble.vector(field).toarray().reshape(-1, 3)
    return float(forces[end, axis].sum())


def model_force(model: pt.Solid, case: str, before: Any) -> tuple[float, Any]:
    """Force [N] on the moved end by the model, and its points and displacements, from which a finer one starts."""
    cloud, (axis, share) = model.cloud, CASES[case]
    free = np.ones(cloud.points.shape, dtype=bool)
    free[np.union1d(cloud.group("x-"), cloud.group("x+"))] = False
    u = np.zeros_like(cloud.points) if before is None else refined(cloud.points, *before)
    for part in np.linspace(0, 1, PARTS + 1)[1:] if before is None else (1.0,):
        if before is None:  # all nodes go on with the end, and then come to rest
            u[:, axis] += share / PARTS * cloud.points[:, 0]
        u[cloud.group("x-")] = 0.0
        u[cloud.group("x+")] = part * share * SIZE[0] * np.eye(3)[axis]
        u = newton(model, u, free)
    return float(moment_and_force(model, u)[axis]), (cloud.points, u)


def refined(points: Any, coarse: Any, u: Any) -> Any:
    """Displacements of one lattice at the points of another."""
    axes = [np.unique(np.round(coarse[:, k], 9)) for k in range(3)]
    grid = RegularGridInterpolator(axes, u.reshape(*map(len, axes), 3), method="cubic")
    return grid(np.clip(points, 0, [axis[-1] for axis in axes]))


def solve(task: tuple[str, tuple[str, ...], tuple[float, ...]]) -> list[dict[str, Any]]:
    """Rows of one law: its elements, and its model of some forms and spacings."""
    name, forms, spacings = task
    law, fibres = (each and each() for each in bodies()[name])
    rows = []
    for case in CASES:
        coarse, fine = (element_force(printed(law, fibres), case, cells) for cells in MESHES)
        for form in forms:
            if form == "strong" and fibres is not None:
                continue
            before = None
            for spacing in spacings if form == "energy" else spacings[:2]:
                row = {"law": name, "case": case, "form": form, "spacing": spacing}
                begin = perf_counter()
                model = body(name, form, spacing)
                try:
                    force, before = model_force(model, case, before)
                except RuntimeError as error:
                    rows.append({**row, "refused": str(error)})
                    before = None
                    continue
                rows.append(
                    {**row, "force": force, "elements": fine, "mesh_change": abs(fine / coarse - 1),
                     "error": force / fine - 1, "seconds": round(perf_counter() - begin, 1)}
                )  # fmt: skip
                print(rows[-1], flush=True)
    return rows


@cache
def body(name: str, form: str, spacing: float) -> pt.Solid:
    """A model of a law."""
    law, fibres = (each and each() for each in bodies()[name])
    return pt.Solid(pt.box(SIZE, spacing), law, ("x-", "x+"), form=form, stiffness_damping=0.0, fibres=fibres)


def spacing_of(row: dict[str, Any]) -> float:
    """Return the spacing [m] of a row, rounded so that equal spacings of different runs compare equal."""
    return round(row["spacing"], 9)


def keep(found: list[dict[str, Any]]) -> None:
    """Write rows in place of older ones of the same law, case, form and spacing."""

    def key(row: dict[str, Any]) -> tuple[Any, ...]:
        return row["law"], row["case"], row["form"], spacing_of(row)

    rows = {key(row): row for row in result_files.read("law_elements", {"rows": []})["rows"]}
    rows |= {key(row): row for row in found}
    about = {"size": SIZE, **GIVEN, "cases": CASES}
    result_files.write("law_elements", {"about": about, "rows": list(rows.values())})


def main() -> None:
    """Solve, and keep the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--laws", nargs="+", choices=list(bodies()), default=list(bodies()))
    parser.add_argument("--spacings", type=float, nargs="+", default=list(SPACINGS))
    parser.add_argument("--forms", nargs="+", choices=["energy", "strong"], default=["energy", "strong"])
    parser.add_argument("--jobs", type=int, default=1)
    args = parser.parse_args()
    tasks = [(name, tuple(args.forms), tuple(args.spacings)) for name in args.laws]
    with get_context("spawn").Pool(args.jobs) as pool:
        for rows in pool.imap_unordered(solve, tasks):
            keep(rows)


if __name__ == "__main__":
    main()
