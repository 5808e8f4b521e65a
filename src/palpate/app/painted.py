"""Painted meshes: points with labels or weights, from what modelling programs write."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.faults import FileFormatError, InputError

__all__ = ["read_painted"]

Floats = NDArray[np.float64]
FORMATS = (".ply", ".vtk", ".vtp", ".vtu")


def read_painted(path: str | Path, name: str) -> tuple[Floats, Floats]:
    """Read a mesh's vertices and a scalar field on them.

    Parameters
    ----------
    path : path
        A PLY file or one of VTK's (.vtk, .vtp, .vtu), lengths in metres.
    name : str
        Of the field on its points.

    Returns
    -------
    points, values : (k, 3) array [m], (k,) array
        As `palpate.painted` takes them.

    Raises
    ------
    FileNotFoundError
        There is no such file.
    FileFormatError
        The file is of another kind, or cannot be read as what it says to be.
    InputError
        It has no such field, or one that is no scalar.
    """
    import pyvista

    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no painted mesh at {path}")
    if path.suffix.lower() not in FORMATS:
        raise FileFormatError(f"{path}: a painted mesh is one of {', '.join(FORMATS)}")
    mesh: Any = pyvista.read(path)
    if not mesh.n_points:
        raise FileFormatError(f"{path} holds no points, or is no {path.suffix} file")
    fields = mesh.point_data
    if name not in fields:
        raise InputError(f"{path} has no field {name!r} on its points, but {', '.join(map(repr, fields)) or 'none'}")
    values = np.asarray(fields[name], dtype=float)
    if values.ndim != 1:
        raise InputError(f"{path}: the field {name!r} is no scalar; its shape is {values.shape}")
    return np.asarray(mesh.points, dtype=float), values
