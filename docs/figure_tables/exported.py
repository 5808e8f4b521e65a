"""Tables of exported libraries."""

from __future__ import annotations

from figure_tables.cells import Row, block, markdown

__all__ = ["exported", "exported_times"]


@block("exported", command="python validation/exported.py")
def exported(found: list[Row]) -> str:
    """Return how many periods of libraries equal the engine's, and the largest differences to the engine as shipped."""
    lines = []
    for equal in sorted({(row["equal"], row["periods"]) for row in found}, reverse=True):
        rows = [row for row in found if (row["equal"], row["periods"]) == equal]
        largest = (max(row["differences"][name] for row in rows) for name in ("force", "coordinates", "stiffness"))
        cells = [f"{equal[0]:,} of {equal[1]:,}", *(f"{value:.0e}" for value in largest)]
        lines.append(["; ".join(row["case"] for row in rows), *cells])
    heads = ["laws and kinds", "equal periods of each", "difference: force", "coordinates", "contact stiffness"]
    return markdown(heads, lines)


@block("exported_times", command="python validation/exported.py --times", timed=True)
def exported_times(found: list[Row]) -> str:
    """Return times of a period in contact, over that of the engine in the same run."""
    lines = [[row["name"], f"{1e6 * row['seconds']:.0f} µs", f"{row['ratio']:.2f}"] for row in found]
    return markdown(["compiled by", "period", "over the engine's"], lines)
