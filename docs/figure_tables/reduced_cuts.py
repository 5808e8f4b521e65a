"""Reduced models of a cut liver: errors, and the cost of a period."""

# ruff: noqa: RUF001  (the typographer's minus is meant)
from __future__ import annotations

from figure_tables.cells import Row, block, markdown, microseconds, percent, signed

RUNS = "python validation/reduced_cuts.py"
PULLS, ERRORS = ("apart", "lifted"), ("opening", "force", "release", "blade")


@block("reduced_cuts", command=RUNS)
def reduced_cuts_errors(livers: list[Row]) -> str:
    """Return the errors of statics under both pulls."""
    lines = [
        [
            row["basis"],
            *("; ".join(signed(row[pull][name]) for pull in PULLS) for name in ERRORS),
        ]
        for liver in livers for row in liver["models"]
    ]  # fmt: skip
    return markdown(["trained on", "opening", "force", "energy release", "blade"], lines)


@block("reduced_cuts", command=RUNS, timed=True)
def reduced_cuts_cost(livers: list[Row]) -> str:
    """Return the processor time of a period, and errors in runs."""
    lines = []
    for liver in livers:
        lines.append(["full model", microseconds(liver["full"]["period"]), "–", "–", "–"])
        for row in liver["models"]:
            runs = [each for each in liver["runs"] if each["basis"] == row["basis"]]
            lines.append([
                row["basis"], microseconds(row["period"]),
                *("; ".join(percent(each[name]) for each in runs) for name in ("opening", "force")),
                "; ".join(f"{each['trust']:.1f}" for each in runs),
            ])  # fmt: skip
    heads = ["trained on", "period", "opening", "force", "error indicator"]
    return markdown(heads, lines)
