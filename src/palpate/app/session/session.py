"""A session: a body in real time, the tools of its user, and recordings; independent of server and page."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from palpate.app.common.rotations import compose_rotations
from palpate.app.models.force_error import nodes_error
from palpate.app.recordings.snapshot import (
    OverlayState,
    Snapshot,
    scalar_descriptions,
    training_errors,
)
from palpate.app.recordings.snapshot_arrays import coordinates_type
from palpate.app.session.bodies import GroupBody, session_body
from palpate.app.session.messages import MAX_COORDINATE, Message, describe_tools
from palpate.app.session.recordings import SessionRecordings
from palpate.app.session.tool_control import (
    NO_ROTATION,
    NO_TOOL,
    WORKSPACE_MARGIN,
    SelectedTool,
    ToolState,
    ToolWorkspace,
    check_clear,
    forceps_of_group,
    make_forceps,
    selected_tool,
)
from palpate.core.arrays import Floats
from palpate.core.faults import InputError
from palpate.dynamics.contact.blade import Blade
from palpate.dynamics.contact.shapes import Forceps, Tool, make_tool, tool_parameters
from palpate.dynamics.contact.tools import Contact
from palpate.dynamics.loads.foundation import Foundation
from palpate.dynamics.nodal.model import NodalModel
from palpate.dynamics.solid.model import EnergySolid
from palpate.realtime.bodies.display_surface import DisplaySurface, places_at_rest
from palpate.realtime.engine import Engine
from palpate.realtime.instrumented import Observation, make_instrumented
from palpate.realtime.record import Reading
from palpate.realtime.statistics import Statistics
from palpate.realtime.suspension import suspended_time
from palpate.reduction.hyper.model import ReducedModel

PERIODS_PER_SECOND = 1000.0  # [Hz]
MAX_TOOL_SPEED = 0.5  # [m/s]
POINTER_TIME = 0.04  # [s] in which a tool reaches a pose of a pointer, at most; a screen has one in 0.017 s
TRAINED_SHARE = 0.95  # of the largest speed of the training, for a tool that follows a pointer
HISTORY_SECONDS = 5.0
MAX_READS = 1000  # attempts to read the engine and the model in the same period
PACE_SECONDS = 3.0  # [s] over which the pace is taken
HOLD_SECONDS = 1.0  # [s] after its last pose for which a tool counts as held
SLEEP_TIME = 3.0  # [s] of suspension between two ticks, after which a session pauses
MODULUS_NAME = "shear modulus"
HAND_FORCE = 3.3  # [N] of a coupled tool: the largest of a common haptic device (Touch, 3D Systems, data sheet)
MIN_MODULUS_RATIO, MAX_MODULUS_RATIO = 0.25, 4.0  # to the model's own moduli


class Session:
    """A reduced model or a full body in an `Engine` of a rate [Hz], with the tools of a user by index.

    A reduced model has tool contact, or one prescribed group. `foundations` are springs between the body and the
    ground. Forceps hold all of the group `end` of a solid, where they grasp it; with `held` they never let go of it,
    and are the only tool. The engine's black box stores a duration `history` [s]; its file `black_box` is written if
    the state diverges.

    Messages must come from one thread at a time; `snapshot` may be called from any thread.
    """

    mode = "live"

    def __init__(
        self,
        model: ReducedModel | NodalModel,
        title: str,
        rate: float = PERIODS_PER_SECOND,
        foundations: Sequence[Foundation] = (),
        history: float = HISTORY_SECONDS,
        black_box: Path | None = None,
        end: str = "",
        held: bool = False,
    ) -> None:
        farthest = float(np.abs(model.cloud.points).max()) + WORKSPACE_MARGIN
        if farthest > MAX_COORDINATE:
            raise InputError(
                f"body must lie within {MAX_COORDINATE - WORKSPACE_MARGIN:g} m of the origin for tools to reach it, "
                f"got {farthest - WORKSPACE_MARGIN:.4g} m; move the surface"
            )
        self.model, self.title, self.rate = model, title, rate
        self.body = session_body(model, foundations, end if held else "")
        self.end, self._end_forceps = end or (self.body.group if isinstance(self.body, GroupBody) else ""), None
        if end and not held:
            try:
                self._end_forceps = forceps_of_group(model.cloud, end)
            except InputError:  # no forceps hold it alone: the page has no end, and forceps hold what they touch
                self.end = ""
        self.surface = self.body.surface
        self._workspace = ToolWorkspace(self.surface)
        idle = self.body.idle_tool
        self.tools = [ToolState(idle, idle, self.body.home, NO_ROTATION) for _ in range(self.body.max_tools)]
        self._instrumented = make_instrumented(self.body.realtime)
        self.engine = Engine(  # every frame has the error indicator
            self._instrumented,
            rate,
            max_speed=MAX_TOOL_SPEED,
            out_of_training="ignore",
            history=history,
            black_box=black_box,
        )
        self.speed_limit, self.fast = trained_speed(model), False
        self.pause_reason: str | None = None
        self.speed, self.modulus_ratio = 1.0, 1.0
        self.recordings = SessionRecordings(title, self.body, self._describe_recorded)
        self._paces: deque[tuple[float, int, int]] = deque()  # time [s], periods, dropped periods
        self.subtitle, self.notes = "", tuple[str, ...]()  # what lies in the body, and lines about how it was made
        self.devices: dict[int, str] = {}  # haptic devices by the tool that they move
        self.successor: Session | None = None  # the session that has taken the place of this one
        self.sessions: tuple[Session, ...] = (self,)  # of all bodies that commands are for
        self._lock, self._suspended = threading.RLock(), suspended_time()

    # queries

    @property
    def notifications(self) -> list[dict[str, Any]]:
        """Messages still to be sent to all viewers."""
        return self.recordings.notifications

    @property
    def shown_surface(self) -> DisplaySurface:
        """The surface that is drawn: of the body as it is cut now."""
        return self.body.shown_surface

    def snapshot(self) -> Snapshot:
        """Return the results of the last period, from the engine and the instrumented model."""
        with self._lock:
            reading, observed = self._read_period()
            acts = [tool.active is not NO_TOOL and reading.steps > tool.since for tool in self.tools]
            values = zip(acts, reading.tools, observed.tool_positions, observed.device_forces, strict=True)
            tools = tuple(tool.snapshot(*each) for tool, each in zip(self.tools, values, strict=True))
            is_acting = np.array(acts)[observed.contact_tools]
            return Snapshot(
                tools=tools, time=reading.time, steps=reading.steps, trust=reading.trust, kinetic=reading.kinetic,
                strain=reading.strain, computing=reading.computing, lateness=reading.lateness, state=reading.state,
                coordinates=observed.coordinates.astype(coordinates_type(self.model)),
                contact_nodes=observed.contact_nodes[is_acting], contact_forces=observed.contact_forces[is_acting],
                contact_tools=observed.contact_tools[is_acting], modulus_ratio=observed.modulus_ratio,
            )  # fmt: skip

    def _read_period(self) -> tuple[Reading, Observation]:
        """Return values of the same period, or of adjacent ones if the processor is too busy."""
        for _ in range(MAX_READS):
            reading, observation = self.engine.read(), self._instrumented.observe()
            if np.array_equal(reading.coordinates, observation.coordinates):
                break
        return reading, observation

    def hello(self) -> dict[str, Any]:
        """Return the constant properties for `hello`."""
        tools = self._describe_period()[1]
        return {
            "tools": self.tool_kinds, "tool": tools[0], "max_tools": self.max_tools, "all_tools": tools,
            "materials": self._materials(), "rate": self.rate, "scalars": scalar_descriptions(self.surface),
            "training_errors": training_errors(self.model), "nodes_error": nodes_error(self.model), "overlay": False,
            "full": self.body.is_full,
            "least_radius": self.body.least_radius, "tool_speed": self.speed_limit,
            "subtitle": self.subtitle, "notes": list(self.notes),
            "end": self._end_vertices(), "end_tools": self._end_tools(),
            **describe_tools(self.tool_kinds),
        }  # fmt: skip

    def _end_vertices(self) -> list[int] | None:
        """Return the vertices of the end that forceps pull; None of a body without one."""
        if not self.end:
            return None
        vertices: list[int] = np.flatnonzero(np.isin(self.surface.nodes, self.model.cloud.group(self.end))).tolist()
        return vertices

    def _end_tools(self) -> list[int]:
        """Return the indices of the tools that hold the end."""
        if isinstance(self.body, GroupBody):
            return [0]
        end = self._end_forceps
        return [index for index, tool in enumerate(self.tools) if end is not None and tool.active.shape == end]

    def _materials(self) -> list[dict[str, Any]]:
        return material_sliders(self.model, self.modulus_ratio)

    def _describe_period(self) -> tuple[Snapshot, list[dict[str, Any]]]:
        """Return the present snapshot, and the descriptions of the selected tools by index."""
        with self._lock:
            now = self.snapshot()
            shown = zip(self.tools, now.tools, strict=True)
            return now, [tool.describe(each.position, each.quaternion) for tool, each in shown]

    def _describe_recorded(self) -> tuple[Snapshot, list[dict[str, Any]], Floats]:
        """Return the present snapshot, the descriptions of the tools, and the triangles of the cut."""
        return *self._describe_period(), self.body.cut_triangles

    def overlay(self, time: float) -> OverlayState | None:
        """Return None: a session of one body has no full model to show."""
        return None

    def status(self) -> dict[str, Any]:
        """Return the properties that change rarely, for `status`."""
        tools = self._describe_period()[1]
        return {
            "state": self.engine.state, "tool": tools[0], "all_tools": tools, "speed": self.speed,
            "strokes": self.body.strokes,
            "fast": self.fast, "pause_reason": self.pause_reason, "recording": self.recordings.is_active,
            "materials": self._materials(), "devices": [[index, name] for index, name in sorted(self.devices.items())],
            "end_tools": self._end_tools(),
        }  # fmt: skip

    def statistics(self) -> dict[str, Any]:
        """Return the deadline statistics since the start, the pace of the last seconds, and the bound of the force.

        The pace is the model time over real time. The error bound [N], the largest of all tools, is None if unknown.
        """
        statistics = self.engine.statistics()
        computing = statistics.computing
        bound = max(tool.force_bound for tool in self.engine.read().tools)
        return {
            "median_ms": 1e3 * computing.percentile(50), "p99_ms": 1e3 * computing.percentile(99),
            "misses": statistics.missed, "periods": statistics.count, "pace": self._recent_pace(statistics),
            "force_bound": bound if math.isfinite(bound) else None,
            **self.body.statistics([tool.selected.kind for tool in self.tools]),
        }  # fmt: skip

    def load(self, seconds: float) -> float:
        """Return the computing time of periods over their length, from the median of those in some seconds.

        The first half is left out: memory is then read for the first time. It is infinite if no period ends.
        """
        time.sleep(0.5 * seconds)
        first = self.engine.statistics().computing.counts
        time.sleep(0.5 * seconds)
        computing = self.engine.statistics().computing
        recent = replace(computing, counts=computing.counts - first)
        return recent.percentile(50) * self.rate if recent.counts.any() else math.inf

    def _recent_pace(self, statistics: Statistics) -> float:
        """Return the real-time factor of the last seconds, from the counts of periods in the statistics."""
        now = time.monotonic()
        self._paces.append((now, statistics.count, statistics.dropped))
        while self._paces[0][0] < now - PACE_SECONDS and len(self._paces) > 2:
            self._paces.popleft()
        _, count, dropped = self._paces[0]
        steps, lost = statistics.count - count, statistics.dropped - dropped
        return steps / (steps + lost) if steps > 0 and lost >= 0 else statistics.real_time_factor

    @property
    def tool_kinds(self) -> list[str]:
        """Kinds of tools that a user may select, forceps first for a body whose end they pull."""
        return (
            sorted(self.body.tool_kinds, key=lambda kind: kind != "grasp") if self.end else list(self.body.tool_kinds)
        )

    @property
    def max_tools(self) -> int:
        """Number of tools that the body takes at the same time."""
        return len(self.tools)

    @property
    def tool_speed(self) -> float:
        """Largest speed [m/s] of a tool that follows a pointer: at most that of the training, unless the user asks."""
        return MAX_TOOL_SPEED if self.fast or self.speed_limit is None else self.speed_limit

    @property
    def is_touched(self) -> bool:
        """Whether a tool touches the body, or is held by its user: it was moved within the last second."""
        active = [tool for tool in self.tools if tool.active is not NO_TOOL]
        moved_lately = any(time.monotonic() - tool.last_pose < HOLD_SECONDS for tool in active)
        return bool(active) and (moved_lately or any(np.any(each.force) for each in self.engine.read().tools))

    # commands

    def handle(self, message: Message) -> None:
        """Execute a validated message of the driver."""
        kind = message["type"]
        if kind == "pose":
            if message["index"] in self.devices:
                device = self.devices[message["index"]]
                raise InputError(f"pose must be of a tool without device, got that of {device}; move another tool")
            self._move_tool(message, POINTER_TIME, self.tool_speed)
        elif kind == "tool":
            self._select_tool(message)
        elif kind == "pin":
            self._pin_tool(message)
        elif kind == "release":
            self.release(message["index"])
        elif kind == "control":
            actions = {"reset": self.reset, "pause": self.pause, "resume": self.resume, "undo": self.undo}
            actions[message["action"]]()
        elif kind == "material":
            self._set_modulus(message["name"], 1e3 * message["value"])
        elif kind == "follow":
            if self.speed_limit is None:
                raise InputError("follow must be left out here, got it; only tools of some reduced models are slowed")
            self.fast = message["fast"]
        elif kind == "record":
            self.recordings.start_file() if message["action"] == "start" else self.recordings.finish()
        elif kind == "speed":
            with self._lock:
                self.engine.slow_down(message["factor"])
                self.speed = message["factor"]
        else:
            raise InputError(f"type must be a message of live sessions, got {kind!r}; see docs/reference/protocol.md")

    def start(self) -> None:
        """Start the engine of every body."""
        for each in self.sessions:
            each.engine.start()

    def stop(self) -> None:
        """Stop the engine of every body."""
        for each in self.sessions:
            each.engine.stop()

    def close(self) -> None:
        """Stop the engine, finish the present recording, and wait until all recordings are written."""
        self.stop()
        self.recordings.close()

    def continue_from(self, former: Session) -> None:
        """Start in place of another session of the same body: with its selected tools, speed, moduli and pause.

        Where both step the same solid, whatever its law, and forceps alone act on it, it keeps its shape and they their
        poses. The other session stops, and its recording is written. Its notifications are those of this session from
        now on.
        """
        self.recordings.continue_from(former.recordings)
        state, reason = former.engine.state, former.pause_reason
        former.stop()
        for each in self.sessions:
            each._take_settings(former)
        if self._steps_the_solid_of(former):
            self._take_shape(former)
        self.devices, former.devices, former.successor = former.devices, {}, self
        self.start()
        if state != "running":
            self.pause(reason)

    def _take_settings(self, former: Session) -> None:
        """Take the selected tools, the speed and the moduli of another session."""
        for tool, before in zip(self.tools, former.tools, strict=False):
            if before.selected.kind in self.tool_kinds:
                tool.selected = before.selected
        self.engine.slow_down(former.speed)
        self.speed = former.speed
        if former.modulus_ratio != 1.0 and self._materials():
            self.engine.set_modulus_ratio(former.modulus_ratio)
            self.modulus_ratio = former.modulus_ratio

    def _steps_the_solid_of(self, former: Session) -> bool:
        """Whether both sessions step a solid of the same nodes, which is not cut, and forceps alone act on it.

        The contact of another tool cannot begin with a body that it has deformed: steps would be too short.
        """
        if any(tool.active is not NO_TOOL and not isinstance(tool.active.shape, Forceps) for tool in former.tools):
            return False
        solids = isinstance(self.model, EnergySolid) and isinstance(former.model, EnergySolid) and not former.body.cuts
        relaxes = self.body.realtime.relaxes or former.body.realtime.relaxes  # by the history of the shape
        alike = solids and not relaxes and self.max_tools == former.max_tools
        return bool(alike and np.array_equal(self.model.cloud.points, former.model.cloud.points))

    def _take_shape(self, former: Session) -> None:
        """Take the shape of the body of another session, at rest, and its tools at their poses."""
        reading, shown = former.engine.read(), former.snapshot().tools
        self.engine.set_shape(reading.coordinates)
        self._instrumented.set_state(reading.coordinates, np.zeros((self.max_tools, 3)))
        for index, before in enumerate(former.tools):
            if before.active is NO_TOOL or before.active.kind not in self.tool_kinds:
                continue
            now, device = shown[index], reading.tools[index]
            self._set_tool(index, before.active, now.position, now.quaternion, device.sequence)
            self.engine.set_pose(before.origin + device.position - now.position, NO_ROTATION, device.sequence, index)
            self.tools[index].pinned = before.pinned

    def pause(self, reason: str | None = None) -> None:
        """Pause the engine of every body."""
        for each in self.sessions:
            each.engine.pause()
            each.pause_reason = reason

    def resume(self) -> None:
        """Resume or start the engine of every body."""
        for each in self.sessions:
            each._resume()

    def _resume(self) -> None:
        if self.engine.state == "diverged":
            raise InputError("state must be finite to resume, got a diverged state; reset the session")
        if self.engine.state == "stopped":
            self.engine.start()
        self.engine.resume()
        self.pause_reason = None

    def reset(self) -> None:
        """Set every body to rest and put all tools away."""
        for each in self.sessions:
            each._reset()

    def undo(self) -> bool:
        """Restore the body before the last stroke that cut it; the blade is put away.

        Body and other tools go on from their present state if the tissue that is joined again bears it. Otherwise the
        body starts from rest, cut as before the stroke, and all tools are put away. Returns whether it went on.

        Raises
        ------
        InputError
            No stroke has cut the body since it was whole.
        """
        cutter = self.body.cutter
        if cutter is None:
            raise InputError("undo must be of a body that a scalpel cuts, got another; use reset")
        with self._lock, self._pause_engine(), cutter.lock:
            blades = [index for index, tool in enumerate(self.tools) if isinstance(tool.active.shape, Blade)]
            coordinates = self.engine.read().coordinates
            goes_on = cutter.undo(coordinates)
            for index in blades:
                self._release(index)
            if goes_on:
                self.engine.swap_data(cutter.update(coordinates))
            else:
                self._reset(keep_cut=True)
        return goes_on

    def _reset(self, keep_cut: bool = False) -> None:
        with self._lock:
            running = self.engine.state in ("running", "diverged")
            self.engine.pause()
            for index, tool in enumerate(self.tools):
                self._set_tool(index, self.body.idle_tool, tool.origin, NO_ROTATION)
            self.engine.reset(keep_cut)
            for tool in self.tools:
                tool.since = 0
            self._instrumented.set_state(self.body.realtime.rest, np.zeros((self.max_tools, 3)))
            if running:
                self._resume()

    def release(self, index: int | None = None) -> None:
        """Put a tool away, by default all; a prescribed group returns to its place at rest."""
        for each in self.sessions:
            each._release(index)

    def _release(self, index: int | None) -> None:
        with self._lock:
            for k in range(self.max_tools) if index is None else [self._checked(index)]:
                tool = self.tools[k]
                if tool.active is self.body.idle_tool:
                    tool.pinned = False
                    if tool.active is not NO_TOOL:
                        self.engine.set_pose(np.zeros(3))
                    continue
                shown = self.snapshot().tools[k]
                self._change_tool(k, NO_TOOL, shown.position, shown.quaternion)

    def tick(self) -> None:
        """Pause if the machine slept since the last call; a stall of a busy machine does not pause."""
        before, self._suspended = self._suspended, suspended_time()
        if self._suspended - before > SLEEP_TIME and self.engine.state == "running":
            self.pause("sleep")

    def _set_modulus(self, name: str, modulus: float) -> None:
        if name != MODULUS_NAME or not self._materials():
            allowed = repr(MODULUS_NAME) if self._materials() else "left out for tissue that relaxes"
            raise InputError(f"material: name must be {allowed}, got {name!r}; see docs/reference/protocol.md")
        material_modulus = float(self.model.material.shear_modulus)
        if not MIN_MODULUS_RATIO <= modulus / material_modulus <= MAX_MODULUS_RATIO:
            low, high = 1e-3 * MIN_MODULUS_RATIO * material_modulus, 1e-3 * MAX_MODULUS_RATIO * material_modulus
            raise InputError(
                f"{name} must be from {low:g} to {high:g} kPa, got {1e-3 * modulus:g} kPa; choose a value in this range"
            )
        with self._lock:
            self.engine.set_modulus_ratio(modulus / material_modulus)
            self.modulus_ratio = modulus / material_modulus

    # the tool

    @contextlib.contextmanager
    def _pause_engine(self) -> Iterator[None]:
        """Pause the engine within a context."""
        running = self.engine.state == "running"
        self.engine.pause()
        try:
            yield
        finally:
            if running:
                self.engine.resume()

    def _checked(self, index: int) -> int:
        """Return the index of a tool; raise InputError for one that this body does not have."""
        if index >= self.max_tools:
            raise InputError(f"index must be below {self.max_tools} for this body, got {index}; use another")
        return index

    def _pin_tool(self, message: Message) -> None:
        """Let a tool stay where it is, or free it."""
        with self._lock:
            tool = self.tools[self._checked(message["index"])]
            if tool.active is NO_TOOL:
                raise InputError(
                    f"pin: index must be of a tool that is put down, got {message['index']}; send 'tool' first"
                )
            tool.pinned = message["pinned"]

    def _move_tool(self, message: Message, seconds: float, speed: float) -> None:
        """Move a tool to a pose, evenly in at most a time [s], and at most at a speed [m/s]."""
        index = self._checked(message["index"])
        position = self._workspace.nearest_position(np.array(message["position"]))
        quaternion = np.array(message["quaternion"])
        with self._lock:
            tool = self.tools[index]
            if tool.pinned:
                raise InputError(f"pose: index must be of a tool that is not pinned, got {index}; unpin it first")
            tool.last_pose = time.monotonic()
            if tool.active is NO_TOOL and not self._restore_tool(index, position, quaternion):
                return
            rotation = compose_rotations(tool.rotation, quaternion, invert_first=True)
            self.engine.follow_evenly(seconds, speed, index)
            self.engine.set_pose(position - tool.origin, rotation, message["sequence"], index)

    def _restore_tool(self, index: int, position: Floats, quaternion: Floats) -> bool:
        """Put the selected tool down again if it is clear of body and tools there; return whether it was."""
        tool = self.tools[index].selected
        if tool.shape is None or isinstance(tool.shape, Forceps):
            return False
        try:
            self._check_place(index, tool.shape, position, quaternion)
        except InputError:
            return False
        self._change_tool(index, tool, position, quaternion)
        return True

    def _select_tool(self, message: Message) -> None:
        index = self._checked(message["index"])
        if not self.tool_kinds:
            raise InputError("tool must be the model's prescribed group, got another tool; use a model with contact")
        if message["kind"] not in self.tool_kinds:
            allowed = ", ".join(map(repr, self.tool_kinds))
            raise InputError(f"tool: kind must be one of {allowed} for this body, got {message['kind']!r}; use another")
        position = self._workspace.nearest_position(np.array(message["position"]))
        quaternion = np.array(message["quaternion"])
        shape: Tool
        with self._lock:
            if message["kind"] == "grasp":
                displacements = self.snapshot().displacements(self.surface).astype(float)
                parts = self.surface, displacements, position, message["radius"], self._end_forceps
                shape, position = make_forceps(*parts)
            else:
                shape = make_tool(message["kind"], message)
            self._check_place(index, shape, position, quaternion)
            parameters = {name: message[name] for name in tool_parameters()}
            selected = SelectedTool(message["kind"], shape, message["friction"], message["stiffness"], parameters)
            self._change_tool(index, selected, position, quaternion, message["sequence"])
            self.tools[index].selected = selected

    def _check_place(self, index: int, shape: Tool, position: Floats, quaternion: Floats) -> None:
        """Raise InputError where a tool is inside the body or another tool, or is a second blade."""
        pose, snapshot = np.concatenate([position, quaternion]), self.snapshot()
        if not isinstance(shape, Forceps):
            displacements = snapshot.displacements(self.surface).astype(float)
            if not self._workspace.is_outside(displacements, shape, pose):
                raise InputError("tool must be outside the body, got a position inside; put it down outside")
        for k, (tool, shown) in enumerate(zip(self.tools, snapshot.tools, strict=True)):
            if k != index and tool.active.shape is not None:
                check_clear(places_at_rest(self.model.cloud), shape, pose, k, tool.active.shape, shown)

    def follow_device(self, position: Floats, quaternion: Floats, sequence: int, index: int = 0) -> None:
        """Move a tool of every body to the pose of a haptic device, in the frame of the body."""
        message = {"position": position, "quaternion": quaternion, "sequence": sequence, "index": index}
        for each in reversed(self.sessions):
            each._move_tool(message, 0.0, MAX_TOOL_SPEED)

    def tool_contact(self, index: int = 0) -> dict[str, Any]:
        """Return what a haptic device needs of a tool: pose, force of the body, contact stiffness, and their age.

        With a virtual coupling the force is that of its spring, and the stiffness that of spring and body in series.
        """
        with self._lock:
            reading, state = self.engine.read(), self.tools[index]
            tool, each = state.active, reading.tools[index]
            force: Floats = each.force
            stiffness: Floats = each.stiffness
            if tool.stiffness is not None:
                force = self._instrumented.observe().device_forces[index]
                spring = tool.stiffness * np.eye(3)
                stiffness = np.asarray(tool.stiffness * np.linalg.solve(spring + stiffness, stiffness), dtype=float)
            return {
                "steps": reading.steps, "running": reading.state == "running" and tool is not NO_TOOL,
                "epoch": state.epoch, "force": force.tolist(), "stiffness": stiffness.ravel().tolist(),
                "position": (state.origin + each.position).tolist(), "sequence": each.sequence,
                "quaternion": compose_rotations(state.rotation, each.quaternion).tolist(),
                "selected": state.selected.shape is not None or not self.tool_kinds,
                "bonded": tool.shape is None or isinstance(tool.shape, Forceps | Blade),
            }  # fmt: skip

    def put_down(self, contact: Contact) -> None:
        """Put the first tool down at its first pose, to which the poses of `palpate.Engine.set_pose` are relative."""
        pose = contact.poses(np.zeros(1))[0]
        self.tools[0].selected = selected_tool(contact)
        self._change_tool(0, self.tools[0].selected, pose[:3], pose[3:])

    def _change_tool(
        self, index: int, tool: SelectedTool, position: Floats, quaternion: Floats, sequence: int | None = None
    ) -> None:
        """Replace the tool of an index; the body and the other tools continue from their present state."""
        with self._lock, self._pause_engine():
            sequence = self.engine.read().tools[index].sequence if sequence is None else sequence
            self._set_tool(index, tool, position, quaternion, sequence)

    def _set_tool(
        self, index: int, tool: SelectedTool, position: Floats, quaternion: Floats, sequence: int = 0
    ) -> None:
        grasps = isinstance(tool.shape, Forceps)  # forceps rotate the nodes they grasp as much as they are rotated
        rotation = NO_ROTATION if grasps else quaternion
        self.body.change_tool(tool, np.concatenate([position, rotation]), index)
        self._instrumented.set_coupling(tool.stiffness, HAND_FORCE, index)
        self._instrumented.place_tool(index, np.zeros(3))
        self.engine.place_tool(np.zeros(3), NO_ROTATION, sequence, index)
        state = self.tools[index]
        state.active, state.origin, state.rotation = tool, np.array(position), np.array(quaternion)
        state.since, state.pinned, state.epoch = self.engine.read().steps, False, state.epoch + 1


def latest(session: Session) -> Session:
    """Return the session that has taken the place of another one in the end, or that one."""
    while session.successor is not None:
        session = session.successor
    return session


def material_sliders(model: ReducedModel | NodalModel, ratio: float) -> list[dict[str, Any]]:
    """Return the adjustable parameters for ``hello``: the shear modulus, unless the tissue has relaxation times."""
    if model.material.prony is not None:
        return []
    modulus = 1e-3 * float(model.material.shear_modulus)
    return [{"name": MODULUS_NAME, "unit": "kPa", "value": ratio * modulus, "low": MIN_MODULUS_RATIO * modulus,
             "high": MAX_MODULUS_RATIO * modulus, "live": True}]  # fmt: skip


def trained_speed(model: ReducedModel | NodalModel) -> float | None:
    """Return the largest speed [m/s] of a pointer's tool that the training of a reduced model supports.

    It is None where the training was as fast as tools move at most, and for other bodies.
    """
    if not isinstance(model, ReducedModel) or model.data.compliance is None:
        return None
    speed = TRAINED_SHARE * model.data.scales.speed_scale
    return speed if speed < MAX_TOOL_SPEED else None
