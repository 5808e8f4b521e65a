"""Coverage of the surface by training paths: its shares, its picture, and paths that are chosen for it."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import palpate as pt
from palpate.app.common.rows import rows_of
from palpate.app.train import choose as choosing
from palpate.app.train.coverage import Coverage, coverage, draw_coverage
from palpate.app.train.folder import TRAINED, Folder, Job
from palpate.app.train.report import MODEL_ROWS
from palpate.scenes.load_case import TrainingScene
from palpate.scenes.tool_paths import ToolPaths

TISSUE = pt.materials.MooneyRivlin(C1=60e3, C2=1.2e3, density=1120.0, poisson=0.45)


@pytest.fixture(scope="module")
def scene():
    """A block that is held at one end, under a ball."""
    model = pt.Solid(pt.box((0.12, 0.06, 0.06), 0.01), TISSUE, "x-", form="energy")
    return TrainingScene(model, ToolPaths(model, 0.02, 0.01, 0.2, 0.0), 0.01, "Block", {})


def test_shares_are_of_the_free_area(scene):
    found = coverage(scene, [scene.path(k) for k in range(6)])
    shares = found.shares()
    ring = 4 * 0.06 * 0.005  # the share of the nodes on the edges that lies on other faces
    assert shares["held"] == pytest.approx((0.06**2 + ring) / (2 * 0.06**2 + 4 * 0.12 * 0.06))
    x = found.surface.points[:, 0]
    free, far = found.surface.areas[x > 0].sum(), found.surface.areas[x > 0.02 - 1e-9].sum()
    assert shares["reachable"] == pytest.approx(far / free)
    assert 0 < shares["covered"] < 1
    assert shares["covered"] * free >= found.surface.areas[found.mask & found.reachable].sum() - 1e-12
    covered, reached, held = coverage_rows(shares)
    assert covered == f"{shares['covered']:.0%}"
    assert reached == f"{shares['reachable']:.0%}; {shares['covered_of_reachable']:.0%}"
    assert held == f"{shares['held']:.0%}"


def coverage_rows(shares):
    """Return the texts of the report's rows about the coverage."""
    rows = {label: row for label, row in MODEL_ROWS.items() if "coverage" in str(row)}
    assert len(rows) == 3
    return [text for (text,) in rows_of(rows, {"coverage": shares}).values()]


def test_further_runs_cover_more_and_the_same_run_adds_nothing(scene):
    runs = [scene.path(k) for k in range(24)]
    found, shares = Coverage(scene, []), []
    for run in runs:
        assert found.added(run) == pytest.approx(1.0) or shares
        found.add(run)
        assert found.added(run) == 0.0
        shares.append(found.shares()["covered"])
    assert shares == sorted(shares)
    assert shares[-1] > 0.7
    np.testing.assert_array_equal(coverage(scene, runs).mask, found.mask)


def test_runs_without_a_tool_on_the_surface_have_no_coverage(scene):
    push = pt.PrescribedMotion("x+", lambda points, time: np.zeros_like(points))
    assert coverage(scene, [((push,), 1.0)]) is None
    assert coverage_rows(None) == []


def chosen(monkeypatch, scene, trust, count, trained=(), largest=10.0):
    """Choose among paths on which the reduced model has these error indicators, and errors of 0.1 at 1."""
    curve = {
        "median": 0.1,
        "bound": 0.2,
        "exponent": 1.0,
        "least_trust": 1e-3,
        "largest_trust": largest,
        "typical_size": 1.0,
    }
    body = SimpleNamespace(mass=np.eye(2), masses=np.ones(2), project=lambda displacements: displacements)
    report = {"held_out": {"expected_error": {"displacement": curve, "level": 0.95, "least_level": 0.9}}}
    model = SimpleNamespace(body=body, report=report, data=SimpleNamespace(scales=SimpleNamespace(distance_scale=1e-9)))
    jobs = [Job(TRAINED, number, number) for number in trust]
    runs = {
        job.number: SimpleNamespace(trust=np.array([trust[job.number]]), displacements=np.full((1, 2), job.number))
        for job in jobs
    }
    monkeypatch.setattr(choosing, "_reduced_run", lambda model, folder, scene, job: runs[job.number])
    before = [Job(TRAINED, number, number) for number in trained]
    found = choosing.choose(model, Folder(None, {}), scene, jobs, count, before)
    return [job.number for job in found]


def test_uncovered_surface_comes_before_errors_and_errors_decide_on_covered_surface(monkeypatch, scene):
    one, two = scene.path(0), scene.path(1)
    paths = {0: one, 1: one, 2: two, 3: two, 4: one}
    repeated = TrainingScene(scene.model, paths.__getitem__, 0.01, "Block", {})
    trust = {1: 5.0, 2: 0.1, 3: 0.2, 4: 4.0}
    assert chosen(monkeypatch, repeated, trust, 3, trained=[0]) == [3, 1, 4]
    assert chosen(monkeypatch, repeated, trust, 2, trained=[0, 2]) == [1, 4]
    # beyond the held-out runs the error is unknown, counts as an uncovered surface does, and the error indicator
    # decides
    assert chosen(monkeypatch, repeated, trust, 3, trained=[0], largest=3.0) == [3, 1, 4]
    assert chosen(monkeypatch, repeated, {1: 5.0, 4: 6.0}, 1, trained=[0], largest=3.0) == [4]


@pytest.mark.slow
def test_the_picture_has_all_kinds_of_surface(scene, tmp_path):
    from matplotlib.image import imread

    covered = coverage(scene, [scene.path(k) for k in range(4)])
    assert set(np.unique(covered.kinds)) == {0, 1, 2, 3}
    draw_coverage(covered, tmp_path / "coverage.png")
    image = imread(tmp_path / "coverage.png")[..., :3].reshape(-1, 3)
    assert len(image) > 5e5
    blue = (image[:, 2] > 0.4) & (image[:, 0] < 0.15)
    yellow = (image[:, 0] > 0.5) & (image[:, 1] > 0.9 * image[:, 0]) & (image[:, 2] < 0.5 * image[:, 0])
    orange = (image[:, 0] > 0.4) & (np.abs(image[:, 1] / np.maximum(image[:, 0], 1e-9) - 0.68) < 0.08)
    orange &= image[:, 2] < 0.2 * image[:, 0]
    for name, mask in (("blue", blue), ("yellow", yellow), ("orange", orange)):
        assert mask.mean() > 0.01, name
