"""Report of a comparison: figures, tables, and a summary in sentences."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

import numpy as np

from palpate.app.common.console import Table, percent, quantities_table
from palpate.app.common.report import machine
from palpate.app.compare.measure import LOAD_NAMES, Comparison
from palpate.files import plain

__all__ = ["build_report", "full_table", "summary", "tables"]

COLUMN_HEADINGS = (
    "states", "offline s", "shared s", "us/step", "step kB", "stable", "small: displ.", "velocity", "energy", "force",
    "response", "large: displ.", "velocity", "energy", "force",
)  # fmt: skip
ADVICE_BY_METHOD = {
    "pod": "motions like the run it learnt from; blind to what that run did not excite",
    "moments": "slow loads: exact statics, no run needed; resonances come last",
    "balanced": "the response at the outputs over all frequencies, with a bound, and stable",
    "hankel": "the same, nearest in the Hankel norm; its displacements elsewhere are fitted",
    "sobt": "as balanced with half as many coordinates, but no bound and no promise of stability; so -p, -v, -pv",
    "sobt-fv": "as sobt, and stable where the stiffness is symmetric",
    "modal": "resonances, whose poles it keeps; statics converge slowly",
    "irka": "few modes, where its poles turn out stable and its errors small",
}
TERMINAL_COLUMNS = (1, 3, 5, 6, 9, 10, 11, 14)  # of these, the columns that fit into a terminal
TERMINAL_HEADINGS = {6: "small: displ.", 9: "force", 11: "large: displ.", 14: "force"}
ERROR_QUANTITIES = ("displacement", "velocity", "energy", "reaction")


def build_report(made: Comparison) -> dict[str, Any]:
    """Return all measured values."""
    body, reduction = made.body, made.reduction
    outputs, inputs = reduction.scales
    s = 1j * made.few
    apart = outputs[:, None] * (made.whole - reduction.source.transfer(s)) * inputs
    size = np.linalg.norm(outputs[:, None] * made.whole * inputs, 2, axis=(1, 2)).max()
    report = {
        "title": body.title,
        "parameters": {
            "nodes": len(body.model.cloud), "unknowns": made.system.order, "spacing": body.model.cloud.spacing,
            "form": body.model.form, "stiffness_damping": body.model.stiffness_damping,
            "small": body.small, "large": body.large, "unit": body.unit, "duration": body.duration,
            "condensed_to": len(reduction.source.mass),
            "inputs": list(made.system.inputs), "outputs": list(made.system.outputs),
            "emphasis": reduction.emphasis.tolist(),
        },
        "material": asdict(body.model.material),
        "machine": machine(),
        "full": {
            name: {"wall_seconds": run.wall_seconds, "steps": int(run.steps[-1]),
                   "seconds_per_step": run.wall_seconds / float(run.steps[-1]),
                   "largest_displacement": float(np.linalg.norm(run.displacements, axis=2).max())}
            for name, run in made.runs.items()
        },
        "condensing_error": float(np.linalg.norm(apart, 2, axis=(1, 2)).max() / size),
        "shared_seconds": reduction.seconds,
        "hankel_singular_values": reduction.hankel_singular_values.tolist(),
        "methods": made.entries,
        "nonlinear": {"name": body.nonlinear_name, "entries": made.nonlinear},
    }  # fmt: skip
    report["summary"] = summary(report)
    return dict(plain(report))


def _share(value: float) -> str:
    """Return a share in per cent; one digit of shares below 0.01 %."""
    return percent(value) if value >= 1e-4 else f"{100 * value:.0e}%"


def _row(entry: dict[str, Any]) -> list[str]:
    if entry["failed"]:
        return ["failed", *[""] * (len(COLUMN_HEADINGS) - 1)]
    cells = [
        str(entry["states"]), f"{entry['offline_seconds']:.2f}", f"{entry['shared_seconds']:.1f}",
        f"{1e6 * entry['step_seconds']:.2f}", f"{entry['step_bytes'] / 1e3:.0f}", "yes" if entry["stable"] else "no",
    ]  # fmt: skip
    for name in LOAD_NAMES:
        errors = entry["errors"][name]
        cells += ["diverged", "", "", ""] if errors is None else [percent(errors[what]) for what in ERROR_QUANTITIES]
        if name == "small":
            cells.append(_share(entry["response_error"]))
    return cells


def _nonlinear_row(entry: dict[str, Any]) -> list[str]:
    if entry["failed"]:
        return ["failed", *[""] * (len(COLUMN_HEADINGS) - 1)]
    cells = ["", f"{entry['offline_seconds']:.2f}", "", "", "", ""]
    for name in LOAD_NAMES:
        errors = entry["errors"][name]
        cells += ["diverged", "", "", ""] if errors is None else [percent(errors[what]) for what in ERROR_QUANTITIES]
        if name == "small":
            cells.append("")
    return cells


def _rows(report: dict[str, Any]) -> dict[str, list[str]]:
    rows = {f"{entry['method']} {entry['modes']}": _row(entry) for entry in report["methods"]}
    rows |= {f"nonlinear {entry['modes']}": _nonlinear_row(entry) for entry in report["nonlinear"]["entries"]}
    return rows


def tables(report: dict[str, Any]) -> list[Table | str]:
    """Return a table of the main figures, and the summary; `full_table` has all figures."""
    rows = {name: [cells[k] for k in TERMINAL_COLUMNS] for name, cells in _rows(report).items()}
    headings = [COLUMN_HEADINGS[k] if k not in TERMINAL_HEADINGS else TERMINAL_HEADINGS[k] for k in TERMINAL_COLUMNS]
    return [quantities_table(report["title"], headings, rows, first="method"), *report["summary"]]


def summary(report: dict[str, Any]) -> list[str]:
    """Return sentences about the figures of the report."""
    done = [entry for entry in report["methods"] if not entry["failed"]]
    about, lines = report["parameters"], []
    size = max((entry["modes"] for entry in done), default=0)
    largest = [entry for entry in done if entry["modes"] == size]

    def best(load: str, what: str) -> list[tuple[float, str]]:
        pairs = [(e["errors"][load][what], e["method"]) for e in largest if e["errors"][load] is not None]
        return sorted((value, name) for value, name in pairs if np.isfinite(value))

    small = best("small", "displacement")
    if small:
        order = ", ".join(f"{name} {percent(value)}" for value, name in small)
        lines.append(f"At {about['small']:g} {about['unit']} with {size} modes, displacements err by: {order}.")
    response = sorted((e["response_error"], e["method"]) for e in largest if e["stable"])
    if response:
        order = ", ".join(f"{name} {_share(value)}" for value, name in response)
        lines.append(f"Frequency response with {size} modes, largest error over the largest response: {order}.")
    unstable = sorted({f"{e['method']} ({e['modes']})" for e in done if not e["stable"]})
    lines.append(f"Unstable: {', '.join(unstable) if unstable else 'none'}.")
    large = best("large", "displacement")
    if large:
        value, name = large[0]
        at_small = {method: missed for missed, method in small}.get(name)
        also = f"; at the small load it misses {percent(at_small)}" if at_small is not None else ""
        lines.append(
            f"At {about['large']:g} {about['unit']} every linear method misses: with {size} modes {name} is nearest "
            f"and errs by {percent(value)} in displacements{also}. The worst errs by {percent(large[-1][0])}."
        )
    forces = best("large", "reaction")
    if forces:
        lines.append(f"There the force errs by {percent(forces[0][0])} at best ({forces[0][1]}).")
    nonlinear = [e for e in report["nonlinear"]["entries"] if not e["failed"] and e["errors"]["large"] is not None]
    if nonlinear:
        last = nonlinear[-1]
        lines.append(
            f"{report['nonlinear']['name']} with {last['modes']} modes errs there by "
            f"{percent(last['errors']['large']['displacement'])}, at the small load by "
            f"{percent(last['errors']['small']['displacement']) if last['errors']['small'] else 'nothing finite'}."
        )
    lines += [f"{name}: {what}." for name, what in ADVICE_BY_METHOD.items() if any(e["method"] == name for e in done)]
    lines.append("None is for large motions: nonlinear reduced models are.")
    lines.append(
        f"Condensing {about['unknowns']} unknowns to {about['condensed_to']} before balancing changed the frequency "
        f"response by {_share(report['condensing_error'])} of its largest value."
    )
    return lines


def full_table(report: dict[str, Any]) -> Table:
    """Return the table of all figures, for `report.md`."""
    return quantities_table(report["title"], COLUMN_HEADINGS, _rows(report), first="method")
