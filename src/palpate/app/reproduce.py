"""``palpate reproduce beam``: the paper's beam with the full model and with reduced ones (section 6.1)."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.app.console import Console, print_results
from palpate.app.export import write_vtkhdf
from palpate.app.files import check_folder, check_space, write_json
from palpate.app.report import build_report
from palpate.dynamics.rollout import rollout
from palpate.dynamics.trajectory import Trajectory
from palpate.faults import DivergenceError, InputError, integer_in_range
from palpate.reduction.errors import errors
from palpate.reduction.pod import Basis, pod
from palpate.reduction.reduced import reduce
from palpate.scenes.beam import DURATION, EVERY, beam
from palpate.scenes.scene import Scene

__all__ = ["FILES", "ReproduceError", "Study", "reproduce_beam", "von_mises"]

Floats = NDArray[np.float64]

SNAPSHOTS = round(DURATION / EVERY)  # that move: the first shows the body at rest
SHOWN_MODES = 8  # the reduced model in tip.png: the paper's choice
FIGURES = (
    "figure3_error.png",
    "figure4_time.png",
    "figure5_ratio.png",
    "singular_values.png",
    "tip.png",
    "energies.png",
    "beam.png",
)
FILES = ("report.json", *FIGURES, "full.h5", "beam.vtkhdf")


class ReproduceError(RuntimeError):
    """The study could not be finished; says what is kept."""


@dataclass
class Study:
    """What was run.

    Parameters
    ----------
    scene : Scene
    full : Trajectory
    basis : Basis
        One mode, with the singular values of all snapshots.
    pod_seconds : float [s]
        Time of the decomposition of the snapshots.
    reduced : list of dict
        One entry for every number of modes, as in the report.
    shown : Trajectory or None
        The reduced run that the figures compare with the full one.
    shown_modes : int
        Its number of modes.
    """

    scene: Scene
    full: Trajectory
    basis: Basis
    pod_seconds: float
    reduced: list[dict[str, Any]] = field(default_factory=list)
    shown: Trajectory | None = None
    shown_modes: int = 0


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

    Raises
    ------
    InputError
        A parameter out of range, or a folder that cannot be written: before anything is computed or written.
    ReproduceError
        The full run diverged; its frames are kept.
    OSError
        A file could not be written.
    """
    sizes = sorted({integer_in_range("modes", m, 1, SNAPSHOTS) for m in modes})
    check_folder(out)
    console = Console()
    with console.status("making the model ready (the first run on a machine compiles it: a minute or two)"):
        scene = beam(spacing=spacing, load=load, poisson=poisson)
    frames, nodes = SNAPSHOTS + 1, len(scene.model.cloud)
    check_space(out, 13 * frames * nodes * 8 + 5_000_000)  # doubles in the snapshots and the export, and the figures
    out.mkdir(parents=True, exist_ok=True)
    console.say(f"{scene.title}: {nodes} nodes; {scene.model.stability.step:.3g} s is stable at rest")
    full = _run_full(scene, out, console)
    study = _reduce_all(scene, full, sizes, console)
    report = build_report(study)
    report["missing"] = _write_results(study, report, out, console)
    write_json(out / "report.json", report)
    print_results(report, out, [name for name in FILES if (out / name).is_file()], as_json)
    return 1 if all(entry["failed"] for entry in study.reduced) else 0


def _run_full(scene: Scene, out: Path, console: Console) -> Trajectory:
    """Run the full model, streaming its frames beside the final name until they are complete."""
    partial = out / "full.partial.h5"
    kept = f"the frames until then are kept in {partial}"
    step = scene.model.stability.step
    try:
        rollout(scene.model, scene.loads, duration=step, every=step, progress=False)  # compiles what is left
        console.say(f"full model: {scene.duration:g} s, {round(scene.duration / scene.every)} snapshots ...")
        full = rollout(scene.model, scene.loads, duration=scene.duration, every=scene.every, file=partial)
    except DivergenceError as error:
        raise ReproduceError(f"the full model diverged: {error}; {kept}") from error
    except KeyboardInterrupt:
        raise KeyboardInterrupt(f"in the full run; {kept}" if partial.exists() else "") from None
    for name in FILES:  # of an earlier study: what stands in the folder belongs together
        (out / name).unlink(missing_ok=True)
    os.replace(partial, out / "full.h5")
    console.say(f"full model: {full.wall_seconds:.2f} s, {int(full.steps[-1])} steps")
    return full


