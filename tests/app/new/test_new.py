"""The command ``new``: a scene file that works, what it says, and the commands that take it."""

from __future__ import annotations

import json
import os
import shutil
import tomllib

import numpy as np
import pytest

import palpate as pt
from palpate.app.cli import main
from palpate.app.train.scene_folder import last_recording, name_in_folder, scene_in_folder, training_folder
from palpate.scenes.organ import liver_surface
from palpate.scenes.schema import scene_schema

COARSE = ["--spacing", "0.006"]


@pytest.fixture(scope="module")
def organ(tmp_path_factory):
    """An OFF file of a small liver in millimetres."""
    surface, path = liver_surface(0.006, 6e-5), tmp_path_factory.mktemp("organ") / "my_organ.off"
    path.write_text(
        f"OFF\n{len(surface.vertices)} {len(surface.triangles)} 0\n"
        + "".join(f"{x} {y} {z}\n" for x, y, z in 1e3 * surface.vertices)
        + "".join(f"3 {a} {b} {c}\n" for a, b, c in surface.triangles)
    )
    return path


@pytest.fixture(scope="module")
def scene(organ, tmp_path_factory):
    """A scene file of the organ in another folder."""
    path = tmp_path_factory.mktemp("scene") / "organ.toml"
    assert main(["new", str(organ), "--out", str(path), *COARSE]) == 0
    return path


def test_a_new_scene_works_as_it_is_and_has_what_was_guessed(organ, scene):
    text = scene.read_text()
    table = tomllib.loads(text)
    assert (scene.parent / table["surface"]["file"]).resolve() == organ.resolve()
    assert table["surface"]["units"] == "mm"
    assert "guessed: an organ of 0.06 litres" in text
    assert "Guessed: the side away from the first view" in text
    opened = pt.open_scene(scene)
    assert opened.cloud.spacing == 0.006
    assert f"# {len(opened.cloud)} nodes" in text
    assert opened.material.shear_modulus == pytest.approx(2200.0)
    assert len(opened.body.supports) == 1
    loads, duration = opened.paths(0)
    assert isinstance(loads[0], pt.tools.Contact)
    assert opened.description.tool.radius is None
    assert f'# radius = "{1e3 * loads[0].tool.radius:.6g} mm"' in text
    assert duration == pytest.approx(0.6)
    assert "reaches" in text


def test_the_tool_of_a_new_scene_follows_the_spacing(scene):
    coarse = pt.open_scene(scene, {"spacing": "7 mm"}).tool_paths()
    assert coarse.radius >= 2 * 0.007
    assert coarse.radius > pt.open_scene(scene).tool_paths().radius


def test_the_schema_is_next_to_the_scene_and_named_by_its_first_line(scene):
    first = scene.read_text().splitlines()[0]
    assert first == "#:schema ./organ.palpate/scene.schema.json"
    assert json.loads((scene.parent / "organ.palpate/scene.schema.json").read_text()) == scene_schema()


def test_comments_of_a_new_scene_are_settings_that_work(scene, tmp_path):
    lines = scene.read_text().splitlines()
    first = lines.index("[tissue]")
    keys = ("# relaxation", "# [[region]]", "# place", "# stiffness = 3", "# [[support]]", "# kind", "# stiffness =")
    used = [line[2:] if line.startswith(keys) else line for line in lines[first:]]
    used = [line.replace("10 mm", "-10 mm") for line in used]
    again = tmp_path / "used.toml"
    again.write_text("\n".join([*lines[:first], *used]).replace(str(lines[6]), lines[6]))
    shutil.copytree(scene.parent / "organ.palpate", tmp_path / "organ.palpate")
    table = tomllib.loads(again.read_text())
    assert [each.get("kind") for each in table["support"]] == ["fixed", "springs"]
    table["surface"]["file"] = str((scene.parent / table["surface"]["file"]).resolve())
    opened = pt.open_scene(again)
    assert opened.description.support[1].stiffness == pytest.approx(1e6)
    assert opened.description.region[0].stiffness == 3.0
    assert opened.material.prony.shares == (0.5,)


