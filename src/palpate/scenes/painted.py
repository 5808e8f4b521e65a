"""Painted meshes: points with labels or weights, from what modelling programs write.

VTK's readers crash on damaged files, and wait or take all memory on others. So a process of its own, with limits of
time and memory, reads the file and returns arrays.
"""

from __future__ import annotations

import contextlib
import io
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from palpate.core.arrays import Floats
from palpate.core.extras import require
from palpate.core.faults import FileFormatError, InputError
from palpate.core.files import regular_file, shortened

MESH_SUFFIXES = (".ply", ".vtk", ".vtp", ".vtu")
MAX_FILE_BYTES = 300_000_000  # bytes of a file
READER_BYTES, READER_SECONDS = 400 << 20, 30  # of the reader, with which it begins; more for larger files
BYTES_PER_FILE_BYTE, FILE_BYTES_PER_SECOND = 20, 1_000_000  # of memory, and bytes a second


def read_painted(path: str | Path, name: str | None = None) -> tuple[Floats, Floats]:
    r"""Read a mesh's vertices and a scalar field on them.

    Parameters
    ----------
    path : path
        A PLY file or one of VTK's (.vtk, .vtp, .vtu), lengths in metres.
    name : str, optional
        Of the field on its points; by default the only one.

    Returns
    -------
    points, values : (k, 3) array [m], (k,) array
        As `palpate.painted` takes them.

    Raises
    ------
    FileNotFoundError
        There is no such file.
    FileFormatError
        The file is of another kind, damaged, or its numbers are not finite.
    InputError
        It has no such field, or one that is not a scalar; or PyVista is not installed.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import palpate as pt
    >>> path = Path(tempfile.mkdtemp()) / "painted.vtk"
    >>> head = "# vtk DataFile Version 3.0\npainted\nASCII\nDATASET POLYDATA\n"
    >>> mesh = "POINTS 3 float\n0 0 0\n0.1 0 0\n0 0.1 0\nPOLYGONS 1 4\n3 0 1 2\n"
    >>> field = "POINT_DATA 3\nSCALARS weight float 1\nLOOKUP_TABLE default\n1 0 0.5\n"
    >>> _ = path.write_text(head + mesh + field)
    >>> points, values = pt.io.read_painted(path)
    >>> values.tolist()
    [1.0, 0.0, 0.5]
    """
    path = Path(path)
    size = regular_file(path, "painted mesh", MAX_FILE_BYTES)
    if path.suffix.lower() not in MESH_SUFFIXES:
        raise FileFormatError(f"{path}: a painted mesh is one of {', '.join(MESH_SUFFIXES)}")
    require("pyvista", "reading a painted mesh")
    command = [sys.executable, "-P", "-m", "palpate.scenes.painted", str(path.absolute()), name or "", str(size)]
    try:
        done = subprocess.run(
            command, capture_output=True, timeout=4 * (READER_SECONDS + size / FILE_BYTES_PER_SECOND), check=False
        )
    except subprocess.TimeoutExpired:
        raise FileFormatError(f"{path} cannot be read in reasonable time; save the mesh again") from None
    arrays = _arrays(done.stdout)
    if done.returncode or len(arrays) != 2:
        raise FileFormatError(f"{path} is damaged, or is not a {path.suffix} file; save the mesh again")
    points, fields = arrays
    if points.ndim != 2 or points.shape[1] != 3 or not len(points):
        raise FileFormatError(f"{path} holds no points, or is not a {path.suffix} file")
    if fields.dtype.kind == "U":  # there is no such field: the names of those there are
        names = ", ".join(shortened(repr(str(each))) for each in fields) or "none"
        if name is None:
            raise InputError(f"{path} must have one field on its points, got {names}; name one of them")
        raise InputError(f"{path} has no field {name!r} on its points, but {names}")
    if fields.shape != (len(points),):
        raise InputError(f"{path}: the field {name!r} is not a scalar; its shape is {fields.shape}")
    if not np.isfinite(points).all() or not np.isfinite(fields).all():
        raise FileFormatError(f"{path} holds points or values that are not finite; save the mesh again")
    return points, fields


def _arrays(content: bytes) -> list[Any]:
    """Return the arrays that the reader wrote."""
    arrays, stream = [], io.BytesIO(content)
    with contextlib.suppress(ValueError, EOFError, OSError):
        while stream.tell() < len(content):
            arrays.append(np.load(stream, allow_pickle=False))
    return arrays


def _main(path: str, name: str, size: str) -> None:
    """Read a file within limits, and write points and values, or the names of all fields, to standard output."""
    import pyvista

    if os.name == "posix":
        import resource

        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize() if _has_statm() else 0
        memory = used + READER_BYTES + BYTES_PER_FILE_BYTE * int(size)
        resource.setrlimit(resource.RLIMIT_AS if used else resource.RLIMIT_DATA, (memory, memory))
        resource.setrlimit(resource.RLIMIT_CPU, (READER_SECONDS + int(size) // FILE_BYTES_PER_SECOND,) * 2)
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    out = os.fdopen(os.dup(1), "wb")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # VTK writes to standard output
    mesh: Any = pyvista.read(path)
    fields = mesh.point_data
    name = name or (fields.keys()[0] if len(fields) == 1 else "")
    values = np.asarray(fields[name], dtype=float) if name in fields else np.array([*fields], dtype=str)
    for array in (np.asarray(mesh.points, dtype=float), values):
        stream = io.BytesIO()
        np.save(stream, array)
        out.write(stream.getvalue())
    out.flush()


def _has_statm() -> bool:
    return Path("/proc/self/statm").exists()


if __name__ == "__main__":
    _main(*sys.argv[1:])
