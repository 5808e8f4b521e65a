"""Processor time of a sub-step of a blade in the engine, early and late in a cut, and against another checkout.

    NUMBA_NUM_THREADS=1 python benchmarks/cutting.py [--spacing 0.0029] [--against FOLDER --rounds 3]

A blade of 30 mm goes down through a box of 60 x 50 x 40 mm, by a tenth of the spacing at a time, and the cutter of the
engine cuts the body without the loop next to it. Times are over that of a fixed loop before and after each sub-step,
because speeds of a machine vary. `--against` runs both checkouts in turn, in a process each, and compares digests of
the sites, the totals of the blade and the sums over the rows of the body.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import subprocess
import sys
from pathlib import Path
from time import process_time
from typing import Any

import numpy as np
from numba import njit

import palpate as pt
from palpate.dynamics.nodal.tool_path import END, HOME

START, DEPTH = 0.045, 0.033  # height of the blade at first, and its way [m]
SHARE = 0.25  # of the sub-steps that are early, and that are late


@njit
def _loop(values):
    total = 0.0
    for _ in range(40):
        for i in range(values.size):
            total += values[i] * values[(7919 * i) % values.size] / (1.0 + total * total)
    return total


def _loop_seconds(values: np.ndarray) -> float:
    times = []
    for _ in range(3):
        began = process_time()
        _loop(values)
        times.append(process_time() - began)
    return float(np.median(times))


def cut_box(spacing: float) -> dict[str, object]:
    """Cut the box; return the times of early and late sub-steps over that of the loop, and a digest of the results."""
    cloud = pt.box((0.06, 0.05, 0.04), spacing=spacing, jitter=0.2)
    tissue = pt.materials.MooneyRivlin(C1=1500.0, C2=0, density=1060.0, poisson=0.45)
    blade = pt.tools.Blade([(-0.015, 0, 0), (0.015, 0, 0)], toughness=5.0)
    tool = pt.tools.Contact(blade, ((0.03, 0.0252, START), (0, 0, 0)))
    cutter: Any = pt.realtime_model(pt.Solid(cloud, tissue, fixed="z-"), contact=tool).cutter
    coordinates = np.column_stack([0.01 * cloud.points[:, 2], np.zeros((len(cloud), 2))]).ravel()  # sheared
    values, ratios, digest = np.random.default_rng(0).random(4000), [], hashlib.sha256()
    _loop(values)
    for height in np.arange(START, START - DEPTH, -0.1 * spacing):
        path = cutter.data.tools.path[cutter.blade]
        path[END][2, 3], path[HOME][2, 3] = height, max(path[HOME][2, 3], height)
        cuts, loop = cutter.cuts, _loop_seconds(values)
        began = process_time()
        cutter.update(coordinates)
        seconds = process_time() - began
        if cutter.cuts > cuts:
            ratios.append(2 * seconds / (loop + _loop_seconds(values)))
            sites, state = cutter.data.tools.contacts.sites, cutter.model.cut_state
            for array in (sites.weights, sites.directions, sites.limits, cutter.totals, state.sums, state.checks):
                digest.update(np.ascontiguousarray(array).tobytes())
    part = int(SHARE * len(ratios))
    early, late = (float(np.median(each)) for each in (ratios[1:part], ratios[-part:]))
    return {"nodes": len(cloud), "cuts": len(ratios), "early": early, "late": late, "digest": digest.hexdigest()[:12]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--spacing", type=float, default=0.0029, help="of the nodes [m]")
    parser.add_argument("--against", type=Path, help="folder of another checkout")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--case", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.case or options.against is None:
        print(json.dumps(cut_box(options.spacing)))
        return
    results: list[list[dict[str, float]]] = [[], []]
    for _ in range(options.rounds):
        for folder, into in zip((options.against, Path(__file__).parents[1]), results, strict=True):
            command = [sys.executable, __file__, "--case", "--spacing", str(options.spacing)]
            environment = {**os.environ, "PYTHONPATH": str((folder / "src").resolve())}
            text = subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout
            into.append(json.loads(text.splitlines()[-1]))
            print(folder, into[-1], flush=True)
    for part in ("early", "late"):
        before, now = (np.array([each[part] for each in side]) for side in results)
        print(f"{part}: {np.median(now) / np.median(before):.2f} of the time (rounds: {np.round(now / before, 2)})")
    print("digests are equal" if len({each["digest"] for side in results for each in side}) == 1 else "digests differ")


if __name__ == "__main__":
    main()
