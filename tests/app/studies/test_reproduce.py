"""The command ``reproduce``: what it prints, what it leaves, how it fails, for each example of the paper."""

from __future__ import annotations

import json
import os

import h5py
import numpy as np
import pytest

import palpate as pt
from palpate.app.cli import main
from palpate.app.common.rendering import DrawingError, check_drawing
from palpate.app.studies.figures import TimeAxes, draw_errors, draw_times, seconds_of
from palpate.app.studies.report import Finished
from palpate.app.studies.reproduce import PAPER_EXAMPLES
from palpate.app.studies.study import Study
from palpate.core.files import check_space
from palpate.scenes.membrane import AFTER, membrane, tool_tip

COARSE = {"beam": 0.02 / 3, "membrane": 0.0125}  # [m]
BEAM = ["reproduce", "beam", "--spacing", str(COARSE["beam"]), "--load", "2"]
MEMBRANE = ["reproduce", "membrane", "--spacing", "0.05"]
SERIES = ("projected", "hyper-reduced")
FIGURES = [(name, figure) for name, example in PAPER_EXAMPLES.items() for figure in example.figures]


@pytest.fixture(scope="module")
def studies(run_study, tmp_path_factory):
    """A function that returns a coarse study: its folder, report, standard output and standard error."""
    done, out = {}, tmp_path_factory.mktemp("study") / "results"
    options = {
        "beam": [*BEAM, "--modes", "4", "2", "2"],
        "membrane": [*MEMBRANE[:-1], str(COARSE["membrane"]), "--modes", "8", "2", "8"],
    }

    def study(name):
        if name not in done:
            done[name] = run_study(options[name], out / name)
        return done[name]

    return study


@pytest.fixture(scope="module")
def model():
    return membrane(spacing=COARSE["membrane"]).model


def by_series(report):
    """The entries of the reduced runs of each series, in the order of the report."""
    return [[entry for entry in report["reduced"] if entry["series"] == name] for name in SERIES]


@pytest.mark.slow
@pytest.mark.parametrize("name", PAPER_EXAMPLES)
def test_the_listed_files_are_written_and_no_others(studies, name):
    assert {path.name for path in studies(name)[0].iterdir()} == set(PAPER_EXAMPLES[name].files)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "figure"), FIGURES)
def test_no_figure_is_blank(studies, assert_drawn, name, figure):
    assert_drawn(studies(name)[0] / figure)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "said"), [("beam", "4 modes at 496 nodes"), ("membrane", "8 modes at 217 nodes, after")]
)
def test_standard_output_is_the_report_and_nothing_else(studies, name, said):
    _, report, stdout, stderr = studies(name)
    assert json.loads(stdout) == report
    assert f"projected, {said}" in stderr
    assert "hyper-reduced, " in stderr


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "expected", "nodes"),
    [
        ("beam", {"load": 2.0, "poisson": 0.49, "duration": 1.0, "every": 0.01}, 31 * 4 * 4),
        (
            "membrane",
            {
                "tool_radius": 0.0, "prestretch": 1.0, "jitter": 0.0, "seed": 0, "duration": 0.2, "every": 0.002,
                "after": "return", "layout": "rings",
            },
            1 + 3 * 8 * 9,  # 6 k on ring k
        ),
    ],
)  # fmt: skip
def test_the_report_has_the_parameters_and_the_machine(studies, name, expected, nodes):
    report = studies(name)[1]
    assert report["parameters"] == expected | {"spacing": COARSE[name]}
    assert report["nodes"] == nodes
    assert report["machine"]["versions"]["palpate"] == pt.__version__
    assert report["machine"]["cpu_count"] == os.cpu_count()
    assert report["stability"]["step"] > 0
    assert report["missing"] == {}


@pytest.mark.slow
def test_the_pulled_end_moves_as_that_of_a_slender_bar(studies):
    full = studies("beam")[1]["full"]
    young = 2 * 61.2e3 * 1.49
    assert full["peak_tip_displacement"] == pytest.approx(2.0 * 0.2 / (young * 0.02**2), rel=0.05)
    assert full["peak_tip_time"] == pytest.approx(0.5, abs=0.02)
    assert full["load_at_peak"] == pytest.approx(2.0)
    assert full["reaction_at_peak"] == pytest.approx(2.0, rel=0.05)
    assert full["energy_balance"] < 0.03
    assert full["real_time_factor"] == pytest.approx(1.0 / full["wall_seconds"])


