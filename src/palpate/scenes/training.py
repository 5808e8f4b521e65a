"""Scenes with random paths by name, for training campaigns."""

from __future__ import annotations

import inspect
import math
import os
import sys
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any, cast

from palpate.faults import InputError, brief
from palpate.scenes.names import SCENES
from palpate.scenes.scene import TrainingScene

__all__ = ["scene_function", "search_current_folder", "training_scene", "typed"]

SCENE_NAMES = f"{', '.join(map(repr, SCENES))}, or 'module:function' of your own"
KINDS = (bool, int, float, str)  # of parameters
MAX_TEXT_CHARACTERS = 200  # characters of a text


def training_scene(name: str, parameters: Mapping[str, Any]) -> TrainingScene:
    """Build a scene.

    Parameters
    ----------
    name : str
        One of `palpate.scenes.names.SCENES`, or ``"module:function"`` of a function that returns a `TrainingScene`.
    parameters : mapping
        Arguments of its function; others have their defaults.

    Raises
    ------
    InputError
        An unknown scene or parameter, a value out of range, or a user's module or function that
        fails.
    """
    function, arguments = scene_function(name), typed(name, parameters)
    if name in SCENES:
        return cast(TrainingScene, function(**arguments))
    made = _own(name, "failed", lambda: function(**arguments))
    if not isinstance(made, TrainingScene):
        raise InputError(f"scene {name!r} must return a TrainingScene, got a {type(made).__name__}")
    return made


def typed(name: str, parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Return all parameters of a scene, with given values converted to the types of its function's defaults.

    Raises
    ------
    InputError
        An unknown scene or parameter, or a value of another type.
    """
    known = _defaults(name)
    values = dict(known)
    for key, given in parameters.items():
        if key not in known:
            raise InputError(f"parameters of scene {name!r} must be among {', '.join(known)}, got {brief(key)}")
        values[key] = _converted(key, given, known[key])
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
        known = {p.name: p.default for p in inspect.signature(scene_function(name)).parameters.values()}
    except (TypeError, ValueError) as error:
        raise InputError(f"scene must be a function with named parameters, got {name!r} ({error})") from error
    for key, default in known.items():
        if not isinstance(default, KINDS):
            raise InputError(f"parameter {key!r} of scene {name!r} must have a number or text as default")
    return known


def _converted(key: str, given: Any, default: Any) -> Any:
    kind = type(default)
    try:
        if isinstance(default, bool):
            return {"true": True, "1": True, "false": False, "0": False}[str(given).lower()]
        if isinstance(default, str) and not (isinstance(given, str) and len(given) <= MAX_TEXT_CHARACTERS):
            raise ValueError
        value = kind(given)
        if isinstance(value, float) and not math.isfinite(value):
            raise ValueError
        if isinstance(default, int) and not isinstance(given, str) and value != given:
            raise ValueError
    except (ValueError, TypeError, OverflowError, KeyError):
        raise InputError(f"{key} must be a {kind.__name__}, as its default {default!r}, got {brief(given)}") from None
    return value


def scene_function(name: str) -> Callable[..., Any]:
    """Return the function of a scene; see `training_scene`."""
    if name in SCENES:
        file, function = SCENES[name]
        return cast(Callable[..., Any], getattr(import_module(f"palpate.scenes.{file}"), function))
    module, _, function = name.partition(":")
    if not (function.isidentifier() and all(part.isidentifier() for part in module.split("."))):
        raise InputError(f"scene must be {SCENE_NAMES}, got {brief(name)}; correct its name")
    found = getattr(_own(name, "cannot be imported", lambda: import_module(module)), function, None)
    if not callable(found):
        raise InputError(f"scene must be {SCENE_NAMES}, got {name!r}: module {module!r} has no function {function!r}")
    return found


def _own(name: str, what: str, call: Callable[[], Any]) -> Any:
    """Call code of a user, and raise its errors as errors of the scene."""
    try:
        return call()
    except InputError:
        raise
    except (Exception, SystemExit) as error:
        raise InputError(
            f"scene must be {SCENE_NAMES}, got {name!r}, which {what} ({type(error).__name__}: {error})"
        ) from error
