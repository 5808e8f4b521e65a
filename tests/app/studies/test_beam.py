"""The command ``reproduce beam``: what it prints, what it leaves, how it fails."""

from __future__ import annotations

import json
import os

import h5py
import numpy as np
import pytest

import palpate as pt
from palpate.app.cli import main
from palpate.app.common.rendering import DrawingError, check_drawing
from palpate.app.studies.beam.report import slight_decrease_after_eight
from palpate.app.studies.beam.reproduce import FIGURES, FILES
from palpate.files import check_space

COARSE = ["reproduce", "beam", "--spacing", str(0.02 / 3), "--load", "2"]


@pytest.fixture(scope="module")
def study(run_study, tmp_path_factory):
    """A coarse study: its folder, report, standard output and standard error."""
    return run_study([*COARSE, "--modes", "4", "2", "2"], tmp_path_factory.mktemp("study") / "results" / "beam")


@pytest.mark.slow
def test_the_listed_files_are_written_and_no_others(study):
    out = study[0]
    assert {path.name for path in out.iterdir()} == set(FILES)


@pytest.mark.slow
@pytest.mark.parametrize("name", FIGURES)
def test_no_figure_is_blank(study, assert_drawn, name):
    assert_drawn(study[0] / name)


@pytest.mark.slow
def test_standard_output_is_the_report_and_nothing_else(study):
    _, report, stdout, stderr = study
    assert json.loads(stdout) == report
    assert "projected, 4 modes at 496 nodes" in stderr
    assert "hyper-reduced, 4 modes at" in stderr


@pytest.mark.slow
def test_the_report_has_the_parameters_and_the_machine(study):
    report = study[1]
    expected = {"spacing": 0.02 / 3, "load": 2.0, "poisson": 0.49, "duration": 1.0, "every": 0.01}
    assert report["parameters"] == pytest.approx(expected)
    assert report["nodes"] == 31 * 4 * 4
    assert report["machine"]["versions"]["palpate"] == pt.__version__
    assert report["machine"]["cpu_count"] == os.cpu_count()
    assert report["stability"]["step"] > 0
    assert report["missing"] == {}


@pytest.mark.slow
def test_the_pulled_end_moves_as_that_of_a_slender_bar(study):
    full = study[1]["full"]
    young = 2 * 61.2e3 * 1.49
    assert full["peak_tip_displacement"] == pytest.approx(2.0 * 0.2 / (young * 0.02**2), rel=0.05)
    assert full["peak_tip_time"] == pytest.approx(0.5, abs=0.02)
    assert full["load_at_peak"] == pytest.approx(2.0)
    assert full["reaction_at_peak"] == pytest.approx(2.0, rel=0.05)
    assert full["energy_balance"] < 0.03
    assert full["real_time_factor"] == pytest.approx(1.0 / full["wall_seconds"])


def by_series(report):
    """The entries of the reduced runs of each series, in the order of the report."""
    names = ("projected", "hyper-reduced")
    assert {entry["series"] for entry in report["reduced"]} == set(names)
    return [[entry for entry in report["reduced"] if entry["series"] == name] for name in names]


@pytest.mark.slow
def test_every_reduced_model_of_both_series_is_reported_once_in_order(study):
    report = study[1]
    for entries in by_series(report):
        assert [entry["modes"] for entry in entries] == [2, 4]
        assert entries[1]["projection_error"] < entries[0]["projection_error"]
        for entry in entries:
            assert not entry["failed"]
            assert set(entry["errors"]) == {"displacement", "velocity", "energy", "reaction"}
            # no run in the space of the modes is nearer than the projection, up to the norm's choice
            assert 0 < entry["projection_error"] <= 1.1 * entry["errors"]["displacement"]
            full = report["full" if entry["series"] == "projected" else "energy_form"]
            assert entry["ratio"] == pytest.approx(entry["wall_seconds"] / full["wall_seconds"])
            assert entry["steps"] >= 100
            assert entry["seconds_per_step"] == pytest.approx(entry["wall_seconds"] / entry["steps"])


@pytest.mark.slow
def test_projected_models_evaluate_all_nodes_and_hyper_reduced_ones_few(study):
    report = study[1]
    projected, sampled = by_series(report)
    assert all(entry["nodes"] == report["nodes"] for entry in projected)
    assert all(0 < entry["nodes"] < report["nodes"] / 5 for entry in sampled)


@pytest.mark.slow
def test_the_report_compares_the_energy_form_with_the_strong_form(study):
    report = study[1]
    energy = report["energy_form"]
    # two discretisations of one body
    assert energy["peak_tip_displacement"] == pytest.approx(report["full"]["peak_tip_displacement"], rel=0.05)
    assert abs(energy["energy_balance"]) < 1e-3
    forms = report["forms"]
    assert forms["until"] == pytest.approx(0.9)
    assert 0 < forms["displacement_until"] < forms["errors"]["displacement"] < 0.5


@pytest.mark.slow
def test_hyper_reduced_models_are_compared_with_the_energy_form_that_they_reduce(study):
    out, report = study[:2]
    _, sampled = by_series(report)
    assert sampled[1]["errors"]["displacement"] < 0.1
    assert sampled[1]["ratio"] == pytest.approx(sampled[1]["wall_seconds"] / report["energy_form"]["wall_seconds"])
    runs = [pt.Trajectory.load(out / name) for name in ("full.h5", "full_energy_form.h5")]
    assert pt.relative_errors(*runs).as_dict() == pytest.approx(report["forms"]["errors"])