@pytest.mark.slow
def test_the_reported_work_is_that_of_the_tool_force(studies):
    out, report = studies("membrane")[:2]
    push, after = (report["full"][name] for name in ("push", "after"))
    assert (push["end_time"], after["end_time"]) == pytest.approx((0.1, 0.2))
    assert push["centre_deflection_at_end"] == pytest.approx(0.01)
    assert after["centre_deflection_at_end"] == 0.0
    assert 0 < push["mean_deflection_at_end"] < 0.01
    assert push["energy_balance"] < 0.01
    assert 0 < push["tool_force_at_end"] <= push["peak_tool_force"]
    assert 0 < push["largest_wrinkled_share"] < 1
    assert push["largest_wrinkled_area"] == pytest.approx(push["largest_wrinkled_share"] * np.pi * 0.1**2)
    full = pt.Trajectory.load(out / "full.h5")
    pushed = full.times < 0.1 + 1e-9
    work = np.trapezoid(0.1 * full.reactions["tool"][pushed, 2], full.times[pushed])  # it moves at 0.1 m/s
    assert full.external[pushed][-1] == pytest.approx(work, rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "sizes"), [("beam", [2, 4]), ("membrane", [2, 8])])
def test_every_reduced_model_of_both_series_is_reported_once_in_order(studies, name, sizes):
    report = studies(name)[1]
    assert [(entry["series"], entry["modes"]) for entry in report["reduced"]] == [(s, m) for s in SERIES for m in sizes]
    for first, last in by_series(report):
        phases = first.get("phases", {"": first}), last.get("phases", {"": last})
        for phase in phases[0]:
            assert phases[1][phase]["projection_error"] < phases[0][phase]["projection_error"]
            for entry in (phases[0][phase], phases[1][phase]):
                assert not entry["failed"]
                assert set(entry["errors"]) == {"displacement", "velocity", "energy", "reaction"}
                # no run in the space of the modes is nearer than the projection, up to the norm's choice
                assert 0 < entry["projection_error"] <= 1.1 * entry["errors"]["displacement"]
                own = "energy_form" if name == "beam" and first["series"] == "hyper-reduced" else "full"
                full = report[own][phase] if phase else report[own]
                assert entry["ratio"] == pytest.approx(entry["wall_seconds"] / full["wall_seconds"])
                assert entry["seconds_per_step"] == pytest.approx(entry["wall_seconds"] / entry["steps"])
                sampled = first["series"] == "hyper-reduced"
                assert sampled or entry["nodes"] == report["nodes"]


@pytest.mark.slow
def test_hyper_reduced_models_of_the_beam_evaluate_few_nodes(studies):
    report = studies("beam")[1]
    assert all(0 < entry["nodes"] < report["nodes"] / 5 for entry in by_series(report)[1])


@pytest.mark.slow
def test_the_two_phases_of_the_membrane_have_reduced_models_of_their_own(studies):
    for entries in by_series(studies("membrane")[1]):
        for entry in entries:
            assert list(entry["phases"]) == ["push", "after"]
            projected = entry["series"] == "projected"
            steps = [phase["steps"] for phase in entry["phases"].values()]
            assert steps == ([250, 1000] if projected else [1000, 1000])
            assert entry["joined"]["steps"] == sum(steps)
            # the mean over all snapshots is that of the phases' means
            halves = [phase["errors"]["displacement"] for phase in entry["phases"].values()]
            assert min(halves) < entry["joined"]["errors"]["displacement"] < max(halves)
        first, last = (entry["phases"]["push"]["errors"]["displacement"] for entry in entries)
        assert last < first


@pytest.mark.slow
def test_the_report_compares_the_energy_form_with_the_strong_form(studies):
    report = studies("beam")[1]
    energy = report["energy_form"]
    # two discretisations of one body
    assert energy["peak_tip_displacement"] == pytest.approx(report["full"]["peak_tip_displacement"], rel=0.05)
    assert abs(energy["energy_balance"]) < 1e-3
    forms = report["forms"]
    assert forms["until"] == pytest.approx(0.9)
    assert 0 < forms["displacement_until"] < forms["errors"]["displacement"] < 0.5