def _reduce_all(scene: Scene, full: Trajectory, sizes: Sequence[int], console: Console) -> Study:
    start = perf_counter()
    basis = pod(full, scene.model.cloud.volumes, modes=1)
    study = Study(scene, full, basis, perf_counter() - start)
    try:
        for size in sizes:
            entry, run = _run_reduced(scene, full, size)
            study.reduced.append(entry)
            if run is None:
                console.say(f"reduced, {size} modes: failed: {entry['reason']}")
                continue
            console.say(
                f"reduced, {size} modes: {run.wall_seconds:.2f} s, {entry['ratio']:.1%} of the full model's time, "
                f"displacement error {entry['errors']['displacement']:.3%}"
            )
            if study.shown is None or abs(size - SHOWN_MODES) < abs(study.shown_modes - SHOWN_MODES):
                study.shown, study.shown_modes = run, size
    except KeyboardInterrupt:
        raise KeyboardInterrupt("in the reduced runs; the full model's frames are kept in full.h5") from None
    return study


def _run_reduced(scene: Scene, full: Trajectory, size: int) -> tuple[dict[str, Any], Trajectory | None]:
    """Train and run a reduced model; return its entry in the report and its run, if it was finished."""
    try:
        start = perf_counter()
        model = reduce(scene.model, full, modes=size)
        training = perf_counter() - start
        step = scene.model.stability.step
        rollout(model, scene.loads, duration=step, every=step, progress=False)  # compiles, and warms the caches
        run = rollout(model, scene.loads, duration=scene.duration, every=scene.every)
    except (DivergenceError, InputError) as error:
        return {"modes": size, "failed": True, "reason": " ".join(str(error).split())}, None
    projected = replace(full, displacements=model.basis.lift(model.basis.project(full.displacements)))
    return {
        "modes": size,
        "failed": False,
        "errors": errors(full, run).as_dict(),
        "projection_error": errors(full, projected).displacement,
        "training_seconds": training,
        "wall_seconds": run.wall_seconds,
        "ratio": run.wall_seconds / full.wall_seconds,
        "real_time_factor": scene.duration / run.wall_seconds,
        "steps": int(run.steps[-1]),
    }, run


def von_mises(scene: Scene, displacements: Floats) -> Floats:
    """Return the von Mises stress [Pa] of the Cauchy stress at every node, (f, n), for displacements (f, n, 3) [m]."""
    stresses = np.empty(displacements.shape[:2])
    for frame, displacement in enumerate(displacements):
        cauchy = scene.model.cauchy_stress(displacement)
        deviator = cauchy - np.trace(cauchy, axis1=1, axis2=2)[:, None, None] * np.eye(3) / 3
        stresses[frame] = np.sqrt(1.5 * np.sum(deviator**2, axis=(1, 2)))
    return stresses


def _write_results(study: Study, report: dict[str, Any], out: Path, console: Console) -> dict[str, str]:
    """Write the export and the figures; return why those that are missing could not be made."""
    with console.status("writing the figures and the file for ParaView"):
        from palpate.app.figures import draw_figures
        from palpate.app.pictures import DrawingError, draw_beam

        full, missing = study.full, {}
        stress = von_mises(study.scene, full.displacements)
        fields = {"displacement": full.displacements, "velocity": full.velocities, "von_mises": stress}
        write_vtkhdf(out / "beam.vtkhdf", study.scene.model.cloud, full.times, fields)
        draw_figures(study, report, out)
        try:
            draw_beam(study.scene.model.cloud, full, stress, out / "beam.png")
        except DrawingError as error:
            missing["beam.png"] = str(error)
            console.say(f"beam.png is missing: {error}")
    return missing
