"""Replay of a recording for the page: play, pause, and seek."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np

from palpate.app.models.force_error import nodes_error
from palpate.app.recordings.cut_surfaces import CutSurfaces
from palpate.app.recordings.recording import Recording
from palpate.app.recordings.snapshot import OverlayState, Snapshot, scalar_descriptions, training_errors
from palpate.app.session.bodies import cut_statistics
from palpate.app.session.messages import Message, describe_tools
from palpate.app.session.tool_control import drawn_outline
from palpate.core.faults import InputError
from palpate.dynamics.nodal.model import NodalModel
from palpate.realtime.bodies.display_surface import DisplaySurface


class Replay:
    """Plays a recording in a loop, in place of a session."""

    mode = "replay"

    def __init__(self, recording: Recording) -> None:
        self.recording, self.title = recording, recording.title
        self._surfaces = CutSurfaces(recording)
        self.surface = self._surfaces.whole
        self.duration = float(recording.times[-1])
        self.pause_reason: str | None = None
        self.notifications: list[dict[str, Any]] = []
        self.devices: dict[int, str] = {}
        self.speed = 1.0
        self._at, self._since, self._playing = 0.0, time.monotonic(), True

    @property
    def time(self) -> float:
        """Playback time [s]; starts again at the end of the recording."""
        if not self._playing:
            return self._at
        elapsed = self._at + self.speed * (time.monotonic() - self._since)
        return elapsed % self.duration if self.duration > 0 else 0.0

    @property
    def frame(self) -> int:
        """Index of the newest snapshot at the playback time."""
        return max(0, int(np.searchsorted(self.recording.times, self.time, side="right")) - 1)

    @property
    def shown_surface(self) -> DisplaySurface:
        """The surface that is drawn: of the body as it was cut."""
        return self._surfaces.at(self.frame)

    def snapshot(self) -> Snapshot:
        """Return the present snapshot, with the time of the recording."""
        frame = self.frame
        return replace(
            self.recording.snapshots[frame], state="running" if self._playing else "paused",
            time=float(self.recording.times[frame]),
        )  # fmt: skip

    @property
    def max_tools(self) -> int:
        """Number of tools in each snapshot."""
        return len(self.recording.snapshots[0].tools)

    def hello(self) -> dict[str, Any]:
        """Return the constant properties for `hello`."""
        tools = self._describe_tools()
        return {
            "tools": [], **describe_tools([]), "tool": tools[0], "max_tools": len(tools), "all_tools": tools,
            "materials": [], "rate": None,
            "training_errors": training_errors(self.recording.model),
            "nodes_error": nodes_error(self.recording.model),
            "scalars": scalar_descriptions(self.surface), "duration": self.duration,
            "overlay": bool(self.recording.full), "full": isinstance(self.recording.model, NodalModel),
            "errors": self.recording.full.get("errors"),
        }  # fmt: skip

    def _describe_tools(self) -> list[dict[str, Any]]:
        """Return the descriptions of all tools by index."""
        frame, described = self.frame, []
        for index, shown in enumerate(self.recording.snapshots[frame].tools):
            tool = {**self.recording.tool_at(frame, index), "active": shown.kind != "none"}
            place = {"position": shown.position.tolist(), "quaternion": shown.quaternion.tolist()}
            described.append({**tool, "outline": drawn_outline(tool), "pinned": shown.pinned, **place})
        return described

    def overlay(self, time: float) -> OverlayState | None:
        """Return the full model's state at a time of the recording [s], with the first tool; None without a run."""
        full = self.recording.full
        if not full:
            return None
        nearest = int(np.argmin(np.abs(full["times"] - time)))
        return OverlayState(full["positions"][nearest], full["force"][nearest, 0])

    def status(self) -> dict[str, Any]:
        """Return the properties that change rarely, for `status`."""
        tools = self._describe_tools()
        return {
            "state": "running" if self._playing else "paused", "tool": tools[0], "all_tools": tools,
            "speed": self.speed, "pause_reason": self.pause_reason, "materials": [],
        }  # fmt: skip

    def statistics(self) -> dict[str, Any]:
        """Return the computing times of the recorded periods."""
        computing = 1e3 * np.array([snapshot.computing for snapshot in self.recording.snapshots])
        return {
            "median_ms": float(np.median(computing)), "p99_ms": float(np.percentile(computing, 99)), "misses": 0,
            "periods": len(computing), **cut_statistics(self.shown_surface),
        }  # fmt: skip

    def handle(self, message: Message) -> None:
        """Execute a message of the driver."""
        kind, action = message["type"], message.get("action")
        if kind == "speed":
            self._seek(self.time)
            self.speed = message["factor"]
        elif kind == "replay" and action == "seek":
            self._seek(min(message["time"], self.duration))
        elif action in ("play", "resume"):
            self.resume()
        elif action == "pause":
            self.pause()
        elif action == "reset":
            self._seek(0.0)
        elif kind != "release":
            raise InputError(f"type must be a message of replays, got {kind!r}; a replay takes no tool")

    def _seek(self, at: float) -> None:
        self._at, self._since = at, time.monotonic()

    def tick(self) -> None:
        """Do nothing: a replay needs no periodic work."""

    def pause(self, reason: str | None = None) -> None:
        """Pause playback."""
        self._seek(self.time)
        self._playing, self.pause_reason = False, reason

    def resume(self) -> None:
        """Resume playback."""
        self._seek(self.time)
        self._playing, self.pause_reason = True, None

    def release(self) -> None:
        """Do nothing: a replay has no tools to release."""
