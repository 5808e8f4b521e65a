"""Coverage of the error bounds: how many further runs keep them in all frames.

    python validation/coverage.py [--runs 60] [--splits 100]

Bodies are trained on a few random runs, at three numbers of modes each. Of `--runs` further runs a random 20
calibrate the error bounds, and the others judge them, in `--splits` random splits. A run keeps the bound if its error
does in all its frames, or if the bound says that the error is unknown there. The bound is to be kept by 95 % of the
runs. Figures go to docs/validation/coverage.json.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
import result_files
from scipy.stats import spearmanr

import palpate as pt
from palpate.reduction.hyper.error_indicator import expected_error
from palpate.reduction.training.calibrate_indicator import (
    Frames,
    calibrate_scales,
    error_curves,
    held_out_frames,
    trust_numbers,
)

TRAINED, CALIBRATED = 8, 20
DURATION, EVERY = 0.1, 0.005
TISSUE = pt.materials.MooneyRivlin(C1=60e3, C2=1.2e3, density=1120.0, poisson=0.45)
SKIN = pt.materials.NeoHookean(C1=10e3, density=1000.0, poisson=0.5)


class Case(NamedTuple):
    """A body, random loads by a generator, numbers of modes, and the group that a tool drives."""

    body: Any
    draw: Callable[[np.random.Generator], list[Any]]
    modes: tuple[int, int, int] = (8, 16, 32)
    prescribed: str = ""


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


def keeps(run: Frames, of: str, numbers: np.ndarray, curves: dict[str, Any]) -> tuple[bool, bool, float]:
    """Whether a run keeps the bound and whether it is known throughout; and the last bound over the largest error."""
    report = {"held_out": {"expected_error": curves}}
    bounds = np.array([expected_error(report, number, of).bound for number in np.maximum.accumulate(numbers)])
    bounds *= np.maximum(run.sizes[of], curves[of]["least_size"])
    errors = run.errors[of]
    return (
        bool(np.all(errors <= bounds)),
        bool(np.isfinite(bounds).all()),
        float(bounds[-1] / max(errors.max(), 1e-300)),
    )


def judge(frames: list[Frames], splits: int) -> dict[str, dict[str, float]]:
    """Coverage, share of unknown runs, sharpness and rank correlation over random splits."""
    random, found = np.random.default_rng(0), {of: [] for of in frames[0].errors}
    for _ in range(splits):
        order = random.permutation(len(frames))
        some, others = ([frames[k] for k in part] for part in np.split(order, [CALIBRATED]))
        scales = calibrate_scales([run.measures for run in some], 0.95)
        curves = error_curves(some, scales)
        numbers = [trust_numbers(run.measures, scales) for run in others]
        for of, values in found.items():
            judged = [keeps(run, of, own, curves) for run, own in zip(others, numbers, strict=True)]
            kept, known, ratio = (np.array(column) for column in zip(*judged, strict=True))
            errors = [run.errors[of].max() / max(run.sizes[of][-1], 1e-300) for run in others]
            rank = spearmanr([own.max() for own in numbers], errors)[0]
            values.append((kept.mean(), 1 - known.mean(), np.median(ratio[known]), np.median(errors), rank))
    names = ("kept", "unknown", "bound over error", "error", "rank correlation")
    return {of: dict(zip(names, np.mean(values, axis=0).tolist(), strict=True)) for of, values in found.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=60, help="further runs of each body")
    parser.add_argument("--splits", type=int, default=100, help="random splits of these")
    chosen = parser.parse_args()
    warnings.simplefilter("ignore", pt.TrustWarning)
    table: list[dict[str, Any]] = []
    print(
        f"{'body':18} {'modes':>5} {'of':>12} {'kept':>6} {'unknown':>8} {'error':>7} {'bound/error':>11} {'rank':>5}"
    )
    for name, case in cases().items():
        random = np.random.default_rng(1)
        runs = [rollout(case.body, case.draw(random)) for _ in range(TRAINED)]
        further = [(loads, rollout(case.body, loads)) for loads in (case.draw(random) for _ in range(chosen.runs))]
        for modes in case.modes:
            rom = pt.hyper_reduce(case.body, runs, modes=modes, prescribed=case.prescribed or ())
            frames = [held_out_frames(rom, loads, rollout(rom, loads), full) for loads, full in further]
            for of, row in judge(frames, chosen.splits).items():
                table.append({"body": name, "modes": modes, "of": of} | row)
                print(
                    f"{name:18} {modes:5} {of:>12} {row['kept']:6.1%} {row['unknown']:8.1%} {row['error']:7.2%} "
                    f"{row['bound over error']:11.1f} {row['rank correlation']:5.2f}",
                    flush=True,
                )
    print(f"mean of all: {np.mean([row['kept'] for row in table]):.1%}")
    result_files.write("coverage", table)


if __name__ == "__main__":
    main()
