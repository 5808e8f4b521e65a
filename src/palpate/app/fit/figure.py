"""Picture of a fit: measured points, and the curves of the law."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from palpate.app.common.figures import BLUE, GREEN, ORANGE, PINK, RED, SKY, figure, heading
from palpate.tissue.fitting import Fit
from palpate.tissue.homogeneous import nominal_stress, rest
from palpate.tissue.measurements import Measurement

if TYPE_CHECKING:
    from matplotlib.axes import Axes

CURVE_COLOURS = (BLUE, RED, GREEN, ORANGE, PINK, SKY)
CURVE_MARKERS = "os^Dvx"


def draw_fit(fitted: Fit, path: Path) -> None:
    """Draw measured points and fitted curves, with separate axes for tests in shear."""
    groups = [[m for m in fitted.measurements if (m.kind == "shear") == sheared] for sheared in (False, True)]
    groups = [group for group in groups if group]
    names = [curve.name for curve in fitted.curves]
    largest = max(float(np.abs(m.stress).max()) for m in fitted.measurements)
    unit, scale = ("MPa", 1e6) if largest >= 1e6 else ("kPa", 1e3) if largest >= 1e3 else ("Pa", 1.0)
    with figure(path, (4.6 + 2.8 * len(groups), 4.6)) as drawn:
        for axes, group in zip(drawn.subplots(1, len(groups), squeeze=False)[0], groups, strict=True):
            for measured in group:
                k = [other is measured for other in fitted.measurements].index(True)
                _draw(axes, fitted, measured, k, names[k], scale)
            axes.set(xlabel="shear" if group[0].kind == "shear" else "stretch", ylabel=f"nominal stress [{unit}]")
            axes.legend(fontsize=9)
        heading(drawn, f"{type(fitted.material).__name__}: measured points, fitted curves")


def _draw(axes: Axes, fitted: Fit, measured: Measurement, k: int, name: str, scale: float) -> None:
    colour, marker = CURVE_COLOURS[k % len(CURVE_COLOURS)], CURVE_MARKERS[k % len(CURVE_MARKERS)]
    ends = [rest(measured.kind), *measured.deformation]
    along = np.linspace(min(ends), max(ends), 200)
    axes.plot(along, nominal_stress(fitted.material, measured.kind, along) / scale, color=colour, lw=1.8)
    label = f"{name}, R$^2$ {fitted.curves[k].r_squared:.4f}"
    stress = measured.stress / scale
    axes.plot(measured.deformation, stress, marker, color=colour, ms=5, mfc="none", label=label)
