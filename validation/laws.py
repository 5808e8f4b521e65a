"""The curves of docs/laws.md: every law in uniaxial tension, equal tension in two directions, and simple shear.

    python validation/laws.py [--out docs/images/laws.png]

Each law has the parameters of its example in `palpate laws`; stresses are over its shear modulus at rest, so that all
curves leave rest with one slope and differ by how they go on. The volume is kept.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from palpate.tissue.catalogue import LAWS

PATHS = {
    "uniaxial": ("stretch", np.linspace(0.55, 1.9, 271), lambda s: (s, s**-0.5, s**-0.5), 1.0, 3.0),
    "equibiaxial": ("stretch", np.linspace(0.75, 1.5, 271), lambda s: (s, s, s**-2.0), 0.5, 6.0),
}
SHEAR = np.linspace(0.0, 1.6, 271)
STYLES = {"NeoHookean": "k-", "LinearElastic": "k:", "StVenantKirchhoff": "k--"}


def energies(material: Any, path: str) -> tuple[Any, Any]:
    """Return the amounts along a path, and the energy [J/m^3] along it."""
    if path == "simple shear":
        return SHEAR, material.shear_energy(np.eye(3) + SHEAR[:, None, None] * np.diag([1.0, 0.0], k=1))
    measure, stretches = PATHS[path][1], PATHS[path][2]
    return measure, material.shear_energy(np.stack(stretches(measure), axis=-1)[:, :, None] * np.eye(3))


def main() -> None:
    """Draw."""
    import matplotlib.pyplot as plt

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--out", type=Path, default=Path("docs/images/laws.png"))
    out = parser.parse_args().out
    figure, axes = plt.subplots(1, 3, figsize=(13, 4.8), layout="constrained")
    for axis, path in zip(axes, [*PATHS, "simple shear"], strict=True):
        for law in LAWS:
            material = law.kind(**law.example, density=1000.0, poisson=0.5)
            if law.name == "LinearElastic":
                measure = SHEAR if path == "simple shear" else PATHS[path][1]
                stress = measure if path == "simple shear" else PATHS[path][4] * (measure - 1)
            else:
                measure, energy = energies(material, path)
                share = 1.0 if path == "simple shear" else PATHS[path][3]
                stress = share * np.gradient(energy, measure, edge_order=2) / material.shear_modulus
            axis.plot(measure, stress, STYLES.get(law.name, "-"), linewidth=1.4, label=law.name)
        axis.set(title=path, ylim=(-8, 8) if path in PATHS else (0, 8))
        axis.set_xlabel("amount of shear" if path == "simple shear" else "stretch")
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("nominal stress / shear modulus")
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right center", frameon=False)
    figure.savefig(out, dpi=110)
    print(f"wrote {out}")


if __name__ == "__main__":
    main()
