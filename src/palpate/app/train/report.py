"""Report of a campaign: runs, the reduced model and its errors, with a figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from palpate.app.common.console import Console, Table, count_nodes, percent, quantities_table
from palpate.app.common.figures import BLUE, GREEN, ORANGE, PINK, figure, heading, legend_below, percent_axis
from palpate.app.common.rendering import DrawingError
from palpate.app.common.report import REPORTS, deliver, machine
from palpate.app.common.rows import Rows, quantities
from palpate.app.train.campaign import MODEL_FILE, Round
from palpate.app.train.coverage import coverage, draw_coverage
from palpate.app.train.folder import HELD_OUT, RECORDED, TRAINED, Folder, Job
from palpate.app.train.paths import path_of
from palpate.core.faults import InputError
from palpate.core.files import plain
from palpate.dynamics.contact.tools import Contact, Grasp
from palpate.dynamics.run.trajectory import StoredTrajectory
from palpate.reduction.hyper.error_indicator import expected_error
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.training.scales import ERROR_QUANTILE
from palpate.scenes.load_case import TrainingScene

ERRORS_FIGURE, COVERAGE_FIGURE = "errors.png", "coverage.png"
FILES = (MODEL_FILE, *REPORTS, ERRORS_FIGURE, COVERAGE_FIGURE, "campaign.json", "runs")
CONTACT_ERRORS = {
    "force": "force on tools, median",
    "force_95": "force on tools, 95th percentile",
    "surface_95": "displacement of the surface, 95th percentile",
}  # as `palpate.reduction.training.errors.ContactErrors` names them
SMALL_CHANGE = 0.05  # of a force, below which supports need not be known better
CURVE_POINTS = 100  # of a curve of expected errors
FIELD_ERRORS = ("displacement", "velocity")  # whose errors are relative to each moment's size
ERROR_COLOURS = {"displacement": BLUE, "velocity": GREEN, "energy": ORANGE, "reaction": PINK}


RUN_ROWS: Rows = {
    "runs to train on, held out, failed": "{totals/trained}, {totals/held_out}, {totals/failed}",
    "of these along recorded paths": "{totals/recorded}",
}
MODEL_ROWS: Rows = {
    "free surface within one tool radius of a place touched in training": "{coverage/covered:.0%}",
    "free surface that the tool reaches; covered of it": (
        "{coverage/reachable:.0%}; {coverage/covered_of_reachable:.0%}"
    ),
    "surface held by supports": "{coverage/held:.0%}",
    "full model": lambda report: count_nodes(report["campaign"]["nodes"]),
    "simulated time": "{totals/simulated:.4g s}",
    "computing time of the runs": "{totals/wall_seconds:.4g s}",
    "runs on disk": "{sizes/run_bytes:.1f MB}",
    "snapshots trained on": "{model/snapshots}",
    "modes": "{model/modes}",
    "nodes sampled; relative error of their forces": "{model/nodes}; {model/cubature:.2g}",
    "projection error": "{model/projection_error:.2%}",
    "time to train and try the model": "{seconds/training:.4g s}",
    "model on disk": "{sizes/model_bytes:.2f MB}",
}


def report_campaign(
    folder: Folder,
    scene: TrainingScene,
    jobs: Sequence[Job],
    model: ReducedModel,
    seconds: Mapping[str, float],
    rounds: Sequence[Round],
    supports: Mapping[str, Any] | None,
    as_json: bool,
) -> None:
    """Write the report and the figure into the folder, and print it as JSON or as a table."""
    runs = [_run_entry(folder, scene, job) for job in jobs]
    good = [job for job, run in zip(jobs, runs, strict=True) if job.kind != HELD_OUT and not run["failed"]]
    covered = coverage(scene, [path_of(folder, scene, job) for job in good])
    report = plain(
        {
            "title": f"Training: {scene.title}",
            "campaign": dict(folder.manifest),
            "machine": machine(),
            "runs": runs,
            "failed": [run["name"] for run in runs if run["failed"]],
            "sizes": _sizes(folder, jobs),
            "seconds": dict(seconds),
            "rounds": [each._asdict() for each in rounds],
            "supports": supports,
            "coverage": None if covered is None else covered.shares(),
            "model": model.report,
        }
    )
    held_out_names = [run["name"] for run in runs if run["kind"] == HELD_OUT and not run["failed"]]
    for figure_of, draw in (
        (ERRORS_FIGURE, (lambda: _draw(folder, report, held_out_names)) if held_out_names else None),
        (COVERAGE_FIGURE, None if covered is None else lambda: draw_coverage(covered, folder.path / COVERAGE_FIGURE)),
    ):
        (folder.path / figure_of).unlink(missing_ok=True)  # of an earlier model
        try:
            if draw is not None:
                draw()
        except (InputError, DrawingError) as error:  # a worker's installation need not draw
            Console().say(f"{figure_of} is missing: {error}")
    table = quantities(report["title"], _rows(report), {"here": report | {"totals": _totals(report)}})
    failed = [f"{run['name']} failed: {run['reason']}" for run in runs if run["failed"]]
    sentences = [*_support_sentences(supports), *([model.report["advice"]] if "advice" in model.report else [])]
    written = [table, *_details(report, held_out_names), *sentences]
    deliver(report, [table, *failed, *sentences], folder.path, FILES, as_json, written=written)


def _run_entry(folder: Folder, scene: TrainingScene, job: Job) -> dict[str, Any]:
    """Return the entry of a run in the report: its frames, cost and kinds of loads."""
    loads = [type(load).__name__ for load in path_of(folder, scene, job)[0]]
    entry: dict[str, Any] = {"name": job.name, "kind": job.kind, "seed": job.seed, "loads": loads}
    entry |= {"failed": True, "reason": None}
    path = folder.file(job)
    if not path.exists():
        entry["reason"] = (folder.record(job) or {"reason": None})["reason"]
        path = folder.failed(job)
        if not path.exists():
            return entry | {"frames": 0, "simulated": 0.0, "steps": 0, "wall_seconds": 0.0}
    else:
        entry["failed"] = False
    run = StoredTrajectory(path)
    frames = len(run.times)
    entry |= {
        "frames": frames,
        "simulated": float(run.times[-1]) if frames else 0.0,
        "steps": int(run.steps[-1]) if frames else 0,
        "wall_seconds": run.wall_seconds,
    }
    return entry


def _sizes(folder: Folder, jobs: Sequence[Job]) -> dict[str, Any]:
    files = [folder.file(job) for job in jobs if folder.file(job).exists()]
    return {
        "run_bytes": sum(file.stat().st_size for file in files),
        "model_bytes": (folder.path / MODEL_FILE).stat().st_size,
    }


def _totals(report: dict[str, Any]) -> dict[str, Any]:
    """Return counts and sums over the runs, for the table."""
    good = [run for run in report["runs"] if not run["failed"]]
    kinds = {kind: sum(run["kind"] == kind for run in good) for kind in (TRAINED, RECORDED, HELD_OUT)}
    return {
        "trained": kinds[TRAINED] + kinds[RECORDED],
        "held_out": kinds[HELD_OUT],
        "failed": len(report["failed"]),
        "simulated": sum(run["simulated"] for run in good),
        "wall_seconds": sum(run["wall_seconds"] for run in good),
        **({"recorded": kinds[RECORDED]} if kinds[RECORDED] else {}),
    }


def _rows(report: dict[str, Any]) -> Rows:
    held_out = report["model"].get("held_out")
    rows: Rows = {**RUN_ROWS, **_round_rows(report["rounds"]), **MODEL_ROWS}
    if held_out:
        failed = sum(run["failed"] for run in held_out["runs"])
        if failed:
            rows["held-out paths that the reduced model failed on"] = str(failed)
        for name in ERROR_COLOURS:
            field = "contact" in held_out and name in FIELD_ERRORS
            label = f"error of {name} on held-out paths{' (each moment alike, also at rest)' if field else ''}"
            rows[f"{label}, mean; 95 % below"] = _mean_and_bound(name)
        rows |= _by_load(report)
        for name, text in CONTACT_ERRORS.items():
            rows[f"error of {text} while pressed; mean over held-out paths, 95 % below"] = _mean_and_bound(
                name, "contact/"
            )
        for quantity in ("displacement", "force"):
            if quantity not in held_out.get("expected_error", {}):
                continue
            error = expected_error(report["model"], 1.0, quantity)
            label = (
                f"error of {quantity} expected at an error indicator of 1, median; {error.level:.0%} of runs "
                f"stay below ({error.least_level:.0%} or more with a confidence of 90%)"
            )
            known = np.isfinite(error.bound)
            rows[label] = f"{percent(error.median)}; {percent(error.bound)}" if known else "unknown; unknown"
    return rows | _support_rows(report["supports"])


def _mean_and_bound(name: str, where: str = "") -> str:
    return f"{{model/held_out/{where}mean/{name}:.2%}}; {{model/held_out/{where}percentile_95/{name}:.2%}}"


def _round_rows(rounds: Sequence[Mapping[str, Any]]) -> dict[str, str]:
    """Return the errors of the models by number of training runs; empty without a tolerance."""
    if not rounds:
        return {}
    errors = "; ".join(f"{each['runs']}, {each['modes']}: {percent(each['error'])}" for each in rounds)
    last = rounds[-1]
    status = "kept" if last["error"] <= last["tolerance"] else "not kept"
    tolerance = percent(last["tolerance"])
    return {f"error by number of training runs and modes; tolerance of {tolerance}": f"{errors}; {status}"}


def _by_load(report: dict[str, Any]) -> dict[str, str]:
    """Return errors of forces by kind of load; empty unless the held-out paths have several."""
    loads_of_runs = [run["loads"] for run in report["runs"] if run["kind"] == HELD_OUT and not run["failed"]]
    errors_by_load: dict[str, list[float]] = {}
    for loads, run in zip(loads_of_runs, report["model"]["held_out"]["runs"], strict=True):
        tools = [load for load in loads if load in (Contact.__name__, Grasp.__name__)]
        kinds = ["pair of tools"] if len(tools) > 1 else dict.fromkeys(loads)
        for kind in kinds if not run["failed"] else ():
            errors_by_load.setdefault(kind, []).append(run["reaction"])
    return {
        f"error of reaction on the {len(errors)} held-out paths with a {load}, mean; 95 % below": (
            f"{percent(float(np.mean(errors)))}; {percent(float(np.quantile(errors, ERROR_QUANTILE)))}"
        )
        for load, errors in (errors_by_load.items() if len(errors_by_load) > 1 else ())
    }


def _support_changes(study: Mapping[str, Any] | None) -> dict[str, dict[str, Mapping[str, Any] | None]]:
    """Return the effects of changed supports, by quantity and by way of change."""
    changes = {}
    if study and study["border"]:
        where = f"the border of the supports moves by {1e3 * study['border']['distance']:.2g} mm"
        changes[where] = {way: study["border"][way] for way in ("outward", "inward")}
    if study and study["springs"]:
        changes["the springs of foundations are"] = {way: study["springs"][way] for way in ("halved", "doubled")}
    return changes


def _support_rows(study: Mapping[str, Any] | None) -> dict[str, str]:
    """Return changes of the force on tools by the supports; empty without contact."""
    return {
        f"force on tools if {what} {way}, median; largest": "nothing would hold the body"
        if change is None
        else f"{change['median']:+.1%}; {change['largest']:+.1%}"
        for what, ways in _support_changes(study).items()
        for way, change in ways.items()
    }


def _support_sentences(study: Mapping[str, Any] | None) -> list[str]:
    """Return one sentence each about the effects of the border and of the springs."""
    sentences = []
    for what, ways in _support_changes(study).items():
        changes = [change for change in ways.values() if change is not None]
        if not changes:
            continue
        worst = max(changes, key=lambda change: abs(change["largest"]))
        place = ", ".join(f"{1e3 * x:.0f}" for x in worst["place"])
        advice = (
            "measure the attachment before such forces are used"
            if abs(worst["largest"]) > SMALL_CHANGE
            else "the attachment need not be known better"
        )
        sentences.append(
            f"The force of a tool at a given depth changes by up to {abs(worst['largest']):.0%}, at ({place}) mm, if "
            f"{what} {' or '.join(ways)}: {advice}. (Linear statics.)"
        )
    return sentences


def _contact_table(held_out: dict[str, Any], names: Sequence[str]) -> list[Table]:
    """Return the table of contact errors of every held-out path with contact."""
    if "contact" not in held_out:
        return []
    touched = [(name, run) for name, run in zip(names, held_out["runs"], strict=True) if "force" in run]
    rows = {name: [percent(run[k]) for k in CONTACT_ERRORS] for name, run in touched}
    title = "Frames with at least a tenth of a tool's largest force"
    return [quantities_table(title, list(CONTACT_ERRORS.values()), rows, first="held-out path")]


def _details(report: dict[str, Any], names: Sequence[str]) -> list[Table | str]:
    """Return the scene, the errors of every held-out path, and the runs that failed, for `report.md`."""
    campaign = report["campaign"]
    parameters = ", ".join(f"{name} = {value}" for name, value in campaign["parameters"].items())
    blocks: list[Table | str] = [f"Scene `{campaign['scene']}` with {parameters}; seed {campaign['seed']}."]
    if names:
        rows, loads = {}, {run["name"]: ", ".join(run["loads"]) for run in report["runs"]}
        for name, run in zip(names, report["model"]["held_out"]["runs"], strict=True):
            failed = [run["reason"], *[""] * (len(ERROR_COLOURS) - 1)] if run["failed"] else None
            rows[name] = [loads[name], *(failed or [percent(run[k]) for k in ERROR_COLOURS])]
        blocks.append(
            quantities_table("Errors on held-out paths", ["loads", *ERROR_COLOURS], rows, first="held-out path")
        )
        blocks += _contact_table(report["model"]["held_out"], names)
    failures = [run for run in report["runs"] if run["failed"]]
    return blocks + [f"{run['name']} failed after {run['simulated']:.4g} s: {run['reason']}" for run in failures]


def _draw(folder: Folder, report: dict[str, Any], names: Sequence[str]) -> None:
    """Draw the errors of every held-out path, and the expected errors by error indicator."""
    model = report["model"]
    held_out = model["held_out"]
    with figure(folder.path / ERRORS_FIGURE, (9.0, 4.6)) as drawn:
        heading(drawn, "Errors on paths that were not trained on")
        paths, trust = drawn.subplots(1, 2)
        for name, colour in ERROR_COLOURS.items():
            good = [(k, 100 * run[name]) for k, run in enumerate(held_out["runs"]) if not run["failed"]]
            paths.plot(*np.array(good).reshape(-1, 2).T, "o", ms=5, color=colour, label=name)
        paths.set(xlabel="held-out path", ylabel="error [%]", title="by path", xlim=(-0.5, len(names) - 0.5))
        paths.xaxis.get_major_locator().set_params(integer=True)
        percent_axis(paths)
        curves = held_out.get("expected_error") or {}
        for what, colour in (("displacement", BLUE), ("force", ORANGE)):
            if what not in curves:
                continue
            numbers = np.linspace(0.0, curves[what]["largest_trust"], CURVE_POINTS)
            errors = 100 * np.array([expected_error(model, number, what)[:2] for number in numbers])
            trust.plot(numbers, errors[:, 1], color=colour, label=f"{what}: {curves['level']:.0%} of runs stay below")
            trust.plot(numbers, errors[:, 0], color=colour, ls=":", label=f"{what}: median of the frames")
        trust.set(xlabel="largest error indicator so far", ylabel="error over the mean of present and typical size [%]")
        trust.set_title("by error indicator; unknown beyond the curves")
        trust.set_ylim(bottom=0.0)
        legend_below(drawn, paths, columns=len(ERROR_COLOURS))
        if curves:
            trust.legend(fontsize=9)
