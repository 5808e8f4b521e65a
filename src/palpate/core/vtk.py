"""Meshes for VTK: files that ParaView opens, and meshes of pyvista.

A mesh has the nodes of a body in their reference positions, the triangles of its surface, and one vertex for every node
inside. Its point data are in SI units: ``displacement`` [m], ``velocity`` [m/s], ``stress`` and ``pressure`` [Pa].
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from palpate.core.arrays import Floats, Ints
from palpate.core.extras import require
from palpate.core.faults import InputError
from palpate.core.files import whole_file

VTK_VERTEX, VTK_TRIANGLE = 1, 5


def write_vtkhdf(
    path: str | Path, points: Floats, triangles: Ints, times: Floats, point_fields: Mapping[str, Floats]
) -> None:
    """Write nodal fields, (f, n) or (f, n, 3), at times (f,) [s] to a VTKHDF file, whole or not at all.

    The points are (n, d) [m], the triangles of the surface (t, 3). In ParaView (5.12 or newer), *Warp By Vector* with
    the field ``displacement`` shows the deformed body.

    The layout is version 2.0 of the VTKHDF format for an ``UnstructuredGrid`` with a static mesh, whose ``Steps`` group
    holds the offsets of the points, cells and values of every time:
    https://docs.vtk.org/en/latest/vtk_file_formats/vtkhdf_file_format/index.html
    """
    import h5py

    path, times = Path(path), np.asarray(times, dtype=float)
    fields = {name: _field(name, values, len(times), len(points)) for name, values in point_fields.items()}
    with whole_file(path) as partial, h5py.File(partial, "w") as file:
        root = file.create_group("VTKHDF")
        root.attrs["Version"] = (2, 0)
        root.attrs.create("Type", b"UnstructuredGrid", dtype=h5py.string_dtype("ascii", 16))
        _write_mesh(root, points, triangles)
        values = root.create_group("PointData")
        for name, field in fields.items():
            values.create_dataset(name, data=field.reshape(-1, *field.shape[2:]))
        _write_steps(root, times, len(points), list(fields))


def _field(name: str, values: Floats, frames: int, nodes: int) -> Floats:
    array = np.asarray(values, dtype=float)
    if array.shape not in ((frames, nodes), (frames, nodes, 3)):
        shapes = f"{(frames, nodes)} or {(frames, nodes, 3)}"
        raise InputError(
            f"field {name!r} must have shape {shapes}, got {array.shape}; give a value at every node and time"
        )
    if not np.isfinite(array).all():
        count = int(np.sum(~np.isfinite(array)))
        raise InputError(f"field {name!r} must be finite, got {count} other numbers; leave the field out")
    return array


def pyvista_grid(points: Floats, triangles: Ints, point_fields: Mapping[str, Floats]) -> Any:
    """Return a `pyvista.UnstructuredGrid` of points (n, d) [m], triangles (t, 3) and nodal fields, (n,) or (n, 3)."""
    require("pyvista", "a mesh of pyvista")
    import pyvista

    corners, ends, types = _cells(len(points), triangles)
    sizes = np.diff(ends)
    grid = pyvista.UnstructuredGrid(np.insert(corners, ends[:-1], sizes), types, _in_space(points))
    for name, values in point_fields.items():
        grid.point_data[name] = values
    return grid


def _in_space(points: Floats) -> Floats:
    return np.pad(np.asarray(points, dtype=float), ((0, 0), (0, 3 - points.shape[1])))


def _cells(nodes: int, triangles: Ints) -> tuple[Ints, Ints, Ints]:
    """Return the nodes of all cells in a row, where each begins and the last ends, and their types."""
    inside = np.setdiff1d(np.arange(nodes), triangles)
    sizes = np.concatenate([np.full(len(triangles), 3), np.ones(len(inside), dtype=int)])
    corners = np.concatenate([np.asarray(triangles, dtype=int).ravel(), inside])
    ends = np.concatenate([[0], np.cumsum(sizes)])
    return corners, ends, np.where(sizes == 3, VTK_TRIANGLE, VTK_VERTEX)


def _write_mesh(root: Any, points: Floats, triangles: Ints) -> None:
    """Write the points and cells, which serve every time."""
    corners, ends, types = _cells(len(points), triangles)
    root.create_dataset("Points", data=_in_space(points))
    root.create_dataset("Connectivity", data=corners.astype("i8"))
    root.create_dataset("Offsets", data=ends.astype("i8"))
    root.create_dataset("Types", data=types.astype("u1"))
    root.create_dataset("NumberOfPoints", data=np.array([len(points)], dtype="i8"))
    root.create_dataset("NumberOfCells", data=np.array([len(types)], dtype="i8"))
    root.create_dataset("NumberOfConnectivityIds", data=np.array([len(corners)], dtype="i8"))


def _write_steps(root: Any, times: Floats, nodes: int, names: list[str]) -> None:
    """Write the offsets of mesh and values of every time; all times share one mesh."""
    frames = len(times)
    steps = root.create_group("Steps")
    steps.attrs["NSteps"] = frames
    steps.create_dataset("Values", data=times)
    steps.create_dataset("NumberOfParts", data=np.ones(frames, dtype="i8"))
    for name in ("PartOffsets", "PointOffsets"):
        steps.create_dataset(name, data=np.zeros(frames, dtype="i8"))
    for name in ("CellOffsets", "ConnectivityIdOffsets"):
        steps.create_dataset(name, data=np.zeros((frames, 1), dtype="i8"))
    offsets = steps.create_group("PointDataOffsets")
    for name in names:
        offsets.create_dataset(name, data=nodes * np.arange(frames, dtype="i8"))
