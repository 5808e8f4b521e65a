"""What studies compile before their runs, in two processes."""

from __future__ import annotations

import subprocess
import sys
from contextlib import suppress

import pytest

from palpate.app.studies import second_form
from palpate.app.studies.reproduce import PAPER_EXAMPLES, assist
from palpate.dynamics.solid.strong import StrongSolid

OPTIONS = {"beam": {"spacing": 0.02 / 3, "load": 2.0}, "membrane": {"spacing": 0.0125}}
COMPILED = """
import warnings

from palpate.app.studies.reproduce import PAPER_EXAMPLES
from palpate.app.studies.study import compile_study
from palpate.code_cache import CodeCache
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
