"""One force evaluation of the full model over the time of reading its stencil weights once from memory.

    python benchmarks/force.py [--nodes 20000 100000] [--jitter 0 0.2] [--energy]

Each case runs in a process of its own, so that its peak memory can be told. The weights are what an unshared table
holds: 9 derivative weights of 8 bytes for every neighbour of every node; reading them is a sum over that many bytes
with all threads. On a lattice the model reads far fewer, because nodes share their stencils. With --energy the energy
form takes turns with the strong form, in double precision and in that of its steps, with the ratios of their times.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
from functools import partial
from time import perf_counter

import numpy as np


def case(nodes: int, jitter: float, energy: bool) -> dict[str, float]:
    """Measure one cloud."""
    from timing import median_seconds, read_seconds

    import palpate as pt

    side = round(nodes ** (1 / 3))
    cloud = pt.box(((side - 1) * 0.005,) * 3, 0.005, jitter)
    pt.moving_least_squares(pt.box((0.02,) * 3, 0.005).points, neighbours=42)  # compile
    start = perf_counter()
    stencils = pt.moving_least_squares(cloud.points, neighbours=42)
    build = perf_counter() - start
    neighbours = int(np.sum(stencils.neighbours != np.arange(len(cloud))[:, None]))
    del stencils  # the model makes its own; the peak is to be the model's
    law = pt.materials.MooneyRivlin(C1=60e3, C2=1.2e3, density=1120, poisson=0.45)
    start = perf_counter()
    model = pt.Solid(cloud, law, "x-", form="strong", stiffness_damping=5e-5)
    prepare = perf_counter() - start
    u = 1e-4 * np.random.default_rng(0).standard_normal(cloud.points.shape)
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20
    calls = [partial(model.force, u, work=model.workspace())]
    if energy:
        body = pt.Solid(cloud, law, "x-", form="energy")
        calls += [partial(body.force, u, work=body.workspace()), partial(body.step_force, u, body.workspace())]
    force, *others = median_seconds(*calls)
    weights = np.ones(neighbours * 9)
    reading = read_seconds(weights, parallel=True)
    row = {
        "nodes": len(cloud), "jitter": jitter, "neighbours": neighbours / len(cloud), "stencils_s": build,
        "model_s": prepare, "force_ns_per_node": force / len(cloud) * 1e9,
        "read_ns_per_node": reading / len(cloud) * 1e9,
        "read_GB_per_s": weights.nbytes / reading / 1e9, "ratio": force / reading, "peak_GB": memory,
    }  # fmt: skip
    if energy:
        double, single = others
        row |= {
            "energy_form_ns_per_node": double / len(cloud) * 1e9, "energy_form_over_strong": double / force,
            "step_ns_per_node": single / len(cloud) * 1e9, "step_over_double": single / double,
        }  # fmt: skip
    return row


def main() -> None:
    """Run every case and print a table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--nodes", type=int, nargs="+", default=[20_000, 100_000])
    parser.add_argument("--jitter", type=float, nargs="+", default=[0.0, 0.2])
    parser.add_argument("--energy", action="store_true", help="measure the energy form too")
    parser.add_argument("--case", action="store_true", help=argparse.SUPPRESS)
    args = parser.parse_args()
    if args.case:
        print(json.dumps(case(args.nodes[0], args.jitter[0], args.energy)))
        return
    for nodes in args.nodes:
        for jitter in args.jitter:
            command = [sys.executable, __file__, "--case", "--nodes", str(nodes), "--jitter", str(jitter)]
            command += ["--energy"] * args.energy
            row = json.loads(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
            print("  ".join(f"{k} {v:.4g}" for k, v in row.items()), flush=True)


if __name__ == "__main__":
    main()
