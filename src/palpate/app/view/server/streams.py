"""Streams of state and force frames to viewers."""

from __future__ import annotations

import asyncio
import contextlib
import time
from typing import Any, NamedTuple

from palpate.app.recordings.snapshot import ToolSnapshot
from palpate.app.view.server import frames
from palpate.app.view.server.view_source import ViewSource
from palpate.app.view.server.viewer import Viewer

STATE_INTERVAL = 1 / 60  # [s] between state frames of a viewer
PRECISE_WAIT = 0.01  # [s]: shorter waits use the system's sleep
POLL_INTERVAL = 0.01  # [s] between checks for a new state
UNCHANGED_INTERVAL = 0.1  # [s] between force frames of the same period
MAX_BACKLOG = 0.005  # [s] of force frames that are sent late; older ones are dropped


class _CachedState(NamedTuple):
    """Body of a state frame, its key, its time of creation [s], time [s] and tools of its snapshot, and its surface."""

    key: Any
    created: float
    time: float
    body: bytes
    surface: Any
    tools: tuple[ToolSnapshot, ...]


class Streams:
    """Sends frames of a view source to viewers."""

    def __init__(self, source: ViewSource) -> None:
        self.source = source
        self._states: dict[str, _CachedState] = {}

    async def send_states(self, viewer: Viewer) -> None:
        """Send the newest state whenever it has changed and the viewer has acknowledged earlier frames."""
        sent_key, shown = None, self.source.surface
        while True:
            await viewer.may_send_frame.wait()
            start = time.monotonic()
            state = self._state(viewer.scalar)
            if state.key == sent_key:
                await asyncio.sleep(POLL_INTERVAL)
                continue
            if state.surface is not shown:
                shown = state.surface
                await viewer.send(frames.cut_geometry_frame(shown))
            sent_key, sequence, vertices = state.key, viewer.next_frame(), len(shown.rest)
            full = self.source.overlay(state.time)
            if full is not None:
                await viewer.send(frames.pack_frame(frames.OVERLAY, sequence, vertices, frames.overlay_body(full)))
            if viewer.version > 2:
                await viewer.send(frames.tools_frame(state.tools, sequence))
            await viewer.send(frames.pack_frame(frames.STATE, sequence, vertices, state.body))
            await asyncio.sleep(max(0.0, start + STATE_INTERVAL - time.monotonic()))

    def _state(self, scalar: str) -> _CachedState:
        """Return the newest state with a scalar, shared between viewers for half a state interval."""
        snapshot = self.source.snapshot()
        surface = self.source.shown_surface
        tools = [(tool.kind, tool.pinned, tool.sequence, *tool.position) for tool in snapshot.tools]
        key = (scalar, id(surface), snapshot.steps, snapshot.time, snapshot.state, *tools)
        cached = self._states.get(scalar)
        if cached is None or (cached.key != key and time.monotonic() - cached.created > 0.5 * STATE_INTERVAL):
            body = frames.state_body(surface, snapshot, scalar)
            cached = self._states[scalar] = _CachedState(
                key, time.monotonic(), snapshot.time, body, surface, snapshot.tools
            )
        return cached

    async def send_forces(self, viewer: Viewer) -> None:
        """Send force frames at the viewer's rate, and at a low rate while the period does not change."""
        sequence, due, steps, sent = 0, 0.0, -1, 0.0
        while True:
            if viewer.force_rate_changed.is_set() or viewer.force_rate == 0.0:
                await viewer.force_rate_changed.wait()
                viewer.force_rate_changed.clear()
                due = time.monotonic()
                continue
            if await _wait_for(viewer.force_rate_changed, due - time.monotonic()):
                continue
            due = max(due + 1 / viewer.force_rate, time.monotonic() - MAX_BACKLOG)
            snapshot = self.source.snapshot()
            if snapshot.steps == steps and time.monotonic() - sent < UNCHANGED_INTERVAL:
                continue
            steps, sent, sequence = snapshot.steps, time.monotonic(), sequence + 1
            for index in viewer.force_tools:
                if index < len(snapshot.tools):
                    await viewer.send(frames.force_frame(snapshot, sequence, index))


async def _wait_for(event: asyncio.Event, seconds: float) -> bool:
    """Wait for an event for at most a duration [s]; return whether it occurred.

    Short waits are precise to a fraction of a millisecond; asyncio rounds its timeouts up to whole milliseconds.
    """
    if 0.0 < seconds < PRECISE_WAIT:
        await asyncio.to_thread(time.sleep, seconds)
    elif seconds > 0.0:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(seconds):
                await event.wait()
    else:
        await asyncio.sleep(0)
    return event.is_set()
