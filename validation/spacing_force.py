"""Force under a tool on organs of real-time spacing and of finer ones: the error that a coarse spacing makes.

A ball presses four livers at two places by a tenth of their thickness along the inward normal in 0.3 s, and stays until
the mean force over 50 ms changes by less than 1 %, at most 1.5 s. The side behind is fixed. The same ball presses the
same place of the same surface filled with nodes half as far apart.

    python validation/spacing_force.py [--only NAME ...] [--nodes 3000] [--finer 2]

It adds a row a place to docs/validation/spacing_force.json; docs/claims/organ_force.md has the table.
"""

from __future__ import annotations

import argparse
from time import perf_counter
from typing import Any

import numpy as np
import result_files
from organs import DATA, spacing_for, surface

import palpate as pt

LIVERS = ("generated", "HRA female 12k", "SOFA smooth", "SOFA vtk")
RADIUS, DEPTH = 0.17, 0.1  # of the ball, over the cube root of the volume; of the press, over the thickness there
PRESSED, SHORTEST, LONGEST = 0.3, 0.6, 1.8  # [s] until the press ends; of all, until the force no longer drifts
MEAN, PERIOD, MAX_DRIFT = 0.05, 1e-3, 0.01  # [s] of a mean of the force, of a period; change of the mean
OUTWARD = ((0.0, -1.0, 0.0), (0.277, -0.833, 0.479))  # sides that are pressed: the front, and that of the page's camera
HELD = 0.12  # share of the extent along the press that is fixed
MASS_DAMPING = 16.0  # [1/s], critical for the slowest vibration of a liver
START = 0.1  # distance of the ball at the start, over the depth


def thickness(body: pt.Surface, point: np.ndarray, direction: np.ndarray) -> float:
    """Return the length [m] of the line from a surface point in a direction to where it first leaves the body."""
    corners = body.vertices[body.triangles]
    a, e, f = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    p = np.cross(direction, f)
    scale = np.einsum("ta,ta->t", e, p)
    with np.errstate(all="ignore"):
        s = point - a
        u = np.einsum("ta,ta->t", s, p) / scale
        q = np.cross(s, e)
        v = q @ direction / scale
        length = np.einsum("ta,ta->t", f, q) / scale
        inside = (u >= 0) & (v >= 0) & (u + v <= 1)
    hit = inside & (length > 0.02 * body.size) & np.isfinite(length)
    return float(length[hit].min())


def place(body: pt.Surface, outward: tuple[float, float, float]) -> tuple[np.ndarray, np.ndarray]:
    """Return the surface point that is farthest in a direction, and the inward normal there."""
    direction = np.array(outward) / np.linalg.norm(outward)
    return body.vertices[np.argmax(body.vertices @ direction)], -direction


def press(cloud: pt.Cloud, point: np.ndarray, direction: np.ndarray, radius: float, depth: float) -> dict[str, Any]:
    """Return force [N] along the press, its change over the last two means, and the time that the steps took."""
    heights = cloud.points @ direction
    held = heights > heights.max() - HELD * np.ptp(heights)
    law = pt.materials.NeoHookean(C1=1.1e3, density=1060.0, poisson=0.45)
    body = pt.Solid(cloud.with_group("held", held), law, "held", mass_damping=MASS_DAMPING)
    home = point - direction * (radius + START * depth)
    made = pt.realtime_model(body, contact=pt.tools.Contact(pt.tools.Sphere(radius), tuple(home)))
    q, v, report = np.zeros(len(made.rest)), np.zeros(len(made.rest)), np.zeros(20)
    forces, began, last, drift = [], perf_counter(), round(MEAN / PERIOD), np.inf
    for k in range(round(LONGEST / PERIOD)):
        share = np.sin(0.5 * np.pi * min((k + 1) * PERIOD / PRESSED, 1.0)) ** 2
        target = np.concatenate([direction * share * (1 + START) * depth, np.zeros(9)])
        made.advance(made.data, q, v, target, PERIOD, report)
        forces.append(report[8:11] @ direction)
        if (k + 1) * PERIOD >= SHORTEST - 1e-9 and (k + 1) % last == 0:
            drift = np.mean(forces[-last:]) / np.mean(forces[-2 * last : -last]) - 1
            if abs(drift) < MAX_DRIFT:
                break
    return {"force": np.mean(forces[-last:]), "drift": drift, "seconds": perf_counter() - began}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="+", default=list(LIVERS))
    parser.add_argument("--nodes", type=int, default=3000)
    parser.add_argument("--finer", type=float, default=2.0, help="spacing over the finer one")
    options = parser.parse_args()
    rows = result_files.read("spacing_force", [])
    for name in options.only:
        if name != "generated" and not DATA.is_dir():
            print(f"{name} left out: there is no folder {DATA}")
            continue
        body = surface(name)
        spacing = spacing_for(body, options.nodes)
        clouds = [pt.fill(body, spacing / finer) for finer in (1.0, options.finer)]
        radius = RADIUS * np.cbrt(body.volume)
        for side, (point, direction) in enumerate(place(body, outward) for outward in OUTWARD):
            depth = DEPTH * thickness(body, point, direction)
            coarse, fine = (press(cloud, point, direction, radius, depth) for cloud in clouds)
            row = {
                "organ": name, "side": side, "nodes": [len(cloud) for cloud in clouds], "radius": float(radius),
                "depth": float(depth), "spacing": float(spacing),
                "force": [float(each["force"]) for each in (coarse, fine)],
                "drift": [float(each["drift"]) for each in (coarse, fine)],
                "seconds": [each["seconds"] for each in (coarse, fine)],
            }  # fmt: skip
            rows = [each for each in rows if (each["organ"], each["side"]) != (name, side)] + [row]
            print(row, flush=True)
            result_files.write("spacing_force", rows)


if __name__ == "__main__":
    main()
