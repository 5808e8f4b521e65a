"""Tool paths of recordings, from one release or lift of a tool to the next, as loads of a full model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from palpate.app.recordings.recording import Recording
from palpate.app.recordings.snapshot import Snapshot, ToolSnapshot
from palpate.core.arrays import Floats
from palpate.dynamics.contact.shapes import TOOLS, make_tool
from palpate.dynamics.contact.tools import Contact, Grasp
from palpate.dynamics.loads.prepared import Load
from palpate.dynamics.loads.prescribed_motion import PrescribedMotion
from palpate.reduction.hyper.model import ReducedModel

MIN_SNAPSHOTS = 3
MAX_PATH = 10.0  # [s] of a path; the rest is left out
TOOL_NAME = "tool"
APPROACH_SECONDS = 0.1  # [s] from rest to the first pose of a held group


class RecordedPath(NamedTuple):
    """A tool's path, from rest, as a load."""

    load: Load
    duration: float  # [s]
    trust: float  # largest error indicator of the snapshots


def recorded_paths(recording: Recording) -> list[RecordedPath]:
    """Return the tool paths of a recording: a touch of a ball or capsule, a grasp, or a motion of a held group.

    Paths begin with the body at rest, whatever its state was, and have at most 10 s. Changed moduli do not count.
    Tools that act at the same time have a path each.
    """
    return [path for index in range(len(recording.snapshots[0].tools)) for path in _paths_of_tool(recording, index)]


def _paths_of_tool(recording: Recording, index: int) -> list[RecordedPath]:
    kinds = np.array([snapshot.tools[index].kind for snapshot in recording.snapshots])
    times = np.array([snapshot.time for snapshot in recording.snapshots])
    starts = [tool["start"] for tool in recording.tools if tool["index"] == index]
    of_tool = np.searchsorted(starts, np.arange(len(kinds)), side="right") - 1
    touching = np.array([_touches(snapshot, index) for snapshot in recording.snapshots])
    touching[:-1] |= touching[1:].copy()  # a path begins before the touch
    acts = (kinds != "none") & (touching | np.isin(kinds, ("grasp", "group")))
    breaks = (np.diff(of_tool) > 0) | (np.diff(times) < 0) | (acts[1:] != acts[:-1]) | (kinds[1:] != kinds[:-1])
    parts = np.split(np.arange(len(kinds)), np.flatnonzero(breaks) + 1)
    paths = [_path(recording, recording.tool_at(part[0], index), part) for part in parts if acts[part[0]]]
    return [path for path in paths if path is not None]


def _touches(snapshot: Snapshot, index: int) -> bool:
    return bool(np.any(snapshot.contact_forces[snapshot.contact_tools == index]))


def _path(recording: Recording, tool: dict[str, Any], part: NDArray[np.intp]) -> RecordedPath | None:
    """Return the path of consecutive snapshots; none if they are too few, or their tool is another one."""
    times = np.array([recording.snapshots[k].time for k in part]) - recording.snapshots[part[0]].time
    kept = np.diff(times, prepend=-1.0) > 0  # one snapshot of a pause
    kept &= times <= MAX_PATH
    snapshots, times = [recording.snapshots[k] for k in part[kept]], times[kept]
    if len(snapshots) < MIN_SNAPSHOTS or snapshots[0].tools[tool["index"]].kind != tool["kind"]:
        return None
    approach = APPROACH_SECONDS if tool["kind"] == "group" else 0.0
    load = make_load(recording, tool, [snapshot.tools[tool["index"]] for snapshot in snapshots], times, approach)
    return RecordedPath(load, float(times[-1]) + approach, max(snapshot.trust for snapshot in snapshots))


def make_load(
    recording: Recording,
    tool: dict[str, Any],
    snapshots: Sequence[ToolSnapshot],
    times: Floats,
    approach: float = 0.0,
    name: str = TOOL_NAME,
) -> Load:
    """Return the load of a tool with the poses of snapshots at times (f,) [s] from 0.

    `tool` is its description. In the duration `approach` [s] a held group moves from rest to the first pose.
    """
    positions = np.array([snapshot.position for snapshot in snapshots])
    quaternions = np.array([snapshot.quaternion for snapshot in snapshots])
    if tool["kind"] in TOOLS and tool["kind"] != "grasp":
        shape = make_tool(tool["kind"], tool)
        return Contact(shape, (times, positions, quaternions), friction=tool["friction"], name=name)
    rotations = Rotation.from_quat(quaternions, scalar_first=True)
    if tool["kind"] == "grasp":
        relative = (rotations * rotations[0].inv()).as_quat(scalar_first=True)
        return Grasp(positions[0], tool["radius"], (times, positions, relative), name=name)
    assert isinstance(recording.model, ReducedModel)  # full bodies have no held groups
    group = recording.model.data.prescribed[0]
    centre = recording.model.cloud.points[recording.model.cloud.group(group)].mean(axis=0)
    centre = np.pad(centre, (0, 3 - len(centre)))
    if approach:
        times = np.concatenate([[0.0], times + approach])
        positions = np.concatenate([[centre], positions])
        rotations = Rotation.concatenate([Rotation.identity(), rotations])
    rotation_at = Slerp(times, rotations)

    def displacement(points: Floats, time: float) -> Floats:
        at = float(np.clip(time, times[0], times[-1]))
        arms = np.pad(points, ((0, 0), (0, 3 - points.shape[1]))) - centre
        place = np.array([np.interp(at, times, column) for column in positions.T])
        return np.asarray(place - centre + rotation_at(at).apply(arms) - arms)

    return PrescribedMotion(group, displacement)
