"""Linear reductions side by side, on a small bar."""

from __future__ import annotations

import json
import sys

import linear_reductions
import numpy as np
import pytest

import palpate as pt

pytestmark = [pytest.mark.slow, pytest.mark.release]

RUN_SECONDS = 0.02


@pytest.fixture
def compared(bar, tissue, monkeypatch, tmp_path):
    """Compare on the bar, pulled a little and by half its length; return the report by some options."""
    model = pt.Solid(bar, tissue, fixed="x-", form="energy", stiffness_damping=2e-5)

    def loads(size):
        return (pt.SurfaceForce("x+", force=lambda t: (size * np.sin(np.pi * t / RUN_SECONDS) ** 2, 0.0, 0.0)),)

    body = linear_reductions.Body(
        "A bar", model, loads, (1e-4, 3.0), "N", ("x+",), RUN_SECONDS, 0.001,
        lambda run, modes: pt.galerkin(model, run, modes=modes), "POD of the nonlinear run",
    )  # fmt: skip
    monkeypatch.setitem(linear_reductions.BODIES, "beam", lambda: body)

    def run(*words):
        line = ["linear_reductions.py", "beam", "--condense", "40", "--out", str(tmp_path), *words]
        monkeypatch.setattr(sys, "argv", line)
        linear_reductions.main()
        return json.loads((tmp_path / "report.json").read_text(encoding="utf-8"))

    return run


def test_the_comparison_writes_a_report_with_figures(compared, tmp_path):
    pytest.importorskip("pymor", reason="pyMOR is not installed: pip install 'palpate[linear]'")
    report = compared("--modes", "4", "9", "--methods", "modal", "pod", "hankel", "balanced", "irka")
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"report.json", "report.md", "errors.png", "response.png", "hankel.png"}
    assert "| modal 4 |" in (tmp_path / "report.md").read_text(encoding="utf-8")
    entries = {(entry["method"], entry["modes"]): entry for entry in report["methods"]}
    assert len(entries) == 10
    for entry in entries.values():
        assert not entry["failed"], entry
        assert entry["errors"]["large"]["displacement"] > 0.05  # no linear body follows
        assert entry["step_seconds"] > 0
    for method in ("hankel", "balanced"):
        for modes in (4, 9):
            assert entries[method, modes]["absolute_error"] <= entries[method, modes]["hankel_bound"] * 1.000001
            assert entries[method, modes]["stable"]
    assert entries["pod", 9]["errors"]["small"]["displacement"] < 0.05
    linear = min(entry["errors"]["large"]["displacement"] for entry in report["methods"])
    assert report["nonlinear"]["entries"][-1]["errors"]["large"]["displacement"] < linear


def test_without_pymor_its_methods_fail_and_the_others_run(compared, monkeypatch):
    monkeypatch.setitem(sys.modules, "pymor", None)
    modal, balanced = compared("--modes", "4", "--methods", "modal", "balanced")["methods"]
    assert not modal["failed"]
    assert "pip install 'palpate[linear]'" in balanced["reason"]
