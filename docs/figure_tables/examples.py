"""The paper's beam and membrane."""

# ruff: noqa: RUF001  (Greek letters and the typographer's minus and dash are meant)
from __future__ import annotations

from collections.abc import Sequence

from figure_tables.cells import ERRORS, Row, block, find, markdown, percent, significant

BEAM_RUNS = "NUMBA_NUM_THREADS=1 palpate reproduce beam"
SHOWN_MODES = (2, 6, 8, 12)
MEMBRANE_RUN = "NUMBA_NUM_THREADS=1 palpate reproduce membrane"


def error_cells(errors: Row, kinds: Sequence[str] = ERRORS) -> list[str]:
    """Return errors in per cent."""
    return [percent(errors[kind]) for kind in kinds]


def projected(report: Row) -> dict[int, Row]:
    """Return the projected models of the beam by their number of modes."""
    return {row["modes"]: row for row in report["reduced"] if row["series"] == "projected"}


@block("reproduce_beam", "reproduce_beam_045", command=f"{BEAM_RUNS}` and `{BEAM_RUNS} --poisson 0.45", timed=True)
def beam_models(beam: Row, softer: Row) -> str:
    """Return the errors of projected and sampled models of the paper's beam at two Poisson's ratios."""
    rows = []
    for series, name in (("projected", "projected"), ("hyper-reduced", "sampled")):
        for modes in SHOWN_MODES:
            pair = [find(report["reduced"], series=series, modes=modes) for report in (beam, softer)]
            nodes = "; ".join(f"{row['nodes']:,}" for row in pair) if series != "projected" else "all"
            errors = ["; ".join(significant(100 * row["errors"][kind]) for kind in ERRORS) for row in pair]
            rows.append([name, str(modes), nodes, *errors, "; ".join(percent(row["ratio"]) for row in pair)])
    heads = ["model", "modes", "nodes", f"ν = 0.49: {'; '.join(ERRORS)} [%]", "ν = 0.45", "time over the full model's"]
    return markdown(heads, rows)


def membrane_phase(report: Row, series: str, phase: str) -> dict[int, Row]:
    """Return the reduced membranes of one phase by their number of modes."""
    return {row["modes"]: row["phases"][phase] for row in report["reduced"] if row["series"] == series}


def series_of(report: Row) -> tuple[str, str]:
    """Return the names of the projected and the hyper-reduced series."""
    first, second = dict.fromkeys(row["series"] for row in report["reduced"])
    return first, second


@block("reproduce_membrane", command=MEMBRANE_RUN, timed=True)
def membrane_models(report: Row) -> str:
    """Return the errors of projected and hyper-reduced models of the paper's membrane."""
    rows = []
    for series, name in zip(series_of(report), ("projected", "hyper-reduced"), strict=True):
        push, after = (membrane_phase(report, series, phase) for phase in ("push", "after"))
        for modes in SHOWN_MODES:
            row = push[modes]
            rows.append([
                name, str(modes), f"{row['nodes']:,}",
                "; ".join(significant(100 * row["errors"][kind]) for kind in ("displacement", "energy", "reaction")),
                significant(100 * row["projection_error"]), percent(row["ratio"]),
                "; ".join(significant(100 * value) for value in (
                    after[modes]["errors"]["displacement"], after[modes]["projection_error"]
                )),
            ])  # fmt: skip
    heads = [
        "model", "modes", "points", "push: displacement; energy; tool force [%]", "projection [%]",
        "time over the full model's", 'after "return": displacement; projection [%]',
    ]  # fmt: skip
    return markdown(heads, rows)
