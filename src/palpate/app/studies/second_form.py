"""The second process of ``palpate reproduce``: it takes over what does not wait for the first runs of an example.

Of an example with two forms of one body it compiles, runs and reduces the second form, and draws the pictures of the
first full run. Of an example with one form it compiles its sampled models. Where there is no second process, or it has
ended early, the first one does the same.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numba

from palpate.app.common.console import Console
from palpate.app.common.exit_status import RunError
from palpate.app.common.rendering import DrawingError
from palpate.app.studies.example import Example
from palpate.app.studies.report import difference_of_forms
from palpate.app.studies.study import PROJECTED, Shown, Study, compile_study, run_full, run_reduced
from palpate.core.files import flush_and_rename
from palpate.core.processes import Answer, Child, Receive
from palpate.dynamics.run.trajectory import Trajectory

COMPILED_ANSWER, STUDY_ANSWER, PICTURES_ANSWER = "compiled", "study", "pictures"  # answers of the second process
START_REQUEST, DRAW_REQUEST = "start", "draw"  # requests to it


def assist_example(
    example: Example, options: Mapping[str, Any], request: tuple[Sequence[int], Path, Path], receive: Receive,
    answer: Answer,
) -> None:  # fmt: skip
    """Do the work of the second process.

    `given` has the numbers of modes, the folder of the results, and one for runs that figures show.
    """
    sizes, out, shown = request
    if example.second_case is None:
        (make,) = example.studies.values()
        study = make(example.case(**options))
        compile_study(study, [name for name in study.series if name != PROJECTED])
        answer({COMPILED_ANSWER: True})
        return
    numba.set_num_threads(1)
    make_first, make = example.studies.values()
    study = make(example.second_case(**options))
    compile_study(study, study.series)
    answer({COMPILED_ANSWER: True})
    receive()  # START_REQUEST: the folder is there
    answer({STUDY_ANSWER: _run_study(study, sizes, out, shown)})
    receive()  # DRAW_REQUEST: the first full run is complete
    first = make_first(example.case(**options))
    first.full = Trajectory.load(out / first.file)
    first.fields = example.fields(first.case.model, first.full.displacements)
    answer({PICTURES_ANSWER: draw_figures(example, example.pictures, [first], out)})


def _run_study(study: Study, sizes: Sequence[int], out: Path, shown: Path) -> dict[str, Any]:
    """Run a study in the second process; return its results, with the names of the files of runs."""
    lines: list[str] = []
    console = _Lines(lines)
    final, study.file = study.file, _waiting_name(study.file)
    try:
        run_full(study, out, [], console)
    except RunError as error:
        return {"failed": str(error)}
    study.file, full_lines = final, len(lines)
    run_reduced(study, sizes, console)
    runs = {}
    for series, each in study.shown.items():
        names = [f"{series} {number}.h5" for number in range(len(each.runs))]
        for name, run in zip(names, each.runs, strict=True):
            run.save(shown / name)
        runs[series] = each.modes, names
    texts = {"full_lines": lines[:full_lines], "reduced_lines": lines[full_lines:]}
    return texts | {"reduced": study.reduced, "shown": runs, "folder": str(shown)}


def _waiting_name(name: str) -> str:
    """Return the name of the file of a run while the files of an earlier study may still be in the folder."""
    return f"{name.removesuffix('.h5')}.complete.h5"


class _Lines(Console):
    """Collects lines for the first process to print."""

    def __init__(self, lines: list[str]) -> None:
        super().__init__()
        self._lines = lines

    def say(self, text: str) -> None:
        self._lines.append(text)


class SecondForm:
    """What the first process requires of the second one, the child that calls `assist_example`, if there is one."""

    def __init__(self, example: Example, child: Child | None) -> None:
        self._example, self._child = example, child
        self._answers: Iterator[Any] = iter(()) if child is None else child.answers()
        self.runs = child is not None and example.second_case is not None
        self.pictures: Sequence[str] = example.pictures if self.runs else ()

    def start(self) -> None:
        """Allow it to write into the folder of the results."""
        self._send(START_REQUEST)

    def draw(self) -> None:
        """Let it draw the pictures of the first full run."""
        self._send(DRAW_REQUEST)

    def _send(self, request: str) -> None:
        if self.runs and self._child is not None:
            self._child.send(request)

    def wait_until_compiled(self) -> None:
        """Wait for what the first process calls next, of an example with one form."""
        if not self.runs:
            next(self._answers, None)

    def finish(self, first: Study, sizes: Sequence[int], out: Path, console: Console) -> dict[str, Study | None]:
        """Return the second study by name, if there is one; None for one whose full run diverged."""
        return {
            name: self._finish(make(first.case), first, sizes, out, console)
            for name, make in list(self._example.studies.items())[1:]
        }

    def _finish(
        self, study: Study, first: Study, sizes: Sequence[int], out: Path, console: Console
    ) -> Study | None:  # fmt: skip
        answer = self._wait_for(STUDY_ANSWER, f"in the runs of the other form; those of the {first.title} are kept")
        try:
            if answer is None:
                (out / _waiting_name(study.file)).unlink(missing_ok=True)  # of a second process that has ended
                run_full(study, out, [], console)
            else:
                _read_study(study, answer, out)
        except RunError as error:
            console.say(str(error))
            return None
        if answer is None:
            console.say(difference_of_forms(first, study))
            run_reduced(study, sizes, console)
            return study
        for line in (*answer["full_lines"], difference_of_forms(first, study), *answer["reduced_lines"]):
            console.say(line)
        return study

    def _wait_for(self, key: str, interrupted: str) -> Any:
        """Return an answer of the second process, or None if it does not run or has ended."""
        try:
            return next((each[key] for each in self._answers if key in each), None) if self.runs else None
        except KeyboardInterrupt:
            raise KeyboardInterrupt(interrupted) from None

    def finish_pictures(self, first: Study, out: Path) -> dict[str, str]:
        """Return why pictures of the first full run could not be drawn, by name; draw them if nobody has."""
        if not self.pictures:
            return {}
        missing = self._wait_for(PICTURES_ANSWER, "in the figures; the files of the runs are kept")
        return draw_figures(self._example, self.pictures, [first], out) if missing is None else missing


def _read_study(study: Study, answer: Mapping[str, Any], out: Path) -> None:
    """Set the results of a study to those of the second process."""
    if "failed" in answer:
        raise RunError(answer["failed"])
    flush_and_rename(out / _waiting_name(study.file), out / study.file)
    study.full = Trajectory.load(out / study.file)
    study.parts, study.reduced = [study.full], answer["reduced"]
    for series, (modes, names) in answer["shown"].items():
        study.shown[series] = Shown(modes, [Trajectory.load(Path(answer["folder"], name)) for name in names])


def draw_figures(example: Example, names: Iterable[str], studies: Sequence[Study], out: Path) -> dict[str, str]:
    """Draw figures; return why those that are missing could not be drawn."""
    missing = {}
    for name in names:
        try:
            example.figures[name](studies, out / name)
        except DrawingError as error:
            missing[name] = str(error)
    return missing
