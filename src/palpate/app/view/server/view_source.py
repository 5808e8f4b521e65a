"""The interface between the server and its source: a session or a replay."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Protocol

from palpate.app.recordings.snapshot import OverlayState, Snapshot
from palpate.app.session.messages import Message

if TYPE_CHECKING:
    from palpate.realtime.bodies.display_surface import DisplaySurface


class ViewSource(Protocol):
    """A session or a replay."""

    mode: str
    title: str
    surface: DisplaySurface

    @property
    def shown_surface(self) -> DisplaySurface:
        """The surface that is drawn, which a cut changes."""

    pause_reason: str | None
    devices: dict[int, str]  # haptic devices by the tool that they move: then the body moves without viewers, too

    @property
    def max_tools(self) -> int:
        """Number of tools in each snapshot."""

    @property
    def notifications(self) -> list[dict[str, Any]]:
        """Messages still to be sent to all viewers."""

    def snapshot(self) -> Snapshot:
        """Return the present snapshot."""

    def hello(self) -> dict[str, Any]:
        """Return the constant properties for `hello`."""

    def status(self) -> dict[str, Any]:
        """Return the properties that change rarely, for `status`."""

    def statistics(self) -> dict[str, Any]:
        """Return deadline statistics."""

    def handle(self, message: Message) -> None:
        """Execute a message of the driver."""

    def tick(self) -> None:
        """Do periodic work; called several times a second."""

    def pause(self, reason: str | None = None) -> None:
        """Pause."""

    def resume(self) -> None:
        """Resume."""

    def release(self) -> None:
        """Put all tools away."""

    def overlay(self, time: float) -> OverlayState | None:
        """Return the state of the full model at the time of a snapshot, or None."""


class Maker(Protocol):
    """What makes a session that replaces the current one; called in the server's thread."""

    def message(self) -> dict[str, Any] | None:
        """Return its message for viewers, such as ``refinement``; None where it makes nothing of the current body."""

    def handle(self, message: Message) -> None:
        """Execute a message of the driver."""

    def next_source(self) -> ViewSource | None:
        """Return the next source, once; None otherwise."""


NO_MAKERS: Mapping[str, Maker] = MappingProxyType({})
