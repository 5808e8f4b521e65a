"""A small block that a ball presses, for sessions."""

from __future__ import annotations

import numpy as np

import palpate as pt
from palpate.scenes.load_case import TrainingScene

SIZE, SPACING, BALL, DEPTH = (0.048, 0.048, 0.024), 0.006, 0.015, 0.004
MIDDLE = np.array([0.024, 0.024, SIZE[2]])
PRESS_SECONDS, EVERY = 0.12, 0.005


def press(seed: int):
    """Return the load of a press near the middle, and how long it takes [s]."""
    x, y = MIDDLE[:2] + 0.006 * np.random.default_rng(seed).uniform(-1, 1, 2)

    def motion(time):
        share = np.sin(np.pi * min(time / PRESS_SECONDS, 1.0)) ** 2
        return x, y, SIZE[2] + BALL + 0.001 - share * (DEPTH + 0.001)

    return (pt.tools.Contact(pt.tools.Sphere(BALL), motion),), PRESS_SECONDS


def block() -> TrainingScene:
    """Return the block with its presses."""
    body = pt.Solid(
        pt.box(SIZE, SPACING),
        pt.materials.MooneyRivlin(C1=4e3, C2=0, density=1000, poisson=0.4),
        "z-",
        form="energy",
        stiffness_damping=1e-4,
    )
    return TrainingScene(body, press, EVERY, "Block", {})
