"""Model loader: a reduced model that takes a tool, of a scene or from a file."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from palpate.app.common.arguments import suggestion
from palpate.app.common.console import Console
from palpate.app.common.exit_status import one_line
from palpate.app.models.trained import trained_model
from palpate.faults import InputError
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.storage.models import load
from palpate.scenes.names import PACKAGE_SCENES
from palpate.scenes.surface_scene import is_surface_file, named_scene
from palpate.scenes.training import is_opened

__all__ = ["open_model"]


def open_model(
    what: str, console: Console, part: Sequence[str] | None = None, labels: Path | None = None
) -> tuple[ReducedModel, str]:
    """Return a model that takes a tool, and its title.

    Parameters
    ----------
    what : str
        A scene of `palpate.scenes.names.PACKAGE_SCENES` or a scene file: its trained model
        (`palpate.app.models.trained`). Or a surface file, likewise, or a file of `palpate train`.
    part, labels
        Of a surface file, as for `palpate.io.read_surface`.
    """
    if is_opened(what) or is_surface_file(what):
        scene = named_scene(what, None, part, labels)
        return _with_advice(trained_model(scene, console), console), scene.title
    if part or labels:
        raise InputError(f"part and labels must be left out unless a surface file is given, got {what!r:.60}")
    path = Path(what)
    if not path.suffix and not os.path.exists(path):  # False also for a name that is too long
        raise InputError(
            f"what must be {', '.join(PACKAGE_SCENES)}, a scene file, or a file of palpate train, got {what!r:.60}"
            f"{suggestion(what, PACKAGE_SCENES)}"
        )
    model = load(path)
    if model.data.compliance is None and len(model.data.prescribed) != 1:
        raise InputError(
            f"{path} must hold a model that takes a tool, got one trained without a tool that touches it or moves one "
            f"group (it has {len(model.data.prescribed)}); train it with a Contact, or with prescribed='GROUP'"
        )
    name = Path(str(model.report.get("scene", {}).get("name", path.stem)))
    title = (name.stem if name.suffix else name.name).rpartition(":")[2].replace("_", " ").capitalize()
    return _with_advice(model, console), title


def _with_advice(model: ReducedModel, console: Console) -> ReducedModel:
    """Return a model; print advice if its held-out errors are too large."""
    if "advice" in model.report:
        console.say(f"warning: {one_line(model.report['advice'])}")
    return model
