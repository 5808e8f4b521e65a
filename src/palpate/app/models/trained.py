"""The reduced model of a scene: from the scene's folder, or trained there by a campaign at the first use.

The folder of a scene file is next to it, that of a scene of the package is in the user's cache.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from palpate.app.common.console import Console, count_nodes, percent
from palpate.app.train.campaign import MODEL_FILE, Campaign, check_sizes
from palpate.app.train.estimate import Estimate, estimate_training, keep_trained
from palpate.app.train.folder import RECORDINGS_FOLDER, manifest_of, open_campaign
from palpate.app.train.scene_folder import name_in_folder, training_folder
from palpate.core.faults import FileFormatError, InputError
from palpate.core.files import check_folder
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.storage.models import load, save
from palpate.reduction.training.reduce import hyper_reduce
from palpate.scenes.names import SceneKind
from palpate.scenes.scene import Scene
from palpate.scenes.training import parameters_of, training_of

__all__ = ["held_out_means", "model_file", "trained_model", "training_folder"]

MAX_WORKERS = 4
FEW_MODES = (4, 8, 16)  # of the models of a held body that are compared, next to those of its scene


def model_file(scene: Scene) -> Path:
    """Return the path of a scene's trained model, which may be missing."""
    return training_folder(scene) / MODEL_FILE


def compared_modes(scene: Scene) -> tuple[int, ...]:
    """Return the numbers of modes of the models of a scene whose tool holds a group, the fewest first."""
    return tuple(sorted({*FEW_MODES, scene.description.training.modes}))


def compared_file(scene: Scene, modes: int) -> Path:
    """Return the path of the model of `train_compared` with a number of modes, which may be missing."""
    return training_folder(scene) / f"modes-{modes}.rom"


def train_compared(scene: Scene, console: Console, workers: int) -> None:
    """Train models of all `compared_modes` on the training runs of a scene whose tool holds a group, and keep them.

    They are compared with the full body, and have no errors on held-out runs.
    """
    folder = training_folder(scene)
    check_folder(folder, "cache" if scene.kind is SceneKind.PACKAGE else "folder")
    with campaign_of(scene, folder, console, workers) as campaign:
        jobs = campaign.jobs(range(scene.description.training.paths), 0)
        campaign.make_runs(jobs)
        runs = [campaign.folder.file(job) for job in jobs]
        for modes in compared_modes(scene):
            with console.status(f"training {modes} modes on {len(runs)} runs"):
                model = hyper_reduce(scene.body, runs, modes=modes, prescribed=scene.held_group)
            save(model, compared_file(scene, modes))


def kept_model(scene: Scene, say: Callable[[str], None]) -> ReducedModel | None:
    """Return the model in the folder of a scene, or None where one has to be trained.

    An existing model stays, also one of another number of paths or modes, such as of ``palpate train --paths 32``. It
    is trained again if `scene` was opened with another setting of them. `say` is called with a line about such a model.
    """
    file, training = model_file(scene), scene.description.training
    if not file.is_file():
        return None
    try:
        model = load(file)
    except FileFormatError as error:
        say(f"{error}; training another")
        return None
    others = _other_sizes(scene, model)
    if others.keys() & {key.rpartition(".")[2] for key in scene.settings}:
        return None
    if others:
        sizes = " and ".join(f"{size} {name}, not {getattr(training, name)}" for name, size in others.items())
        say(f"{file} has {sizes}; palpate train {scene.name} trains it again")
    return model


def training_needed(scene: Scene, console: Console, workers: int | None = None) -> Estimate | None:
    """Return the estimate of the training of `trained_model`, or None where a model is kept.

    Sizes and folders are checked first.
    """
    if kept_model(scene, lambda _: None) is not None:
        return None
    _check(scene)
    with console.status("measuring this machine"):
        return estimate_training(scene, scene.description.training, training_folder(scene), workers or _workers())


def trained_model(scene: Scene, console: Console, workers: int | None = None) -> ReducedModel:
    """Return the reduced model of a scene from its folder; train a missing one.

    A stopped campaign is continued. By default one process for each processor makes the runs, at most 4.
    """
    model = kept_model(scene, console.say)
    if model is not None:
        return model
    _check(scene)
    folder, training = training_folder(scene), scene.description.training
    with console.status("preparing the full model (the first time on a machine compiles it, for about a minute)"):
        _ = scene.body
    console.say(f"the runs and the model are kept in {folder}")
    with campaign_of(scene, folder, console, workers or _workers()) as campaign:
        if training.tolerance:
            _, model, _ = campaign.train_to_tolerance(training.tolerance, training.paths, training.held_out)
        else:
            model = campaign.train(campaign.jobs(range(training.paths), training.held_out))
    keep_trained(scene)
    console.say(f"trained {training.modes} modes, {count_nodes(model.report['nodes'])} sampled{_errors(model)}")
    return model


def _workers() -> int:
    return min(os.cpu_count() or 1, MAX_WORKERS)


def _check(scene: Scene) -> None:
    """Raise `InputError` for a scene whose model cannot be trained or kept, before its body is made."""
    folder = training_folder(scene)
    try:
        check_folder(folder, "cache" if scene.kind is SceneKind.PACKAGE else "folder")
    except InputError as error:
        raise InputError(f"{error}, or train a model elsewhere: palpate train {scene.name} --out FOLDER") from error
    check_sizes(scene, scene.description.training, recorded=(folder / RECORDINGS_FOLDER).is_dir())
    scene.check_training()


@contextmanager
def campaign_of(scene: Scene, folder: Path, console: Console, workers: int) -> Iterator[Campaign]:
    """Open the campaign of a scene in a folder, with a number of processes."""
    made, training = training_of(scene, parameters_of(scene)), scene.description.training
    with open_campaign(folder, manifest_of(name_in_folder(scene.name, folder), made, training.seed)) as campaign_folder:
        yield Campaign(campaign_folder, made, console, training.modes, workers=workers)


def _other_sizes(scene: Scene, model: ReducedModel) -> dict[str, Any]:
    """Return the numbers of paths and modes of a model that differ from those of its scene, by name."""
    training = scene.description.training
    sizes = {"modes": model.report.get("modes")}
    if not training.tolerance:  # which chooses the number of paths
        sizes["paths"] = model.report.get("training_runs")
    return {name: size for name, size in sizes.items() if size != getattr(training, name)}


def held_out_means(model: ReducedModel) -> dict[str, float]:
    """Return a model's mean relative errors on held-out runs by quantity; empty without such runs."""
    errors = model.report.get("held_out")
    if not errors:
        return {}
    if "contact" in errors:
        mean = errors["contact"]["mean"]
        return {"force": mean["force"], "surface": mean["surface_95"]}
    return {"force": errors["mean"]["reaction"], "displacement": errors["mean"]["displacement"]}


def _errors(model: ReducedModel) -> str:
    """Return the mean errors on held-out runs as text; empty without such runs."""
    errors = [f"{name} errs by {percent(error)}" for name, error in held_out_means(model).items()]
    return f"; on paths not trained on {', '.join(errors)}" if errors else ""
