"""Replay of a recorded tool path on the full model, and the errors of the recorded reduced model."""

from __future__ import annotations

from typing import Any

import numpy as np

from palpate.app.recordings.recorded_paths import MIN_SNAPSHOTS, TOOL_NAME, make_load
from palpate.app.recordings.recording import MAX_DURATION, Recording
from palpate.app.recordings.snapshot import Snapshot
from palpate.app.train.scene_folder import is_file
from palpate.core.arrays import Floats
from palpate.core.faults import InputError
from palpate.core.files import shortened
from palpate.dynamics.contact.geometry import compute_gaps
from palpate.dynamics.contact.shapes import make_tool
from palpate.dynamics.contact.tools import Contact
from palpate.dynamics.loads.prescribed_motion import PrescribedMotion
from palpate.dynamics.run.model import Model
from palpate.dynamics.run.rollout import rollout
from palpate.dynamics.run.trajectory import Trajectory
from palpate.realtime.bodies.display_surface import Surface
from palpate.reduction.hyper.model import ReducedModel
from palpate.scenes.names import PACKAGE_SCENES
from palpate.scenes.training import open_training, search_current_folder

MAX_INITIAL_DISPLACEMENT = 0.02  # of the body when the tool comes, as a fraction of the spacing
POINT_TOLERANCE = 1e-6  # between equal points of two bodies, as a fraction of the spacing


