"""Figures of the beam study, with the paper's claims."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from palpate.app.common.console import count_nodes
from palpate.app.common.figures import (
    BLUE,
    GREEN,
    GREY,
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
from palpate.app.studies.beam.report import tip_displacement
from palpate.app.studies.study import HYPER_REDUCED, PROJECTED, Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_figures"]


Entries = list[dict[str, Any]]
TITLES = {
    PROJECTED: "Projected at all nodes (the paper's), strong form",
    HYPER_REDUCED: "Hyper-reduced to few nodes, energy form",
}
COLOURS = {PROJECTED: BLUE, HYPER_REDUCED: GREEN}


def draw_figures(strong: Study, energy: Study | None, report: dict[str, Any], out: Path) -> None:
    """Draw Figures 3 to 5 of the paper, the singular values, the pulled end and the energies.

    Parameters
    ----------
    strong : Study
        Of the strong form.
    energy : Study, optional
        Of the energy form.
    report : dict
        Of `palpate.app.studies.beam.report.build_report`.
    out : path
        Folder.
    """
    done = {
        series: [entry for entry in report["reduced"] if entry["series"] == series and not entry["failed"]]
        for series in TITLES
    }
    draw_error(done, out / "figure3_error.png")
    draw_time(done, out / "figure4_time.png")
    draw_ratio(done, out / "figure5_ratio.png")
    title = "Singular values of the full model's snapshots"
    draw_singular_values({"snapshots": report["singular_values"]}, title, out / "singular_values.png")
    draw_tip([study for study in (strong, energy) if study], out / "tip.png")
    draw_energies(strong, out / "energies.png")


def draw_error(done: dict[str, Entries], path: Path) -> None:
    """Draw errors over the number of modes for each series (Figure 3)."""
    with figure(path, (10.4, 5.6)) as drawn:
        heading(drawn, "Error of the reduced models, each against the full model that it reduces (paper: Figure 3)")
        both = drawn.subplots(1, 2, sharey=True)
        for axes, (series, entries) in zip(both, done.items(), strict=True):
            over_modes(axes, entries, TITLES[series], "relative error [%]" if axes is both[0] else "")
            if entries:
                percent_axis(axes)
                plot_errors(axes, entries)
        projected = done[PROJECTED]
        if projected:
            _draw_error_claims(both[0], [entry["modes"] for entry in projected])
        legend_below(drawn, *both)


def _draw_error_claims(axes: Axes, sizes: list[int]) -> None:
    """Draw the paper's claims about Figure 3: below 3 % with 6 modes; a slight decrease after 8."""
    if min(sizes) < 8 < max(sizes):
        label = "paper: only a slight decrease after 8"
        axes.axvspan(8, max(sizes) + 0.7, color=RED, alpha=0.08, lw=0, label=label)
    if min(sizes) <= 6 <= max(sizes):
        axes.axhline(3, color=RED, lw=1, ls=":")
        axes.plot(6, 3, "v", color=RED, ms=9, zorder=4, label="paper: below 3 % with 6 modes")


def draw_time(done: dict[str, Entries], path: Path) -> None:
    """Draw the computing time over the number of modes for each series (Figure 4)."""
    with figure(path) as drawn:
        axes, title = drawn.subplots(), "Computing time of the reduced models (paper: Figure 4)"
        over_modes(axes, max(done.values(), key=len), title, "wall-clock time of the run [s]")
        most = 0.0
        for series, entries in done.items():
            sizes = np.array([entry["modes"] for entry in entries], dtype=float)
            seconds = np.array([entry["wall_seconds"] for entry in entries])
            most = max(most, *seconds, 0.0)
            if len(sizes) > 2:
                line = np.polynomial.Polynomial.fit(sizes, seconds, 1)
                label = "straight lines fitted (paper: almost linear)" if series == PROJECTED else None
                axes.plot(sizes, line(sizes), "--", color=RED, lw=1.2, label=label)
            axes.plot(sizes, seconds, "o-", color=COLOURS[series], lw=2, label=TITLES[series])
        if most:
            axes.set_ylim(0, 1.45 * most)
            axes.legend(loc="upper left")


