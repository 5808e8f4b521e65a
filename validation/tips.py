"""Static tip of the paper's beam, pulled and bent, against the finite-element reference.

    python validation/tips.py [--spacings 0.005 0.0025] [--forms strong energy]

writes docs/validation/tips.json and prints the table. The reference is validation/reference/finite_elements.json. The
half cell is the strong form's; the energy form has half cells, c = 2.
"""

from __future__ import annotations

import argparse
import json
from itertools import product
from pathlib import Path

import numpy as np
import result_files
from scipy.interpolate import RegularGridInterpolator

import palpate as pt

HERE = Path(__file__).parent


def body(spacing: float, poisson: float, form: str, half_cell: float) -> pt.Solid:
    cloud = pt.box((0.2, 0.02, 0.02), spacing)
    law = pt.materials.MooneyRivlin(C1=60e3, C2=1.2e3, density=1120, poisson=poisson)
    if form == "energy":
        return pt.Solid(cloud, law, "x-", form="energy")
    # more than the default stiffness damping: it changes no static state
    return pt.Solid(cloud, law, "x-", form="strong", stiffness_damping=1.8e-2 * spacing, half_cell=half_cell)


def tips(model: pt.Solid, kind: str, forces: list[float], starts: list[np.ndarray] | None) -> list[np.ndarray]:
    """Displacements (n, 3) [m] under load after load; from given states, the coarser body's, if there are any."""
    direction = np.array([0.0, 0.0, 1.0] if kind == "sideways" else [1.0, 0.0, 0.0])
    found = [np.zeros_like(model.cloud.points)]
    for k, force in enumerate(forces):
        start = starts[k] if starts else found[-1]
        load = pt.SurfaceForce("x+", force=force * direction)
        found.append(pt.equilibrium(model, [load], displacement=start).displacements)
    return found[1:]


def refined(coarse: pt.Cloud, states: list[np.ndarray], fine: pt.Cloud) -> list[np.ndarray]:
    """Interpolate states of one lattice to another."""
    axes = [np.unique(np.round(coarse.points[:, a], 9)) for a in range(3)]
    shape = [len(axis) for axis in axes]
    fields = [
        RegularGridInterpolator(axes, u.reshape(*shape, 3), method="cubic", bounds_error=False, fill_value=None)
        for u in states
    ]
    return [field(fine.points) for field in fields]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--spacings", type=float, nargs="+", default=[0.005, 0.0025])
    parser.add_argument("--forms", nargs="+", default=["strong", "energy"])
    parser.add_argument("--poisson", type=float, nargs="+", default=[0.3, 0.45, 0.49])
    parser.add_argument("--kinds", nargs="+", default=["sideways", "axial"])
    parser.add_argument("--half-cell", type=float, default=3.0)
    args = parser.parse_args()
    reference = json.loads((HERE / "reference" / "finite_elements.json").read_text())
    rows = result_files.read("tips", [])
    bodies = [(form, args.half_cell if form == "strong" else 2.0) for form in args.forms]
    for kind, poisson, (form, half_cell) in product(args.kinds, args.poisson, bodies):
        expected = [r for r in reference[kind] if r["poisson"] == poisson]
        starts, coarse = None, None
        for spacing in args.spacings:
            model = body(spacing, poisson, form, half_cell)
            if coarse is not None and starts is not None:
                starts = refined(coarse, starts, model.cloud)
            try:
                starts, coarse = tips(model, kind, [r["force"] for r in expected], starts), model.cloud
            except (RuntimeError, ValueError) as error:
                print(f"{kind} {spacing} {poisson} {form}: unstable ({error})", flush=True)
                break
            for r, u in zip(expected, starts, strict=True):
                tip, target = u[model.cloud.group("x+")].mean(axis=0), np.array(r["mean_tip"])
                error = float(np.linalg.norm(tip - target) / np.linalg.norm(target))
                key = {
                    "kind": kind, "spacing": spacing, "poisson": poisson, "form": form, "force": r["force"],
                    "half_cell": half_cell,
                }  # fmt: skip
                rows = [row for row in rows if any(row[k] != v for k, v in key.items())]
                rows.append({**key, "tip": tip.tolist(), "reference": target.tolist(), "error": error})
                print(*key.values(), np.round(tip * 1e3, 3), np.round(target * 1e3, 3), f"{error:.2%}", flush=True)
            result_files.write("tips", rows)


if __name__ == "__main__":
    main()
