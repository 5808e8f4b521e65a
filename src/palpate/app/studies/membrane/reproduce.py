"""``palpate reproduce membrane``: the paper's membrane with the full model and with reduced ones (section 6.2).

The reduced models are the paper's, projected on all nodes, and hyper-reduced ones, an energy sampled at few points.

One basis for the whole run is far worse than one for each of its phases, while the tool pushes and after.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from time import perf_counter
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from palpate.app.common.console import Console
from palpate.app.common.preparation import prepare
from palpate.app.common.report import REPORTS
from palpate.app.common.vtkhdf import write_vtkhdf
from palpate.app.studies.membrane.report import build_report, tables
from palpate.app.studies.report import deliver_study
from palpate.app.studies.study import HYPER_REDUCED, PROJECTED, Phase, Study, Train, run_full, run_reduced
from palpate.arrays import Floats
from palpate.dynamics.membrane.model import Membrane
from palpate.dynamics.nodal.model import NodalModel
from palpate.dynamics.run.trajectory import Trajectory
from palpate.extras import require
from palpate.faults import integer_in_range
from palpate.reduction.galerkin.model import GalerkinModel, galerkin
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.training.reduce import hyper_reduce
from palpate.scenes.membrane import DURATION, EVERY, PUSH_TIME, membrane

__all__ = ["FIGURES", "FILES", "reproduce_membrane"]

SNAPSHOTS = round(PUSH_TIME / EVERY)  # of a phase, that move
STEP = EVERY / 5  # of the projected runs while the tool pushes; after its jump they are not stable with such a step
PHASES = (Phase("push", 0.0, PUSH_TIME, STEP), Phase("after", PUSH_TIME, DURATION - PUSH_TIME))
FIGURES = (
    "figure7_error.png",
    "figure8_time.png",
    "figure9_deflection.png",
    "singular_values.png",
    "tool_force.png",
    "energies.png",
    "tension.png",
)
FILES = (*REPORTS, *FIGURES, "full.h5", "membrane.vtkhdf")


def reproduce_membrane(
    *,
    spacing: float,
    after: str,
    tool_radius: float,
    prestretch: float,
    layout: str,
    jitter: float,
    seed: int,
    modes: Sequence[int],
    out: Path,
    as_json: bool = False,
) -> int:
    """Run the study and leave its files in a folder.

    Parameters
    ----------
    spacing : float [m]
    tool_radius : float [m]
    prestretch, layout, jitter, seed
        As for `palpate.scenes.membrane.membrane`.
    modes : sequence of int
        Sizes of the reduced models of each phase, from 1 to its 50 snapshots.
    out : path
        Folder for the results; made if it does not exist. A file of an earlier study is replaced by the new one.
    as_json : bool
        Print the report as JSON instead of tables.

    Returns
    -------
    int
        0, or 1 if every reduced run failed.
    """
    sizes = sorted({integer_in_range("modes", m, 1, SNAPSHOTS) for m in modes})
    require("matplotlib", "palpate reproduce membrane")
    console = Console()
    scene = prepare(
        lambda: membrane(spacing, after, tool_radius, prestretch, layout, jitter, seed),
        out,
        6 + 9,  # in full.h5 displacements and velocities, in the export those, two stresses and the state
        console,
    )
    study = Study(scene, PHASES, SERIES)
    run_full(study, out, FILES, console)
    model = cast(Membrane, scene.model)
    states = np.stack([model.tension(displacement) for displacement in study.full.displacements])
    values, pod_seconds = _singular_values(study)
    run_reduced(study, sizes, console)
    report = build_report(study, states, values, pod_seconds, {"after": after, "layout": layout})
    report["missing"] = _write_results(study, states, report, out, console)
    return deliver_study(report, tables(report), out, FILES, as_json)


def _singular_values(study: Study) -> tuple[dict[str, Floats], float]:
    """Return the singular values that the modes of every phase belong to, and the time [s] of finding them."""
    start = perf_counter()
    runs = zip(study.phases, study.parts, strict=True)
    values = {phase.name: train(study.scene.model, run, 1).basis.singular_values for phase, run in runs}
    return values, perf_counter() - start


def train(model: NodalModel, run: Trajectory, modes: int) -> GalerkinModel:
    """Train a reduced model on a run over one phase: the waves start at the tool, and small at first."""
    return galerkin(model, run, modes=modes, prescribed=("tool",), lifting="local", relative=True)


def train_sampled(model: NodalModel, run: Trajectory, modes: int) -> ReducedModel:
    """Train a hyper-reduced model on a run over one phase."""
    return hyper_reduce(cast(Membrane, model), run, modes=modes, prescribed="tool")


SERIES: dict[str, Train] = {PROJECTED: train, HYPER_REDUCED: train_sampled}


def _write_results(
    study: Study, states: NDArray[np.int8], report: dict[str, Any], out: Path, console: Console
) -> dict[str, str]:
    """Write the export and the figures; return why those that are missing could not be made."""
    with console.status("writing the figures and the file for ParaView"):
        from palpate.app.common.rendering import DrawingError
        from palpate.app.studies.membrane.figures import draw_figures
        from palpate.app.studies.membrane.picture import draw_deflection

        full, missing = study.full, {}
        model = cast(Membrane, study.scene.model)
        stress = np.stack([model.principal_stress(displacement) for displacement in full.displacements])
        fields = {
            "displacement": full.displacements,
            "velocity": full.velocities,
            "principal_stress_1": stress[..., 0],
            "principal_stress_2": stress[..., 1],
            "tension": states.astype(float),
        }
        write_vtkhdf(out / "membrane.vtkhdf", model.cloud, full.times, fields)
        draw_figures(study, states, report, out)
        try:
            draw_deflection(study, out / "figure9_deflection.png")
        except DrawingError as error:
            missing["figure9_deflection.png"] = str(error)
            console.say(f"figure9_deflection.png is missing: {error}")
    return missing
