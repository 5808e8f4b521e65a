"""Nearly incompressible blocks."""

# ruff: noqa: RUF001  (Greek letters and the typographer's minus and dash are meant)
from __future__ import annotations

from typing import Any

from figure_tables.cells import Row, block, find, markdown, millimetres, signed

STUDY_SCRIPT = "python validation/incompressible.py"
BOTH_CLOUDS = f"{STUDY_SCRIPT} blocks --jitters 0`, `{STUDY_SCRIPT} blocks --jitters 0.2`"
CASES = ("tension", "compression", "bending", "torsion")


def _error_or_gap(rows: list[Row], **key: Any) -> str:
    found = find(rows, **key)
    return signed(found["error"], unit="") if found else "not run"


@block("incompressible", command=f"{BOTH_CLOUDS} and `{STUDY_SCRIPT} cook --spacings 0.005 0.004")
def incompressible_energy(found: Row) -> str:
    """Return the errors of the energy form on blocks and Cook's slab, lattice and jittered cloud."""
    lines = []
    for case in (*CASES, "cook"):
        for poisson in (0.49, 0.499):
            cells = []
            for spacing in (0.005, 0.0025):
                key = {"case": case, "poisson": poisson, "form": "energy", "spacing": spacing}
                pair = [_error_or_gap(found["rows"], **key, jitter=jitter) for jitter in (0.0, 0.2)]
                cells.append("not run" if pair == ["not run"] * 2 else "; ".join(pair))
            lines.append(["Cook's slab" if case == "cook" else case, f"{poisson:g}", *cells])
    return markdown(["case", "ν", "5 mm: lattice; jittered [%]", "2.5 mm"], lines)


@block("incompressible", command=f"{BOTH_CLOUDS} and `{STUDY_SCRIPT} shown")
def incompressible_pressures(found: Row) -> str:
    """Return checkerboards and errors of pressures at 2.5 mm and a Poisson's ratio of 0.499."""
    lines = []
    for case in CASES:
        key = {"case": case, "poisson": 0.499}
        shown = [find(found["shown"], **key, jitter=jitter) for jitter in (0.0, 0.2)]
        pair = [find(found["rows"], **key, spacing=0.0025, form="energy", jitter=jitter) for jitter in (0.0, 0.2)]
        values = [
            [row["rough"][1] for row in pair], [row["rough"] for row in shown],
            [row["pressure_errors"][0] for row in shown],
        ]  # fmt: skip
        cells = ["; ".join(f"{value:.0f}" for value in each) for each in values]
        lines.append([case, *cells, f"{shown[0]['range']:.0f}"])
    heads = ["case", "board in the stress [Pa]", "board, recovered", "difference, recovered", "range"]
    return markdown(heads, lines)


@block("incompressible", command=f"{BOTH_CLOUDS} and `{STUDY_SCRIPT} blocks --forms strong --spacings 0.005")
def incompressible_steps(found: Row) -> str:
    """Return the stable step at rest of the block."""
    lines = []
    for form, spacings in (("energy", (0.005, 0.0025)), ("strong", (0.005,))):
        for spacing in spacings:
            cells = []
            for poisson in (0.49, 0.499):
                key = {"case": "bending", "form": form, "poisson": poisson, "spacing": spacing}
                steps = [find(found["rows"], **key, jitter=jitter) for jitter in (0.0, 0.2)]
                cells.append("; ".join(f"{1e6 * row['step']:.0f}" if row else "not run" for row in steps))
            lines.append([f"{form} form, {millimetres(spacing)}", *cells])
    return markdown(["", "ν = 0.49: lattice; jittered", "ν = 0.499"], lines)
