"""Compilation in a second process."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numba
import pytest

from palpate.app.common import compile_ahead as module
from palpate.app.common.compile_ahead import compile_ahead, only_compiled_code
from palpate.app.view.compile_engine import compile_engine
from palpate.core import processes
from palpate.core.parameters import written_section
from palpate.scenes.description import Tissue


def test_one_processor_starts_no_second_process(monkeypatch):
    def start(*arguments, **options):
        raise AssertionError("a process was started")

    monkeypatch.setattr(module, "_processors", lambda: 1)
    monkeypatch.setattr(processes.subprocess, "Popen", start)
    with compile_ahead(compile_engine, written_section(Tissue())) as wait:
        wait()


@pytest.mark.slow
def test_the_engine_of_a_law_is_compiled_in_a_second_process(monkeypatch):
    monkeypatch.setattr(module, "_processors", lambda: 2)
    with compile_ahead(compile_engine, written_section(Tissue(parameters={"C1": 900.0}))) as wait:
        assert wait() is True


def test_the_second_process_ends_with_the_first(monkeypatch):
    started = []
    start = processes.subprocess.Popen

    def popen(*arguments, **options):
        started.append(start(*arguments, **options))
        return started[0]

    monkeypatch.setattr(module, "_processors", lambda: 2)
    monkeypatch.setattr(processes.subprocess, "Popen", popen)
    with compile_ahead(compile_engine, written_section(Tissue())):
        assert started[0].poll() is None
    assert started[0].poll() is not None


def test_a_block_ends_where_code_would_have_to_be_compiled():
    function, results = numba.njit(lambda x: x + 1), ["before"]
    with only_compiled_code():
        results.append(function(1.0))
    assert results == ["before"]
    assert function(1.0) == 2.0  # compiles
    with only_compiled_code():
        results.append(function(1.0))
    assert results == ["before", 2.0]


def test_another_thread_compiles_next_to_such_a_block():
    theirs, ours, results = numba.njit(lambda x: x + 2), numba.njit(lambda x: x + 3), ["before"]
    with ThreadPoolExecutor(1) as threads, only_compiled_code():
        assert threads.submit(theirs, 1.0).result() == 3.0
        results.append(theirs(1.0))
        results.append(ours(1.0))
    assert results == ["before", 3.0]
