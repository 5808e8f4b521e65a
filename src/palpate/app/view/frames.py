"""Binary frames: what is drawn, as the page reads it. See docs/protocol.md for every byte."""

from __future__ import annotations

import struct

import numpy as np
from numpy.typing import NDArray

from palpate.app.view.snapshot import STATES, TOOLS, Snapshot
from palpate.reduction.realtime.display_surface import Surface

__all__ = [
    "FORCE", "GEOMETRY", "OVERLAY", "STATE", "colour_range", "force_frame", "geometry_frame", "headed", "overlay",
    "state",
]  # fmt: skip

Singles = NDArray[np.float32]

GEOMETRY, STATE, OVERLAY, FORCE = 1, 2, 3, 4
HEAD = struct.Struct("<4I")
RANGE = 99.0  # percentile of a scalar that ends the scale of colours: single vertices at an edge do not set it


def headed(kind: int, sequence: int, vertices: int, body: bytes, triangles: int = 0) -> bytes:
    """Return a frame: 16 bytes of what it is, and its body."""
    return HEAD.pack(kind, sequence % 2**32, vertices, triangles) + body


def geometry_frame(surface: Surface) -> bytes:
    """Return the surface at rest and its triangles."""
    body = surface.rest.astype("<f4").tobytes() + surface.triangles.astype("<u4").tobytes()
    return headed(GEOMETRY, 0, len(surface.rest), body, len(surface.triangles))


def state(surface: Surface, snapshot: Snapshot, scalar: str) -> bytes:
    """Return the body of a state frame, to be `headed` for each viewer."""
    moved = snapshot.displacements(surface)
    values, low, high = np.zeros(0, dtype="<f4"), 0.0, 0.0
    if scalar != "none":
        values = snapshot.scalar(surface, scalar, moved).astype("<f4")
        low, high = colour_range(values)
    numbers = np.array(
        [
            snapshot.time, snapshot.trust, *snapshot.force, *snapshot.moment, *snapshot.position, *snapshot.quaternion,
            snapshot.kinetic, snapshot.strain, snapshot.computing, snapshot.lateness, snapshot.steps,
            STATES.index(snapshot.state), TOOLS.index(snapshot.tool), low, high, snapshot.sequence,
        ], dtype="<f8",
    )  # fmt: skip
    return numbers.tobytes() + (surface.rest + moved).astype("<f4").tobytes() + values.tobytes()


def colour_range(values: Singles) -> tuple[float, float]:
    """Return what a scale of colours reaches: of both signs alike, or from 0."""
    most = float(np.percentile(np.abs(values), RANGE)) if len(values) else 0.0
    return (-most if len(values) and values.min() < 0 else 0.0), most


def overlay(positions: Singles) -> bytes:
    """Return the body of a frame with the full model's positions (n, 3) [m]."""
    return positions.astype("<f4").tobytes()


def force_frame(snapshot: Snapshot, sequence: int) -> bytes:
    """Return what a program that holds the tool needs of a moment: 23 numbers."""
    numbers = np.array(
        [
            snapshot.time, snapshot.trust, *snapshot.hand, *snapshot.moment, *snapshot.stiffness.ravel(),
            *snapshot.position, snapshot.steps, STATES.index(snapshot.state), snapshot.sequence,
        ], dtype="<f8",
    )  # fmt: skip
    return headed(FORCE, sequence, 0, numbers.tobytes())
