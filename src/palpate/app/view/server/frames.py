"""Binary frames of the protocol; docs/reference/protocol.md describes every byte."""

from __future__ import annotations

import json
import struct
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from palpate.app.recordings.snapshot import (
    ENGINE_STATES,
    SNAPSHOT_FIELDS,
    TOOL_KINDS,
    OverlayState,
    Snapshot,
    ToolSnapshot,
)
from palpate.core.arrays import Singles
from palpate.realtime.record import layout
from palpate.surface.labels.anatomy import tissue_of

if TYPE_CHECKING:
    from palpate.realtime.bodies.display_surface import DisplaySurface
    from palpate.surface.labels.surroundings import Surroundings
    from palpate.surface.surface import Surface


GEOMETRY, STATE, OVERLAY, FORCE, PREVIEW, CUT_GEOMETRY, SURROUNDING_SHAPES, TOOL_STATES = 1, 2, 3, 4, 5, 6, 7, 8
STATE_NUMBERS = layout(
    (
        "time", "trust", "force", "moment", "position", "quaternion", "kinetic", "strain", "computing", "lateness",
        "steps", "state", "kind", "low", "high", "sequence",
    ), SNAPSHOT_FIELDS,
)  # fmt: skip
TOOL_NUMBERS = layout(("kind", "pinned", "force", "moment", "position", "quaternion", "sequence"), SNAPSHOT_FIELDS)
FORCE_NUMBERS = layout(
    ("time", "trust", "device_force", "moment", "stiffness", "position", "steps", "state", "sequence"), SNAPSHOT_FIELDS
)
FIELD_CODES = {"kind": TOOL_KINDS, "state": ENGINE_STATES}  # whose indices are sent
FRAME_HEADER = struct.Struct("<4I")
RANGE_PERCENTILE = 99.0  # of a scalar, at which its colour range ends; excludes peaks of single vertices at edges


def pack_frame(kind: int, sequence: int, vertices: int, body: bytes, triangles: int = 0) -> bytes:
    """Return a frame: a header of 16 bytes and the body."""
    return FRAME_HEADER.pack(kind, sequence % 2**32, vertices, triangles) + body


def geometry_frame(surface: DisplaySurface) -> bytes:
    """Return the geometry frame of a surface: positions at rest, triangles, and which vertices are fixed."""
    return _mesh_frame(GEOMETRY, surface.rest, surface.triangles, surface.fixed)


def cut_geometry_frame(surface: DisplaySurface) -> bytes:
    """Return the geometry frame of a surface that is cut, and where the cut opens it."""
    mesh, line = _mesh(surface.rest, surface.triangles, surface.fixed), surface.cut_line
    body = mesh + bytes(-len(mesh) % 4) + line.corners.astype("<u4").tobytes() + line.ends.astype("<f4").tobytes()
    return pack_frame(CUT_GEOMETRY, len(line.corners), len(surface.rest), body, len(surface.triangles))


def preview_frame(surface: Surface) -> bytes:
    """Return the preview frame of the surface of a file, shown until the body is ready; no vertex is fixed."""
    return _mesh_frame(PREVIEW, surface.vertices, surface.triangles, np.zeros(len(surface.vertices)))


def surroundings_frame(surroundings: Surroundings) -> bytes:
    """Return the frame of what is around a body: positions, triangles, their numbers by shape, names, kinds, edges."""
    surfaces = surroundings.shapes
    counts = [len(each.vertices) for each in surfaces]
    starts = np.cumsum([0, *counts])
    points = np.concatenate([np.zeros((0, 3)), *(each.vertices for each in surfaces)]).astype("<f4")
    shifted = [each.triangles + start for each, start in zip(surfaces, starts, strict=False)]
    triangles = np.concatenate([np.zeros((0, 3), dtype=int), *shifted])
    sizes = np.array([len(each.triangles) for each in surfaces], dtype="<u4")
    names = [each.name for each in surfaces]
    about = {"names": names, "kinds": [tissue_of(name).value for name in names], "edges": surroundings.edges.tolist()}
    body = points.tobytes() + triangles.astype("<u4").tobytes() + sizes.tobytes() + json.dumps(about).encode()
    return pack_frame(SURROUNDING_SHAPES, len(surfaces), len(points), body, len(triangles))


def _mesh_frame(kind: int, points: NDArray[Any], triangles: NDArray[Any], fixed: NDArray[Any]) -> bytes:
    return pack_frame(kind, 0, len(points), _mesh(points, triangles, fixed), len(triangles))


def _mesh(points: NDArray[Any], triangles: NDArray[Any], fixed: NDArray[Any]) -> bytes:
    return points.astype("<f4").tobytes() + triangles.astype("<u4").tobytes() + fixed.astype("u1").tobytes()


def state_body(surface: DisplaySurface, snapshot: Snapshot, scalar: str) -> bytes:
    """Return the body of a state frame, without the header, which has a sequence number of each viewer."""
    displacements = snapshot.displacements(surface)
    values, low, high = np.zeros(0, dtype="<f4"), 0.0, 0.0
    if scalar != "none":
        values = snapshot.scalar(surface, scalar, displacements).astype("<f4")
        low, high = colour_range(values)
    numbers = _numbers(STATE_NUMBERS, snapshot, snapshot.tools[0], low=low, high=high)
    return numbers + (surface.rest + displacements).astype("<f4").tobytes() + values.tobytes()


def _numbers(fields: np.dtype[Any], *sources: Snapshot | ToolSnapshot, **values: Any) -> bytes:
    """Return the float64 numbers of fields, of snapshots and of further values."""
    for source in sources:
        values |= vars(source)
    numbers = np.zeros((), dtype=fields)
    for name in fields.names or ():
        numbers[name] = FIELD_CODES[name].index(values[name]) if name in FIELD_CODES else values[name]
    return numbers.tobytes()


def colour_range(values: Singles) -> tuple[float, float]:
    """Return the colour range of a scalar: from 0, or symmetric if there are negative values."""
    high = float(np.percentile(np.abs(values), RANGE_PERCENTILE)) if len(values) else 0.0
    return (-high if len(values) and values.min() < 0 else 0.0), high


def overlay_body(full: OverlayState) -> bytes:
    """Return the body of an overlay frame: positions and force of the full model."""
    return full.positions.astype("<f4").tobytes() + full.force.astype("<f4").tobytes()


def tools_frame(tools: Sequence[ToolSnapshot], sequence: int) -> bytes:
    """Return the frame of all tools by index, with the sequence of a state frame."""
    return pack_frame(TOOL_STATES, sequence, len(tools), b"".join(_numbers(TOOL_NUMBERS, tool) for tool in tools))


def force_frame(snapshot: Snapshot, sequence: int, index: int = 0) -> bytes:
    """Return the force frame of a tool for the program of a haptic device."""
    return pack_frame(FORCE, sequence, index, _numbers(FORCE_NUMBERS, snapshot, snapshot.tools[index]))
