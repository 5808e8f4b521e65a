"""What happens at each message of the service: poses of the tools from hands, and forces on hands from readings."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from palpate.app.device.force import (
    MAX_STIFFNESS,
    EnergyAccount,
    Freshness,
    ToolForce,
    contact_force,
    limited_force,
    stable_stiffness,
    stored_energy,
)
from palpate.app.device.hand import NO_TURN, Anchor, HandMap
from palpate.app.device.options import DeviceOptions, axes_rotation
from palpate.app.device.service import Grip, ServiceState, assign_tools
from palpate.arrays import Floats

MAX_INTERVAL = 0.05  # [s] between two states from which a velocity is taken
TOOL_WORDS = ("first", "second", "third", "fourth")
GONE_SECONDS = 0.1  # [s] out of the messages after which a device is gone; its force is zero at once
SAME_LINE_SECONDS = 10.0  # [s] in which a line is not said again
MAX_LINES, MAX_NAMES = 100, 64  # different lines that are said; devices that are remembered
NO_FORCE = np.zeros(3)
NO_GRIP = Grip(None, False)


@dataclass
class Hand:
    """A device with the tool that it moves."""

    index: int
    position: Floats  # (3,) array [m], in the device's frame
    freshness: Freshness
    force: Floats = field(default_factory=lambda: NO_FORCE)  # (3,) array [N]: the last one that was sent
    stiffness: Floats = field(default_factory=lambda: np.zeros((3, 3)))  # [N/m] at the hand
    anchor: Anchor | None = None
    pose: tuple[Floats, Floats] | None = None  # of the tool
    epoch: int = -1  # of the tool: it is another one after a change
    reading: ToolForce | None = None
    given: tuple[float, ...] = ()  # contact stiffness of that reading, as it came
    has_rotation: bool = False
    has_clutch: bool = False
    seen: float = 0.0  # time [s] of the last message with it


class HandLoop:
    """Moves tools by hands, and computes the forces on them.

    Parameters
    ----------
    tools : int
        Tools that devices may move.
    answer : function
        Sends a message to the session: ``poses``, ``devices`` or ``say``.
    """

    def __init__(self, options: DeviceOptions, tools: int, answer: Callable[[dict[str, Any]], None]) -> None:
        self.options, self.tools, self._answer = options, tools, answer
        self.map = HandMap(options.device_scale, axes_rotation(options.device_axes))
        self.hands: dict[str, Hand] = {}
        self.account = EnergyAccount()
        self._assigned: dict[str, int] = {}  # also of devices that have gone
        self._refused: set[str] = set()
        self._lines: dict[str, float] = {}  # when each was said [s]
        self._period, self._time, self._number, self._asked = 1e-3, -math.inf, 0, False

    def receive(self, message: Mapping[str, Any], now: float) -> None:
        """Take the answer of the session to poses, which arrived at a time [s]."""
        self._asked, self._period = False, message["period"]
        for hand in self.hands.values():
            if hand.index < len(message["tools"]):
                self._take_reading(hand, message["tools"][hand.index], now)

    def _take_reading(self, hand: Hand, given: Mapping[str, Any], now: float) -> None:
        position, quaternion = np.array(given["position"]), np.array(given["quaternion"])
        if given["epoch"] != hand.epoch or hand.anchor is None:
            hand.epoch, hand.pose, hand.anchor = given["epoch"], (position, quaternion), None
            hand.freshness.restart()
        if not given["running"]:
            hand.reading = None
            return
        stiffness = tuple(given["stiffness"])
        if stiffness != hand.given or hand.reading is None:
            hand.given = stiffness
            gain = self.options.device_scale * self.options.device_force
            local = stable_stiffness(np.reshape(stiffness, (3, 3)), MAX_STIFFNESS / max(gain, 1e-9))
            hand.stiffness = self.options.device_force * self.map.stiffness_at_hand(local)
        else:
            local = hand.reading.stiffness
        hand.reading = ToolForce(np.array(given["force"]), local, position, given["bonded"])
        hand.freshness.note_reading(given["steps"], now)

    def forces(self, state: ServiceState, now: float) -> dict[str, list[float]]:
        """Return the forces [N] on devices for their state at a time [s], and send the poses of their tools.

        A device that is not in the state has no force, and is gone after a while.
        """
        self._note_devices(state, now)
        interval = now - self._time
        self._time = now
        moving: list[Hand] = []
        wanted, velocities, before, steps = [], [], [], []
        for name, hand in self.hands.items():
            if name not in state.positions:
                hand.force = NO_FORCE
                hand.freshness.restart()
                continue
            position = np.array(state.positions[name])
            step = position - hand.position
            hand.position = position
            before.append(hand.force)
            steps.append(step)
            grip = state.grips[hand.index] if hand.index < len(state.grips) else NO_GRIP
            force = self._wanted_force(hand, grip, now)
            hand.force = NO_FORCE
            if force.any():
                moving.append(hand)
                wanted.append(force)
                velocities.append(step / interval if 0.0 < interval < MAX_INTERVAL else NO_FORCE)
        self.account.note_motion(before, steps)
        stored = [stored_energy(force, hand.stiffness) for force, hand in zip(wanted, moving, strict=True)]
        self.account.forget(math.fsum(stored) if all(map(math.isfinite, stored)) else math.inf)
        passive = self.account.passive_forces(wanted, velocities, interval)
        for hand, force in zip(moving, passive, strict=True):
            hand.force = limited_force(force, self.options.device_limit)
        self._send_poses()
        return {name: hand.force.tolist() for name, hand in self.hands.items()}

    def _wanted_force(self, hand: Hand, grip: Grip, now: float) -> Floats:
        """Return the force (3,) [N] on a hand before passivity, and set the pose of its tool."""
        turn = NO_TURN if grip.rotation is None else np.array(grip.rotation)
        has_rotation = grip.rotation is not None
        released = hand.has_clutch and not grip.clutch
        hand.has_clutch = grip.clutch
        if hand.pose is None:
            return NO_FORCE
        if hand.anchor is None or released or has_rotation != hand.has_rotation:
            hand.anchor, hand.has_rotation = Anchor(hand.position, turn, *hand.pose), has_rotation
        if grip.clutch:
            hand.freshness.restart()
            return NO_FORCE
        hand.pose = self.map.position(hand.anchor, hand.position), self.map.quaternion(hand.anchor, turn)
        share = hand.freshness.share(now, self._period, hand.reading is not None)
        if share == 0.0 or hand.reading is None:
            return NO_FORCE
        force = self.options.device_force * self.map.force_on_hand(contact_force(hand.reading, hand.pose[0]))
        return share * limited_force(force, self.options.device_limit)

    def _send_poses(self) -> None:
        """Send the poses of all tools, unless the last ones are not answered yet."""
        if self._asked or not self.hands:
            return
        self._asked, self._number = True, self._number + 1
        poses = [
            [hand.index, hand.epoch, None if hand.pose is None else [part.tolist() for part in hand.pose]]
            for hand in self.hands.values()
        ]
        self._answer({"poses": poses, "number": self._number})

    def silence(self) -> None:
        """Take all forces away, until new states have been read: the ramp begins again."""
        for hand in self.hands.values():
            hand.force = NO_FORCE
            hand.freshness.restart()

    def close(self) -> None:
        """Take all devices away: the connection has ended."""
        if self.hands:
            self.hands = {}
            self._answer({"devices": {}})

    def is_new(self, state: ServiceState) -> bool:
        """Return whether a device without a tool came after the snapshot, which alone says its handedness."""
        unknown = state.positions.keys() - self._assigned.keys() - self._refused
        return bool(unknown) and not state.handedness

    def _say(self, text: str, now: float) -> None:
        """Say a line, unless it was said lately."""
        if len(self._lines) < MAX_LINES and now - self._lines.get(text, -math.inf) > SAME_LINE_SECONDS:
            self._lines[text] = now
            self._answer({"say": text})

    def _note_devices(self, state: ServiceState, now: float) -> None:
        """Begin with the devices that came, and end with those that went."""
        for name in self.hands.keys() & state.positions.keys():
            self.hands[name].seen = now
        if state.positions.keys() == self.hands.keys():
            return
        gone = [name for name, hand in self.hands.items() if now - hand.seen > GONE_SECONDS]
        for name in gone:
            del self.hands[name]
            self._say(f"{name} is gone: its tool stays where it is", now)
        kept = {name: hand.index for name, hand in self.hands.items()}
        assigned = assign_tools(state, kept, self._assigned, self.tools)
        for name in state.positions.keys() - assigned.keys() - self._refused:
            if len(self._refused) < MAX_NAMES:
                self._refused.add(name)
            many = "one tool" if self.tools == 1 else f"{self.tools} tools"
            self._say(f"{name} is left out: devices move {many} at most", now)
        came = [name for name in assigned if name not in self.hands]
        for name in came:
            index = assigned[name]
            self.hands[name] = Hand(index, np.array(state.positions[name]), Freshness(self.options.max_age), seen=now)
            back = " again" if name in self._assigned else ""
            self._say(f"{name} moves the {TOOL_WORDS[index]} tool{back}", now)
        for name, index in assigned.items():
            self._assigned.pop(name, None)
            self._assigned[name] = index
        for name in list(self._assigned)[:-MAX_NAMES]:
            del self._assigned[name]
        if gone or came:
            self._answer({"devices": {str(hand.index): name for name, hand in self.hands.items()}})
