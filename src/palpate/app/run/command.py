"""``palpate run SCENE``: the full or a reduced model of a scene, once or in real time."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any, cast

import numpy as np

from palpate.app.common.arguments import parse_settings
from palpate.app.common.console import Console, Table, count_nodes
from palpate.app.common.exit_status import RunError
from palpate.app.common.load_cases import build_load_case
from palpate.app.common.report import REPORTS, deliver, machine
from palpate.app.common.rows import Rows, named_rows, quantities
from palpate.app.device.options import take_device
from palpate.app.models.input import open_input
from palpate.app.run.realtime import run_realtime
from palpate.app.session.opening import check_record
from palpate.core.faults import DivergenceError, InputError, TrustWarning, integer_in_range
from palpate.core.files import plain
from palpate.core.parameters import quantity
from palpate.dynamics.run.model import Model
from palpate.dynamics.run.rollout import rollout
from palpate.dynamics.run.trajectory import Trajectory
from palpate.dynamics.solid.model import Solid
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.storage.models import load as load_model
from palpate.reduction.training.errors import relative_errors
from palpate.reduction.training.reduce import hyper_reduce
from palpate.scenes.beam import DURATION, EVERY, beam
from palpate.scenes.load_case import LoadCase

FILES = (*REPORTS, "full.h5", "reduced.h5")
PRESS_SEED = 500_000  # of the path of a scene without loads: the first held-out one
RUN_SNAPSHOTS = round(DURATION / EVERY)
RUN_ROWS: Rows = {
    "computing time": "{wall_seconds:.3g s}",
    "simulated time over computing time": "{real_time_factor:.3g}",
    "time steps": "{steps}",
    "a step": "{seconds_per_step: us}",
    "largest displacement": "{largest_displacement:.4g mm}",
    "energy balance, largest miss over largest work": "{energy_balance:.2%}",
}
PAPER_SCENE = "beam"  # a single run is that of the paper, in its strong form
PAPER_UNITS = {"spacing": "m", "load": "N", "poisson": ""}  # its settings


def run(
    *,
    source: str,
    realtime: bool = False,
    full: bool = False,
    cut: bool = False,
    model: Path | None = None,
    script: Path | None = None,
    record: Path | None = None,
    seconds: float | None = None,
    rate: float | None = None,
    spacing: float | None = None,
    load: float | None = None,
    poisson: float | None = None,
    given: Sequence[str] = (),
    modes: int | None = None,
    out: Path,
    as_json: bool = False,
    **shape: Any,
) -> int:
    """Run a body once or in real time: `run_once`, `palpate.app.run.realtime.run_realtime`.

    `model` is the file of a reduced model of the scene, in place of that which is trained at the first use. `shape` has
    the options of a surface file, and those of a device (`palpate.app.device.options`).
    """
    device = take_device(shape)
    words: dict[str, Any] = {"spacing": spacing, "poisson": poisson, "modes": modes}
    words = {name: value for name, value in words.items() if value is not None}
    if not (realtime or cut or script is not None or device):  # a cut, a script and a device are in real time
        for name, value in (
            ("seconds", seconds), ("rate", rate), ("model", model), ("full", full or None), ("record", record)
        ):  # fmt: skip
            if value is not None:
                raise InputError(f"{name} must be left out of a single run, got {value}; or add --realtime")
        return run_once(source=source, load=load, given=given, out=out, as_json=as_json, **words, **shape)
    if load is not None:
        raise InputError(f"load must be left out in real time, got {load:g}; a tool moves the body instead")
    if words and model is not None:
        name = next(iter(words))
        raise InputError(f"{name} must be left out with --model, got {words[name]}; the file's model has its own")
    if (full or cut) and model is not None:
        option = "--cut" if cut else "--full"
        raise InputError(f"model must be left out with {option}, got {str(model)!r}; leave out one of the two")
    if record is not None:
        check_record(record, source)
    spacing = words.pop("spacing", None)
    opened = open_input(source, words | parse_settings(given), spacing, for_training=not (full or cut), **shape)
    if model is not None:
        opened = replace(opened, name=str(model), model=load_model(model))
    if (full or cut) and opened.scene is None:
        raise InputError(f"full and cut must be left out for the model of a file, got one of them for {source!r:.60}")
    limits = {name: value for name, value in (("seconds", seconds), ("rate", rate)) if value is not None}
    full = full or cut
    return run_realtime(
        opened, full=full, cut=cut, script=script, record=record, device=device, out=out, as_json=as_json, **limits
    )  # fmt: skip


def run_once(
    *,
    source: str,
    spacing: float | None = None,
    load: float | None = None,
    poisson: float | None = None,
    given: Sequence[str] = (),
    modes: int | None = None,
    out: Path,
    as_json: bool = False,
    **shape: Any,
) -> int:
    """Run the full body of a scene under its loads, and leave the trajectory and a report in a folder.

    A scene without loads is pressed by its tool. The run of the beam is the paper's (`palpate.scenes.beam.beam`), and
    `load` [N] is of it. With `modes`, train a hyper-reduced model of so many modes on the full run, and run it, too;
    the full model then is in its energy form, which the reduced one samples.
    """
    if modes is not None:
        integer_in_range("modes", modes, 1, RUN_SNAPSHOTS)
    words = {"spacing": spacing, "load": load, "poisson": poisson}
    settings = {name: value for name, value in words.items() if value is not None} | parse_settings(given)
    if load is not None and source != PAPER_SCENE:
        raise InputError(f"load must be left out of {source}, got {load:g}; change the loads in its file")
    console = Console()
    doubles = 6 if modes is None else 12
    made = build_load_case(lambda: _load_case(source, settings, modes is not None, shape), out, doubles, console)
    for name in FILES:  # of an earlier run: all files of a folder belong together
        (out / name).unlink(missing_ok=True)
    runs, reduced = {"full": _run(made, made.model, console, out / "full.h5")}, None
    if modes is not None:
        start = perf_counter()
        reduced = hyper_reduce(cast(Solid, made.model), runs["full"], modes=modes)
        count = count_nodes(reduced.report["nodes"])
        console.say(f"trained {modes} modes at {count} in {perf_counter() - start:.3g} s")
        runs["reduced"] = _run(made, reduced, console)
        runs["reduced"].save(out / "reduced.h5")
    report = _report(made, runs, reduced)
    deliver(report, [_table(report)], out, FILES, as_json)
    return 0


def _load_case(name: str, settings: dict[str, Any], energy: bool, shape: Mapping[str, Any]) -> LoadCase:
    """Return a body and its loads for a single run, the body in the energy form if asked."""
    if name == PAPER_SCENE:
        option = next((key for key, value in shape.items() if value not in (None, 1.0, [], ())), None)
        if option is not None:
            raise InputError(f"{option} must be left out of the beam, which has no surface file; leave it out")
        values: dict[str, Any] = {key: _paper_value(key, value) for key, value in settings.items()}
        return beam(**values, form="energy" if energy else "strong")
    scene = open_input(name, settings, for_training=True, **shape).scene
    if scene is None:
        raise InputError(
            f"source must be a scene or a surface file for a single run, got the model {name!r:.60}; add --script"
        )
    loads, duration, every = scene.loads, scene.duration, scene.every
    if not scene.description.load:
        (loads, duration), every = scene.paths(PRESS_SEED), scene.description.training.every
    parameters = {"spacing": scene.body.cloud.spacing}
    return LoadCase(scene.body, loads, duration, every, scene.title, parameters, scene.start)


def _paper_value(key: str, value: Any) -> float:
    """Return the value of a setting of the paper's beam in SI units."""
    if key not in PAPER_UNITS:
        raise InputError(
            f"set must name {', '.join(PAPER_UNITS)} for a single run of the beam, got {key!r:.60}; use one"
        )
    try:
        return quantity(value, PAPER_UNITS[key])
    except InputError as error:
        raise InputError(f"{key} {error}") from None


