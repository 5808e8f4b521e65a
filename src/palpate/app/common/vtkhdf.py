"""VTKHDF files, which ParaView opens."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from palpate.core.arrays import Floats
from palpate.core.faults import InputError
from palpate.core.files import whole_file
from palpate.meshfree.cloud import Cloud

VTK_VERTEX, VTK_TRIANGLE = 1, 5


def write_vtkhdf(path: str | Path, cloud: Cloud, times: Floats, point_fields: Mapping[str, Floats]) -> None:
    """Write nodal fields, (f, n) or (f, n, 3), at times (f,) [s] to a VTKHDF file, whole or not at all.

    The points are the reference positions, the cells the surface triangles and one vertex for every node inside. In
    ParaView (5.12 or newer), *Warp By Vector* with the field ``displacement`` shows the deformed body.

    The layout is version 2.0 of the VTKHDF format for an ``UnstructuredGrid`` with a static mesh, whose ``Steps`` group
    holds the offsets of the points, cells and values of every time:
    https://docs.vtk.org/en/latest/vtk_file_formats/vtkhdf_file_format/index.html
    """
    import h5py

    path, times = Path(path), np.asarray(times, dtype=float)
    fields = {name: _field(name, values, len(times), len(cloud)) for name, values in point_fields.items()}
    with whole_file(path) as partial, h5py.File(partial, "w") as file:
        root = file.create_group("VTKHDF")
        root.attrs["Version"] = (2, 0)
        root.attrs.create("Type", b"UnstructuredGrid", dtype=h5py.string_dtype("ascii", 16))
        _write_mesh(root, cloud)
        values = root.create_group("PointData")
        for name, field in fields.items():
            values.create_dataset(name, data=field.reshape(-1, *field.shape[2:]))
        _write_steps(root, times, len(cloud), list(fields))


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


def _write_mesh(root: Any, cloud: Cloud) -> None:
    """Write the points and cells, which serve every time."""
    n, d = cloud.points.shape
    points = np.zeros((n, 3))
    points[:, :d] = cloud.points
    inside = np.setdiff1d(np.arange(n), cloud.triangles)
    sizes = np.concatenate([np.full(len(cloud.triangles), 3), np.ones(len(inside), dtype=int)])
    connectivity = np.concatenate([cloud.triangles.ravel(), inside])
    root.create_dataset("Points", data=points)
    root.create_dataset("Connectivity", data=connectivity.astype("i8"))
    root.create_dataset("Offsets", data=np.concatenate([[0], np.cumsum(sizes)]).astype("i8"))
    root.create_dataset("Types", data=np.where(sizes == 3, VTK_TRIANGLE, VTK_VERTEX).astype("u1"))
    root.create_dataset("NumberOfPoints", data=np.array([n], dtype="i8"))
    root.create_dataset("NumberOfCells", data=np.array([len(sizes)], dtype="i8"))
    root.create_dataset("NumberOfConnectivityIds", data=np.array([len(connectivity)], dtype="i8"))


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
