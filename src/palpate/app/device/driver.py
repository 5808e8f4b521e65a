"""Driver of a session: passes poses of devices to its tools, and readings of the engine to the adapter."""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Callable, Iterator
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from palpate.app.device.haply import serve_devices
from palpate.app.device.options import DeviceOptions, axes_rotation
from palpate.app.device.statistics import HandStatistics, add_statistics
from palpate.app.session.messages import NO_VIEWERS, VIEWERS_LEFT, validate_message
from palpate.core.extras import require
from palpate.core.faults import InputError
from palpate.core.processes import Child
from palpate.dynamics.contact.shapes import TOOLS

if TYPE_CHECKING:
    from palpate.app.session.session import Session

STOP_SECONDS, RESTART_SECONDS = 1.0, 1.0
FIRST_GAP = 0.01  # [m] of a tool from the body at first
FIRST_SPACING = 3.0  # radii between the first two tools
TOP_SHARE = 0.1  # of the height of the body, in which its top is
DEFAULT_KIND = "sphere"
MAX_DEVICE_TOOLS = 2  # tools of a session that devices may move

Say = Callable[[str], None]


class DeviceDriver:
    """Moves the tools of a session by haptic devices until it is closed; `say` shows a line to the person.

    `hands` holds what happened at the devices so far, by their names; it is complete after `close`.
    """

    def __init__(self, session: Session, options: DeviceOptions, say: Say) -> None:
        self.session, self._options, self._say = session, options, say
        self._tools = min(MAX_DEVICE_TOOLS, len(session.tools))
        self._closing = threading.Event()
        self._refused = ""
        self.hands: dict[str, HandStatistics] = {}
        self._child = self._start()
        self._thread = threading.Thread(target=self._run, name="palpate device", daemon=True)
        self._thread.start()

    @property
    def process(self) -> int:
        """Number of the process of the adapter."""
        return self._child.pid

    def _start(self) -> Child:
        return Child(serve_devices, {"options": asdict(self._options), "tools": self._tools})

    def _run(self) -> None:
        while True:
            for answer in self._child.answers():
                self._handle(answer)
            self._session().devices = {}
            if self._closing.is_set():
                return
            self._say(f"the process of the device ended (exit code {self._child.wait()}): it is started again")
            if self._closing.wait(RESTART_SECONDS):
                return
            self._child.stop()
            self._child = self._start()

    def _session(self) -> Session:
        """Return the session that is stepped now: another may have taken the place of the first."""
        while self.session.successor is not None:
            self.session = self.session.successor
        return self.session

    def _handle(self, answer: dict[str, Any]) -> None:
        session = self._session()
        if "say" in answer:
            self._say(f"haply: {answer['say']}")
        elif "hands" in answer:
            add_statistics(self.hands, answer["hands"])
        elif "devices" in answer:
            session.devices = {int(index): name for index, name in answer["devices"].items()}
            if session.devices and session.pause_reason in (NO_VIEWERS, VIEWERS_LEFT):
                with contextlib.suppress(InputError):  # a diverged state waits for a reset
                    session.resume()
        else:
            tools = min(self._tools, session.max_tools)  # another body may have fewer
            for index, epoch, pose in answer["poses"]:
                if index < tools:
                    self._move(session, index, epoch, pose, answer["number"])
            contacts = [session.tool_contact(index) for index in range(tools)]
            with contextlib.suppress(ValueError):  # the driver is being closed
                self._child.send({"period": session.engine.period, "tools": contacts})

    def _move(self, session: Session, index: int, epoch: int, pose: Any, number: int) -> None:
        """Move a tool, and put one down where there is none."""
        try:
            now = session.tool_contact(index)
            if not now["selected"]:
                session.handle(self._first_tool(session, index))
            elif pose is not None and epoch == now["epoch"]:
                session.follow_device(pose[0], pose[1], number, index)
            self._refused = ""
        except InputError as error:
            if str(error) != self._refused:
                self._refused = str(error)
                self._say(f"haply: {error}")

    def _first_tool(self, session: Session, index: int) -> dict[str, Any]:
        """Return the message that puts a ball down above the body, where up is that of the device.

        The second one is to the left of the first.
        """
        up = np.array(axes_rotation(self._options.device_axes))[:, 2]
        vertices = session.surface.rest.astype(float)
        heights, sideways = vertices @ up, vertices - np.outer(vertices @ up, up)
        top = np.flatnonzero(heights > heights.max() - TOP_SHARE * np.ptp(heights))
        off_middle = np.linalg.norm(sideways[top] - sideways.mean(axis=0), axis=1)
        highest = vertices[top[np.argmin(off_middle)]]
        radius = TOOLS[DEFAULT_KIND].usual["radius"]
        right = np.array(axes_rotation(self._options.device_axes))[:, 0]
        position = highest + (radius + FIRST_GAP) * up - index * FIRST_SPACING * radius * right
        return validate_message(
            {"type": "tool", "kind": DEFAULT_KIND, "radius": radius, "position": position.tolist(), "index": index}
        )

    def close(self) -> None:
        """Take the forces away, and end the adapter."""
        self._closing.set()
        self._child.send({"stop": True})
        self._thread.join(STOP_SECONDS)
        self._child.stop()
        self._thread.join()
        self._session().devices = {}


@contextlib.contextmanager
def driving(session: Session, options: DeviceOptions | None, say: Say) -> Iterator[DeviceDriver | None]:
    """Let devices move the tools of a session within a context; without options nothing does."""
    if options is None:
        yield None
        return
    require("websockets", "a haptic device")
    driver = DeviceDriver(session, options, say)
    try:
        yield driver
    finally:
        driver.close()
