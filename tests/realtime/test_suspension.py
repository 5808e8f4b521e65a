"""The time of suspension is told from a stall by two clocks."""

from __future__ import annotations

import ctypes
import time
from types import SimpleNamespace

import pytest

from palpate.realtime import suspension
from palpate.realtime.suspension import suspended_time


@pytest.fixture
def clocks(monkeypatch):
    """A machine whose two clocks a test sets [s]."""
    at = SimpleNamespace(total=1000.0, up=900.0)
    monkeypatch.setattr(suspension, "HAS_CLOCKS", True)
    monkeypatch.setattr(suspension, "time_since_start", lambda: at.total)
    monkeypatch.setattr(suspension, "uptime", lambda: at.up)
    return at


def test_suspension_counts_and_a_stall_does_not(clocks):
    assert suspended_time() == 100.0
    clocks.total, clocks.up = 1020.0, 920.0  # no processor time
    assert suspended_time() == 100.0
    clocks.total += 3600.0  # the lid was closed
    assert suspended_time() == 3700.0


def test_a_stall_between_the_readings_does_not_count(clocks, monkeypatch):
    readings = iter([0.0, 10.0, 10.0, 10.001])  # ten seconds pass during the first try
    monkeypatch.setattr(suspension, "uptime", lambda: next(readings))
    clocks.total = 15.0
    assert suspended_time() == pytest.approx(5.0)


def test_this_machine_is_awake_while_it_runs_a_test():
    before = suspended_time()
    time.sleep(0.05)
    assert before >= -1e-3
    assert suspended_time() - before == pytest.approx(0.0, abs=1e-2)


def test_a_system_without_such_clocks_has_no_suspension(monkeypatch):
    monkeypatch.setattr(suspension, "HAS_CLOCKS", False)
    assert suspended_time() == 0.0


def test_windows_has_two_functions(monkeypatch):
    class Count:
        def __call__(self):
            return 2**40 + 5_000  # [ms]

    def unbiased(ticks):
        ticks._obj.value = 10_000 * 2**40 + 20_000_000  # [100 ns]

    kernel = SimpleNamespace(GetTickCount64=Count(), QueryUnbiasedInterruptTime=unbiased)
    monkeypatch.setattr(ctypes, "windll", SimpleNamespace(kernel32=kernel), raising=False)
    monkeypatch.setattr(suspension, "IS_WINDOWS", True)
    monkeypatch.setattr(suspension, "HAS_CLOCKS", True)
    assert suspended_time() == pytest.approx(3.0, abs=1e-3)
    assert kernel.GetTickCount64.restype is ctypes.c_ulonglong
