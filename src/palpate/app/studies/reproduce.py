"""``palpate reproduce``: an example of the paper, with the full model and with reduced ones.

The paper's models project the forces at all nodes. Next to them stand hyper-reduced models of the same numbers of
modes, which sample an energy at few points. Each is trained on the run of the full model that it reduces, and compared
with that run.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from time import perf_counter
from typing import Any, cast

from palpate.app.common.compile_ahead import CompiledFunctions, compile_ahead
from palpate.app.common.console import Console
from palpate.app.common.exit_status import RunError
from palpate.app.common.preparation import prepare
from palpate.app.common.rendering import DrawingError
from palpate.app.common.report import deliver
from palpate.app.common.vtkhdf import write_vtkhdf
from palpate.app.studies.beam import BEAM_EXAMPLE
from palpate.app.studies.example import Example
from palpate.app.studies.membrane import MEMBRANE_EXAMPLE
from palpate.app.studies.report import build_report, difference_of_forms, tables
from palpate.app.studies.study import PROJECTED, Study, compile_study, run_full, run_reduced
from palpate.extras import require
from palpate.faults import integer_in_range
from palpate.processes import Answer, Receive
from palpate.reduction.galerkin.model import GalerkinModel
from palpate.scenes.load_case import LoadCase

PAPER_EXAMPLES = {example.name: example for example in (BEAM_EXAMPLE, MEMBRANE_EXAMPLE)}


def reproduce(*, example: str, modes: Sequence[int], out: Path, as_json: bool = False, **options: Any) -> int:
    """Run an example and leave its files in a folder.

    Parameters
    ----------
    example : str
        One of `PAPER_EXAMPLES`.
    modes : sequence of int
        Sizes of the reduced models of each phase, from 1 to its snapshots.
    out : path
        Folder for the results; made if it does not exist. A file of an earlier study is replaced by the new one.
    as_json : bool
        Print the report as JSON instead of tables.
    options : mapping
        Of the example's case.

    Returns
    -------
    int
        0, or 1 if every reduced run failed.
    """
    chosen = PAPER_EXAMPLES[example]
    sizes = sorted({integer_in_range("modes", m, 1, chosen.snapshots) for m in modes})
    require("matplotlib", f"palpate reproduce {example}")
    console = Console()
    (key, make), *others = chosen.studies.items()
    with compile_ahead(compile_rest, [example, options]) as wait, closing(CompiledFunctions()) as compiled:
        case = prepare(lambda: chosen.case(**options), out, chosen.doubles, console)
        study = make(case)
        with console.status("compiling what is not compiled yet"):
            compile_study(study, [PROJECTED])
            if compiled.count:  # otherwise the other process finds all compiled, too
                wait()
    run_full(study, out, chosen.files, console)
    study.fields = chosen.fields(case.model, study.full.displacements)
    start = perf_counter()
    study.singular_values = [_singular_values(study, number) for number in range(len(study.phases))]
    pod_seconds = perf_counter() - start
    run_reduced(study, sizes, console)
    studies = {key: study} | {name: _run_other(make, study, sizes, out, console) for name, make in others}
    report = build_report(studies, chosen.quantities, chosen.claims, pod_seconds)
    with console.status("writing the figures and the file for ParaView"):
        full = study.full
        fields = {"displacement": full.displacements, "velocity": full.velocities, **study.fields}
        write_vtkhdf(out / f"{example}.vtkhdf", case.model.cloud, full.times, fields)
        report["missing"] = _draw(chosen, [each for each in studies.values() if each], out, console)
    deliver(report, tables(report, studies, chosen.rows), out, chosen.files, as_json)
    return 1 if all(entry["failed"] for entry in report["reduced"]) else 0


def compile_rest(receive: Receive, _answer: Answer) -> None:
    """Compile all of an example but its first full and projected models; its name and options are received."""
    example, options = receive()
    chosen = PAPER_EXAMPLES[example]
    case = chosen.case(**options)
    for number, make in enumerate(chosen.studies.values()):
        study = make(case)
        series = [name for name in study.series if number > 0 or name != PROJECTED]
        if series:
            compile_study(study, series)


def _singular_values(study: Study, number: int) -> Any:
    """Return the singular values (r,) that the modes of a phase belong to."""
    model = cast(GalerkinModel, study.series[PROJECTED](study.case.model, study.parts[number], 1))
    return model.basis.singular_values


def _run_other(
    make: Callable[[LoadCase], Study], first: Study, sizes: Sequence[int], out: Path, console: Console
) -> Study | None:
    """Run another form of the same body and its reduced models; return None if the full run diverges."""
    with console.status("making the other form of the model ready"):
        study = make(first.case)
    try:
        run_full(study, out, [], console)
    except RunError as error:
        console.say(str(error))
        return None
    console.say(difference_of_forms(first, study))
    run_reduced(study, sizes, console)
    return study


def _draw(example: Example, studies: Sequence[Study], out: Path, console: Console) -> dict[str, str]:
    """Draw the figures; return why those that are missing could not be drawn."""
    missing = {}
    for name, draw in example.figures.items():
        try:
            draw(studies, out / name)
        except DrawingError as error:
            missing[name] = str(error)
            console.say(f"{name} is missing: {error}")
    return missing
