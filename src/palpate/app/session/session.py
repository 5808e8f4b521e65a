"""A session: a body in real time, the tool of its user, and recordings; independent of server and page."""

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

from palpate.app.recordings.snapshot import OverlayState, Snapshot, scalar_descriptions, training_errors
from palpate.app.recordings.snapshot_arrays import coordinates_type
from palpate.app.session.bodies import session_body
from palpate.app.session.messages import MAX_COORDINATE, Message, describe_tools
from palpate.app.session.recordings import SessionRecordings
from palpate.app.session.tool_control import (
    NO_ROTATION,
    NO_TOOL,
    WORKSPACE_MARGIN,
    SelectedTool,
    ToolWorkspace,
    compose_rotations,
    make_forceps,
    selected_tool,
)
from palpate.arrays import Floats
from palpate.dynamics.contact.shapes import Forceps, Tool, make_tool, tool_parameters
from palpate.dynamics.contact.tools import Contact
from palpate.dynamics.loads.foundation import Foundation
from palpate.dynamics.solid.model import EnergySolid
from palpate.faults import InputError
from palpate.realtime.bodies.display_surface import DisplaySurface
from palpate.realtime.engine import Engine
from palpate.realtime.observable import Observation, make_observable
from palpate.realtime.record import Reading
from palpate.realtime.statistics import Statistics
from palpate.reduction.hyper.model import ReducedModel

PERIODS_PER_SECOND = 1000.0  # [Hz]
MAX_TOOL_SPEED = 0.5  # [m/s]
HISTORY_SECONDS = 5.0
MAX_READS = 1000  # attempts to read the engine and the model in the same period
PACE_SECONDS = 3.0  # [s] over which the pace is taken
HOLD_SECONDS = 1.0  # [s] after its last pose for which a tool counts as held
SLEEP_TIME = 3.0  # [s] without a tick after which the machine is taken to have slept
MODULUS_NAME = "shear modulus"
HAND_FORCE = 3.3  # [N] of a coupled tool: the largest of a common haptic device (Touch, 3D Systems, data sheet)
MIN_MODULUS_RATIO, MAX_MODULUS_RATIO = 0.25, 4.0  # to the model's own moduli


