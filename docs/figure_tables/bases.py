"""Bases of reduced models with the same number of coordinates."""

from __future__ import annotations

from itertools import pairwise
from statistics import median

from figure_tables.cells import Row, block, markdown, percent

CLASS_BOUNDS = (0.0, 0.03, 0.09, 1.0)  # between the classes of displacements [m]


@block("bases", command="python validation/bases.py states")
def bases_states(studies: Row) -> str:
    """Return by how much frequencies are too high with the present basis, by the displacement of the state."""
    rows, lines = studies["states"], []
    for least, most in pairwise(CLASS_BOUNDS):
        cells = []
        for count in sorted({row["coordinates"] for row in rows}):
            some = [
                row["excess"]
                for row in rows
                if row["coordinates"] == count and least <= row["largest_displacement"] < most
            ]
            cells.append(f"{percent(median(some))} (up to {percent(max(some))})")
        last = most == CLASS_BOUNDS[-1]
        sizes = f"above {1e3 * least:.0f} mm" if last else f"{1e3 * least:.0f} to {1e3 * most:.0f} mm"
        lines.append([f"{len(some)}, {sizes}", *cells])
    counts = sorted({row["coordinates"] for row in rows})
    return markdown(["states", *(f"{count} coordinates" for count in counts)], lines)
