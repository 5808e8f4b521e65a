"""``palpate reproduce beam``: the paper's beam with the full model and with reduced ones (section 6.1).

The paper's models project the strong form at all nodes. Next to them stand hyper-reduced models of the same numbers
of modes, which sample the energy form. Each is trained on the run of the full model that it reduces, and compared with
that run; the difference of the two full runs is a figure of its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any, cast

import numpy as np

from palpate.app.common.console import Console
from palpate.app.common.exit_status import RunError
from palpate.app.common.preparation import prepare
from palpate.app.common.report import REPORTS
from palpate.app.common.vtkhdf import write_vtkhdf
from palpate.app.studies.beam.report import build_report, difference_of_forms, tables
from palpate.app.studies.report import deliver_study
from palpate.app.studies.study import HYPER_REDUCED, PROJECTED, Phase, Study, Train, run_full, run_reduced
from palpate.arrays import Floats
from palpate.dynamics.solid.model import Solid
from palpate.extras import require
from palpate.faults import integer_in_range
from palpate.reduction.basis.pod import pod
from palpate.reduction.galerkin.model import galerkin
from palpate.reduction.training.reduce import hyper_reduce
from palpate.scenes.beam import DURATION, EVERY, beam

__all__ = ["FIGURES", "FILES", "reproduce_beam", "von_mises"]


STRONG_FORM_PHASES = (Phase("full", 0.0, DURATION),)
ENERGY_FORM_PHASES = (Phase("full_energy_form", 0.0, DURATION),)
PROJECTED_SERIES: dict[str, Train] = {PROJECTED: lambda model, run, size: galerkin(model, run, modes=size)}
HYPER_REDUCED_SERIES: dict[str, Train] = {
    HYPER_REDUCED: lambda model, run, size: hyper_reduce(cast(Solid, model), run, modes=size)
}
SNAPSHOTS = round(DURATION / EVERY)  # that move: the first shows the body at rest
FIGURES = (
    "figure3_error.png",
    "figure4_time.png",
    "figure5_ratio.png",
    "singular_values.png",
    "tip.png",
    "energies.png",
    "beam.png",
)
FILES = (*REPORTS, *FIGURES, "full.h5", "full_energy_form.h5", "beam.vtkhdf")


def reproduce_beam(
    *, spacing: float, load: float, poisson: float, modes: Sequence[int], out: Path, as_json: bool = False
) -> int:
    """Run the study and leave its files in a folder.

    Parameters
    ----------
    spacing : float [m]
    load : float [N]
    poisson : float
        As for `palpate.scenes.beam.beam`.
    modes : sequence of int
        Sizes of the reduced models, from 1 to the 100 snapshots.
    out : path
        Folder for the results; made if it does not exist. A file of an earlier study is replaced by the new one.
    as_json : bool
        Print the report as JSON instead of a table.

    Returns
    -------
    int
        0, or 1 if every reduced run failed.
    """
    sizes = sorted({integer_in_range("modes", m, 1, SNAPSHOTS) for m in modes})
    require("matplotlib", "palpate reproduce beam")
    console = Console()
    # in each file of a run displacements and velocities, in the export those and the stress
    scene = prepare(lambda: beam(spacing=spacing, load=load, poisson=poisson), out, 2 * 6 + 7, console)
    strong = Study(scene, STRONG_FORM_PHASES, PROJECTED_SERIES, title="full model, strong form")
    run_full(strong, out, FILES, console)
    start = perf_counter()
    singular_values = pod(strong.full, scene.model.cloud.volumes, modes=1).singular_values
    pod_seconds = perf_counter() - start
    run_reduced(strong, sizes, console)
    energy = _run_energy_form(strong, sizes, out, console)
    report = build_report(strong, energy, singular_values, pod_seconds)
    report["missing"] = _write_results(strong, energy, report, out, console)
    return deliver_study(report, tables(report), out, FILES, as_json)


def _run_energy_form(strong: Study, sizes: Sequence[int], out: Path, console: Console) -> Study | None:
    """Run the energy form of the same body and its reduced models; return nothing if the full run diverges."""
    body = cast(Solid, strong.scene.model)
    with console.status("making the energy form of the model ready"):
        scene = replace(strong.scene, model=Solid(body.cloud, body.material, body.supports, form="energy"))
    title, file = "full model, energy form", "full_energy_form.h5"
    energy = Study(scene, ENERGY_FORM_PHASES, HYPER_REDUCED_SERIES, title=title, file=file)
    try:
        run_full(energy, out, [], console)
    except RunError as error:
        console.say(str(error))
        return None
    console.say(difference_of_forms(strong, energy))
    run_reduced(energy, sizes, console)
    return energy


def von_mises(model: Solid, displacements: Floats) -> Floats:
    """Return the von Mises stress [Pa] of the Cauchy stress at every node, (f, n), for displacements (f, n, 3) [m]."""
    stresses = np.empty(displacements.shape[:2])
    for frame, displacement in enumerate(displacements):
        cauchy = model.cauchy_stress(displacement)
        deviator = cauchy - np.trace(cauchy, axis1=1, axis2=2)[:, None, None] * np.eye(3) / 3
        stresses[frame] = np.sqrt(1.5 * np.sum(deviator**2, axis=(1, 2)))
    return stresses


def _write_results(
    study: Study, energy: Study | None, report: dict[str, Any], out: Path, console: Console
) -> dict[str, str]:
    """Write the export and the figures; return why those that are missing could not be made."""
    with console.status("writing the figures and the file for ParaView"):
        from palpate.app.common.rendering import DrawingError
        from palpate.app.studies.beam.figures import draw_figures
        from palpate.app.studies.beam.picture import draw_beam

        full, missing = study.full, {}
        stress = von_mises(cast(Solid, study.scene.model), full.displacements)
        fields = {"displacement": full.displacements, "velocity": full.velocities, "von_mises": stress}
        write_vtkhdf(out / "beam.vtkhdf", study.scene.model.cloud, full.times, fields)
        draw_figures(study, energy, report, out)
        try:
            draw_beam(study.scene.model.cloud, full, stress, out / "beam.png")
        except DrawingError as error:
            missing["beam.png"] = str(error)
            console.say(f"beam.png is missing: {error}")
    return missing
