"""Shared style of the figures of all studies, and curves over the number of modes."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from palpate.core.extras import require
from palpate.core.files import whole_file

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's colours, which colour-blind people tell apart
BLUE, ORANGE, GREEN, RED, PINK, SKY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9"
YELLOW, GREY = "#F0E442", "#777777"
STYLE: dict[Any, Any] = {
    "font.size": 10,
    "axes.titlesize": 11,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.axisbelow": True,
    "grid.color": "#DDDDDD",
    "grid.linewidth": 0.6,
    "legend.frameon": False,
    "lines.markersize": 6,
    "savefig.dpi": 150,
}
MODES = "number of POD modes"


@contextmanager
def figure(path: Path, size: tuple[float, float] = (7.0, 4.6)) -> Iterator[Figure]:
    """Yield an empty figure [inch] in this package's style; save it whole or not at all."""
    require("matplotlib", "drawing figures")
    import matplotlib
    import matplotlib.figure
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    with matplotlib.rc_context(STYLE):
        drawn = matplotlib.figure.Figure(figsize=size, layout="constrained")
        FigureCanvasAgg(drawn)
        yield drawn
        with whole_file(path) as partial:
            drawn.savefig(partial)


def heading(drawn: Figure, text: str) -> None:
    """Give a figure of several axes a common title."""
    drawn.suptitle(text, x=0.01, ha="left", weight="bold", size=12)


def over_modes(axes: Axes, done: Sequence[dict[str, Any]], title: str, label: str) -> None:
    """Make axes ready for curves over the number of modes of some finished runs; print a text if there are none."""
    axes.set(title=title, xlabel=MODES, ylabel=label)
    sizes = [entry["modes"] for entry in done]
    if sizes:
        axes.set_xticks(sizes if len(sizes) <= 15 else sizes[:: len(sizes) // 10])
        axes.set_xlim(min(sizes) - 0.7, max(sizes) + 0.7)
    else:
        axes.text(0.5, 0.5, "every reduced run failed", ha="center", transform=axes.transAxes)


def plot_errors(axes: Axes, done: Sequence[dict[str, Any]]) -> None:
    """Plot all errors [%] of finished runs over their number of modes, the displacement's above the others."""
    sizes = [entry["modes"] for entry in done]
    others = (("velocity", GREEN, "s"), ("energy", ORANGE, "^"), ("reaction", PINK, "D"))
    for name, colour, marker in others:
        values = [100 * entry["errors"][name] for entry in done]
        label = "reaction forces" if name == "reaction" else name
        axes.plot(sizes, values, marker=marker, color=colour, lw=1, ms=4, alpha=0.75, label=label)
    values = [100 * entry["projection_error"] for entry in done]
    axes.plot(sizes, values, "--", marker="x", color=GREY, lw=1, ms=5, label="projection: best these modes can do")
    values = [100 * entry["errors"]["displacement"] for entry in done]
    axes.plot(sizes, values, "o-", color=BLUE, lw=2.2, ms=7, label="displacement, equation (34)")


def percent_axis(axes: Axes) -> None:
    """Make the vertical axis logarithmic, with plain numbers."""
    from matplotlib.ticker import LogLocator

    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(_plain)
    axes.yaxis.set_minor_locator(LogLocator(subs=(2, 5)))
    axes.yaxis.set_minor_formatter(_plain)


def _plain(value: float, _position: object = None) -> str:
    return f"{value:g}"


def legend_below(drawn: Figure, *axes: Axes, columns: int = 2) -> None:
    """Set the common legend of some axes below the figure, in reverse order of drawing."""
    handles_and_labels = [pair for one in axes for pair in zip(*one.get_legend_handles_labels(), strict=True)][::-1]
    named = {label: handle for handle, label in handles_and_labels}
    if named:
        drawn.legend(named.values(), named.keys(), loc="outside lower center", ncols=columns, fontsize=9)


def draw_singular_values(series: Mapping[str, Sequence[float]], title: str, path: Path) -> None:
    """Draw singular values of snapshots by name, each series relative to its first, down to rounding noise."""
    with figure(path) as drawn:
        axes = drawn.subplots()
        most = 1
        for (name, values), colour in zip(series.items(), (BLUE, RED, GREEN), strict=False):
            relative = np.array(values) / values[0]
            relative = relative[relative > 1e-16]
            most = max(most, len(relative))
            axes.semilogy(np.arange(1, len(relative) + 1), relative, "o", ms=3.5, color=colour, label=name)
        axes.set(title=title, xlabel="index", ylabel="relative to the first")
        axes.set_xlim(0, most + 1)
        if len(series) > 1:
            axes.legend()


def energy_unit(values: ArrayLike) -> tuple[str, float]:
    """Return a unit of energy for some values [J], and the number of units in a joule."""
    largest = np.abs(values).max()
    return ("J", 1.0) if largest >= 1 else ("mJ", 1e3) if largest >= 1e-3 else ("\u00b5J", 1e6)


def scale_bar(axes: Axes, left: float, right: float, at: float) -> None:
    """Draw a bar of a round length [mm] near the right end of axes that reach from `left` to `right` [mm]."""
    length = max(n for n in (1, 2, 5, 10, 20, 50, 100, 200, 500) if n <= max(1.0, (right - left) / 8))
    end = right - 0.02 * (right - left)
    axes.plot([end - length, end], [at, at], color="black", lw=2.5, solid_capstyle="butt")
    placing = {"textcoords": "offset points", "ha": "right", "va": "center", "fontsize": 9}
    axes.annotate(f"{length} mm", (end - length, at), (-5, 0), **placing)  # type: ignore[arg-type]
