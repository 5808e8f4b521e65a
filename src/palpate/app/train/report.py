"""What a campaign leaves for people and machines: report.json, report.md and a figure."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from palpate.app.console import Console, count_nodes, percent, print_json, print_plain, quantities_table
from palpate.app.figures import BLUE, GREEN, ORANGE, PINK, figure, heading, legend_below, percent_axis
from palpate.app.report import machine
from palpate.app.train.campaign import MODEL
from palpate.app.train.folder import HELD_OUT, TRAINED, Folder, Job
from palpate.dynamics.run.trajectory import StoredTrajectory
from palpate.faults import InputError
from palpate.files import plain, whole_file, write_json
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.training.reduce import HELD_SHARE
from palpate.scenes.scene import TrainingScene

__all__ = ["FILES", "deliver"]

FIGURE = "errors.png"
FILES = (MODEL, "report.json", "report.md", FIGURE, "campaign.json", "runs")
TOUCH = {
    "force": "force on tools, median",
    "force_95": "force on tools, 95th percentile",
    "surface_95": "displacement of the surface, 95th percentile",
}  # as `palpate.reduction.training.errors.TouchErrors` names them
KINDS = {"displacement": BLUE, "velocity": GREEN, "energy": ORANGE, "reaction": PINK}


def deliver(
    folder: Folder,
    scene: TrainingScene,
    wanted: Sequence[Job],
    model: ReducedModel,
    seconds: Mapping[str, float],
    as_json: bool,
) -> None:
    """Write the report and the figure into the folder, and print it as JSON or as a table."""
    runs = [_described(folder, scene, job) for job in wanted]
    report = plain(
        {
            "title": f"Training: {scene.title}",
            "campaign": dict(folder.manifest),
            "machine": machine(),
            "runs": runs,
            "failed": [run["name"] for run in runs if run["failed"]],
            "sizes": _sizes(folder, wanted),
            "seconds": dict(seconds),
            "model": model.report,
        }
    )
    held = [run["name"] for run in runs if run["kind"] == HELD_OUT and not run["failed"]]
    (folder.path / FIGURE).unlink(missing_ok=True)  # of an earlier model
    pictures = []
    if held:
        try:
            _draw(folder, report, held)
            pictures = [FIGURE]
        except InputError as error:  # a worker's installation need not draw
            Console().say(f"{FIGURE} is missing: {error}")
    write_json(folder.path / "report.json", report)
    rows = _rows(report)
    with whole_file(folder.path / "report.md") as partial:
        partial.write_text(_markdown(report, rows, held, pictures), encoding="utf-8")
    if as_json:
        print_json(report)
        return
    told = [quantities_table(report["title"], ["here"], {name: [value] for name, value in rows.items()})]
    failed = [f"{run['name']} failed: {run['reason']}" for run in runs if run["failed"]]
    print_plain([*told, *failed], folder.path, [name for name in FILES if (folder.path / name).exists()])


def _described(folder: Folder, scene: TrainingScene, job: Job) -> dict[str, Any]:
    """What the folder says of a run, and the kinds of its loads."""
    loads = [type(load).__name__ for load in scene.path(job.seed)[0]]
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


def _sizes(folder: Folder, wanted: Sequence[Job]) -> dict[str, Any]:
    files = [folder.file(job) for job in wanted if folder.file(job).exists()]
    return {
        "run_bytes": sum(file.stat().st_size for file in files),
        "model_bytes": (folder.path / MODEL).stat().st_size,
    }


def _rows(report: dict[str, Any]) -> dict[str, str]:
    runs, model, sizes = report["runs"], report["model"], report["sizes"]
    good = [run for run in runs if not run["failed"]]
    simulated = sum(run["simulated"] for run in good)
    wall = sum(run["wall_seconds"] for run in good)
    kinds = {kind: sum(run["kind"] == kind for run in good) for kind in (TRAINED, HELD_OUT)}
    rows = {
        "runs to train on, held out, failed": f"{kinds[TRAINED]}, {kinds[HELD_OUT]}, {len(report['failed'])}",
        "full model": count_nodes(report["campaign"]["nodes"]),
        "simulated time": f"{simulated:.4g} s",
        "computing time of the runs": f"{wall:.4g} s",
        "runs on disk": f"{sizes['run_bytes'] / 1e6:.1f} MB",
        "snapshots trained on": str(model["snapshots"]),
        "modes": str(model["modes"]),
        "nodes sampled; what they may miss of the forces": f"{model['nodes']}; {model['cubature']:.2g}",
        "projection error": percent(model["projection_error"]),
        "time to train and try the model": f"{report['seconds']['training']:.4g} s",
        "model on disk": f"{sizes['model_bytes'] / 1e6:.2f} MB",
    }
    if "held_out" in model:
        failed = sum(run["failed"] for run in model["held_out"]["runs"])
        if failed:
            rows["held-out paths that the reduced model failed on"] = str(failed)
        for name in KINDS:
            mean, worst = (model["held_out"][kind][name] for kind in ("mean", "percentile_95"))
            rows[f"error of {name} on held-out paths, mean; 95 % below"] = (
                "-" if mean is None else f"{percent(mean)}; {percent(worst)}"
            )
        rows |= _by_load(report) | _touch_rows(model["held_out"])
    return rows


def _by_load(report: dict[str, Any]) -> dict[str, str]:
    """Errors of forces for every kind of load, where the held-out paths have several."""
    held = [run["loads"] for run in report["runs"] if run["kind"] == HELD_OUT and not run["failed"]]
    found: dict[str, list[float]] = {}
    for loads, run in zip(held, report["model"]["held_out"]["runs"], strict=True):
        for load in dict.fromkeys(loads) if not run["failed"] else ():
            found.setdefault(load, []).append(run["reaction"])
    return {
        f"error of reaction on the {len(own)} held-out paths with a {load}, mean; 95 % below": (
            f"{percent(float(np.mean(own)))}; {percent(float(np.quantile(own, HELD_SHARE)))}"
        )
        for load, own in (found.items() if len(found) > 1 else ())
    }


def _touch_rows(found: dict[str, Any]) -> dict[str, str]:
    """Say what tools on the surface of a body miss; nothing where none touches it."""
    if "contact" not in found:
        return {}
    errors = {name: (found["contact"]["mean"][name], found["contact"]["percentile_95"][name]) for name in TOUCH}
    return {
        f"error of {text} while pressed; mean over held-out paths, 95 % below": "-"
        if errors[name][0] is None
        else f"{percent(errors[name][0])}; {percent(errors[name][1])}"
        for name, text in TOUCH.items()
    }


def _touch_table(found: dict[str, Any], held: Sequence[str]) -> list[str]:
    """The same of every held-out path whose tools touch the body, as lines of Markdown."""
    if "contact" not in found:
        return []
    lines = ["", "Frames with at least a tenth of a tool's largest force:", ""]
    lines += [f"| held-out path | {' | '.join(TOUCH.values())} |", "|---" * (len(TOUCH) + 1) + "|"]
    touched = [(name, run) for name, run in zip(held, found["runs"], strict=True) if "force" in run]
    return lines + [f"| {name} | {' | '.join(percent(run[k]) for k in TOUCH)} |" for name, run in touched]


def _markdown(report: dict[str, Any], rows: Mapping[str, str], held: Sequence[str], pictures: Sequence[str]) -> str:
    lines = [f"# {report['title']}", "", "| | |", "|---|---|"]
    lines += [f"| {name} | {value} |" for name, value in rows.items()]
    parameters = ", ".join(f"{name} = {value}" for name, value in report["campaign"]["parameters"].items())
    lines += ["", f"Scene `{report['campaign']['scene']}` with {parameters}; seed {report['campaign']['seed']}."]
    if held:
        lines += [line for name in pictures for line in ("", f"![Errors on held-out paths]({name})")]
        lines += ["", f"| held-out path | loads | {' | '.join(KINDS)} |"]
        lines += ["|---" * (len(KINDS) + 2) + "|"]
        loads = {run["name"]: ", ".join(run["loads"]) for run in report["runs"]}
        for name, run in zip(held, report["model"]["held_out"]["runs"], strict=True):
            told = [run["reason"], *[""] * (len(KINDS) - 1)] if run["failed"] else [percent(run[k]) for k in KINDS]
            lines.append(f"| {name} | {loads[name]} | {' | '.join(told)} |")
        lines += _touch_table(report["model"]["held_out"], held)
    failed = [run for run in report["runs"] if run["failed"]]
    if failed:
        lines += ["", "Runs of the full model that failed:", ""]
        lines += [f"- {run['name']}, after {run['simulated']:.4g} s: {run['reason']}" for run in failed]
    return "\n".join(lines) + "\n"


def _draw(folder: Folder, report: dict[str, Any], held: Sequence[str]) -> None:
    """Draw the errors of every held-out path, and what errors trust numbers have meant."""
    found = report["model"]["held_out"]
    with figure(folder.path / FIGURE, (9.0, 4.6)) as drawn:
        heading(drawn, "Errors on paths that were not trained on")
        paths, trust = drawn.subplots(1, 2)
        for name, colour in KINDS.items():
            good = [(k, 100 * run[name]) for k, run in enumerate(found["runs"]) if not run["failed"]]
            paths.plot(*np.array(good).reshape(-1, 2).T, "o", ms=5, color=colour, label=name)
        paths.set(xlabel="held-out path", ylabel="error [%]", title="by path", xlim=(-0.5, len(held) - 0.5))
        paths.xaxis.get_major_locator().set_params(integer=True)
        percent_axis(paths)
        rows = found.get("trust") or []
        for name, colour in (("percentile_95", ORANGE), ("median", BLUE)):
            label = "95 % below" if name == "percentile_95" else name
            points = [0.0, *(row["trust"] for row in rows)], [100 * row[name] for row in (*rows[:1], *rows)]
            trust.step(*points, where="pre", color=colour, label=label)
        trust.set(xlabel="trust number", ylabel="error of displacement [%]", title="by trust number")
        trust.set_ylim(bottom=0.0)
        legend_below(drawn, paths, columns=len(KINDS))
        trust.legend(fontsize=9)
