"""A small scene for training campaigns, some of whose paths can be told to go wrong."""

from __future__ import annotations

import os

import numpy as np

from palpate.dynamics.contact.tools import Contact, Sphere
from palpate.dynamics.loads.foundation import Foundation
from palpate.dynamics.loads.prescribed_motion import PrescribedMotion
from palpate.dynamics.solid.model import Solid
from palpate.meshfree.cloud import box
from palpate.scenes.load_case import TrainingScene
from palpate.tissue.materials import MooneyRivlin

EVERY = 0.001


def pad(springs: float = 0.0) -> TrainingScene:
    """Return a pad that a ball presses at random places, with springs [N/m^3] on a side."""
    tissue = MooneyRivlin(C1=4e3, C2=0, density=1000.0, poisson=0.4)
    model = Solid(box((0.06, 0.06, 0.03), 0.006), tissue, "z-", stiffness_damping=1e-4)

    def path(seed: int) -> tuple[tuple[Contact, Foundation], float]:
        place = np.random.default_rng(seed).uniform(0.02, 0.04, 2)

        def motion(time: float) -> np.ndarray:
            return np.array([*place, 0.03 + 0.016 - 0.004 * np.sin(np.pi * min(time / 0.08, 1.0)) ** 2])

        return (Contact(Sphere(0.015), motion), Foundation("x-", springs)), 0.1

    return TrainingScene(model, path, 0.005, "Pad", {"springs": springs})


def bar(lasting: float = 0.01, diverging: str = "", deadly: str = "") -> TrainingScene:
    """Return a bar whose end is pulled about; at some seeds through the bar, at others the process ends."""
    tissue = MooneyRivlin(C1=60e3, C2=1.2e3, density=1120.0, poisson=0.45)
    model = Solid(box((0.03, 0.015, 0.015), 0.005), tissue, "x-", form="energy")

    def path(seed: int) -> tuple[tuple[PrescribedMotion], float]:
        aim = np.random.default_rng(seed).uniform(-0.003, 0.003, 3)
        thrust = np.array([-0.4, 0.0, 0.0]) * (str(seed) in diverging.split(","))

        def displacement(points: np.ndarray, time: float) -> np.ndarray:
            if time > 0.5 * lasting and str(seed) in deadly.split(","):
                os._exit(3)
            share = time / lasting
            moved = aim * np.sin(np.pi * share) ** 2 + thrust * max(0.0, share - 0.5)
            return np.broadcast_to(moved, points.shape)

        return (PrescribedMotion("x+", displacement),), lasting

    parameters = {"lasting": lasting, "diverging": diverging, "deadly": deadly}
    return TrainingScene(model, path, EVERY, "Bar", parameters, ("x+",))
