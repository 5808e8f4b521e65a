"""Linear reductions of a body side by side: cost, stability and errors against the full, nonlinear body.

    python validation/linear_reductions.py beam|liver [--modes 4 8 16 24] [--methods modal hankel ...] [--out FOLDER]

pulls the paper's beam, or a place at the front of the generated liver, a little and far, and reduces the linearised
body by all methods of docs/claims/linear.md: those of `palpate.lti`, of pyMOR, and the Hankel norm. It leaves
report.md, report.json and three figures in FOLDER, by default out/linear_reductions; `validation/result_files.py`
keeps a report for the docs.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

import linear_reductions_figures
import numpy as np
from linear_methods import CONDENSED_MODES, METHODS, Reductions
from linear_runs import input_sizes

import palpate as pt
from palpate.app.common.console import Table, quantities_table
from palpate.app.common.report import REPORTS, deliver, machine
from palpate.core.extras import require
from palpate.core.files import plain
from palpate.reduction.lti.model import LinearModel, propagate
from palpate.scenes.beam import beam, pull
from palpate.scenes.open_scene import open_scene

LOAD_NAMES = ("small", "large")
MIN_TOOL_DISTANCE = 0.02  # [m] least distance of the liver's tool from its fixed back
GRIP_SPACINGS = 2.0  # [spacings] radius of the nodes that the tool holds
TOOL_SECONDS = 0.6  # [s] of the tool, out and back
SPREAD_FREQUENCIES, FULL_FREQUENCIES, RESONANT_FREQUENCIES = 240, 10, 24  # condensed body; whole one; resonances
TIMING_ROUNDS, TIMED_STEPS, STEP_SECONDS = 7, 2000, 1e-3
MIN_INPUT_WEIGHT = 1e-2  # least weight of an input, over that of the input that the run drives most
QUANTITIES = ("displacement", "velocity", "energy", "reaction")
HEADINGS = (
    "states", "offline s", "shared s", "us/step", "step kB", "stable", *(f"small: {each} %" for each in QUANTITIES),
    "response %", *(f"large: {each} %" for each in QUANTITIES),
)  # fmt: skip


class Body(NamedTuple):
    """A body with its loads by size, a small and a large size, and its nonlinear reduced model by run and modes."""

    title: str
    model: pt.Solid
    loads: Callable[[float], tuple[Any, ...]]
    sizes: tuple[float, float]
    unit: str
    outputs: tuple[str, ...]
    duration: float
    every: float
    nonlinear: Callable[[pt.Trajectory, int], Any]
    nonlinear_name: str

    def run(self, model: Any, size: float) -> pt.Trajectory:
        return pt.rollout(model, self.loads(size), duration=self.duration, every=self.every, progress=False)


def pulled_beam(spacing: float = 0.005, poisson: float = 0.49) -> Body:
    """Return the paper's beam, pulled by up to 0.1 N and up to 100 N."""
    case = beam(spacing=spacing, poisson=poisson)
    return Body(
        f"The paper's beam, {1e3 * spacing:g} mm", case.model,
        lambda size: (pt.SurfaceForce("x+", force=lambda time: (pull(time, size), 0.0, 0.0)),),
        (0.1, 100.0), "N", ("x+",), case.duration, case.every,
        lambda run, modes: pt.galerkin(case.model, run, modes=modes), "POD of the nonlinear run",
    )  # fmt: skip


def pulled_liver(spacing: float = 0.012, poisson: float = 0.45) -> Body:
    """Return the generated liver, a place of its front pulled by a tool by up to 0.2 mm and up to 20 mm."""
    bare = open_scene("liver", {"spacing": spacing, "poisson": poisson}).body
    cloud, surface = bare.cloud, np.unique(bare.cloud.face_nodes)
    back = cloud.points[cloud.group("back"), 1].min()
    reachable = surface[cloud.points[surface, 1] < back - MIN_TOOL_DISTANCE]
    at = reachable[np.argmin(cloud.points[reachable, 1])]
    near = surface[np.linalg.norm(cloud.points[surface] - cloud.points[at], axis=1) <= GRIP_SPACINGS * spacing]
    model = pt.Solid(
        cloud.with_group("tool", near), bare.material, "back", form="energy", stiffness_damping=bare.stiffness_damping
    )
    normals = np.zeros_like(cloud.points)
    normals[cloud.face_nodes] = cloud.face_normals
    along = normals[near].mean(axis=0) / np.linalg.norm(normals[near].mean(axis=0))

    def loads(size: float) -> tuple[pt.PrescribedMotion]:
        def pulled(points: np.ndarray, time: float) -> np.ndarray:
            return size * np.sin(np.pi * min(time, TOOL_SECONDS) / TOOL_SECONDS) ** 2 * along

        return (pt.PrescribedMotion("tool", pulled),)

    return Body(
        f"A liver pulled at its front, {1e3 * spacing:g} mm", model, loads, (2e-4, 0.02), "m", (), TOOL_SECONDS, 0.01,
        lambda run, modes: pt.hyper_reduce(model, run, modes=modes, prescribed="tool"),
        "POD of that run, hyper-reduced",
    )  # fmt: skip


