"""The command ``check``: what it prints, what it leaves, how it refuses."""

from __future__ import annotations

import json

import numpy as np
import pytest

import palpate as pt
from palpate.app.check.command import FILES
from palpate.app.cli import main


@pytest.fixture(scope="module")
def liver(tmp_path_factory):
    """The generated liver as a file, in millimetres."""
    trimesh = pytest.importorskip("trimesh")
    body = pt.liver_surface(0.006)
    path = tmp_path_factory.mktemp("surface") / "liver.stl"
    trimesh.Trimesh(1e3 * body.vertices, body.triangles, process=False).export(path)
    return path


@pytest.mark.slow
def test_a_good_surface_is_filled_and_drawn(liver, run_study, tmp_path, assert_drawn):
    out, report, stdout, _ = run_study(["check", str(liver), "--spacing", "0.012"], tmp_path / "check")
    assert {path.name for path in out.iterdir()} == set(FILES) - {"tool.png"}  # of scene files
    assert json.loads(stdout) == report
    assert report["surface"]["volume"] == pytest.approx(1.5e-3, rel=1e-4)
    assert "mm assumed" in report["surface"]["warnings"][0]
    assert report["surface"]["problems"] == []
    cloud = pt.fill(pt.io.read_surface(liver, units="mm"), 0.012)
    assert report["cloud"]["nodes"] == len(cloud)
    assert report["cloud"]["volume"] == pytest.approx(cloud.volumes.sum())
    assert "surface.png" in (out / "report.md").read_text()
    for name in ("surface.png", "cloud.png"):
        assert_drawn(out / name)


@pytest.mark.slow
def test_an_open_surface_is_reported_not_filled(liver, tmp_path, capsys):
    trimesh = pytest.importorskip("trimesh")
    body = pt.io.read_surface(liver, units="mm")
    keep = np.ones(len(body.triangles), dtype=bool)
    keep[:4] = False
    trimesh.Trimesh(body.vertices, body.triangles[keep], process=False).export(tmp_path / "open.ply")
    code = main(["check", str(tmp_path / "open.ply"), "--units", "m", "--out", str(tmp_path / "out")])
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert code == 1
    assert [problem["name"] for problem in report["surface"]["problems"]] == ["open"]
    assert "cloud" not in report
    assert "the surface is open" in " ".join(capsys.readouterr().out.split())
    assert not (tmp_path / "out" / "cloud.png").exists()


@pytest.mark.slow
def test_repairs_are_listed_and_drawn(liver, tmp_path, capsys, assert_drawn):
    trimesh = pytest.importorskip("trimesh")
    body = pt.io.read_surface(liver, units="mm")
    trimesh.Trimesh(body.vertices, body.triangles[:, ::-1][4:], process=False).export(tmp_path / "open.ply")
    line = ["check", str(tmp_path / "open.ply"), "--units", "m", "--spacing", "0.014", "--repair"]
    assert main([*line, "--out", str(tmp_path / "out")]) == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert [problem["name"] for problem in report["surface"]["problems"]] == ["closed holes", "turned"]
    assert {problem["kind"] for problem in report["surface"]["problems"]} == {"repair"}
    printed = " ".join(capsys.readouterr().out.split())
    assert "repaired, closed holes: holes were closed by fans of triangles: 1, with" in printed
    assert_drawn(tmp_path / "out" / "surface.png")
    orange = _pixels(tmp_path / "out" / "surface.png", (230, 159, 0))
    assert main([*line[:2], "--units", "m", "--out", str(tmp_path / "without")]) == 1
    assert orange > 20 > _pixels(tmp_path / "without" / "surface.png", (230, 159, 0))


def _pixels(path, colour):
    """Number of pixels of a hue, in light or shade."""
    import matplotlib.pyplot as plt

    image = plt.imread(path)[..., :3]
    shade = image.max(axis=2, keepdims=True)
    near = np.abs(image / np.maximum(shade, 0.2) - np.array(colour) / max(colour)).max(axis=2) < 0.08
    return int(near.sum())


@pytest.mark.slow
def test_an_implausible_volume_names_the_scale(liver, tmp_path, capsys):
    line = ["check", str(liver), "--units", "m", "--out", str(tmp_path / "out")]
    main(line)
    assert "--scale 0.001 would make it 1.5 litres" in " ".join(capsys.readouterr().out.split())
    assert main([*line[:4], "--scale", "0.001", "--spacing", "0.014", *line[-2:]]) == 0
    assert "--scale" not in capsys.readouterr().out


@pytest.mark.slow
def test_a_spacing_that_is_too_coarse_is_reported(liver, tmp_path, capsys):
    assert main(["check", str(liver), "--spacing", "0.06", "--json", "--out", str(tmp_path / "out")]) == 1
    assert "too coarse" in json.loads(capsys.readouterr().out)["refused"]


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nowhere.stl"], "nowhere.stl"),
        (["pyproject.toml"], "line 1: build-system is not a key of the file"),
        (["README.md"], "got 'md'"),
        ([__file__, "--units", "ell"], "--units must be one of m, cm, mm, in, got 'ell'"),
    ],
)
def test_bad_input_is_refused_in_one_line(words, said, assert_refused, tmp_path):
    assert_refused(["check", *words, "--out", str(tmp_path / "out")], said)
