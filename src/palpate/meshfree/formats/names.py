"""Formats of surface files, declared once: readers, help and documentation follow this table."""

from __future__ import annotations

from pathlib import PurePath

__all__ = ["FORMATS", "FORMATS_WITH_PARTS", "GZIP", "format_of", "listed_formats"]

FORMATS = {
    "stl": "STL", "obj": "OBJ", "ply": "PLY", "off": "OFF", "glb": "GLB", "gltf": "glTF", "vtk": "VTK", "vtp": "VTP",
    "trian": "trian",
}  # fmt: skip
FORMATS_WITH_PARTS = ("glb", "gltf", "obj", "stl")
GZIP = "gz"  # suffix after that of the format


def format_of(path: PurePath) -> tuple[str, bool]:
    """Return the format of a name by its suffix, in lower case, and whether the file is compressed by gzip."""
    packed = path.suffix.lower() == f".{GZIP}"
    return (PurePath(path.stem) if packed else path).suffix[1:].lower(), packed


def listed_formats() -> str:
    """Return the names of all formats for a sentence."""
    *names, last = FORMATS.values()
    return f"{', '.join(names)} or {last}"