@pytest.mark.slow
def test_hyper_reduced_models_are_compared_with_the_energy_form_that_they_reduce(studies):
    out, report = studies("beam")[:2]
    assert by_series(report)[1][1]["errors"]["displacement"] < 0.1
    runs = [pt.Trajectory.load(out / name) for name in PAPER_EXAMPLES["beam"].runs]
    assert pt.relative_errors(*runs).as_dict() == pytest.approx(report["forms"]["errors"])


@pytest.mark.slow
def test_the_messages_name_the_difference_of_the_forms_once_with_its_reason(studies):
    lines = [line for line in studies("beam")[3].splitlines() if "The two full models differ by" in line]
    assert len(lines) == 1
    assert "differ in phase" in lines[0]


@pytest.mark.slow
@pytest.mark.parametrize(("name", "frames"), [("beam", {"": 101}), ("membrane", {"push": 51, "after": 51})])
def test_singular_values_descend(studies, name, frames):
    report = studies(name)[1]
    for phase, count in frames.items():
        values, snapshots = (report[key][phase] if phase else report[key] for key in ("singular_values", "snapshots"))
        assert len(values) == snapshots == count
        assert np.all(np.diff(values) <= 0)


@pytest.mark.slow
@pytest.mark.parametrize("name", PAPER_EXAMPLES)
def test_each_claim_of_the_paper_is_judged_for_both_series(studies, name):
    report = studies(name)[1]
    projected, sampled = report["paper"], report["paper_hyper_reduced"]
    assert [claim["figure"] for claim in projected] == [claim.figure for claim in PAPER_EXAMPLES[name].claims]
    assert [claim["claim"] for claim in sampled] == [claim["claim"] for claim in projected]
    assert [claim["here"] for claim in sampled] != [claim["here"] for claim in projected]


@pytest.mark.slow
def test_claims_of_the_membrane_are_compared_during_the_push(studies):
    report = studies("membrane")[1]
    for entries, claims in zip(by_series(report), (report["paper"], report["paper_hyper_reduced"]), strict=True):
        two, eight = (entry["phases"]["push"]["errors"]["displacement"] for entry in entries)
        fast = entries[0]["phases"]["push"]["ratio"] < 0.1
        # nothing was run with more than 8 modes, nor with three sizes
        expected = [two > 0.1, eight < 0.2 * two, eight < 0.03, None, fast, None]
        assert [claim["holds"] for claim in claims] == expected


@pytest.mark.slow
def test_the_snapshots_and_the_export_agree(studies):
    out = studies("beam")[0]
    run = pt.Trajectory.load(out / "full.h5")
    assert run.complete
    with h5py.File(out / "beam.vtkhdf") as file:
        exported = file["VTKHDF/PointData/displacement"][:].reshape(run.displacements.shape)
        np.testing.assert_array_equal(exported, run.displacements)
        assert set(file["VTKHDF/PointData"]) == {"displacement", "velocity", "von_mises"}
        stress = file["VTKHDF/PointData/von_mises"][:].reshape(101, -1)
    middle = np.abs(run.points[:, 0] - 0.1) < 0.02  # far from the ends the stress is the force over the area
    assert stress[50, middle].mean() == pytest.approx(2.0 / 0.02**2, rel=0.05)


@pytest.mark.slow
def test_the_snapshots_are_of_both_phases_and_follow_the_tool(studies, model):
    run = pt.Trajectory.load(studies("membrane")[0] / "full.h5")
    assert run.complete
    np.testing.assert_allclose(run.times, np.arange(101) * 0.002)
    expected = [tool_tip(time) for time in run.times]
    np.testing.assert_allclose(run.displacements[:, model.cloud.group("tool")[0], 2], expected, atol=1e-15)
    assert not run.displacements[:, model.cloud.group("rim")].any()


@pytest.mark.slow
def test_vtk_reads_the_sheet_and_its_stresses(studies, model):
    from vtkmodules.util.numpy_support import vtk_to_numpy
    from vtkmodules.vtkIOHDF import vtkHDFReader

    file = studies("membrane")[0] / "membrane.vtkhdf"
    reader = vtkHDFReader()
    reader.SetFileName(str(file))
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
    with h5py.File(file) as read:
        assert set(read["VTKHDF/PointData"]) == set(names)


