"""Every name of a scene is that of a scene to train on, and stands in the helps."""

from __future__ import annotations

import contextlib

import pytest

import palpate as pt
from palpate.app.cli import main
from palpate.scenes.names import PACKAGE_SCENES, is_scene_file, listed_scenes
from palpate.scenes.training import is_opened, training_scene


@pytest.mark.parametrize("name", [pytest.param("liver", marks=pytest.mark.slow), "beam", "membrane"])
def test_every_name_is_of_a_scene_to_train_on(name):
    scene = training_scene(name, {})
    assert scene.title == name.capitalize()
    loads, duration = scene.path(0)
    scene.model.prepare(loads)
    assert 0 < scene.every < duration


def test_scene_files_are_known_by_their_suffix():
    assert is_scene_file("a/organ.toml")
    assert is_scene_file("ORGAN.TOML")
    assert not is_scene_file("organ.stl")
    assert [name for name in PACKAGE_SCENES if not is_opened(name)] == []
    assert is_opened("organ.toml")
    assert not is_opened("module:function")


def test_a_near_name_is_suggested():
    with pytest.raises(pt.InputError, match="did you mean liver"):
        training_scene("livr", {})


@pytest.mark.parametrize("command", ["train", "view", "run"])
def test_the_help_lists_every_scene(command, capsys):
    with contextlib.suppress(SystemExit):
        main([command, "--help"])
    text = capsys.readouterr().out
    assert [name for name in PACKAGE_SCENES if name not in text] == []
    assert listed_scenes() in " ".join(text.split())
