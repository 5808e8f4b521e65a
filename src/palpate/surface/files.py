"""Surfaces from files of the formats in `palpate.surface.formats.names`, with their parts and units."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from palpate.core.faults import FileFormatError, InputError, brief, number_in_range
from palpate.core.files import read_bytes, regular_file, shortened, unpack_gzip
from palpate.surface.checks import METRES_BY_UNIT, guessed_units, scale_problems
from palpate.surface.formats.common import Parts, triangle_count_error
from palpate.surface.formats.first_bytes import refuse_misnamed
from palpate.surface.formats.gltf import read_glb, read_gltf
from palpate.surface.formats.names import (
    FORMATS_WITH_PARTS,
    LABEL_FORMATS,
    SURFACE_FORMATS,
    VOLUME_FORMATS,
    format_of,
)
from palpate.surface.formats.plain import read_obj, read_off, read_stl, read_trian
from palpate.surface.formats.ply import read_ply
from palpate.surface.formats.vtk import read_vtk
from palpate.surface.formats.vtp import read_vtp, space_of_vtp
from palpate.surface.labels.label_map import LabelMap
from palpate.surface.labels.listing import choice_of_labels
from palpate.surface.labels.mask_surface import label_surface
from palpate.surface.labels.reading import read_label_map
from palpate.surface.parts import MAX_PARTS, choose_body, join_parts, matching_parts, names_text
from palpate.surface.repair import repair_surface
from palpate.surface.surface import MAX_TRIANGLES, Surface, scaled, weld

__all__ = ["METRES_BY_UNIT", "read_surface"]

READER_BY_FORMAT = {
    "stl": read_stl, "obj": read_obj, "ply": read_ply, "off": read_off, "glb": read_glb, "gltf": read_gltf,
    "vtk": read_vtk, "vtp": read_vtp, "trian": read_trian,
}  # fmt: skip
HEADER_BYTES = 4096  # of a file, in which it states its frame
SPACE_PATTERN = re.compile(rb"SPACE=(LPS|RAS)\b")
MAX_BYTES = 300_000_000  # of a file, packed or not


def read_surface(
    path: str | Path,
    *,
    part: str | Sequence[str] | None = None,
    units: str | None = None,
    scale: float = 1.0,
    repair: bool = False,
    labels: str | Path | None = None,
) -> Surface:
    r"""Read a closed surface, or make that of an organ in a label map.

    Other files that the file names are not read. Polygons are split into fans of triangles.

    Parameters
    ----------
    path : str or path
        An STL, OBJ, PLY, OFF, GLB, glTF, VTK, VTP or trian file, or one of them compressed by gzip:
        ``"organ.stl.gz"``. Or a label map: NIfTI, NRRD, MHA, MHD or DICOM SEG.
    part : str or sequence of str, optional
        Names of parts in a file of several, or shell-style patterns. Several parts become one
        surface, joined where their borders coincide; a closed part inside another is a cavity. By
        default the largest closed body, if it is around all others, with a warning. Of a label map
        names or numbers of labels, whose voxels are united; ``"liver#2"`` is the second largest
        piece. By default its only label.
    units : str, optional
        Unit of length in the file: ``"m"``, ``"cm"``, ``"mm"`` or ``"in"``. A glTF file is in
        metres, and a label map states its unit; other formats do not. By default it is the unit for
        which the volume is nearest to that of an organ, with a warning.
    scale : float
        Factor of all lengths.
    repair : bool
        Whether to repair the surface, see `palpate.surface.repair.repair_surface`; that of a label map
        needs none.
    labels : str or path, optional
        File of names that a label map lacks: JSON, a color table of 3D Slicer, or lines of a number
        and a name.

    Returns
    -------
    Surface

    Raises
    ------
    FileNotFoundError
        The file does not exist.
    FileFormatError
        The file is not regular, of another format, damaged, over 300 MB, or without triangles.
    InputError
        The file has several bodies and `part` is not given, or too many triangles, or unknown units.
    ChoiceError
        A label map has several labels and `part` is not given; with a table of them.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> import palpate as pt
    >>> path = Path(tempfile.mkdtemp()) / "tetrahedron.off"
    >>> points = "0 0 0\n60 0 0\n0 60 0\n0 0 60\n"
    >>> faces = "3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n"
    >>> _ = path.write_text("OFF\n4 4 0\n" + points + faces)
    >>> surface = pt.io.read_surface(path, units="mm")
    >>> round(surface.volume, 9)
    3.6e-05
    """
    path = Path(path)
    if units is not None and units not in METRES_BY_UNIT:
        raise InputError(f"units must be one of {', '.join(map(repr, METRES_BY_UNIT))}, got {brief(units)}")
    scale = number_in_range("scale", scale, 1e-6, 1e6, open_low=True)
    refuse_misnamed(path)
    regular_file(path, "surface file")
    kind, packed = format_of(path)
    if kind in LABEL_FORMATS:
        if units is not None:
            raise InputError(
                f"units must be omitted for label maps, which state theirs, got {brief(units)}; correct it by scale"
            )
        return surface_of_labels(read_label_map(path, labels).scaled(scale), part)
    if labels is not None:
        raise InputError(f"labels must be omitted for {kind.upper()} files, got {brief(str(labels))}")
    refuse_other_format(path)
    if part is not None and kind not in FORMATS_WITH_PARTS:
        raise InputError(f"part must be omitted for {kind.upper()} files, which have no named parts, got {brief(part)}")
    units = "m" if units is None and kind in ("glb", "gltf") else units
    return scaled(_in_metres(_read(path, kind, packed, part, repair, units), units), scale)


def refuse_other_format(path: Path) -> None:
    """Raise `FileFormatError` for a file that is not of a format of surfaces or label maps."""
    kind, _ = format_of(path)
    if kind == "msh":
        raise FileFormatError(
            f"{path} is a Gmsh file{_gmsh_version(path)} of a volume mesh; export its surface as STL, PLY or "
            f"OBJ (in Gmsh: File, Export)"
        )
    if kind in VOLUME_FORMATS:
        raise FileFormatError(
            f"{path} is {VOLUME_FORMATS[kind]}, a volume mesh; export its surface as STL, PLY or VTP (in ParaView: "
            f"Filters, Extract Surface, then File, Save Data)"
        )
    if kind not in (*SURFACE_FORMATS, *LABEL_FORMATS):
        formats = ", ".join([*SURFACE_FORMATS, *LABEL_FORMATS]).upper()
        raise FileFormatError(f"{path}: the format must be one of {formats}, got {kind!r}")


def surface_of_labels(labels: LabelMap, part: str | Sequence[str] | None = None) -> Surface:
    """Return the surface of parts of a label map, with its notes as warnings; see `read_surface`."""
    if part is None and len(labels.segments) > 1:
        raise choice_of_labels(labels)
    notes = tuple(f"{labels.name}: {note}" for note in labels.notes)
    try:
        surface = label_surface(labels, part)
    except InputError as error:
        raise type(error)("; ".join([str(error), *notes])) from error
    scale = tuple(f"{surface.name}: {problem.what}" for problem in scale_problems(surface))
    return replace(surface, warnings=(*notes, *surface.warnings, *scale))


def _gmsh_version(path: Path) -> str:
    with path.open("rb") as file:
        head = file.readline(100).strip()
        if head == b"$NOD":
            return " of version 1"
        version = file.readline(100).split() if head == b"$MeshFormat" else []
    return f" of version {shortened(version[0].decode(errors='replace'), 10)}" if version else ""


def _read(
    path: Path, kind: str, packed: bool, part: str | Sequence[str] | None, repair: bool, units: str | None
) -> Surface:
    """Return the welded or repaired surface of a file, or of parts of it."""
    finish = repair_surface if repair else weld
    data = read_bytes(path, "surface file", MAX_BYTES)
    if packed:
        data = unpack_gzip(data, path, MAX_BYTES)
    if not data:
        raise FileFormatError(f"{path} must not be empty")
    try:
        parts = READER_BY_FORMAT[kind](data)
        if not parts:
            raise FileFormatError("it must hold triangles, got none")
        names = list(parts) if part is None else matching_parts(list(parts), part)
        surfaces = _surfaces(parts, names, path.name)
        space = space_of_vtp(data) if kind == "vtp" else _stated_space(data)
    except FileFormatError as error:
        raise FileFormatError(f"{path} cannot be read as {kind.upper()}: {error}") from error
    except InputError as error:
        raise InputError(f"{path}: {error}") from error
    except (ArithmeticError, LookupError, MemoryError, RecursionError, TypeError, ValueError) as error:
        # errors that no check of a reader has found
        raise FileFormatError(f"{path} is damaged ({type(error).__name__}: {shortened(str(error))})") from error
    if not surfaces:
        raise FileFormatError(f"{path} must hold triangles, got none")
    if part is None and len(surfaces) > 1:
        body = choose_body(surfaces, path.name, finish, units)
    else:
        whole_name = path.name if part is None else f"{path.name}, part {names_text(names, 3)}"
        body = finish(join_parts(surfaces, whole_name))
    return replace(body, space=space)


def _stated_space(data: bytes) -> str:
    """Return the frame that 3D Slicer writes into headers and comments; empty for other files."""
    stated = SPACE_PATTERN.search(data[:HEADER_BYTES])
    return stated.group(1).decode() if stated else ""


def _surfaces(parts: Parts, names: Sequence[str], file: str) -> dict[str, Surface]:
    """Return the surfaces of parts, of several ones without unused vertices."""
    if len(names) > MAX_PARTS:
        raise InputError(
            f"part must be given for a file of {len(parts)} parts, at most {MAX_PARTS} of them; choose one of "
            f"{names_text(sorted(parts))}"
        )
    surfaces, total = dict[str, Surface](), 0
    for name in names:
        vertices, triangles = parts[name]()
        total += len(triangles)
        if total > MAX_TRIANGLES:
            raise triangle_count_error(total)
        if len(names) > 1 and len(triangles):
            if triangles.min() < 0 or triangles.max() >= len(vertices):
                raise InputError(f"triangles must hold vertices in [0, {len(vertices) - 1}], got others")
            used, triangles = np.unique(triangles, return_inverse=True)
            vertices, triangles = vertices[used], triangles.reshape(-1, 3)
        if len(triangles):
            surfaces[name] = Surface(vertices, triangles, file if len(parts) == 1 else f"{file}, part {name}")
    return surfaces


def _in_metres(surface: Surface, units: str | None) -> Surface:
    warnings = surface.warnings
    if units is None:
        units = guessed_units(surface)
        guess = (
            f"{surface.name} does not state its units: {units} assumed, for "
            + (
                f"a volume of {1e3 * abs(surface.volume) * METRES_BY_UNIT[units] ** 3:.3g} litres"
                if surface.closed
                else f"an open surface {1e3 * surface.size * METRES_BY_UNIT[units]:.3g} mm long"
            )
            + "; give units= to be sure"
        )
        warnings = (*warnings, guess)
    return replace(scaled(surface, METRES_BY_UNIT[units]), warnings=warnings)
