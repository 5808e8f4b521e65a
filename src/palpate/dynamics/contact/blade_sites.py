"""Sites of blades: points of the tissue at their edges and sides, for the compiled step."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from palpate.core.arrays import Floats, Ints

EDGE_SITE, FACE_SITE, PAIR_SITE = 0, 1, 2  # kinds of a site; a pair are the two faces of a cut
AWAY_TOOL, NO_TOOL = -1, -2  # of sites of a tool that was put away, and of pairs


class BladeSites(NamedTuple):
    """Points of the tissue at blades, for the compiled step."""

    # tool, kind: (s,) arrays: number of the tool or AWAY_TOOL or NO_TOOL, and EDGE_SITE, FACE_SITE or PAIR_SITE
    tool: Ints
    kind: Ints
    start: Ints  # (s + 1,) array: first entry of every site in the next two arrays
    # nodes, weights: (e,) arrays
    nodes: Ints
    weights: Floats
    points: Floats  # (s, 3) array [m]: reference positions
    places: Floats  # (s, 3) array [m]: the points of the blade, in its frame
    # (s, 3) array: in the tool's frame, the direction in which the edge cuts, or the normal of the blade's side. In
    # space, the normal from the second face of a pair to its first.
    directions: Floats
    limits: Floats  # (s,) array [N]: largest force of the edge, or largest friction
    offsets: Floats  # (s, 3) array [m]: from the tissue to the point of the blade where an edge is at the front
    slips: Floats  # (s,) array [m]: how far the front has advanced since the site was made
    impulses: Floats  # (s, 3) array [N s]: of the present step
    works: Floats  # (2,) array [J]: energy dissipated at the edge and by friction since the start of a call


def no_sites() -> BladeSites:
    """Return no sites."""
    numbers, vectors = np.zeros(0, dtype=np.int64), np.zeros((0, 3))
    return BladeSites(
        tool=numbers, kind=numbers, start=np.zeros(1, dtype=np.int64), nodes=numbers, weights=np.zeros(0),
        points=vectors, places=vectors, directions=vectors, limits=np.zeros(0), offsets=vectors, slips=np.zeros(0),
        impulses=vectors, works=np.zeros(2),
    )  # fmt: skip