@pytest.mark.parametrize(
    ("command", "option", "named", "allowed"),
    [
        (BEAM, ["--spacing", "0.01"], "--spacing", "0.00666667] m"),
        (BEAM, ["--spacing", "nan"], "--spacing", "0.00666667] m"),
        (BEAM, ["--poisson", "0.6"], "--poisson", "0.499]"),
        (BEAM, ["--load", "0"], "--load", "(0, 1000] N"),
        (BEAM, ["--modes", "0"], "--modes", "an integer in [1, 100]"),
        (BEAM, ["--modes", "2", "-3"], "--modes", "an integer in [1, 100]"),
        (BEAM, ["--modes", "1000"], "--modes", "an integer in [1, 100]"),
        (BEAM, ["--modes", "two"], "--modes must be a whole number", "'two'"),
        (MEMBRANE, ["--spacing", "0.06"], "--spacing", "at most 0.05 m"),
        (MEMBRANE, ["--spacing", "0.0001"], "--spacing", "[0.001"),
        (MEMBRANE, ["--spacing", "nan"], "--spacing", "[0.001"),
        (MEMBRANE, ["--after", "stay"], "--after must be one of", "'stay'"),
        (MEMBRANE, ["--tool-radius", "-0.01"], "--tool-radius", "[0, 0.08] m"),
        (MEMBRANE, ["--tool-radius", "0.09"], "--tool-radius", "[0, 0.08] m"),
        (MEMBRANE, ["--prestretch", "0.9"], "--prestretch", "[1, 10]"),
        (MEMBRANE, ["--layout", "random"], "--layout must be one of", "'random'"),
        (MEMBRANE, ["--jitter", "0.5"], "--jitter", "[0, 0.3]"),
        (MEMBRANE, ["--seed", "-1"], "--seed", "an integer in [0, "),
        (MEMBRANE, ["--modes", "2", "51"], "--modes", "an integer in [1, 50]"),
        (MEMBRANE, ["--out", __file__], "--out ", "is not a folder"),
    ],
)
def test_bad_values_are_refused_in_one_line_and_no_file_is_left(
    tmp_path, assert_refused, command, option, named, allowed
):
    out = tmp_path / "results"
    assert_refused([*command, "--out", str(out), *option], named, allowed)
    assert not out.exists()


@pytest.mark.parametrize("after", AFTER)
def test_every_motion_of_the_tool_is_an_option(after, tmp_path, assert_refused):
    assert_refused([*MEMBRANE, "--after", after, "--modes", "0", "--out", str(tmp_path)], "--modes")


def test_a_file_in_the_place_of_the_folder_is_refused(tmp_path, assert_refused):
    place = tmp_path / "results"
    place.write_text("mine")
    for out in (place, place / "beam"):
        assert_refused([*BEAM, "--out", str(out)], "--out ", "is not a folder")
    assert place.read_text() == "mine"
    assert list(tmp_path.iterdir()) == [place]


def test_a_folder_that_cannot_be_written_is_refused(tmp_path, assert_refused, monkeypatch):
    def refuse(*_arguments, **_options):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("palpate.core.files.TemporaryDirectory", refuse)  # the superuser may write anywhere
    assert_refused([*BEAM, "--out", str(tmp_path / "results")], "--out ", "cannot be written (permission denied)")
    assert list(tmp_path.iterdir()) == []


def test_a_disk_without_room_is_refused(tmp_path):
    with pytest.raises(pt.InputError, match=r"this run writes about 1000000000000 MB"):
        check_space(tmp_path / "results", 10**18)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("error", "code", "said"),
    [(KeyboardInterrupt(), 130, "interrupted in the run of the "), (pt.DivergenceError("ran away"), 1, "ran away")],
)
@pytest.mark.parametrize(
    ("command", "time", "partials", "expected"),
    [
        (BEAM, 0.045, ["full"], np.arange(5) * 0.01),
        (MEMBRANE, 0.109, ["push", "after"], np.arange(55) * 0.002),
    ],
)
def test_an_interrupted_full_run_keeps_its_frames_and_names_their_files(
    tmp_path, capsys, stop_after, error, code, said, command, time, partials, expected
):
    stop_after(time, error)
    assert main([*command, "--out", str(tmp_path)]) == code
    captured = capsys.readouterr()
    last = captured.err.splitlines()[-1]
    files = [tmp_path / f"{name}.partial.h5" for name in partials]
    assert last.startswith("palpate: ")
    assert all(part in last for part in ("full model", said, *map(str, files)))
    assert "Traceback" not in captured.err
    *complete, stopped = map(pt.Trajectory.load, files)
    assert all(run.complete for run in complete)
    assert not stopped.complete
    whole_run = complete[0].concatenate(stopped) if complete else stopped
    np.testing.assert_allclose(whole_run.times, expected)


