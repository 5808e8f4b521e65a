"""Replay of a recorded tool path on the full model, and the errors of the recorded reduced model."""

from __future__ import annotations

from typing import Any

import numpy as np

from palpate.app.recordings.recording import MAX_DURATION, Recording
from palpate.app.recordings.snapshot import Snapshot
from palpate.app.recordings.tool_paths import MIN_SNAPSHOTS, TOOL_NAME, make_load
from palpate.app.train.scene_folder import is_file
from palpate.arrays import Floats
from palpate.dynamics.contact.tools import Contact
from palpate.dynamics.loads.prescribed_motion import PrescribedMotion
from palpate.dynamics.run.model import Model
from palpate.dynamics.run.rollout import rollout
from palpate.dynamics.run.trajectory import Trajectory
from palpate.faults import InputError
from palpate.files import shortened
from palpate.realtime.bodies.display_surface import Surface
from palpate.reduction.hyper.model import ReducedModel
from palpate.scenes.names import PACKAGE_SCENES
from palpate.scenes.training import search_current_folder, training_scene

MAX_INITIAL_DISPLACEMENT = 0.02  # of the body when the tool comes, as a fraction of the spacing
POINT_TOLERANCE = 1e-6  # between equal points of two bodies, as a fraction of the spacing


def full_model(reduced: ReducedModel, trusted_scene: str | None = None) -> Model:
    """Return the full model of the scene that a reduced model was trained on.

    Names in a file are never imported: without `trusted_scene` the scene must be one of palpate's own.

    Parameters
    ----------
    trusted_scene : str, optional
        Scene that the user trusts, ``"module:function"``; it must equal the one in the file.
    """
    scene_record = reduced.report.get("scene")
    if not scene_record:
        raise InputError(
            "model must name its training scene for a full model, got one without; train the model by "
            "`palpate train SCENE`"
        )
    scene, parameters, cloud = scene_record["name"], scene_record["parameters"], reduced.cloud
    if trusted_scene is not None and is_file(trusted_scene) and is_file(scene):
        scene = trusted_scene  # its digest is checked, wherever it lies
    if trusted_scene is not None and trusted_scene != scene:
        raise InputError(f"scene must be {scene!r}, on which the model was trained, got {trusted_scene!r}")
    if trusted_scene is None and scene not in PACKAGE_SCENES:
        kind = scene if is_file(scene) else "MODULE:FUNCTION if you trust that module"
        raise InputError(
            f"scene of the model must be one of {', '.join(PACKAGE_SCENES)}, got {shortened(scene)!r}; names in a file "
            f"are not imported or opened: add --scene {kind}"
        )
    if trusted_scene is not None:
        search_current_folder()
    model = training_scene(scene, parameters).model
    points, tolerance = model.cloud.points, POINT_TOLERANCE * cloud.spacing
    if points.shape != cloud.points.shape or not np.allclose(points, cloud.points, atol=tolerance):
        raise InputError(
            f"body of scene {scene!r} must be that of the model, got different points; train the model again"
        )
    return model


def reduced_model(recording: Recording) -> ReducedModel:
    """Return the reduced model of a recording; raise `InputError` for one of a full body."""
    if not isinstance(recording.model, ReducedModel):
        raise InputError("full must be left out for a recording of a full body, got one; replay it without --full")
    return recording.model


def tool_path(recording: Recording) -> tuple[slice, dict[str, Any]]:
    """Return the range of snapshots with an active tool, and the description of the tool."""
    reduced_model(recording)
    active = np.array([snapshot.tool != "none" for snapshot in recording.snapshots])
    if not active.any():
        raise InputError("recording must have an active tool, got none; record a press or a grasp")
    first, last = int(np.argmax(active)), len(active) - int(np.argmax(active[::-1]))
    part = slice(first, last)
    ends = [tool["start"] for tool in recording.tools[1:]] + [len(active)]
    tools = [tool for tool, end in zip(recording.tools, ends, strict=True) if tool["start"] < last and end > first]
    if not active[part].all() or len(tools) > 1:
        raise InputError(
            "recording must have a single press or grasp, got a tool that was released or changed; record one at a time"
        )
    snapshots, kind = recording.snapshots[part], tools[0]["kind"]
    _check_path(recording, snapshots, kind)
    return part, tools[0]


