"""The command ``reproduce membrane``: what it prints, what it leaves, how it fails."""

from __future__ import annotations

import json

import h5py
import numpy as np
import pytest

import palpate as pt
from palpate.app.cli import main
from palpate.app.studies.membrane.figures import draw_error, draw_time
from palpate.app.studies.membrane.reproduce import FIGURES, FILES
from palpate.scenes.membrane import AFTER, membrane, tool_tip

MEMBRANE = ["reproduce", "membrane"]
COARSE = 0.0125
COARSEST = [*MEMBRANE, "--spacing", "0.05"]


@pytest.fixture(scope="module")
def study(run_study, tmp_path_factory):
    """A coarse study: its folder, report, standard output and standard error."""
    out = tmp_path_factory.mktemp("study") / "results" / "membrane"
    return run_study([*MEMBRANE, "--spacing", str(COARSE), "--modes", "8", "2", "8"], out)


@pytest.fixture(scope="module")
def model():
    return membrane(spacing=COARSE).model


@pytest.mark.slow
def test_the_listed_files_are_written_and_no_others(study):
    assert {path.name for path in study[0].iterdir()} == set(FILES)


@pytest.mark.slow
@pytest.mark.parametrize("name", FIGURES)
def test_no_figure_is_blank(study, assert_drawn, name):
    assert_drawn(study[0] / name)


@pytest.mark.slow
def test_standard_output_is_the_report_and_nothing_else(study):
    _, report, stdout, stderr = study
    assert json.loads(stdout) == report
    assert "projected, 8 modes at 217 nodes, after" in stderr
    assert "hyper-reduced, 8 modes at " in stderr


@pytest.mark.slow
def test_the_report_has_the_parameters_of_the_run(study, model):
    report = study[1]
    numbers = {"spacing": COARSE, "tool_radius": 0.0, "prestretch": 1.0, "jitter": 0.0, "seed": 0}
    expected = numbers | {"duration": 0.2, "every": 0.002, "after": "return", "layout": "rings"}
    assert report["parameters"] == expected
    assert report["nodes"] == 1 + 3 * 8 * 9  # 6 k on ring k
    assert report["stability"]["step"] == pytest.approx(model.stability.step)
    assert report["missing"] == {}


@pytest.mark.slow
def test_the_reported_work_is_that_of_the_tool_force(study):
    push, after = (study[1]["full"][name] for name in ("push", "after"))
    assert (push["end_time"], after["end_time"]) == pytest.approx((0.1, 0.2))
    assert push["centre_deflection_at_end"] == pytest.approx(0.01)
    assert after["centre_deflection_at_end"] == 0.0
    assert 0 < push["mean_deflection_at_end"] < 0.01
    assert push["energy_balance"] < 0.01
    assert 0 < push["tool_force_at_end"] <= push["peak_tool_force"]
    assert 0 < push["largest_wrinkled_share"] < 1
    assert push["largest_wrinkled_area"] == pytest.approx(push["largest_wrinkled_share"] * np.pi * 0.1**2)
    full = pt.Trajectory.load(study[0] / "full.h5")
    pushed = full.times < 0.1 + 1e-9
    work = np.trapezoid(0.1 * full.reactions["tool"][pushed, 2], full.times[pushed])  # it moves at 0.1 m/s
    assert full.external[pushed][-1] == pytest.approx(work, rel=0.05)


@pytest.mark.slow
def test_every_reduced_model_is_reported_once_in_order(study):
    report = study[1]
    expected = [("projected", 2), ("projected", 8), ("hyper-reduced", 2), ("hyper-reduced", 8)]
    assert [(entry["series"], entry["modes"]) for entry in report["reduced"]] == expected
    for entry in report["reduced"]:
        assert not entry["failed"]
        sampled = entry["series"] == "hyper-reduced"
        assert list(entry["phases"]) == ["push", "after"]
        for name, phase in entry["phases"].items():
            assert set(phase["errors"]) == {"displacement", "velocity", "energy", "reaction"}
            assert phase["projection_error"] <= 1.1 * phase["errors"]["displacement"]
            assert phase["ratio"] == pytest.approx(phase["wall_seconds"] / report["full"][name]["wall_seconds"])
            assert phase["steps"] == 1000 if sampled or name == "after" else 250
            assert phase["nodes"] < 6 * 217 if sampled else phase["nodes"] == 217
        # the mean over all snapshots is that of the phases' means
        halves = [phase["errors"]["displacement"] for phase in entry["phases"].values()]
        assert min(halves) < entry["joined"]["errors"]["displacement"] < max(halves)
        assert entry["joined"]["steps"] == (2000 if sampled else 1250)
    for series in (slice(0, 2), slice(2, 4)):
        first, last = (entry["phases"]["push"] for entry in report["reduced"][series])
        assert last["projection_error"] < first["projection_error"]
        assert last["errors"]["displacement"] < first["errors"]["displacement"]


@pytest.mark.slow
def test_singular_values_descend(study):
    report = study[1]
    for name, values in report["singular_values"].items():
        assert len(values) == report["snapshots"][name] == 51
        assert np.all(np.diff(values) <= 0)


@pytest.mark.slow
def test_claims_of_the_paper_are_compared_during_the_push(study):
    report = study[1]
    two, eight = (entry["phases"]["push"]["errors"]["displacement"] for entry in report["reduced"][:2])
    fast = report["reduced"][0]["phases"]["push"]["ratio"] < 0.1
    assert [claim["figure"] for claim in report["paper"]] == 4 * ["Figure 7"] + 2 * ["Figure 8"]
    # nothing was run with more than 8 modes, nor with three sizes
    expected = [two > 0.1, eight < 0.2 * two, eight < 0.03, None, fast, None]
    assert [claim["holds"] for claim in report["paper"]] == expected


