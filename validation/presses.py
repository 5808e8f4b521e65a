"""Reduced livers against the full model's held-out presses and grasps: force on the tool, places of the surface.

    palpate train liver --set spacing=8mm radius=20mm depth=20mm --paths 14 --held-out 4 --modes 60 --cubature 1e-3
    python validation/presses.py out/train                       the campaign's own model
    python validation/presses.py out/train --shapes 100          other models from the same runs ...
    python validation/presses.py out/train --cubature 0.01
    python validation/presses.py out/train --shapes 0 --modes 40  ... with modes of the runs in place of smooth ones

It adds a row a path, a press or a grasp, to docs/validation/presses.json, and their means. Force: difference of the two
forces over the full one of the moment, in frames with at least a tenth of its largest, median and 95th percentile.
Surface: distance of the two places of a free node over the largest displacement, 95th percentile over nodes
and those frames, and over those frames of the farthest node.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np
import result_files

import palpate as pt
from palpate.app.train.campaign import MAX_REPEATED
from palpate.app.train.folder import HELD_OUT, jobs
from palpate.reduction.basis.linear_modes import interpolated_modes
from palpate.reduction.contact.coarse_body import coarse_body
from palpate.reduction.contact.residual_flexibility import MAX_NODES
from palpate.scenes.training import open_training

MAX_TRIALS = 1000  # runs of either kind that are looked for
MEANS = ("force", "force_95", "surface_95", "farthest_95")
MIN_FORCE_SHARE = 0.1  # of the largest force: frames that count


def compared(scene, model: pt.ReducedModel, seed: int, full: pt.Trajectory) -> dict[str, Any]:
    """Run a path on the reduced model, and return how it differs from the full one."""
    loads, duration = scene.path(seed)
    own = pt.rollout(model, loads, duration=duration, every=scene.every, progress=False)
    cloud = scene.model.cloud
    fixed = np.concatenate([cloud.group(name) for name in scene.model.fixed])
    free = np.setdiff1d(pt.tools.surface_nodes(cloud), fixed)
    (tool,) = loads
    mine, theirs = own.reactions[tool.name], full.reactions[tool.name]
    size = np.linalg.norm(theirs, axis=1)
    counted = size > MIN_FORCE_SHARE * size.max()
    force = np.linalg.norm(mine - theirs, axis=1)[counted] / size[counted]
    largest = np.linalg.norm(full.displacements[:, free], axis=2).max()
    apart = np.linalg.norm(own.displacements[:, free] - full.displacements[:, free], axis=2)[counted] / largest
    return {
        "kind": "grasp" if isinstance(tool, pt.tools.Grasp) else "press", "seed": seed,
        "force": float(np.median(force)), "force_95": float(np.quantile(force, 0.95)),
        "surface_95": float(np.quantile(apart, 0.95)), "farthest_95": float(np.quantile(apart.max(axis=1), 0.95)),
        "largest": [float(np.linalg.norm(mine, axis=1).max()), float(size.max())],
        "seconds_a_second": own.wall_seconds / duration,
    }  # fmt: skip


def _means(rows: list[dict[str, Any]]) -> dict[str, float]:
    return {name: float(np.mean([row[name] for row in rows])) for name in MEANS}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--shapes", type=int, help="smooth shapes of another model")
    parser.add_argument("--modes", type=int, default=0, help="modes of the runs of another model")
    parser.add_argument("--cubature", type=float)
    args = parser.parse_args()
    manifest = json.loads((args.folder / "campaign.json").read_text())
    scene = open_training(manifest["scene"], manifest["parameters"])
    found = [
        (job, args.folder / "runs" / f"{job.name}.h5") for job in jobs(manifest["seed"], range(MAX_TRIALS), MAX_TRIALS)
    ]
    found = [(job, path) for job, path in found if path.exists()]
    model = pt.load(args.folder / "model.rom")
    if args.shapes is not None or args.modes or args.cubature is not None:
        shapes = model.data.modes if args.shapes is None else args.shapes
        coarse = scene.model if len(scene.model.cloud) <= MAX_NODES else coarse_body(scene.model)
        trained = [(scene.path(job.seed)[0], path) for job, path in found if job.kind != HELD_OUT]
        model = pt.hyper_reduce(
            scene.model, [path for _, path in trained], modes=args.modes, coarse=coarse,
            repeated=trained[:MAX_REPEATED],
            enrichment=interpolated_modes(coarse, scene.model, shapes) if shapes else None,
            cubature=args.cubature,
        )  # fmt: skip
    about = {"shapes": args.shapes, "modes": args.modes, "cubature": args.cubature, **manifest["parameters"]}
    known = ("modes", "nodes", "nodes_full", "training_runs", "compliance_explained")
    about |= {f"model_{name}": model.report[name] for name in known}
    rows = [compared(scene, model, job.seed, pt.Trajectory.load(path)) for job, path in found if job.kind == HELD_OUT]
    print(about)
    for row in rows:
        print({name: value if name == "kind" else np.round(value, 3).tolist() for name, value in row.items()})
    kinds = sorted({row["kind"] for row in rows})
    means = {kind: _means([row for row in rows if row["kind"] == kind]) for kind in kinds}
    print("means", means)
    others = [entry for entry in result_files.read("presses", []) if entry["about"] != about]
    result_files.write("presses", [*others, {"about": about, "means": means, "presses": rows}])


if __name__ == "__main__":
    main()
