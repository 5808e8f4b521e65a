"""Scenes with random paths by name, for training campaigns."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

from palpate.faults import InputError
from palpate.scenes.grasp import grasped_beam
from palpate.scenes.liver import pressed_liver
from palpate.scenes.push import pushed_membrane
from palpate.scenes.scene import TrainingScene

__all__ = ["TRAINING", "training_scene", "typed"]

TRAINING: dict[str, Callable[..., TrainingScene]] = {
    "beam": grasped_beam, "liver": pressed_liver, "membrane": pushed_membrane,
}  # fmt: skip


def training_scene(name: str, parameters: Mapping[str, Any]) -> TrainingScene:
    """Build a scene.

    Parameters
    ----------
    name : str
        One of `TRAINING`, or ``"module:function"`` of a function that returns a `TrainingScene`.
    parameters : mapping
        Arguments of its function; what is not given has its default.

    Raises
    ------
    InputError
        An unknown scene or parameter, or a value out of range.
    """
    made = _function(name)(**typed(name, parameters))
    if not isinstance(made, TrainingScene):
        raise InputError(f"scene {name!r} returned a {type(made).__name__}; needed is a TrainingScene")
    return made


def typed(name: str, parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Return all parameters of a scene, those given, numbers or text, as its function's defaults are typed.

    Raises
    ------
    InputError
        An unknown scene or parameter, or a value that is no such number.
    """
    known = {p.name: p.default for p in inspect.signature(_function(name)).parameters.values()}
    values = dict(known)
    for key, given in parameters.items():
        if key not in known:
            raise InputError(f"scene {name!r} has no parameter {key!r}; it has {', '.join(known)}")
        kind = type(known[key])
        try:
            values[key] = kind(given)
        except ValueError:
            raise InputError(f"{key} = {given!r}: needed is a {kind.__name__}, as its default {known[key]!r}") from None
    return values


def _function(name: str) -> Callable[..., Any]:
    if name in TRAINING:
        return TRAINING[name]
    module, colon, function = name.partition(":")
    known = f"allowed are {', '.join(map(repr, TRAINING))}, or 'module:function' of your own"
    if not colon:
        raise InputError(f"scene = {name!r}: {known}")
    try:
        found = getattr(import_module(module), function)
    except (ImportError, AttributeError, ValueError) as error:
        raise InputError(f"scene = {name!r}: {error}; {known}") from error
    return found