@pytest.mark.slow
def test_the_study_continues_when_one_reduced_model_and_the_picture_fail(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr("palpate.app.common.rendering.PROBE", "raise SystemExit(3)")
    (tmp_path / "after.partial.h5").write_text("of a run that was stopped")
    assert main([*MEMBRANE, "--after", "release", "--modes", "4", "50", "--out", str(tmp_path)]) == 0
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["parameters"]["after"] == "release"
    assert report["full"]["after"]["tool_force_at_end"] == 0.0
    assert report["full"]["after"]["energy_balance"] < 0.01
    for four, fifty in by_series(report):
        assert not four["failed"]
        assert fifty["failed"]
        assert "independent shapes" in fifty["phases"]["push"]["reason"]
        assert fifty["phases"]["after"]["reason"] == "the phase before it failed"
    assert "apt-get install" in report["missing"]["figure9_deflection.png"]
    assert {path.name for path in tmp_path.iterdir()} == {*PAPER_EXAMPLES["membrane"].files} - {
        "figure9_deflection.png"
    }
    said = capsys.readouterr().out
    assert "Projected models (the paper's), after" in said
    assert "Hyper-reduced models, after" in said
    assert "Claims of the paper" in said


def test_a_machine_that_cannot_draw_raises_with_the_packages_to_install(monkeypatch):
    monkeypatch.setattr("palpate.app.common.rendering.PROBE", "import os; os.abort()")
    with pytest.raises(DrawingError, match="apt-get install libegl1 libgl1-mesa-dri"):
        check_drawing()


@pytest.mark.slow
def test_figures_are_drawn_when_every_reduced_run_failed(tmp_path):
    case = membrane(spacing=0.05)
    (make,) = PAPER_EXAMPLES["membrane"].studies.values()
    study: Study = make(case)
    draw = PAPER_EXAMPLES["membrane"].figures["figure7_error.png"]
    assert draw.func is draw_errors
    draw([study], tmp_path / "error.png")
    draw_times("Times", (7.0, 4.6), (TimeAxes("", "time [s]", seconds_of),), [study], tmp_path / "time.png")
    assert len(list(tmp_path.iterdir())) == 2


def claim(name, words):
    """The claim of an example with some words in its text."""
    (found,) = (each for each in PAPER_EXAMPLES[name].claims if words in each.text)
    return found


def test_an_error_that_falls_to_a_quarter_after_eight_modes_is_not_a_slight_decrease():
    slight = claim("beam", "decreases only slightly")
    errors = {6: 0.024, 8: 0.038, 12: 0.008}
    entry = slight.entry(Finished(errors, {}, {}))
    assert (entry["here"], entry["holds"]) == ("3.800% with 8, 0.800% with 12", False)
    assert slight.entry(Finished(errors | {12: 0.03}, {}, {}))["holds"]


@pytest.mark.parametrize(
    ("name", "words", "sizes", "needs"),
    [
        ("beam", "decreases only slightly", (6, 8), "needs 8 modes and more"),
        ("beam", "with 6 modes", (2, 8), "needs 6 modes"),
        ("beam", "almost linearly", (2, 8), "needs 3 sizes"),
        ("membrane", "dramatically (read: 8", (2, 6), "needs 2 and 8 modes"),
    ],
)
def test_a_claim_without_the_models_it_needs_is_not_judged(name, words, sizes, needs):
    values = dict.fromkeys(sizes, 0.5)
    entry = claim(name, words).entry(Finished(values, values, values))
    assert (entry["here"], entry["holds"]) == (needs, None)
