"""A hand that holds a tool by a spring and a damper: the energy that it gets back is never more than what it gave.

    python validation/virtual_coupling.py model.rom 300

The model is one that tools touch, such as `palpate train liver` makes. The ball is pressed in and drawn out, faster and
faster, at 1 kHz of the body's time; after every period the books are balanced.
"""

from __future__ import annotations

import sys

import numpy as np

import palpate as pt
from palpate.realtime.watched import DAMPING, HAND, MASS, STIFFNESS, watched

PERIOD, LASTING, RADIUS, DEPTH, GAP = 1e-3, 4.0, 0.02, 0.008, 0.002  # [s], [s], [m], [m], [m]


def balance(model: pt.ReducedModel, stiffness: float, radius: float = RADIUS, depth: float = DEPTH) -> dict:
    """Press a body through a coupling [N/m]; return work and energies (t,) [J] after every period."""
    cloud = model.cloud
    fixed = np.concatenate([cloud.group(name) for name in model.fixed])
    free = np.setdiff1d(pt.tools.surface_nodes(cloud), fixed)
    along = cloud.points - cloud.points[fixed].mean(axis=0)
    first = free[np.argmax(np.linalg.norm(along[free], axis=1))]  # the place farthest from the support
    normal = cloud.face_normals[cloud.face_nodes == first].sum(axis=0)
    normal /= np.linalg.norm(normal)
    home = cloud.points[first] + (radius + GAP) * normal
    body = watched(pt.realtime_model(model, contact=pt.tools.Contact(pt.tools.Sphere(radius), home, friction=0.2)))
    body.couple(stiffness)
    data, q, v, report, hand = body.data, body.rest.copy(), np.zeros_like(body.rest), np.zeros(20), np.zeros(3)
    work, books = 0.0, {"work": [], "body": [], "coupling": []}
    for k in range(round(LASTING / PERIOD)):
        time = (k + 1) * PERIOD
        wanted = -(depth + GAP) * np.sin(np.pi * (time + time**2)) ** 2 * normal
        body.advance(data, q, v, np.concatenate([wanted, np.zeros(9)]), PERIOD, report)
        if report[0] != 0.0:
            raise SystemExit("the state ran away")
        work -= data.numbers[HAND : HAND + 3] @ (wanted - hand)  # of the hand on the coupling
        hand = wanted
        spring = 0.5 * data.spring[STIFFNESS] * np.sum((hand - data.place) ** 2)
        moving = 0.5 * data.spring[MASS] * np.sum(data.speed**2)
        for name, value in (("work", work), ("body", report[3] + report[4]), ("coupling", spring + moving)):
            books[name].append(value)
    return {name: np.array(values) for name, values in books.items()} | {"damping": data.spring[DAMPING]}


if __name__ == "__main__":
    books = balance(pt.load(sys.argv[1]), float(sys.argv[2]) if len(sys.argv) > 2 else 300.0)
    lost = books["work"] - books["body"] - books["coupling"]
    print(f"damping of the coupling {books['damping']:.3g} N s/m")
    print(f"largest energy in the body {1e3 * books['body'].max():.3g} mJ")
    print(
        f"work of the hand in the end {1e3 * books['work'][-1]:.3g} mJ, never below {1e3 * books['work'].min():.3g} mJ"
    )
    print(f"work less stored energy: never below {1e3 * lost.min():.3g} mJ, in the end {1e3 * lost[-1]:.3g} mJ")
    print("passive" if books["work"].min() > -1e-3 * books["body"].max() else "NOT passive")
