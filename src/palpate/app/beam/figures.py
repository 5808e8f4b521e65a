"""The figures of the beam study, beside the paper's claims."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from palpate.app.beam.report import tip_displacement
from palpate.app.figures import (
    BLUE,
    GREEN,
    ORANGE,
    RED,
    draw_singular_values,
    energy_unit,
    figure,
    legend_below,
    over_modes,
    percent_axis,
    plot_errors,
)
from palpate.app.study import Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_figures"]


def draw_figures(study: Study, report: dict[str, Any], out: Path) -> None:
    """Draw Figures 3 to 5 of the paper, the singular values, the pulled end and the energies.

    Parameters
    ----------
    study : Study
    report : dict
        Of `palpate.app.beam.report.build_report`.
    out : path
        Folder.
    """
    done = [entry for entry in report["reduced"] if not entry["failed"]]
    draw_error(done, out / "figure3_error.png")
    draw_time(done, out / "figure4_time.png")
    draw_ratio(done, out / "figure5_ratio.png")
    title = "Singular values of the full model's snapshots"
    draw_singular_values({"snapshots": report["singular_values"]}, title, out / "singular_values.png")
    draw_tip(study, out / "tip.png")
    draw_energies(study, out / "energies.png")


def draw_error(done: list[dict[str, Any]], path: Path) -> None:
    """Draw errors over the number of modes (Figure 3)."""
    with figure(path, (7.0, 5.0)) as drawn:
        axes = drawn.subplots()
        over_modes(axes, done, "Error of the reduced models (paper: Figure 3)", "relative error [%]")
        if not done:
            return
        plot_errors(axes, done)
        _draw_error_claims(axes, [entry["modes"] for entry in done])
        percent_axis(axes)
        legend_below(drawn, axes)


def _draw_error_claims(axes: Axes, sizes: list[int]) -> None:
    """Draw what the paper says of Figure 3: below 3 % with 6 modes; a slight decrease after 8."""
    if min(sizes) < 8 < max(sizes):
        label = "paper: only a slight decrease after 8"
        axes.axvspan(8, max(sizes) + 0.7, color=RED, alpha=0.08, lw=0, label=label)
    if min(sizes) <= 6 <= max(sizes):
        axes.axhline(3, color=RED, lw=1, ls=":")
        axes.plot(6, 3, "v", color=RED, ms=9, zorder=4, label="paper: below 3 % with 6 modes")


def draw_time(done: list[dict[str, Any]], path: Path) -> None:
    """Draw the computing time over the number of modes (Figure 4)."""
    with figure(path) as drawn:
        axes, title = drawn.subplots(), "Computing time of the reduced models (paper: Figure 4)"
        over_modes(axes, done, title, "wall-clock time of the run [s]")
        if not done:
            return
        sizes = np.array([entry["modes"] for entry in done], dtype=float)
        seconds = np.array([entry["wall_seconds"] for entry in done])
        if len(sizes) > 2:
            line = np.polynomial.Polynomial.fit(sizes, seconds, 1)
            axes.plot(sizes, line(sizes), "--", color=RED, lw=1.2, label="straight line fitted (paper: almost linear)")
        axes.plot(sizes, seconds, "o-", color=BLUE, lw=2, label="here")
        axes.set_ylim(0, 1.25 * seconds.max())
        axes.legend(loc="upper left")


def draw_ratio(done: list[dict[str, Any]], path: Path) -> None:
    """Draw the computing time relative to the full model's over the number of modes (Figure 5)."""
    with figure(path) as drawn:
        axes, title = drawn.subplots(), "Computing time relative to the full model (paper: Figure 5)"
        over_modes(axes, done, title, "time of reduced / full model [%]")
        if not done:
            return
        sizes, ratios = [entry["modes"] for entry in done], [100 * entry["ratio"] for entry in done]
        axes.plot(sizes, ratios, "o-", color=BLUE, lw=2, label="here")
        axes.plot([2, 8], [1, 3], "D", color=RED, ms=7, label="paper: almost 1 % with 2 modes, around 3 % with 8")
        for size, ratio in zip(sizes, ratios, strict=True):
            axes.annotate(f"{ratio:.2g}", (size, ratio), (0, 8), textcoords="offset points", ha="center", color=BLUE)
        percent_axis(axes)
        axes.set_ylim(0.5 * min(1, *ratios), 3.5 * max(3, *ratios))
        axes.set_xlim(min(2, *sizes) - 0.7, max(8, *sizes) + 0.7)
        axes.legend(loc="upper left")


def draw_tip(study: Study, path: Path) -> None:
    """Draw the displacement of the pulled end, and the support force against the load, over time."""
    full = study.full
    force: Any = study.scene.loads[0].force  # type: ignore[union-attr]
    with figure(path, (8.6, 6.0)) as drawn:
        upper, lower = drawn.subplots(2, 1, sharex=True)
        upper.plot(full.times, 1e3 * tip_displacement(study, full), color=BLUE, lw=2.4, label="full model")
        lower.plot(full.times, [force(t)[0] for t in full.times], ":", color="black", lw=1.4, label="load applied")
        lower.plot(full.times, -full.reactions["x-"][:, 0], color=BLUE, lw=2.4, label="full model")
        for shown in study.shown:
            label = f"reduced model, {study.shown_modes} modes"
            upper.plot(shown.times, 1e3 * tip_displacement(study, shown), "--", color=ORANGE, lw=1.6, label=label)
            lower.plot(shown.times, -shown.reactions["x-"][:, 0], "--", color=ORANGE, lw=1.6, label=label)
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
        lower.plot(full.times, scale * full.dissipated, "--", color=GREEN, lw=1.6, label="lost to viscosity")
        lower.plot(full.times, scale * full.balance, color=RED, lw=1.6, label="missed by the balance of all")
        upper.set(title="Energies of the full model", ylabel=f"energy [{unit}]")
        lower.set(title="The small ones", xlabel="time [s]", ylabel=f"energy [{unit}]")
        for axes in (upper, lower):
            axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
            axes.set_xlim(0, full.times[-1])
