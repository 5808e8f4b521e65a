"""A sheet with a long cut whose two legs are pulled apart out of its plane; `cuts.py` runs it.

Grips turn the ends of the legs upright, and move one up and the other down. The sheet is free. A longer cut transfers
material from the sheet, which has no energy, to the legs, which are stretched by lambda and have the energy density W.
The bends at the front only move with it, so for legs of width b and thickness t

    G = 2 lambda F / t - 2 b W

(Rivlin and Thomas, J. Polym. Sci. 10, 1953). Stretch and W are measured in the middle of the legs. The other release
rate is the change of the energy with the length of the cut at fixed grips.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np

import palpate as pt
from palpate.core.arrays import Floats
from palpate.meshfree.cut.surface import swept

SPACING = 2.5e-3
SIZE = SPACING * np.array([48, 15, 3])
WIDTH, THICKNESS = 0.5 * SIZE[1], SIZE[2]  # of a leg
PLANE = WIDTH + 0.15 * SPACING  # between nodes
LENGTH = 29 * SPACING  # of the cut
MIDDLE = (8 * SPACING, 14 * SPACING)  # of the legs
INCREMENTS = 16  # of the motion of the grips, until the legs are upright and nearly straight
LARGEST_RISE = 10e-3  # [m] of the grips between two equilibria from then on
TISSUE = pt.materials.MooneyRivlin(C1=1e3, C2=0.0, poisson=0.45, density=1000.0)


def opened(body: pt.Solid, end: float) -> pt.Solid:
    """Cut the sheet from one end to a place [m]."""
    across = np.linspace(-3 * SPACING, THICKNESS + 3 * SPACING, 9)
    ends = np.array([-3 * SPACING, end])[:, None]
    return pt.cut(body, swept(np.stack(np.broadcast_arrays(ends, PLANE, across), axis=2)))


def grips(height: float, share: float) -> list[pt.PrescribedMotion]:
    """Grips after a share of their way to +-height [m]; the ends are upright after half of it."""

    def motion(side: float) -> Any:
        angle = min(2 * share, 1.0) * np.pi / 2

        def displacements(points: Floats, _: float) -> Floats:
            depth = points[:, 2] - 0.5 * THICKNESS
            x = side * depth * np.sin(angle) - points[:, 0]
            z = 0.5 * THICKNESS + side * height * share + depth * np.cos(angle) - points[:, 2]
            return np.column_stack([x, np.zeros_like(x), z])

        return displacements

    return [pt.PrescribedMotion("up", motion(1.0)), pt.PrescribedMotion("down", motion(-1.0))]


def leg(body: pt.Solid, u: Floats) -> tuple[float, float]:
    """Stretch of the middle of a leg, and its energy density [J/m^3]."""
    points, (first, last) = body.cloud.points, MIDDLE
    ends = [(points[:, 1] < WIDTH) & (np.abs(points[:, 0] - x) < 0.5 * SPACING) for x in MIDDLE]
    ways = [np.diff([field[end].mean(axis=0) for end in ends], axis=0) for field in (points + u, points)]
    within = (points[:, 1] < WIDTH) & (points[:, 0] > first) & (points[:, 0] < last)
    energies = body.evaluate(u).energy_density
    stretch = float(np.linalg.norm(ways[0]) / np.linalg.norm(ways[1]))
    return stretch, float(np.average(energies[within], weights=body.volumes[within]))


def trousers(jitter: float, heights: tuple[float, ...]) -> list[dict]:
    """Release rates at heights of the grips [m] from three lengths of the cut, a spacing apart."""
    begin = time.perf_counter()
    cloud = pt.box(SIZE, SPACING, jitter=jitter, seed=4)
    ends = cloud.group("x-")
    left = cloud.points[ends, 1] < WIDTH
    cloud = cloud.with_group("up", ends[left]).with_group("down", ends[~left])
    uncut = pt.Solid(cloud, TISSUE)
    bodies = [opened(uncut, LENGTH + k * SPACING) for k in (-1, 0, 1)]
    before = u = np.zeros((len(cloud), 3))
    for k in range(1, INCREMENTS + 1):
        state = pt.equilibrium(bodies[1], grips(heights[0], k / INCREMENTS), displacement=2 * u - before)
        before, u = u, state.displacements
    rows, present = [], heights[0]
    states = [pt.equilibrium(body, grips(present, 1.0), displacement=u) for body in bodies]
    for height in heights:
        while present < height - 1e-9:
            present = min(present + LARGEST_RISE, height)
            states = [
                pt.equilibrium(body, grips(present, 1.0), displacement=state.displacements)
                for body, state in zip(bodies, states, strict=True)
            ]
        first, middle, last = states
        u = middle.displacements
        stretch, density = leg(bodies[1], u)
        force = float(np.linalg.norm(middle.reactions["up"]))
        area = 2 * SPACING * THICKNESS
        row = {
            "jitter": jitter, "nodes": len(cloud), "height": height, "stretch": stretch, "force": force,
            "release": (first.strain_energy - last.strain_energy) / area,
            "legs": 2 * stretch * force / THICKNESS - 2 * WIDTH * density, "simple": 2 * force / THICKNESS,
            "seconds": time.perf_counter() - begin,
        }  # fmt: skip
        rows.append(row)
        print(
            f"trousers of jitter {jitter}, grips at {1e3 * height:.0f} mm: stretch {stretch:.3f}, force {force:.4f} N, "
            f"release {row['release']:.3f} J/m^2, legs {row['legs']:.3f}, 2 F / t {row['simple']:.3f}, "
            f"{row['seconds']:.0f} s", flush=True,
        )  # fmt: skip
    return rows
