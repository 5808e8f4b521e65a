"""What limits the stable step of the energy form: the place of the fastest vibration, and the margin of the step.

    python validation/stable_step.py

For a box on a lattice, a box of jittered nodes and two livers the script prints

- the highest frequency at rest over that of a wave of two spacings, and the nodes that vibrate;
- the largest step that a free vibration of small random velocities survives, over the step that runs take;
- the step that would be stable if the nodes had at least a share of the median nodal mass.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sparse
from scipy.sparse.linalg import eigsh

import palpate as pt
from palpate.reduction.basis.linear_modes import rest_stiffness
from palpate.scenes.liver import _model

FACTORS = np.arange(1.0, 1.41, 0.02)  # steps tried, over the stable step
SHARES = (0.15, 0.25, 0.5)  # least nodal masses, over the median
STEPS = 3000  # of a trial


def fastest(model: pt.Solid, masses: np.ndarray) -> tuple[float, np.ndarray]:
    """Return the highest frequency [rad/s] at rest and each node's share of that mode's kinetic energy."""
    free = model.free_directions
    diagonal = (free.T @ sparse.diags(np.repeat(masses, 3)) @ free).diagonal()
    root = sparse.diags(1 / np.sqrt(diagonal))
    values, vectors = eigsh((root @ (free.T @ rest_stiffness(model) @ free) @ root).tocsr(), k=1, which="LA", tol=1e-8)
    fields = (free @ (root @ vectors[:, 0])).reshape(-1, 3)
    energy = masses * np.sum(fields**2, axis=1)
    return float(np.sqrt(values[0])), energy / energy.sum()


def largest_step(model: pt.Solid) -> float:
    """Return the largest step that a free vibration survives, over the step that runs take."""
    prepared, work = model.prepare([]), model.workspace()
    noise = 1e-6 * np.random.default_rng(0).standard_normal((len(model.cloud), 3))
    survived = 0.0
    for factor in FACTORS:
        state = model.state(prepared, velocity=noise)
        first = model.outputs(state, prepared).kinetic
        with np.errstate(all="ignore"):
            state, _ = model.advance(state, prepared, factor * model.stability.step, STEPS, work)
            kinetic = model.outputs(state, prepared).kinetic
        if not kinetic <= first:
            break
        survived = factor
    return survived


def main() -> None:
    tissue = pt.materials.NeoHookean(C1=500.0, density=1000.0, poisson=0.45)
    bodies = {
        "box": pt.Solid(pt.box((0.1, 0.02, 0.02), 0.004), tissue, "x-"),
        "jittered box": pt.Solid(pt.box((0.1, 0.02, 0.02), 0.004, 0.2), tissue, "x-"),
        "liver, 12 mm": _model(0.012, 0.45),
        "liver, 9 mm": _model(0.009, 0.45),
    }
    for name, model in bodies.items():
        law, median = model.material, float(np.median(model.masses))
        highest, share = fastest(model, model.masses)
        wave = np.pi / model.cloud.spacing * np.sqrt((law.lame + 2 * law.shear_modulus) / law.density)
        order = np.argsort(share)[::-1][:4]
        print(f"{name}: {len(model.cloud)} nodes, masses {model.masses.min() / median:.2f} to "
              f"{model.masses.max() / median:.1f} of the median")  # fmt: skip
        print(f"  highest frequency {highest / wave:.2f} of a wave of two spacings; four nodes have "
              f"{share[order].sum():.0%} of its energy, with {model.masses[order].mean() / median:.2f} of the median "
              f"mass; nodes below half of it have {share[model.masses < 0.5 * median].sum():.0%}")  # fmt: skip
        print(f"  steps are stable up to {largest_step(model):.2f} times the step of runs")
        for least in SHARES:
            own = np.maximum(model.masses, least * median)
            ratio = highest / fastest(model, own)[0]
            print(f"  masses of at least {least:.0%} of the median: steps {ratio:.2f} times as long, "
                  f"{own.sum() / model.masses.sum() - 1:.2%} more mass")  # fmt: skip


if __name__ == "__main__":
    main()
