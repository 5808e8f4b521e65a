"""The engine: steps a model at a fixed rate against its tools, in its own thread."""

from __future__ import annotations

import math
import threading
import time
import warnings
import weakref
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, nullcontext
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from palpate.compiled.threads import check_process
from palpate.core.arrays import Floats
from palpate.core.deprecation import warn_renamed
from palpate.core.describe import Described, Fact
from palpate.core.faults import InputError, TrustWarning, brief, integer_in_range, number_in_range
from palpate.realtime.black_box import write_black_box
from palpate.realtime.bodies.model import RealtimeModel
from palpate.realtime.channel import SharedSlots
from palpate.realtime.clock import HAS_CLOCKS
from palpate.realtime.contract import check_contract
from palpate.realtime.instrumented import InstrumentedModel, make_instrumented
from palpate.realtime.loop import DIVERGED, PAUSED, RUNNING, STOPPED, Channels, compile_loop, loop_arguments
from palpate.realtime.period import (
    CLAMP,
    IGNORE,
    LARGEST_WAY,
    MAX_PERIODS,
    SEQUENCE,
    STOP,
    TIME_SCALE,
    WARN,
    WORST_SINCE_RESET,
    Settings,
    Work,
)
from palpate.realtime.pose import IDENTITY_POSE, normalise_pose
from palpate.realtime.record import HEADER_SIZE, Reading, field_offset, record_size
from palpate.realtime.runner import Runner
from palpate.realtime.seqlock import publish, snapshot
from palpate.realtime.statistics import Statistics

STATE_NAMES = {RUNNING: "running", STOPPED: "stopped", PAUSED: "paused", DIVERGED: "diverged"}
OUT_OF_TRAINING = {"warn": WARN, "clamp": CLAMP, "stop": STOP, "ignore": IGNORE}
MIN_RATE, MAX_RATE = 1e-6, 20_000.0  # [Hz]; the period of a lower rate overflows
MAX_HISTORY = 600.0  # [s]
MIN_TIME_SCALE = 1e-3  # model time per wall-clock time
MAX_SPIN = 1e-3  # [s]
CUT_INTERVAL = 5e-3  # [s] between two looks at where a blade is


def _make_settings(
    rate: float,
    force_limit: float,
    stiffness_every: int,
    out_of_training: str,
    max_speed: float,
    max_angular_speed: float,
    spin: float,
    max_backlog: int = 0,
) -> Settings:
    """Return the settings of the loop; raises InputError for an argument out of range."""
    period = round(1e9 / number_in_range("rate", rate, MIN_RATE, MAX_RATE, unit="Hz"))
    if out_of_training not in OUT_OF_TRAINING:
        allowed = ", ".join(map(repr, OUT_OF_TRAINING))
        raise InputError(f"out_of_training must be one of {allowed}, got {out_of_training!r}; choose one of these")
    if force_limit != math.inf:
        force_limit = number_in_range("force_limit", force_limit, 0, open_low=True, unit="N")
    return Settings(
        period=period,
        spin=round(1e9 * number_in_range("spin", spin, 0, MAX_SPIN, unit="s")),
        max_distance=1e-9 * period * number_in_range("max_speed", max_speed, 0, open_low=True, unit="m/s"),
        max_angle=1e-9
        * period
        * number_in_range("max_angular_speed", max_angular_speed, 0, open_low=True, unit="rad/s"),
        force_limit=float(force_limit),
        stiffness_every=integer_in_range("stiffness_every", stiffness_every, 0),
        out_of_training=OUT_OF_TRAINING[out_of_training],
        max_backlog=max_backlog,
    )


