"""``palpate reproduce``: an example of the paper, with the full model and with reduced ones.

The paper's models project the forces at all nodes. Next to them stand hyper-reduced models of the same numbers of
modes, which sample an energy at few points. Each is trained on the run of the full model that it reduces, and compared
with that run.
"""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any, cast

import numba

from palpate.app.common.compile_ahead import CompiledFunctions, second_process
from palpate.app.common.console import Console
from palpate.app.common.load_cases import build_load_case
from palpate.app.common.report import deliver
from palpate.app.studies.beam import BEAM_EXAMPLE
from palpate.app.studies.membrane import MEMBRANE_EXAMPLE
from palpate.app.studies.report import build_report, tables
from palpate.app.studies.second_form import SecondForm, assist_example, draw_figures
from palpate.app.studies.study import PROJECTED, Study, compile_study, run_full, run_reduced
from palpate.core.extras import require
from palpate.core.faults import integer_in_range
from palpate.core.processes import Answer, Receive
from palpate.core.vtk import write_vtkhdf
from palpate.reduction.galerkin.model import GalerkinModel

PAPER_EXAMPLES = {example.name: example for example in (BEAM_EXAMPLE, MEMBRANE_EXAMPLE)}


def reproduce(*, example: str, modes: Sequence[int], out: Path, as_json: bool = False, **options: Any) -> int:
    """Run one of `PAPER_EXAMPLES` and leave its files in a folder, where they replace those of an earlier study.

    `modes` are the sizes of the reduced models of each phase, from 1 to its snapshots; `options` are those of the
    example's case. Returns 0, or 1 if every reduced run failed.
    """
    chosen = PAPER_EXAMPLES[example]
    sizes = sorted({integer_in_range("modes", m, 1, chosen.snapshots) for m in modes})
    require("matplotlib", f"palpate reproduce {example}")
    console = Console()
    key, make = next(iter(chosen.studies.items()))
    with ExitStack() as stack:
        shown = stack.enter_context(TemporaryDirectory(prefix="palpate-"))
        request = [example, options, sizes, str(out), shown]
        other = SecondForm(chosen, stack.enter_context(second_process(assist, request)))
        compiled = stack.enter_context(closing(CompiledFunctions()))
        case = build_load_case(lambda: chosen.case(**options), out, chosen.doubles, console)
        other.start()
        study = make(case)
        with console.status("compiling what is not compiled yet"):
            compile_study(study, [PROJECTED])
            if compiled.count:  # otherwise the other process finds all compiled, too
                other.wait_until_compiled()
        if other.runs:  # each process has one processor, so that the times of all runs compare
            stack.callback(numba.set_num_threads, numba.get_num_threads())
            numba.set_num_threads(1)
        run_full(study, out, chosen.files, console)
        other.draw()
        study.fields = chosen.fields(case.model, study.full.displacements)
        start = perf_counter()
        study.singular_values = [_singular_values(study, number) for number in range(len(study.phases))]
        pod_seconds = perf_counter() - start
        run_reduced(study, sizes, console)
        studies = {key: study} | other.finish(study, sizes, out, console)
        report = build_report(studies, chosen.quantities, chosen.claims, pod_seconds)
        with console.status("writing the figures and the file for ParaView"):
            full = study.full
            fields = {"displacement": full.displacements, "velocity": full.velocities, **study.fields}
            cloud = case.model.cloud
            write_vtkhdf(out / f"{example}.vtkhdf", cloud.points, cloud.triangles, full.times, fields)
            drawn = [name for name in chosen.figures if name not in other.pictures]
            missing = draw_figures(chosen, drawn, [each for each in studies.values() if each], out)
            report["missing"] = missing | other.finish_pictures(study, out)
            for name, text in report["missing"].items():
                console.say(f"{name} is missing: {text}")
        deliver(report, tables(report, studies, chosen.rows), out, chosen.files, as_json)
    return 1 if all(entry["failed"] for entry in report["reduced"]) else 0


def assist(receive: Receive, answer: Answer) -> None:
    """Take over what does not wait for the first full and projected runs of an example, in a second process.

    It receives name and options of the example, the numbers of modes, the folder, and one for runs that figures show.
    """
    example, options, sizes, folder, shown = receive()
    assist_example(PAPER_EXAMPLES[example], options, (sizes, Path(folder), Path(shown)), receive, answer)


def _singular_values(study: Study, number: int) -> Any:
    """Return the singular values (r,) that the modes of a phase belong to."""
    model = cast(GalerkinModel, study.series[PROJECTED](study.case.model, study.parts[number], 1))
    return model.basis.singular_values
