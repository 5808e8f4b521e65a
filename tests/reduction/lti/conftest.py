"""A small bar, linearised in both forms."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt

SMALL = 1e-4  # of the usual pull: the body then moves by micrometres, and is linear


def small_pull(time):
    return SMALL * np.sin(300 * time) ** 2 * np.array([0.6, 0.15, 0.05])


@pytest.fixture(scope="session")
def soft_pull():
    return pt.SurfaceForce("x+", force=small_pull)


@pytest.fixture(scope="session")
def strong(bar, tissue, calm):
    return pt.Solid(bar, tissue, form="strong", fixed="x-", stiffness_damping=calm)


@pytest.fixture(scope="session")
def energetic(bar, tissue):
    return pt.Solid(bar, tissue, fixed="x-", form="energy", stiffness_damping=2e-5)


@pytest.fixture(scope="session")
def strong_system(strong, soft_pull):
    return pt.lti.linearise(strong, [soft_pull], ["x+", "x-"])


@pytest.fixture(scope="session")
def system(energetic, soft_pull):
    return pt.lti.linearise(energetic, [soft_pull], ["x+", "x-"])


@pytest.fixture(scope="session")
def tool_system(energetic):
    return pt.lti.linearise(energetic, [pt.PrescribedMotion("tip", (0.0, 0.0, 0.0))], ["z+"])