def draw_ratio(done: dict[str, Entries], path: Path) -> None:
    """Draw the computing time relative to the full model's over the number of modes for each series (Figure 5)."""
    with figure(path) as drawn:
        axes, title = drawn.subplots(), "Computing time relative to the full model (paper: Figure 5)"
        over_modes(axes, max(done.values(), key=len), title, "time of reduced / full model [%]")
        every = [entry for entries in done.values() for entry in entries]
        if not every:
            return
        for series, entries in done.items():
            sizes, ratios = [entry["modes"] for entry in entries], [100 * entry["ratio"] for entry in entries]
            axes.plot(sizes, ratios, "o-", color=COLOURS[series], lw=2, label=TITLES[series])
            for entry, size, ratio in zip(entries, sizes, ratios, strict=True):
                text = f"{ratio:.2g}" if series == PROJECTED else f"{ratio:.2g}\n{count_nodes(entry['nodes'])}"
                style: dict[str, Any] = {"ha": "center", "color": COLOURS[series], "fontsize": 9}
                above = 8 if series == PROJECTED else -28
                axes.annotate(text, (size, ratio), (0, above), textcoords="offset points", **style)
        axes.plot([2, 8], [1, 3], "D", color=RED, ms=7, label="paper: almost 1 % with 2 modes, around 3 % with 8")
        percent_axis(axes)
        ratios, sizes = [100 * entry["ratio"] for entry in every], [entry["modes"] for entry in every]
        axes.set_ylim(0.3 * min(1, *ratios), 5 * max(3, *ratios))
        axes.set_xlim(min(2, *sizes) - 0.7, max(8, *sizes) + 0.7)
        axes.legend(loc="upper left")


def draw_tip(studies: Sequence[Study], path: Path) -> None:
    """Draw the displacement of the pulled end, and the support force against the load, over time."""
    scene, full = studies[0].scene, studies[0].full
    force: Any = scene.loads[0].force  # type: ignore[union-attr]
    runs = []
    for study, (full_colour, reduced_colour) in zip(studies, ((BLUE, ORANGE), (GREY, GREEN)), strict=False):
        runs.append((study.title, study.full, {"ls": "-", "color": full_colour, "lw": 2.0}))
        for series, shown in study.shown.items():
            style = {"ls": "--", "color": reduced_colour, "lw": 1.6}
            runs.append((f"{series}, {shown.modes} modes", shown.runs[0], style))
    with figure(path, (9.0, 6.0)) as drawn:
        upper, lower = drawn.subplots(2, 1, sharex=True)
        lower.plot(full.times, [force(t)[0] for t in full.times], ":", color="black", lw=1.4, label="load applied")
        for label, run, style in runs:
            upper.plot(run.times, 1e3 * tip_displacement(studies[0], run), label=label, **style)
            lower.plot(run.times, -run.reactions["x-"][:, 0], label=label, **style)
        upper.set(title="Pulled end: mean axial displacement", ylabel="displacement [mm]")
        lower.set(title="Held end: force of the support", xlabel="time [s]", ylabel="force [N]")
        for axes in (upper, lower):
            axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
            axes.set_xlim(0, full.times[-1])


def draw_energies(study: Study, path: Path) -> None:
    """Draw the energies of the full model over time, the large ones above and the small ones below."""
    full = study.full
    unit, scale = energy_unit(full.external)
    with figure(path, (8.6, 6.0)) as drawn:
        upper, lower = drawn.subplots(2, 1, sharex=True)
        upper.plot(full.times, scale * full.external, color="black", lw=2.4, label="work of the load")
        upper.plot(full.times, scale * full.strain, "--", color=ORANGE, lw=1.8, label="strain energy")
        lower.plot(full.times, scale * full.kinetic, color=BLUE, lw=1.6, label="kinetic")
        lower.plot(full.times, scale * full.dissipated, "--", color=GREEN, lw=1.6, label="lost to damping")
        lower.plot(full.times, scale * full.balance, color=RED, lw=1.6, label="missed by the balance of all")
        upper.set(title="Energies of the full model", ylabel=f"energy [{unit}]")
        lower.set(title="The small ones", xlabel="time [s]", ylabel=f"energy [{unit}]")
        for axes in (upper, lower):
            axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
            axes.set_xlim(0, full.times[-1])
