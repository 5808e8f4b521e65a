"""The change of a tool's force by the border of a liver's support: linear statics against runs of the full model.

    python validation/moved_supports.py --set spacing=0.009 radius=0.0225 depth=0.016 --paths 11

The full model runs along each path of the scene with its own support, and with the border one ring of surface nodes
further out and in. Printed are the changes of the force, summed over the frames with at least 0.3 of the largest, and
those of the statics (`palpate.reduction.contact.support_sensitivity`) at the frame of the largest force.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

import palpate as pt
from palpate.reduction.contact.support_sensitivity import moved_borders, select_presses, support_sensitivity
from palpate.scenes.training import open_training

PRESSED = 0.3  # of the largest force: frames that count


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--set", nargs="+", default=[], dest="given", metavar="NAME=X")
    parser.add_argument("--paths", type=int, default=11)
    args = parser.parse_args()
    scene = open_training("liver", dict(pair.split("=") for pair in args.given))
    body, found = scene.model, []
    cloud = body.cloud
    outer, inner, distance = moved_borders(cloud, body.supports)
    bodies = {"own": body}
    for way, groups in (("outward", outer), ("inward", inner)):
        moved = replace(cloud, groups={**cloud.groups, **groups})
        bodies[way] = pt.Solid(moved, body.material, body.supports, mass_damping=body.mass_damping)
    print(f"{len(cloud)} nodes; the border moves by {1e3 * distance:.2g} mm")
    for seed in range(args.paths):
        (load,), duration = scene.path(seed)
        runs = {
            way: pt.rollout(each, [load], duration=duration, every=scene.every, progress=False)
            for way, each in bodies.items()
        }
        statics = support_sensitivity(body, cloud.points, select_presses([runs["own"]]))
        if statics is None:
            print(f"path {seed}: at the border")
            continue
        force = {way: np.linalg.norm(run.reactions[load.name], axis=1) for way, run in runs.items()}
        on = force["own"] > PRESSED * force["own"].max()
        for way in ("outward", "inward"):
            pair = statics["border"][way]["largest"], force[way][on].sum() / force["own"][on].sum() - 1
            found.append(pair)
            print(f"path {seed}, {load.name}, {way}: statics {pair[0]:+.1%}, runs {pair[1]:+.1%}", flush=True)
    linear, run = np.array(found).T
    missed = np.abs(linear - run)
    print(f"difference: median {np.median(missed):.1%}, largest {missed.max():.1%}; "
          f"statics over runs: median {np.median(linear / run):.2f}")  # fmt: skip


if __name__ == "__main__":
    main()
