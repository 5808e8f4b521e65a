"""The figures of validation/linear_reductions.py: errors, frequency responses, and the bound of balancing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

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

FILES = ("errors.png", "response.png", "hankel.png")
LINE_STYLES = {
    "modal": (BLUE, "o", "-"), "moments": (GREEN, "s", "-"), "irka": (GREEN, "^", "--"), "balanced": (RED, "o", "-"),
    "hankel": (RED, "x", "--"), "pod": (ORANGE, "D", "-"), "sobt": (PINK, "o", "-"), "sobt-p": (PINK, "^", "--"),
    "sobt-v": (SKY, "v", "--"), "sobt-pv": (SKY, "s", ":"), "sobt-vp": (YELLOW, "<", ":"), "sobt-fv": (GREY, ">", "--"),
}  # fmt: skip
SHOWN_MODES = 8  # modes of the frequency responses that are drawn, or the nearest number
MAX_ERROR = 10.0  # larger errors are drawn as this


def draw(made: Any, out: Path) -> tuple[str, ...]:
    """Draw the figures of a comparison into a folder; return the names of the files."""
    methods: dict[str, list[dict[str, Any]]] = {}
    for entry in made.entries:
        if not entry["failed"]:
            methods.setdefault(entry["method"], []).append(entry)
    for name, drawing in zip(FILES, (_errors, _response, _hankel), strict=True):
        drawing(made, methods, out / name)
    return FILES


def _line(axes: Any, method: str, sizes: list[int], values: list[float]) -> None:
    colour, marker, style = LINE_STYLES[method]
    axes.plot(sizes, values, marker=marker, ls=style, color=colour, lw=1.4, ms=5, label=method)


def _errors(made: Any, methods: dict[str, Any], path: Path) -> None:
    with figure(path, (10.4, 8.2)) as drawn:
        heading(drawn, f"Errors against the full, nonlinear body: {made.body.title}")
        grid = drawn.subplots(2, 2, sharex=True)
        for column, (load, size) in enumerate(zip(made.runs, made.body.sizes, strict=True)):
            for row, what in enumerate(("displacement", "reaction")):
                axes = grid[row, column]
                for method, entries in methods.items():
                    _line(axes, method, [entry["modes"] for entry in entries], _percents(entries, load, what))
                done = [entry for entry in made.nonlinear if not entry["failed"]]
                sizes, values = [entry["modes"] for entry in done], _percents(done, load, what)
                axes.plot(sizes, values, "k*-", lw=2, ms=9, label=made.body.nonlinear_name)
                axes.set_title(f"{'force' if what == 'reaction' else what}, {size:g} {made.body.unit}")
                axes.set_ylabel("" if column else "error [%], cut at 1000")
                axes.set_xlabel("number of modes" if row else "")
                axes.set_xticks(sorted({entry["modes"] for entry in made.entries}))
                percent_axis(axes)
        legend_below(drawn, grid[0, 0])


def _percents(entries: list[dict[str, Any]], load: str, what: str) -> list[float]:
    """Return errors [%]; a run that diverged has none."""
    return [np.nan if e["errors"][load] is None else 100 * min(e["errors"][load][what], MAX_ERROR) for e in entries]


def _response(made: Any, _methods: dict[str, Any], path: Path) -> None:
    size = made.sizes(made.response)
    nearest = min((modes for _, modes in made.models), key=lambda modes: abs(modes - SHOWN_MODES), default=0)
    with figure(path, (9.6, 7.2)) as drawn:
        heading(drawn, f"Frequency response with {nearest} modes: {made.body.title}")
        upper, lower = drawn.subplots(2, 1, sharex=True)
        upper.loglog(made.frequencies, size, color="black", lw=2.4, label="the linear body")
        upper.loglog(made.few, made.sizes(made.whole), "k+", ms=9, label="the same, not condensed")
        for (method, modes), model in made.models.items():
            if modes == nearest:
                colour, _, style = LINE_STYLES[method]
                reduced = made.sizes(model.reduced.transfer(1j * made.frequencies))
                upper.loglog(made.frequencies, reduced, color=colour, ls=style, lw=1)
                lower.loglog(made.frequencies, made.missed(model), color=colour, ls=style, lw=1.2, label=method)
        upper.set(title="Largest singular value, inputs and outputs scaled", ylabel="response")
        lower.set(title="Error", xlabel="circular frequency [rad/s]", ylabel="response")
        for axes in (upper, lower):
            axes.set_ylim(1e-6 * size.max(), 3 * size.max())
        legend_below(drawn, upper, lower)


def _hankel(made: Any, methods: dict[str, Any], path: Path) -> None:
    values = made.reduction.hankel_singular_values
    with figure(path, (8.6, 5.4)) as drawn:
        axes = drawn.subplots()
        index = np.arange(1, len(values) + 1)
        axes.semilogy(index, values, ".", color=GREY, ms=4, label="Hankel singular values")
        bound = 2 * (values.sum() - np.cumsum(values))[:-1]
        axes.semilogy(index[:-1], bound, color="black", lw=1, label="twice the sum of those discarded")
        for method in ("balanced", "hankel"):
            entries = methods.get(method, [])
            _line(axes, method, [entry["states"] for entry in entries], [entry["absolute_error"] for entry in entries])
        axes.set(title=f"Bound and measured error: {made.body.title}", xlabel="states", ylabel="scaled response")
        most = max((entry["states"] for entries in methods.values() for entry in entries), default=10)
        axes.set_xlim(0, min(len(values), 4 * most))
        axes.legend()
