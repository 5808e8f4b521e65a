"""The membrane under a tool tip: section 6.2 of the paper.

One basis for the whole run is far worse than one for each of its phases, while the tool pushes and after.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

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
    figure,
    heading,
)
from palpate.app.common.rows import Rows
from palpate.app.studies.example import Example
from palpate.app.studies.figures import (
    ErrorMark,
    TimeAxes,
    draw_energies,
    draw_errors,
    draw_times,
    draw_values,
    percentage_of,
    phase_titles,
    seconds_of,
)
from palpate.app.studies.membrane_picture import draw_deflection
from palpate.app.studies.report import COST_ROWS, Claim, Finished, cost_of
from palpate.app.studies.study import HYPER_REDUCED, PROJECTED, Phase, Study
from palpate.core.arrays import Floats
from palpate.dynamics.membrane.model import Membrane
from palpate.dynamics.nodal.model import NodalModel
from palpate.dynamics.run.trajectory import Trajectory
from palpate.meshfree.cloud import Cloud
from palpate.reduction.galerkin.model import GalerkinModel, galerkin
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.training.reduce import hyper_reduce
from palpate.scenes.load_case import LoadCase
from palpate.scenes.membrane import DURATION, EVERY, PUSH_TIME, RADIUS, membrane

if TYPE_CHECKING:
    from matplotlib.axes import Axes

STEP = EVERY / 5  # of the projected runs while the tool pushes; after its jump they are not stable with such a step
AFTERWARDS = {"return": "Tool back at 0", "hold": "Tool holds still", "release": "Tool has let go"}
STATES = {"slack": YELLOW, "wrinkled": SKY, "taut": BLUE}
WRINKLED_STATE = list(STATES).index("wrinkled")
RADIUS_COLOURS = {0.0: "black", 0.25: BLUE, 0.5: GREEN, 0.75: ORANGE}  # shares of the radius whose deflection is drawn
PIXELS = 700  # across a map of states

# How the paper's words of Figures 7 and 8 are read; it prints no numbers
HIGH_ERROR, SMALL_ERROR = 0.1, 0.03  # displacement error
MAX_REMAINING_ERROR = 0.2  # at most this share of the error with 2 modes is left with 8
MAX_ERROR_CHANGE = 0.01  # change of the displacement error
MAX_TIME_SHARE = 0.1  # of the full model's


def _study(case: LoadCase) -> Study:
    after = AFTERWARDS[str(case.parameters["after"])]
    phases = (
        Phase("push", 0.0, PUSH_TIME, STEP, "Tool pushes"),
        Phase("after", PUSH_TIME, DURATION - PUSH_TIME, title=after),
    )
    return Study(case, phases, {PROJECTED: _train, HYPER_REDUCED: _train_sampled})


def _train(model: NodalModel, run: Trajectory, modes: int) -> GalerkinModel:
    """Train a reduced model on a run over one phase: the waves start at the tool, and small at first."""
    return galerkin(model, run, modes=modes, prescribed=("tool",), lifting="local", relative=True)


def _train_sampled(model: NodalModel, run: Trajectory, modes: int) -> ReducedModel:
    """Train a hyper-reduced model on a run over one phase."""
    return hyper_reduce(cast(Membrane, model), run, modes=modes, prescribed="tool")


def _stresses(model: NodalModel, displacements: Floats) -> dict[str, Floats]:
    """Return principal stresses [Pa] and the state of the sheet, `palpate.Membrane.tension`, (f, n)."""
    sheet = cast(Membrane, model)
    stress = np.stack([sheet.principal_stress(displacement) for displacement in displacements])
    states = np.stack([sheet.tension(displacement) for displacement in displacements]).astype(float)
    return {"principal_stress_1": stress[..., 0], "principal_stress_2": stress[..., 1], "tension": states}


def _quantities(study: Study, number: int) -> dict[str, Any]:
    cloud, run = study.case.model.cloud, study.parts[number]
    begin = sum(len(part.times) - 1 for part in study.parts[:number])
    wrinkled = (study.fields["tension"][begin : begin + len(run.times)] == WRINKLED_STATE) @ cloud.volumes
    force, deflection = run.reactions["tool"], run.displacements[-1, :, 2]
    size = np.linalg.norm(force, axis=1)
    peak, widest = int(np.argmax(size)), int(np.argmax(wrinkled))
    energy = max(np.abs(run.external).max(), (run.kinetic + run.strain).max())
    return {
        **cost_of(run),
        "end_time": float(run.times[-1]),
        "tool_force_at_end": float(force[-1, 2]),
        "centre_deflection_at_end": float(deflection[cloud.group("centre")[0]]),
        "mean_deflection_at_end": float(deflection @ cloud.volumes / cloud.volumes.sum()),
        "peak_tool_force": float(size[peak]),
        "peak_tool_force_time": float(run.times[peak]),
        "energy_balance": float(np.abs(run.balance).max() / energy),
        "energy_balance_after_first_snapshot": float(np.abs(run.balance[1:] - run.balance[1]).max() / energy),
        "largest_wrinkled_area": float(wrinkled[widest]),
        "largest_wrinkled_share": float(wrinkled[widest] / cloud.volumes.sum()),
        "largest_wrinkled_time": float(run.times[widest]) if wrinkled[widest] else None,
    }


ROWS: Rows = {
    **COST_ROWS,
    "tool force at the end": "{tool_force_at_end:.3f mN}",
    "largest tool force": "{peak_tool_force:.3f mN} at {peak_tool_force_time:.0f ms}",
    "deflection of the centre at the end": "{centre_deflection_at_end:.2f mm}",
    "mean deflection at the end": "{mean_deflection_at_end:.2f mm}",
    "largest wrinkled share of the sheet": "{largest_wrinkled_share:.1%} at {largest_wrinkled_time:.0f ms}",
    "energy balance, largest miss over largest energy": "{energy_balance:.2%}",
    "the same after the first snapshot": "{energy_balance_after_first_snapshot:.2%}",
}


def _negligible_change(done: Finished) -> tuple[str, bool]:
    wrong = done.errors
    more = [modes for modes in wrong if modes > 8]
    text = f"{wrong[8]:.2%} with 8, " + ", ".join(f"{wrong[modes]:.2%} with {modes}" for modes in more)
    return text, max(abs(wrong[modes] - wrong[8]) for modes in more) < MAX_ERROR_CHANGE


def _growing_time(done: Finished) -> tuple[str, bool]:
    slope, fit = done.time_per_mode()
    first, last = (done.seconds[modes] for modes in (min(done.seconds), max(done.seconds)))
    ends = f"{first:.2f} s with {min(done.seconds)}, {last:.2f} s with {max(done.seconds)}"
    return f"{ends}; {1e3 * slope:.2g} ms a mode, R^2 = {fit:.2f}", slope > 0 and last > first


PAPER_CLAIMS = (
    Claim(
        "Figure 7",
        f"the error with only 2 modes is relatively high (read: above {HIGH_ERROR:.0%})",
        lambda done: (f"{done.errors[2]:.2%}", done.errors[2] > HIGH_ERROR),
        modes=(2,),
    ),
    Claim(
        "Figure 7",
        f"more modes reduce it dramatically (read: 8 leave less than {MAX_REMAINING_ERROR:.0%} of it)",
        lambda done: (
            f"8 leave {done.errors[8] / done.errors[2]:.2%} of it",
            done.errors[8] < MAX_REMAINING_ERROR * done.errors[2],
        ),
        modes=(2, 8),
    ),
    Claim(
        "Figure 7",
        f"the error with 8 modes is very small (read: below {SMALL_ERROR:.0%})",
        lambda done: (f"{done.errors[8]:.2%}", done.errors[8] < SMALL_ERROR),
        modes=(8,),
    ),
    Claim(
        "Figure 7",
        f"after 8 modes its change is negligible (read: less than {MAX_ERROR_CHANGE:.0%} of the displacement)",
        _negligible_change,
        modes=(8,),
        more=True,
    ),
    Claim(
        "Figure 8",
        f"few modes reduce the computing time dramatically (read: 2 take less than {MAX_TIME_SHARE:.0%})",
        lambda done: (f"{done.ratios[2]:.1%} of the full model's", done.ratios[2] < MAX_TIME_SHARE),
        modes=(2,),
    ),
    Claim("Figure 8", "the computing time increases with the number of modes", _growing_time, sizes=3),
)


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


def _draw_tool_force(studies: Sequence[Study], path: Path) -> None:
    """Draw the force of the tool, and the deflection at some radii, over time, the force of each phase to its scale."""
    study = studies[0]
    cloud = study.case.model.cloud
    with figure(path, (10.5, 6.4)) as drawn:
        heading(drawn, "Force of the tool on the sheet, and deflection (mean over a ring), at the snapshots")
        upper, lower = drawn.subplots(2, 2, sharex="col")
        lower[1].sharey(lower[0])
        for place, (title, part) in enumerate(zip(phase_titles(study), study.parts, strict=True)):
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


def _draw_tension(studies: Sequence[Study], path: Path) -> None:
    """Draw how much of the sheet is slack, wrinkled or taut over time, and where, when most of it is wrinkled."""
    study = studies[0]
    cloud, times, states = study.case.model.cloud, study.full.times, study.fields["tension"]
    shares = np.stack([(states == k) @ cloud.volumes for k in range(len(STATES))]) / cloud.volumes.sum()
    begin = int(np.argmin(np.abs(times - study.phases[1].start)))
    shown = {"until": slice(1, begin + 1), "after": slice(begin + 1, None)}
    widest = [part.start + int(np.argmax(shares[WRINKLED_STATE, part])) for part in shown.values()]
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
            much = "most" if shares[WRINKLED_STATE, frame] else "never"
            axes.set_title(f"{1e3 * times[frame]:.0f} ms: {much} wrinkled {when} {1e3 * times[begin]:.0f} ms")
        label = "mapped below"
        above.plot(1e3 * times[widest], [103, 103], "v", color=RED, ms=8, clip_on=False, zorder=5, label=label)
        above.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0))


def _map_states(axes: Axes, cloud: Cloud, states: Floats) -> None:
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


ERROR_MARK = ErrorMark((8, 3.0, "paper: very small with 8 modes (drawn: 3 %)"), "paper: negligible change after 8")
TIME_AXES = (
    TimeAxes("Seconds", "wall-clock time of a phase of 0.1 s [s]", seconds_of, full_lines=True),
    TimeAxes("Relative to the full model", "time of reduced / full model [%]", percentage_of),
)
MEMBRANE_EXAMPLE = Example(
    "membrane",
    membrane,
    round(PUSH_TIME / EVERY),
    {"full": _study},
    _stresses,
    6 + 9,  # in full.h5 displacements and velocities, in the export those, two stresses and the state
    _quantities,
    ROWS,
    PAPER_CLAIMS,
    {
        "figure7_error.png": partial(draw_errors, 7, (9.6, 8.6), ERROR_MARK),
        "figure8_time.png": partial(
            draw_times, "Computing time of the reduced models (paper: Figure 8)", (9.6, 4.8), TIME_AXES
        ),
        "figure9_deflection.png": draw_deflection,
        "singular_values.png": draw_values,
        "tool_force.png": _draw_tool_force,
        "energies.png": partial(draw_energies, (9.6, 4.8), (("given", "strain", "kinetic", "dissipated", "balance"),)),
        "tension.png": _draw_tension,
    },
)
