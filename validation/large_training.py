"""How long and how much memory the training of a reduced model of a large body takes.

    python validation/large_training.py [--side 46] [--modes 100]

A fixed block of side^3 nodes; 200 smooth random states in place of runs, large enough to be nonlinear. Prints seconds,
sampled nodes and the peak memory of the process, and appends them to docs/validation/large_training.json.
"""

from __future__ import annotations

import argparse
import resource
from time import perf_counter

import numpy as np
import result_files

import palpate as pt

STATES, SHAPES, LARGEST = 200, 120, 0.15  # the largest displacement is this share of the block's side


def states(cloud: pt.Cloud, seed: int = 0) -> pt.Trajectory:
    """Return smooth random states that vanish at the fixed face, as a run."""
    random = np.random.default_rng(seed)
    side = np.ptp(cloud.points, axis=0)
    place = (cloud.points - cloud.points.min(axis=0)) / side
    waves, phases = random.uniform(-2.5, 2.5, (SHAPES, 3)), random.uniform(0, 2 * np.pi, SHAPES)
    shapes = np.sin(np.pi * place @ waves.T + phases).T * place[:, 0]
    fade = 1 / (1 + np.linalg.norm(waves, axis=1) ** 2)
    mixed = random.standard_normal((STATES, 3, SHAPES)) * fade
    fields = np.einsum("tcs,sn->tnc", mixed, shapes)
    fields *= LARGEST * side[0] / np.abs(fields).max() * np.linspace(0.05, 1, STATES)[:, None, None]
    fields[0] = 0.0
    times, zeros = np.linspace(0, 1, STATES), np.zeros(STATES)
    return pt.Trajectory(
        points=cloud.points, times=times, displacements=fields, velocities=np.zeros_like(fields), reactions={},
        kinetic=zeros, strain=zeros, external=zeros, dissipated=zeros, steps=np.arange(STATES), wall_seconds=1.0,
        model="random states", stiffness_damping=0.0,
    )  # fmt: skip


def main() -> None:
    """Train once and say what it took."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--side", type=int, default=46, help="nodes along an edge")
    parser.add_argument("--modes", type=int, default=100)
    chosen = parser.parse_args()
    cloud = pt.box((0.1, 0.1, 0.1), 0.1 / (chosen.side - 1))
    tissue = pt.materials.MooneyRivlin(C1=60e3, C2=1.2e3, density=1120, poisson=0.49)
    body = pt.Solid(cloud, tissue, "x-", form="energy", stiffness_damping=1e-6)
    run = states(cloud)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6
    start = perf_counter()
    model = pt.hyper_reduce(body, run, modes=chosen.modes)
    entry = {
        "nodes": len(cloud),
        "modes": chosen.modes,
        "seconds": perf_counter() - start,
        "sampled": len(model.data.cubature.nodes),
        "cubature_residual": model.report["cubature_residual"],
        "gigabytes_before": before,
        "gigabytes": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e6,
    }
    print(entry)
    result_files.write("large_training", [*result_files.read("large_training", []), entry])


if __name__ == "__main__":
    main()
