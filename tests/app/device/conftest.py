"""Emulated devices, and a wall in place of a session, of `validation/emulated_hand.py`."""

from __future__ import annotations

import importlib.util
from pathlib import Path

import pytest

FOUND = importlib.util.spec_from_file_location(
    "emulated_hand", Path(__file__).parents[3] / "validation" / "emulated_hand.py"
)
RIG = importlib.util.module_from_spec(FOUND)
FOUND.loader.exec_module(RIG)


@pytest.fixture
def service_of():
    """A function that starts a service with devices of some names; R and L begin those of the right and left hand."""
    made = []

    def start(*names):
        made.append(RIG.Service(*names))
        return made[-1]

    yield start
    for each in made:
        each.close()


@pytest.fixture
def wall_of():
    """A function that starts the adapter of a service with a wall."""
    made = []

    def start(service, **options):
        made.append(RIG.Wall(service.port, **{"max_age": 1.0, **options}))  # of a machine with other work
        return made[-1]

    yield start
    for each in made:
        each.close()
