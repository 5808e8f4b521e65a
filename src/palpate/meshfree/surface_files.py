"""Surfaces from files: STL, OBJ, PLY, OFF, glTF and VTK, with their units."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from palpate.arrays import Floats, Ints
from palpate.faults import FileFormatError, InputError, brief
from palpate.files import read_bytes, regular_file, shortened
from palpate.meshfree.formats.common import Parts
from palpate.meshfree.formats.gltf import read_glb, read_gltf
from palpate.meshfree.formats.plain import read_obj, read_off, read_stl
from palpate.meshfree.formats.ply import read_ply
from palpate.meshfree.formats.vtk import read_vtk
from palpate.meshfree.formats.vtp import read_vtp
from palpate.meshfree.surface_repair import repair_surface
from palpate.meshfree.surfaces import Surface, weld

__all__ = ["UNITS", "read_surface"]

UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "in": 0.0254}
READERS = {
    "stl": read_stl, "obj": read_obj, "ply": read_ply, "off": read_off, "glb": read_glb, "gltf": read_gltf,
    "vtk": read_vtk, "vtp": read_vtp,
}  # fmt: skip
FORMATS_WITH_PARTS = ("glb", "gltf", "obj", "stl")
MAX_BYTES = 300_000_000
MAX_LISTED_NAMES = 40  # of parts, in a message
OPEN_SHARE = 0.05  # volume of an organ over the cube of its diagonal, for a surface that is open
TYPICAL_VOLUME = 5e-4  # [m^3] of an organ: geometric mean of an adrenal gland and a liver


def read_surface(
    path: str | Path, *, part: str | None = None, units: str | None = None, repair: bool = False
) -> Surface:
    """Read a closed surface.

    Other files that the file names are not read. Polygons are split into fans of triangles.

    Parameters
    ----------
    path : str or path
        An STL, OBJ, PLY, OFF, GLB, glTF, VTK or VTP file.
    part : str, optional
        Name of the part in a file of several.
    units : str, optional
        Unit of length in the file: ``"m"``, ``"cm"``, ``"mm"`` or ``"in"``. A glTF file is in
        metres; other formats do not state a unit. By default it is the unit for which the volume is
        nearest to that of an organ, with a warning.
    repair : bool
        Whether to repair the surface, see `palpate.meshfree.surface_repair.repair_surface`.

    Raises
    ------
    FileNotFoundError
        The file does not exist.
    FileFormatError
        The file is not regular, of another format, damaged, over 300 MB, or without triangles.
    InputError
        The file has several parts and `part` is not given, or too many triangles, or unknown units.
    """
    path = Path(path)
    if units is not None and units not in UNITS:
        raise InputError(f"units must be one of {', '.join(map(repr, UNITS))}, got {brief(units)}")
    regular_file(path, "surface file")
    kind = path.suffix[1:].lower()
    if kind == "msh":
        raise FileFormatError(
            f"{path} is a Gmsh file{_gmsh_version(path)} of a volume mesh; export its surface as STL, PLY or "
            f"OBJ (in Gmsh: File, Export)"
        )
    if kind not in READERS:
        raise FileFormatError(f"{path}: the format must be one of {', '.join(READERS).upper()}, got {kind!r}")
    if part is not None and kind not in FORMATS_WITH_PARTS:
        raise InputError(f"part must be omitted for {kind.upper()} files, which have no named parts, got {brief(part)}")
    vertices, triangles = _read(path, kind, part)
    surface = Surface(vertices, triangles, path.name if part is None else f"{path.name}, part {part}")
    surface = repair_surface(surface) if repair else weld(surface)
    return _in_metres(surface, "m" if units is None and kind in ("glb", "gltf") else units)


def _gmsh_version(path: Path) -> str:
    with path.open("rb") as file:
        head = file.readline(100).strip()
        if head == b"$NOD":
            return " of version 1"
        version = file.readline(100).split() if head == b"$MeshFormat" else []
    return f" of version {shortened(version[0].decode(errors='replace'), 10)}" if version else ""


def _read(path: Path, kind: str, part: str | None) -> tuple[Floats, Ints]:
    """Return the vertices and triangles of a file, or of a part of it."""
    data = read_bytes(path, "surface file", MAX_BYTES)
    if not data:
        raise FileFormatError(f"{path} must not be empty")
    try:
        parts = READERS[kind](data)
        vertices, triangles = parts[_choose_part(parts, part)]()
    except FileFormatError as error:
        raise FileFormatError(f"{path} cannot be read as {kind.upper()}: {error}") from error
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except (ArithmeticError, LookupError, MemoryError, RecursionError, TypeError, ValueError) as error:
        # errors that no check of a reader has found
        raise FileFormatError(f"{path} is damaged ({type(error).__name__}: {shortened(str(error))})") from error
    if not len(triangles):
        raise FileFormatError(f"{path} must hold triangles, got none")
    return vertices, triangles


def _choose_part(parts: Parts, part: str | None) -> str:
    plain = (shortened(name if name.isprintable() else repr(name)) for name in sorted(parts)[:MAX_LISTED_NAMES])
    names = ", ".join(plain) + ", ..." * (len(parts) > MAX_LISTED_NAMES)
    if part is None:
        if len(parts) > 1:
            raise InputError(f"part must be given for a file of {len(parts)} parts; choose one of {names}")
        if not parts:
            raise FileFormatError("it must hold triangles, got none")
        return next(iter(parts))
    if part not in parts:
        raise InputError(f"part must be one of {names or 'none'}, got {shortened(repr(part))}")
    return part


def _in_metres(surface: Surface, units: str | None) -> Surface:
    warnings = surface.warnings
    if units is None:
        volume = max(abs(surface.volume) if surface.closed else (OPEN_SHARE * surface.size**3), 1e-300)
        away = {name: abs(np.log(volume * scale**3 / TYPICAL_VOLUME)) for name, scale in UNITS.items() if name != "in"}
        units = min(away, key=away.__getitem__)
        guess = (
            f"{surface.name} does not state its units: {units} assumed, for "
            + (
                f"a volume of {1e3 * volume * UNITS[units] ** 3:.3g} litres"
                if surface.closed
                else f"an open surface {1e3 * surface.size * UNITS[units]:.3g} mm long"
            )
            + "; give units= to be sure"
        )
        warnings = (*warnings, guess)
    return Surface(surface.vertices * UNITS[units], surface.triangles, surface.name, warnings)
