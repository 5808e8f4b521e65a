"""The command ``fit``: what it prints, what it leaves, how it fails."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

import palpate as pt
from palpate.app.cli import main
from palpate.app.fit.command import FILES
from palpate.tissue.fitting import fit
from palpate.tissue.measurement_files import read_measurements

EXAMPLES = Path(__file__).parents[3] / "examples"
UNIAXIAL, SHEAR, RUBBER = (
    str(EXAMPLES / f"{name}.csv") for name in ("liver_synthetic_uniaxial", "liver_synthetic_shear", "rubber_treloar")
)


@pytest.fixture(scope="module")
def left(run_study, tmp_path_factory):
    """A fit of two files: its folder, report, standard output and standard error."""
    return run_study(["fit", "mooney-rivlin", UNIAXIAL, SHEAR], tmp_path_factory.mktemp("fit") / "results" / "liver")


@pytest.mark.slow
def test_the_listed_files_are_written_and_no_others(left, assert_drawn):
    out, report, stdout, stderr = left
    assert {path.name for path in out.iterdir()} == set(FILES)
    assert json.loads(stdout) == report
    assert "fitting MooneyRivlin to 2 curves" in stderr
    assert_drawn(out / "fit.png")


def test_the_report_has_the_parameters_of_the_fit(left):
    report = left[1]
    measured = [curve for path in (UNIAXIAL, SHEAR) for curve in read_measurements(path)]
    fitted = fit(pt.materials.MooneyRivlin, measured)
    for name, parameter in report["parameters"].items():
        assert parameter["value"] == pytest.approx(fitted.parameters[name], rel=1e-9)
        assert parameter["standard_error"] == pytest.approx(fitted.standard_errors[name], rel=1e-6)
    assert report["law"] == "MooneyRivlin"
    assert report["shear_modulus"] == pytest.approx(fitted.material.shear_modulus)
    assert [c["name"] for c in report["curves"]] == [
        "liver_synthetic_uniaxial, uniaxial",
        "liver_synthetic_shear, simple shear",
    ]
    assert [c["r_squared"] for c in report["curves"]] == pytest.approx([c.r_squared for c in fitted.curves])
    assert report["stability"]["stable"]
    assert all(source.startswith("Synthetic, not measured") for source in report["sources"])
    assert report["machine"]["versions"]["palpate"] == pt.__version__


def test_a_law_that_stiffens_less_than_the_tissue_is_reported_to_miss(left):
    assert [remark.split(" are systematic")[0] for remark in left[1]["remarks"]] == [
        "the residuals of liver_synthetic_uniaxial, uniaxial",
        "the residuals of liver_synthetic_shear, simple shear",
    ]


@pytest.mark.slow
def test_the_printed_report_has_parameters_curves_and_stability(tmp_path, capsys):
    assert main(["fit", "NeoHookean", RUBBER, "--out", str(tmp_path), "--poisson", "0.49"]) == 0
    said = " ".join(capsys.readouterr().out.split())
    for part in ("NeoHookean", "C1", "standard error", "equibiaxial", "Poisson's ratio 0.49", "stable for principal"):
        assert part in said


@pytest.mark.slow
def test_options_reach_the_fit(tmp_path, capsys):
    options = ["--fix", "C2=500", "--start", "C1=2e3", "--bounds", "C1=1e3,3e3", "--starts", "2", "--density", "1100"]
    assert main(["fit", "MooneyRivlin", UNIAXIAL, *options, "--out", str(tmp_path), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    assert list(report["parameters"]) == ["C1"]
    assert report["parameters"]["C1"] == {"value": 3e3, "standard_error": None}  # on its bound
    assert report["material"]["C2"] == 500
    assert report["material"]["density"] == 1100
    assert "C1 lies on its bound 3000" in report["remarks"]


@pytest.mark.parametrize(
    ("argv", "parts"),
    [
        (["Hooke", UNIAXIAL], ["LAW must be one of ", "MooneyRivlin, NeoHookean", "got 'Hooke'"]),
        (["Material", UNIAXIAL], ["LAW must be one of "]),
        (["NeoHookean", "nowhere.csv"], ["DATA.csv must be an existing file, got 'nowhere.csv'"]),
        (["NeoHookean", __file__], ["a column must be one of"]),
        (["NeoHookean", UNIAXIAL, "--start", "C1"], ["--start must be NAME=NUMBER", "'C1'"]),
        (["NeoHookean", UNIAXIAL, "--fix", "C1=stiff"], ["--fix must be NAME=NUMBER", "'C1=stiff'"]),
        (["NeoHookean", UNIAXIAL, "--bounds", "C1=1"], ["--bounds C1 must be two numbers"]),
        (["NeoHookean", UNIAXIAL, "--start", "C9=1"], ["a parameter of NeoHookean must be one of C1, got C9"]),
        (["NeoHookean", UNIAXIAL, "--poisson", "0.6"], ["--poisson"]),
        (["NeoHookean", UNIAXIAL, "--starts", "0"], ["--starts"]),
        (["NeoHookean"], ["DATA.csv"]),
    ],
)
def test_bad_input_is_refused_in_one_line(argv, parts, assert_refused, tmp_path):
    assert_refused(["fit", *argv, "--out", str(tmp_path / "results")], *parts)
    assert not (tmp_path / "results").exists()
