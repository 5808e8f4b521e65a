"""Model loader: a reduced model that takes a tool, from the name of a scene or from a file."""

from __future__ import annotations

import os
from pathlib import Path

from palpate.app.common.arguments import suggestion
from palpate.app.common.console import Console
from palpate.app.common.exit_status import one_line
from palpate.app.models.cache import LIVER, load_cached_liver
from palpate.app.models.quick_training import train_quickly
from palpate.faults import InputError
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.storage.models import load
from palpate.scenes.names import SCENES as NAMES
from palpate.scenes.training import scene_function

__all__ = ["open_model"]

MODES = 24  # of the models of scenes that are trained at each start: all but the liver
SCENES = (LIVER, *(name for name in NAMES if name != LIVER))


def open_model(what: str, console: Console) -> tuple[ReducedModel, str]:
    """Return a model that takes a tool, and its title.

    Parameters
    ----------
    what : str
        ``"liver"``: the small model from the user's cache, trained at the first use; another scene of
        `palpate.scenes.names.SCENES`, trained at once; or a file of `palpate train`.
    console : Console

    Raises
    ------
    InputError, FileFormatError, FileNotFoundError
        No such scene or file, or a model that takes no tool.
    """
    if what == LIVER:
        return _with_advice(load_cached_liver(console), console), "Liver"
    if what in NAMES:
        return train_quickly(scene_function(what), MODES, console), what.capitalize()
    path = Path(what)
    if not path.suffix and not os.path.exists(path):  # False also for a name that is too long
        raise InputError(
            f"what must be {', '.join(SCENES)}, or a file of palpate train, got {what!r:.60}{suggestion(what, SCENES)}"
        )
    model = load(path)
    if model.data.compliance is None and len(model.data.prescribed) != 1:
        raise InputError(
            f"{path} must hold a model that takes a tool, got one trained without a tool that touches it or moves one "
            f"group (it has {len(model.data.prescribed)}); train it with a Contact, or with prescribed='GROUP'"
        )
    name = str(model.report.get("scene", {}).get("name", path.stem))
    return _with_advice(model, console), name.rpartition(":")[2].replace("_", " ").capitalize()


def _with_advice(model: ReducedModel, console: Console) -> ReducedModel:
    """Return a model; print what to change if its held-out errors are too large to use it."""
    if "advice" in model.report:
        console.say(f"warning: {one_line(model.report['advice'])}")
    return model
