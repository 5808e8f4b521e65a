"""Formats of surface files, declared once: readers, help and documentation follow this table."""

from __future__ import annotations

from pathlib import PurePath

SURFACE_FORMATS = {
    "stl": "STL", "obj": "OBJ", "ply": "PLY", "off": "OFF", "glb": "GLB", "gltf": "glTF", "vtk": "VTK", "vtp": "VTP",
    "trian": "trian",
}  # fmt: skip
VOLUME_FORMATS = {  # which are refused
    "vtu": "a VTK unstructured grid", "pvtu": "a parallel VTK unstructured grid", "inp": "an Abaqus input file",
    "mesh": "a Medit mesh", "e": "an Exodus mesh", "exo": "an Exodus mesh", "feb": "a FEBio model",
}  # fmt: skip
LABEL_FORMATS = {"nii": "NIfTI", "nrrd": "NRRD", "mha": "MHA", "mhd": "MHD", "dcm": "DICOM SEG"}  # segmentations
FORMATS_WITH_PARTS = ("glb", "gltf", "obj", "stl")
GZIP_SUFFIX = "gz"  # suffix after that of the format


def format_of(path: PurePath) -> tuple[str, bool]:
    """Return the format of a name by its suffix, in lower case, and whether the file is compressed by gzip."""
    packed = path.suffix.lower() == f".{GZIP_SUFFIX}"
    return (PurePath(path.stem) if packed else path).suffix[1:].lower(), packed


def listed_formats() -> str:
    """Return the names of all formats for a sentence."""
    *names, last = (*SURFACE_FORMATS.values(), *LABEL_FORMATS.values())
    return f"{', '.join(names)} or {last}"
