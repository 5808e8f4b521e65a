"""Figures of the membrane study, with the paper's claims."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from palpate.app.common.figures import (
    BLUE,
    GREEN,
    GREY,
    ORANGE,
    RED,
    SKY,
    YELLOW,
    draw_singular_values,
    energy_unit,
    figure,
    heading,
    legend_below,
    over_modes,
    percent_axis,
    plot_errors,
)
from palpate.app.studies.report import finished_runs
from palpate.app.studies.study import HYPER_REDUCED, PROJECTED, Study
from palpate.dynamics.run.trajectory import Trajectory
from palpate.meshfree.cloud import Cloud
from palpate.scenes.membrane import RADIUS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

__all__ = ["draw_figures"]

States = NDArray[np.int8]

Done = dict[str, list[dict[str, Any]]]  # finished runs by what happens in their phase

TITLES = {PROJECTED: "Projected, all nodes (the paper's)", HYPER_REDUCED: "Hyper-reduced, few points"}
MARKS = {PROJECTED: "o-", HYPER_REDUCED: "s:"}
AFTERWARDS = {"return": "Tool back at 0", "hold": "Tool holds still", "release": "Tool has let go"}
STATES = {"slack": YELLOW, "wrinkled": SKY, "taut": BLUE}
RADIUS_COLOURS = {0.0: "black", 0.25: BLUE, 0.5: GREEN, 0.75: ORANGE}  # shares of the radius whose deflection is drawn
MAX_DRAWN_ERROR = 1000.0  # [%] error up to which an axis reaches
PIXELS = 700  # across a map of states


def draw_figures(study: Study, states: States, report: dict[str, Any], out: Path) -> None:
    """Draw Figures 7 and 8 of the paper, the singular values, the tool's force, the energies and the states.

    Parameters
    ----------
    states : (f, n) array
        Of `palpate.Membrane.tension` at the times of the full run.
    report : dict
        Of `palpate.app.studies.membrane.report.build_report`.
    out : path
        Folder.
    """
    what = ("Tool pushes", AFTERWARDS[report["parameters"]["after"]])
    ends = (1e3 * (phase.start + phase.duration) for phase in study.phases)
    titles = [f"{happens}, until {end:.0f} ms" for happens, end in zip(what, ends, strict=True)]
    done = {
        series: {
            title: finished_runs(study, phase.name, series) for title, phase in zip(titles, study.phases, strict=True)
        }
        for series in TITLES
    }
    draw_error(done, out / "figure7_error.png")
    draw_time(done, [part.wall_seconds for part in study.parts], out / "figure8_time.png")
    series = dict(zip(titles, report["singular_values"].values(), strict=True))
    title = "Singular values of the snapshots, each scaled to the same size"
    draw_singular_values(series, title, out / "singular_values.png")
    draw_tool_force(study, titles, out / "tool_force.png")
    draw_energies(study, titles, out / "energies.png")
    draw_tension(study, states, out / "tension.png")


def draw_error(done: dict[str, Done], path: Path) -> None:
    """Draw errors over the number of modes for each series and phase (Figure 7)."""
    with figure(path, (9.6, 8.6)) as drawn:
        heading(drawn, "Error of the reduced models (paper: Figure 7)")
        grid = drawn.subplots(2, 2, sharey=True)
        for row, (series, phases) in zip(grid, done.items(), strict=True):
            for axes, (title, entries) in zip(row, phases.items(), strict=True):
                label = f"{TITLES[series]}\nrelative error [%]" if axes is row[0] else ""
                over_modes(axes, entries, title, label)
                if entries:
                    plot_errors(axes, entries)
                    percent_axis(axes)
        grid[0, 0].set_ylim(top=min(grid[0, 0].get_ylim()[1], MAX_DRAWN_ERROR))
        sizes = [entry["modes"] for entry in next(iter(done[PROJECTED].values()))]
        if sizes:
            _draw_error_claims(grid[0, 0], sizes)
        legend_below(drawn, *grid.ravel())


def _draw_error_claims(axes: Axes, sizes: list[int]) -> None:
    """Draw the paper's claims about Figure 7: very small with 8 modes, then a negligible change."""
    if min(sizes) < 8 < max(sizes):
        label = "paper: negligible change after 8"
        axes.axvspan(8, max(sizes) + 0.7, color=RED, alpha=0.08, lw=0, label=label)
    if min(sizes) <= 8 <= max(sizes):
        label = "paper: very small with 8 modes (drawn: 3 %)"
        axes.plot(8, 3, "v", color=RED, ms=9, zorder=4, label=label)


