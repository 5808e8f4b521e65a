"""The stand-in for a model is a module that the tests' scripts import, too."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

sys.path.append(str(Path(__file__).parent))

from mass_spring import mass_spring

from palpate.realtime.engine import Engine


@pytest.fixture
def engine_of():
    """A function that makes engines of a mass-spring, and stops them after the test."""
    engines = []

    def make(*, rate=1000.0, options=None, **parameters):
        engines.append(Engine(mass_spring(**parameters), rate, **(options or {})))
        return engines[-1]

    yield make
    for engine in engines:
        engine.stop()
