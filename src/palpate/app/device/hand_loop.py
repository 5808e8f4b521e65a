"""What happens at each message of the service: poses of the tools from hands, and forces on hands from readings."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from palpate.app.device.force import (
    MAX_STIFFNESS,
    PassivityObserver,
    ToolForce,
    Watchdog,
    contact_force,
    limited_force,
    stable_stiffness,
    stored_energy,
)
from palpate.app.device.hand import NO_TURN, Anchor, HandMap
from palpate.app.device.options import DeviceOptions, axes_rotation
from palpate.app.device.service import Fault, Grip, ServiceState, assign_tools
from palpate.app.device.statistics import (
    CLUTCH_PRESSED,
    NO_ANSWER,
    NO_CONTACT,
    NO_READING,
    NOT_LISTED,
    NOT_RUNNING,
    OLD_READING,
    POSITION_JUMP,
    HandStatistics,
    tool_name,
)
from palpate.core.arrays import Floats

MAX_INTERVAL = 0.05  # [s] between two states from which a velocity is taken
MAX_HAND_SPEED = 2.0  # [m/s]: through all of an arm's reach in 0.15 s
MAX_STEP_AFTER_GAP = 0.002  # [m] of a hand over a gap without answers
GONE_SECONDS = 0.1  # [s] out of the messages after which a device is gone; its force is zero at once
REPORT_SECONDS = 0.5  # [s] between two messages with statistics
SAME_LINE_SECONDS = 10.0  # [s] in which a line is not said again
MAX_LINES, MAX_NAMES = 100, 64  # different lines that are said; devices that are remembered
NO_FORCE = np.zeros(3)
NO_GRIP = Grip(None, False)
NOT_READ = Fault("is new", "")  # of a device whose states were not read yet


@dataclass
class HandForce:
    """The force on a hand."""

    watchdog: Watchdog
    sent: Floats = field(default_factory=lambda: NO_FORCE)  # (3,) array [N]: the last one
    stiffness: Floats = field(default_factory=lambda: np.zeros((3, 3)))  # [N/m] at the hand
    reading: ToolForce | None = None
    given: tuple[float, ...] = ()  # contact stiffness of that reading, as it came
    without: str = NO_READING  # why there is none
    was_there: bool = False
    share: float = 0.0  # of the force that a ramp lets pass
    is_limited: bool = False
    is_damped: bool = False

    def take_away(self, reason: str) -> None:
        """Take the force away; the ramp begins again."""
        self.sent, self.without = NO_FORCE, reason
        self.watchdog.restart()

    def note_time(self, interval: float, told: HandStatistics) -> None:
        """Count a message, and a time [s] in which the last force was held."""
        size = math.sqrt(self.sent @ self.sent)
        told.seconds, told.messages = told.seconds + interval, told.messages + 1
        if size == 0.0:
            told.without_force[self.without] = told.without_force.get(self.without, 0.0) + interval
            told.interruptions += self.was_there and self.without not in (NO_CONTACT, CLUTCH_PRESSED)
            self.was_there = False
            return
        self.was_there = True
        told.impulse += interval * size
        told.ramped += interval * (self.share < 1.0)
        told.limited += interval * self.is_limited
        told.damped += interval * self.is_damped


@dataclass
class DeviceChannel:
    """A device channel: a haptic device, and the tool that it moves."""

    index: int
    force: HandForce
    statistics: HandStatistics
    position: Floats | None = None  # (3,) array [m], in the device's frame
    anchor: Anchor | None = None
    pose: tuple[Floats, Floats] | None = None  # of the tool
    epoch: int = -1  # of the tool: it is another one after a change
    grip: str | None = None  # name of the grip whose rotation belongs to the anchor
    has_clutch: bool = False
    seen: float = 0.0  # time [s] of the last message with it
    fault: Fault | None = None  # why it moves nothing

    def give(self, force: Floats, is_damped: bool) -> None:
        """Note the force (3,) [N] that is sent, and whether the passivity observer changed it."""
        self.force.sent, self.force.is_damped = force, is_damped
        self.statistics.peak_force = max(self.statistics.peak_force, math.sqrt(force @ force))

    def block(self, fault: Fault) -> None:
        """Leave the tool: another hand may move it, so its pose is read again afterwards."""
        self.fault, self.anchor, self.pose, self.force.reading, self.epoch = fault, None, None, None, -1
        self.force.take_away(fault.reason)


class HandLoop:
    """Moves up to `tools` tools by hands, and computes the forces on them.

    `answer` sends a message to the session: ``poses``, ``devices``, ``hands`` (statistics) or ``say``.
    """

    def __init__(self, options: DeviceOptions, tools: int, answer: Callable[[dict[str, Any]], None]) -> None:
        self.options, self.tools, self._answer = options, tools, answer
        self.map = HandMap(options.device_scale, axes_rotation(options.device_axes))
        self.channels: dict[str, DeviceChannel] = {}
        self.passivity = PassivityObserver()
        self._assigned: dict[str, int] = {}  # also of devices that have gone
        self._refused: set[str] = set()
        self._lines: dict[str, float] = {}  # when each was said [s]
        self._grips: list[str] = []  # names of grips by the tool that they turn
        self._period, self._number, self._asked = 1e-3, 0, False
        self._time, self._interval, self._reported = -math.inf, math.inf, -math.inf  # [s] of the last state
        self._after_gap = False  # whether no state came for a time

    def receive(self, message: Mapping[str, Any], now: float) -> None:
        """Take the answer of the session to poses, which arrived at a time [s]."""
        self._asked, self._period = False, message["period"]
        for channel in self.channels.values():
            if channel.index < len(message["tools"]) and channel.fault is None:
                self._take_reading(channel, message["tools"][channel.index], now)

    def _take_reading(self, channel: DeviceChannel, entry: Mapping[str, Any], now: float) -> None:
        position, quaternion = np.array(entry["position"]), np.array(entry["quaternion"])
        if entry["epoch"] != channel.epoch or channel.pose is None:
            channel.epoch, channel.pose, channel.anchor = entry["epoch"], (position, quaternion), None
            channel.force.watchdog.restart()
        if not entry["running"]:
            channel.force.reading = None
            return
        stiffness = tuple(entry["stiffness"])
        if stiffness != channel.force.given or channel.force.reading is None:
            channel.force.given = stiffness
            gain = self.options.device_scale * self.options.device_force
            local = stable_stiffness(np.reshape(stiffness, (3, 3)), MAX_STIFFNESS / max(gain, 1e-9))
            channel.force.stiffness = self.options.device_force * self.map.stiffness_at_hand(local)
        else:
            local = channel.force.reading.stiffness
        channel.force.reading = ToolForce(np.array(entry["force"]), local, position, entry["bonded"])
        channel.force.watchdog.note_reading(entry["steps"], now)

    def forces(self, state: ServiceState, now: float) -> dict[str, list[float]]:
        """Return the forces [N] on devices for their state at a time [s], and send the poses of their tools.

        Devices missing from the message, or not ready, get zero force; missing ones are removed after 0.1 s. After
        that, and after a step that no hand makes, a hand continues from where its tool is.
        """
        interval = now - self._time
        window = interval + min(self._interval, self.options.max_age)
        self._time, self._interval = now, interval
        held = max(interval, 0.0) if math.isfinite(interval) else 0.0
        for channel in self.channels.values():
            channel.force.note_time(held, channel.statistics)
        self._note_devices(state, now)
        grips = self._note_grips(state)
        moving: list[DeviceChannel] = []
        wanted, velocities, before, steps = [], [], [], []
        for name, channel in self.channels.items():
            if name not in state.positions:
                channel.anchor = None
                channel.force.take_away(NOT_LISTED if channel.fault is None else channel.fault.reason)
                continue
            before.append(channel.force.sent)
            steps.append(self._follow(name, channel, np.array(state.positions[name]), interval, window))
            force = self._wanted_force(channel, grips.get(channel.index, NO_GRIP), now)
            channel.force.sent = NO_FORCE
            if force.any():
                moving.append(channel)
                wanted.append(force)
                velocities.append(steps[-1] / interval if 0.0 < interval < MAX_INTERVAL else NO_FORCE)
        self._after_gap = False
        self.passivity.note_motion(before, steps)
        stored = [stored_energy(force, channel.force.stiffness) for force, channel in zip(wanted, moving, strict=True)]
        self.passivity.limit_energy(math.fsum(stored) if all(map(math.isfinite, stored)) else math.inf)
        passive = self.passivity.passive_forces(wanted, velocities, interval)
        for channel, force, free in zip(moving, passive, wanted, strict=True):
            channel.give(limited_force(force, self.options.device_limit), force is not free)
        self._send_poses()
        self._report(now)
        return {name: channel.force.sent.tolist() for name, channel in self.channels.items()}

    def _follow(self, name: str, channel: DeviceChannel, position: Floats, interval: float, window: float) -> Floats:
        """Return the step (3,) [m] of a hand to a position; one that no hand makes is zero, and moves no tool.

        The service takes a state between the last message to it and the arrival of its answer. So two states are at
        most the window [s] of three arrivals apart, however late they are read.
        """
        step = NO_FORCE if channel.position is None else position - channel.position
        channel.position = position
        late = self._after_gap or interval > self.options.max_age
        limit = MAX_STEP_AFTER_GAP / max(self.options.device_scale, 1.0) if late else MAX_HAND_SPEED * window
        if channel.anchor is None or step @ step <= limit**2:
            return step
        channel.anchor = None
        channel.force.take_away(POSITION_JUMP)
        if not late and not channel.has_clutch:
            tool = tool_name(channel.index)
            self._say(f"{name} jumped, faster than a hand: {tool} stays, and follows it from there", self._time)
        return NO_FORCE

    def _wanted_force(self, channel: DeviceChannel, grip: Grip, now: float) -> Floats:
        """Return the force (3,) [N] on a hand before passivity, and set the pose of its tool."""
        turn = NO_TURN if grip.rotation is None else np.array(grip.rotation)
        name = None if grip.rotation is None else grip.name
        released, pressed = channel.has_clutch and not grip.clutch, grip.clutch and not channel.has_clutch
        channel.has_clutch, channel.force.share = grip.clutch, 0.0
        channel.statistics.clutches += pressed
        if channel.pose is None or channel.position is None:
            channel.force.without = NO_READING
            return NO_FORCE
        if channel.anchor is None or released or name != channel.grip:
            channel.anchor, channel.grip = Anchor(channel.position, turn, *channel.pose), name
        if grip.clutch:
            channel.force.take_away(CLUTCH_PRESSED)
            return NO_FORCE
        if channel.force.reading is None or channel.force.watchdog.age(now) > max(self.options.max_age, GONE_SECONDS):
            channel.anchor = None  # an engine that has stopped would find its tool far away
            channel.force.take_away(NOT_RUNNING if channel.force.reading is None else OLD_READING)
            return NO_FORCE
        channel.pose = self.map.position(channel.anchor, channel.position), self.map.quaternion(channel.anchor, turn)
        channel.force.share = channel.force.watchdog.share(now, self._period)
        if channel.force.share == 0.0:
            channel.force.without = (
                OLD_READING if channel.force.watchdog.is_old(now, self._period) else channel.force.without
            )
            return NO_FORCE
        force = self.options.device_force * self.map.force_on_hand(
            contact_force(channel.force.reading, channel.pose[0])
        )
        limited = limited_force(force, self.options.device_limit)
        channel.force.is_limited, channel.force.without = limited is not force, NO_CONTACT
        return channel.force.share * limited

    def _note_grips(self, state: ServiceState) -> dict[int, Grip]:
        """Return the grips by the tool that they turn: the order in which they came, also while others are away."""
        present = {grip.name or str(k): grip for k, grip in enumerate(state.grips)}
        for name in [each for each in present if each not in self._grips]:
            free = [k for k, each in enumerate(self._grips) if each not in present]
            if free:
                self._grips[free[0]] = name
            else:
                self._grips.append(name)
        return {k: present[name] for k, name in enumerate(self._grips) if name in present}

    def _send_poses(self) -> None:
        """Send the poses of all tools, unless the last ones are not answered yet."""
        poses = [
            [channel.index, channel.epoch, None if channel.pose is None else [part.tolist() for part in channel.pose]]
            for channel in self.channels.values()
            if channel.fault is None
        ]
        if self._asked or not poses:
            return
        self._asked, self._number = True, self._number + 1
        self._answer({"poses": poses, "number": self._number})

    def _report(self, now: float) -> None:
        """Send the statistics since the last time, if there are some."""
        if now - self._reported < REPORT_SECONDS:
            return
        self._reported = now
        statistics = {
            name: asdict(channel.statistics) for name, channel in self.channels.items() if channel.statistics.messages
        }
        for channel in self.channels.values():
            channel.statistics = HandStatistics(channel.index)
        if statistics:
            self._answer({"hands": statistics})

    def silence(self) -> None:
        """Take all forces away, until new states have been read: the ramp begins again."""
        self._after_gap = True
        for channel in self.channels.values():
            channel.force.take_away(NO_ANSWER)

    def close(self) -> None:
        """Take all devices away: the connection has ended."""
        self._report(math.inf)
        self._time, self._interval, self._reported = -math.inf, math.inf, -math.inf
        self._grips = []
        if self.channels:
            self.channels = {}
            self._answer({"devices": {}})

    def is_new(self, state: ServiceState) -> bool:
        """Return whether a device without a tool came after the snapshot; only the snapshot contains the handedness."""
        unknown = set(state.devices) - self.channels.keys() - self._assigned.keys() - self._refused
        return bool(unknown) and not state.handedness

    def _say(self, text: str, now: float) -> None:
        """Say a line, unless it was said lately."""
        if len(self._lines) < MAX_LINES and now - self._lines.get(text, -math.inf) > SAME_LINE_SECONDS:
            self._lines[text] = now
            self._answer({"say": text})

    def _note_devices(self, state: ServiceState, now: float) -> None:
        """Begin with the devices that came or are ready again, and end with those that went or are not."""
        listed = state.devices
        for name in self.channels.keys() & listed:
            self.channels[name].seen = now
        if self.channels.keys() == set(listed) and all(
            channel.fault == state.faults.get(name) for name, channel in self.channels.items()
        ):
            return
        before = self._moving()
        for name in [name for name, channel in self.channels.items() if now - channel.seen > GONE_SECONDS]:
            index = self._leave(name)
            self._say(f"{name} is gone: {tool_name(index)} stays where it is", now)
        indices = {name: channel.index for name, channel in self.channels.items()}
        assigned = assign_tools(state, indices, self._assigned, self.tools)
        self._refuse(set(listed) - assigned.keys(), now)
        for name, index in assigned.items():
            if name not in self.channels:
                statistics = HandStatistics(index)
                self.channels[name] = DeviceChannel(
                    index, HandForce(Watchdog(self.options.max_age)), statistics, seen=now, fault=NOT_READ
                )
            if name in listed:
                self._note_fault(name, self.channels[name], state.faults.get(name), now)
        for name in list(self._assigned)[:-MAX_NAMES]:
            del self._assigned[name]
        if self._moving() != before:
            self._answer({"devices": self._moving()})

    def _moving(self) -> dict[str, str]:
        """Return the devices that move a tool, by its index."""
        return {str(channel.index): name for name, channel in self.channels.items() if channel.fault is None}

    def _note_fault(self, name: str, channel: DeviceChannel, fault: Fault | None, now: float) -> None:
        """Let a device that is ready move its tool, and one that is not leave it."""
        if fault == channel.fault:
            return
        tool = tool_name(channel.index)
        if fault is not None:
            channel.block(fault)
            self._say(f"{name} {fault.reason}: {fault.remedy}; until then {tool} stays, and the hand has no force", now)
            return
        channel.fault, channel.position, channel.force.without = None, None, NO_READING
        self._say(f"{name} moves {tool}{' again' if name in self._assigned else ''}", now)
        self._assigned.pop(name, None)  # the last one is the newest
        self._assigned[name] = channel.index

    def _leave(self, name: str) -> int:
        """Remove a hand, and return the index of its tool."""
        channel = self.channels.pop(name)
        if channel.statistics.messages:
            self._answer({"hands": {name: asdict(channel.statistics)}})
        return channel.index

    def _refuse(self, names: set[str], now: float) -> None:
        """Name the devices for which there is no tool, each once."""
        many = "one tool" if self.tools == 1 else f"{self.tools} tools"
        for name in names - self._refused:
            if len(self._refused) < MAX_NAMES:
                self._refused.add(name)
            self._say(f"{name} is left out: devices move {many} at most", now)
