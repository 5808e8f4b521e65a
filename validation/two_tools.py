"""Two tools at once on reduced models: errors, and whether the error bounds hold, on three organs.

    python validation/two_tools.py [--only NAME ...] [--splits 100] [--folder out/two_tools]

A liver, a kidney and a spleen, each of a public file, are trained on 16 paths with one tool. Further runs are 32 with
one tool and 32 with two, near each other in half of them (`palpate.scenes.tool_paths.ToolPaths.pair`). The truth is the
full model's run of the same tools. Random 20 of the further runs calibrate the error bounds, and the others judge them,
in `--splits` splits: with one tool alone, and with both kinds. A run keeps the bound if the force on each of its
tools does in all frames, or if the bound says there that the error is unknown.

On the liver a second model is trained on runs with the same first tools, of which each has a second one. Runs and
models are kept in the folder and used again. Results are added to docs/validation/two_tools.json.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import result_files
from organs import DATA

import palpate as pt
from palpate.reduction.hyper.error_indicator import Scales, curve_errors, error_indicators, mean_size
from palpate.reduction.training.calibrate_indicator import Frames, calibrate_scales, error_curves, repeat_run
from palpate.reduction.training.errors import contact_errors
from palpate.scenes.load_case import TRAINING_SEEDS
from palpate.scenes.tool_paths import ToolPaths
from palpate.scenes.training import open_training

COMMAND = "python validation/two_tools.py"  # also of results that are made one by one
TRAINED, FURTHER, CALIBRATED, MODES = 16, 32, 20, 32
TRAININGS = {"one tool": "train", "two tools": "trainpair"}  # kinds of runs
UNLIMITED_TOOLS = 99


class Organ(NamedTuple):
    """A file, a part of it, the spacing [m], and the trainings that are compared."""

    file: str
    part: str
    spacing: str
    trainings: tuple[str, ...] = ("one tool",)


ORGANS = {
    "liver": Organ("hra/VH_F_liver_solid_2k.ply", "", "0.012", ("one tool", "two tools")),
    "kidney": Organ("labels/trunk_3mm_61_labels.nii.gz", "2", "0.007"),
    "spleen": Organ("labels/trunk_3mm_61_labels.nii.gz", "1", "0.008"),
}
Trial = tuple[Sequence[Any], Path]


class Tested(NamedTuple):
    """A further run of a reduced model: its frames, and the errors of contact by name."""

    frames: Frames
    errors: dict[str, float]


def scene_of(name: str, folder: Path) -> Any:
    """Return the scene of an organ; write its file where the folder has none."""
    organ, file = ORGANS[name], folder / f"{name}.toml"
    if not file.is_file():
        part = ["--part", organ.part] if organ.part else []
        words = ["new", DATA / organ.file, *part, "--spacing", organ.spacing, "--out", file]
        subprocess.run([sys.executable, "-m", "palpate", *map(str, words)], check=True)
    return open_training(str(file), {})


def trials(scene: Any, folder: Path, kind: str, count: int) -> list[Trial]:
    """Return runs of the full model of a kind, and their loads; make those that the folder lacks."""
    paths, result = scene.path, []
    assert isinstance(paths, ToolPaths)
    for number in range(count):
        seed = number + (TRAINING_SEEDS if kind.startswith("held") else 0)
        loads, duration = paths.pair(seed) if kind.endswith("pair") else paths.single(seed)
        file = folder / f"{kind}{number:03d}.h5"
        if not file.is_file():
            pt.rollout(scene.model, loads, duration=duration, every=scene.every, progress=False).save(file)
        result.append((loads, file))
    return result


def tested(model: pt.ReducedModel, some: Sequence[Trial]) -> list[Tested]:
    """Repeat further runs with a reduced model."""
    result = []
    for loads, file in some:
        full = pt.Trajectory.load(file)
        run, frames = repeat_run(model, loads, full)
        tools = [load.name for load in loads if isinstance(load, pt.tools.Contact | pt.tools.Grasp)]
        errors = contact_errors(full, run, tools, model.data.compliance.nodes)
        result.append(Tested(frames, {} if errors is None else errors.as_dict()))
    return result


class Bounds(NamedTuple):
    """Scales and curves of a calibration."""

    scales: Scales
    curves: dict[str, Any]


def calibrated(runs: list[Frames]) -> Bounds:
    """Return the scales and curves of some runs."""
    scales = calibrate_scales([run.measures for run in runs], 0.95)
    return Bounds(scales, error_curves(runs, scales))


def limits(bounds: Bounds, run: Frames, of: str, *, count_tools: bool = True) -> Any:
    """Return the bounds of a run's errors, of the shape of these."""
    scales = bounds.scales if count_tools else bounds.scales._replace(trained_tools=UNLIMITED_TOOLS)
    worst, curve = np.maximum.accumulate(error_indicators(run.measures, scales)), bounds.curves[of]
    relative, sizes = curve_errors(curve, "bound", worst), run.sizes[of]
    return relative.reshape(len(worst), *[1] * (sizes.ndim - 1)) * mean_size(sizes, curve["typical_size"])


