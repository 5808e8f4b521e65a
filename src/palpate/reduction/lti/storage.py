"""File of a linear model: its reduced equations in a sealed HDF5 file, without the body."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from palpate.faults import InputError
from palpate.files import plain
from palpate.reduction.lti.model import LinearModel
from palpate.reduction.lti.state_space import FirstOrder, SecondOrder
from palpate.reduction.lti.system import LinearSystem
from palpate.sealed import loading, open_sealed, write_sealed

__all__ = ["read_linear", "save_linear"]

FORMAT, VERSION = "palpate linear model", 2
LINEAR_MODEL_REMEDY = "make the linear model again"
ARRAY_SHAPES: dict[str, tuple[str | int, ...]] = {
    "mass": ("k", "k"), "damping": ("k", "k"), "stiffness": ("k", "k"), "state": ("k", "k"), "input": ("k", "p"),
    "output": ("q", "k"), "rate_output": ("q", "k"), "feedthrough": ("q", "p"), "fields": ("k", "n", 3),
}  # fmt: skip
CLASS_BY_ORDER: dict[str, type[SecondOrder] | type[FirstOrder]] = {"second": SecondOrder, "first": FirstOrder}


def save_linear(model: LinearModel, path: str | Path) -> None:
    """Write a model, whole or not at all."""
    arrays = {each.name: getattr(model.reduced, each.name) for each in fields(model.reduced)}
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise InputError(f"{name} of the linear model is not finite: {path} was not written")
    kind = next(name for name, form in CLASS_BY_ORDER.items() if isinstance(model.reduced, form))
    header = _header(model.system) | {"kind": kind, "report": plain(model.report)}
    write_sealed(Path(path), FORMAT, VERSION, header, arrays | {"points": model.cloud.points})


def _header(system: LinearSystem) -> dict[str, Any]:
    return {"inputs": list(system.inputs), "outputs": list(system.outputs), "unknowns": int(system.order)}


def read_linear(path: str | Path, system: LinearSystem) -> LinearModel:
    """Read a linear model from a file of `save_linear`.

    Parameters
    ----------
    system : LinearSystem
        The same linearised body as for the saved model.
    """
    path = Path(path)
    with loading(path, LINEAR_MODEL_REMEDY):
        file = open_sealed(path, FORMAT, VERSION)
        header, expected = file.header, _header(system)
        if header.keys() != {*expected, "kind", "report"} or not isinstance(header["report"], dict):
            raise InputError("the header is not that of a linear model")
        if not isinstance(header["kind"], str) or header["kind"] not in CLASS_BY_ORDER:
            raise InputError(f"kind must be one of {', '.join(CLASS_BY_ORDER)}, got {header['kind']!r:.60}")
        form = CLASS_BY_ORDER[header["kind"]]
        names = [each.name for each in fields(form)]
        if file.arrays.keys() != {*names, "points"}:
            raise InputError(f"the arrays are {', '.join(sorted(file.arrays))}; expected {', '.join(names)}, points")
        arrays = {name: file.read(name) for name in file.arrays}
        for name, array in arrays.items():
            if array.dtype != np.float64 or not np.isfinite(array).all():
                raise InputError(f"array {name} is not of finite numbers")
    points = arrays.pop("points")
    differ = [name for name in expected if header[name] != expected[name]]
    if differ or points.shape != system.model.cloud.points.shape or not np.allclose(points, system.model.cloud.points):
        raise InputError(f"{path} was made of another linear system: {', '.join(differ) or 'points'} differ")
    with loading(path, LINEAR_MODEL_REMEDY):
        _check_shapes(arrays, {"p": len(system.inputs), "q": len(system.outputs), "n": len(points)})
        with np.errstate(all="ignore"):
            model = LinearModel(system, form(**arrays), header["report"])
        if not all(np.isfinite(matrix).all() for matrix in (model.A, model.B, model.C, model.D)):
            raise InputError("its state-space matrices are not finite")
        model.state(model.prepare(system.loads))  # raises an error for fields that are not independent
        return model


def _check_shapes(arrays: dict[str, Any], sizes: dict[str | int, int]) -> None:
    """Check that arrays have the shapes of `ARRAY_SHAPES`, with one k for all."""
    sizes = sizes | {"k": len(arrays["fields"]) if arrays["fields"].ndim else 0}
    for name, array in arrays.items():
        expected = tuple(sizes.get(size, size) for size in ARRAY_SHAPES[name])
        if array.shape != expected or not sizes["k"]:
            raise InputError(f"array {name} has shape {array.shape}, expected {expected}")
