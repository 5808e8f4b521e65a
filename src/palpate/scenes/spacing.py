"""Spacing of nodes by their number: of what has no spacing of its own, before it is filled."""

from __future__ import annotations

from math import cbrt

NODES_PER_CELL = 1.45  # nodes over volume / spacing^3 in a filled organ
TRAINING_NODES = 4500  # of a body without a spacing; statics of training take 5,000 at most


def expected_nodes(volume: float, spacing: float) -> float:
    """Return about how many nodes of a spacing [m] fill a volume [m^3]."""
    return NODES_PER_CELL * volume / spacing**3


def spacing_for(nodes: int, volume: float) -> float:
    """Return the spacing [m], of three digits, at which about so many nodes fill a volume [m^3]."""
    return float(f"{cbrt(NODES_PER_CELL * volume / nodes):.3g}")
