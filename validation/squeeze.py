"""Two balls squeeze a free block from opposite sides in the engine: forces against finite elements.

    python validation/squeeze.py [--spacings 0.005 0.004 0.003]

writes docs/validation/squeeze.json. The block is 60 mm wide, deep and high and held by nothing but two balls of 20 mm
radius, which go in by up to a tenth of that in 0.25 s and stay. Its middle plane stays plane, so that half of it, on a
smooth floor, is the block of contact_elements.py: FElupe's axisymmetric elements on a cylinder of the same area.
"""

from __future__ import annotations

import argparse

import numpy as np
import result_files
from contact import DEPTH, LAW, RADIUS, WIDTH
from contact_elements import Block, sphere

import palpate as pt
from palpate.realtime.period import Work

DEPTHS = (1e-3, 2e-3)  # [m] of each ball
FINE, REACH = 5e-4, 0.011  # [m] of the elements
PERIOD, PRESS_SECONDS, MEAN_SECONDS = 1e-3, 0.25, 0.1


def reference(depth: float, fine: float = FINE) -> float:
    """Return the force [N] on a ball by finite elements of a size [m]."""
    half = Block(np.sqrt(WIDTH**2 / np.pi), DEPTH, LAW, fine, REACH)
    X = half.points
    held = np.zeros(X.shape, bool)
    held[np.isclose(X[:, 0], 0), 0] = True  # the middle plane slides
    held[np.isclose(X[:, 1], 0), 1] = True
    half.free = np.flatnonzero(~held.ravel())
    return half.press(sphere(DEPTH + RADIUS - depth, RADIUS))


def squeezed(spacing: float, depth: float) -> list[float]:
    """Return the mean forces [N] of two balls that stay at a depth [m] in the block."""
    block = pt.Solid(pt.box((WIDTH, WIDTH, 2 * DEPTH), spacing), LAW, (), mass_damping=20.0)
    middle = WIDTH / 2
    places = (middle, middle, 2 * DEPTH + RADIUS), (middle, middle, -RADIUS)
    balls = [pt.tools.Contact(pt.tools.Sphere(RADIUS), at, name=f"ball {k}") for k, at in enumerate(places)]
    model = pt.realtime_model(block, contact=balls)
    work, forces = Work.at_rest(model.rest, model.tool), []
    for k in range(round((PRESS_SECONDS + 2 * MEAN_SECONDS) / PERIOD)):
        way = depth * min((k + 1) * PERIOD / PRESS_SECONDS, 1.0)
        work.target[2], work.target[14] = -way, way
        model.advance(model.data, work.q, work.v, work.target, PERIOD, work.report)
        forces.append((-work.report[10], work.report[22]))
    return np.mean(forces[-round(MEAN_SECONDS / PERIOD) :], axis=0).tolist()


def main() -> None:
    """Measure, and write the results."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--spacings", type=float, nargs="*", default=[0.005, 0.004, 0.003])
    options = parser.parse_args()
    rows = []
    for depth in DEPTHS:
        truth, coarse = reference(depth), reference(depth, 2 * FINE)
        for spacing in options.spacings:
            one, other = squeezed(spacing, depth)
            row = {"depth": depth, "spacing": spacing, "elements": truth, "elements_of_1_mm": coarse}
            rows.append(row | {"forces": [one, other], "error": (one + other) / (2 * truth) - 1})
            print(rows[-1], flush=True)
    result_files.write("squeeze", rows, "python validation/squeeze.py")


if __name__ == "__main__":
    main()
