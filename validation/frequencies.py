"""First bending, torsion and axial frequencies of a clamped block, 100 x 20 x 20 mm, against finite elements.

    python validation/frequencies.py [--forms strong energy] [--spacings 0.005 0.004]

prints the table and brings docs/validation/frequencies.json up to date. All eigenvalues of the dense tangent are
computed.
"""

from __future__ import annotations

import argparse
import json
from itertools import product
from pathlib import Path

import numpy as np
import result_files

import palpate as pt
from palpate.dynamics.nodal.stability import stiffness

HERE = Path(__file__).parent
SIZE = (0.1, 0.02, 0.02)


def body(spacing: float, poisson: float, form: str) -> pt.Solid:
    law = pt.materials.MooneyRivlin(C1=60e3, C2=1.2e3, density=1120, poisson=poisson)
    return pt.Solid(pt.box(SIZE, spacing), law, "x-", form=form, stiffness_damping=0.0)


def vibrations(model: pt.Solid) -> tuple[np.ndarray, np.ndarray]:
    """Eigenvalues w^2 [1/s^2], and the shapes of the free nodes (nodes, 3, modes)."""
    tangent = stiffness(model)
    if model.form == "energy":  # symmetric in the nodal volumes
        root = np.sqrt(np.repeat(model.volumes[~model.fixed_mask], 3))
        symmetric = tangent * root[:, None] / root
        values, vectors = np.linalg.eigh((symmetric + symmetric.T) / 2)
        vectors /= root[:, None]
    else:
        values, vectors = np.linalg.eig(tangent)
    return values, vectors.real.reshape(-1, 3, len(values))


def first_modes(model: pt.Solid) -> tuple[dict[str, float], int]:
    """First bending, torsion and axial circular frequency [rad/s], and the number of negative real parts."""
    values, shapes = vibrations(model)
    mean = np.abs(shapes.mean(axis=0))  # (3, modes): an axial mode moves all nodes along x
    axial = (mean[0] > 3 * mean[1:].max(axis=0)) & (np.abs(shapes).mean(axis=(0, 1)) < 2 * mean[0])
    y, z = (model.cloud.points[~model.fixed_mask, 1:] - 0.5 * SIZE[1]).T
    turn = y @ shapes[:, 2] - z @ shapes[:, 1]  # a torsion turns all sections alike
    torsion = turn**2 > 0.5 * np.sum(y**2 + z**2) * np.sum(shapes**2, axis=(0, 1))
    oscillating = (values.real > 0) & (np.abs(values.imag) < 1e-3 * np.abs(values))
    kinds = {"bending": oscillating, "torsion": oscillating & torsion, "axial": oscillating & axial}
    found = {kind: float(np.sqrt(values.real[which].min())) for kind, which in kinds.items()}
    return found, int(np.sum(values.real < 0))


def main() -> None:
    """Compute and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--forms", nargs="+", default=["strong", "energy"])
    parser.add_argument("--poisson", type=float, nargs="+", default=[0.3, 0.45, 0.49])
    parser.add_argument("--spacings", type=float, nargs="+", default=[0.02 / 3, 0.005, 0.004])
    args = parser.parse_args()
    reference = json.loads((HERE / "reference" / "finite_elements.json").read_text())["frequencies"]
    rows = result_files.read("frequencies", [])
    for form, poisson, spacing in product(args.forms, args.poisson, args.spacings):
        target = next(r for r in reference if r["length"] == SIZE[0] and r["poisson"] == poisson)
        found, negative = first_modes(body(spacing, poisson, form))
        key = {"form": form, "poisson": poisson, "spacing": spacing}
        errors = {f"{kind}_error": value / target[kind] - 1 for kind, value in found.items()}
        rows = [row for row in rows if any(row[k] != v for k, v in key.items())]
        rows.append({**key, **found, "negative": negative, **errors})
        print(
            "  ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in rows[-1].items()), flush=True
        )
        result_files.write("frequencies", rows)


if __name__ == "__main__":
    main()
