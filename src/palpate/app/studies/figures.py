"""Figures that the examples share: errors and times over the number of modes, singular values, energies."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from palpate.app.common.figures import (
    BLUE,
    GREEN,
    ORANGE,
    RED,
    draw_singular_values,
    energy_unit,
    figure,
    heading,
    legend_below,
    over_modes,
    percent_axis,
    plot_errors,
)
from palpate.app.studies.study import HYPER_REDUCED, PROJECTED, Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SERIES_TITLES = {
    PROJECTED: "Projected at all nodes (the paper's)",
    HYPER_REDUCED: "Hyper-reduced to few points",
}
PHASE_COLOURS = (BLUE, ORANGE)
SERIES_MARKERS = {PROJECTED: "o-", HYPER_REDUCED: "s:"}
MAX_DRAWN_ERROR = 1000.0  # [%] error up to which an axis reaches
ENERGIES: dict[str, tuple[str, dict[str, Any]]] = {
    "given": ("energy at the start + work of the loads", {"color": "black", "lw": 2.2}),
    "strain": ("strain energy", {"ls": "--", "color": ORANGE, "lw": 1.8}),
    "kinetic": ("kinetic energy", {"color": BLUE, "lw": 1.8}),
    "dissipated": ("lost to damping", {"ls": "--", "color": GREEN, "lw": 1.6}),
    "balance": ("missed by the balance of all", {"color": RED, "lw": 1.6}),
}


@dataclass(frozen=True)
class Panel:
    """Finished runs of a series over a phase."""

    series: str
    title: str  # of the series where the example has one phase, else of the phase
    label: str  # of both
    entries: list[dict[str, Any]]
    colour: str


@dataclass(frozen=True)
class ErrorMark:
    """The paper's words on the error of its models."""

    point: tuple[int, float, str]  # number of modes, error [%], label
    span: str  # label of the range from 8 modes on
    line: bool = False  # whether a line is drawn at the error


@dataclass(frozen=True)
class TimeAxes:
    """Axes of computing times: seconds, or per cent of the full model's time."""

    title: str
    label: str
    value: Callable[[Mapping[str, Any]], float]  # of the entry of a run
    full_lines: bool = False  # whether the seconds of the full runs are drawn as lines
    logarithmic: bool = True
    fitted: str = ""  # label of straight lines fitted to the values
    points: tuple[Sequence[float], Sequence[float], str] | None = None  # of the paper: modes, values, label


def seconds_of(entry: Mapping[str, Any]) -> float:
    """Return the computing time [s] of a run."""
    return float(entry["wall_seconds"])


def percentage_of(entry: Mapping[str, Any]) -> float:
    """Return the computing time of a run over the full model's [%]."""
    return float(100 * entry["ratio"])


def grid_of(studies: Sequence[Study]) -> list[list[Panel]]:
    """Return the panels of the reduced runs: a row for each series with a column for each phase, or one row."""
    grid = []
    for study in studies:
        for series in study.series:
            name = f"{SERIES_TITLES[series]}{f', {study.form}' if study.form else ''}"
            if len(study.phases) == 1:
                colour = BLUE if series == PROJECTED else GREEN
                entries = study.finished(study.phases[0], series)
                grid.append([Panel(series, name, name, entries, colour)])
                continue
            grid.append(
                [
                    Panel(series, title, f"{name}: {title}", study.finished(phase, series), colour)
                    for phase, title, colour in zip(study.phases, phase_titles(study), PHASE_COLOURS, strict=True)
                ]
            )
    return grid if len(grid[0]) > 1 else [[panel for row in grid for panel in row]]


def phase_titles(study: Study) -> list[str]:
    """Return what happens in each phase, and until when."""
    return [f"{phase.title}, until {1e3 * (phase.start + phase.duration):.0f} ms" for phase in study.phases]


def draw_errors(number: int, size: tuple[float, float], mark: ErrorMark, studies: Sequence[Study], path: Path) -> None:
    """Draw errors over the number of modes for each series and phase, a figure of the paper by its number."""
    grid = grid_of(studies)
    with figure(path, size) as drawn:
        heading(drawn, f"Error of the reduced models, each against its full model (paper: Figure {number})")
        axes_grid = drawn.subplots(len(grid), len(grid[0]), sharey=True, squeeze=False)
        for axes_row, row in zip(axes_grid, grid, strict=True):
            for axes, panel in zip(axes_row, row, strict=True):
                series = f"{SERIES_TITLES[panel.series]}\n" if len(grid) > 1 else ""
                label = f"{series}relative error [%]" if axes is axes_row[0] else ""
                over_modes(axes, panel.entries, panel.title, label)
                if panel.entries:
                    percent_axis(axes)
                    plot_errors(axes, panel.entries)
        first = axes_grid[0, 0]
        first.set_ylim(top=min(first.get_ylim()[1], MAX_DRAWN_ERROR))
        if grid[0][0].entries:
            _draw_mark(first, mark, [entry["modes"] for entry in grid[0][0].entries])
        legend_below(drawn, *axes_grid.ravel())


