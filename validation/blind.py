"""Runs unlike those of training: how often an error indicator below 1 hides a large error.

    python validation/blind.py [--only organ bodies] [--cases 40] [--folder out/blind]

Organ: a liver that `palpate train` trains on 16 paths with 45 held-out ones, in a folder whose model is used again.
A ball presses next to supports, presses 2 to 10 times faster than on held-out paths, and taps at 5 to 20 Hz. Bodies:
bars, blocks and sheets of random size, tissue and supports, trained on a few slow runs and tried on faster ones, at
other places and in other directions, by balls, prescribed motions and loads.

A run is blind if some frame errs by 30 % of the largest size so far while the largest error indicator so far is below
1. Sizes below a fifth of the typical one count as that. Results are added to docs/validation/blind.json.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import result_files
from scipy.spatial import cKDTree

import palpate as pt
from palpate.app.common.arguments import parse_settings
from palpate.app.train.folder import jobs
from palpate.reduction.hyper.error_indicator import force_sizes, rms_sizes
from palpate.scenes.training import open_training

LARGE_ERROR, MIN_SHARE = 0.3, 0.2  # relative; of the typical size
SETTINGS = ["spacing=0.012", "radius=0.026"]
PATHS, HELD_OUT, MODES = 16, 45, 32
FRICTION = 0.2
COMMAND = "python validation/blind.py"  # also of parts that are run one by one


class Outcome(NamedTuple):
    """Largest relative errors of a run, the same below an error indicator of 1, and its largest error indicator."""

    kind: str
    force: float
    displacement: float
    hidden_force: float
    hidden_displacement: float
    trust: float


def compare(kind: str, model: pt.ReducedModel, body: Any, loads: list[Any], duration: float, every: float) -> Outcome:
    """Return the errors of a reduced run against the full one."""
    full, run = (pt.rollout(each, loads, duration=duration, every=every, progress=False) for each in (body, model))
    curves, below = model.report["held_out"]["expected_error"], np.maximum.accumulate(run.trust) < 1
    largest, hidden = {"force": 0.0, "displacement": 0.0}, {"force": 0.0, "displacement": 0.0}
    shares = body.volumes / body.volumes.sum()
    missed = {"displacement": np.sqrt(np.sum((run.displacements - full.displacements) ** 2, axis=2) @ shares)}
    sizes = {"displacement": rms_sizes(model.data, full)}
    if len(force_sizes(model.data, full)) and "force" in curves:
        supports = {support.group for support in model.data.supports}
        names = [name for name in full.reactions if name not in supports]
        apart = [np.linalg.norm(run.reactions[name] - full.reactions[name], axis=1) for name in names]
        missed["force"], sizes["force"] = np.max(apart, axis=0), force_sizes(model.data, full)
    for of, errors in missed.items():
        least = MIN_SHARE * curves[of]["typical_size"]
        relative = errors / np.maximum(np.maximum.accumulate(sizes[of]), least)
        largest[of], hidden[of] = float(relative.max()), float(relative[below].max(initial=0.0))
    return Outcome(kind, *largest.values(), *hidden.values(), float(run.trust.max()))


def organ_runs(folder: Path, cases: int) -> Iterator[Outcome]:
    """Yield the outcomes of presses next to supports, of fast presses and of taps."""
    campaign = folder / "liver"
    if not (campaign / "model.rom").is_file():
        numbers = ["--paths", str(PATHS), "--held-out", str(HELD_OUT), "--modes", str(MODES)]
        command = [sys.executable, "-m", "palpate", "train", "liver", "--set", *SETTINGS, *numbers, "--out", campaign]
        subprocess.run(command, check=True)
    scene, model = open_training("liver", parse_settings(SETTINGS)), pt.load(campaign / "model.rom")
    paths, random = scene.path, np.random.default_rng(0)
    surface, ball = paths.surface, pt.tools.Sphere(paths.radius)
    distances = cKDTree(surface.fixed_points).query(surface.points)[0]
    near = np.flatnonzero(~surface.held & (paths.heights <= 1.1 * paths.radius) & (distances < paths.radius))
    for node in random.choice(near, cases, replace=False):
        yield compare(
            "next to a support", model, scene.model, [press(paths, ball, node, random.uniform(4e-3, 8e-3))], 0.4, 0.01
        )
    seeds = [job.seed for job in jobs(1, (), 2 * cases)]
    presses = [each for each in (paths(seed)[0][-1] for seed in seeds) if isinstance(each, pt.tools.Contact)][:cases]
    for number, load in enumerate(presses):
        factor = (2, 3, 5, 10)[number % 4]
        fast = pt.tools.Contact(ball, lambda t: load.motion(factor * t), friction=FRICTION)  # noqa: B023
        yield compare(f"{factor} times faster", model, scene.model, [fast], 0.6 / factor, scene.every / factor)
    for number, load in enumerate(presses):
        frequency = (5, 10, 20)[number % 3]
        yield compare(f"tap at {frequency} Hz", model, scene.model, [tap(ball, load, frequency)], 0.4, 0.005)


def press(paths: Any, ball: Any, node: int, depth: float) -> pt.tools.Contact:
    """Return a press along the normal of a surface node and back, in 0.4 s."""
    touch, normal = paths.surface.points[node] + paths.heights[node] * paths.normals[node], paths.normals[node]
    clear = 0.004

    def motion(time: float) -> np.ndarray:
        return touch + normal * (clear - (depth + clear) * np.sin(np.pi * min(time / 0.4, 1.0)) ** 2)

    return pt.tools.Contact(ball, motion, friction=FRICTION)


def tap(ball: Any, load: Any, frequency: float) -> pt.tools.Contact:
    """Return a press to a third of the depth of another, which oscillates by 3 mm."""
    begin, deepest = load.motion(0.02), load.motion(0.25)
    way = (deepest - begin) / np.linalg.norm(deepest - begin)

    def motion(time: float) -> np.ndarray:
        reach = 0.6 * np.linalg.norm(deepest - begin) + 3e-3 * np.sin(2 * np.pi * frequency * time)
        return begin + way * reach * min(time / 0.1, 1.0)

    return pt.tools.Contact(ball, motion, friction=FRICTION)


def body_runs(cases: int) -> Iterator[Outcome]:
    """Yield the outcomes of random bodies."""
    for number in range(cases):
        random = np.random.default_rng(number)
        yield (_pushed, _moved, _pressed, _sheet)[number % 4](random)


def _tissue(random: np.random.Generator) -> Any:
    return pt.materials.NeoHookean(C1=random.uniform(2e3, 10e3), density=1060.0, poisson=random.uniform(0.4, 0.48))


def _bar(random: np.random.Generator) -> pt.Solid:
    size = (0.06, random.uniform(0.016, 0.02), random.uniform(0.016, 0.02))
    fixed = str(random.choice(["x-", "z-"]))
    return pt.Solid(pt.box(size, 0.005), _tissue(random), fixed, mass_damping=random.uniform(2.0, 20.0))


def _trained(body: Any, draw: Any, duration: float, **options: Any) -> pt.ReducedModel:
    runs = [(loads, pt.rollout(body, loads, duration=duration, every=0.01, progress=False))
            for loads in (draw(1.0) for _ in range(14))]  # fmt: skip
    return pt.hyper_reduce(body, [run for _, run in runs[:4]], held_out=runs[4:], **options)


def _pushed(random: np.random.Generator) -> Outcome:
    body = _bar(random)

    def draw(speed: float, turned: bool = False) -> list[Any]:
        way = (
            random.standard_normal(3) * 0.02 * (np.array([0.3, 0.1, 1.0]) if not turned else np.array([0.3, 1.0, 0.1]))
        )
        return [pt.SurfaceForce("x+", force=lambda t: way * np.sin(3 * speed * t) ** 2)]

    model, speed, turned = _trained(body, draw, 0.5, modes=8), random.uniform(1.0, 10.0), bool(random.random() < 0.5)
    return compare("load", model, body, draw(speed, turned), 0.5 / speed, 0.01 / speed)


def _moved(random: np.random.Generator) -> Outcome:
    body = _bar(random)

    def draw(speed: float, turned: bool = False) -> list[Any]:
        way = (
            random.standard_normal(3) * 0.006 * (np.array([0.5, 0.1, 1.0]) if not turned else np.array([0.5, 1.0, 0.1]))
        )
        return [pt.PrescribedMotion("x+", lambda _, t: way * np.sin(3 * speed * t) ** 2)]

    if body.supports[0].group == "z-":
        body = pt.Solid(body.cloud, body.material, "x-", mass_damping=body.mass_damping)
    model, speed = _trained(body, draw, 0.5, modes=8, prescribed="x+"), random.uniform(1.0, 10.0)
    return compare(
        "prescribed motion", model, body, draw(speed, bool(random.random() < 0.5)), 0.5 / speed, 0.01 / speed
    )


def _pressed(random: np.random.Generator) -> Outcome:
    size = np.array([0.048, 0.048, random.uniform(0.018, 0.03)])
    fixed = str(random.choice(["z-", "x-"]))
    body = pt.Solid(pt.box(tuple(size), 0.006), _tissue(random), fixed, mass_damping=random.uniform(2.0, 20.0))
    radius = 0.013

    def draw(speed: float, margin: float = 0.016) -> list[Any]:
        at, depth = random.uniform(margin, size[:2] - 0.012), random.uniform(0.002, 0.005)
        place = np.array([*at, size[2] + radius])

        def motion(time: float) -> np.ndarray:
            return place + np.array([0.0, 0.0, 0.001 - (depth + 0.001) * np.sin(2 * np.pi * speed * time) ** 2])

        return [pt.tools.Contact(pt.tools.Sphere(radius), motion, friction=FRICTION)]

    model = _trained(body, draw, 0.5, modes=0, enrichment=pt.vibration_modes(body, 16)[0])
    speed, margin = random.uniform(1.0, 10.0), float(random.choice([0.004, 0.016]))
    return compare("press", model, body, draw(speed, margin), 0.5 / speed, 0.01 / speed)


def _sheet(random: np.random.Generator) -> Outcome:
    corners = 0.03 * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    skin = pt.materials.NeoHookean(C1=random.uniform(5e3, 20e3), density=1000.0, poisson=0.5)
    body = pt.Membrane(
        pt.sheet(corners, 0.003), skin, 1e-3, "rim", prestretch=random.uniform(1.02, 1.2), stiffness_damping=1e-4
    )

    def draw(speed: float, turned: bool = False) -> list[Any]:
        way = (
            random.standard_normal(3) * 0.05 * (np.array([0.1, 0.1, 1.0]) if not turned else np.array([1.0, 0.3, 0.3]))
        )
        return [pt.SurfaceForce("face", force=lambda t: way * np.sin(3 * speed * t) ** 2)]

    model, speed = _trained(body, draw, 0.5, modes=6), random.uniform(1.0, 10.0)
    return compare("sheet", model, body, draw(speed, bool(random.random() < 0.5)), 0.5 / speed, 0.01 / speed)


def summary(outcomes: list[Outcome]) -> list[dict[str, Any]]:
    """Return numbers of runs, of those with large errors and of blind ones, by kind."""
    rows = []
    for kind in dict.fromkeys(each.kind for each in outcomes):
        some = [each for each in outcomes if each.kind == kind]
        hidden = [max(each.hidden_force, each.hidden_displacement) for each in some]
        errors = [max(each.force, each.displacement) for each in some]
        rows.append({
            "kind": kind, "runs": len(some), "error": float(np.median(errors)), "largest_error": max(errors),
            "large": sum(error >= LARGE_ERROR for error in errors), "hidden": max(hidden),
            "blind": sum(error >= LARGE_ERROR for error in hidden),
            "trusted": sum(each.trust < 1 for each in some),
        })  # fmt: skip
    return rows


def main() -> None:
    """Run the cases asked for, and keep their summary."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=["organ", "bodies"], default=["organ", "bodies"])
    parser.add_argument("--cases", type=int, default=40, help="of each kind")
    parser.add_argument("--folder", type=Path, default=Path("out/blind"), help="of the campaign")
    chosen = parser.parse_args()
    warnings.simplefilter("ignore", pt.TrustWarning)
    results = result_files.read("blind", {})
    for part in chosen.only:
        outcomes = []
        for outcome in organ_runs(chosen.folder, chosen.cases) if part == "organ" else body_runs(chosen.cases):
            print({key: round(value, 2) if isinstance(value, float) else value for key, value in
                   outcome._asdict().items()}, flush=True)  # fmt: skip
            outcomes.append(outcome)
        results = results | {part: summary(outcomes)}
        result_files.write("blind", results, COMMAND)
        print(*results[part], sep="\n")


if __name__ == "__main__":
    main()
