"""Surfaces from files: STL, OBJ, PLY, OFF, glTF and VTK, with their units."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from palpate.faults import FileFormatError, InputError
from palpate.meshfree.surface_repair import repair
from palpate.meshfree.surfaces import MOST_TRIANGLES, Surface, welded

__all__ = ["UNITS", "read_surface"]

UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 0.0254}
KINDS = ("stl", "obj", "ply", "off", "glb", "gltf", "vtk", "vtp")
LARGEST = 300_000_000  # bytes
TYPICAL = 5e-4  # [m^3] of an organ, in the logarithm's middle: between an adrenal gland and a liver


def read_surface(path: str | Path, *, part: str | None = None, units: str | None = None, mend: bool = False) -> Surface:
    """Read a closed surface.

    Parameters
    ----------
    path : str or path
        An STL, OBJ, PLY, OFF, GLB, glTF, VTK or VTP file.
    part : str, optional
        Name of the part to take from a file of several.
    units : str, optional
        Of the file's lengths: ``"m"``, ``"cm"``, ``"mm"`` or ``"in"``. A glTF file is in metres; others do not say, and
        without `units` the one is taken in which the volume is most like an organ's, with a warning.
    mend : bool
        Whether to repair what can be: see `palpate.meshfree.surface_repair.repair`.

    Raises
    ------
    FileNotFoundError
        There is no such file.
    FileFormatError
        It is of another kind, damaged, or holds no triangles.
    InputError
        It has several parts and none is chosen, or too many triangles, or unknown units.
    """
    path = Path(path)
    if units is not None and units not in UNITS:
        raise InputError(f"units = {units!r} are unknown: allowed are {', '.join(map(repr, UNITS))}")
    if not path.is_file():
        raise FileNotFoundError(f"there is no file {path}")
    kind = path.suffix[1:].lower()
    if kind == "msh":
        raise FileFormatError(
            f"{path} is a Gmsh file{_gmsh_version(path)}, which holds a volume mesh: export its surface as STL, PLY or "
            f"OBJ (in Gmsh: File, Export)"
        )
    if kind not in KINDS:
        raise FileFormatError(f"{path}: surfaces are read from {', '.join(KINDS).upper()} files, not from {kind!r}")
    _refuse_large(path, kind)
    vertices, triangles = _vtk(path, kind) if kind in ("vtk", "vtp") else _trimesh(path, kind, part)
    if part is not None and kind not in ("glb", "gltf", "obj"):
        raise InputError(f"part = {part!r}: a {kind.upper()} file has no named parts")
    surface = Surface(vertices, triangles, path.name if part is None else f"{path.name}, part {part}")
    surface = repair(surface) if mend else welded(surface)
    return _in_metres(surface, "m" if units is None and kind in ("glb", "gltf") else units)


def _gmsh_version(path: Path) -> str:
    with path.open("rb") as file:
        head = file.readline().strip()
        if head == b"$NOD":
            return " of version 1"
        version = file.readline().split() if head == b"$MeshFormat" else []
    return f" of version {version[0].decode(errors='replace')}" if version else ""


def _refuse_large(path: Path, kind: str) -> None:
    """Refuse a file of too many triangles before it is read."""
    size = path.stat().st_size
    with path.open("rb") as file:
        head = file.read(4096)
    count = 0
    if kind == "stl" and len(head) >= 84 and size == 84 + 50 * struct.unpack("<I", head[80:84])[0]:
        count = struct.unpack("<I", head[80:84])[0]
    elif kind == "ply" and b"element face " in head:
        count = int(head.split(b"element face ")[1].split()[0])
    elif kind == "off":
        words = [word for word in head.split() if word.isdigit()]
        count = int(words[1]) if len(words) > 1 else 0
    if count > MOST_TRIANGLES or size > LARGEST:
        what = f"has {count} triangles; at most {MOST_TRIANGLES} are" if count else f"is {size / 1e6:.0f} MB; 300 are"
        raise InputError(f"{path} {what} taken: decimate it first (30,000 triangles are enough for an organ)")
    if size == 0:
        raise FileFormatError(f"{path} is empty")


def _trimesh(path: Path, kind: str, part: str | None) -> tuple[Any, Any]:
    import trimesh

    try:
        scene = trimesh.load_scene(path, file_type=kind, process=False)
        # in place, as the file's transformations say, by the names of the parts
        placed: dict[str, Any] = {}
        for node in scene.graph.nodes_geometry:
            matrix, name = scene.graph[node]
            mesh = scene.geometry[name]
            if isinstance(mesh, trimesh.Trimesh) and len(mesh.faces):
                placed[str(name)] = mesh.copy().apply_transform(matrix)
    except Exception as error:  # a reader may raise anything on a damaged file
        raise FileFormatError(f"{path} cannot be read as {kind.upper()}: {' '.join(str(error).split())}") from error
    if not placed:
        raise FileFormatError(f"{path} holds no triangles")
    mesh = _chosen(path, placed, part)
    return np.array(mesh.vertices, dtype=float), np.array(mesh.faces, dtype=np.int64)


def _chosen(path: Path, parts: dict[str, Any], part: str | None) -> Any:
    names: Sequence[str] = sorted(parts)
    if part is None:
        if len(parts) > 1:
            raise InputError(f"{path} has {len(parts)} parts: choose one with part=: {', '.join(names)}")
        return next(iter(parts.values()))
    if part not in parts:
        raise InputError(f"{path} has no part {part!r}; it has {', '.join(names)}")
    return parts[part]


def _vtk(path: Path, kind: str) -> tuple[Any, Any]:
    from vtkmodules.util import numpy_support
    from vtkmodules.vtkCommonCore import vtkCommand, vtkObject
    from vtkmodules.vtkFiltersCore import vtkTriangleFilter
    from vtkmodules.vtkIOLegacy import vtkPolyDataReader
    from vtkmodules.vtkIOXML import vtkXMLPolyDataReader

    reader: Any = vtkPolyDataReader() if kind == "vtk" else vtkXMLPolyDataReader()
    array: Any = numpy_support.vtk_to_numpy
    complaints: list[int] = []
    reader.AddObserver(vtkCommand.ErrorEvent, lambda *_: complaints.append(1))
    vtkObject.GlobalWarningDisplayOff()
    try:
        reader.SetFileName(str(path))
        flat = vtkTriangleFilter()
        flat.PassLinesOff()
        flat.PassVertsOff()
        flat.SetInputConnection(reader.GetOutputPort())
        flat.Update()
    finally:
        vtkObject.GlobalWarningDisplayOn()
    data = flat.GetOutput()
    if complaints or data.GetNumberOfPolys() == 0:
        raise FileFormatError(f"{path} is no VTK file of a surface (PolyData with triangles), or is damaged")
    triangles = array(data.GetPolys().GetConnectivityArray()).reshape(-1, 3)
    return array(data.GetPoints().GetData()).astype(float), triangles.astype(np.int64)


def _in_metres(surface: Surface, units: str | None) -> Surface:
    warnings = surface.warnings
    if units is None:
        volume = max(abs(surface.volume), 1e-300)
        away = {name: abs(np.log(volume * scale**3 / TYPICAL)) for name, scale in UNITS.items() if name != "in"}
        units = min(away, key=away.__getitem__)
        guess = (
            f"{surface.name} does not say its units: taken as {units}, which makes "
            f"{1e3 * volume * UNITS[units] ** 3:.3g} litres; say units= to be sure"
        )
        warnings = (*warnings, guess)
    return Surface(surface.vertices * UNITS[units], surface.triangles, surface.name, warnings)
