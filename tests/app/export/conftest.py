"""The studies' modules and the helpers of browser tests can be imported by these tests."""

from __future__ import annotations

import sys
from pathlib import Path

TESTS = Path(__file__).parents[2]
sys.path += [str(TESTS.parent / "validation"), str(TESTS.parent / "benchmarks"), str(TESTS / "app" / "view")]
