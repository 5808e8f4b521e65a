"""Material laws."""

# ruff: noqa: RUF001  (Greek letters and the typographer's minus and dash are meant)
from __future__ import annotations

from figure_tables.cells import Row, block, find, markdown, millimetres, signed


@block("law_elements", command="python validation/law_elements.py")
def law_elements(found: Row) -> str:
    """Return the errors of the force on a block against finite elements, for every law, at the finest spacings."""
    rows, cases = found["rows"], found["about"]["cases"]
    finest = {form: min(row["spacing"] for row in rows if row["form"] == form) for form in ("energy", "strong")}
    lines = []
    for law in dict.fromkeys(row["law"] for row in rows):
        cells = []
        for form, spacing in finest.items():
            errors = [find(rows, law=law, form=form, case=case, spacing=spacing) for case in cases]
            cells.append(", ".join(signed(each["error"], unit="") for each in errors) if all(errors) else "–")
        lines.append([f"`{law}`", *cells])
    return markdown(["law", *(f"{form} form, {millimetres(h)}" for form, h in finest.items())], lines)


@block("closed_forms", command="python validation/closed_forms.py")
def closed_forms(found: Row) -> str:
    """Return the errors of torsion and inflation against the laws' closed forms, over the spacing."""
    lines = []
    for law in dict.fromkeys(row["law"] for row in found["rows"]):
        rows = sorted((row for row in found["rows"] if row["law"] == law), key=lambda row: -row["spacing"])
        lines.append([
            f"`{law}`",
            *(
                ", ".join(signed(row[f"{each}_error"], unit="") for row in rows if each in row["exact"])
                for each in ("moment", "force", "pressure")
            ),
        ])  # fmt: skip
    return markdown(["law", "torsion, moment", "torsion, axial force", "inflation, pressure"], lines)


INTERFACES = {
    "second half 4 times softer": "small, 0.25 times as stiff",
    "second half 5 times stiffer": "small, 5 times as stiff",
    "softer, mean of the compliances": "small, 0.25 times as stiff, mean compliance",
    "stiffer, mean of the compliances": "small, 5 times as stiff, mean compliance",
    "large strain, soft then stiff": "large, soft then stiff",
    "large strain, stiff then soft": "large, stiff then soft",
}


@block("interfaces", command="python validation/interfaces.py")
def interfaces(rows: list[Row]) -> str:
    """Return the errors of the stretch of a bar of two halves, by the place of the interface, over the spacing."""
    places = {
        "midway": [row for row in rows if row["cells"] % 2],
        "on nodes": [row for row in rows if not row["cells"] % 2],
    }
    lines = []
    for words, name in INTERFACES.items():
        errors = [[row["error"].get(name) for row in each] for each in places.values()]
        lines.append([words, *(", ".join(signed(e, unit="") for e in each if e is not None) or "–" for each in errors)])
    heads = [f"{place}, {', '.join(millimetres(row['spacing']) for row in each)}" for place, each in places.items()]
    return markdown(["bar of two halves", *heads], lines)


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
