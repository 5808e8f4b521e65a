"""The engine: a model stepped at a fixed rate against a tool, in a thread of its own."""

from __future__ import annotations

import math
import threading
import warnings
import weakref
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from palpate.describe import Described, Fact
from palpate.faults import InputError, integer_in_range, number_in_range
from palpate.realtime.blackbox import write_black_box
from palpate.realtime.clock import SUPPORTED
from palpate.realtime.contract import check_contract
from palpate.realtime.exchange import publish, snapshot
from palpate.realtime.loop import (
    CLAMP,
    PAUSED,
    RAN_AWAY,
    RUNNING,
    STOP,
    STOPPED,
    WARN,
    Channels,
    Settings,
    Work,
    loop_of,
)
from palpate.realtime.pose import IDENTITY, checked_pose
from palpate.realtime.row import Reading, offset
from palpate.realtime.runner import Runner
from palpate.realtime.statistics import Statistics

__all__ = ["Engine"]

Floats = NDArray[np.float64]

STATES = {RUNNING: "running", STOPPED: "stopped", PAUSED: "paused", RAN_AWAY: "ran away"}
ON_DISTRUST = {"warn": WARN, "clamp": CLAMP, "stop": STOP}
SLOWEST_RATE, FASTEST_RATE = 1e-6, 20_000.0  # [Hz]; a slower one's period overflows
LONGEST_HISTORY = 600.0  # [s]
SLOWEST = 1e-3  # body's time over time on the wall
LONGEST_SPIN = 1e-3  # [s]


def _settings(
    rate: float,
    force_limit: float,
    stiffness_every: int,
    on_distrust: str,
    most_speed: float,
    most_turn: float,
    spin: float,
) -> Settings:
    """Check the arguments of an engine, and return them as the loop needs them."""
    period = round(1e9 / number_in_range("rate", rate, SLOWEST_RATE, FASTEST_RATE, unit="Hz"))
    if on_distrust not in ON_DISTRUST:
        raise InputError(f"on_distrust = {on_distrust!r}: allowed are {', '.join(map(repr, ON_DISTRUST))}")
    if force_limit != math.inf:
        force_limit = number_in_range("force_limit", force_limit, 0, open_low=True, unit="N")
    return Settings(
        period=period,
        spin=round(1e9 * number_in_range("spin", spin, 0, LONGEST_SPIN, unit="s")),
        most_way=1e-9 * period * number_in_range("most_speed", most_speed, 0, open_low=True, unit="m/s"),
        most_angle=1e-9 * period * number_in_range("most_turn", most_turn, 0, open_low=True, unit="rad/s"),
        force_limit=float(force_limit),
        stiffness_every=integer_in_range("stiffness_every", stiffness_every, 0),
        on_distrust=ON_DISTRUST[on_distrust],
    )


