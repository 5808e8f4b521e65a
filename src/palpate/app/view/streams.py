"""What is shown, and the frames of it that viewers are sent."""

from __future__ import annotations

import asyncio
import contextlib
import time
from typing import Any, NamedTuple, Protocol

from palpate.app.view import frames
from palpate.app.view.messages import Message
from palpate.app.view.snapshot import Snapshot
from palpate.app.view.viewer import Viewer
from palpate.reduction.realtime.display_surface import Surface

__all__ = ["Show", "Streams"]

FASTEST = 1 / 60  # [s] between two state frames of a viewer
SHORT = 0.01  # [s]
IDLE = 0.01  # [s] between two looks whether anything has changed
STILL = 0.1  # [s] between force frames of a body that stands still
CATCHING_UP = 0.005  # [s] of force frames that are sent late rather than left out


class Show(Protocol):
    """What is shown: a session, or a replay."""

    mode: str
    title: str
    surface: Surface
    paused_because: str | None
    news: list[dict[str, Any]]  # what all are still to be told

    def snapshot(self) -> Snapshot:
        """Return what is to be seen now."""

    def hello(self) -> dict[str, Any]:
        """Return what does not change."""

    def status(self) -> dict[str, Any]:
        """Return what changes seldom."""

    def statistics(self) -> dict[str, Any]:
        """Return how the engine keeps its deadlines."""

    def handle(self, message: Message) -> None:
        """Do what a message of the driver says."""

    def tick(self) -> None:
        """Be called several times a second."""

    def pause(self, because: str | None = None) -> None:
        """Let time stand still."""

    def resume(self) -> None:
        """Let time go on."""

    def release(self) -> None:
        """Take the tool away."""

    def overlay(self, time: float) -> Any:
        """Return positions (n, 3) of the full model at a time that a snapshot tells, or None."""


class _Made(NamedTuple):
    """A frame that was made: what tells it from others, when it was made, the snapshot's time, and its body."""

    key: Any
    at: float
    time: float
    body: bytes


class Streams:
    """Sends frames of a show, each to a viewer that wants it.

    Parameters
    ----------
    show : Session or Replay
    """

    def __init__(self, show: Show) -> None:
        self.show = show
        self._made: dict[str, _Made] = {}

    async def states(self, viewer: Viewer) -> None:
        """Send the newest state whenever there is one and the viewer has drawn enough of those before."""
        shown: Any = None
        while True:
            await viewer.room.wait()
            began = time.monotonic()
            made = self._frame(viewer.scalar)
            if made.key == shown:
                await asyncio.sleep(IDLE)
                continue
            shown, sequence, vertices = made.key, viewer.next_frame(), len(self.show.surface.rest)
            positions = self.show.overlay(made.time)
            if positions is not None:
                await viewer.send(frames.headed(frames.OVERLAY, sequence, vertices, frames.overlay(positions)))
            await viewer.send(frames.headed(frames.STATE, sequence, vertices, made.body))
            await asyncio.sleep(max(0.0, began + FASTEST - time.monotonic()))

    def _frame(self, scalar: str) -> _Made:
        """Return a frame of the newest state; made once for all who want it within a moment."""
        snapshot = self.show.snapshot()
        key = (scalar, snapshot.steps, snapshot.time, snapshot.state, snapshot.tool, snapshot.sequence,
               *snapshot.position)  # fmt: skip
        made = self._made.get(scalar)
        if made is None or (made.key != key and time.monotonic() - made.at > 0.5 * FASTEST):
            body = frames.state(self.show.surface, snapshot, scalar)
            made = self._made[scalar] = _Made(key, time.monotonic(), snapshot.time, body)
        return made

    async def forces(self, viewer: Viewer) -> None:
        """Send force frames at the rate that the viewer asked for, of a body that stands still only now and then."""
        sequence, due, steps, sent = 0, 0.0, -1, 0.0
        while True:
            if viewer.paced.is_set() or viewer.rate == 0.0:
                await viewer.paced.wait()
                viewer.paced.clear()
                due = time.monotonic()
                continue
            if await _changed(viewer.paced, due - time.monotonic()):
                continue
            due = max(due + 1 / viewer.rate, time.monotonic() - CATCHING_UP)
            snapshot = self.show.snapshot()
            if snapshot.steps == steps and time.monotonic() - sent < STILL:
                continue
            steps, sent, sequence = snapshot.steps, time.monotonic(), sequence + 1
            await viewer.send(frames.force_frame(snapshot, sequence))


async def _changed(event: asyncio.Event, seconds: float) -> bool:
    """Wait for an event at most so long, and return whether it came.

    Short times are kept to a fraction of a millisecond: asyncio's own are rounded up to whole ones.
    """
    if 0.0 < seconds < SHORT:
        await asyncio.to_thread(time.sleep, seconds)
    elif seconds > 0.0:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                await event.wait()
    else:
        await asyncio.sleep(0)
    return event.is_set()
