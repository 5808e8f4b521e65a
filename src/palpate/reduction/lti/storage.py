"""File of a linear model: its reduced equations in a sealed HDF5 file, without the body."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from palpate.core.faults import InputError
from palpate.core.files import plain
from palpate.core.sealed import Array, check_arrays, check_names, loading, open_sealed, write_sealed
from palpate.reduction.lti.model import LinearModel
from palpate.reduction.lti.state_space import FirstOrder, SecondOrder
from palpate.reduction.lti.system import LinearSystem

FORMAT, VERSION = "palpate linear model", 2
LINEAR_MODEL_REMEDY = "make the linear model again"
LINEAR_ARRAYS = {
    "mass": Array(("order", "order")),
    "damping": Array(("order", "order")),
    "stiffness": Array(("order", "order")),
    "state": Array(("order", "order")),
    "input": Array(("order", "inputs")),
    "output": Array(("outputs", "order")),
    "rate_output": Array(("outputs", "order")),
    "feedthrough": Array(("outputs", "inputs")),
    "fields": Array(("order", "nodes", 3)),
}
POINTS_ARRAY = {"points": Array(("nodes", "space"), unit="m")}
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
    """Read a linear model from a file of `save_linear`; the system is that of the saved model, linearised alike."""
    path = Path(path)
    with loading(path, LINEAR_MODEL_REMEDY):
        file = open_sealed(path, FORMAT, VERSION)
        header, expected = file.header, _header(system)
        if header.keys() != {*expected, "kind", "report"} or not isinstance(header["report"], dict):
            raise InputError("the header is not that of a linear model")
        if not isinstance(header["kind"], str) or header["kind"] not in CLASS_BY_ORDER:
            raise InputError(f"kind must be one of {', '.join(CLASS_BY_ORDER)}, got {header['kind']!r:.60}")
        form = CLASS_BY_ORDER[header["kind"]]
        declared = {each.name: LINEAR_ARRAYS[each.name] for each in fields(form)}
        check_names(file.arrays, declared | POINTS_ARRAY)
        arrays = {name: file.read(name) for name in declared}
        points = file.read("points")
        check_arrays({"points": points}, POINTS_ARRAY, {})
    differ = [name for name in expected if header[name] != expected[name]]
    if differ or points.shape != system.model.cloud.points.shape or not np.allclose(points, system.model.cloud.points):
        raise InputError(f"{path} was made of another linear system: {', '.join(differ) or 'points'} differ")
    with loading(path, LINEAR_MODEL_REMEDY):
        sizes = {"inputs": len(system.inputs), "outputs": len(system.outputs), "nodes": len(points)}
        check_arrays(arrays, declared, sizes)
        if not len(arrays["fields"]):
            raise InputError("array fields must hold at least one field, got none")
        with np.errstate(all="ignore"):
            model = LinearModel(system, form(**arrays), header["report"])
        if not all(np.isfinite(matrix).all() for matrix in (model.A, model.B, model.C, model.D)):
            raise InputError("its state-space matrices are not finite")
        model.state(model.prepare(system.loads))  # raises an error for fields that are not independent
        return model