class Engine(Described):
    """Steps a model at a fixed rate in its own thread, without holding Python's lock.

    The thread never runs Python code while it steps: it waits for a deadline, moves the tool towards the newest pose,
    advances the model by a period and publishes the forces. Where steps take longer than a period, periods are dropped
    and the body's time falls behind. On a system without clock_nanosleep (macOS) waits are less exact.

    Parameters
    ----------
    model : object
        What ``ReducedModel.realtime()`` returns; see `Realtime`.
    rate : float [Hz]
        Steps a second, above 0 (from a millionth on) and up to 20000.
    force_limit : float [N]
        Largest force reported.
    stiffness_every : int
        Periods between evaluations of the contact stiffness; 0 for never.
    history : float [s]
        What the black box keeps, up to 600 s.
    on_distrust : str
        What to do where the model says that it was not trained on the state: ``"warn"``: warn once, at a reading.
        ``"clamp"``: hold the tool where the model was last trusted, until trust is back and the pose comes back from
        beyond it. Where trust does not return within 50 ms, hold it further back on the way by which it came, and so
        on, at last where that way began: at rest, or where `place_tool` put the tool.
        ``"stop"``: pause; after `resume` go on until trust is lost anew.
    most_speed : float [m/s]
    most_turn : float [rad/s]
        How fast the tool follows a pose.
    spin : float [s]
        How long before each deadline the thread stops sleeping and watches the clock; up to 1 ms.
    black_box : path, optional
        Where to write the black box when the state runs away.

    Raises
    ------
    InputError
        An argument is out of range, or the model does not keep the contract.
    RuntimeError
        The system has no clocks for this (Windows).
    """

    def __init__(
        self,
        model: Any,
        rate: float = 1000.0,
        *,
        force_limit: float = math.inf,
        stiffness_every: int = 50,
        history: float = 5.0,
        on_distrust: str = "warn",
        most_speed: float = 2.0,
        most_turn: float = 10.0,
        spin: float = 50e-6,
        black_box: str | Path | None = None,
    ) -> None:
        if not SUPPORTED:
            raise RuntimeError("the engine needs clock_gettime and nanosleep: run it on Linux or macOS")
        model = check_contract(model)
        if black_box is not None and not Path(black_box).absolute().parent.is_dir():
            raise InputError(f"black_box = {str(black_box)!r}: its folder does not exist")
        history = number_in_range("history", history, 0, LONGEST_HISTORY, open_low=True, unit="s")
        self._settings = _settings(rate, force_limit, stiffness_every, on_distrust, most_speed, most_turn, spin)
        self.period = 1e-9 * self._settings.period
        self._rest, self._work = model.rest, Work.of(model.rest, model.tool)
        self._channels = Channels.of(len(model.rest), math.ceil(history / self.period))
        about = {"period": self.period, "coordinates": len(model.rest), "on_distrust": on_distrust}
        self._write = partial(write_black_box, ring=self._channels.ring, about=about)
        loop = loop_of(model.advance, model.stiffness)
        self._runner = Runner(
            partial(loop, model.data, self._work, self._channels, self._settings),
            self._channels.command,
            partial(self._write, black_box) if black_box is not None else None,
        )
        self._lock, self._last_pose, self._warned = threading.RLock(), IDENTITY, False
        self._to_rest()
        snapshot(self._channels.row)  # compiled here rather than in the first read, beside a loop that runs
        weakref.finalize(self, self._runner.end, STOPPED)  # when Python ends, or nobody refers to the engine any more

    def _facts(self) -> list[Fact]:
        row, statistics = snapshot(self._channels.row), self.statistics()
        return [
            ("state", self.state, ""),
            ("rate", 1 / self.period, "Hz"),
            ("coordinates", len(self._rest), ""),
            ("time", float(row[offset("time")]), "s"),
            ("trust", float(row[offset("trust")]), ""),
            ("rate held", statistics.held if statistics.count else None, ""),
            ("verdict", statistics.verdict, ""),
        ]

    @property
    def state(self) -> str:
        """``"stopped"``, ``"running"``, ``"paused"`` or ``"ran away"`` (once the black box is written)."""
        return STATES[self._runner.state]

    def start(self) -> None:
        """Step, from the state as it stands; from ``"stopped"`` the statistics begin anew.

        Raises
        ------
        InputError
            The state ran away and was not reset.
        """
        with self._lock:
            if self._runner.state == STOPPED:
                self._channels.tally.clear()
            self._go()

    def resume(self) -> None:
        """Step again after a pause; does nothing if the engine is stopped.

        Raises
        ------
        InputError
            The state ran away and was not reset.
        """
        with self._lock:
            if self._runner.state != STOPPED:
                self._go()

    def _go(self) -> None:
        if self._runner.state == RAN_AWAY:
            raise InputError("the state ran away; reset() the engine before it steps again")
        if self._runner.state != RUNNING:
            self._runner.go()

    def stop(self) -> None:
        """End the thread; the state is kept. Does nothing if the engine is stopped."""
        with self._lock:
            self._runner.end(STOPPED)

    def pause(self) -> None:
        """Stop stepping; state and statistics are kept. Does nothing if the engine is not running."""
        with self._lock:
            if self._runner.state == RUNNING:
                self._runner.end(PAUSED)

    def reset(self) -> None:
        """Put body and tool at rest, and time to 0; an engine that runs goes on, one that ran away is then stopped."""
        with self._lock:
            running = self._runner.state == RUNNING
            if running:
                self._runner.end(PAUSED)
            self._to_rest()
            if self._runner.state == RAN_AWAY:
                self._runner.state = STOPPED
            elif running:
                self._runner.go()

    def _to_rest(self) -> None:
        self._work.reset(self._rest)
        self._publish_pose(IDENTITY, 0)
        publish(self._channels.row, self._work.row)

    def _publish_pose(self, pose: Floats, sequence: int) -> None:
        self._last_pose = pose
        publish(self._channels.pose, np.append(pose, float(sequence)))

    def set_pose(
        self,
        position: Sequence[float] | Floats,
        quaternion: Sequence[float] | Floats = (1.0, 0.0, 0.0, 0.0),
        sequence: int = 0,
    ) -> None:
        """Tell where the tool is to be; it follows at no more than the engine's speeds.

        Parameters
        ----------
        position : (3,) [m]
            Of the tool's reference point, from where it stands at rest.
        quaternion : (4,), w x y z
            Rotation about the reference point; is made a unit quaternion.
        sequence : int
            Number of the pose, at least 0: `Reading.sequence` tells which pose a force answers.

        Raises
        ------
        InputError
            The pose is not of finite real numbers, the quaternion has no length, or the position is more than a metre
            from the last one; or the number is negative. The last pose is kept.
        """
        sequence = integer_in_range("sequence", sequence, 0)
        with self._lock:
            self._publish_pose(checked_pose(position, quaternion, self._last_pose), sequence)

    def place_tool(
        self,
        position: Sequence[float] | Floats,
        quaternion: Sequence[float] | Floats = (1.0, 0.0, 0.0, 0.0),
        sequence: int = 0,
    ) -> None:
        """Put the tool somewhere at once, as a hand does that lifts it off and sets it down; see `set_pose`.

        A model that goes on from where its tool was must be told, too.

        Raises
        ------
        InputError
            The pose is not of finite real numbers, the quaternion has no length, or the number is negative.
        RuntimeError
            The engine runs; pause it.
        """
        sequence = integer_in_range("sequence", sequence, 0)
        with self._lock:
            if self._runner.state == RUNNING:
                raise RuntimeError("the engine runs: pause() it before its tool is put elsewhere")
            pose = checked_pose(position, quaternion, None)
            self._work.place(pose)
            self._work.row[offset("sequence")] = sequence
            self._publish_pose(pose, sequence)
            publish(self._channels.row, self._work.row)

    def slow_down(self, factor: float) -> None:
        """Let the body's time go slower than the clock on the wall, and the tool follow poses as much more slowly.

        Parameters
        ----------
        factor : float
            Body's time over time on the wall, from 0.001 to 1.

        Raises
        ------
        InputError
            The factor is out of range.
        """
        factor = number_in_range("factor", factor, SLOWEST, 1.0)
        with self._lock:
            running = self._runner.state == RUNNING
            self.pause()
            self._work.clock[1] = factor
            if running and self._runner.state == PAUSED:
                self._runner.go()

    def read(self) -> Reading:
        """Return the newest forces and state.

        Warns
        -----
        RuntimeWarning
            Once, if the model said that it was not trained on a state, and `on_distrust` is ``"warn"``; and when the
            model's step failed, or the black box could not be written.
        """
        row = snapshot(self._channels.row)
        most = row[offset("worst_trust")]
        if most > 1 and not self._warned and self._settings.on_distrust == WARN:
            self._warned = True
            warnings.warn(
                f"the model was not trained on such states: its trust number reached {most:.3g}, above 1",
                RuntimeWarning,
                stacklevel=2,
            )
        trouble, self._runner.trouble = self._runner.trouble, ""
        if trouble:
            warnings.warn(trouble, RuntimeWarning, stacklevel=2)
        return Reading.of(row, self.state)

    def statistics(self) -> Statistics:
        """Return how the deadlines have been kept since `start`."""
        return Statistics.of(self._channels.tally, self.period)

    def dump(self, path: str | Path) -> None:
        """Write the black box to an HDF5 file, whole or not at all: time, pose, forces, trust and more of every period.

        Raises
        ------
        OSError
            The file cannot be written; names it.
        """
        self._write(path)

    def __enter__(self) -> Self:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
