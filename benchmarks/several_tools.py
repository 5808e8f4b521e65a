"""Computing time of periods under a ball: alone, and with other tools that touch nothing, of full and reduced bodies.

    python benchmarks/several_tools.py [MODEL.rom] [--rounds 5] [--seconds 0.6]

Without a model the body is the generated liver of `benchmarks/pressed_liver.py`. The cases take turns in one process,
with the processor time of the thread; ratios are those of the medians of a round. `--alone` measures the ball alone,
also with commits that take one tool.
"""

from __future__ import annotations

import argparse
from typing import Any

import numpy as np
from numba import njit

PERIOD, DEPTH, GAP = 1e-3, 0.006, 5e-4


def timed(advance: Any) -> Any:
    """Compile the steps through periods; the times are those of the thread [ns]."""
    from palpate.realtime.clock import thread_time

    @njit
    def step(data, q, v, targets, report, times):
        for k in range(targets.shape[0]):
            began = thread_time()
            advance(data, q, v, targets[k].copy(), PERIOD, report)
            times[k] = thread_time() - began

    return step


def prepared(body: Any, tools: int) -> Any:
    """Return a body with a ball on the free side, and with other tools that are put away."""
    import palpate as pt

    points = body.cloud.points
    fixed = np.concatenate([body.cloud.group(group) for group in body.fixed])
    inward = points[fixed].mean(axis=0) - points.mean(axis=0)
    inward /= np.linalg.norm(inward)
    top = points[np.argmin(points @ inward)]
    radius = max(0.015, 2 * body.cloud.spacing)
    home = top - (radius + GAP) * inward
    sphere = pt.tools.Sphere(radius)
    if tools == 0:  # as before several tools were possible
        return pt.realtime_model(body, contact=pt.tools.Contact(sphere, tuple(home))), inward
    from palpate.realtime.bodies.model import idle_model

    ready = idle_model(body, tools=tools)
    ready.change_tool(sphere, np.array([*home, 1.0, 0.0, 0.0, 0.0]), 0.0, 0)
    return ready, inward


def main() -> None:
    """Measure, and print a table."""
    from pressed_liver import PressedLiver

    import palpate as pt

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model", nargs="?")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--seconds", type=float, default=0.6)
    parser.add_argument("--alone", action="store_true")
    args = parser.parse_args()
    body = pt.load(args.model) if args.model else PressedLiver(0.009).body
    counts = [0] if args.alone else [0, 1, 2, 4]
    periods, medians = round(args.seconds / PERIOD), []
    bodies = [prepared(body, count) for count in counts]
    step = timed(bodies[0][0].advance)
    for _ in range(args.rounds + 1):  # the first compiles
        row = []
        for (ready, inward), count in zip(bodies, counts, strict=True):
            targets, report = np.zeros((periods, 12 * max(count, 1))), np.zeros(8 + 12 * max(count, 1))
            shares = np.sin(np.pi * np.arange(1, periods + 1) / periods) ** 2
            targets[:, :3] = (DEPTH + GAP) * shares[:, None] * inward
            times = np.zeros(periods)
            step(ready.data, ready.rest.copy(), np.zeros_like(ready.rest), targets, report, times)
            row.append(1e-6 * np.median(times))
        medians.append(row)
    table = np.array(medians[1:])
    for k, count in enumerate(counts):
        name = "a ball" if count == 0 else f"a ball in one of {count} places for tools"
        ratio = np.median(table[:, k] / table[:, 0])
        print(f"{name:<42}{np.median(table[:, k]):8.4f} ms   {ratio:.3f} of the ball alone")


if __name__ == "__main__":
    main()
