"""The session of the formula with several tools: version 3 of the protocol, as far as the page can tell."""

from __future__ import annotations

import json

import numpy as np
from synthetic_session import SyntheticSession

from palpate.app.session.messages import describe_tools

KINDS = ["sphere", "capsule", "grasp", "scalpel"]
NUMBERS = {"none": 0, "sphere": 1, "capsule": 2, "grasp": 3, "scalpel": 5}
MAX_TOOLS = 4
AWAY = {"kind": "none", "pinned": False, "active": False, "radius": 0.0, "length": 0.0}


class SyntheticHands(SyntheticSession):
    """A body that yields to up to four tools, one of them a blade that touches nothing."""

    subprotocols = ("palpate.v3", "palpate.v2")

    def __init__(self, folder, **hello):
        super().__init__(folder, **hello)
        self.hands = [dict(AWAY) for _ in range(MAX_TOOLS)]
        self.poses, self.places = [None] * MAX_TOOLS, [None] * MAX_TOOLS

    def _hello(self, viewer):
        described = describe_tools(KINDS)
        more = {"protocol": 3, "tools": KINDS, "max_tools": MAX_TOOLS, "all_tools": self.hands, **described}
        return {**super()._hello(viewer), **more, **self.more}

    def _status(self, viewer):
        return {**super()._status(viewer), "all_tools": self.hands}

    async def _prescribed(self, viewer, kind, message):
        if kind == "control" and message["action"] == "reset":
            for index in range(MAX_TOOLS):
                self._let_go(index)
        if kind not in ("pose", "tool", "release", "pin"):
            return await super()._prescribed(viewer, kind, message)
        index = message.get("index", 0)
        hand = self.hands[index]
        if kind == "pin":
            hand["pinned"] = message["pinned"]
        elif kind == "release":
            self._let_go(index)
        elif kind == "tool":
            self.hands[index] = {**AWAY, **{k: v for k, v in message.items() if k in ("kind", "radius", "length")}}
            self.poses[index], self.places[index] = message, np.array(message["position"])
        elif hand["pinned"]:
            await viewer.send(json.dumps({"type": "error", "reason": f"tool {index} is pinned; unpin it first"}))
        elif hand["kind"] in ("sphere", "capsule", "scalpel") or self.poses[index]:  # forceps come back by `tool` only
            self.poses[index] = message
        return None

    def _let_go(self, index):
        self.poses[index] = None
        self.hands[index]["pinned"] = False

    def _forces(self):
        """Positions of the surface, and the force on each tool."""
        moved, forces = np.zeros_like(self.rest), np.zeros((MAX_TOOLS, 3))
        for k, (hand, pose) in enumerate(zip(self.hands, self.poses, strict=True)):
            if pose is None or hand["kind"] == "none":
                continue
            if hand["kind"] == "scalpel":
                forces[k] = 0.0, 0.0, 0.3
                continue
            positions, forces[k] = self._deform(hand, pose, self.places[k])
            moved += positions - self.rest
        return self.rest + moved, forces

    def _contact_displacement(self):
        positions, forces = self._forces()
        self.pose, self.tool["kind"] = self.poses[0], self.hands[0]["kind"]
        self.posed = 0 if self.pose is None else self.pose.get("sequence", 0)
        return positions, forces[0]

    def tools_frame(self, sequence):
        """Return a frame of kind 8."""
        forces = self._forces()[1]
        rows = []
        for hand, pose, force in zip(self.hands, self.poses, forces, strict=True):
            kind = NUMBERS[hand["kind"]] if pose is not None else 0
            place = pose or {"position": [0, 0, 0], "quaternion": [1, 0, 0, 0]}
            number = float(place.get("sequence", 0))
            rows.append([kind, hand["pinned"], *force, 0, 0, 0, *place["position"], *place["quaternion"], number])
        head = np.array([8, sequence, MAX_TOOLS, 0], dtype="<u4").tobytes()
        return head + np.array(rows, dtype="<f8").tobytes()

    async def _send(self, viewer, message):
        if isinstance(message, bytes) and message[:4] == b"\x02\0\0\0" and viewer.subprotocol == "palpate.v3":
            await super()._send(viewer, self.tools_frame(int(np.frombuffer(message[4:8], "<u4")[0])))
        await super()._send(viewer, message)
