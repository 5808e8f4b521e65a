"""The command ``palpate compare``, on a small bar."""

from __future__ import annotations

import json
import sys

import numpy as np
import pytest

import palpate as pt
from palpate.app.cli import main
from palpate.app.compare import bodies
from palpate.app.compare.bodies import ComparedBody, compared_liver
from palpate.app.compare.report import summary

pytestmark = pytest.mark.slow

RUN_SECONDS = 0.02


@pytest.fixture
def small_bar(bar, tissue, monkeypatch):
    """Let the bar, pulled a little and by half its length, stand for the beam."""
    model = pt.Solid(bar, tissue, fixed="x-", form="energy", stiffness_damping=2e-5)

    def loads(size):
        return (pt.SurfaceForce("x+", force=lambda t: (size * np.sin(np.pi * t / RUN_SECONDS) ** 2, 0.0, 0.0)),)

    def make(spacing=0.005, poisson=0.45):
        return ComparedBody(
            "A bar", model, loads, 1e-4, 3.0, "N", ("x+",), RUN_SECONDS, 0.001,
            lambda run, modes: pt.galerkin(model, run, modes=modes), "POD of the nonlinear run",
        )  # fmt: skip

    monkeypatch.setitem(bodies.BODIES, "beam", make)


def test_the_comparison_writes_a_report_with_figures(small_bar, tmp_path, capsys):
    pytest.importorskip("pymor", reason="pyMOR is not installed: pip install 'palpate[linear]'")
    out = tmp_path / "out"
    words = ["compare", "beam", "--modes", "4", "9", "--methods", "modal", "pod", "hankel", "balanced", "irka"]
    assert main([*words, "--condense", "40", "--out", str(out), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    names = {path.name for path in out.iterdir()}
    assert names == {"report.json", "report.md", "errors.png", "response.png", "hankel.png", "cost.png"}
    assert len(report["methods"]) == 10
    for entry in report["methods"]:
        assert not entry["failed"], entry
        assert entry["errors"]["large"]["displacement"] > 0.05  # no linear body follows
        assert entry["step_seconds"] > 0
    entries = {(entry["method"], entry["modes"]): entry for entry in report["methods"]}
    for method in ("hankel", "balanced"):
        for modes in (4, 9):
            assert entries[method, modes]["absolute_error"] <= entries[method, modes]["hankel_bound"] * 1.000001
            assert entries[method, modes]["stable"]
    assert entries["pod", 9]["errors"]["small"]["displacement"] < 0.05
    nonlinear = report["nonlinear"]["entries"][-1]
    linear = min(entry["errors"]["large"]["displacement"] for entry in report["methods"])
    assert nonlinear["errors"]["large"]["displacement"] < linear
    assert any("every linear method misses" in line for line in report["summary"])
    assert "| modal 4 |" in (out / "report.md").read_text(encoding="utf-8")


def test_methods_that_do_not_use_pymor_run_without_it(small_bar, tmp_path, capsys, monkeypatch):
    monkeypatch.setitem(sys.modules, "pymor", None)
    monkeypatch.setitem(sys.modules, "pymor.core.logger", None)
    words = ["compare", "beam", "--modes", "4", "--condense", "40", "--out", str(tmp_path / "out")]
    assert main(words) == 2
    assert "pip install 'palpate[linear]'" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    assert main([*words, "--methods", "modal", "hankel", "moments"]) == 0
    shown = capsys.readouterr().out
    assert "modal 4" in shown
    assert "every linear method misses" in shown


@pytest.mark.parametrize(
    ("words", "message"), [(["--methods", "fourier"], "--methods must be some of modal"), (["--modes", "0"], "--modes")]
)
def test_bad_requests_are_refused(words, message, capsys):
    assert main(["compare", "beam", *words]) == 2
    assert message in capsys.readouterr().err


def test_the_summary_names_unstable_models():
    entry = {
        "failed": False, "method": "sobt-v", "modes": 4, "stable": False, "response_error": 3.0,
        "errors": {"small": None, "large": None},
    }  # fmt: skip
    report = {
        "methods": [entry], "nonlinear": {"name": "POD", "entries": []}, "condensing_error": 0.01,
        "parameters": {"small": 0.1, "large": 100.0, "unit": "N", "unknowns": 10, "condensed_to": 5},
    }  # fmt: skip
    assert "Unstable: sobt-v (4)." in summary(report)


def test_a_liver_too_coarse_is_refused():
    with pytest.raises(pt.InputError, match="spacing"):
        compared_liver(spacing=0.05)
