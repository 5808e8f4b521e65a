"""Stress-free shapes of organs that were scanned under gravity: how far their equilibrium is from the scan.

    python validation/unloaded.py [--only NAME ...]

The organs and their supports are those of elements.py, at about 3,000 nodes. Their shear moduli let an organ sag by
some tenths of its size at most; livers of 3.2 kPa, held on one side alone, have no stress-free shape under all of
gravity. Gravity acts along three axes in turn, as on a patient on the back, on the side and upright. For comparison the
scan is deformed by the opposite of gravity in one pass, which is taken for the stress-free shape by some. Rows are
printed in Markdown; docs/howto/unloaded.md has their range.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from time import perf_counter

import numpy as np
from elements import body_of, cloud_of
from elements_cases import case

import palpate as pt

ORGANS = {"kidney": 3200.0, "liver": 12800.0, "lobes": 12800.0}  # shear moduli [Pa]
GRAVITY = 9.81  # [m/s^2]


def largest(field: np.ndarray) -> float:
    """Return the largest length [m] of nodal vectors."""
    return float(np.linalg.norm(field, axis=1).max())


def row(name: str, body: pt.Solid, axis: int) -> str:
    """Return the row of an organ under gravity along an axis."""
    weight = [pt.Gravity(-GRAVITY * np.eye(3)[axis])]
    start = perf_counter()
    try:
        rest = pt.unloaded(body, weight)
    except pt.DivergenceError as error:
        return f"| {name}, {'xyz'[axis]} | {len(body.cloud)} | {error} |"
    seconds, sag = perf_counter() - start, largest(rest.displacements)
    opposite = pt.equilibrium(body, [pt.Gravity(GRAVITY * np.eye(3)[axis])]).displacements
    pass_ = body.moved(opposite)
    once = largest(pass_.cloud.points + pt.equilibrium(pass_, weight).displacements - body.cloud.points)
    return (
        f"| {name}, {'xyz'[axis]} | {len(body.cloud)} | {1e3 * sag:.1f} | {100 * once / sag:.1f} | "
        f"{100 * rest.distance / sag:.3f} | {rest.iterations} | {seconds:.0f} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", choices=list(ORGANS), default=list(ORGANS), metavar="NAME")
    print(
        "| organ, gravity along | nodes | largest displacement [mm] | one pass [%] | distance [%] | steps | time [s] |"
    )
    print("|---|---|---|---|---|---|---|")
    for name in parser.parse_args().only:
        it = replace(case(name), c1=ORGANS[name] / 2)
        body = body_of(it, cloud_of(it, it.spacing, 0))
        for axis in range(3):
            print(row(name, body, axis), flush=True)


if __name__ == "__main__":
    main()
