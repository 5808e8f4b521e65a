"""Period of a full liver in the engine under a ball, and its force against that of `rollout`.

    python benchmarks/full_body.py [--spacing 0.009]

A ball of 20 mm presses the generated liver by 15 mm in 0.2 s and leaves it. Periods of 1 ms follow each other without
a clock. The force is compared in means over 10 ms, over the largest.
"""

from __future__ import annotations

import argparse
from time import perf_counter

import numpy as np

import palpate as pt
from palpate.scenes.organ import liver_surface

RADIUS, DEPTH, DURATION, PERIOD = 0.02, 0.015, 0.4, 1e-3  # [m], [m], [s], [s]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--spacing", type=float, default=0.009, help="distance of the nodes [m]")
    cloud = pt.fill(liver_surface(0.004), spacing=parser.parse_args().spacing)
    points = cloud.points
    cloud = cloud.with_group("back", points[:, 1] > np.quantile(points[:, 1], 0.85))
    body = pt.Solid(cloud, pt.materials.NeoHookean(C1=1.1e3, density=1060.0, poisson=0.45), "back")
    home = points[np.argmin(points[:, 1])] - np.array([0.0, RADIUS + 0.002, 0.0])

    def displacement(time: float) -> np.ndarray:
        return np.array([0.0, (DEPTH + 0.002) * np.sin(np.pi * min(time / DURATION, 1.0)) ** 2, 0.0])

    def ball(motion: object) -> pt.tools.Contact:
        return pt.tools.Contact(pt.tools.Sphere(RADIUS), motion)

    made = pt.realtime_model(body, contact=ball(tuple(home)))
    q, v, report = np.zeros(len(made.rest)), np.zeros(len(made.rest)), np.zeros(20)
    made.advance(made.data, q, v, np.zeros(12), PERIOD, report)  # compiles
    forces, seconds, steps = [], [], 0
    for k in range(round(DURATION / PERIOD)):
        target = np.concatenate([displacement((k + 1) * PERIOD), np.zeros(9)])
        began = perf_counter()
        made.advance(made.data, q, v, target, PERIOD, report)
        seconds.append(perf_counter() - began)
        forces.append(report[8:11].copy())
        steps += int(report[2])
    run = pt.rollout(body, [ball(lambda t: tuple(home + displacement(t)))], duration=DURATION, every=0.01)
    expected = run.reactions["tool"][1:]
    missed = np.abs(np.array(forces).reshape(len(expected), -1, 3).mean(axis=1) - expected) / np.abs(expected).max()
    print(f"{len(cloud):,} nodes, {1e3 * steps / len(seconds):.0f} steps a second")
    print(
        f"period: mean {1e3 * np.mean(seconds):.2f}, median {1e3 * np.median(seconds):.2f}, 99 % "
        f"{1e3 * np.quantile(seconds, 0.99):.2f} ms; time over real time {PERIOD / max(np.mean(seconds), PERIOD):.2f}"
    )
    print(f"force against rollout: mean {100 * missed.mean():.2f} %, largest {100 * missed.max():.2f} %")


if __name__ == "__main__":
    main()
