"""A recorded path of a tool on the full model, and how far the reduced one was from it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from palpate.app.view.recording import LONGEST, Recording
from palpate.app.view.snapshot import Snapshot
from palpate.dynamics.contact.tools import Capsule, Contact, Grasp, Sphere
from palpate.dynamics.loads.prepared import Load
from palpate.dynamics.loads.prescribed_motion import PrescribedMotion
from palpate.dynamics.run.model import Model
from palpate.dynamics.run.rollout import rollout
from palpate.dynamics.run.trajectory import Trajectory
from palpate.faults import InputError
from palpate.files import shortened
from palpate.reduction.realtime.display_surface import Surface
from palpate.scenes.training import TRAINING, search_current_folder, training_scene, typed

__all__ = ["compared", "full_model", "path_of", "run_full"]

Floats = NDArray[np.float64]

AT_REST = 0.02  # of the spacing: how far from rest a body may be that a run begins with
SAME = 1e-6  # of the spacing: how far points of one body may be from each other
TOOL = "tool"


def full_model(recording: Recording, named: str | None = None) -> Model:
    """Return the full model of the scene that the recorded one was trained on.

    Nothing that a file names is imported: without `named` the scene must be one of palpate's own.

    Parameters
    ----------
    recording : Recording
    named : str, optional
        Scene that the person names, ``"module:function"``; it must be the one that the recording names.

    Raises
    ------
    InputError
        The recording does not name a scene, or another one than `named`, or one that is not palpate's; or the scene's
        body is not the recorded one.
    """
    about = recording.model.report.get("scene")
    if not about:
        raise InputError(
            "the recorded model does not name the scene it was trained on, so that there is no full model to run: "
            "models of `palpate train SCENE` name it"
        )
    scene = about["name"]
    if named is not None and named != scene:
        raise InputError(f"scene must be {scene!r}, which the recorded model was trained on, got {named!r}")
    if named is None and scene not in TRAINING:
        raise InputError(
            f"the recording names the scene {shortened(scene)!r}, which is not one of palpate's "
            f"({', '.join(TRAINING)}); nothing that a file names is imported: add --scene MODULE:FUNCTION if you trust "
            "that module"
        )
    if named is not None:
        search_current_folder()
    own, cloud = typed(scene, about["parameters"]), recording.model.cloud
    if "spacing" in own and not np.isclose(own["spacing"], cloud.spacing, rtol=1e-6):
        raise InputError(
            f"the scene's spacing is {own['spacing']:g} m, and that of the recorded body {cloud.spacing:g} m"
        )
    model = training_scene(scene, about["parameters"]).model
    points = model.cloud.points
    if points.shape != cloud.points.shape or not np.allclose(points, cloud.points, atol=SAME * cloud.spacing):
        raise InputError(f"the body of scene {scene!r} is not the recorded one: its points differ")
    return model


def path_of(recording: Recording) -> tuple[slice, dict[str, Any]]:
    """Return the moments in which a tool was held, from rest, and what tool it was.

    Raises
    ------
    InputError
        No tool was held, or several one after the other; the body did not begin at rest; time went back (a reset); or
        the moduli were changed.
    """
    held = np.array([moment.tool != "none" for moment in recording.moments])
    if not held.any():
        raise InputError("no tool was held in this recording: there is nothing to run")
    first, last = int(np.argmax(held)), len(held) - int(np.argmax(held[::-1]))
    span = slice(first, last)
    ends = [tool["frame"] for tool in recording.tools[1:]] + [len(held)]
    used = [tool for tool, end in zip(recording.tools, ends, strict=True) if tool["frame"] < last and end > first]
    if not held[span].all() or len(used) > 1:
        raise InputError("the tool was released or changed in between: record one press or grasp at a time for --full")
    moments, kind = recording.moments[span], used[0]["kind"]
    if any(moment.tool != kind for moment in moments):
        raise InputError(f"the recording names a {kind} as the tool, and moments of another one: record it again")
    if kind == "group" and len(recording.model.data.prescribed) != 1:
        raise InputError("the recording holds a group, and its model has not exactly one that tools hold")
    if moments[-1].time - moments[0].time > 2 * LONGEST:
        raise InputError(f"the body moves for more than {2 * LONGEST:g} s in this recording, which no session does")
    if any(moment.modulus_ratio != 1.0 for moment in moments):
        raise InputError("the moduli were changed in this recording: the scene's full model has its own")
    if np.any(np.diff([moment.time for moment in moments]) < 0):
        raise InputError("the body was reset in this recording: record without for --full")
    surface = Surface(recording.model)
    off = float(np.abs(moments[0].displacements(surface)).max())
    if off > AT_REST * recording.model.cloud.spacing:
        raise InputError(f"the body was {1e3 * off:.2g} mm off its rest when the tool came: let it come to rest first")
    return span, used[0]


def run_full(recording: Recording, model: Model | None = None) -> dict[str, Any]:
    """Run the recorded path on the full model.

    Parameters
    ----------
    recording : Recording
    model : Model, optional
        By default that of the scene.

    Returns
    -------
    dict
        ``"times"`` (f,) [s] of the recording, ``"positions"`` (f, n, 3) [m] of the surface, ``"force"`` (f, 3) [N] on
        the tool, and ``"errors"``, see `compared`.

    Raises
    ------
    InputError
        The recording cannot be run.
    DivergenceError
        The full model left the range of sensible states.
    """
    span, tool = path_of(recording)
    model = model or full_model(recording)
    moments = recording.moments[span]
    own = np.array([moment.time for moment in moments])
    keep = np.concatenate([[True], np.diff(own) > 0])  # a paused body has one moment
    times, wall = own[keep] - own[0], recording.times[span][keep]
    moments = [moment for moment, kept in zip(moments, keep, strict=True) if kept]
    if len(times) < 3:
        raise InputError("the tool was held for less than three moments: there is nothing to run")
    load = _load(recording, tool, moments, times)
    every = float(times[-1] / (len(times) - 1))
    run = rollout(model, [load], duration=float(times[-1]), every=every)
    surface = Surface(recording.model)
    at = np.array([int(np.argmin(np.abs(run.times - t))) for t in times])
    moved = run.displacements[at][:, surface.nodes]
    if isinstance(load, Contact):
        moved = np.array([surface.met(each) for each in moved])
    force = -run.reactions[load.group if isinstance(load, PrescribedMotion) else TOOL][at]
    return {
        "times": wall, "positions": (surface.rest + moved).astype(np.float32), "force": force,
        "errors": compared(surface, moments, moved, force, run),
    }  # fmt: skip


def _load(recording: Recording, tool: dict[str, Any], moments: list[Snapshot], times: Floats) -> Load:
    places = np.array([moment.position for moment in moments])
    turns = np.array([moment.quaternion for moment in moments])
    if tool["kind"] in ("sphere", "capsule"):
        radius = tool["radius"]
        shape = Sphere(radius) if tool["kind"] == "sphere" else Capsule(radius, tool["length"])
        return Contact(shape, (times, places, turns), friction=tool["friction"], name=TOOL)
    turning = Rotation.from_quat(turns, scalar_first=True)
    since = turning * turning[0].inv()
    if tool["kind"] == "grasp":
        return Grasp(places[0], tool["radius"], (times, places, since.as_quat(scalar_first=True)), name=TOOL)
    group = recording.model.data.prescribed[0]
    centre = recording.model.cloud.points[recording.model.cloud.group(group)].mean(axis=0)
    centre, turned = np.pad(centre, (0, 3 - len(centre))), Slerp(times, turning)

    def displacement(points: Floats, time: float) -> Floats:
        at = float(np.clip(time, times[0], times[-1]))
        arms = np.pad(points, ((0, 0), (0, 3 - points.shape[1]))) - centre
        place = np.array([np.interp(at, times, column) for column in places.T])
        return np.asarray(place - centre + turned(at).apply(arms) - arms)

    return PrescribedMotion(group, displacement)


def compared(
    surface: Surface, moments: list[Snapshot], moved: Floats, force: Floats, run: Trajectory
) -> dict[str, float]:
    """Return how far recorded moments are from the full model's.

    Returns
    -------
    dict
        ``"displacement"``: root mean square over the surface and time, over the full model's; ``"largest"``: largest
        distance of a vertex over the largest displacement; ``"force"``: mean distance of the tool's force over the
        largest; ``"peak"``: largest force over the full model's, less 1; ``"wall_seconds"`` of the full run, and
        ``"seconds"`` of the path.
    """
    own = np.array([moment.displacements(surface) for moment in moments])
    felt = np.array([moment.force for moment in moments])
    size, peak = float(np.linalg.norm(moved)), float(np.linalg.norm(force, axis=1).max())
    if not size > 0 or not peak > 0:
        raise InputError("the tool never touched the full model: there is nothing to compare")
    farthest = float(np.linalg.norm(moved, axis=2).max())
    return {
        "displacement": float(np.linalg.norm(own - moved)) / size,
        "largest": float(np.linalg.norm(own - moved, axis=2).max()) / farthest,
        "force": float(np.linalg.norm(felt - force, axis=1).mean()) / peak,
        "peak": float(np.linalg.norm(felt, axis=1).max()) / peak - 1.0,
        "wall_seconds": float(run.wall_seconds),
        "seconds": float(run.times[-1]),
    }
