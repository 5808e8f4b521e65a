"""The table and the picture of docs/claims/incompressibility.md, from what validation/incompressible.py has found.

python validation/incompressible_table.py            prints the tables
python validation/incompressible_table.py figure     draws docs/images/incompressible.png
"""

from __future__ import annotations

import sys

import matplotlib.pyplot as plt
import numpy as np
from incompressible import CASES, FIGURE, SIZE, kept, read

RATIO = 0.499  # of the picture
MIN_SPAN = 0.56  # kPa that the colours span: a fifth of the shear modulus
ROWS = ("finite elements", "recovered", "in the stress", "each node's own J")


def find(rows: list[dict], **key) -> dict | None:
    return next((row for row in rows if all(row.get(k) == v for k, v in key.items())), None)


def cell(row: dict | None, text) -> str:
    if row is None:
        return "not run"
    return "refused" if "refused" in row else text(row)


def table(text, cases: tuple[str, ...] = (*CASES, "cook")) -> None:
    """Print one figure of every run: cases down, spacings across."""
    rows = read()["rows"]
    columns = sorted({(row["spacing"], row["jitter"]) for row in rows}, key=lambda c: (-c[0], c[1]))
    heads = [f"{1e3 * h:g} mm{', jittered' if j else ''}" for h, j in columns]
    print("| case | nu | form | " + " | ".join(heads) + " |\n|" + "---|" * (3 + len(heads)))
    for form in ("energy", "strong"):
        for case in cases:
            for poisson in (0.49, 0.499):
                found = [find(rows, case=case, poisson=poisson, form=form, spacing=h, jitter=j) for h, j in columns]
                if any(found):
                    print(f"| {case} | {poisson} | {form} | " + " | ".join(cell(r, text) for r in found) + " |")
    print()


def print_all() -> None:
    print("| case | nu | elements | change from the coarser mesh |\n|---|---|---|---|")
    for row in read()["reference"]:
        print(f"| {row['case']} | {row['poisson']} | {row['answer']:.5g} | {row['mesh_change']:.2%} |")
    print("\nError of the answer\n")
    table(lambda r: f"{100 * r['error']:+.1f} %")
    print("Checkerboard [Pa] off the ends: in the stress / smoothed once / of each node's own J\n")
    table(lambda r: f"{r['rough'][1]:.0f} / {r['rough'][0]:.0f} / {r['rough'][2]:.0f}")
    print("Difference [Pa] of the pressure in the stress from the elements', (their range)\n")
    table(lambda r: f"{r['pressure_errors'][1]:.0f} ({r['range']:.0f})")
    print("The same at 2.5 mm, recovered: checkerboard, difference (range) [Pa]\n")
    for row in read()["shown"]:
        figures = f"{row['rough']:.0f} | {row['pressure_errors'][0]:.0f} ({row['range']:.0f}) |"
        print(f"| {row['case']} | {row['poisson']} | {'jittered' if row['jitter'] else 'lattice'} | {figures}")
    print("\nStable step at rest [us], default stiffness damping\n")
    table(lambda r: f"{1e6 * r['step']:.0f}", ("bending", "cook"))
    print("| case | form of U | form of the solid | error |\n|---|---|---|---|")
    for row in read()["volumetric"]:
        name = f"| {row['case']} {row['answer']:.4f} N, nu = {row['poisson']} "
        print(f"{name}| {row['volumetric']} | {row['form']} | {100 * row['error']:+.2f} % |")


def panel(axis, x: np.ndarray, y: np.ndarray, values: np.ndarray, limits: tuple[float, float]):
    """Values on a grid of points, in the reference state [mm, kPa]."""
    return axis.pcolormesh(1e3 * x, 1e3 * y, values / 1e3, shading="nearest", cmap="RdBu_r", vmin=limits[0],
                           vmax=limits[1])  # fmt: skip


def figure() -> None:
    """Pressures in the plane of bending through the middle: elements above, the energy form's below."""
    drawing, axes = plt.subplots(
        len(ROWS), len(CASES), figsize=(13, 7.4), layout="constrained", sharex=True, sharey=True
    )
    for column, case in zip(axes.T, CASES, strict=True):
        reference = find(read()["reference"], case=case, poisson=RATIO)
        where, pressure = np.array(reference["where"]), np.array(reference["pressure"])
        middle = np.isclose(where[:, 1], SIZE[1] / 2, atol=1e-5)
        low, high = np.quantile(pressure[middle] / 1e3, (0.03, 0.97))
        span = max(0.7 * (high - low), MIN_SPAN / 2)
        limits = ((low + high) / 2 - span, (low + high) / 2 + span)
        grids = [_grid(where[middle], pressure[middle])]
        fields = np.load(kept(case, RATIO, 0.0))
        plane = np.isclose(fields["points"][:, 1], SIZE[1] / 2, atol=1e-6)
        grids += [_grid(fields["points"][plane], fields[name][plane]) for name in ("shown", "acting", "own")]
        for axis, name, grid in zip(column, ROWS, grids, strict=True):
            drawn = panel(axis, *grid, limits)
            axis.set_aspect("equal")
            if case == next(iter(CASES)):
                axis.set_ylabel(f"{name}\nz [mm]")
        column[0].set_title(case)
        column[-1].set_xlabel("x [mm]")
        drawing.colorbar(drawn, ax=column, orientation="horizontal", label="U'(J) [kPa]", shrink=0.8)
    FIGURE.parent.mkdir(parents=True, exist_ok=True)
    drawing.savefig(FIGURE, dpi=90)
    print(f"wrote {FIGURE}")


def _grid(points: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points (n, 3) of a lattice in a plane of constant y as a grid of x, z and values."""
    x, z = (np.unique(np.round(points[:, axis], 5)) for axis in (0, 2))
    order = np.lexsort((np.round(points[:, 2], 5), np.round(points[:, 0], 5)))
    return x, z, values[order].reshape(len(x), len(z)).T


if __name__ == "__main__":
    (figure if "figure" in sys.argv[1:] else print_all)()