BODIES: dict[str, Callable[..., Body]] = {"beam": pulled_beam, "liver": pulled_liver}


class Comparison:
    """The full body's runs, its frequency response, and the measured models of all methods and sizes."""

    def __init__(self, body: Body, condense: int) -> None:
        self.body, small = body, body.loads(body.sizes[0])
        self.system = system = pt.lti.linearise(body.model, small, body.outputs)
        print(f"linearised {system.order} unknowns", flush=True)
        largest = input_sizes(system, small, body.duration)
        self.emphasis = emphasis = np.maximum(largest / largest.max(), MIN_INPUT_WEIGHT)
        training = (small, body.duration, body.every)
        self.reduction = Reductions(system, condense, training, emphasis)
        self.runs = {name: body.run(body.model, size) for name, size in zip(LOAD_NAMES, body.sizes, strict=True)}
        print(f"full body: {', '.join(f'{run.wall_seconds:.1f} s' for run in self.runs.values())}", flush=True)
        poles = self.reduction.condensed.poles
        moving = np.sort(np.abs(poles[poles.imag > 0]))
        ends = 0.2 * moving[0], moving[-1]
        spread = np.geomspace(*ends, SPREAD_FREQUENCIES)
        self.frequencies = np.unique(np.concatenate([spread, moving[:RESONANT_FREQUENCIES]]))  # [rad/s]
        self.response = self.reduction.condensed.reduced.transfer(1j * self.frequencies)
        self.few = np.unique(np.concatenate([moving[:2], np.geomspace(*ends, FULL_FREQUENCIES)]))
        self.whole = system.frequency_response(self.few)  # of the body that is not condensed
        self.models: dict[tuple[str, int], LinearModel] = {}
        self.entries: list[dict[str, Any]] = []
        self.nonlinear: list[dict[str, Any]] = []

    def sizes(self, response: np.ndarray) -> np.ndarray:
        """Return the largest singular values (t,) of a response (t, q, p), inputs and outputs scaled."""
        return self.reduction.sizes(response)

    def missed(self, model: LinearModel) -> np.ndarray:
        """Return the sizes (t,) of the error of a model's frequency response."""
        return self.sizes(self.response - model.reduced.transfer(1j * self.frequencies))

    def compare(self, methods: list[str], sizes: list[int]) -> None:
        """Make and measure linear models by all methods and sizes, and nonlinear ones of the same sizes."""
        for method in methods:
            for size in sizes:
                self.entries.append({"method": method, "modes": size} | self._linear(method, size))
                print(f"{method}, {size} modes: {_shown(self.entries[-1])}", flush=True)
        for size in sizes:
            self.nonlinear.append({"modes": size} | self._nonlinear(size))
            print(f"{self.body.nonlinear_name}, {size} modes: {_shown(self.nonlinear[-1])}", flush=True)

    def _linear(self, method: str, size: int) -> dict[str, Any]:
        try:
            model = self.reduction.model(method, size)
        except (pt.InputError, np.linalg.LinAlgError, ValueError) as error:
            return {"failed": True, "reason": " ".join(str(error).split())}
        self.models[method, size] = model
        error = self.missed(model).max()
        return {
            "failed": False,
            "states": model.reduced.states,
            "offline_seconds": model.report["seconds"],
            "shared_seconds": model.report["shared_seconds"],
            "step_seconds": _step_seconds(model),
            "step_bytes": sum(array.nbytes for array in model._propagator(STEP_SECONDS)),
            "field_bytes": model.columns.nbytes,
            "stable": model.stable,
            "response_error": error / self.sizes(self.response).max(),
            "absolute_error": error,
            "hankel_bound": self.reduction.bound(model.reduced.states),
            "errors": self._errors(model),
        }

    def _nonlinear(self, size: int) -> dict[str, Any]:
        start = perf_counter()
        try:
            model = self.body.nonlinear(self.runs["large"], size)
        except pt.InputError as error:
            return {"failed": True, "reason": " ".join(str(error).split())}
        return {"failed": False, "offline_seconds": perf_counter() - start, "errors": self._errors(model)}

    def _errors(self, model: Any) -> dict[str, dict[str, float] | None]:
        """Return the errors by load against the full nonlinear body; None for a run that diverged."""
        result: dict[str, dict[str, float] | None] = {}
        for (name, full), size in zip(self.runs.items(), self.body.sizes, strict=True):
            try:
                with warnings.catch_warnings(action="ignore", category=pt.TrustWarning):  # errors are measured
                    run = self.body.run(model, size)
                result[name] = pt.relative_errors(full, run).as_dict() | {"wall_seconds": run.wall_seconds}
            except pt.DivergenceError:
                result[name] = None
        return result

    def report(self) -> dict[str, Any]:
        """Return all measured values."""
        body, reduction, cloud = self.body, self.reduction, self.body.model.cloud
        apart = self.whole - reduction.condensed.reduced.transfer(1j * self.few)
        return plain({
            "title": body.title,
            "parameters": {
                "nodes": len(cloud), "unknowns": self.system.order, "spacing": cloud.spacing, "form": body.model.form,
                "stiffness_damping": body.model.stiffness_damping, **dict(zip(LOAD_NAMES, body.sizes, strict=True)),
                "unit": body.unit, "duration": body.duration, "condensed_to": reduction.condensed.count,
                "emphasis": self.emphasis,
            },
            "machine": machine(),
            "full": {
                name: {"wall_seconds": run.wall_seconds, "steps": run.steps[-1],
                       "largest_displacement": np.linalg.norm(run.displacements, axis=2).max()}
                for name, run in self.runs.items()
            },
            "condensing_error": self.sizes(apart).max() / self.sizes(self.whole).max(),
            "shared_seconds": reduction.seconds,
            "hankel_singular_values": reduction.hankel_singular_values,
            "methods": self.entries,
            "nonlinear": {"name": body.nonlinear_name, "entries": self.nonlinear},
        })  # fmt: skip

    def table(self) -> Table:
        """Return all entries as rows."""
        rows = {f"{entry['method']} {entry['modes']}": _row(entry) for entry in self.entries}
        rows |= {f"nonlinear {entry['modes']}": _row(entry) for entry in self.nonlinear}
        return quantities_table(self.body.title, HEADINGS, rows, first="method")


