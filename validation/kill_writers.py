"""Kill every writer of files in the middle, again and again, and see that its file is the old one or the new one.

    python validation/kill_writers.py --kills 20 --seed 1

A process writes a file without pause, with two contents in turn, until it is killed after a random time. The script
prints how often each content was found, and ends with status 1 if a file is neither, or cannot be loaded.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

os.environ |= {"OPENBLAS_NUM_THREADS": "1", "NUMBA_NUM_THREADS": "1", "NUMBA_THREADING_LAYER": "workqueue"}

import numpy as np
from fuzz_kinds import bar, fingerprint, model, pressed, recording

import palpate as pt
from palpate.app.recordings.recording import load_recording, save_recording
from palpate.core.files import read_sealed_json, write_sealed_json
from palpate.core.vtk import write_vtkhdf
from palpate.realtime.black_box import RingBuffer, append_record, write_black_box
from palpate.realtime.record import record_size

Writer = tuple[str, Callable[[Path, int], None], Callable[[Path], Any]]


def writers() -> dict[str, Writer]:
    """Return, by name, the file's name, a function that writes one of two contents, and one that loads it."""
    run, body, seen = pressed(), model(), recording()
    system = pt.lti.linearise(bar(), [pt.SurfaceForce("x+", force=lambda t: (t, 0.0, 0.0))], ["x+"])
    linear = [pt.lti.reduce_linear(system, "modal", k) for k in (3, 4)]
    runs = [run, replace(run, model="other")]
    bodies = [body, body.with_step(1e-4)]
    records = [seen, replace(seen, title="Other")]

    def streamed(path: Path, k: int) -> None:
        pt.rollout(bar(), [pt.Gravity()], duration=2e-3, every=1e-3, file=path, label=str(k), progress=False)

    def black_box(path: Path, k: int) -> None:
        ring = RingBuffer.empty(5, 4)
        for row in range(k + 2):
            append_record(ring, np.full(record_size(4, 1), float(row)))
        write_black_box(path, ring, 1, {})

    def paraview(path: Path, k: int) -> None:
        fields = {"displacement": run.displacements[:2] * k}
        write_vtkhdf(path, run_cloud.points, run_cloud.triangles, np.arange(2.0), fields)

    run_cloud = bar().cloud
    import h5py

    def some_hdf5(path: Path) -> Any:
        with h5py.File(path) as file:
            found: dict[str, Any] = {}
            file.visititems(lambda name, item: found.update({name: item[()]} if hasattr(item, "dtype") else {}))
            return found

    def matlab(path: Path) -> Any:
        from scipy.io import loadmat

        return loadmat(path)["points"]

    return {
        "trajectory": ("run.h5", lambda path, k: runs[k].save(path), pt.Trajectory.load),
        "run": ("run.h5", streamed, lambda path: len(pt.Trajectory.load(path).times) > 0),
        "model": ("body.rom", lambda path, k: pt.save(bodies[k], path), pt.load),
        "linear model": ("bar.lti", lambda path, k: pt.save(linear[k], path), lambda path: pt.load(path, system)),
        "recording": ("seen.h5", lambda path, k: save_recording(path, records[k]), load_recording),
        "manifest": (
            "campaign.json", lambda path, k: write_sealed_json(path, {"k": [k] * 999}),
            lambda path: read_sealed_json(path, "campaign"),
        ),
        "black box": ("box.h5", black_box, some_hdf5),
        "ParaView": ("body.vtkhdf", paraview, some_hdf5),
        "MATLAB": ("system.mat", lambda path, k: pt.lti.save_matlab(system, path), matlab),
    }  # fmt: skip


def killed(writer: Writer, folder: Path, after: float, first: int) -> None:
    """Let a process write without pause, and kill it after a time [s] since its first file."""
    name, write, _ = writer
    child = os.fork()
    if child == 0:
        try:
            k = first
            while True:
                write(folder / name, k % 2)
                k += 1
        finally:
            os._exit(1)
    time.sleep(after)
    os.kill(child, signal.SIGKILL)
    _, status = os.waitpid(child, 0)
    if not os.WIFSIGNALED(status):
        raise RuntimeError(f"the writer of {name} ended by itself")


def study(kills: int, seed: int) -> tuple[dict[str, Any], int]:
    """Kill each writer some times; return what was found, and the number of faults."""
    rng, found, faults = np.random.default_rng(seed), {}, 0
    for title, writer in writers().items():
        counts: Counter[str] = Counter()
        with TemporaryDirectory(prefix="palpate-kill-") as place:
            folder, (name, write, load) = Path(place), writer
            known = {}
            for k in (0, 1):
                begun = time.monotonic()
                write(folder / name, k)
                took = time.monotonic() - begun
                known[fingerprint(load(folder / name))] = f"content {k}"
            for kill in range(kills):
                killed(writer, folder, float(rng.uniform(0.2, 3.2)) * max(took, 2e-3), kill)
                try:
                    counts[known.get(fingerprint(load(folder / name)), "neither")] += 1
                except Exception as error:
                    counts[f"{type(error).__name__}: {error}"] += 1
            visible = sorted(path.name for path in folder.iterdir() if not path.name.startswith("."))
            hidden = len(list(folder.iterdir())) - len(visible)
            stray = [each for each in visible if each not in (name, Path(name).with_suffix(".vtkhdf").name)]
        found[title] = {"found": dict(counts), "stray files": stray, "hidden partial files": hidden}
        faults += len(stray) + sum(count for what, count in counts.items() if not what.startswith("content"))
    return found, faults


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kills", type=int, default=20, help="of each writer (20)")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    found, faults = study(options.kills, options.seed)
    for title, counts in found.items():
        print(title, json.dumps(counts))
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
