"""Choice of the labels of a body on the page, before it is prepared."""

from __future__ import annotations

import asyncio
import queue
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

from palpate.app.session.messages import parse_message
from palpate.app.view.server.connection import close_connection
from palpate.app.view.server.viewer import INVALID_MESSAGES, Viewer
from palpate.core.faults import InputError
from palpate.core.files import shortened

if TYPE_CHECKING:
    from palpate.surface.labels.listing import LabelRow

POLL_INTERVAL = 0.5  # [s]: a wait without an end cannot be interrupted everywhere


class Chosen(NamedTuple):
    """Labels of a body, and those that lie in them and do not join."""

    parts: tuple[str, ...]
    without: tuple[str, ...] = ()


class LabelChoice:
    """Labels of a map, of which a viewer chooses one or several; `rows` are listed in their order.

    The server's thread calls `choose`, the main thread `wait`. The event `made` is set once a choice has made a body.
    """

    def __init__(self, title: str, rows: Sequence[LabelRow]) -> None:
        self.title, self.rows = title, tuple(rows)
        self.made = asyncio.Event()
        self._chosen: queue.Queue[Chosen] = queue.Queue(maxsize=1)

    def message(self) -> dict[str, Any]:
        """Return the message ``labels`` of the protocol."""
        from palpate.surface.labels.listing import inner_text

        labels = [
            {
                "part": row.part, "number": row.number, "name": row.name, "volume": row.volume, "pieces": row.pieces,
                "at_edge": row.at_edge,
                "inner": [
                    {"part": each.part, "name": each.segment.name, "joins": each.joins, "why": inner_text(each)}
                    for each in row.inner
                ],
            } for row in self.rows
        ]  # fmt: skip
        return {"type": "labels", "title": self.title, "labels": labels}

    def choose(self, parts: Sequence[str], without: Sequence[str] = ()) -> None:
        """Take a choice of the labels, or of the largest piece of one, and of those in them that are left out."""
        known = {row.part for row in self.rows} | {f"{row.part}#1" for row in self.rows}
        for part in parts:
            if part not in known:
                raise InputError(f"choose: parts must be of the list, got {shortened(repr(part))}; choose others")
        if not parts:
            raise InputError("choose: parts must be one or more, got none; choose a label")
        joining = {each.part for row in self.rows if row.part in parts for each in row.inner if each.joins}
        for part in without:
            if part not in joining:
                raise InputError(
                    f"choose: without must be of what joins the parts, got {shortened(repr(part))}; leave it out"
                )
        try:
            self._chosen.put_nowait(Chosen(tuple(dict.fromkeys(parts)), tuple(dict.fromkeys(without))))
        except queue.Full:
            raise InputError("choose must wait for the choice before, got another one; try again later") from None

    def wait(self) -> Chosen:
        """Return the next choice, once there is one."""
        while True:
            try:
                return self._chosen.get(timeout=POLL_INTERVAL)
            except queue.Empty:
                continue


async def let_choose(viewer: Viewer, choice: LabelChoice) -> None:
    """Send the labels, and process messages of a viewer until a choice is made, by it or another one."""
    if viewer.follows_preparation:
        await viewer.send_message(choice.message())
        viewer.ready = True
    made = asyncio.ensure_future(choice.made.wait())
    try:
        while not choice.made.is_set():
            received = asyncio.ensure_future(viewer.socket.recv())
            try:
                await asyncio.wait([received, made], return_when=asyncio.FIRST_COMPLETED)
                if received.done() and not await _take(viewer, choice, received.result()):
                    return
            finally:
                received.cancel()
                await asyncio.wait([received])
    finally:
        made.cancel()
        viewer.ready = False


async def _take(viewer: Viewer, choice: LabelChoice, text: str | bytes) -> bool:
    """Process a message of a viewer; return False if it was the last of too many invalid ones."""
    try:
        message = parse_message(text)
        if message["type"] != "choose":
            raise InputError(f"type must be 'choose' until labels are chosen, got {message['type']!r}; choose labels")
        choice.choose(message["parts"], message["without"])
    except InputError as error:
        if viewer.count_invalid_message():
            await close_connection(viewer.socket, INVALID_MESSAGES, "too many invalid messages")
            return False
        await viewer.send_message({"type": "error", "reason": str(error)})
    else:
        viewer.invalid_messages = 0
    return True
