"""Surfaces from files: STL, OBJ, PLY, OFF, glTF and VTK, with their units."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from palpate.faults import FileFormatError, InputError
from palpate.files import read_bytes, regular_file, shortened
from palpate.meshfree.formats.common import Floats, Ints, Parts
from palpate.meshfree.formats.gltf import read_glb, read_gltf
from palpate.meshfree.formats.plain import read_obj, read_off, read_stl
from palpate.meshfree.formats.ply import read_ply
from palpate.meshfree.formats.vtk import read_vtk
from palpate.meshfree.formats.vtp import read_vtp
from palpate.meshfree.surface_repair import repair
from palpate.meshfree.surfaces import Surface, welded

__all__ = ["UNITS", "read_surface"]

UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 0.0254}
READERS = {
    "stl": read_stl, "obj": read_obj, "ply": read_ply, "off": read_off, "glb": read_glb, "gltf": read_gltf,
    "vtk": read_vtk, "vtp": read_vtp,
}  # fmt: skip
NAMED = ("glb", "gltf", "obj", "stl")  # kinds whose parts have names
LARGEST = 300_000_000  # bytes
MOST_NAMES = 40  # of parts, in a message
TYPICAL = 5e-4  # [m^3] of an organ, in the logarithm's middle: between an adrenal gland and a liver


def read_surface(path: str | Path, *, part: str | None = None, units: str | None = None, mend: bool = False) -> Surface:
    """Read a closed surface.

    Only the file itself is read, never another one that it names; polygons are split into fans of triangles.

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
        It is not a regular file, of another kind, damaged, over 300 MB, or holds no triangles.
    InputError
        It has several parts and none is chosen, or too many triangles, or unknown units.
    """
    path = Path(path)
    if units is not None and units not in UNITS:
        raise InputError(f"units = {units!r} are unknown: allowed are {', '.join(map(repr, UNITS))}")
    regular_file(path, "surface file")
    kind = path.suffix[1:].lower()
    if kind == "msh":
        raise FileFormatError(
            f"{path} is a Gmsh file{_gmsh_version(path)}, which holds a volume mesh: export its surface as STL, PLY or "
            f"OBJ (in Gmsh: File, Export)"
        )
    if kind not in READERS:
        raise FileFormatError(f"{path}: surfaces are read from {', '.join(READERS).upper()} files, not from {kind!r}")
    if part is not None and kind not in NAMED:
        raise InputError(f"part = {part!r}: a {kind.upper()} file has no named parts")
    vertices, triangles = _read(path, kind, part)
    surface = Surface(vertices, triangles, path.name if part is None else f"{path.name}, part {part}")
    surface = repair(surface) if mend else welded(surface)
    return _in_metres(surface, "m" if units is None and kind in ("glb", "gltf") else units)


def _gmsh_version(path: Path) -> str:
    with path.open("rb") as file:
        head = file.readline(100).strip()
        if head == b"$NOD":
            return " of version 1"
        version = file.readline(100).split() if head == b"$MeshFormat" else []
    return f" of version {shortened(version[0].decode(errors='replace'), 10)}" if version else ""


def _read(path: Path, kind: str, part: str | None) -> tuple[Floats, Ints]:
    """Vertices and triangles of a file, or of a part of it."""
    data = read_bytes(path, "surface file", LARGEST)
    if not data:
        raise FileFormatError(f"{path} is empty")
    try:
        parts = READERS[kind](data)
        vertices, triangles = parts[_chosen(parts, part)]()
    except FileFormatError as error:
        raise FileFormatError(f"{path} cannot be read as {kind.upper()}: {error}") from error
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except (ArithmeticError, LookupError, MemoryError, RecursionError, TypeError, ValueError) as error:
        # what no check of a reader has caught
        raise FileFormatError(f"{path} is damaged ({type(error).__name__}: {shortened(str(error))})") from error
    if not len(triangles):
        raise FileFormatError(f"{path} holds no triangles")
    return vertices, triangles


def _chosen(parts: Parts, part: str | None) -> str:
    plain = (shortened(name if name.isprintable() else repr(name)) for name in sorted(parts)[:MOST_NAMES])
    names = ", ".join(plain) + ", ..." * (len(parts) > MOST_NAMES)
    if part is None:
        if len(parts) > 1:
            raise InputError(f"it has {len(parts)} parts: choose one with part=: {names}")
        if not parts:
            raise FileFormatError("it holds no triangles")
        return next(iter(parts))
    if part not in parts:
        raise InputError(f"it has no part {shortened(repr(part))}; it has {names or 'none'}")
    return part


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
