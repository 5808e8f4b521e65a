"""Two bodies in one session under the same tools: a reduced model and its full body, or solids of two laws."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from palpate.app.recordings.snapshot import OverlayState
from palpate.app.session.messages import Message
from palpate.app.session.session import PERIODS_PER_SECOND, Session
from palpate.app.session.tool_control import NO_TOOL
from palpate.core.faults import InputError
from palpate.dynamics.loads.foundation import Foundation
from palpate.dynamics.run.model import Model
from palpate.dynamics.solid.model import EnergySolid
from palpate.reduction.hyper.model import ReducedModel

SHARED_MESSAGES = (
    "pose",
    "tool",
    "pin",
    "material",
    "speed",
    "follow",
)  # messages that `Session.handle` does not pass to a command below


class Comparison(Session):
    """The session of a reduced model with the full body in a second engine, or of a solid with one of another law.

    Both have the same nodes and the same tools at the same poses, with a rigid coupling: the tools of two springs would
    differ. Of a model with a prescribed group, forceps hold that group of the full body; they hold the `end` of two
    solids. `foundations` are springs between the ground and each body. The session of the second body is `second`. Each
    body has its own clock. While one is slower than real time and the tool moves, the two are at different times.
    """

    def __init__(
        self,
        model: ReducedModel | EnergySolid,
        second: Model,
        title: str,
        rate: float = PERIODS_PER_SECOND,
        end: str = "",
        foundations: Sequence[Foundation] = (),
    ) -> None:
        if isinstance(model, ReducedModel):
            touched, groups = model.data.compliance is not None, model.data.prescribed
        else:
            touched, groups = not end, (end,)
        if not isinstance(second, EnergySolid) or not (touched or len(groups) == 1):
            raise InputError(
                "model must be of a solid that a tool touches or holds to be compared, got another one; leave "
                "--compare out"
            )
        group = "" if touched else groups[0]
        self.second = Session(second, title, rate, foundations, end=group, held=not touched)
        super().__init__(model, title, rate, foundations, end=end, held=bool(end))
        self.sessions = (self.second, self)
        self.second.speed_limit = self.speed_limit
        if not np.array_equal(self.second.surface.triangles, self.surface.triangles):
            raise InputError("second must have the surface of the model, got another one; train the model again")

    def hello(self) -> dict[str, Any]:
        """Return the constant properties for `hello`."""
        names = ["reduced", "full"]
        if isinstance(self.model, EnergySolid):
            names = [type(each.model.material).__name__ for each in (self, self.second)]
        about = {"overlay": True, "compare": True, "compared": names, "least_radius": self.second.body.least_radius}
        return {**super().hello(), **about}

    def statistics(self) -> dict[str, Any]:
        """Return the statistics of the first body, with the pace of the slower one."""
        first = super().statistics()
        return {**first, "pace": min(first["pace"], self.second.statistics()["pace"])}

    def overlay(self, time: float) -> OverlayState:
        """Return positions (n, 3) [m] of the second body, and the force (3,) [N] on its tool."""
        snapshot, surface = self.second.snapshot(), self.second.surface
        return OverlayState(surface.rest + snapshot.displacements(surface), snapshot.tools[0].force)

    def _steps_the_solid_of(self, former: Session) -> bool:
        """Whether the shape of another session is kept: both bodies begin at rest."""
        return False

    @property
    def tool_kinds(self) -> list[str]:
        """Kinds of tools for both bodies; not forceps, which would grasp different nodes, and scalpels."""
        return [kind for kind in self.second.tool_kinds if kind not in ("grasp", "scalpel")]

    def handle(self, message: Message) -> None:
        """Execute a message of the driver for both bodies."""
        if message["type"] == "tool":
            if message["kind"] not in self.tool_kinds:
                allowed = ", ".join(map(repr, self.tool_kinds))
                raise InputError(f"kind must be one of {allowed} in a comparison, got {message['kind']!r}; use another")
            message = {**message, "stiffness": None}
        super().handle(message)
        if message["type"] not in SHARED_MESSAGES:
            return
        try:
            self.second.handle(message)
        except InputError:
            self.release(message.get("index"))
            raise
        for index, (tool, other) in enumerate(zip(self.tools, self.second.tools, strict=True)):
            if (tool.active is NO_TOOL) != (other.active is NO_TOOL):  # one body is in the way of its tool
                self.release(index)
