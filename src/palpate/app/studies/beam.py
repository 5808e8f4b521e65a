"""The beam under traction: section 6.1 of the paper.

The paper's models project the strong form. The hyper-reduced models sample the energy form, whose full run is compared
with that of the strong form.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, cast

import numpy as np

from palpate.app.common.figures import BLUE, GREEN, GREY, ORANGE, figure
from palpate.app.common.rows import Rows
from palpate.app.studies.beam_picture import draw_beam
from palpate.app.studies.example import Example
from palpate.app.studies.figures import (
    ErrorMark,
    TimeAxes,
    draw_energies,
    draw_errors,
    draw_times,
    draw_values,
    percentage_of,
    seconds_of,
)
from palpate.app.studies.report import COST_ROWS, Claim, Finished, cost_of
from palpate.app.studies.study import HYPER_REDUCED, PROJECTED, Phase, Study
from palpate.core.arrays import Floats
from palpate.dynamics.nodal.model import NodalModel
from palpate.dynamics.run.trajectory import Trajectory
from palpate.dynamics.solid.model import Solid
from palpate.reduction.galerkin.model import galerkin
from palpate.reduction.training.reduce import hyper_reduce
from palpate.scenes.beam import DURATION, EVERY, beam
from palpate.scenes.load_case import LoadCase

MIN_SHARE_LEFT = 0.5  # of the error with 8 modes; with less than that left, the decrease is not slight
NEARLY_LINEAR = 0.9  # coefficient of determination
MAX_TIME_RATIO = 1.5  # at most this many times the printed ratio of times still is its "almost" or "around"


def _strong_form(case: LoadCase) -> Study:
    series = {PROJECTED: lambda model, run, size: galerkin(model, run, modes=size)}
    return Study(case, (Phase("full", 0.0, DURATION),), series, "strong form")


def _energy_form(case: LoadCase) -> Study:
    body = cast(Solid, case.model)
    if not body.conservative:
        case = replace(case, model=Solid(body.cloud, body.material, body.supports, form="energy"))
    series = {HYPER_REDUCED: lambda model, run, size: hyper_reduce(cast(Solid, model), run, modes=size)}
    name = "full_energy_form"
    return Study(case, (Phase(name, 0.0, DURATION),), series, "energy form", f"{name}.h5")


def von_mises(model: NodalModel, displacements: Floats) -> dict[str, Floats]:
    """Return the von Mises stress [Pa] of the Cauchy stress at every node, (f, n), for displacements (f, n, 3) [m]."""
    stresses = np.empty(displacements.shape[:2])
    for frame, displacement in enumerate(displacements):
        cauchy = cast(Solid, model).cauchy_stress(displacement)
        deviator = cauchy - np.trace(cauchy, axis1=1, axis2=2)[:, None, None] * np.eye(3) / 3
        stresses[frame] = np.sqrt(1.5 * np.sum(deviator**2, axis=(1, 2)))
    return {"von_mises": stresses}


def _tip(study: Study, run: Trajectory) -> Floats:
    """Return the mean axial displacement [m] of the pulled end over a run, shape (f,)."""
    nodes = study.case.model.cloud.group("x+")
    return np.asarray(run.displacements[:, nodes, 0].mean(axis=1))


def _quantities(study: Study, _number: int) -> dict[str, Any]:
    case, full = study.case, study.full
    tip = _tip(study, full)
    peak, middle = int(np.argmax(np.abs(tip))), int(np.argmin(np.abs(full.times - case.duration / 2)))
    force = case.loads[0].force  # type: ignore[union-attr]
    return {
        **cost_of(full),
        "peak_tip_displacement": float(tip[peak]),
        "peak_tip_time": float(full.times[peak]),
        "energy_balance": float(np.abs(full.balance).max() / np.abs(full.external).max()),
        "load_at_peak": float(force(full.times[middle])[0]) if callable(force) else math.nan,
        "reaction_at_peak": float(-full.reactions["x-"][middle, 0]),
    }


ROWS: Rows = {
    **COST_ROWS,
    "largest displacement of the pulled end": "{peak_tip_displacement:.2f mm}",
    "support force at the largest load": "{reaction_at_peak:.4g N} for {load_at_peak:.4g N}",
    "energy balance, largest miss over largest work": "{energy_balance:.2%}",
}


def _slight_decrease(done: Finished) -> tuple[str, bool]:
    eight, last = done.errors[8], done.errors[max(done.errors)]
    return f"{eight:.3%} with 8, {last:.3%} with {max(done.errors)}", last >= MIN_SHARE_LEFT * eight


def _linear_time(done: Finished) -> tuple[str, bool]:
    slope, fit = done.time_per_mode()
    return f"{slope:.3g} s a mode, R^2 = {fit:.3f}", fit > NEARLY_LINEAR and slope > 0


def _ratio_near(modes: int, printed: float) -> Callable[[Finished], tuple[str, bool]]:
    return lambda done: (f"{done.ratios[modes]:.2%}", done.ratios[modes] <= MAX_TIME_RATIO * printed)


PAPER_CLAIMS = (
    Claim(
        "Figure 3",
        "displacement error below 3 % with 6 modes",
        lambda done: (f"{done.errors[6]:.3%}", done.errors[6] < 0.03),
        modes=(6,),
    ),
    Claim(
        "Figure 3",
        f"the error decreases only slightly after 8 modes (read: at least {MIN_SHARE_LEFT:.0%} of it is left)",
        _slight_decrease,
        modes=(8,),
        more=True,
    ),
    Claim("Figure 4", "the time grows almost linearly with the modes", _linear_time, sizes=3),
    Claim("Figure 5", "almost 1 % of the full model's time with 2 modes", _ratio_near(2, 0.01), modes=(2,)),
    Claim("Figure 5", "around 3 % of the full model's time with 8 modes", _ratio_near(8, 0.03), modes=(8,)),
)


def _draw_tip(studies: Sequence[Study], path: Path) -> None:
    """Draw the displacement of the pulled end, and the support force against the load, over time."""
    case, full = studies[0].case, studies[0].full
    force: Any = case.loads[0].force  # type: ignore[union-attr]
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
            upper.plot(run.times, 1e3 * _tip(studies[0], run), label=label, **style)
            lower.plot(run.times, -run.reactions["x-"][:, 0], label=label, **style)
        upper.set(title="Pulled end: mean axial displacement", ylabel="displacement [mm]")
        lower.set(title="Held end: force of the support", xlabel="time [s]", ylabel="force [N]")
        for axes in (upper, lower):
            axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))
            axes.set_xlim(0, full.times[-1])


ERROR_MARK = ErrorMark((6, 3.0, "paper: below 3 % with 6 modes"), "paper: only a slight decrease after 8", line=True)
SECONDS_AXES = TimeAxes(
    "", "wall-clock time of the run [s]", seconds_of, logarithmic=False,
    fitted="straight lines fitted (paper: almost linear)",
)  # fmt: skip
RATIO_AXES = TimeAxes(
    "", "time of reduced / full model [%]", percentage_of,
    points=((2, 8), (1, 3), "paper: almost 1 % with 2 modes, around 3 % with 8"),
)  # fmt: skip
BEAM_EXAMPLE = Example(
    "beam",
    beam,
    round(DURATION / EVERY),
    {"full": _strong_form, "energy_form": _energy_form},
    von_mises,
    2 * 6 + 7,  # in each file of a run displacements and velocities, in the export those and the stress
    _quantities,
    ROWS,
    PAPER_CLAIMS,
    {
        "figure3_error.png": partial(draw_errors, 3, (10.4, 5.6), ERROR_MARK),
        "figure4_time.png": partial(
            draw_times, "Computing time of the reduced models (paper: Figure 4)", (7.0, 4.6), (SECONDS_AXES,)
        ),
        "figure5_ratio.png": partial(
            draw_times, "Computing time relative to the full model (paper: Figure 5)", (7.0, 4.6), (RATIO_AXES,)
        ),
        "singular_values.png": draw_values,
        "tip.png": _draw_tip,
        "energies.png": partial(draw_energies, (8.6, 6.0), (("given", "strain"), ("kinetic", "dissipated", "balance"))),
        "beam.png": draw_beam,
    },
    ("full.h5", "full_energy_form.h5"),
    partial(beam, form="energy"),
    ("beam.png",),
)