def _report(case: LoadCase, runs: dict[str, Trajectory], model: ReducedModel | None) -> dict[str, Any]:
    report: dict[str, Any] = {
        "title": case.title,
        "parameters": dict(case.parameters),
        "form": cast(Solid, case.model).form,
        "machine": machine(),
        "model": model and model.report,
        "runs": {name: _run_entry(run, case) for name, run in runs.items()},
    }
    if len(runs) == 2:
        report["errors"] = relative_errors(runs["full"], runs["reduced"]).as_dict()
        report["ratio"] = runs["reduced"].wall_seconds / runs["full"].wall_seconds
    return {name: plain(value) for name, value in report.items()}


def _run(case: LoadCase, model: Model, console: Console, file: Path | None = None) -> Trajectory:
    """Run a model; write the frames of a long run to a file, if there is one."""
    prepared = model.prepare(case.loads)
    note = f"; the frames until then are kept in {file}" if file else ""
    try:
        step = min(case.every, model.stable_step(model.state(prepared), prepared)[0])
        with warnings.catch_warnings(action="ignore", category=TrustWarning):  # a line below has the number
            begin: Any = {"displacement": case.displacement}
            rollout(model, case.loads, duration=step, every=step, progress=False, **begin)  # compiles the rest
            run = rollout(model, case.loads, duration=case.duration, every=case.every, file=file, **begin)
    except DivergenceError as error:
        raise RunError(f"the {model.name} model diverged: {error}{note}") from error
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"in the {model.name} run{note}") from None
    trust = "" if not len(run.trust) else f"; error indicator at most {run.trust.max():.3g}"
    if trust and run.trust.max() > 1:
        trust += " (above 1: not trained on such states)"
    console.say(f"{model.name} model: {run.wall_seconds:.3g} s, {int(run.steps[-1])} steps{trust}")
    return run


def _run_entry(run: Trajectory, case: LoadCase) -> dict[str, Any]:
    peaks = {name: float(np.linalg.norm(force, axis=1).max()) for name, force in run.reactions.items()}
    return {
        "nodes": len(run.points),
        "wall_seconds": run.wall_seconds,
        "real_time_factor": case.duration / run.wall_seconds,
        "steps": int(run.steps[-1]),
        "seconds_per_step": run.wall_seconds / float(run.steps[-1]),
        "stiffness_damping": run.stiffness_damping,
        "largest_displacement": float(np.linalg.norm(run.displacements, axis=2).max()),
        "largest_reactions": peaks,
        "largest_trust": float(run.trust.max()) if len(run.trust) else None,
        "energy_balance": float(np.abs(run.balance).max() / np.abs(run.external).max()),
    }


def _table(report: dict[str, Any]) -> Table:
    names = [f"full model, {report['form']} form", "reduced model"]
    runs = dict(zip(names, report["runs"].values(), strict=False))
    if "errors" in report:
        runs["reduced model"] = runs["reduced model"] | {"errors": report["errors"], "ratio": report["ratio"]}
    forces = report["runs"]["full"]["largest_reactions"]
    rows = RUN_ROWS | named_rows("largest force of {!r}", "largest_reactions", "{value:.4g N}", forces)
    rows |= named_rows("error of {}", "errors", "{value:.2%}", report.get("errors", ()))
    return quantities(report["title"], rows | {"time over the full model's": "{ratio:.2%}"}, runs)
