"""The paper's beam and membrane."""

# ruff: noqa: RUF001  (Greek letters and the typographer's minus and dash are meant)
from __future__ import annotations

from collections.abc import Sequence

from figure_tables.cells import ERRORS, Row, block, markdown, percent

BEAM_RUNS = "NUMBA_NUM_THREADS=1 palpate reproduce beam"
MEMBRANE_RUN = "NUMBA_NUM_THREADS=1 palpate reproduce membrane"


def error_cells(errors: Row, kinds: Sequence[str] = ERRORS) -> list[str]:
    """Return errors in per cent."""
    return [percent(errors[kind]) for kind in kinds]


def projected(report: Row) -> dict[int, Row]:
    """Return the projected models of the beam by their number of modes."""
    return {row["modes"]: row for row in report["reduced"] if row["series"] == "projected"}


@block("reproduce_beam", "reproduce_beam_045", command=f"{BEAM_RUNS}` and `{BEAM_RUNS} --poisson 0.45", timed=True)
def beam_projected(beam: Row, softer: Row) -> str:
    """Return the errors of projected models of the paper's beam at two Poisson's ratios."""
    rows = [
        [
            f"{report['parameters']['poisson']:g}", str(modes), *error_cells(row["errors"]),
            percent(row["projection_error"]), percent(row["ratio"]), f"{row['steps']:,}",
        ]
        for report in (beam, softer) for modes, row in projected(report).items()
    ]  # fmt: skip
    return markdown(["ν", "modes", *ERRORS, "projection", "time / full", "steps"], rows)


@block("reproduce_beam", "reproduce_beam_045", command=f"{BEAM_RUNS}` and `{BEAM_RUNS} --poisson 0.45", timed=True)
def beam_full(beam: Row, softer: Row) -> str:
    """Return the runs of the full models of the paper's beam."""
    rows = []
    for report in (beam, softer):
        for form, run in (("strong", report["full"]), ("energy", report["energy_form"])):
            rows.append([
                f"{report['parameters']['poisson']:g}", form, f"{run['steps']:,}", f"{run['wall_seconds']:.0f} s",
                f"{1e3 * run['peak_tip_displacement']:.0f} mm", f"{run['reaction_at_peak']:.1f} N",
                percent(run["energy_balance"]),
            ])  # fmt: skip
    heads = ["ν", "form", "steps", "computing time", "largest displacement of the end", "support force at 100 N"]
    return markdown([*heads, "largest miss of the energy balance over the largest work"], rows)


@block("reproduce_beam", "reproduce_beam_045", command=f"{BEAM_RUNS}` and `{BEAM_RUNS} --poisson 0.45", timed=True)
def beam_sampled(beam: Row, softer: Row) -> str:
    """Return the errors of sampled models against the energy form, which they reduce."""
    rows = []
    for report in (beam, softer):
        for row in report["reduced"]:
            if row["series"] == "hyper-reduced":
                counts = [f"{report['parameters']['poisson']:g}", str(row["modes"]), str(row["nodes"])]
                rows.append([*counts, *error_cells(row["errors"]), percent(row["ratio"])])
    return markdown(["ν", "modes", "nodes", *ERRORS, "time / full"], rows)


@block("reproduce_beam", "reproduce_beam_045", command=f"{BEAM_RUNS}` and `{BEAM_RUNS} --poisson 0.45")
def beam_forms(beam: Row, softer: Row) -> str:
    """Return the difference of the two forms of the full model."""
    rows = []
    for report in (beam, softer):
        forms = report["forms"]
        rows.append([
            f"{report['parameters']['poisson']:g}", *error_cells(forms["errors"]), percent(forms["displacement_until"]),
        ])  # fmt: skip
    return markdown(["ν", *ERRORS, f"displacement until {beam['forms']['until']:g} s"], rows)


def membrane_phase(report: Row, series: str, phase: str) -> dict[int, Row]:
    """Return the reduced membranes of one phase by their number of modes."""
    return {row["modes"]: row["phases"][phase] for row in report["reduced"] if row["series"] == series}


def series_of(report: Row) -> tuple[str, str]:
    """Return the names of the projected and the hyper-reduced series."""
    first, second = dict.fromkeys(row["series"] for row in report["reduced"])
    return first, second


@block("reproduce_membrane", command=MEMBRANE_RUN, timed=True)
def membrane_projected(report: Row) -> str:
    """Return the errors of projected models of the paper's membrane."""
    return _membrane_table(report, series_of(report)[0])


@block("reproduce_membrane", command=MEMBRANE_RUN, timed=True)
def membrane_sampled(report: Row) -> str:
    """Return the errors of hyper-reduced models of the paper's membrane."""
    return _membrane_table(report, series_of(report)[1])


def _membrane_table(report: Row, series: str) -> str:
    push, after = (membrane_phase(report, series, phase) for phase in ("push", "after"))
    rows = [
        [
            str(modes), f"{row['nodes']:,}; {after[modes]['nodes']:,}", *error_cells(row["errors"]),
            percent(row["projection_error"]), percent(row["ratio"]), percent(row["error_at_end"]),
            percent(after[modes]["errors"]["displacement"]), percent(after[modes]["projection_error"]),
            percent(after[modes]["ratio"]),
        ]
        for modes, row in push.items()
    ]  # fmt: skip
    heads = [
        "modes", "nodes or points: push; after", "push: displacement (34)", "velocity", "energy", "tool force",
        "projection", "time / full", "displacement at 0.1 s", 'after "return": displacement', "projection",
        "time / full",
    ]  # fmt: skip
    return markdown(heads, rows)
