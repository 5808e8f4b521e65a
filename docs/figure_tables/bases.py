"""Bases of reduced models with the same number of coordinates."""

from __future__ import annotations

from itertools import pairwise
from statistics import median

from figure_tables.cells import ERRORS, Row, block, markdown, percent, significant

CLASS_BOUNDS = (0.0, 0.03, 0.09, 1.0)  # between the classes of displacements [m]


def _cells(found: Row, statistic: str, kinds: tuple[str, ...] = ERRORS) -> str:
    return " / ".join(significant(100 * found[kind][statistic], 2) for kind in kinds)


def _projection(found: Row) -> str:
    return _cells(found, "percentile_95", ERRORS[:2])


@block("bases", command="python validation/bases.py")
def bases_rollouts(studies: Row) -> str:
    """Return the errors of bases and corrections on motions inside, with all nodes."""
    lines = []
    for row in studies["rollouts"]:
        errors = [_cells(row["errors"], statistic) for statistic in ("median", "percentile_95")]
        projection = _projection(row["projection"]) if "projection" in row else ""
        excess = percent(row["excess"]).replace("-", "−") if "excess" in row else ""  # noqa: RUF001
        lines.append([str(row["coordinates"]), row["basis"], *errors, projection, excess])
    heads = ["coordinates", "basis", "median", "95th percentile", "projection", "frequencies too high by"]
    return markdown(heads, lines)


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


@block("bases", command="python validation/bases.py")
def bases_local(studies: Row) -> str:
    """Return what bases of parts of the training states miss of motions inside."""
    lines = [
        [
            str(row["clusters"]), str(row["coordinates"]), _projection(row), f"{100 * row['surplus']:.4f} %",
            percent(row["excess"]),
        ]
        for row in studies["local"]
    ]  # fmt: skip
    heads = ["bases", "coordinates of each", "projection", "strain energy left", "frequencies too high by"]
    return markdown(heads, lines)
