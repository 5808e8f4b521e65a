"""The figures of a comparison."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from palpate.app.common.figures import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    PINK,
    RED,
    SKY,
    YELLOW,
    figure,
    heading,
    legend_below,
    percent_axis,
)
from palpate.app.compare.measure import Comparison

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["FILES", "draw_comparison"]

FILES = ("errors.png", "response.png", "hankel.png", "cost.png")
LINE_STYLES = {
    "modal": (BLUE, "o", "-"), "moments": (GREEN, "s", "-"), "irka": (GREEN, "^", "--"), "balanced": (RED, "o", "-"),
    "balanced-low-rank": (RED, "+", ":"),
    "hankel": (RED, "x", "--"), "pod": (ORANGE, "D", "-"), "sobt": (PINK, "o", "-"), "sobt-p": (PINK, "^", "--"),
    "sobt-v": (SKY, "v", "--"), "sobt-pv": (SKY, "s", ":"), "sobt-vp": (YELLOW, "<", ":"), "sobt-fv": (GREY, ">", "--"),
}  # fmt: skip
SHOWN_MODES = 8  # modes of the frequency responses that are drawn


def draw_comparison(made: Comparison, report: dict[str, Any], out: Path) -> list[str]:
    """Draw errors, frequency responses, Hankel singular values and costs; return the names of the files."""
    _draw_errors(report, out / "errors.png")
    _draw_response(made, out / "response.png")
    _draw_hankel(report, out / "hankel.png")
    _draw_cost(report, out / "cost.png")
    return list(FILES)


def _series(report: dict[str, Any]) -> dict[str, list[dict[str, Any]]]:
    entries_by_method: dict[str, list[dict[str, Any]]] = {}
    for entry in report["methods"]:
        if not entry["failed"]:
            entries_by_method.setdefault(entry["method"], []).append(entry)
    return entries_by_method


def _line(axes: Axes, method: str, sizes: list[int], values: list[float]) -> None:
    colour, marker, style = LINE_STYLES[method]
    axes.plot(sizes, values, marker=marker, ls=style, color=colour, lw=1.4, ms=5, label=method)


def _draw_errors(report: dict[str, Any], path: Path) -> None:
    about = report["parameters"]
    with figure(path, (10.4, 8.2)) as drawn:
        heading(drawn, f"Errors against the full, nonlinear body: {report['title']}")
        grid = drawn.subplots(2, 2, sharex=True)
        for column, load in enumerate(("small", "large")):
            for row, what in enumerate(("displacement", "reaction")):
                axes = grid[row, column]
                for method, entries in _series(report).items():
                    kept = [e for e in entries if e["errors"][load] is not None and e["errors"][load][what] is not None]
                    values = [100 * min(e["errors"][load][what], 10.0) for e in kept]
                    _line(axes, method, [e["modes"] for e in kept], values)
                finished = [
                    e for e in report["nonlinear"]["entries"] if not e["failed"] and e["errors"][load] is not None
                ]
                values = [100 * min(e["errors"][load][what], 10.0) for e in finished]
                axes.plot([e["modes"] for e in finished], values, "k*-", lw=2, ms=9, label=report["nonlinear"]["name"])
                name = "force" if what == "reaction" else what
                axes.set(
                    title=f"{name}, {about[load]:g} {about['unit']}",
                    ylabel="error [%], cut at 1000" if column == 0 else "",
                )
                axes.set_xticks(sorted({entry["modes"] for entry in report["methods"]}))
                if row == 1:
                    axes.set_xlabel("number of modes")
                percent_axis(axes)
        legend_below(drawn, grid[0, 0])


def _draw_response(made: Comparison, path: Path) -> None:
    outputs, inputs = made.reduction.scales
    with figure(path, (9.6, 7.2)) as drawn:
        heading(drawn, f"Frequency response with {SHOWN_MODES} modes: {made.body.title}")
        upper, lower = drawn.subplots(2, 1, sharex=True)
        size = np.linalg.norm(outputs[:, None] * made.response * inputs, 2, axis=(1, 2))
        upper.loglog(made.frequencies, size, color="black", lw=2.4, label="the linear body")
        uncondensed_size = np.linalg.norm(outputs[:, None] * made.whole * inputs, 2, axis=(1, 2))
        upper.loglog(made.few, uncondensed_size, "k+", ms=9, label="the same, not condensed")
        for (method, modes), model in made.models.items():
            if modes != _nearest(made):
                continue
            reduced_response = model.reduced.transfer(1j * made.frequencies)
            colour, _, style = LINE_STYLES[method]
            values = np.linalg.norm(outputs[:, None] * reduced_response * inputs, 2, axis=(1, 2))
            upper.loglog(made.frequencies, values, color=colour, ls=style, lw=1)
            wrong = np.linalg.norm(outputs[:, None] * (made.response - reduced_response) * inputs, 2, axis=(1, 2))
            lower.loglog(made.frequencies, wrong, color=colour, ls=style, lw=1.2, label=method)
        upper.set(title="Largest singular value, inputs and outputs scaled", ylabel="response")
        lower.set(title="Error", xlabel="circular frequency [rad/s]", ylabel="response")
        lower.set_ylim(1e-6 * size.max(), 3 * size.max())
        upper.set_ylim(1e-6 * size.max(), 3 * size.max())
        legend_below(drawn, upper, lower)


def _nearest(made: Comparison) -> int:
    sizes = sorted({modes for _, modes in made.models}, key=lambda modes: abs(modes - SHOWN_MODES))
    return sizes[0] if sizes else 0


def _draw_hankel(report: dict[str, Any], path: Path) -> None:
    values = np.array(report["hankel_singular_values"])
    with figure(path, (8.6, 5.4)) as drawn:
        axes = drawn.subplots()
        index = np.arange(1, len(values) + 1)
        axes.semilogy(index, values, ".", color=GREY, ms=4, label="Hankel singular values")
        bound = 2 * (values.sum() - np.cumsum(values))[:-1]
        axes.semilogy(index[:-1], bound, color="black", lw=1, label="twice the sum of those discarded")
        for method, entries in _series(report).items():
            if method in ("balanced", "hankel"):
                states = [entry["states"] for entry in entries]
                _line(axes, method, states, [entry["absolute_error"] for entry in entries])
        axes.set(title=f"Bound and measured error: {report['title']}", xlabel="states", ylabel="scaled response")
        axes.set_xlim(0, min(len(values), 4 * max([e["states"] for e in report["methods"] if not e["failed"]] or [10])))
        axes.legend()


def _draw_cost(report: dict[str, Any], path: Path) -> None:
    with figure(path, (10.4, 5.0)) as drawn:
        heading(drawn, f"What the models cost: {report['title']}")
        left, right = drawn.subplots(1, 2)
        for method, entries in _series(report).items():
            sizes = [entry["modes"] for entry in entries]
            _line(left, method, sizes, [entry["offline_seconds"] + entry["shared_seconds"] for entry in entries])
            _line(right, method, sizes, [1e6 * entry["step_seconds"] for entry in entries])
        left.set(title="Offline, with what methods share", xlabel="number of modes", ylabel="time [s]", yscale="log")
        right.set(title="A step of 1 ms", xlabel="number of modes", ylabel="time [\u00b5s]", yscale="log")
        legend_below(drawn, left)
