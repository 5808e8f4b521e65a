"""Every name of a scene leads to a function that returns a scene to train on, and stands in the helps."""

from __future__ import annotations

import contextlib
import typing

import pytest

from palpate.app.cli import main
from palpate.scenes.names import SCENES
from palpate.scenes.scene import TrainingScene
from palpate.scenes.training import scene_function


@pytest.mark.parametrize("name", SCENES)
def test_every_name_is_of_a_function_that_returns_a_scene(name):
    assert typing.get_type_hints(scene_function(name))["return"] is TrainingScene


@pytest.mark.parametrize("command", ["train", "view"])
def test_the_help_lists_every_scene(command, capsys):
    with contextlib.suppress(SystemExit):
        main([command, "--help"])
    text = capsys.readouterr().out
    assert [name for name in SCENES if name not in text] == []
