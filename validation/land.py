"""The first problem of the cardiac benchmark of Land et al., Proc. R. Soc. A 471, 20150641, 2015, over the spacing.

    python validation/land.py [--cells 4 6] [--bulk 100e3 400e3 800e3] [--keep]

A beam of 10 x 1 x 1 mm of Guccione's law (C = 2 kPa, bf = 8, bt = 2, bfs = 4), fibres along it, incompressible, is held
at x = 0; a pressure of 4 Pa pushes on its bottom and follows it. Asked for is the place of the point (10, 0.5, 1) mm:
the published z is about 4.17 to 4.2 mm, a displacement of 3.17 to 3.2 mm. Here the volume resists with a bulk modulus,
and the state of rest is found by dynamic relaxation: the body moves, damped so that its slowest motion just does not
swing. Every spacing starts from the rest of the coarser one.
"""

from __future__ import annotations

import argparse
from time import perf_counter
from typing import Any

import numpy as np
import result_files
from scipy.interpolate import RegularGridInterpolator

import palpate as pt

MM = 1e-3
PRESSURE = 4.0  # Pa
PUBLISHED = (4.17, 4.2)  # mm, about
SLOWEST = 40.0  # about the beam's lowest frequency [rad/s]: half the damping of the mass
SHARE = 0.7  # of the stable step
EVERY, FEWEST, SETTLED = 500, 4000, 1e-4  # the tip may move by so little [mm] in so many steps, after some
BALANCED = 0.01  # force left, over the pressure's
MAX_STEPS = 100_000


def beam(cells: int, bulk: float) -> Any:
    """Make the beam with some number of cells across."""
    heart = pt.materials.Guccione(C=2e3, bf=8.0, bt=2.0, bfs=4.0, directions=(1.0, 0.0, 0.0))
    rest = pt.materials.VolumeOnly(mu=2e3, density=1000.0, bulk=bulk)
    cloud = pt.box((10 * MM, MM, MM), MM / cells)
    return pt.Solid(cloud, rest, "x-", form="energy", stiffness_damping=0.0, fibres=heart)


def run_to_rest(model: Any, u: Any, tip: int) -> tuple[Any, int, float]:
    """Return displacements at rest, the steps taken, and the norm of the forces left over that of the pressure's."""
    prepared, rest = model.prepare([pt.Pressure("z-", PRESSURE)]), np.zeros_like(u)
    v, step, before = np.zeros_like(u), 0.0, np.inf
    for steps in range(MAX_STEPS):
        if steps % EVERY == 0:
            step = SHARE * model.stable_step(pt.State(u, rest, 0.0), prepared)[0]
            if steps > FEWEST and abs(u[tip, 2] - before) < SETTLED * MM and unbalanced(model, u, prepared) < BALANCED:
                break
            before = u[tip, 2]
        v = (1 - 2 * SLOWEST * step) * v + step * model.acceleration(pt.State(u, rest, 0.0), prepared)
        u = u + step * v
    return u, steps, unbalanced(model, u, prepared)


def unbalanced(model: Any, u: Any, prepared: Any) -> float:
    """Return the norm of the forces left at the nodes over that of the pressure's."""
    state = pt.State(u, np.zeros_like(u), 0.0)
    left = model.acceleration(state, prepared) * model.masses[:, None]
    return float(np.linalg.norm(left) / np.linalg.norm(model.external_force(state, prepared)))


def refined(points: Any, coarse: Any, u: Any) -> Any:
    """Displacements of one lattice at the points of another."""
    axes = [np.unique(np.round(coarse[:, k], 9)) for k in range(3)]
    order = np.lexsort((coarse[:, 2], coarse[:, 1], coarse[:, 0]))
    grid = RegularGridInterpolator(axes, u[order].reshape(*map(len, axes), 3), method="cubic")
    return grid(np.clip(points, 0, coarse.max(axis=0)))


def solved(cells: int, bulk: float, before: Any) -> tuple[dict[str, Any], Any]:
    """Return a row of the table, and the points and displacements from which the next spacing starts."""
    start, model = perf_counter(), beam(cells, bulk)
    points = model.cloud.points
    tip = int(np.argmin(np.linalg.norm(points - np.array([10, 0.5, 1]) * MM, axis=1)))
    u = np.zeros_like(points) if before is None else refined(points, *before)
    u, steps, left = run_to_rest(model, u, tip)
    place = (points[tip] + u[tip]) / MM
    J = np.linalg.det(model.deformation_gradient(u))
    row = {
        "cells_across": cells, "bulk": bulk, "nodes": len(points), "tip_mm": place.tolist(), "steps": steps,
        "force_left": left, "largest_volume_change": float(np.abs(J - 1).max()), "seconds": perf_counter() - start,
    }  # fmt: skip
    return row, (points, u)


def main() -> None:
    """Solve, print and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, nargs="+", default=[4, 6], help="across the beam; even")
    parser.add_argument("--bulk", type=float, nargs="+", default=[100e3, 400e3, 800e3], help="bulk moduli [Pa]")
    parser.add_argument("--keep", action="store_true", help="add to docs/validation/land.json")
    args = parser.parse_args()
    rows: dict[tuple[float, int], dict[str, Any]] = {
        (row["bulk"], row["cells_across"]): row for row in result_files.read("land", {"rows": []})["rows"]
    }
    for bulk in args.bulk:
        before = None
        for cells in args.cells:
            row, before = solved(cells, bulk, before)
            rows[bulk, cells] = row
            x, y, z = row["tip_mm"]
            print(
                f"{cells:3d} cells across, bulk modulus {bulk / 1e3:5.0f} kPa: tip at ({x:.3f}, {y:.3f}, {z:.3f}) mm; "
                f"force left {row['force_left']:.1e}, {row['steps']} steps, {row['seconds']:.0f} s",
                flush=True,
            )
            if args.keep:
                report = {
                    "pressure": PRESSURE,
                    "published_tip_z_mm": PUBLISHED,
                    "rows": [rows[key] for key in sorted(rows)],
                }
                result_files.write("land", report)


if __name__ == "__main__":
    main()
