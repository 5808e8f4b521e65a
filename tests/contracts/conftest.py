"""The models of all kinds stand in a module that the tests of the contract import."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent))