class Engine(Described):
    """Steps a model at a fixed rate in its own thread, without Python's global lock.

    In every period the thread waits for a deadline, moves the tools towards their newest poses, advances the model, and
    publishes the forces. It runs no Python code while it steps. If steps take longer than a period, periods are dropped
    and model time falls behind. A full body, whose periods differ, may first be late by a few periods. Sleeps are less
    precise on a system without clock_nanosleep (macOS).

    Parameters
    ----------
    model : object
        Result of `palpate.realtime_model`, or any object with the attributes of `Realtime`.
    rate : float [Hz]
        Steps per second, from 1e-6 to 20000.
    force_limit : float [N]
        Largest force reported.
    stiffness_every : int
        Periods between evaluations of the contact stiffness; 0 for never.
    history : float [s]
        Duration that the black box stores, up to 600 s.
    out_of_training : str
        Response to an error indicator above 1, where the model was not trained. ``"warn"`` warns once, in `read`.
        ``"clamp"`` keeps all tools at the last trusted poses until the model is trusted again and the requested poses
        have returned from beyond them. If that takes more than 50 ms, the tools move back along their paths, at most to
        the start of the path: rest, or the pose of `place_tool`. ``"stop"`` pauses the engine; `resume` continues until
        trust is lost again. ``"ignore"`` does nothing, for callers that read the error indicator themselves.
    max_speed : float [m/s]
    max_angular_speed : float [rad/s]
        Largest speeds at which a tool follows a pose.
    spin : float [s]
        Time before each deadline at which the thread stops sleeping and polls the clock; up to 1 ms.
    black_box : path, optional
        File for the black box, written if the state diverges.
    shared_memory : str, optional
        Name of shared memory through which a program on this machine sends poses and reads records
        (``palpate_channel.h``, see `palpate.realtime.channel`). The poses are then those of that program only.
    adjustable : bool
        `set_modulus_ratio` is supported. The model must be one of `palpate.realtime_model`, of a full body or a
        reduced model whose tissue has no relaxation times.
    on_distrust : str, optional
        Former name of `out_of_training`.

    Raises
    ------
    InputError
        An argument is out of range, the model lacks an attribute of `Realtime`, or `shared_memory` is in use. The
        moduli of an adjustable model cannot be changed.
    RuntimeError
        The system lacks the required clocks.

    Examples
    --------
    >>> import time
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.03, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1060, poisson=0.45)
    >>> block = pt.Solid(cloud, tissue, fixed="z-")
    >>> ball = pt.tools.Contact(pt.tools.Sphere(radius=0.01), (0.015, 0.015, 0.026))
    >>> with pt.Engine(pt.realtime_model(block, contact=ball)) as engine:
    ...     engine.set_pose((0, 0, -0.003))  # 2 mm into the block
    ...     for _ in range(500):
    ...         time.sleep(0.01)
    ...         reading = engine.read()
    ...         if reading.force[2] > 0:
    ...             break
    >>> reading.state, bool(reading.force[2] > 0)
    ('running', True)
    """

    def __init__(
        self,
        model: Any,
        rate: float = 1000.0,
        *,
        force_limit: float = math.inf,
        stiffness_every: int = 50,
        history: float = 5.0,
        out_of_training: str = "warn",
        max_speed: float = 2.0,
        max_angular_speed: float = 10.0,
        spin: float = 50e-6,
        black_box: str | Path | None = None,
        shared_memory: str | None = None,
        adjustable: bool = False,
        on_distrust: str | None = None,
    ) -> None:
        if on_distrust is not None:
            warn_renamed("Engine(on_distrust=)", "Engine(out_of_training=)")
            out_of_training = on_distrust
        _check_system(black_box)
        self._force_bound, max_backlog = getattr(model, "force_bound", None), _max_backlog(model)
        self._cutter, tool_names = getattr(model, "cutter", None), getattr(model, "tool_names", ())
        if adjustable:
            model = _adjustable(model)
        self._model = model
        model = check_contract(model)
        history = number_in_range("history", history, 0, MAX_HISTORY, open_low=True, unit="s")
        self._settings = _make_settings(
            rate, force_limit, stiffness_every, out_of_training, max_speed, max_angular_speed, spin, max_backlog
        )
        self.period = 1e-9 * self._settings.period
        forgetting = getattr(self._force_bound, "forgetting", 0.0)
        self._rest, self._work = model.rest, Work.at_rest(model.rest, model.tool, forgetting)
        tools = len(model.tool)
        self._tool_names = tuple(tool_names) or tuple(map(str, range(tools)))
        self._shared_name = shared_memory
        shared = None if shared_memory is None else SharedSlots(shared_memory, len(model.rest), tools)
        self._channels = Channels.allocate(len(model.rest), tools, math.ceil(history / self.period), shared)
        attributes = {"period": self.period, "coordinates": len(model.rest), "on_distrust": out_of_training}
        buffer = self._channels.ring_buffer
        self._write = partial(write_black_box, buffer=buffer, tools=tools, attributes=attributes)
        advance, stiffness, data = loop_arguments(model.advance, model.stiffness, model.data)
        self._loop = compile_loop(advance, stiffness)
        self._is_swapping = False  # while the loop stops for new data
        self._runner = Runner(
            partial(self._loop, data, self._work, self._channels, self._settings),
            self._channels.command,
            partial(self._write, black_box) if black_box is not None else None,
        )
        self._lock, self._warned = threading.RLock(), False
        self._last_poses = [IDENTITY_POSE] * tools
        for t in range(tools):
            publish(self._channels.pose_slot(t), np.append(IDENTITY_POSE, 0.0))
        self._to_rest()
        snapshot(self._channels.record)  # compiles it before the loop runs
        weakref.finalize(self, self._runner.stop, STOPPED)  # at exit, or without references to the engine
        if self._cutter is not None:
            threading.Thread(target=_cut, args=(weakref.ref(self),), name="palpate cutter", daemon=True).start()

    def _facts(self) -> list[Fact]:
        record, statistics = snapshot(self._channels.record), self.statistics()
        return [
            ("state", self.state, ""),
            ("rate", 1 / self.period, "Hz"),
            ("coordinates", len(self._rest), ""),
            ("time", float(record[field_offset("time")]), "s"),
            ("trust", float(record[field_offset("trust")]), ""),
            ("in real time", statistics.is_real_time if statistics.count else None, ""),
            ("status", statistics.status, ""),
        ]

    @property
    def state(self) -> str:
        """``"stopped"``, ``"running"``, ``"paused"`` or ``"diverged"`` (after the black box is written)."""
        return "running" if self._is_swapping else STATE_NAMES[self._runner.state]

    def start(self) -> None:
        """Start stepping from the present state; from ``"stopped"`` this resets the statistics.

        Raises
        ------
        InputError
            The state diverged and was not reset.
        """
        check_process()
        with self._lock:
            if self._runner.state == STOPPED:
                self._channels.histograms.clear()
            self._run()

    def resume(self) -> None:
        """Continue after a pause; does nothing if the engine is stopped.

        Raises
        ------
        InputError
            The state diverged and was not reset.
        """
        with self._lock:
            if self._runner.state != STOPPED:
                self._run()

    def _run(self) -> None:
        if self._runner.state == DIVERGED:
            raise InputError("state must be finite, got a diverged state; call reset() before the engine steps again")
        if self._runner.state != RUNNING:
            self._runner.start()

    def stop(self) -> None:
        """Stop the thread and keep the state; does nothing if the engine is stopped."""
        with self._lock:
            self._runner.stop(STOPPED)

    def pause(self) -> None:
        """Pause stepping and keep state and statistics; does nothing if the engine is not running."""
        with self._lock:
            if self._runner.state == RUNNING:
                self._runner.stop(PAUSED)

    def reset(self, keep_cut: bool = False) -> None:
        """Set body and tools to rest and time to 0; a running engine continues, a diverged one becomes stopped.

        Parameters
        ----------
        keep_cut : bool
            The body stays cut as it is, and a blade is put away; by default the body is whole again.
        """
        with self._cutter_lock(), self._lock:
            running = self._runner.state == RUNNING
            if running:
                self._runner.stop(PAUSED)
            if self._cutter is not None:
                if keep_cut:
                    self._cutter.put_away()
                else:
                    self._cutter.restore()
                self.swap_data(self._cutter.update(self._rest))
            self._to_rest()
            if self._runner.state == DIVERGED:
                self._runner.state = STOPPED
            elif running:
                self._runner.start()

    def set_shape(self, coordinates: Floats) -> None:
        """Set the body to coordinates (m,) of another engine of it, without velocity; tools stay.

        Raises
        ------
        InputError
            There are more or fewer coordinates, or one that is not finite.
        RuntimeError
            The engine runs.
        """
        coordinates = np.asarray(coordinates, dtype=float)
        if coordinates.shape != self._rest.shape or not np.isfinite(coordinates).all():
            raise InputError(
                f"coordinates must be {len(self._rest)} finite numbers, got {brief(coordinates)}; use those of an "
                "engine of the same body"
            )
        with self._lock:
            if self._runner.state == RUNNING:
                raise RuntimeError("the engine must be paused for set_shape, got a running one; call pause() first")
            self._work.q[:], self._work.v[:] = coordinates, 0.0
            first = record_size(0, len(self._work.tool))
            self._work.record[first : first + len(coordinates)] = coordinates
            publish(self._channels.record, self._work.record)

    def exchange(self, data: Any) -> None:
        """Swap the data: former name of `swap_data`."""
        warn_renamed("Engine.exchange", "Engine.swap_data")
        self.swap_data(data)

    def swap_data(self, data: Any) -> None:
        """Replace the data of the model between two periods; state, statistics and pose stay.

        Parameters
        ----------
        data : any type that Numba supports
            Of the same types as the data before.
        """
        with self._lock:
            advance = self._model.advance
            if self._cutter is not None and not isinstance(self._model, InstrumentedModel):
                advance = self._cutter.advance  # with cuts from the first blade on
            _, _, stored = loop_arguments(advance, self._model.stiffness, data)
            self._is_swapping = self._runner.state == RUNNING
            if self._is_swapping:
                self._runner.stop(PAUSED)
            self._runner.swap_loop(partial(self._loop, stored, self._work, self._channels, self._settings))
            if self._is_swapping and self._runner.state == PAUSED:
                self._runner.start()
            self._is_swapping = False

    @contextmanager
    def _between_periods(self) -> Iterator[None]:
        """Pause a running engine within a context."""
        with self._lock:
            running = self._runner.state == RUNNING
            self.pause()
            try:
                yield
            finally:
                if running and self._runner.state == PAUSED:
                    self._runner.start()

    def _cutter_lock(self) -> Any:
        """Return a context in which nothing is cut."""
        return nullcontext() if self._cutter is None else self._cutter.lock

    def _cut(self) -> None:
        """Cut the body up to where the blade is, once."""
        if self._runner.state != RUNNING or self._cutter is None:
            return
        with self._cutter.lock:
            record, first = snapshot(self._channels.record), record_size(0, len(self._work.tool))
            data = self._cutter.update(record[first : first + len(self._rest)])
            if data is not None:
                self.swap_data(data)

    def _to_rest(self) -> None:
        self._work.reset(self._rest)
        for t in range(len(self._last_poses)):
            self._publish_pose(t, IDENTITY_POSE, 0)
        publish(self._channels.record, self._work.record)

    def _publish_pose(self, tool: int, pose: Floats, sequence: int) -> None:
        self._last_poses[tool] = pose
        if self._shared_name is None:  # a slot has one writer
            publish(self._channels.pose_slot(tool), np.append(pose, float(sequence)))

    def _index_of(self, tool: int | str) -> int:
        """Return the index of a tool by its index or name."""
        if isinstance(tool, str) and tool in self._tool_names:
            return self._tool_names.index(tool)
        if isinstance(tool, int) and not isinstance(tool, bool) and 0 <= tool < len(self._last_poses):
            return tool
        named = ", ".join(f"{t} ({name!r})" for t, name in enumerate(self._tool_names))
        raise InputError(f"tool must be the number or name of a tool, got {brief(tool)}; use one of {named}")

    def _require_own_poses(self) -> None:
        if self._shared_name is not None:
            raise InputError(
                f"poses must come through the shared memory {self._shared_name!r}, got one of this program; start the "
                "engine without shared_memory"
            )

    def set_pose(
        self,
        position: Sequence[float] | Floats,
        quaternion: Sequence[float] | Floats = (1.0, 0.0, 0.0, 0.0),
        sequence: int = 0,
        tool: int | str = 0,
    ) -> None:
        """Request a pose of a tool, which follows it at the engine's largest speeds, or as `follow_evenly` states.

        Parameters
        ----------
        position : (3,) [m]
            Displacement of the tool's reference point from rest.
        quaternion : (4,), w x y z
            Rotation about the reference point; normalised.
        sequence : int
            Number of the pose, at least 0; `Reading.sequence` returns the number of the pose that a force includes.
        tool : int or str
            Number of the tool, in the order of `palpate.realtime_model`, or its name.

        Raises
        ------
        InputError
            The pose is not finite, the quaternion is zero, the position is more than a metre from the last one, or the
            sequence number is negative. The last pose is kept. Or there is no such tool, or the engine has
            `shared_memory`.
        """
        sequence, index = integer_in_range("sequence", sequence, 0), self._index_of(tool)
        self._require_own_poses()
        with self._lock:
            self._publish_pose(index, normalise_pose(position, quaternion, self._last_poses[index]), sequence)

    def place_tool(
        self,
        position: Sequence[float] | Floats,
        quaternion: Sequence[float] | Floats = (1.0, 0.0, 0.0, 0.0),
        sequence: int = 0,
        tool: int | str = 0,
    ) -> None:
        """Move a tool to a pose at once, as if it were lifted off and put down again; see `set_pose`.

        A model that stores its tool's previous pose must be updated as well.

        Raises
        ------
        InputError
            The pose is not finite, the quaternion is zero, the sequence number is negative, or there is no such tool.
        RuntimeError
            The engine runs.
        """
        sequence, index = integer_in_range("sequence", sequence, 0), self._index_of(tool)
        self._require_own_poses()
        with self._lock:
            if self._runner.state == RUNNING:
                raise RuntimeError("the engine must be paused for place_tool, got a running one; call pause() first")
            pose = normalise_pose(position, quaternion, None)
            self._work.place_tool(index, pose)
            self._work.record[record_size(0, index) + SEQUENCE] = sequence
            self._work.record[field_offset("sequence")] = self._work.record[HEADER_SIZE + SEQUENCE]
            self._publish_pose(index, pose, sequence)
            publish(self._channels.record, self._work.record)

    def follow_evenly(self, seconds: float, speed: float = math.inf, tool: int | str = 0) -> None:
        """Move a tool to each new pose evenly, in the time since the pose before.

        A pointer of a computer sends some 60 poses a second. A tool that reaches each at the largest speed moves in
        jerks, which are faster than the hand.

        Parameters
        ----------
        seconds : float [s]
            Longest time in which it reaches a pose; 0 to reach it at the largest speed.
        speed : float [m/s]
            Largest speed of this tool, where it is less than the engine's `max_speed`.

        Raises
        ------
        InputError
            A number is out of range, or there is no such tool.
        """
        index, seconds = self._index_of(tool), number_in_range("seconds", seconds, 0.0, 1.0, unit="s")
        if speed != math.inf:
            speed = number_in_range("speed", speed, 0.0, open_low=True, unit="m/s")
        follow = self._work.follow[index]
        follow[MAX_PERIODS], follow[LARGEST_WAY] = round(seconds / self.period), speed * self.period

    def slow_down(self, factor: float) -> None:
        """Slow model time and the speeds of the tool by a factor.

        Parameters
        ----------
        factor : float
            Model time per wall-clock time, from 0.001 to 1.

        Raises
        ------
        InputError
            The factor is out of range.
        """
        factor = number_in_range("factor", factor, MIN_TIME_SCALE, 1.0)
        with self._between_periods():
            self._work.time[TIME_SCALE] = factor

    def set_modulus_ratio(self, ratio: float) -> None:
        """Multiply all moduli of an adjustable model at constant density; a running engine continues.

        The moduli change gradually, by at most a factor of e in 0.2 s of model time, and vibrations with them: they
        decay in the same number of their own periods. The springs of foundations scale like the moduli. The factor is
        exact for every law without relaxation times: M x'' = s f(x) in t is M x'' = f(x) in sqrt(s) t.

        Parameters
        ----------
        ratio : float
            Of the moduli to those of the model, from 0.1 to 10.

        Raises
        ------
        InputError
            The ratio is out of range, or the model is not adjustable.

        Examples
        --------
        >>> import palpate as pt
        >>> cloud = pt.box((0.03, 0.03, 0.015), spacing=0.005)
        >>> tissue = pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1060, poisson=0.45)
        >>> ball = pt.tools.Contact(pt.tools.Sphere(radius=0.01), (0.015, 0.015, 0.026))
        >>> block = pt.realtime_model(pt.Solid(cloud, tissue, fixed="z-"), contact=ball)
        >>> with pt.Engine(block, adjustable=True) as engine:
        ...     engine.set_modulus_ratio(1.5)  # 3 kPa in place of 2 kPa
        """
        if not hasattr(self._model, "set_modulus_ratio"):
            raise InputError(
                "the engine must be adjustable for set_modulus_ratio, got one that is not; make it with adjustable=True"
            )
        with self._between_periods():
            self._model.set_modulus_ratio(ratio)

    def read(self) -> Reading:
        """Return the newest forces and state.

        Warns
        -----
        TrustWarning
            Once for an error indicator above 1, if `out_of_training` is ``"warn"``.
        RuntimeWarning
            The model's step raised an exception, or the black box could not be written.
        """
        record = snapshot(self._channels.record)
        worst = self._work.peaks[WORST_SINCE_RESET]
        if worst > 1 and not self._warned and self._settings.out_of_training == WARN:
            self._warned = True
            warnings.warn(
                f"the error indicator reached {worst:.3g}, above 1: the model was not trained on such states",
                TrustWarning,
                stacklevel=2,
            )
        error_text, self._runner.error_text = self._runner.error_text, ""
        if error_text:
            warnings.warn(error_text, RuntimeWarning, stacklevel=2)
        return Reading.from_record(record, self.state, len(self._last_poses), self._force_bound)

    def statistics(self) -> Statistics:
        """Return the deadline statistics since `start`."""
        return Statistics.from_histograms(self._channels.histograms, self.period)

    def dump(self, path: str | Path) -> None:
        """Write the black box, the records of all stored periods, to an HDF5 file atomically.

        Raises
        ------
        OSError
            The file cannot be written; the message names it.
        """
        self._write(path)

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()


