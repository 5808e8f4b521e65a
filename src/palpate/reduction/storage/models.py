"""Files of reduced models of either kind: hyper-reduced and linear."""

from __future__ import annotations

from pathlib import Path
from typing import overload

from palpate.faults import InputError
from palpate.files import regular_file
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.lti import storage as linear
from palpate.reduction.lti.model import LinearModel
from palpate.reduction.lti.storage import load_linear, save_linear
from palpate.reduction.lti.system import LinearSystem
from palpate.reduction.storage.model_file import REMEDY, load_hyper_reduced, save_hyper_reduced
from palpate.sealed import loading

__all__ = ["load", "save"]


def save(model: ReducedModel | LinearModel, path: str | Path) -> None:
    """Write a reduced model to one checked file, whole or not at all.

    Parameters
    ----------
    model : ReducedModel or LinearModel
    path : path

    Raises
    ------
    InputError
        The model is of another kind, or its file could not be read again: a material of one's own, or numbers that
        are not finite.
    OSError
        The place cannot be written or the disk is full; a file that was there is unchanged.
    """
    if isinstance(model, ReducedModel):
        save_hyper_reduced(model, path)
    elif isinstance(model, LinearModel):
        save_linear(model, path)
    else:
        raise InputError(f"model must be a ReducedModel or a LinearModel, got {type(model).__name__}; reduce it first")


@overload
def load(path: str | Path) -> ReducedModel: ...


@overload
def load(path: str | Path, system: LinearSystem | None) -> ReducedModel | LinearModel: ...


def load(path: str | Path, system: LinearSystem | None = None) -> ReducedModel | LinearModel:
    """Read a reduced model that `save` wrote.

    Parameters
    ----------
    path : path
    system : LinearSystem, optional
        The linearised body, made again: a linear model's file holds its reduced equations alone.

    Raises
    ------
    FileNotFoundError
        The file does not exist.
    FileFormatError
        The file is truncated, changed, of another kind or version, or its content does not fit together.
    InputError
        The file holds a linear model, and `system` is missing or another one.
    """
    path = Path(path)
    with loading(path, REMEDY):
        regular_file(path, "model")
        with path.open("rb") as file:
            is_linear = file.read(len(linear.FORMAT) + 1) == linear.FORMAT.encode() + b"\n"
    if not is_linear:
        return load_hyper_reduced(path)
    if system is None:
        raise InputError(f"system must be a LinearSystem for {path}, got None; give load the linearised body")
    return load_linear(path, system)