def _check_path(recording: Recording, snapshots: list[Snapshot], kind: str) -> None:
    """Raise InputError for a path that the full model cannot follow."""
    model, times = reduced_model(recording), np.array([snapshot.time for snapshot in snapshots])
    if any(snapshot.tool != kind for snapshot in snapshots):
        raise InputError(f"tools of the snapshots must all be {kind!r}, got another one; record the session again")
    if kind == "group" and len(model.data.prescribed) != 1:
        raise InputError(
            f"model must have one prescribed group, got {len(model.data.prescribed)}; record the session again"
        )
    if times[-1] - times[0] > 2 * MAX_DURATION:
        raise InputError(
            f"model time of a recording must be at most {2 * MAX_DURATION:g} s, got {times[-1] - times[0]:g} s; "
            "record the session again"
        )
    if any(snapshot.modulus_ratio != 1.0 for snapshot in snapshots):
        raise InputError("modulus_ratio must be 1 for --full, got another one; record without changing the moduli")
    if np.any(np.diff(times) < 0):
        raise InputError("time must not decrease for --full, got a reset of the session; record without a reset")
    displacement = float(np.abs(snapshots[0].displacements(Surface(model))).max())
    limit = MAX_INITIAL_DISPLACEMENT * model.cloud.spacing
    if displacement > limit:
        raise InputError(
            f"initial displacement must be at most {1e3 * limit:.2g} mm for --full, got {1e3 * displacement:.2g} mm; "
            "let the body come to rest before the tool touches it"
        )


def replay_on_full_model(recording: Recording, model: Model | None = None) -> dict[str, Any]:
    """Run the recorded tool path on the full model.

    Parameters
    ----------
    model : Model, optional
        By default the model of the scene.

    Returns
    -------
    dict
        ``"times"`` (f,) [s] of the recording, ``"positions"`` (f, n, 3) [m] of the surface, ``"force"`` (f, 3) [N] on
        the tool, and ``"errors"``, the result of `replay_errors`.
    """
    part, tool = tool_path(recording)
    model = model or full_model(reduced_model(recording))
    snapshots = recording.snapshots[part]
    model_times = np.array([snapshot.time for snapshot in snapshots])
    keep = np.concatenate([[True], np.diff(model_times) > 0])  # one snapshot of a pause
    times, wall = model_times[keep] - model_times[0], recording.times[part][keep]
    snapshots = [snapshot for snapshot, kept in zip(snapshots, keep, strict=True) if kept]
    if len(times) < MIN_SNAPSHOTS:
        raise InputError(
            f"the tool must be active in at least {MIN_SNAPSHOTS} snapshots, got {len(times)}; record for longer"
        )
    load = make_load(recording, tool, snapshots, times)
    every = float(times[-1] / (len(times) - 1))
    run = rollout(model, [load], duration=float(times[-1]), every=every)
    surface = Surface(reduced_model(recording))
    at = np.array([int(np.argmin(np.abs(run.times - t))) for t in times])
    displacements = run.displacements[at][:, surface.nodes]
    if isinstance(load, Contact):
        displacements = np.array([surface.patch_displacements(each) for each in displacements])
    force = -run.reactions[load.group if isinstance(load, PrescribedMotion) else TOOL_NAME][at]
    return {
        "times": wall, "positions": (surface.rest + displacements).astype(np.float32), "force": force,
        "errors": replay_errors(surface, snapshots, displacements, force, run),
    }  # fmt: skip


def replay_errors(
    surface: Surface, snapshots: list[Snapshot], displacements: Floats, force: Floats, run: Trajectory
) -> dict[str, float]:
    """Return the relative errors of recorded snapshots against the full model.

    Returns
    -------
    dict
        ``"displacement"``: root mean square of the error over that of the displacement, over surface and time.
        ``"largest"``: largest error of a vertex over the largest displacement. ``"force"``: mean error of the tool's
        force over the largest force. ``"peak"``: relative error of the largest force. ``"wall_seconds"``: computing
        time of the full model. ``"seconds"``: duration of the path.
    """
    recorded = np.array([snapshot.displacements(surface) for snapshot in snapshots])
    tool_forces = np.array([snapshot.force for snapshot in snapshots])
    size, peak = float(np.linalg.norm(displacements)), float(np.linalg.norm(force, axis=1).max())
    if not size > 0 or not peak > 0:
        raise InputError("tool must touch the full model for a comparison, got no contact; record a deeper press")
    largest = float(np.linalg.norm(displacements, axis=2).max())
    return {
        "displacement": float(np.linalg.norm(recorded - displacements)) / size,
        "largest": float(np.linalg.norm(recorded - displacements, axis=2).max()) / largest,
        "force": float(np.linalg.norm(tool_forces - force, axis=1).mean()) / peak,
        "peak": float(np.linalg.norm(tool_forces, axis=1).max()) / peak - 1.0,
        "wall_seconds": float(run.wall_seconds),
        "seconds": float(run.times[-1]),
    }