@pytest.mark.slow
def test_the_messages_name_the_difference_of_the_forms_once_with_its_reason(study):
    lines = [line for line in study[3].splitlines() if "The two full models differ by" in line]
    assert len(lines) == 1
    assert "differ in phase" in lines[0]


@pytest.mark.slow
def test_singular_values_descend_and_claims_of_the_paper_are_listed(study):
    report = study[1]
    values = np.array(report["singular_values"])
    assert len(values) == report["snapshots"] == 101
    assert np.all(np.diff(values) <= 0)
    assert [claim["figure"] for claim in report["paper"]] == ["Figure 3"] * 2 + ["Figure 4"] + ["Figure 5"] * 2
    assert report["paper"][0]["holds"] is None  # not run with 6 modes
    sampled = report["paper_hyper_reduced"]
    assert [claim["claim"] for claim in sampled] == [claim["claim"] for claim in report["paper"]]
    assert [claim["here"] for claim in sampled] != [claim["here"] for claim in report["paper"]]


@pytest.mark.slow
def test_the_snapshots_and_the_export_agree(study):
    out = study[0]
    run = pt.Trajectory.load(out / "full.h5")
    assert run.complete
    with h5py.File(out / "beam.vtkhdf") as file:
        exported = file["VTKHDF/PointData/displacement"][:].reshape(run.displacements.shape)
        np.testing.assert_array_equal(exported, run.displacements)
        assert set(file["VTKHDF/PointData"]) == {"displacement", "velocity", "von_mises"}
        stress = file["VTKHDF/PointData/von_mises"][:].reshape(101, -1)
    middle = np.abs(run.points[:, 0] - 0.1) < 0.02  # far from the ends the stress is the force over the area
    assert stress[50, middle].mean() == pytest.approx(2.0 / 0.02**2, rel=0.05)


@pytest.mark.parametrize(
    ("option", "named", "allowed"),
    [
        (["--spacing", "0.01"], "--spacing", "0.00666667] m"),
        (["--spacing", "nan"], "--spacing", "0.00666667] m"),
        (["--poisson", "0.6"], "--poisson", "0.499]"),
        (["--load", "0"], "--load", "(0, 1000] N"),
        (["--modes", "0"], "--modes", "an integer in [1, 100]"),
        (["--modes", "2", "-3"], "--modes", "an integer in [1, 100]"),
        (["--modes", "1000"], "--modes", "an integer in [1, 100]"),
        (["--modes", "two"], "--modes must be a whole number", "'two'"),
    ],
)
def test_bad_values_are_refused_in_one_line_and_no_file_is_left(tmp_path, assert_refused, option, named, allowed):
    out = tmp_path / "results"
    assert_refused([*COARSE, "--out", str(out), *option], named, allowed)
    assert not out.exists()


def test_a_file_in_the_place_of_the_folder_is_refused(tmp_path, assert_refused):
    place = tmp_path / "results"
    place.write_text("mine")
    for out in (place, place / "beam"):
        assert_refused([*COARSE, "--out", str(out)], "--out ", "is not a folder")
    assert place.read_text() == "mine"
    assert list(tmp_path.iterdir()) == [place]


def test_a_folder_that_cannot_be_written_is_refused(tmp_path, assert_refused, monkeypatch):
    def refuse(*_arguments, **_options):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("palpate.files.TemporaryDirectory", refuse)  # the superuser may write anywhere
    assert_refused([*COARSE, "--out", str(tmp_path / "results")], "--out ", "cannot be written (permission denied)")
    assert list(tmp_path.iterdir()) == []


def test_a_disk_without_room_is_refused(tmp_path):
    with pytest.raises(pt.InputError, match=r"this run writes about 1000000000000 MB"):
        check_space(tmp_path / "results", 10**18)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (KeyboardInterrupt(), 130, "interrupted in the run of the full model, strong form"),
        (pt.DivergenceError("ran away"), 1, "diverged: ran away"),
    ],
)
def test_an_interrupted_full_run_keeps_its_frames_and_names_their_file(tmp_path, capsys, stop_after, error, code, said):
    stop_after(0.045, error)
    assert main([*COARSE, "--out", str(tmp_path)]) == code
    captured = capsys.readouterr()
    last = captured.err.splitlines()[-1]
    assert last.startswith("palpate: ")
    assert said in last
    assert str(tmp_path / "full.partial.h5") in last
    assert "Traceback" not in captured.err
    kept = pt.Trajectory.load(tmp_path / "full.partial.h5")
    assert not kept.complete
    np.testing.assert_allclose(kept.times, np.arange(5) * 0.01)


def test_a_machine_that_cannot_draw_raises_with_the_packages_to_install(monkeypatch):
    monkeypatch.setattr("palpate.app.common.rendering.PROBE", "import os; os.abort()")
    with pytest.raises(DrawingError, match="apt-get install libegl1 libgl1-mesa-dri"):
        check_drawing()


def test_an_error_that_falls_to_a_quarter_after_eight_modes_is_not_a_slight_decrease():
    entries = {modes: {"errors": {"displacement": error}} for modes, error in ((6, 0.024), (8, 0.038), (12, 0.008))}
    *_, here, holds = slight_decrease_after_eight(entries)
    assert (here, holds) == ("3.800% with 8, 0.800% with 12", False)
    entries[12] = {"errors": {"displacement": 0.03}}
    assert slight_decrease_after_eight(entries)[-1]
    assert slight_decrease_after_eight({8: entries[8]})[-1] is None
