"""A linear model's reduced equations in an HDF5 file; the body itself is made again by who reads it."""

from __future__ import annotations

import json
import os
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from palpate.faults import FileFormatError, InputError
from palpate.reduction.lti.forms import FirstOrder, SecondOrder
from palpate.reduction.lti.model import LinearModel

if TYPE_CHECKING:
    from palpate.reduction.lti.system import LinearSystem

__all__ = ["load_linear", "save"]

FORMAT, VERSION = "palpate linear model", 1
KINDS: dict[str, type[SecondOrder] | type[FirstOrder]] = {"second": SecondOrder, "first": FirstOrder}


def save(model: LinearModel, path: Path) -> None:
    """Write a model, whole or not at all.

    Raises
    ------
    OSError
        The place cannot be written.
    """
    import h5py

    partial = path.with_name(path.name + ".partial")
    kind = "second" if isinstance(model.reduced, SecondOrder) else "first"
    try:
        with h5py.File(partial, "w") as file:
            file.attrs.update(_header(model.system) | {"kind": kind, "report": json.dumps(model.report)})
            for own in fields(model.reduced):
                file.create_dataset(own.name, data=getattr(model.reduced, own.name))
            file.create_dataset("points", data=model.cloud.points)
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def _header(system: LinearSystem) -> dict[str, Any]:
    return {
        "format": FORMAT, "version": VERSION, "inputs": json.dumps(system.inputs),
        "outputs": json.dumps(system.outputs), "unknowns": system.order,
    }  # fmt: skip


def load_linear(path: str | Path, system: LinearSystem) -> LinearModel:
    """Read a linear model that `LinearModel.save` wrote.

    Parameters
    ----------
    path : path
    system : LinearSystem
        The linearised body that it was made of, made again.

    Raises
    ------
    FileNotFoundError
        There is no such file.
    FileFormatError
        It is no linear model, or holds what none can hold.
    InputError
        It was made of another body, or with other inputs or outputs.
    """
    import h5py

    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no linear model at {path}")
    try:
        with h5py.File(path, "r") as file:
            header = dict(file.attrs)
            if header.get("format") != FORMAT or header.get("version") != VERSION or header.get("kind") not in KINDS:
                raise FileFormatError(f"{path}: not a linear model of version {VERSION}")
            form = KINDS[str(header["kind"])]
            arrays = {own.name: np.array(file[own.name], dtype=float) for own in fields(form)}
            points, report = np.array(file["points"]), json.loads(str(header["report"]))
    except (OSError, KeyError, ValueError) as error:
        if isinstance(error, FileFormatError):
            raise
        raise FileFormatError(f"{path}: {error}") from error
    wanted = _header(system)
    differ = [name for name in ("inputs", "outputs", "unknowns") if header.get(name) != wanted[name]]
    if differ or points.shape != system.model.cloud.points.shape or not np.allclose(points, system.model.cloud.points):
        raise InputError(f"{path} was made of another linear system: {', '.join(differ) or 'points'} differ")
    if not all(np.isfinite(array).all() for array in arrays.values()):
        raise FileFormatError(f"{path}: holds numbers that are not finite")
    try:
        return LinearModel(system, form(**arrays), report)
    except (ValueError, np.linalg.LinAlgError) as error:
        raise FileFormatError(f"{path}: its arrays do not fit together ({error})") from error
