"""What studies compile before their runs, in two processes."""

from __future__ import annotations

import subprocess
import sys
from contextlib import suppress
from types import SimpleNamespace

import pytest

from palpate.app.common.console import Console
from palpate.app.studies import second_form
from palpate.app.studies.reproduce import PAPER_EXAMPLES, assist
from palpate.app.studies.second_form import SecondForm
from palpate.dynamics.solid.strong import StrongSolid

OPTIONS = {"beam": {"spacing": 0.02 / 3, "load": 2.0}, "membrane": {"spacing": 0.0125}}
COMPILED = """
import warnings

from palpate.app.studies.reproduce import PAPER_EXAMPLES
from palpate.app.studies.study import compile_study
from palpate.compiled.code_cache import CodeCache
from palpate.dynamics.run.rollout import rollout

warnings.simplefilter("ignore")
asked, load = [], CodeCache.load_overload


def recorded(self, signature, context):
    asked.append(self._name)
    return load(self, signature, context)


CodeCache.load_overload = recorded
example, case = PAPER_EXAMPLES[{name!r}], PAPER_EXAMPLES[{name!r}].case(**{options})
for make in example.studies.values():
    study = make(case)
    compile_study(study, study.series)
    assert asked
    asked.clear()
    run = rollout(study.case.model, case.loads, duration=12 * case.every, every=case.every, progress=False)
    for train in study.series.values():
        rollout(train(study.case.model, run, 4), case.loads, duration=case.every, every=case.every, progress=False)
    assert not asked, asked
    asked.append("of the study before")
"""


@pytest.mark.slow
@pytest.mark.parametrize("name", PAPER_EXAMPLES)
def test_runs_call_nothing_that_is_not_compiled_before(name):
    code = COMPILED.format(name=name, options=OPTIONS[name])
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.slow
def test_the_second_process_compiles_all_but_what_the_first_does(monkeypatch):
    compiled, answers = [], []
    monkeypatch.setattr(second_form, "compile_study", lambda study, series: compiled.append((study.form, list(series))))
    # a body in the strong form compiles what the second process does not run
    monkeypatch.setattr(StrongSolid, "_build", lambda *arguments: pytest.fail("the strong form was made"))
    for name, options in OPTIONS.items():
        requests = iter([[name, options, [2], "", ""]])  # then it would wait for the first process
        with suppress(StopIteration):
            assist(lambda requests=requests: next(requests), answers.append)
    assert compiled == [("energy form", ["hyper-reduced"]), ("", ["hyper-reduced"])]
    assert answers == [{"compiled": True}] * 2


class _EndedChild:
    """A second process that has ended before its first answer."""

    def __init__(self):
        self.requests = []

    def answers(self):
        return iter(())

    def send(self, value):
        self.requests.append(value)


def test_the_first_process_does_the_work_of_a_second_one_that_has_ended(monkeypatch, tmp_path):
    first, ran, drawn = SimpleNamespace(title="full model", case=None), [], []
    example = SimpleNamespace(
        studies={"full": None, "energy_form": lambda case: SimpleNamespace(title="other", file="full_energy_form.h5")},
        second_case=object(), pictures=("beam.png",), figures={"beam.png": lambda studies, path: drawn.append(path)},
    )  # fmt: skip
    monkeypatch.setattr(second_form, "run_full", lambda study, out, files, console: ran.append(study.title))
    monkeypatch.setattr(second_form, "run_reduced", lambda study, sizes, console: ran.append(sizes))
    monkeypatch.setattr(second_form, "difference_of_forms", lambda first, study: "")
    left = tmp_path / "full_energy_form.complete.h5"
    left.touch()
    form = SecondForm(example, _EndedChild())
    form.start()
    form.wait_until_compiled()
    form.draw()
    (study,) = form.finish(first, [2], tmp_path, Console()).values()
    assert study.title == "other"
    assert ran == ["other", [2]]
    assert form.finish_pictures(first, tmp_path) == {}
    assert drawn == [tmp_path / "beam.png"]
    assert not left.exists()
