"""``palpate bench page``: a finer surface that is the same one, and a short run of the command."""

from __future__ import annotations

import json

import numpy as np
import pytest

import palpate as pt
from palpate.app.bench.chromium import find_chromium
from palpate.app.bench.subdivided_surface import SubdividedSession, subdivide, subdivide_at_centroids
from palpate.app.cli import main

pytestmark = pytest.mark.slow


def test_dividing_a_triangle_keeps_its_area_and_its_sense():
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.2, 0.7, 0.3]])
    triangles, weights = subdivide(np.array([[0, 1, 2]], dtype=np.uint32), 3)
    points = weights @ corners
    assert (len(points), len(triangles)) == (6, 4)
    np.testing.assert_array_equal(points[:3], corners)
    areas = np.cross(
        points[triangles[:, 1]] - points[triangles[:, 0]], points[triangles[:, 2]] - points[triangles[:, 0]]
    )
    np.testing.assert_allclose(areas, np.tile(np.cross(corners[1], corners[2]) / 4, (4, 1)), atol=1e-15)


def test_a_triangle_divided_at_its_centroid_keeps_its_area_and_its_sense():
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.2, 0.7, 0.3], [1.0, 1.0, 0.0]])
    triangles, weights = subdivide_at_centroids(np.array([[0, 1, 2], [1, 3, 2]], dtype=np.uint32), 4, 1)
    points = weights @ corners
    assert (len(points), len(triangles)) == (5, 4)
    np.testing.assert_array_equal(triangles[-1], [1, 3, 2])
    a, b, c = (points[triangles[:3, k]] for k in range(3))
    np.testing.assert_allclose(
        np.cross(b - a, c - a), np.tile(np.cross(corners[1], corners[2]) / 3, (3, 1)), atol=1e-15
    )


def test_a_finer_surface_moves_linearly_between_the_vertices_of_the_coarse_one(session):
    coarse, drawn = session.surface, SubdividedSession(session, 2000)
    fine = drawn.surface
    assert len(fine.rest) == 2000
    edges = np.sort(fine.triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    assert (np.unique(edges, axis=0, return_counts=True)[1] == 2).all()  # closed, as the block's surface is
    state = np.random.default_rng(0).standard_normal(session.model.count) * 1e-4
    given = (state, np.zeros(0, dtype=np.int64), np.zeros((0, 3)), False)
    moved, moved_finely = coarse.displacements(*given), fine.displacements(*given)
    np.testing.assert_array_equal(moved_finely[: len(moved)], moved)
    np.testing.assert_allclose(moved_finely.mean(axis=0), fine._weights.mean(axis=0) @ moved, rtol=1e-5, atol=1e-8)
    stress = fine.scalar("stress", state, moved_finely)
    np.testing.assert_allclose(stress[: len(moved)], coarse.scalar("stress", state, moved), rtol=1e-6)
    assert drawn.tool_kinds == session.tool_kinds  # the rest is the session's


@pytest.mark.skipif(find_chromium() is None, reason="no Chromium on this machine; on Debian: apt-get install chromium")
def test_the_command_measures_a_press(model, tmp_path, capsys):
    pt.save(model, tmp_path / "block.rom")
    given = [
        "--model",
        str(tmp_path / "block.rom"),
        "--vertices",
        "500",
        "--seconds",
        "2",
        "--out",
        str(tmp_path),
        "--json",
    ]
    assert main(["bench", "page", *given]) == 0
    report = json.loads(capsys.readouterr().out)
    assert report == json.loads((tmp_path / "report.json").read_text())
    assert report["vertices"] == 500
    assert report["errors"] == []
    assert report["page"]["frames"] > 2
    assert 0 < report["page"]["median"] <= report["page"]["p95"]
    assert report["largest_force"] > 0
    assert report["engine"]["periods"] > 100


def test_a_benchmark_without_vertices_is_refused(tmp_path, capsys):
    assert main(["bench", "page", "--vertices", "7", "--out", str(tmp_path)]) == 2
    assert "--vertices must be an integer in [100, 1e+06], got 7" in capsys.readouterr().err