def _check_system(black_box: str | Path | None) -> None:
    """Raise where the system lacks clocks, or the folder of a black box does not exist."""
    if not HAS_CLOCKS:
        raise RuntimeError("the system must have clock_gettime and nanosleep, got neither; use Linux, macOS or Windows")
    if black_box is not None and not Path(black_box).absolute().parent.is_dir():
        raise InputError(f"black_box must be in an existing folder, got {str(black_box)!r}; create its folder first")


def _max_backlog(model: Any) -> int:
    """Return the number of periods by which a model may be late and still take them all."""
    if not hasattr(model, "max_backlog") and hasattr(model, "catch_up"):
        warn_renamed("catch_up of a model of the engine", "max_backlog", stacklevel=4)
        return int(model.catch_up)
    return int(getattr(model, "max_backlog", 0))


def _adjustable(model: Any) -> InstrumentedModel:
    """Return a model whose moduli can be changed; raises InputError where they cannot."""
    if isinstance(model, InstrumentedModel):
        return model
    if not isinstance(model, RealtimeModel):
        raise InputError(
            f"model must be a nonlinear one of realtime_model to be adjustable, got {type(model).__name__}; "
            "leave out adjustable"
        )
    if model.relaxes:
        raise InputError(
            "the tissue must have no relaxation times to be adjustable, got one that relaxes; leave out adjustable"
        )
    return make_instrumented(model)


def _cut(reference: weakref.ref[Engine]) -> None:
    """Cut the body of an engine with its blade until nothing refers to the engine."""
    while (engine := reference()) is not None:
        engine._cut()
        del engine
        time.sleep(CUT_INTERVAL)