class Session:
    """A reduced model or a full body in an `Engine`, with the tool of a user.

    Messages must come from one thread at a time; `snapshot` may be called from any thread.

    Parameters
    ----------
    model : ReducedModel or EnergySolid
        A reduced model with tool contact, or with one prescribed group; or a full body.
    rate : float [Hz]
    foundations : sequence of Foundation
        Springs between the body and the ground.
    history : float [s]
        Duration that the engine's black box stores.
    black_box : path, optional
        Its file, written if the state diverges.
    """

    mode = "live"

    def __init__(
        self,
        model: ReducedModel | EnergySolid,
        title: str,
        rate: float = PERIODS_PER_SECOND,
        foundations: Sequence[Foundation] = (),
        history: float = HISTORY_SECONDS,
        black_box: Path | None = None,
    ) -> None:
        farthest = float(np.abs(model.cloud.points).max()) + WORKSPACE_MARGIN
        if farthest > MAX_COORDINATE:
            raise InputError(
                f"body must lie within {MAX_COORDINATE - WORKSPACE_MARGIN:g} m of the origin for tools to reach it, "
                f"got {farthest - WORKSPACE_MARGIN:.4g} m; move the surface"
            )
        self.model, self.title, self.rate = model, title, rate
        self.body = session_body(model, foundations)
        self.surface = self.body.surface
        self._workspace = ToolWorkspace(self.surface)
        self.tool = self.selected_tool = self.body.idle_tool
        self._tool_origin, self._tool_rotation = self.body.home, NO_ROTATION  # when the tool was put down
        self._observable = make_observable(self.body.realtime)
        self.engine = Engine(  # every frame has the trust number
            self._observable, rate, max_speed=MAX_TOOL_SPEED, on_distrust="ignore", history=history, black_box=black_box
        )
        self.pause_reason: str | None = None
        self.speed, self.modulus_ratio = 1.0, 1.0
        self.recordings = SessionRecordings(title, self.body, self._describe_recorded)
        self._paces: deque[tuple[float, int, int]] = deque()  # time [s], periods, dropped periods
        self._last_pose = -math.inf  # [s]
        self._lock, self._last_tick = threading.RLock(), (time.time(), time.monotonic())

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
        """Return the results of the last period, from the engine and the observable model."""
        with self._lock:
            reading, observed = self._read_period()
            return Snapshot(
                time=reading.time, steps=reading.steps, force=reading.force, moment=reading.moment,
                stiffness=reading.stiffness, trust=reading.trust, position=self._tool_origin + observed.tool_position,
                quaternion=compose_rotations(self._tool_rotation, reading.quaternion), sequence=reading.sequence,
                kinetic=reading.kinetic, strain=reading.strain, computing=reading.computing, lateness=reading.lateness,
                coordinates=observed.coordinates.astype(coordinates_type(self.model)), state=reading.state,
                device_force=observed.device_force, contact_nodes=observed.contact_nodes,
                contact_forces=observed.contact_forces, modulus_ratio=observed.modulus_ratio, tool=self.tool.kind,
            )  # fmt: skip

    def _read_period(self) -> tuple[Reading, Observation]:
        """Return values of the same period, or of adjacent ones if the processor is too busy."""
        for _ in range(MAX_READS):
            reading, observation = self.engine.read(), self._observable.observe()
            if np.array_equal(reading.coordinates, observation.coordinates):
                break
        return reading, observation

    def hello(self) -> dict[str, Any]:
        """Return the constant properties for `hello`."""
        return {
            "tools": self.tool_kinds, "tool": self._describe_tool(), "materials": self._materials(), "rate": self.rate,
            "scalars": scalar_descriptions(self.surface), "training_errors": training_errors(self.model),
            "overlay": False, "full": self.body.is_full, **describe_tools(self.tool_kinds),
        }  # fmt: skip

    def _materials(self) -> list[dict[str, Any]]:
        return material_sliders(self.model, self.modulus_ratio)

    def _describe_tool(self) -> dict[str, Any]:
        return self._describe_period()[1]

    def _describe_period(self) -> tuple[Snapshot, dict[str, Any]]:
        with self._lock:
            now, active = self.snapshot(), self.tool is self.selected_tool
            return now, self.selected_tool.describe(now.position, now.quaternion, active)

    def _describe_recorded(self) -> tuple[Snapshot, dict[str, Any], Floats]:
        """Return the present snapshot, the description of the tool, and the triangles of the cut."""
        return *self._describe_period(), self.body.cut_triangles

    def overlay(self, time: float) -> OverlayState | None:
        """Return None: a session of one body has no full model to show."""
        return None

    def status(self) -> dict[str, Any]:
        """Return the properties that change rarely, for `status`."""
        return {
            "state": self.engine.state, "tool": self._describe_tool(), "speed": self.speed,
            "pause_reason": self.pause_reason, "recording": self.recordings.is_active,
            "materials": self._materials(),
        }  # fmt: skip

    def statistics(self) -> dict[str, Any]:
        """Return the deadline statistics since the start, the pace of the last seconds, and the bound of the force.

        The pace is the model time over real time. The error bound [N] is None if it is unknown.
        """
        statistics, bound = self.engine.statistics(), self.engine.read().force_bound
        computing = statistics.computing
        return {
            "median_ms": 1e3 * computing.percentile(50), "p99_ms": 1e3 * computing.percentile(99),
            "misses": statistics.missed, "periods": statistics.count, "pace": self._recent_pace(statistics),
            "force_bound": bound if math.isfinite(bound) else None,
            **self.body.statistics(self.selected_tool),
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
        """Return the pace of the last seconds, from the counts of periods in the statistics of that time."""
        now = time.monotonic()
        self._paces.append((now, statistics.count, statistics.dropped))
        while self._paces[0][0] < now - PACE_SECONDS and len(self._paces) > 2:
            self._paces.popleft()
        _, count, dropped = self._paces[0]
        steps, lost = statistics.count - count, statistics.dropped - dropped
        return steps / (steps + lost) if steps > 0 and lost >= 0 else statistics.pace

    @property
    def tool_kinds(self) -> list[str]:
        """Kinds of tools that a user may select."""
        return list(self.body.tool_kinds)

    @property
    def is_touched(self) -> bool:
        """Whether a tool touches the body, or is held by its user: it was moved within the last second."""
        if self.tool is NO_TOOL:
            return False
        moved_lately = time.monotonic() - self._last_pose < HOLD_SECONDS
        return moved_lately or bool(np.any(self.engine.read().force))

    # commands

    def handle(self, message: Message) -> None:
        """Execute a validated message of the driver."""
        kind = message["type"]
        if kind == "pose":
            self._move_tool(message)
        elif kind == "tool":
            self._select_tool(message)
        elif kind == "release":
            self.release()
        elif kind == "control":
            {"reset": self.reset, "pause": self.pause, "resume": self.resume}[message["action"]]()
        elif kind == "material":
            self._set_modulus(message["name"], 1e3 * message["value"])
        elif kind == "record":
            self.recordings.start_file() if message["action"] == "start" else self.recordings.finish()
        elif kind == "speed":
            with self._lock:
                self.engine.slow_down(message["factor"])
                self.speed = message["factor"]
        else:
            raise InputError(f"type must be a message of live sessions, got {kind!r}; see docs/protocol.md")

    def start(self) -> None:
        """Start the engine."""
        self.engine.start()

    def stop(self) -> None:
        """Stop the engine."""
        self.engine.stop()

    def close(self) -> None:
        """Stop the engine, finish the present recording, and wait until all recordings are written."""
        self.stop()
        self.recordings.close()

    def continue_from(self, former: Session) -> None:
        """Start in place of another session of the same body: with its selected tool, speed, moduli and pause.

        The other session stops, and its recording is written. Its notifications are those of this session from now
        on.
        """
        self.recordings.continue_from(former.recordings)
        state, reason = former.engine.state, former.pause_reason
        former.stop()
        if former.selected_tool.kind in self.tool_kinds:
            self.selected_tool = former.selected_tool
        self.engine.slow_down(former.speed)
        self.speed = former.speed
        if former.modulus_ratio != 1.0 and self._materials():
            self.engine.set_modulus_ratio(former.modulus_ratio)
            self.modulus_ratio = former.modulus_ratio
        self.start()
        if state != "running":
            self.pause(reason)

    def pause(self, reason: str | None = None) -> None:
        """Pause the engine."""
        self.engine.pause()
        self.pause_reason = reason

    def resume(self) -> None:
        """Resume or start the engine."""
        if self.engine.state == "diverged":
            raise InputError("state must be finite to resume, got a diverged state; reset the session")
        if self.engine.state == "stopped":
            self.engine.start()
        self.engine.resume()
        self.pause_reason = None

    def reset(self) -> None:
        """Set the body to rest and put the tool away."""
        with self._lock:
            running = self.engine.state in ("running", "diverged")
            self.engine.pause()
            self._set_tool(self.body.idle_tool, self._tool_origin, NO_ROTATION)
            self.engine.reset()
            self._observable.set_state(self.body.realtime.rest, np.zeros(3))
            if running:
                self.resume()

    def release(self) -> None:
        """Put the tool away; a prescribed group returns to its place at rest."""
        if self.tool is NO_TOOL:
            return
        if self.tool is self.body.idle_tool:
            self.engine.set_pose(np.zeros(3))
            return
        with self._lock:
            snapshot = self.snapshot()
            self._change_tool(NO_TOOL, snapshot.position, snapshot.quaternion)

    def tick(self) -> None:
        """Pause if the machine slept or the program was stopped; to be called several times a second."""
        now = (time.time(), time.monotonic())
        slept = max(now[0] - self._last_tick[0], now[1] - self._last_tick[1]) > SLEEP_TIME
        self._last_tick = now
        if slept and self.engine.state == "running":
            self.pause("sleep")

    def _set_modulus(self, name: str, modulus: float) -> None:
        if name != MODULUS_NAME or not self._materials():
            allowed = repr(MODULUS_NAME) if self._materials() else "left out for tissue that relaxes"
            raise InputError(f"material: name must be {allowed}, got {name!r}; see docs/protocol.md")
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

    def _move_tool(self, message: Message) -> None:
        self._last_pose = time.monotonic()
        position = self._workspace.nearest_position(np.array(message["position"]))
        quaternion = np.array(message["quaternion"])
        with self._lock:
            if self.tool is NO_TOOL and not self._restore_tool(position, quaternion):
                return
            rotation = compose_rotations(self._tool_rotation, quaternion, invert_first=True)
            self.engine.set_pose(position - self._tool_origin, rotation, message["sequence"])

    def _restore_tool(self, position: Floats, quaternion: Floats) -> bool:
        """Put the selected tool down again if it is outside the body; return whether it was."""
        shape = self.selected_tool.shape
        if shape is None or isinstance(shape, Forceps):
            return False
        if not self._workspace.is_outside(self._displacements(), shape, np.concatenate([position, quaternion])):
            return False
        self._change_tool(self.selected_tool, position, quaternion)
        return True

    def _select_tool(self, message: Message) -> None:
        if not self.tool_kinds:
            raise InputError("tool must be the model's prescribed group, got another tool; use a model with contact")
        if message["kind"] not in self.tool_kinds:
            allowed = ", ".join(map(repr, self.tool_kinds))
            raise InputError(f"tool: kind must be one of {allowed} for this body, got {message['kind']!r}; use another")
        position = self._workspace.nearest_position(np.array(message["position"]))
        quaternion = np.array(message["quaternion"])
        shape: Tool
        if message["kind"] == "grasp":
            shape, position = make_forceps(self.surface, self._displacements(), position, message["radius"])
        else:
            shape = make_tool(message["kind"], message)
            if not self._workspace.is_outside(self._displacements(), shape, np.concatenate([position, quaternion])):
                raise InputError("tool must be outside the body, got a position inside; put it down outside")
        parameters = {name: message[name] for name in tool_parameters()}
        self.selected_tool = SelectedTool(message["kind"], shape, message["friction"], message["stiffness"], parameters)
        self._change_tool(self.selected_tool, position, quaternion, message["sequence"])

    def put_down(self, contact: Contact) -> None:
        """Put a tool down at its first pose, to which the poses of `palpate.Engine.set_pose` are then relative."""
        pose = contact.poses(np.zeros(1))[0]
        self.selected_tool = selected_tool(contact)
        self._change_tool(self.selected_tool, pose[:3], pose[3:])

    def _displacements(self) -> Floats:
        return self.snapshot().displacements(self.surface).astype(float)

    def _change_tool(
        self, tool: SelectedTool, position: Floats, quaternion: Floats, sequence: int | None = None
    ) -> None:
        """Replace the tool; the body continues from its present state."""
        with self._lock, self._pause_engine():
            self._set_tool(tool, position, quaternion, self.engine.read().sequence if sequence is None else sequence)

    def _set_tool(self, tool: SelectedTool, position: Floats, quaternion: Floats, sequence: int = 0) -> None:
        grasps = isinstance(tool.shape, Forceps)  # forceps rotate the nodes they grasp as much as they are rotated
        rotation = NO_ROTATION if grasps else quaternion
        self.body.change_tool(tool, np.concatenate([position, rotation]))
        self._observable.set_coupling(tool.stiffness, HAND_FORCE)
        self._observable.set_state(self.engine.read().coordinates, np.zeros(3))
        self.engine.place_tool(np.zeros(3), NO_ROTATION, sequence)
        self.tool, self._tool_origin, self._tool_rotation = tool, np.array(position), np.array(quaternion)


def material_sliders(model: ReducedModel | EnergySolid, ratio: float) -> list[dict[str, Any]]:
    """Return the adjustable parameters for ``hello``: the shear modulus, unless the tissue has relaxation times."""
    if model.material.prony is not None:
        return []
    modulus = 1e-3 * float(model.material.shear_modulus)
    return [{"name": MODULUS_NAME, "unit": "kPa", "value": ratio * modulus, "low": MIN_MODULUS_RATIO * modulus,
             "high": MAX_MODULUS_RATIO * modulus, "live": True}]  # fmt: skip