@pytest.mark.slow
def test_options_of_a_new_scene_are_written(organ, tmp_path):
    out = tmp_path / "hard.toml"
    options = ["--law", "Gent", "--fixed", "z-", "--units", "mm", "--scale", "2", "--spacing", "0.012"]
    assert main(["new", str(organ), "-o", str(out), *options]) == 0
    opened = pt.open_scene(out)
    assert opened.description.tissue.law == "Gent"
    assert opened.description.support[0].place.side == "z-"
    assert np.ptp(opened.cloud.points[:, 2]) == pytest.approx(
        2 * np.ptp(liver_surface(0.006, 6e-5).vertices[:, 2]), rel=0.02
    )
    assert "given, " in out.read_text()


@pytest.mark.slow
def test_what_cannot_become_a_scene_is_refused_and_nothing_is_written(organ, scene, tmp_path, assert_refused):
    def folder():
        return sorted(path.name for path in tmp_path.iterdir())

    assert_refused(["new", str(organ), "-o", str(scene)], "out must be a new file", "which exists")
    assert_refused(["new", str(organ), "-o", str(tmp_path / "organ.txt")], "out must end in .toml")
    assert_refused(["new", str(tmp_path), "-o", str(tmp_path / "a.toml")], "is a folder")
    text = tmp_path / "notes.txt"
    text.write_text("no surface")
    assert_refused(["new", str(text), "-o", str(tmp_path / "a.toml")], "FILE must be a surface")
    broken = tmp_path / "broken.stl"
    broken.write_bytes(b"solid\n" + b"x" * 100)
    assert_refused(["new", str(broken), "-o", str(tmp_path / "a.toml")], "broken.stl")
    command = ["new", str(organ), "-o", str(tmp_path / "a.toml"), *COARSE]
    assert_refused([*command, "--fixed", "lowest 99%"], "leave tissue free")
    assert_refused([*command, "--fixed", "near 900,0,0,1"], "place must hold a node")
    assert folder() == ["broken.stl", "notes.txt"]


@pytest.mark.slow
def test_check_of_a_scene_reports_supports_and_the_reach_of_the_tool(scene, tmp_path, capsys, assert_refused):
    assert main(["check", str(scene), "--out", str(tmp_path / "out"), "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    opened = pt.open_scene(scene)
    assert report["cloud"]["nodes"] == len(opened.cloud)
    assert report["scene"]["supports"] == {"support 1": len(opened.cloud.group("support 1"))}
    assert 0.2 < report["scene"]["reached"] < 1
    assert 0 < report["scene"]["held"] < 0.5
    assert (tmp_path / "out" / "tool.png").stat().st_size > 10_000
    assert_refused(["check", str(scene), "--spacing", "0.01"], "--spacing must be left out with a scene file")


def test_the_folder_of_a_scene_follows_its_contents_and_moves_with_it(scene, tmp_path):
    opened = pt.open_scene(scene)
    folder = training_folder(opened)
    assert folder.parent == scene.with_suffix(".palpate")
    assert training_folder(pt.open_scene(scene, {"paths": 99, "modes": 9})) == folder
    assert training_folder(pt.open_scene(scene, {"poisson": 0.3})) != folder
    name = name_in_folder(str(scene), folder)
    assert name == "../../organ.toml"
    moved = tmp_path / "elsewhere" / "organ.palpate" / folder.name
    assert scene_in_folder(name, moved) == str(moved / "../../organ.toml")
    assert name_in_folder("liver", folder) == scene_in_folder("liver", folder) == "liver"


def test_replay_of_a_scene_without_recordings_is_refused(scene, tmp_path, assert_refused):
    assert_refused(["replay", str(scene), "--png", str(tmp_path / "a.png")], "must have a recording", "press record")
    folder = scene.parent / "organ.palpate" / "recordings"
    folder.mkdir()
    try:
        for time, name in enumerate(("b.h5", "a.h5")):
            (folder / name).touch()
            os.utime(folder / name, (1e9 + time, 1e9 + time))
        assert last_recording(scene) == folder / "a.h5"
    finally:
        shutil.rmtree(folder)
