"""Bodies of known shape stand in a module that tests of tool paths import."""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parent))