def kept(bounds: Bounds, runs: list[Frames], of: str, *, count_tools: bool = True) -> tuple[float, float]:
    """Return the share of runs that keep their bounds in all frames, and of those whose bounds are known in all."""
    largest = [limits(bounds, run, of, count_tools=count_tools) for run in runs]
    keeps = [np.all(run.errors[of] <= each) for run, each in zip(runs, largest, strict=True)]
    return float(np.mean(keeps)), float(np.mean([np.isfinite(each).all() for each in largest]))


def widening(before: Bounds, after: Bounds, runs: list[Frames], of: str) -> float:
    """Return the median ratio of the bounds of two calibrations, in frames in which both are known."""
    pairs = [(limits(before, run, of), limits(after, run, of)) for run in runs]
    one, two = (np.concatenate([part.ravel() for part in each]) for each in zip(*pairs, strict=True))
    known = np.isfinite(one) & np.isfinite(two)
    return float(np.median(two[known] / one[known]))


def _split(runs: list[Frames], order: Any) -> tuple[list[Frames], list[Frames]]:
    """Return the runs that calibrate, the first in an order, and the others."""
    shuffled = [runs[k] for k in order]
    return shuffled[:CALIBRATED], shuffled[CALIBRATED:]


def judged(one: list[Frames], two: list[Frames], splits: int) -> dict[str, dict[str, float]]:
    """Return shares of runs with one tool and with two that keep their bounds, over random splits."""
    random, rows = np.random.default_rng(0), {of: [] for of in one[0].errors}
    for _ in range(splits):
        (one_in, one_out), (two_in, two_out) = (_split(runs, random.permutation(len(runs))) for runs in (one, two))
        alone, both = calibrated(one_in), calibrated(one_in + two_in)
        for of, values in rows.items():
            values.append({
                "one by one": kept(alone, one_out, of),
                "two by one, not counted": kept(alone, two_out, of, count_tools=False),
                "two by one": kept(alone, two_out, of),
                "one by both": kept(both, one_out, of),
                "two by both": kept(both, two_out, of),
                "widening": widening(alone, both, one_out, of),
            })  # fmt: skip
    return {of: {name: np.mean([each[name] for each in some], axis=0).tolist() for name in some[0]}
            for of, some in rows.items()}  # fmt: skip


def summary(some: list[Tested]) -> dict[str, float]:
    """Return means and 95th percentiles of errors of contact over runs."""
    touched = [each.errors for each in some if each.errors]
    means = {name: float(np.mean([each[name] for each in touched])) for name in touched[0]}
    return means | {"worst force_95": max(each["force_95"] for each in touched), "runs": len(touched)}


def study(name: str, training: str, folder: Path, splits: int) -> dict[str, Any]:
    """Return the results of an organ that is trained on runs with one tool, or with two."""
    scene, runs = scene_of(name, folder), folder / name
    runs.mkdir(exist_ok=True)
    file = runs / f"{training}.rom"
    if not file.is_file():
        learned = trials(scene, runs, TRAININGS[training], TRAINED)
        pt.save(pt.hyper_reduce(scene.model, [run for _, run in learned], modes=MODES, repeated=learned), file)
    model = pt.load(file)
    one, two = (tested(model, trials(scene, runs, kind, FURTHER)) for kind in ("held", "heldpair"))
    return {
        "organ": name, "nodes": len(scene.model.cloud), "training": training, "runs": TRAINED, "further": FURTHER,
        "modes": model.data.modes, "sampled nodes": model.report["nodes"], "one tool": summary(one),
        "two tools": summary(two), **judged([each.frames for each in one], [each.frames for each in two], splits),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=list(ORGANS), default=list(ORGANS), metavar="NAME")
    parser.add_argument("--splits", type=int, default=100, help="random splits of the further runs")
    parser.add_argument("--folder", type=Path, default=Path("out/two_tools"), help="of scenes and runs")
    chosen = parser.parse_args()
    chosen.folder.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("ignore", pt.TrustWarning)
    order = [(name, training) for name, organ in ORGANS.items() for training in organ.trainings]
    for name, training in sorted(order, key=lambda each: each[1]):
        if name in chosen.only:
            rows = {(row["organ"], row["training"]): row for row in result_files.read("two_tools", [])}
            rows[name, training] = study(name, training, chosen.folder, chosen.splits)
            print(rows[name, training], flush=True)
            result_files.write("two_tools", [rows[each] for each in order if each in rows], COMMAND)


if __name__ == "__main__":
    main()
