"""Every organ surface at hand by the commands a newcomer uses, with default choices: how long, and how good.

For each surface `palpate new` writes a scene file; `palpate run --full --script` presses the full body by a script (the
time to its end, less the length of the script, bounds the time to the first force); `palpate train` makes the small
model of the defaults; and again with 32 paths and 10 held-out ones.

    python validation/organ_models.py [--only NAME] [--small] [--folder out/organs] [--held-out] [--table]

Results are added to docs/validation/organ_models.json, one organ a line. Of the model
with 32 paths the errors of each held-out path are kept, too; --held-out measures these only, on models in the folder.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
import result_files
from organs import DATA, SURFACES

import palpate as pt
from palpate.app.train.folder import jobs
from palpate.app.train.scene_folder import training_folder
from palpate.reduction.training.errors import contact_errors
from palpate.scenes.training import training_of

PATHS, HELD_OUT = 32, 10
PRESS_SECONDS, DEPTH = 1.0, 0.2  # [s] of the script; depth of its press over the radius of the ball


def palpate(*words: Any) -> tuple[float, str]:
    """Run a command; return its duration [s] and what it printed."""
    began = perf_counter()
    done = subprocess.run(
        [sys.executable, "-m", "palpate", *map(str, words)], capture_output=True, text=True, check=False
    )
    if done.returncode not in (0, 3):
        raise SystemExit(f"palpate {' '.join(map(str, words))} ended with {done.returncode}: {done.stderr[-2000:]}")
    return perf_counter() - began, done.stdout


def press(scene: Path) -> str:
    """Return a script that presses the highest point of a scene's body with its ball."""
    opened = pt.open_scene(scene)
    points, radius = opened.cloud.points, opened.description.tool.radius
    top = points[np.argmax(points[:, 2])]
    away, deep = (top + np.array([0.0, 0.0, height * radius]) for height in (1.1, 1 - DEPTH))
    tool = {"time": 0.0, "type": "tool", "kind": "sphere", "radius": radius, "position": away.tolist()}
    return "\n".join(map(json.dumps, (tool, {"time": 0.1, "type": "pose", "position": deep.tolist()})))


def measure(name: str, folder: Path, small: bool) -> dict[str, Any]:
    """Return the times and errors of an organ."""
    source = SURFACES[name]
    assert source is not None
    scene = scene_file(name, folder)
    shutil.rmtree(scene.with_suffix(".palpate"), ignore_errors=True)
    scene.unlink(missing_ok=True)
    entry: dict[str, Any] = {"organ": name}
    entry["new"], _ = palpate("new", DATA / source[0], "--out", scene)
    script = folder / "press.jsonl"
    script.write_text(press(scene))
    options = ["--full", "--script", script, "--seconds", PRESS_SECONDS, "--json", "--out", folder / "run"]
    seconds, printed = palpate("run", scene, *options)
    entry |= {"first_force": seconds - PRESS_SECONDS, "largest_force": json.loads(printed)["tool"]["largest_force"]}
    entry["small"] = train(scene)
    if not small:
        entry["large"] = train(scene, "--paths", PATHS, "--held-out", HELD_OUT)
        entry["large"]["held_out"] = held_out_errors(scene)
    return entry


def scene_file(name: str, folder: Path) -> Path:
    return folder / f"{name.replace(' ', '-')}.toml"


def held_out_errors(file: Path) -> list[dict[str, float]]:
    """Return the largest force [N] of each held-out path, and the errors of its force."""
    opened = pt.open_scene(file)
    scene, folder = training_of(opened, {}), training_folder(opened)
    model, found = pt.load(folder / "model.rom"), []
    for job in jobs(opened.description.training.seed, (), HELD_OUT):
        full = pt.Trajectory.load(folder / "runs" / f"{job.name}.h5")
        loads, duration = scene.path(job.seed)
        run = pt.rollout(model, loads, duration=duration, every=scene.every)
        tool = next(load.name for load in loads if load.name in full.reactions)
        errors = contact_errors(full, run, [tool], np.arange(1))
        assert errors is not None
        largest = float(np.linalg.norm(full.reactions[tool], axis=1).max())
        found.append({"largest": largest, "force": errors.force, "force_95": errors.force_95})
    return found


def train(scene: Path, *options: Any) -> dict[str, Any]:
    """Return the duration of a training and the errors of its model."""
    seconds, printed = palpate("train", scene, "--json", *options)
    report = json.loads(printed)
    held_out = report["model"]["held_out"]["contact"]
    return {
        "seconds": seconds, "nodes": report["model"]["nodes_full"], "sampled": report["model"]["nodes"],
        "megabytes": next(scene.with_suffix(".palpate").glob("*/model.rom")).stat().st_size / 1e6,
        "force": held_out["mean"]["force"], "force_95": held_out["mean"]["force_95"],
        "surface_95": held_out["mean"]["surface_95"],
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", default=[name for name, source in SURFACES.items() if source])
    parser.add_argument("--small", action="store_true", help="leave out the training with 32 paths")
    parser.add_argument("--folder", type=Path, default=Path("out/organs"))
    parser.add_argument(
        "--held-out", action="store_true", help="add the errors of each held-out path of models at hand"
    )
    arguments = parser.parse_args()
    entries = {each["organ"]: each for each in result_files.read("organ_models", [])}
    arguments.folder.mkdir(parents=True, exist_ok=True)
    for name in arguments.only:
        if arguments.held_out:
            entries[name]["large"]["held_out"] = held_out_errors(scene_file(name, arguments.folder))
        else:
            entries[name] = measure(name, arguments.folder, arguments.small)
        print(json.dumps(entries[name]), flush=True)
        result_files.write("organ_models", list(entries.values()))


if __name__ == "__main__":
    main()
