"""Full bodies in real time: periods of the generated liver under a ball, on one processor core and on all."""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numba
import numpy as np

from palpate.app.common.console import Console
from palpate.compiled.jit import law_digest, law_njit
from palpate.core.arrays import Floats
from palpate.dynamics.contact.tools import Contact, Motion, Sphere
from palpate.dynamics.run.period_report import FORCES, STEPS
from palpate.dynamics.solid.model import EnergySolid
from palpate.meshfree.filling import fill
from palpate.realtime.bodies.model import RealtimeModel, realtime_model
from palpate.realtime.clock import now
from palpate.realtime.period import function_key
from palpate.scenes.organ import liver_surface
from palpate.tissue.materials import NeoHookean

BALL_RADIUS, PRESS_DEPTH = 0.02, 0.015  # [m]
START_GAP = 0.002  # [m] between ball and body before the press
PRESS_SECONDS, TIMED_PERIOD = 0.4, 1e-3  # [s] duration of a press, and of a period
SURFACE_SPACING, NODE_SPACING = 0.004, 0.009  # [m]


class PressedLiver:
    """The generated liver, held at its back, and a ball that presses it and leaves.

    Parameters
    ----------
    spacing : float [m]
    """

    def __init__(self, spacing: float) -> None:
        cloud = fill(liver_surface(SURFACE_SPACING), spacing=spacing)
        points = cloud.points
        cloud = cloud.with_group("back", points[:, 1] > np.quantile(points[:, 1], 0.85))
        self.body = EnergySolid(cloud, NeoHookean(C1=1.1e3, density=1060.0, poisson=0.45), "back")
        self.home = points[np.argmin(points[:, 1])] - np.array([0.0, BALL_RADIUS + START_GAP, 0.0])

    def ball(self, motion: Motion) -> Contact:
        """Return the ball with a motion."""
        return Contact(Sphere(BALL_RADIUS), motion)

    def displacement(self, time: float) -> Floats:
        """Return the displacement (3,) [m] of the ball at a time [s] of the press."""
        return np.array([0.0, (PRESS_DEPTH + START_GAP) * np.sin(np.pi * min(time / PRESS_SECONDS, 1.0)) ** 2, 0.0])

    def realtime(self, modes: int | None = None) -> RealtimeModel:
        """Return the body for the engine, with a number of modes that get more mass."""
        return realtime_model(self.body, contact=self.ball(tuple(self.home)), scaled_modes=modes)


class Periods(NamedTuple):
    """Wall times (p,) [s] of periods, forces (p, 3) [N] of the ball, and the number of steps."""

    seconds: Floats
    forces: Floats
    steps: int


def step_periods(liver: PressedLiver, model: RealtimeModel) -> Periods:
    """Step the periods of a press one after another in compiled code, without a clock."""
    q, v = np.zeros(len(model.rest)), np.zeros(len(model.rest))
    times = TIMED_PERIOD * np.arange(1, round(PRESS_SECONDS / TIMED_PERIOD) + 1)
    targets = np.zeros((len(times), 12))
    targets[:, :3] = [liver.displacement(t) for t in times]
    seconds, reports = np.zeros(len(times)), np.zeros((len(times), FORCES + 12))
    _stepper(model.advance)(model.data, q, v, targets, seconds, reports)
    return Periods(seconds, reports[:, FORCES : FORCES + 3], int(reports[:, STEPS].sum()))


@cache
def _stepper(advance: Any) -> Any:
    """Compile the steps through periods: a call from Python for each would cost a tenth of a period."""

    @law_njit(law_digest(__name__, function_key(advance)), nogil=True)
    def step(data, q, v, targets, seconds, reports):
        for k in range(targets.shape[0]):
            began = now()
            advance(data, q, v, targets[k], TIMED_PERIOD, reports[k])
            seconds[k] = 1e-9 * (now() - began)

    return step


def full_case(repeats: int, console: Console) -> dict[str, Any]:
    """Measure periods of the pressed liver on one thread and on all, in turn.

    The number of nodes in real time is that of a liver whose periods take a period in the mean. The cost of a body
    grows as the number of its nodes to the power 4/3, because its stable step shrinks with the spacing.
    """
    console.say(f"full liver, {1e3 * NODE_SPACING:g} mm: {repeats} presses on each number of threads ...")
    liver = PressedLiver(NODE_SPACING)
    nodes, most = len(liver.body.cloud), numba.get_num_threads()
    seconds: dict[int, list[Floats]] = {threads: [] for threads in sorted({1, most})}
    for _ in range(repeats):
        for threads, rounds in seconds.items():
            numba.set_num_threads(threads)
            rounds.append(step_periods(liver, liver.realtime()).seconds)
    numba.set_num_threads(most)
    return {"nodes": nodes, "spacing": NODE_SPACING, "threads": [_summary(t, r, nodes) for t, r in seconds.items()]}


def _summary(threads: int, rounds: list[Floats], nodes: int) -> dict[str, float]:
    mean = float(np.median([each.mean() for each in rounds]))
    return {
        "threads": threads,
        "mean_seconds": mean,
        "median_seconds": float(np.median(np.concatenate(rounds))),
        "seconds_99": float(np.quantile(np.concatenate(rounds), 0.99)),
        "nodes_in_real_time": nodes * (TIMED_PERIOD / mean) ** 0.75,
    }
