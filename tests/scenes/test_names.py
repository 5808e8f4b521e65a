"""Every name of a scene is that of a scene to train on, and stands in the helps."""

from __future__ import annotations

import contextlib

import pytest

import palpate as pt
from palpate.app.cli import main
from palpate.scenes.names import PACKAGE_SCENES, SceneKind, kind_of, listed_scenes
from palpate.scenes.training import open_training


@pytest.mark.quick(name=["beam"])
@pytest.mark.parametrize("name", ["liver", "beam", "membrane"])
def test_every_name_is_of_a_scene_to_train_on(name):
    scene = open_training(name, {})
    assert scene.title == name.capitalize()
    loads, duration = scene.path(0)
    scene.model.prepare(loads)
    assert 0 < scene.every < duration


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        *((name, SceneKind.PACKAGE) for name in PACKAGE_SCENES),
        *((name, SceneKind.SCENE_FILE) for name in ("a/organ.toml", "ORGAN.TOML")),
        *((name, SceneKind.SURFACE_FILE) for name in ("organ.STL", "a/b.ply", "organ.obj.gz")),
        *((name, None) for name in ("module:function", "model.rom", "model.rom.gz", "kidney")),
    ],
)
def test_a_name_has_the_kind_of_its_scene(name, kind):
    assert kind_of(name) is kind


def test_a_near_name_is_suggested():
    with pytest.raises(pt.InputError, match="did you mean liver"):
        open_training("livr", {})


@pytest.mark.parametrize("command", ["train", "view", "run"])
def test_the_help_lists_every_scene(command, capsys):
    with contextlib.suppress(SystemExit):
        main([command, "--help"])
    text = capsys.readouterr().out
    assert [name for name in PACKAGE_SCENES if name not in text] == []
    assert listed_scenes() in " ".join(text.split())
