"""Material laws."""

# ruff: noqa: RUF001  (Greek letters and the typographer's minus and dash are meant)
from __future__ import annotations

from figure_tables.cells import Row, block, distinct, markdown, signed


@block("law_elements", command="python validation/law_elements.py")
def law_elements(found: Row) -> str:
    """Return the errors of the force on a block against finite elements, for every law, over the spacing."""
    rows = found["rows"]
    spacings = distinct(round(row["spacing"], 9) for row in rows)
    lines = []
    for law in dict.fromkeys(row["law"] for row in rows):
        for form in ("energy", "strong"):
            own = [row for row in rows if row["law"] == law and row["form"] == form]
            cells = []
            for case in found["about"]["cases"]:
                errors = {round(row["spacing"], 9): row["error"] for row in own if row["case"] == case}
                cells.append(", ".join(signed(errors[h], unit="") if h in errors else "–" for h in spacings))
            if own:
                lines.append([f"`{law}`", form, *cells])
    return markdown(["law", "form", *found["about"]["cases"]], lines)


@block("closed_forms", command="python validation/closed_forms.py")
def closed_forms(found: Row) -> str:
    """Return the errors of torsion and inflation against the laws' closed forms."""
    symbols = {"moment": "M [N m]", "force": "N [N]", "pressure": "p [Pa]"}
    lines = []
    for case, law in dict.fromkeys((row["case"], row["law"]) for row in found["rows"]):
        own = [row for row in found["rows"] if (row["case"], row["law"]) == (case, law)]
        own.sort(key=lambda row: -row["spacing"])
        for quantity, exact in own[0]["exact"].items():
            errors = ", ".join(signed(row[f"{quantity}_error"], 2, "") for row in own)
            numbers = [f"{value:.4g}".replace("-", "−") for value in (exact, own[0]["incompressible"][quantity])]
            lines.append([case, f"`{law}`", symbols[quantity], *numbers, errors])
    return markdown(["case", "law", "of", "equation", "incompressible", "errors [%]"], lines)


INTERFACES = {
    "uniform, small": "uniform",
    "small, second half 4 times softer": "small, 0.25 times as stiff",
    "small, second half 5 times stiffer": "small, 5 times as stiff",
    "the same, mean of the compliances on the interface, softer": "small, 0.25 times as stiff, mean compliance",
    "the same, stiffer": "small, 5 times as stiff, mean compliance",
    "uniform, large": "large, soft",
    "large, soft then stiff": "large, soft then stiff",
    "large, stiff then soft": "large, stiff then soft",
}


@block("interfaces", command="python validation/interfaces.py")
def interfaces(rows: list[Row]) -> str:
    """Return the errors of the stretch of a bar of two halves."""
    heads = [f"{1e3 * row['spacing']:.2f} mm, {'midway' if row['cells'] % 2 else 'on nodes'}" for row in rows]
    lines = []
    for words, name in INTERFACES.items():
        errors = [row["error"].get(name) for row in rows]
        lines.append(
            [words, *("–" if e is None else f"{round(100 * e, 2) + 0.0:.2f}".replace("-", "−") for e in errors)]
        )
    return markdown(["error of the stretch [%] at", *heads], lines)


@block(
    "land",
    command="python validation/land.py --cells 4 6 --bulk 100e3 --keep` and `... --cells 4 --bulk 400e3 800e3 --keep",
)
def land(found: Row) -> str:
    """Return the place of the tip in the cardiac benchmark, over the bulk modulus."""
    scale = 2e3  # C bt / 2 of Guccione's law [Pa]
    lines = [
        [f"{row['bulk'] / scale:.0f}", str(row["cells_across"]), f"{row['tip_mm'][2]:.3f}"] for row in found["rows"]
    ]
    return markdown(["bulk modulus, over C bt/2 = 2 kPa", "cells across", "z of the tip [mm]"], lines)
