"""The command ``palpate compare``."""

from __future__ import annotations

from pathlib import Path

from palpate.app.common.arguments import suggestion
from palpate.app.common.console import Console
from palpate.app.common.report import REPORTS, deliver
from palpate.app.compare.bodies import BODIES
from palpate.app.compare.figures import draw_comparison
from palpate.app.compare.measure import compare_methods, prepare_comparison
from palpate.app.compare.report import build_report, full_table, tables
from palpate.extras import require
from palpate.faults import InputError, integer_in_range
from palpate.files import check_folder
from palpate.reduction.lti.pymor_bridge import need_pymor
from palpate.reduction.lti.reductors import PYMOR_METHODS, TITLE_BY_METHOD

__all__ = ["compare"]

LOW_RANK = "balanced-low-rank"


def compare(
    *,
    body: str,
    spacing: float | None = None,
    poisson: float | None = None,
    modes: list[int],
    methods: list[str] | None = None,
    condense: int | None = None,
    out: Path,
    as_json: bool = False,
) -> int:
    """Compare linear reductions of a body with each other and with its full, nonlinear model; return the exit code.

    Parameters
    ----------
    body : str
        ``"beam"`` or ``"liver"``.
    spacing, poisson : float, optional
        As of the scenes; by default those of `palpate.app.compare.bodies`.
    modes : list of int
        Sizes.
    methods : list of str, optional
        Of `TITLE_BY_METHOD`; by default all but the low-rank solver, which does not suit these lightly damped bodies.
    condense : int, optional
        As of `Reduction`.
    out : path
        Folder for the report and the figures.
    as_json : bool
        Print the report as JSON instead of a table.

    Raises
    ------
    InputError
        A parameter out of range; pyMOR missing, with how to install it.
    """
    chosen = methods or [name for name in TITLE_BY_METHOD if name != LOW_RANK]
    unknown = [name for name in chosen if name not in TITLE_BY_METHOD]
    if unknown:
        raise InputError(
            f"methods must be some of {', '.join(TITLE_BY_METHOD)}, got {unknown[0]!r}"
            f"{suggestion(unknown[0], list(TITLE_BY_METHOD))}"
        )
    sizes = sorted({integer_in_range("modes", size, 1, 200) for size in modes})
    needing = [name for name in chosen if name in PYMOR_METHODS]
    if needing:
        need_pymor(f"palpate compare with {', '.join(needing)}")
    require("matplotlib", "palpate compare")
    check_folder(out)
    console = Console()
    given = {"spacing": spacing, "poisson": poisson}
    with console.status("making the model ready (the first run on a machine compiles it: a minute or two)"):
        made_body = BODIES[body](**{name: value for name, value in given.items() if value is not None})
    made = prepare_comparison(made_body, condense, console)
    compare_methods(made, chosen, sizes, console)
    report = build_report(made)
    out.mkdir(parents=True, exist_ok=True)
    figures = draw_comparison(made, report, out)
    written = [*report["summary"], full_table(report)]
    deliver(report, tables(report), out, [*REPORTS, *figures], as_json, written=written)
    return 1 if all(entry["failed"] for entry in report["methods"]) else 0
