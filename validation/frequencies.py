"""First bending and axial frequencies of a clamped block, 100 x 20 x 20 mm, against finite elements.

    python validation/frequencies.py

prints the table and writes docs/validation/frequencies.json. All eigenvalues of the dense tangent are computed.
"""

from __future__ import annotations

import json
from itertools import product
from pathlib import Path

import numpy as np

import palpate as pt
from palpate.dynamics.stability import stiffness

HERE = Path(__file__).parent
OUTPUT = HERE.parent / "docs" / "validation" / "frequencies.json"
LENGTH = 0.1


def first_modes(spacing: float, poisson: float, pressure: str) -> tuple[float, float, int]:
    """First bending and first axial circular frequency [rad/s], and the number of negative real parts."""
    law = pt.MooneyRivlin(C1=60e3, C2=1.2e3, density=1120, poisson=poisson)
    model = pt.FullModel(pt.box((LENGTH, 0.02, 0.02), spacing), law, "x-", viscosity=0.0, pressure=pressure)
    values, vectors = np.linalg.eig(stiffness(model))
    shapes = vectors.real.reshape(-1, 3, vectors.shape[1])
    mean = np.abs(shapes.mean(axis=0))  # (3, modes): an axial mode moves all nodes along x
    axial = (mean[0] > 3 * mean[1:].max(axis=0)) & (np.abs(shapes).mean(axis=(0, 1)) < 2 * mean[0])
    oscillating = (values.real > 0) & (np.abs(values.imag) < 1e-3 * np.abs(values))
    first = np.sqrt(values.real[oscillating].min())
    return float(first), float(np.sqrt(values.real[oscillating & axial].min())), int(np.sum(values.real < 0))


def main() -> None:
    """Compute and print the table."""
    reference = json.loads((HERE / "reference" / "finite_elements.json").read_text())["frequencies"]
    rows = []
    for pressure, poisson, spacing in product(("split", "direct"), (0.3, 0.45, 0.49), (0.02 / 3, 0.005, 0.004)):
        target = next(r for r in reference if r["length"] == LENGTH and r["poisson"] == poisson)
        bending, axial, negative = first_modes(spacing, poisson, pressure)
        rows.append({
            "pressure": pressure, "poisson": poisson, "spacing": spacing, "bending": bending, "axial": axial,
            "negative": negative, "bending_error": bending / target["bending"] - 1,
            "axial_error": axial / target["axial"] - 1,
        })  # fmt: skip
        print(
            "  ".join(f"{k} {v:.4g}" if isinstance(v, float) else f"{k} {v}" for k, v in rows[-1].items()), flush=True
        )
        OUTPUT.parent.mkdir(parents=True, exist_ok=True)
        OUTPUT.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
