"""Tables of exported libraries."""

from __future__ import annotations

from figure_tables.cells import Row, block, markdown

__all__ = ["exported", "exported_times"]


@block("exported", command="python validation/exported.py")
def exported(found: list[Row]) -> str:
    """Return how many periods of libraries equal the engine's, and the differences to the engine as shipped."""
    lines = [
        [
            row["case"], f"{row['equal']:,} of {row['periods']:,}", f"{row['largest_force']:.2g} N",
            *(f"{row['differences'][name]:.0e}" for name in ("force", "coordinates", "stiffness")),
        ]
        for row in found
    ]  # fmt: skip
    heads = ["law or kind", "equal periods", "largest force", "difference: force", "coordinates", "contact stiffness"]
    return markdown(heads, lines)


@block("exported_times", command="python validation/exported.py --times", timed=True)
def exported_times(found: list[Row]) -> str:
    """Return times of a period in contact, over that of the engine in the same run."""
    lines = [[row["name"], f"{1e6 * row['seconds']:.0f} µs", f"{row['ratio']:.2f}"] for row in found]
    return markdown(["compiled by", "period", "over the engine's"], lines)
