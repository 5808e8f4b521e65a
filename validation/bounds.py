"""Coverage of the error bounds: how many further runs keep them in all frames, and how wide they are.

    python validation/bounds.py [--only NAME ...] [--runs 60] [--splits 100] [--folder out/bounds]

Two beams and a membrane are trained on a few random runs, at three numbers of modes each. Organs are trained by
`palpate train` on 16 paths of a ball and of forceps, with 100 held-out paths, in a folder whose runs and models are
used again. Of the further runs a random part calibrates the error bounds, and the others judge them, in `--splits`
random splits: a campaign each. A run keeps the bound if its error does in all its frames, or if the bound says that the
error is unknown there. Results are added to docs/validation/bounds.json.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import result_files
from organs import DATA
from scipy.stats import spearmanr

import palpate as pt
from palpate.app.common.arguments import parse_settings
from palpate.app.train.folder import jobs
from palpate.reduction.hyper.error_indicator import curve_bound
from palpate.reduction.training.calibrate_indicator import (
    Frames,
    calibrate_scales,
    error_curves,
    error_indicators,
    repeat_run,
)
from palpate.scenes.training import open_training

TRAINED = 8
DURATION, EVERY = 0.1, 0.005
TISSUE = pt.materials.MooneyRivlin(C1=60e3, C2=1.2e3, density=1120.0, poisson=0.45)
SKIN = pt.materials.NeoHookean(C1=10e3, density=1000.0, poisson=0.5)
PATHS, HELD_OUT = 16, 100  # of the campaigns on organs
ONE_TOOL = "pairs=0"  # two tools: `two_tools.py`
COMMAND = "python validation/bounds.py"  # also of results that are made one by one
CURVE = ("bound", "least_trust", "exponent", "largest_trust", "typical_size")


class Case(NamedTuple):
    """A body, random loads by a generator, numbers of modes, and the group that a tool drives."""

    body: Any
    draw: Callable[[np.random.Generator], list[Any]]
    modes: tuple[int, int, int] = (8, 16, 32)
    prescribed: str = ""


class Organ(NamedTuple):
    """A scene, settings of `palpate train`, the number of modes, and the file and spacing of another surface."""

    scene: str
    settings: tuple[str, ...]
    modes: int
    file: str = ""
    spacing: str = ""


ORGANS = {
    "liver, 15 mm": Organ("liver", ("spacing=0.015", "radius=0.0325"), 24),
    "liver, 12 mm": Organ("liver", ("spacing=0.012", "radius=0.026"), 32),
    "liver, 9 mm": Organ("liver", ("spacing=0.009", "radius=0.0225", "depth=0.016"), 48),
    "HRA liver, 15 mm": Organ("hra-liver-15.toml", (), 24, "hra/VH_F_liver_solid_2k.ply", "0.015"),
    "HRA liver, 12 mm": Organ("hra-liver.toml", (), 32, "hra/VH_F_liver_solid_2k.ply", "0.012"),
    "HRA liver, 10 mm": Organ("hra-liver-10.toml", (), 40, "hra/VH_F_liver_solid_2k.ply", "0.010"),
    "SOFA liver, 4.5 mm": Organ("sofa-liver-45.toml", (), 24, "sofa/liver-smooth.obj", "0.0045"),
    "SOFA liver, 3.5 mm": Organ("sofa-liver.toml", (), 32, "sofa/liver-smooth.obj", "0.0035"),
    "SOFA liver, 3 mm": Organ("sofa-liver-30.toml", (), 40, "sofa/liver-smooth.obj", "0.003"),
}


def ramp(time: float) -> float:
    return float(np.sin(0.5 * np.pi * min(time / 0.05, 1.0)) ** 2)


def forced(random: np.random.Generator) -> list[Any]:
    size = random.standard_normal(3) * (1.0, 0.07, 0.07)
    return [pt.SurfaceForce("x+", force=lambda t: ramp(t) * size)]


def prescribed_end(random: np.random.Generator) -> list[Any]:
    slow, fast = random.standard_normal((2, 3)) * (0.004, 0.008, 0.008)
    return [pt.PrescribedMotion("x+", lambda _, t: slow * np.sin(20 * t) ** 2 + fast * np.sin(31 * t) ** 2)]


def blown(random: np.random.Generator) -> list[Any]:
    size = random.standard_normal(3) * (0.03, 0.03, 0.12)
    return [pt.SurfaceForce("face", force=lambda t: ramp(t) * size)]


def cases() -> dict[str, Case]:
    beam = pt.Solid(pt.box((0.1, 0.02, 0.02), 0.005), TISSUE, "x-")
    corners = 0.03 * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    sheet = pt.Membrane(pt.sheet(corners, 0.002), SKIN, 1e-3, "rim", prestretch=1.1, stiffness_damping=1e-4)
    return {
        "beam, end force": Case(beam, forced),
        "beam, prescribed end": Case(beam, prescribed_end, prescribed="x+"),
        "membrane": Case(sheet, blown, (4, 8, 12)),
    }


def rollout(model: Any, loads: list[Any]) -> pt.Trajectory:
    return pt.rollout(model, loads, duration=DURATION, every=EVERY, progress=False)


def frames_of_case(case: Case, runs: int) -> Iterator[tuple[int, list[Frames]]]:
    """Yield the number of modes, and the frames of further runs."""
    random = np.random.default_rng(1)
    trained = [rollout(case.body, case.draw(random)) for _ in range(TRAINED)]
    further = [(loads, rollout(case.body, loads)) for loads in (case.draw(random) for _ in range(runs))]
    for modes in case.modes:
        rom = pt.hyper_reduce(case.body, trained, modes=modes, prescribed=case.prescribed or ())
        yield modes, [repeat_run(rom, loads, full)[1] for loads, full in further]


def palpate(*words: Any) -> None:
    done = subprocess.run([sys.executable, "-m", "palpate", *map(str, words)], check=False)
    if done.returncode not in (0, 3):
        raise SystemExit(f"palpate {' '.join(map(str, words))} ended with {done.returncode}")


def frames_of_organ(organ: Organ, folder: Path) -> list[Frames]:
    """Train an organ where the folder has no model, and return the frames of its held-out runs."""
    scene = str(folder / organ.scene) if organ.file else organ.scene
    campaign = folder / Path(organ.scene).stem
    if organ.file:
        if not Path(scene).is_file():
            palpate("new", DATA / organ.file, "--spacing", organ.spacing, "--out", scene)
    else:
        campaign = campaign.with_name(f"{organ.scene}-{organ.settings[0].partition('=')[2]}")
    settings = (*organ.settings, ONE_TOOL)
    if not (campaign / "model.rom").is_file():
        numbers = ["--paths", PATHS, "--held-out", HELD_OUT, "--modes", organ.modes]
        palpate("train", scene, "--set", *settings, *numbers, "--out", campaign)
    made, model, frames = open_training(scene, parse_settings(settings)), pt.load(campaign / "model.rom"), []
    for job in jobs(0, (), HELD_OUT):
        if (campaign / "runs" / f"{job.name}.h5").is_file():
            full = pt.Trajectory.load(campaign / "runs" / f"{job.name}.h5")
            frames.append(repeat_run(model, made.path(job.seed)[0], full)[1])
    return frames


def judge(frames: list[Frames], calibrated: int, splits: int) -> dict[str, dict[str, float]]:
    """Return coverage, share of unknown runs, width and rank correlations over random splits."""
    random = np.random.default_rng(0)
    found: dict[str, list[tuple[float, ...]]] = {of: [] for of in frames[0].errors}
    for _ in range(splits):
        order = random.permutation(len(frames))
        some, others = ([frames[k] for k in part] for part in np.split(order, [calibrated]))
        scales = calibrate_scales([run.measures for run in some], 0.95)
        curves = error_curves(some, scales)
        worst = [np.maximum.accumulate(error_indicators(run.measures, scales)) for run in others]
        for of, values in found.items():
            curve = np.array([curves[of][name] for name in CURVE])
            errors = [run.errors[of] for run in others]
            bounds = [
                np.array(
                    [
                        [curve_bound(curve, trust, size) for size in np.atleast_1d(sizes)]
                        for trust, sizes in zip(numbers, run.sizes[of], strict=True)
                    ]
                ).reshape(run.sizes[of].shape)
                for run, numbers in zip(others, worst, strict=True)
            ]
            within = np.mean([np.all(error <= bound) for error, bound in zip(errors, bounds, strict=True)])
            known = np.array([np.isfinite(bound).all() for bound in bounds])
            wide, wrong = (np.array([each.max() for each in values]) for values in (bounds, errors))
            expected, actual = (np.concatenate([part.ravel() for part in each]) for each in (bounds, errors))
            finite = np.isfinite(expected)
            values.append((
                within, 1 - known.mean(), float(within >= curves["least_level"]),
                np.median(wide[known]) / np.median(wrong[known]),
                np.median(wrong / np.array([max(run.sizes[of].max(), 1e-300) for run in others])),
                spearmanr(wide[known], wrong[known])[0], spearmanr(expected[finite], actual[finite])[0],
            ))  # fmt: skip
    names = ("kept", "unknown", "campaigns", "bound over error", "error", "rank of runs", "rank of frames")
    means = {of: dict(zip(names, np.mean(values, axis=0).tolist(), strict=True)) for of, values in found.items()}
    return {of: row | {"least level": curves["least_level"]} for of, row in means.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    every = {**cases(), **ORGANS}
    parser.add_argument("--only", nargs="+", choices=list(every), default=list(every), metavar="NAME")
    parser.add_argument("--runs", type=int, default=60, help="further runs of beams and membrane")
    parser.add_argument("--splits", type=int, default=100, help="random splits of these")
    parser.add_argument("--folder", type=Path, default=Path("out/bounds"), help="of the campaigns on organs")
    chosen = parser.parse_args()
    chosen.folder.mkdir(parents=True, exist_ok=True)
    warnings.simplefilter("ignore", pt.TrustWarning)
    for name in chosen.only:
        case = every[name]
        rows = []
        if isinstance(case, Organ):
            frames = frames_of_organ(case, chosen.folder)
            made = [(case.modes, calibrated, frames) for calibrated in (20, 45)]
        else:
            made = [(modes, 20, frames) for modes, frames in frames_of_case(case, chosen.runs)]
        for modes, calibrated, frames in made:
            for of, row in judge(frames, calibrated, chosen.splits).items():
                rows.append({"body": name, "modes": modes, "of": of, "held out": calibrated, "runs": len(frames)} | row)
                print({key: round(value, 3) if isinstance(value, float) else value for key, value in rows[-1].items()})
        before = [row for row in result_files.read("bounds", []) if row["body"] != name]
        order = list(every)
        results = sorted([*before, *rows], key=lambda row: order.index(row["body"]))
        result_files.write("bounds", results, COMMAND)


if __name__ == "__main__":
    main()