def _step_seconds(model: LinearModel) -> float:
    """Return the time [s] of one compiled step, the median of some rounds."""
    f = np.zeros((TIMED_STEPS + 1, model.system.forces))
    kicks = np.zeros((TIMED_STEPS + 1, model.lifting_count))
    x, parts = np.zeros(len(model.A)), model._propagator(STEP_SECONDS)
    history, times = np.zeros((TIMED_STEPS + 1, len(x))), []
    for _ in range(TIMING_ROUNDS + 1):
        start = perf_counter()
        propagate(x, *parts, f, kicks, history)
        times.append((perf_counter() - start) / TIMED_STEPS)
    return float(np.median(times[1:]))


def _shown(entry: dict[str, Any]) -> str:
    if entry["failed"]:
        return f"failed: {entry['reason']}"
    errors = [each and f"{each['displacement']:.2%}" for each in entry["errors"].values()]
    return f"displacement errors {', '.join(each or 'diverged' for each in errors)}"


def _row(entry: dict[str, Any]) -> list[str]:
    cells = dict.fromkeys(HEADINGS, "")
    if entry["failed"]:
        return [*(cells | {"states": "failed"}).values()]
    cells["offline s"] = f"{entry['offline_seconds']:.2f}"
    if "states" in entry:
        cells |= {
            "states": str(entry["states"]), "shared s": f"{entry['shared_seconds']:.1f}",
            "us/step": f"{1e6 * entry['step_seconds']:.2f}", "step kB": f"{entry['step_bytes'] / 1e3:.0f}",
            "stable": "yes" if entry["stable"] else "no", "response %": f"{100 * entry['response_error']:.3g}",
        }  # fmt: skip
    for load, errors in entry["errors"].items():
        for each in QUANTITIES:
            cells[f"{load}: {each} %"] = "diverged" if errors is None else f"{100 * errors[each]:.3g}"
    return [*cells.values()]


def main() -> None:
    """Compare the methods on a body, and leave a report with figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("body", choices=BODIES)
    parser.add_argument("--modes", type=int, nargs="+", default=[4, 8, 16, 24], metavar="M")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=[*METHODS], metavar="NAME")
    parser.add_argument("--spacing", type=float, metavar="M", help="0.005 m by default for the beam, 0.012 m the liver")
    parser.add_argument("--poisson", type=float, metavar="NU", help="0.49 by default for the beam, 0.45 for the liver")
    parser.add_argument("--condense", type=int, default=CONDENSED_MODES, metavar="K", help="slowest modes to balance")
    parser.add_argument("--out", type=Path, default=Path("out/linear_reductions"), metavar="FOLDER")
    options = parser.parse_args()
    require("matplotlib", "the figures")
    options_given = {"spacing": options.spacing, "poisson": options.poisson}
    body = BODIES[options.body](**{name: value for name, value in options_given.items() if value is not None})
    made = Comparison(body, options.condense)
    made.compare(options.methods, sorted(set(options.modes)))
    report = made.report()
    options.out.mkdir(parents=True, exist_ok=True)
    figures = linear_reductions_figures.draw(made, options.out)
    condensed = (
        f"Condensing {report['parameters']['unknowns']} unknowns to {report['parameters']['condensed_to']} changed "
        f"the frequency response by {100 * report['condensing_error']:.2g} % of its largest value."
    )
    deliver(report, [condensed], options.out, [*REPORTS, *figures], False, written=[condensed, made.table()])


if __name__ == "__main__":
    main()
