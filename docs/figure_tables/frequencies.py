"""Static tips and frequencies."""

# ruff: noqa: RUF001  (Greek letters and the typographer's minus and dash are meant)
from __future__ import annotations

from figure_tables.cells import Row, block, distinct, find, markdown, millimetres, signed

ENERGY_TIPS = "python validation/tips.py --forms energy --spacings"
STRONG_TIPS = "python validation/tips.py --forms strong --spacings"


@block("tips", command=f"{ENERGY_TIPS} 0.005`, `{ENERGY_TIPS} 0.004` and `{STRONG_TIPS} 0.005")
def tips(rows: list[Row]) -> str:
    """Return the error of the mean displacement of the beam's end, by load, form and spacing."""
    columns = (("energy", 0.005), ("energy", 0.004), ("strong", 0.005))
    lines = []
    for kind in ("axial", "sideways"):
        for force in distinct((row["force"] for row in rows if row["kind"] == kind), reverse=False):
            cells = []
            for poisson in (0.3, 0.45, 0.49):
                key = {"kind": kind, "poisson": poisson, "force": force}
                found = [find(rows, **key, form=form, spacing=spacing) for form, spacing in columns]
                cells.append("; ".join(f"{100 * row['error']:.2f}" if row else "not run" for row in found))
            lines.append([f"{kind} {force:g} N", *cells])
    names = "; ".join(f"{form}, {millimetres(spacing)}" for form, spacing in columns)
    return markdown(["load", f"ν = 0.3: {names} [%]", "ν = 0.45", "ν = 0.49"], lines)


@block("frequencies", command="python validation/frequencies.py --forms strong")
def frequencies_strong(rows: list[Row]) -> str:
    """Return the errors of the first bending and axial frequency of the strong form."""
    spacings = (0.02 / 3, 0.005, 0.004)
    lines = []
    for poisson in (0.3, 0.45, 0.49):
        found = [find(rows, form="strong", poisson=poisson, spacing=h) for h in spacings]
        lines.append([f"{poisson:g}", *(_frequency_errors(row) for row in found)])
    return markdown(["ν", *map(millimetres, spacings)], lines)


def _frequency_errors(row: Row) -> str:
    negative = f" ({row['negative']})" if row["negative"] else ""
    return f"{signed(row['bending_error'], unit='')} / {signed(row['axial_error'])}{negative}"


@block("frequencies", command="python validation/frequencies.py --forms energy")
def frequencies_energy(rows: list[Row]) -> str:
    """Return the errors of the first bending, torsion and axial frequency of the energy form."""
    spacings = (0.02 / 3, 0.005, 0.004, 0.01 / 3)
    lines = []
    for poisson in (0.3, 0.45, 0.49):
        found = [find(rows, form="energy", poisson=poisson, spacing=h) for h in spacings]
        cells = [
            " / ".join(signed(row[f"{kind}_error"], unit="") for kind in ("bending", "torsion", "axial")) + " %"
            for row in found
        ]
        lines.append([f"{poisson:g}", *cells])
    return markdown(["ν", *map(millimetres, spacings)], lines)