def full_model(reduced: ReducedModel, trusted_scene: str | None = None) -> Model:
    """Return the full model of the scene that a reduced model was trained on.

    Names in a file are never imported: without `trusted_scene` the scene must be one of palpate's own. `trusted_scene`
    is ``"module:function"``, trusted by the user; it must equal the one in the file.
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
    model = open_training(scene, parameters).model
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


def tool_path(recording: Recording) -> tuple[slice, list[dict[str, Any]]]:
    """Return the range of snapshots in which tools are active, and the descriptions of these tools.

    It ends where the first of several tools is released, because a tool cannot leave the full model. A tool that comes
    later waits where it is put down, clear of the body.
    """
    reduced_model(recording)
    kinds = np.array([[tool.kind for tool in snapshot.tools] for snapshot in recording.snapshots])
    active = kinds != "none"
    starts, ends = np.argmax(active, axis=0), len(active) - np.argmax(active[::-1], axis=0)
    indices: list[int] = np.flatnonzero(active.any(axis=0)).tolist()
    if not indices:
        raise InputError("recording must have an active tool, got none; record a press or a grasp")
    part = slice(int(starts[indices].min()), int(ends[indices].min()))
    tools = [recording.tool_at(part.stop - 1, index) for index in indices]
    for tool, index in zip(tools, indices, strict=True):
        held = slice(starts[index], part.stop)
        if held.start >= held.stop or not active[held, index].all() or tool is not recording.tool_at(held.start, index):
            raise InputError(
                "recording must have a single press or grasp of each tool, all at a time, got a tool that was released "
                "or changed; record one at a time"
            )
        if np.any(kinds[held, index] != tool["kind"]):
            raise InputError(
                f"tools of the snapshots must all be {tool['kind']!r}, got another one; record the session again"
            )
        _check_wait(recording, recording.snapshots[part.start : held.start], recording.snapshots[held.start], tool)
    _check_path(recording, recording.snapshots[part], tools)
    return part, tools


def _check_wait(recording: Recording, before: list[Snapshot], first: Snapshot, tool: dict[str, Any]) -> None:
    """Raise InputError if a tool that waits at its first pose would act on the body in the snapshots before."""
    model, place = reduced_model(recording), first.tools[tool["index"]]
    surface, tolerance = Surface(model), MAX_INITIAL_DISPLACEMENT * model.cloud.spacing
    for snapshot in before:
        displacements, gaps = snapshot.displacements(surface), np.zeros(len(surface.rest))
        vertices = np.ascontiguousarray(surface.rest + displacements, dtype=float)
        if tool["kind"] == "grasp":
            near = np.linalg.norm(surface.rest - place.position, axis=1) <= tool["radius"]
            acts = np.abs(displacements[near]).max(initial=0.0) > tolerance
        else:
            shape = make_tool(tool["kind"], tool)
            compute_gaps(shape.kind, np.array(shape.sizes), np.append(place.position, place.quaternion), vertices, gaps)
            acts = gaps.min() < -tolerance
        if acts:
            raise InputError(
                f"tool {tool['index']} must be clear of the body until it is put down for --full, got the body there; "
                "put all tools down before the first one presses"
            )


def _check_path(recording: Recording, snapshots: list[Snapshot], tools: list[dict[str, Any]]) -> None:
    """Raise InputError for a path that the full model cannot follow."""
    model, times = reduced_model(recording), np.array([snapshot.time for snapshot in snapshots])
    if any(tool["kind"] == "group" for tool in tools) and len(model.data.prescribed) != 1:
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
    """Run the recorded tool path on the full model, by default that of the scene.

    Returns ``"times"`` (f,) [s] of the recording, ``"positions"`` (f, n, 3) [m] of the surface, ``"force"`` (f, t, 3)
    [N] on the tools, and ``"errors"``, the result of `replay_errors`.
    """
    part, tools = tool_path(recording)
    model = model or full_model(reduced_model(recording))
    snapshots = recording.snapshots[part]
    model_times = np.array([snapshot.time for snapshot in snapshots])
    keep = np.concatenate([[True], np.diff(model_times) > 0])  # one snapshot of a pause
    times, wall = model_times[keep] - model_times[0], recording.times[part][keep]
    snapshots = [snapshot for snapshot, is_shared in zip(snapshots, keep, strict=True) if is_shared]
    if len(times) < MIN_SNAPSHOTS:
        raise InputError(
            f"the tools must be active in at least {MIN_SNAPSHOTS} snapshots, got {len(times)}; record for longer"
        )
    loads = {tool["index"]: _load(recording, tool, snapshots, times) for tool in tools}
    every = float(times[-1] / (len(times) - 1))
    run = rollout(model, list(loads.values()), duration=float(times[-1]), every=every)
    surface = Surface(reduced_model(recording))
    at = np.array([int(np.argmin(np.abs(run.times - t))) for t in times])
    displacements = run.displacements[at][:, surface.nodes]
    if any(isinstance(load, Contact) for load in loads.values()):
        displacements = np.array([surface.patch_displacements(each) for each in displacements])
    force = np.zeros((len(times), len(snapshots[0].tools), 3))
    for index, load in loads.items():
        force[:, index] = -run.reactions[load.group if isinstance(load, PrescribedMotion) else load.name][at]
    return {
        "times": wall, "positions": (surface.rest + displacements).astype(np.float32), "force": force,
        "errors": replay_errors(surface, snapshots, displacements, force, run),
    }  # fmt: skip


def _load(recording: Recording, tool: dict[str, Any], snapshots: list[Snapshot], times: Floats) -> Any:
    """Return the load of a tool from the snapshot on in which it is put down."""
    shown = [snapshot.tools[tool["index"]] for snapshot in snapshots]
    start = [each.kind != "none" for each in shown].index(True)
    if len(shown) - start < 2:
        raise InputError(
            f"tool {tool['index']} must be active in at least 2 snapshots, got {len(shown) - start}; record for longer"
        )
    return make_load(recording, tool, shown[start:], times[start:], name=f"{TOOL_NAME} {tool['index']}")


def replay_errors(
    surface: Surface, snapshots: list[Snapshot], displacements: Floats, force: Floats, run: Trajectory
) -> dict[str, float]:
    """Return the relative errors of recorded snapshots against the full model.

    - ``"displacement"``: root mean square of the error over that of the displacement, over surface and time
    - ``"largest"``: largest error of a vertex over the largest displacement
    - ``"force"``: mean error of the force on an active tool over the largest force
    - ``"peak"``: relative error of the largest force
    - ``"wall_seconds"``, ``"seconds"``: computing time of the full model, and duration of the path
    """
    recorded = np.array([snapshot.displacements(surface) for snapshot in snapshots])
    tool_forces = np.array([[tool.force for tool in snapshot.tools] for snapshot in snapshots])
    active = np.array([[tool.kind != "none" for tool in snapshot.tools] for snapshot in snapshots])
    size, peak = float(np.linalg.norm(displacements)), float(np.linalg.norm(force, axis=2).max())
    if not size > 0 or not peak > 0:
        raise InputError("tool must touch the full model for a comparison, got no contact; record a deeper press")
    largest = float(np.linalg.norm(displacements, axis=2).max())
    return {
        "displacement": float(np.linalg.norm(recorded - displacements)) / size,
        "largest": float(np.linalg.norm(recorded - displacements, axis=2).max()) / largest,
        "force": float(np.linalg.norm(tool_forces - force, axis=2)[active].mean()) / peak,
        "peak": float(np.linalg.norm(tool_forces, axis=2).max()) / peak - 1.0,
        "wall_seconds": float(run.wall_seconds),
        "seconds": float(run.times[-1]),
    }
