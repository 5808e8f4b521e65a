"""The study of organs in small: filled, poked and let go, energy never grows."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

sys.path.append(str(Path(__file__).parents[2] / "validation"))
organs = importlib.import_module("organs")

needs_data = pytest.mark.skipif(not organs.DATA.is_dir(), reason="the organ surfaces are not at hand")


@pytest.mark.parametrize("name", ["generated", pytest.param("HRA female 6k", marks=needs_data)])
def test_a_poked_organ_is_stable_with_default_settings(name):
    found = organs.run(name, 1500, 0.49, "energy", duration=0.1)
    assert found["stable"], found
    assert found["nodes"] == pytest.approx(1500, rel=0.05)
    assert found["largest_displacement"] >= 0.0199
    assert found["energy_at_end"] <= found["energy_at_release"]
    assert found["balance"] < 0.02