def draw_time(done: dict[str, Done], full: list[float], path: Path) -> None:
    """Draw the computing time over the number of modes, in seconds and over the full model's [s] (Figure 8)."""
    with figure(path, (9.6, 4.8)) as drawn:
        heading(drawn, "Computing time of the reduced models (paper: Figure 8)")
        left, right = drawn.subplots(1, 2)
        most = max((entries for phases in done.values() for entries in phases.values()), key=len)
        over_modes(left, most, "Seconds", "wall-clock time of a phase of 0.1 s [s]")
        over_modes(right, most, "Relative to the full model", "time of reduced / full model [%]")
        if not most:
            return
        for series, phases in done.items():
            for (title, entries), colour in zip(phases.items(), (BLUE, ORANGE), strict=True):
                sizes, label = [entry["modes"] for entry in entries], f"{TITLES[series]}: {title}"
                left.plot(sizes, [entry["wall_seconds"] for entry in entries], MARKS[series], color=colour, label=label)
                right.plot(sizes, [100 * entry["ratio"] for entry in entries], MARKS[series], color=colour)
        for full_seconds, colour in zip(full, (BLUE, ORANGE), strict=True):
            left.axhline(full_seconds, color=colour, ls="--", lw=1.4)
        left.plot([], [], "--", color=GREY, lw=1.4, label="dashed: full model")
        percent_axis(left)
        percent_axis(right)
        drawn.legend(*left.get_legend_handles_labels(), loc="outside lower center", ncols=2, fontsize=9)


def _at_radius(cloud: Cloud, share: float) -> NDArray[np.int64]:
    """Return the nodes at a share of the radius: the central one, or a ring as wide as the spacing."""
    distance = np.linalg.norm(cloud.points, axis=1)
    wide = 0.5 * cloud.spacing if share else 0.0
    return np.flatnonzero(np.abs(distance - share * RADIUS) <= wide * (1 + 1e-6))


def _plot_deflections(axes: Axes, cloud: Cloud, run: Trajectory, style: str, label: bool) -> None:
    for share, colour in RADIUS_COLOURS.items():
        name = f"r = {1e3 * share * RADIUS:.0f} mm" if label else None
        deflection = run.displacements[:, _at_radius(cloud, share), 2].mean(axis=1)
        axes.plot(1e3 * run.times, 1e3 * deflection, style, color=colour, lw=1.8, label=name)


def draw_tool_force(study: Study, titles: Sequence[str], path: Path) -> None:
    """Draw the force of the tool, and the deflection at some radii, over time, the force of each phase to its scale."""
    cloud = study.scene.model.cloud
    with figure(path, (10.5, 6.4)) as drawn:
        heading(drawn, "Force of the tool on the sheet, and deflection (mean over a ring), at the snapshots")
        upper, lower = drawn.subplots(2, 2, sharex="col")
        lower[1].sharey(lower[0])
        for place, (title, part) in enumerate(zip(titles, study.parts, strict=True)):
            upper[place].plot(1e3 * part.times, 1e3 * part.reactions["tool"][:, 2], color=BLUE, lw=2.4, label="full")
            _plot_deflections(lower[place], cloud, part, "-", label=True)
            for (series, ready), colour in zip(study.shown.items(), (ORANGE, GREEN), strict=False):
                shown, label = ready.runs[place], f"{series}, {ready.modes} modes"
                force = 1e3 * shown.reactions["tool"][:, 2]
                upper[place].plot(1e3 * shown.times, force, "--", color=colour, lw=1.6, label=label)
                if series == PROJECTED:
                    _plot_deflections(lower[place], cloud, shown, ":", label=False)
                    lower[place].plot([], [], ":", color=GREY, lw=1.8, label=f"dotted: {label}")
            upper[place].set_title(title)
            lower[place].set(xlabel="time [ms]", xlim=1e3 * part.times[[0, -1]])
        upper[0].set_ylabel("force [mN]")
        lower[0].set_ylabel("deflection [mm]")
        for row in (upper, lower):
            row[1].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))


