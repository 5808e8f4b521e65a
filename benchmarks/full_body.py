"""Period of a full liver in the engine under a ball, and its force against that of `rollout`.

    python benchmarks/full_body.py [--spacing 0.009]
    NUMBA_NUM_THREADS=1 python benchmarks/full_body.py --modes 0 20 40 [--rounds 7]

A ball of 20 mm presses the generated liver by 15 mm in 0.2 s and leaves it. Periods of 1 ms follow each other without
a clock. The force is compared in means over 10 ms, over the largest, and a step with one of `rollout` by wall time.
With `--modes` the same presses are taken in turn with numbers of modes that get more mass, and their processor times
are compared.
"""

from __future__ import annotations

import argparse
from time import process_time

import numpy as np
from pressed_liver import PRESS_SECONDS, TIMED_PERIOD, PressedLiver, step_periods

import palpate as pt


def compare_modes(liver: PressedLiver, modes: list[int], rounds: int) -> None:
    """Print steps and processor time of presses with numbers of modes, over those with the first number."""
    times, steps = np.zeros((rounds, len(modes))), np.zeros(len(modes))
    step_periods(liver, liver.realtime(modes[0]))  # compiles
    for k in range(rounds):
        for j, count in enumerate(modes):
            model, began = liver.realtime(count), process_time()
            steps[j] = step_periods(liver, model).steps
            times[k, j] = process_time() - began
    print(f"{len(liver.body.cloud):,} nodes, {rounds} rounds in turn")
    for j, count in enumerate(modes):
        ratios = times[:, j] / times[:, 0]
        print(
            f"{count} modes: {steps[j]:.0f} steps, {steps[0] / steps[j]:.2f} times as long; a press takes "
            f"{np.median(ratios):.2f} of the time (median; {ratios.min():.2f} to {ratios.max():.2f})"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--spacing", type=float, default=0.009, help="distance of the nodes [m]")
    parser.add_argument("--modes", type=int, nargs="+", help="numbers of modes that get more mass")
    parser.add_argument("--rounds", type=int, default=7, help="presses with each number of modes")
    args = parser.parse_args()
    liver = PressedLiver(args.spacing)
    if args.modes:
        compare_modes(liver, args.modes, args.rounds)
        return
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
    step, expected_step = np.sum(seconds) / steps, run.wall_seconds / run.steps[-1]
    print(f"a step of the engine takes {step / expected_step:.2f} of the time of a step of rollout with the same ball")
    print(f"force against rollout: mean {100 * missed.mean():.2f} %, largest {100 * missed.max():.2f} %")


if __name__ == "__main__":
    main()
