"""Input of a command: a scene, or the reduced model in a file."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from palpate.app.common.arguments import suggestion
from palpate.app.common.console import Console
from palpate.app.common.exit_status import one_line
from palpate.core.faults import InputError
from palpate.scenes.names import PACKAGE_SCENES, SceneKind, kind_of
from palpate.scenes.open_scene import open_scene
from palpate.scenes.open_surface import complete_for_training
from palpate.scenes.places import side_mask
from palpate.scenes.scene import Scene
from palpate.surface.formats.first_bytes import refuse_misnamed

if TYPE_CHECKING:  # it takes a second to import, before a page opens
    from palpate.app.train.estimate import Estimate
    from palpate.reduction.hyper.model import ReducedModel

INPUT_NAMES = f"{', '.join(PACKAGE_SCENES)}, a scene file, or a file of palpate train"


@dataclass(frozen=True)
class Input:
    """A scene, whose reduced model is trained at its first use, or the reduced model of a file."""

    name: str
    title: str
    scene: Scene | None = None
    model: ReducedModel | None = None

    def training_needed(self, console: Console) -> Estimate | None:
        """Return the estimate of the training of a model that is missing, after checks of its options, or None."""
        if self.scene is None or self.model is not None:
            return None
        from palpate.app.models.trained import training_needed

        return training_needed(self.scene, console)

    def reduced(self, console: Console) -> ReducedModel:
        """Return the reduced model, trained where it is missing; print advice if its held-out errors are too large."""
        model = self.model
        if model is None:
            from palpate.app.models.trained import trained_model

            assert self.scene is not None
            model = trained_model(self.scene, console)
        if "advice" in model.report:
            console.say(f"warning: {one_line(model.report['advice'])}")
        return model


def open_input(
    source: str,
    settings: Mapping[str, Any] | None = None,
    spacing: float | None = None,
    for_training: bool = False,
    **shape: Any,
) -> Input:
    """Open a scene as `palpate.open_scene` does, or the file of a reduced model.

    `shape` are options of a surface file, None, 1, or empty where the user gave none: settings (units, scale, law), and
    arguments of `palpate.open_scene`. With `for_training` the scene of a surface file has all that a reduced model
    requires (`palpate.scenes.open_surface.complete_for_training`). Errors of a file are raised at once.
    """
    given = {} if spacing is None else {"spacing": spacing}
    shape = {option: value for option, value in shape.items() if value not in (None, 1.0, [], ())}
    kind = kind_of(source)
    if kind is None:
        refuse_misnamed(Path(source))
        if not (shape or settings or given):
            return _model_of_file(source)
    if kind is None or (shape and kind is SceneKind.PACKAGE):
        raise InputError(
            "units, scale, part, labels, without, spacing, law, set and fixed must be left out unless a surface file "
            f"is viewed, got {source!r:.60}"
        )
    if shape and kind is SceneKind.SCENE_FILE:
        raise InputError(f"{next(iter(shape))} must be left out with a scene file, got {source!r:.60}; change the file")
    given |= {option: shape.pop(option) for option in ("units", "scale", "law") if option in shape}
    scene = open_scene(source, given | dict(settings or {}), **shape)
    if kind is not SceneKind.PACKAGE:
        _check_files(scene)
    is_completed = for_training and kind is SceneKind.SURFACE_FILE
    return Input(source, scene.title, complete_for_training(scene) if is_completed else scene)


def _check_files(scene: Scene) -> None:
    """Read the surface and the tissue of a scene, and of a surface file alone the supports."""
    surface, _ = scene.surface, scene.material
    if surface is None or scene.kind is not SceneKind.SURFACE_FILE:
        return
    for support in scene.description.support:
        if support.place.side:
            side_mask(surface.vertices, support.place.side, space=surface.space)


def _model_of_file(name: str) -> Input:
    """Return the reduced model of a file of ``palpate train``, which takes a tool."""
    path = Path(name)
    if not path.suffix and not os.path.exists(path):  # False also for a name that is too long
        raise InputError(f"source must be {INPUT_NAMES}, got {name!r:.60}{suggestion(name, PACKAGE_SCENES)}")
    from palpate.reduction.storage.models import load

    model = load(path)
    if model.data.compliance is None and len(model.data.prescribed) != 1:
        raise InputError(
            f"{path} must hold a model that takes a tool, got one trained without a tool that touches it or moves one "
            f"group (it has {len(model.data.prescribed)}); train it with a Contact, or with prescribed='GROUP'"
        )
    scene = Path(str(model.report.get("scene", {}).get("name", path.stem)))
    title = (scene.stem if scene.suffix else scene.name).rpartition(":")[2].replace("_", " ").capitalize()
    return Input(name, title, model=model)