def draw_energies(study: Study, titles: Sequence[str], path: Path) -> None:
    """Draw the energies of the full model over time, each phase with its own scale."""
    with figure(path, (9.6, 4.8)) as drawn:
        heading(drawn, "Energies of the full model")
        both = drawn.subplots(1, 2)
        for axes, title, run in zip(both, titles, study.parts, strict=True):
            unit, scale = energy_unit([run.external, run.kinetic, run.strain])
            times, given = 1e3 * run.times, run.external + (run.kinetic + run.strain)[0]
            axes.plot(times, scale * given, color="black", lw=2.2, label="energy at the start + work of the tool")
            axes.plot(times, scale * run.strain, "--", color=ORANGE, lw=1.8, label="strain energy")
            axes.plot(times, scale * run.kinetic, color=BLUE, lw=1.8, label="kinetic energy")
            axes.plot(times, scale * run.dissipated, "--", color=GREEN, lw=1.6, label="lost to damping")
            axes.plot(times, scale * run.balance, color=RED, lw=1.6, label="missed by the balance of all")
            axes.set(title=title, xlabel="time [ms]", ylabel=f"energy [{unit}]", xlim=times[[0, -1]])
        drawn.legend(*both[0].get_legend_handles_labels(), loc="outside lower center", ncols=3, fontsize=9)


def draw_tension(study: Study, states: States, path: Path) -> None:
    """Draw how much of the sheet is slack, wrinkled or taut over time, and where, when most of it is wrinkled."""
    cloud, times = study.scene.model.cloud, study.full.times
    shares = np.stack([(states == k) @ cloud.volumes for k in range(len(STATES))]) / cloud.volumes.sum()
    begin = int(np.argmin(np.abs(times - study.phases[1].start)))
    shown = {"until": slice(1, begin + 1), "after": slice(begin + 1, None)}
    widest = [part.start + int(np.argmax(shares[1, part])) for part in shown.values()]
    with figure(path, (9.6, 7.6)) as drawn:
        grid = drawn.add_gridspec(2, 2, height_ratios=[2, 3])
        above = drawn.add_subplot(grid[0, :])
        # the sheet at rest is neither
        above.stackplot(1e3 * times[1:], 100 * shares[:, 1:], colors=list(STATES.values()), labels=list(STATES), lw=0)
        above.set_title("State of the sheet", pad=12)
        above.set(xlabel="time [ms]", ylabel="share of the area [%]", xlim=(0, 1e3 * times[-1]), ylim=(0, 100))
        above.axvline(1e3 * times[begin], color="black", lw=1, ls=(0, (4, 3)))
        for place, (when, frame) in enumerate(zip(shown, widest, strict=True)):
            axes = drawn.add_subplot(grid[1, place])
            _map_states(axes, cloud, states[frame])
            much = "most" if shares[1, frame] else "never"
            axes.set_title(f"{1e3 * times[frame]:.0f} ms: {much} wrinkled {when} {1e3 * times[begin]:.0f} ms")
        label = "mapped below"
        above.plot(1e3 * times[widest], [103, 103], "v", color=RED, ms=8, clip_on=False, zorder=5, label=label)
        above.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _map_states(axes: Axes, cloud: Cloud, states: States) -> None:
    """Fill the disc with the states of the nearest nodes."""
    from matplotlib.colors import ListedColormap
    from scipy.spatial import cKDTree

    line = np.linspace(-RADIUS, RADIUS, PIXELS)
    places = np.stack(np.meshgrid(line, line), axis=-1)
    nearest = cKDTree(cloud.points).query(places)[1]
    picture = np.ma.masked_where(np.linalg.norm(places, axis=-1) > RADIUS, states[nearest])
    reach = 1e3 * RADIUS
    axes.imshow(
        picture,
        cmap=ListedColormap(list(STATES.values())),
        vmin=-0.5,
        vmax=len(STATES) - 0.5,
        extent=(-reach, reach, -reach, reach),
        origin="lower",
        interpolation="nearest",
    )
    axes.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal")
    axes.grid(False)