def _draw_mark(axes: Axes, mark: ErrorMark, sizes: Sequence[int]) -> None:
    modes, error, label = mark.point
    if min(sizes) < 8 < max(sizes):
        axes.axvspan(8, max(sizes) + 0.7, color=RED, alpha=0.08, lw=0, label=mark.span)
    if min(sizes) <= modes <= max(sizes):
        if mark.line:
            axes.axhline(error, color=RED, lw=1, ls=":")
        axes.plot(modes, error, "v", color=RED, ms=9, zorder=4, label=label)


def draw_times(
    title: str, size: tuple[float, float], columns: Sequence[TimeAxes], studies: Sequence[Study], path: Path
) -> None:
    """Draw computing times over the number of modes, with a curve for every series and phase."""
    panels = [panel for row in grid_of(studies) for panel in row]
    with figure(path, size) as drawn:
        heading(drawn, title)
        for axes, column in zip(drawn.subplots(1, len(columns), squeeze=False)[0], columns, strict=True):
            over_modes(axes, max((panel.entries for panel in panels), key=len), column.title, column.label)
            if any(panel.entries for panel in panels):
                _plot_times(axes, column, panels, studies[0])
        legend_below(drawn, *drawn.axes, columns=len(columns))


def _plot_times(axes: Axes, column: TimeAxes, panels: Sequence[Panel], study: Study) -> None:
    for panel in panels:
        sizes = np.array([entry["modes"] for entry in panel.entries], dtype=float)
        values = np.array([column.value(entry) for entry in panel.entries])
        axes.plot(sizes, values, SERIES_MARKERS[panel.series], color=panel.colour, lw=2, label=panel.label)
        if column.fitted and len(sizes) > 2:
            line = np.polynomial.Polynomial.fit(sizes, values, 1)
            axes.plot(sizes, line(sizes), "--", color=RED, lw=1.2, label=column.fitted)
    if column.full_lines:
        for part, colour in zip(study.parts, PHASE_COLOURS, strict=False):
            axes.axhline(part.wall_seconds, color=colour, ls="--", lw=1.4, label="dashed: full model")
    if column.points is not None:
        modes, printed, label = column.points
        axes.plot(modes, printed, "D", color=RED, ms=7, label=label)
    if column.logarithmic:
        percent_axis(axes)
    else:
        axes.set_ylim(bottom=0)


def draw_values(studies: Sequence[Study], path: Path) -> None:
    """Draw the singular values of the snapshots of every phase, which a study keeps."""
    study = studies[0]
    names = phase_titles(study) if len(study.phases) > 1 else ["snapshots"]
    title = "Singular values of the full model's snapshots"
    values = [each.tolist() for each in study.singular_values]
    draw_singular_values(dict(zip(names, values, strict=True)), title, path)


def draw_energies(
    size: tuple[float, float], rows: Sequence[Sequence[str]], studies: Sequence[Study], path: Path
) -> None:
    """Draw the energies of the full model over time, each phase in a column with its own scale.

    `rows` has the names of `ENERGIES` in each row of axes.
    """
    study = studies[0]
    titles = phase_titles(study) if len(study.phases) > 1 else [""]
    with figure(path, size) as drawn:
        heading(drawn, "Energies of the full model")
        grid = drawn.subplots(len(rows), len(titles), squeeze=False, sharex="col")
        for column, (title, run) in enumerate(zip(titles, study.parts, strict=True)):
            unit, scale = energy_unit([run.external, run.kinetic, run.strain])
            values = {name: getattr(run, name) for name in ENERGIES if name != "given"}
            values["given"] = run.external + (run.kinetic + run.strain)[0]
            for axes, names in zip(grid[:, column], rows, strict=True):
                for name in names:
                    label, style = ENERGIES[name]
                    axes.plot(1e3 * run.times, scale * values[name], label=label, **style)
                axes.set(ylabel=f"energy [{unit}]", xlim=1e3 * run.times[[0, -1]])
            grid[0, column].set_title(title)
            grid[-1, column].set_xlabel("time [ms]")
        legend_below(drawn, *grid.ravel(), columns=3)
