"""Subject of a command: a scene, or the reduced model in a file. Its name is looked at here, once."""

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
from palpate.scenes.open_surface import complete_for_training, open_surface
from palpate.scenes.places import side_mask
from palpate.scenes.scene import Scene
from palpate.surface.formats.first_bytes import refuse_misnamed

if TYPE_CHECKING:  # it takes a second to import, before a page opens
    from palpate.reduction.hyper.model import ReducedModel


@dataclass(frozen=True)
class Subject:
    """A scene, whose reduced model is trained at its first use, or the reduced model of a file."""

    name: str
    title: str
    scene: Scene | None = None
    model: ReducedModel | None = None

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


SUBJECT_NAMES = f"{', '.join(PACKAGE_SCENES)}, a scene file, or a file of palpate train"


def open_subject(
    name: str,
    settings: Mapping[str, Any] | None = None,
    spacing: float | None = None,
    for_training: bool = False,
    **shape: Any,
) -> Subject:
    """Open a scene of the package, a scene file, a surface file, or the file of a reduced model.

    `settings` and `spacing` [m] are of a scene (`palpate.open_scene`), `shape` are further options of a surface file
    (`palpate.scenes.open_surface.open_surface`): None, 1, or empty where the user gave none. With `for_training` the
    scene of a surface file has all that a reduced model requires (`palpate.scenes.open_surface.complete_for_training`).
    """
    shape = {option: value for option, value in shape.items() if value not in (None, 1.0, [], ())}
    kind, settings = kind_of(name), dict(settings or {})
    if kind is None:
        refuse_misnamed(Path(name))
    if kind is SceneKind.SURFACE_FILE:
        scene = open_surface(name, spacing=spacing, settings=settings, **shape)
        assert scene.surface is not None
        for support in scene.description.support:
            if support.place.side:
                side_mask(scene.surface.vertices, support.place.side, space=scene.surface.space)
        return Subject(name, scene.title, complete_for_training(scene) if for_training else scene)
    if kind is None and not (shape or settings or spacing is not None):
        return _model_of_file(name)
    if kind is None or (shape and kind is SceneKind.PACKAGE):
        raise InputError(
            "units, scale, part, labels, without, spacing, law, set and fixed must be left out unless a surface file "
            f"is viewed, got {name!r:.60}"
        )
    if shape:
        raise InputError(f"{next(iter(shape))} must be left out with a scene file, got {name!r:.60}; change the file")
    scene = open_scene(name, ({} if spacing is None else {"spacing": spacing}) | settings)
    if kind is SceneKind.SCENE_FILE:
        _ = scene.surface, scene.material  # raises errors of the surface and the tissue at once
    return Subject(name, scene.title, scene)


def _model_of_file(name: str) -> Subject:
    """Return the subject of a file of ``palpate train``, whose model takes a tool."""
    path = Path(name)
    if not path.suffix and not os.path.exists(path):  # False also for a name that is too long
        raise InputError(f"what must be {SUBJECT_NAMES}, got {name!r:.60}{suggestion(name, PACKAGE_SCENES)}")
    from palpate.reduction.storage.models import load

    model = load(path)
    if model.data.compliance is None and len(model.data.prescribed) != 1:
        raise InputError(
            f"{path} must hold a model that takes a tool, got one trained without a tool that touches it or moves one "
            f"group (it has {len(model.data.prescribed)}); train it with a Contact, or with prescribed='GROUP'"
        )
    scene = Path(str(model.report.get("scene", {}).get("name", path.stem)))
    title = (scene.stem if scene.suffix else scene.name).rpartition(":")[2].replace("_", " ").capitalize()
    return Subject(name, title, model=model)
