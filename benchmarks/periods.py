"""Computing time of the periods of a liver that a ball presses in real time, with its contact stiffness and without.

    python benchmarks/periods.py out/train/model.rom [--seconds 4] [--rounds 3] [--every 50]

The same presses as in `palpate run liver --realtime`, one period after another without waiting, with and without in
turn, in one process. Times are those of the thread, so that what else the machine does shows less. Periods in which
nothing is touched are left out; the first press, in which code is compiled, is not counted.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit

PERIOD = 1e-3


def timed(advance: Any, stiffness: Any) -> Any:
    """Compile a period that returns how long its parts took [ns]."""
    from palpate.realtime.clock import thread_time

    @njit
    def period(data, q, v, target, report, out, ask, times):
        began = thread_time()
        advance(data, q, v, target, PERIOD, report)
        advanced = thread_time()
        if ask:
            stiffness(data, q, out)
        times[0], times[1] = advanced - began, thread_time() - advanced

    return period


def press(ready: Any, period: Any, hand: Any, periods: int, every: int) -> np.ndarray:
    """Step through presses; return times [ms] of the step and the stiffness, patches touched and whether asked."""
    from palpate.realtime.contract import tool_maps
    from palpate.realtime.pose import tool_coordinates

    q, v, report, out = ready.rest.copy(), np.zeros_like(ready.rest), np.zeros(20), np.zeros((12, 12))
    target, times, rows = np.zeros(12), np.zeros(2), np.zeros((periods, 4))
    for k in range(periods):
        place, turn = hand((k + 1) * PERIOD)
        tool_coordinates(tool_maps(ready.tool), np.concatenate([place, turn])[None], target)
        ask = every > 0 and k % every == 0
        period(ready.data, q, v, target, report, out, ask, times)
        rows[k] = 1e-6 * times[0], 1e-6 * times[1], ready.data.contact_work.numbers[0], ask
    return rows


def told(what: str, times: np.ndarray) -> str:
    numbers = "  ".join(f"{t:.3f}" for t in (*np.quantile(times, (0.5, 0.95, 0.99)), times.max()))
    return f"{what:<42}{len(times):>7}  {numbers}"


def main() -> None:
    """Measure, and print a table."""
    import palpate as pt
    from palpate.app.run.tool_motion import pressing_ball
    from palpate.scenes.open_scene import open_scene

    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("model", type=Path)
    parser.add_argument("--seconds", type=float, default=4.0)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--every", type=int, default=50)
    args = parser.parse_args()
    body = pt.load(args.model)
    hand, contact = pressing_ball(open_scene("liver"), body, args.model)
    ready = pt.realtime_model(body, contact=contact)
    period = timed(ready.advance, ready.stiffness)
    press(ready, period, hand, 2 * args.every, 1)
    found: dict[int, list[np.ndarray]] = {args.every: [], 0: []}
    for _ in range(args.rounds):
        for every, rows in found.items():
            rows.append(press(ready, period, hand, round(args.seconds / PERIOD), every))
    asked, bare = (np.concatenate(found[every]) for every in (args.every, 0))
    asked, bare = asked[asked[:, 2] > 0], bare[bare[:, 2] > 0]
    own = asked[asked[:, 3] > 0]
    print(f"{len(body.cloud)} nodes, {body.count} coordinates, {body.report['nodes']} sampled nodes;", end=" ")
    print(f"patches touched: {np.median(bare[:, 2]):.0f} in the median, {bare[:, 2].max():.0f} at most")
    print(f"{'[ms]':<42}{'periods':>7}  median  95 %  99 %  most")
    print(told("without the stiffness", bare[:, 0]))
    print(told(f"with it every {args.every} periods", asked[:, 0] + asked[:, 1]))
    print(told("of these, those in which it is asked for", own[:, 0] + own[:, 1]))
    print(told("what it adds to them", own[:, 1]))


if __name__ == "__main__":
    main()