@pytest.mark.slow
def test_the_snapshots_are_of_both_phases_and_follow_the_tool(study, model):
    run = pt.Trajectory.load(study[0] / "full.h5")
    assert run.complete
    np.testing.assert_allclose(run.times, np.arange(101) * 0.002)
    expected = [tool_tip(time) for time in run.times]
    np.testing.assert_allclose(run.displacements[:, model.cloud.group("tool")[0], 2], expected, atol=1e-15)
    assert not run.displacements[:, model.cloud.group("rim")].any()


@pytest.mark.slow
def test_vtk_reads_the_sheet_and_its_stresses(study, model):
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkIOHDF import vtkHDFReader

    reader = vtkHDFReader()
    reader.SetFileName(str(study[0] / "membrane.vtkhdf"))
    reader.UpdateInformation()
    reader.UpdateTimeStep(0.1)
    grid = reader.GetOutputDataObject(0)
    points = vtk_to_numpy(grid.GetPoints().GetData())
    np.testing.assert_array_equal(points, np.column_stack([model.cloud.points, np.zeros(len(points))]))
    names = ("displacement", "principal_stress_1", "principal_stress_2", "tension", "velocity")
    fields = {name: vtk_to_numpy(grid.GetPointData().GetArray(name)) for name in names}
    np.testing.assert_array_equal(fields["tension"], model.tension(fields["displacement"]))
    np.testing.assert_allclose(
        np.column_stack([fields["principal_stress_1"], fields["principal_stress_2"]]),
        model.principal_stress(fields["displacement"]),
    )
    with h5py.File(study[0] / "membrane.vtkhdf") as file:
        assert set(file["VTKHDF/PointData"]) == set(names)


@pytest.mark.parametrize(
    ("option", "named", "allowed"),
    [
        (["--spacing", "0.06"], "--spacing", "at most 0.05 m"),
        (["--spacing", "0.0001"], "--spacing", "[0.001"),
        (["--spacing", "nan"], "--spacing", "[0.001"),
        (["--after", "stay"], "--after must be one of", "'stay'"),
        (["--tool-radius", "-0.01"], "--tool-radius", "[0, 0.08] m"),
        (["--tool-radius", "0.09"], "--tool-radius", "[0, 0.08] m"),
        (["--prestretch", "0.9"], "--prestretch", "[1, 10]"),
        (["--layout", "random"], "--layout must be one of", "'random'"),
        (["--jitter", "0.5"], "--jitter", "[0, 0.3]"),
        (["--seed", "-1"], "--seed", "an integer in [0, "),
        (["--modes", "0"], "--modes", "an integer in [1, 50]"),
        (["--modes", "2", "51"], "--modes", "an integer in [1, 50]"),
        (["--out", __file__], "--out ", "is not a folder"),
    ],
)
def test_bad_values_are_refused_in_one_line_and_no_file_is_left(tmp_path, assert_refused, option, named, allowed):
    out = tmp_path / "results"
    assert_refused([*COARSEST, "--out", str(out), *option], named, allowed)
    assert not out.exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (KeyboardInterrupt(), 130, "interrupted in the run of the full model"),
        (pt.DivergenceError("ran away"), 1, "diverged: ran away"),
    ],
)
def test_an_interrupted_full_run_keeps_the_frames_of_both_phases(tmp_path, capsys, stop_after, error, code, said):
    stop_after(0.109, error)
    assert main([*COARSEST, "--out", str(tmp_path)]) == code
    last = capsys.readouterr().err.splitlines()[-1]
    partials = [tmp_path / f"{name}.partial.h5" for name in ("push", "after")]
    assert all(part in last for part in ("palpate: ", said, *map(str, partials)))
    push, after = map(pt.Trajectory.load, partials)
    assert push.complete
    assert not after.complete
    np.testing.assert_allclose(push.concatenate(after).times, np.arange(55) * 0.002)


@pytest.mark.slow
def test_the_study_continues_when_one_reduced_model_and_the_picture_fail(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("palpate.app.common.rendering.PROBE", "raise SystemExit(3)")
    (tmp_path / "after.partial.h5").write_text("of a run that was stopped")
    assert main([*COARSEST, "--after", "release", "--modes", "4", "50", "--out", str(tmp_path)]) == 0
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["parameters"]["after"] == "release"
    assert report["full"]["after"]["tool_force_at_end"] == 0.0
    assert report["full"]["after"]["energy_balance"] < 0.01
    for four, fifty in (report["reduced"][:2], report["reduced"][2:]):
        assert not four["failed"]
        assert fifty["failed"]
        assert "independent shapes" in fifty["phases"]["push"]["reason"]
        assert fifty["phases"]["after"]["reason"] == "the phase before it failed"
    assert "apt-get install" in report["missing"]["figure9_deflection.png"]
    assert {path.name for path in tmp_path.iterdir()} == set(FILES) - {"figure9_deflection.png"}
    said = capsys.readouterr().out
    assert "Projected models (the paper's), after" in said
    assert "Hyper-reduced models, after" in said
    assert "Claims of the paper" in said


def test_figures_are_drawn_when_every_reduced_run_failed(tmp_path):
    none: dict[str, dict[str, list]] = {name: {"push": [], "after": []} for name in ("projected", "hyper-reduced")}
    draw_error(none, tmp_path / "error.png")
    draw_time(none, [1.0, 1.0], tmp_path / "time.png")
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.parametrize("after", AFTER)
def test_every_motion_of_the_tool_is_an_option(after, tmp_path, assert_refused):
    assert_refused([*COARSEST, "--after", after, "--modes", "0", "--out", str(tmp_path)], "--modes")
