"""The kinds of tools, as the compiled passes compare them. A new tool takes the next number."""

from __future__ import annotations

CAPSULE, PLANE, PUNCH, BONDED, BLADE = 0, 1, 2, 3, 4
