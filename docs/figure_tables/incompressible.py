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
            for spacing in (0.005, 0.004, 0.0025):
                key = {"case": case, "poisson": poisson, "form": "energy", "spacing": spacing}
                pair = [_error_or_gap(found["rows"], **key, jitter=jitter) for jitter in (0.0, 0.2)]
                cells.append("not run" if pair == ["not run"] * 2 else " / ".join(pair) + " %")
            lines.append(["Cook's slab" if case == "cook" else case, f"{poisson:g}", *cells])
    return markdown(["case", "ν", "5 mm", "4 mm", "2.5 mm"], lines)


@block("incompressible", command="python validation/incompressible.py blocks --forms strong")
def incompressible_strong(found: Row) -> str:
    """Return the errors of the strong form with its split pressure on blocks."""
    columns = [(0.49, 0.005), (0.49, 0.004), (0.499, 0.005)]
    lines = []
    for case in CASES:
        cells = []
        for poisson, spacing in columns:
            key = {"case": case, "poisson": poisson, "form": "strong", "spacing": spacing}
            cells.append(" / ".join(_error_or_gap(found["rows"], **key, jitter=j) for j in (0.0, 0.2)) + " %")
        lines.append([case, *cells])
    return markdown(["case", *(f"{poisson:g}, {millimetres(h)}" for poisson, h in columns)], lines)


@block("incompressible", command=f"{BOTH_CLOUDS} and `{STUDY_SCRIPT} shown")
def incompressible_pressures(found: Row) -> str:
    """Return checkerboards and errors of pressures at 2.5 mm."""
    lines = []
    for case in CASES:
        for poisson in (0.49, 0.499):
            key = {"case": case, "poisson": poisson, "spacing": 0.0025, "form": "energy"}
            pair = [find(found["rows"], **key, jitter=jitter) for jitter in (0.0, 0.2)]
            shown = [find(found["shown"], case=case, poisson=poisson, jitter=jitter) for jitter in (0.0, 0.2)]
            values = [
                [row["rough"][2] for row in pair], [row["rough"][1] for row in pair], [row["rough"] for row in shown],
                [row["pressure_errors"][1] for row in pair], [row["pressure_errors"][0] for row in shown],
            ]  # fmt: skip
            cells = [" / ".join(f"{value:.0f}" for value in each) for each in values]
            lines.append([case, f"{poisson:g}", *cells, f"{shown[0]['range']:.0f}"])
    heads = [
        "case", "ν", "board, each node's own J", "board, in the stress", "board, recovered",
        "difference, in the stress", "difference, recovered", "range",
    ]  # fmt: skip
    return markdown(heads, lines)


@block("incompressible", command=f"{BOTH_CLOUDS} and `{STUDY_SCRIPT} blocks --forms strong --spacings 0.005")
def incompressible_steps(found: Row) -> str:
    """Return the stable step at rest of the block."""
    lines = []
    for form, spacings in (("energy", (0.005, 0.004, 0.0025)), ("strong", (0.005, 0.004))):
        for spacing in spacings:
            cells = []
            for poisson in (0.49, 0.499):
                key = {"case": "bending", "form": form, "poisson": poisson, "spacing": spacing}
                steps = [find(found["rows"], **key, jitter=jitter) for jitter in (0.0, 0.2)]
                cells.append(" / ".join(f"{1e6 * row['step']:.0f}" if row else "not run" for row in steps))
            lines.append([f"{form} form, {millimetres(spacing)}", *cells])
    return markdown(["", "ν = 0.49: lattice / jittered", "ν = 0.499: lattice / jittered"], lines)


@block("incompressible", command="python validation/incompressible.py volumetric")
def incompressible_volumetric(found: Row) -> str:
    """Return the errors of the forms of U(J)."""
    lines = []
    for case in ("tension", "compression"):
        for volumetric in ("quadratic", "logarithmic", "mixed"):
            pair = [find(found["volumetric"], case=case, volumetric=volumetric, form=f) for f in ("energy", "strong")]
            elements = f"{pair[0]['elements']:.4f}".replace("-", "−")
            lines.append([f"{case}, {volumetric}", elements, *(signed(row["error"], 2) for row in pair)])
    return markdown(["", "elements [N]", "energy form", "strong form"], lines)
