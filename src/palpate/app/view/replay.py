"""A recording as the page shows it: it plays, pauses, and is looked at wherever one likes."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.app.view.messages import Message
from palpate.app.view.recording import Recording
from palpate.app.view.snapshot import Snapshot, told_scalars, told_training
from palpate.faults import InputError
from palpate.reduction.realtime.display_surface import Surface

__all__ = ["Replay"]


class Replay:
    """Shows a recording.

    Parameters
    ----------
    recording : Recording
    """

    mode = "replay"

    def __init__(self, recording: Recording) -> None:
        self.recording, self.title = recording, recording.title
        self.surface = Surface(recording.model)
        self.duration = float(recording.times[-1])
        self.paused_because: str | None = None
        self.news: list[dict[str, Any]] = []
        self.speed = 1.0
        self._at, self._since, self._playing = 0.0, time.monotonic(), True

    @property
    def time(self) -> float:
        """Where the replay is [s]; at the end it begins anew."""
        if not self._playing:
            return self._at
        gone = self._at + self.speed * (time.monotonic() - self._since)
        return gone % self.duration if self.duration > 0 else 0.0

    @property
    def frame(self) -> int:
        """The newest moment at that time."""
        return max(0, int(np.searchsorted(self.recording.times, self.time, side="right")) - 1)

    def snapshot(self) -> Snapshot:
        """Return the moment that is shown, its time that of the recording."""
        frame = self.frame
        return replace(
            self.recording.moments[frame], state="running" if self._playing else "paused",
            time=float(self.recording.times[frame]),
        )  # fmt: skip

    def hello(self) -> dict[str, Any]:
        """Return what does not change."""
        return {
            "tools": [], "tool": self._tool(), "materials": [], "rate": None,
            "trained": told_training(self.recording.model),
            "scalars": told_scalars(self.surface), "duration": self.duration, "overlay": bool(self.recording.full),
            "errors": self.recording.full.get("errors"),
        }  # fmt: skip

    def _tool(self) -> dict[str, Any]:
        frame = self.frame
        told = [tool for tool in self.recording.tools if tool["frame"] <= frame][-1]
        moment = self.recording.moments[frame]
        return {
            **told, "held": moment.tool != "none", "position": moment.position.tolist(),
            "quaternion": moment.quaternion.tolist(),
        }  # fmt: skip

    def overlay(self, time: float) -> NDArray[np.float32] | None:
        """Return the full model's positions (n, 3) [m] at a time of the recording [s], where it was run."""
        full = self.recording.full
        if not full:
            return None
        return np.asarray(full["positions"][int(np.argmin(np.abs(full["times"] - time)))])

    def status(self) -> dict[str, Any]:
        """Return what changes seldom."""
        return {
            "state": "running" if self._playing else "paused", "tool": self._tool(), "speed": self.speed,
            "paused_because": self.paused_because, "materials": [],
        }  # fmt: skip

    def statistics(self) -> dict[str, Any]:
        """Return how long the recorded periods took."""
        took = 1e3 * np.array([moment.computing for moment in self.recording.moments])
        return {
            "median_ms": float(np.median(took)), "p99_ms": float(np.percentile(took, 99)), "misses": 0,
            "periods": len(took),
        }  # fmt: skip

    def handle(self, message: Message) -> None:
        """Do what a message says.

        Raises
        ------
        InputError
            It is for live sessions.
        """
        kind, action = message["type"], message.get("action")
        if kind == "speed":
            self._go_from(self.time)
            self.speed = message["factor"]
        elif kind == "replay" and action == "seek":
            self._go_from(min(message["time"], self.duration))
        elif action in ("play", "resume"):
            self.resume()
        elif action == "pause":
            self.pause()
        elif action == "reset":
            self._go_from(0.0)
        elif kind != "release":
            raise InputError(f"{kind}: this is a replay; nothing can be touched")

    def _go_from(self, at: float) -> None:
        self._at, self._since = at, time.monotonic()

    def tick(self) -> None:
        """Do nothing: a replay needs no looking after."""

    def pause(self, because: str | None = None) -> None:
        """Stand still."""
        self._go_from(self.time)
        self._playing, self.paused_because = False, because

    def resume(self) -> None:
        """Go on."""
        self._go_from(self.time)
        self._playing, self.paused_because = True, None

    def release(self) -> None:
        """Do nothing: there is no tool to take away."""
