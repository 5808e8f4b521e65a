"""Scenes with random paths for training campaigns: of the package, from scene files, or of a user's function."""

from __future__ import annotations

import inspect
import math
import os
import sys
from collections.abc import Callable, Mapping
from dataclasses import replace
from difflib import get_close_matches
from importlib import import_module
from typing import Any

from palpate.core.faults import InputError, brief
from palpate.scenes.description import chooses_runs
from palpate.scenes.load_case import TrainingScene
from palpate.scenes.names import PACKAGE_SCENES, SceneKind, kind_of
from palpate.scenes.open_scene import json_of_scene, open_description, open_scene
from palpate.scenes.scene import Scene

# parameters of a training scene from a file: digest of what it depends on; its description where the file alone has
# another one, or is a surface
DIGEST_KEY, DESCRIPTION_KEY = "digest", "description"

SCENE_NAMES = f"{', '.join(map(repr, PACKAGE_SCENES))}, a scene file, or 'module:function' of your own"
PARAMETER_TYPES = (bool, int, float, str)  # of parameters
MAX_TEXT_CHARACTERS = 200  # characters of a text


def open_training(name: str, parameters: Mapping[str, Any]) -> TrainingScene:
    """Open a scene for a campaign: its body, and paths by seed.

    `name` is one of `palpate.scenes.names.PACKAGE_SCENES`, a scene file, or ``"module:function"`` of a function that
    returns a `TrainingScene`. `parameters` are settings of the scene (`palpate.open_scene`), or arguments of the
    function; others have their defaults.
    """
    if DESCRIPTION_KEY in parameters:
        return training_of(open_description(name, str(parameters[DESCRIPTION_KEY])), parameters)
    if kind_of(name) in (SceneKind.PACKAGE, SceneKind.SCENE_FILE):
        settings = {key: value for key, value in parameters.items() if key != DIGEST_KEY}
        return training_of(open_scene(name, settings), parameters)
    function, arguments = _user_function(name), _arguments(name, parameters)
    made = _call_user_code(name, "failed", lambda: function(**arguments))
    if not isinstance(made, TrainingScene):
        raise InputError(f"scene {name!r} must return a TrainingScene, got a {type(made).__name__}")
    return made


def training_of(scene: Scene, parameters: Mapping[str, Any]) -> TrainingScene:
    """Return the body and the paths of a scene for a campaign.

    The scene was opened with `parameters`. A digest among them must be that of the scene.
    """
    values = dict(parameters)
    digest, text = values.pop(DIGEST_KEY, None), values.get(DESCRIPTION_KEY)
    for name, value in values.items():
        if not isinstance(value, str | int | float):  # as a campaign and a model file keep it
            raise InputError(f"{name} must be a number or a text to train with, got {brief(value)}; change the file")
    if text is not None and text != json_of_scene(scene):
        raise InputError(f"{DESCRIPTION_KEY} must be that of the scene, got another one; open the scene by it")
    if digest not in (None, scene.digest):
        raise InputError(
            f"{scene.name}, or a file that it names, has changed; open the changed scene in another folder"
        )
    training = scene.description.training
    tools = (scene.held_group,) if scene.held_group else ()
    # a campaign continues with other numbers of paths and modes
    recorded = {
        key: values[key] for key in values if key == DESCRIPTION_KEY or not chooses_runs(scene.description, key)
    }
    recorded[DIGEST_KEY] = scene.digest
    paths = scene.paths  # raises for a tool that is too small before the body is made
    made = TrainingScene(scene.body, paths, training.every, scene.title, recorded, tools)
    return made if training.cubature is None else replace(made, cubature=training.cubature)


def parameters_of(scene: Scene) -> dict[str, Any]:
    """Return the parameters with which a worker opens a scene: its settings, or its own description."""
    if scene.kind is not SceneKind.SURFACE_FILE and open_scene(scene.name, scene.settings).digest == scene.digest:
        return scene.settings
    return {DESCRIPTION_KEY: json_of_scene(scene)}


def _arguments(name: str, parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Return all arguments of a user's function, with given values converted to the types of its defaults."""
    defaults = _defaults(name)
    values = dict(defaults)
    for key, value in parameters.items():
        if key not in defaults:
            raise InputError(f"parameters of scene {name!r} must be among {', '.join(defaults)}, got {brief(key)}")
        values[key] = _converted(key, value, defaults[key])
    return values


def search_current_folder() -> None:
    """Append the current folder to the search path of modules.

    It is only for a scene that a person names on the command line: a name from a file must not
    select code there.
    """
    folder = os.getcwd()
    if not {"", folder} & set(sys.path):
        sys.path.append(folder)


def _defaults(name: str) -> dict[str, Any]:
    """Return the parameters of a scene's function with their defaults, each a number, a truth value or text."""
    try:
        defaults = {p.name: p.default for p in inspect.signature(_user_function(name)).parameters.values()}
    except (TypeError, ValueError) as error:
        raise InputError(f"scene must be a function with named parameters, got {name!r} ({error})") from error
    for key, default in defaults.items():
        if not isinstance(default, PARAMETER_TYPES):
            raise InputError(f"parameter {key!r} of scene {name!r} must have a number or text as default")
    return defaults


def _converted(key: str, raw: Any, default: Any) -> Any:
    kind = type(default)
    try:
        if isinstance(default, bool):
            return {"true": True, "1": True, "false": False, "0": False}[str(raw).lower()]
        if isinstance(default, str) and not (isinstance(raw, str) and len(raw) <= MAX_TEXT_CHARACTERS):
            raise ValueError
        value = kind(raw)
        if isinstance(value, float) and not math.isfinite(value):
            raise ValueError
        if isinstance(default, int) and not isinstance(raw, str) and value != raw:
            raise ValueError
    except (ValueError, TypeError, OverflowError, KeyError):
        raise InputError(f"{key} must be a {kind.__name__}, as its default {default!r}, got {brief(raw)}") from None
    return value


def _user_function(name: str) -> Callable[..., Any]:
    """Return the function of a user's scene; see `open_training`."""
    module, _, function = name.partition(":")
    if not (function.isidentifier() and all(part.isidentifier() for part in module.split("."))):
        near = get_close_matches(name[:60], PACKAGE_SCENES, 1)
        remedy = f"did you mean {near[0]}?" if near else "correct its name"
        raise InputError(f"scene must be {SCENE_NAMES}, got {brief(name)}; {remedy}")
    user_function = getattr(_call_user_code(name, "cannot be imported", lambda: import_module(module)), function, None)
    if not callable(user_function):
        raise InputError(f"scene must be {SCENE_NAMES}, got {name!r}: module {module!r} has no function {function!r}")
    return user_function


def _call_user_code(name: str, what: str, call: Callable[[], Any]) -> Any:
    """Call code of a user, and raise its errors as errors of the scene."""
    try:
        return call()
    except InputError:
        raise
    except (Exception, SystemExit) as error:
        raise InputError(
            f"scene must be {SCENE_NAMES}, got {name!r}, which {what} ({type(error).__name__}: {error})"
        ) from error
