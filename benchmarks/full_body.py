"""Period of a full liver in the engine under a ball, and its force against that of `rollout`.

    python benchmarks/full_body.py [--spacing 0.009]

A ball of 20 mm presses the generated liver by 15 mm in 0.2 s and leaves it. Periods of 1 ms follow each other without
a clock. The force is compared in means over 10 ms, over the largest.
"""

from __future__ import annotations

import argparse

import numpy as np
from pressed_liver import PRESS_SECONDS, TIMED_PERIOD, PressedLiver, step_periods

import palpate as pt


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--spacing", type=float, default=0.009, help="distance of the nodes [m]")
    liver = PressedLiver(parser.parse_args().spacing)
    seconds, forces, steps = step_periods(liver, liver.realtime())
    path = liver.ball(lambda t: tuple(liver.home + liver.displacement(t)))
    run = pt.rollout(liver.body, [path], duration=PRESS_SECONDS, every=0.01)
    expected = run.reactions["tool"][1:]
    missed = np.abs(forces.reshape(len(expected), -1, 3).mean(axis=1) - expected) / np.abs(expected).max()
    print(f"{len(liver.body.cloud):,} nodes, {1e3 * steps / len(seconds):.0f} steps a second")
    print(
        f"period: mean {1e3 * np.mean(seconds):.2f}, median {1e3 * np.median(seconds):.2f}, 99 % "
        f"{1e3 * np.quantile(seconds, 0.99):.2f} ms; time over real time "
        f"{TIMED_PERIOD / max(np.mean(seconds), TIMED_PERIOD):.2f}"
    )
    print(f"force against rollout: mean {100 * missed.mean():.2f} %, largest {100 * missed.max():.2f} %")


if __name__ == "__main__":
    main()
