"""A bar of two kinds of tissue, one behind the other, against its closed form.

    python validation/interfaces.py [--cells 9 17 33 8 16 32]

writes docs/validation/interfaces.json and prints the table. Small: one half 4 times softer or 5 times stiffer than the
other at nu = 0, free sides, the stiffness at rest under a small pull. Large: two Gent materials of other shear moduli,
limits and Poisson's ratios, their sides fixed, pulled until the softer is half as long again; the closed form is the
stretch of either at which its stress P11 of diag(l, 1, 1) is that of the pull. With an odd number of cells the
interface lies midway between nodes; with an even one nodes lie on it: they are counted to the first half, and the
closed form has its interface half a spacing further; or, where a stiffness tells the halves apart, they have the mean
of the compliances.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np
import result_files
from scipy.optimize import brentq, newton_krylov
from scipy.sparse.linalg import LinearOperator, splu

import palpate as pt
from palpate.reduction.basis.linear_modes import rest_stiffness

LENGTH, ACROSS = 0.08, 4  # cells across: the lattice is even in all directions
TISSUE = {"density": 1000.0, "poisson": 0.0}
SOFT = pt.materials.Gent(mu=8e3, Jm=3.0, density=1000.0, poisson=0.3)
STIFF = pt.materials.Gent(mu=20e3, Jm=0.5, density=1000.0, poisson=0.4)
STRETCH = 1.5  # of the softer half of a large pull


def bar(cells: int) -> pt.Cloud:
    """Lay out the bar, its further half a group."""
    cloud = pt.box((LENGTH, ACROSS * LENGTH / cells, ACROSS * LENGTH / cells), LENGTH / cells)
    x = cloud.points[:, 0]
    groups = {"far": np.flatnonzero(x > LENGTH / 2 + 1e-9), "middle": np.flatnonzero(np.abs(x - LENGTH / 2) < 1e-9)}
    return replace(cloud, groups=cloud.groups | {name: nodes for name, nodes in groups.items() if len(nodes)})


def loads(model: pt.Solid, force: float) -> np.ndarray:
    """Nodal forces [N] of a pull, (3 n,)."""
    prepared = model.prepare([pt.SurfaceForce("x+", force=lambda t: (force, 0.0, 0.0))])
    return model.external_force(model.state(prepared), prepared).ravel()


def tip(model: pt.Solid, u: np.ndarray) -> float:
    return float(u.reshape(-1, 3)[model.cloud.group("x+"), 0].mean())


def area(cells: int) -> float:
    """Cross-section [m^2] of the bar."""
    return (ACROSS * LENGTH / cells) ** 2


def middle(cells: int) -> float:
    """Where the interface counts as: half a spacing beyond nodes that lie on it and belong to the first half."""
    return LENGTH / 2 + (LENGTH / cells / 2 if cells % 2 == 0 else 0.0)


def small(cells: int, ratio: float, kind: str) -> float:
    """Error of the stretch of a bar whose further half is stiffer, told by `kind`."""
    cloud, law, stress = bar(cells), pt.materials.NeoHookean(C1=5e3, **TISSUE), 1.0
    stiff = pt.materials.NeoHookean(C1=5e3 * ratio, **TISSUE)
    if kind == "materials":
        model = pt.Solid(cloud, {"": law, "far": stiff}, "x-", form="energy")
    else:
        between = {"middle": 2 / (1 + 1 / ratio)} if kind == "mean compliance" else {}
        model = pt.Solid(cloud, law, "x-", form="energy", stiffness={"far": ratio} | between)
    free = np.flatnonzero(np.repeat(~model.fixed_mask, 3))
    u = np.zeros(3 * len(cloud))
    u[free] = splu(rest_stiffness(model)[free][:, free].tocsc()).solve(loads(model, stress * area(cells))[free])
    place = LENGTH / 2 if kind == "mean compliance" else middle(cells)
    return tip(model, u) / (stress / 2e4 * (place + (LENGTH - place) / ratio)) - 1


def pull(material: pt.materials.Material, stretch: float) -> float:
    """Stress P11 [Pa] of tissue whose sides are fixed."""
    return float(material.stress(np.diag([stretch, 1.0, 1.0]))[0, 0])


def large(cells: int, first: pt.materials.Material, second: pt.materials.Material) -> float:
    """Error of the stretch of a bar of two materials, its sides fixed."""
    cloud, stress = bar(cells), pull(SOFT, STRETCH)
    model = pt.Solid(cloud, {"": first, "far": second}, "x-", form="energy")
    outside = loads(model, stress * area(cells))
    free = 3 * np.flatnonzero(~model.fixed_mask)
    inverse = splu(rest_stiffness(model)[free][:, free].tocsc())
    u = np.zeros(3 * len(cloud))
    start = np.zeros(len(free))
    for part in np.linspace(0.1, 1.0, 10):

        def balance(x: np.ndarray, share: float = part) -> np.ndarray:
            u[free] = x
            return (model.force(u.reshape(-1, 3)) * model.volumes[:, None]).ravel()[free] + share * outside[free]

        solver = LinearOperator(inverse.shape, matvec=inverse.solve)
        start = newton_krylov(balance, start, inner_M=solver, f_tol=1e-7 * np.abs(outside).max(), maxiter=60)
    u[free] = start
    stretches = [brentq(lambda s, m=m: pull(m, s) - stress, 1.0, 3.0, xtol=1e-12) for m in (first, second)]
    place = middle(cells)
    expected = (stretches[0] - 1) * place + (stretches[1] - 1) * (LENGTH - place)
    return tip(model, u) / expected - 1


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cells", type=int, nargs="+", default=[9, 17, 33, 8, 16, 32])
    args = parser.parse_args()
    report = []
    for cells in args.cells:
        found = {"uniform": small(cells, 1.0, "materials")}
        for ratio in (0.25, 5.0):
            found[f"small, {ratio:g} times as stiff"] = small(cells, ratio, "materials")
            if cells % 2 == 0:
                found[f"small, {ratio:g} times as stiff, mean compliance"] = small(cells, ratio, "mean compliance")
        found["large, soft"] = large(cells, SOFT, SOFT)
        found["large, soft then stiff"] = large(cells, SOFT, STIFF)
        found["large, stiff then soft"] = large(cells, STIFF, SOFT)
        report.append({"cells": cells, "spacing": LENGTH / cells, "error": found})
        print(f"{cells} cells, {1e3 * LENGTH / cells:.2f} mm")
        for name, error in found.items():
            print(f"  {name:45s} {error:+.2%}", flush=True)
    result_files.write("interfaces", report)


if __name__ == "__main__":
    main()
