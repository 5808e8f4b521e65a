"""Lets the tests of this folder find the surfaces of `tests/surface`."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "surface"))
