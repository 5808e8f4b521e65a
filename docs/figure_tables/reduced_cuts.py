"""Reduced models of a cut liver: errors, cost of a period, and how it grows with the cut."""

# ruff: noqa: RUF001  (the typographer's minus and dash are meant)
from __future__ import annotations

from figure_tables.cells import Row, block, markdown, microseconds, percent, signed

RUNS = "python validation/reduced_cuts.py --nodes 3000` and `python validation/reduced_cuts.py --nodes 5000"
PULLS = ("apart", "lifted")
MAX_FIELD_ERROR = 2.0  # of displacements that are an equilibrium, relative


def _both(row: Row, kind: str, name: str) -> str:
    """Return the errors under both pulls; a dash where Newton's method did not converge."""
    errors = [row[kind][pull] for pull in PULLS]
    return "; ".join(signed(each[name]) if each["field"] < MAX_FIELD_ERROR else "–" for each in errors)


@block("reduced_cuts", command=RUNS)
def reduced_cuts_errors(livers: list[Row]) -> str:
    """Return the errors of statics under both pulls, of sampled models or else with the energy of all nodes."""
    lines = []
    for liver in livers:
        for row in liver["bases"]:
            kind = "sampled" if row["sampled"] else "projected"
            cells = (_both(row, kind, name) for name in ("opening", "force", "release", "blade"))
            energy = f"{row['terms']} terms" if row["sampled"] else "all nodes"
            lines.append([f"{liver['nodes']:,}", row["basis"], str(row["coordinates"]), energy, *cells])
    return markdown(["nodes", "basis", "coordinates", "energy", "opening", "force", "energy release", "blade"], lines)


@block("reduced_cuts", command=RUNS)
def reduced_cuts_cost(livers: list[Row]) -> str:
    """Return terms, the time of an evaluation and the step, and errors in runs."""
    lines = []
    for liver in livers:
        full = liver["full"]
        lines.append([
            f"{liver['nodes']:,}", "full model", f"{3 * liver['nodes']:,}", microseconds(full["evaluation"]),
            f"{1e3 * full['step']:.1f} ms", microseconds(full["period"]), "–", "–", "–",
        ])  # fmt: skip
        for row in liver["bases"]:
            if not row["sampled"]:
                continue
            runs = [each for each in liver["runs"] if each["basis"] == row["basis"]]
            lines.append([
                f"{liver['nodes']:,}", row["basis"], str(row["coordinates"]), microseconds(row["evaluation"]),
                f"{1e3 * row['step']:.1f} ms", microseconds(row["period"]),
                *("; ".join(percent(each[name]) for each in runs) for name in ("opening", "force")),
                "; ".join(f"{each['trust']:.1f}" for each in runs),
            ])  # fmt: skip
    heads = ["nodes", "model", "coordinates", "evaluation", "step", "period", "opening", "force", "trust number"]
    return markdown(heads, lines)


@block("reduced_cuts", command=RUNS)
def reduced_cuts_lengths(livers: list[Row]) -> str:
    """Return how the cost of `pt.cut_reduced` grows with the length of the cut."""
    lines = [
        [
            f"{liver['nodes']:,}", f"{1e3 * row['length']:.0f} mm", str(row["touched"]), str(row["coordinates"]),
            str(row["terms"]), microseconds(row["evaluation"]), f"{1e3 * row['step']:.1f} ms",
            microseconds(row["period"]), f"{row['seconds']:.0f} s",
        ]
        for liver in livers for row in liver["lengths"]
    ]  # fmt: skip
    heads = ["nodes", "length", "changed nodes", "coordinates", "terms", "evaluation", "step", "period", "to make it"]
    return markdown(heads, lines)
