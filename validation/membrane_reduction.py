"""What helps a reduced membrane: the lifting of its tool, the weighting of snapshots, a basis for every phase.

    python validation/membrane_reduction.py

runs the paper's membrane at 5 mm with the three readings of (35), prints the tables and writes them to
docs/validation/membrane_reduction.json. About five minutes.
"""

from __future__ import annotations

from dataclasses import asdict
from itertools import product

import numpy as np
import result_files

import palpate as pt
from palpate.scenes.membrane import membrane

PHASE, EVERY = 0.1, 0.002  # [s]
TRAININGS = {
    "fitted lifting": {"lifting": "fitted"},
    "local lifting": {"lifting": "local"},
    "fitted lifting, relative snapshots": {"lifting": "fitted", "relative": True},
    "local lifting, relative snapshots": {"lifting": "local", "relative": True},
}


def phase(model, loads, start, before=None, **options):
    """Run one phase, from the last frame of a run before it."""
    if before is not None:
        options |= {"displacement": before.displacements[-1], "velocity": before.velocities[-1]}
    return pt.rollout(model, loads, duration=PHASE, every=EVERY, start=start, progress=False, **options)


def both(case, models):
    """Run the two phases with one model each, the second from where the first ended."""
    push = phase(models[0], case.loads, 0.0, step=EVERY / 5)
    return push, phase(models[1], case.loads, PHASE, push)


def projection(model, run):
    """Mean relative error (34) of the best that a reduced model's basis vectors can do for a run."""
    tool = model.cloud.group("tool")
    lifting_part = np.tensordot(run.displacements[:, tool, 2].mean(axis=1), model.lifting[0], 0)
    lifting_part /= model.lifting[0, tool, 2].mean()
    best = lifting_part + model.basis.lift(model.basis.project(run.displacements - lifting_part))
    sizes = np.linalg.norm(run.displacements, axis=2).sum(axis=1)
    moving = sizes > 1e-12 * sizes.max()
    missed = np.linalg.norm(best - run.displacements, axis=2).sum(axis=1)
    return float(np.mean(missed[moving] / sizes[moving]))


def main() -> None:
    """Compute and print the table."""
    rows = []
    for after in ("hold", "release", "return"):
        case = membrane(0.005, after)
        full = [phase(case.model, case.loads, 0.0)]
        full.append(phase(case.model, case.loads, PHASE, full[0]))
        for (name, training), apart, modes in product(TRAININGS.items(), (False, True), (4, 8, 12, 20, 40)):
            if apart and name != "local lifting, relative snapshots":
                continue
            data = full if apart else [full[0].concatenate(full[1])] * 2
            models = [pt.galerkin(case.model, run, modes=modes, prescribed=["tool"], **training) for run in data]
            row = {"then": after, "training": name, "basis": "a phase" if apart else "one", "modes": modes}
            try:
                found = both(case, models)
            except pt.DivergenceError as error:
                row["failed"] = str(error).split(";")[0]
                found = ()
            for label, model, expected, run in zip(("push", "after"), models, full, found, strict=False):
                row[label] = asdict(pt.relative_errors(expected, run)) | {"projection": projection(model, expected)}
                row[label]["time_ratio"] = run.wall_seconds / expected.wall_seconds
            rows.append(row)
            show(row)
            result_files.write("membrane_reduction", rows)


def show(row):
    """Print one row of the table."""
    words = [str(row[name]) for name in ("then", "training", "basis", "modes")]
    for label in ("push", "after"):
        words += [label, *(f"{name} {value:.3g}" for name, value in row.get(label, {}).items())]
    print("  ".join([*words, row.get("failed", "")]), flush=True)


if __name__ == "__main__":
    main()
