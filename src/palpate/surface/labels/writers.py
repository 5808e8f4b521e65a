"""Writers of label maps and displacement fields: NIfTI-1 (.nii, .nii.gz) and NRRD (.nrrd, .seg.nrrd)."""

from __future__ import annotations

import gzip
import struct
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np
from numpy.typing import NDArray

from palpate.core.arrays import Floats, Singles
from palpate.core.faults import InputError
from palpate.core.files import whole_file
from palpate.surface.labels.label_map import Segment

VOLUME_SUFFIXES = (".nii", ".nii.gz", ".nrrd")
LPS_TO_RAS = np.diag([-1.0, -1.0, 1.0, 1.0])
METRES_TO_MILLIMETRES = np.diag([1e3, 1e3, 1e3, 1.0])  # of a metre
NIFTI_KINDS = {"<i2": 4, "<i4": 8, "<f4": 16}  # codes of types
NRRD_KINDS = {
    kind: {"type": name, "dimension": "3", "kinds": "domain domain domain"}
    for kind, name in (("<i2", "short"), ("<i4", "int"))
}
DISPLACEMENT_VECTORS, LABELS_INTENT = 1006, 1002  # NIfTI's intents
HEADER_BYTES, MAX_AXIS = 348, 32767
CHUNK_BYTES = 1 << 24


def check_volume_name(path: Path, name: str) -> None:
    """Raise `InputError` unless a path ends in .nii, .nii.gz or .nrrd."""
    if not path.name.lower().endswith(VOLUME_SUFFIXES):
        raise InputError(f"{name} must end in {', '.join(VOLUME_SUFFIXES)}, got {str(path)!r}; choose another name")


def write_labels(path: Path, numbers: NDArray[Any], affine: Floats, names: Mapping[int, str]) -> None:
    """Write a label map of one layer of numbers (nx, ny, nz), with their names.

    `affine` (4, 4) [m] maps indices to the middles of the voxels, in LPS.
    """
    kind = _integers([numbers])
    if path.name.lower().endswith(".nrrd"):
        segments = [Segment(number, name, 0, number, 0) for number, name in names.items()]
        _write_nrrd(path, numbers.astype(kind), affine, _segment_fields(segments) | NRRD_KINDS[kind])
        return
    rows = "".join(f"<Label Key={quoteattr(str(k))}><![CDATA[{_line(v)}]]></Label>" for k, v in names.items())
    table = f"<?xml version='1.0' encoding='UTF-8'?><CaretExtension><VolumeInformation><LabelTable>{rows}"
    table += "</LabelTable></VolumeInformation></CaretExtension>"
    _write_nifti(path, numbers.astype(kind), affine, NIFTI_KINDS[kind], LABELS_INTENT, table.encode())


def write_layers(path: Path, layers: Sequence[NDArray[Any]], affine: Floats, segments: Sequence[Segment]) -> list[str]:
    """Write a label map of one or several layers, and return what the file has lost.

    NRRD has all layers (nx, ny, nz), as 3D Slicer writes them. In NIfTI a voxel has one number: that of the last
    segment there. `affine` (4, 4) [m] maps indices to the middles of the voxels, in LPS.
    """
    used = sorted({each.layer for each in segments})
    layers, segments = [layers[k] for k in used], [replace(each, layer=used.index(each.layer)) for each in segments]
    if len(layers) > 1 and path.name.lower().endswith(".nrrd"):
        kind = _integers(layers)
        values = np.stack([each.astype(kind) for each in layers])
        of_file = [each if each.label is None else replace(each, number=each.label) for each in segments]
        for each, written in zip(segments, of_file, strict=True):
            values[each.layer][layers[each.layer] == each.number] = written.number
        fields = {"dimension": "4", "kinds": "list domain domain domain"}
        _write_nrrd(path, values, affine, _segment_fields(of_file) | NRRD_KINDS[kind] | fields)
        return []
    numbers = np.zeros_like(layers[0])
    for each in segments:
        numbers[layers[each.layer] == each.number] = each.number
    write_labels(path, numbers, affine, {each.number: each.name for each in segments})
    counts = [[np.count_nonzero(layer == each.number) for layer in (layers[each.layer], numbers)] for each in segments]
    return [
        f"{each.name} lost {before - after} of its {before} voxels to labels that overlap it: a name that ends in "
        ".seg.nrrd keeps all"
        for each, (before, after) in zip(segments, counts, strict=True) if after < before
    ]  # fmt: skip


def _integers(layers: Sequence[NDArray[Any]]) -> str:
    """Return the type of numbers of segments in a file."""
    return "<i4" if max(int(each.max(initial=0)) for each in layers) > np.iinfo(np.int16).max else "<i2"


def _segment_fields(segments: Sequence[Segment]) -> dict[str, str]:
    """Return the fields by which 3D Slicer finds segments in a NRRD file."""
    fields = dict[str, str]()
    for k, each in enumerate(segments):
        fields |= {f"Segment{k}_ID:": f"Segment_{each.layer}_{each.number}", f"Segment{k}_Name:": _line(each.name),
                   f"Segment{k}_LabelValue:": str(each.number), f"Segment{k}_Layer:": str(each.layer)}  # fmt: skip
    return fields


def write_field(path: Path, field: Floats | Singles, affine: Floats) -> None:
    """Write displacement vectors (nx, ny, nz, 3) [m], LPS, in millimetres: in RAS in NIfTI, in LPS in NRRD.

    So 3D Slicer and ITK read them as a transform that resamples an image.
    """
    values = (1e3 * field).astype("<f4")
    if path.name.lower().endswith(".nrrd"):
        kinds = {"dimension": "4", "kinds": "vector domain domain domain", "displacement field type:": "resampling"}
        _write_nrrd(path, np.moveaxis(values, 3, 0), affine, {"type": "float", **kinds})
        return
    values[..., :2] *= -1
    _write_nifti(path, values[:, :, :, None, :], affine, NIFTI_KINDS["<f4"], DISPLACEMENT_VECTORS)


def _line(text: str) -> str:
    """Return a name without what would end a line or a section of a header."""
    return " ".join(text.replace("<", "").replace(">", "").split())


def _write_nifti(
    path: Path, values: NDArray[Any], affine: Floats, kind: int, intent: int, extension: bytes = b""
) -> None:
    if max(values.shape) > MAX_AXIS:
        raise InputError(
            f"an image of NIfTI must have at most {MAX_AXIS} voxels an axis, got {max(values.shape)}; use .nrrd"
        )
    rows = (LPS_TO_RAS @ METRES_TO_MILLIMETRES @ affine)[:3]
    edges = np.linalg.norm(rows[:, :3], axis=0)
    extended = bytes(4)
    if extension:
        size = -(-(len(extension) + 8) // 16) * 16
        extended = struct.pack("<4b2i", 1, 0, 0, 0, size, 0) + extension.ljust(size - 8, b"\0")
    start = HEADER_BYTES + len(extended)
    dim = [values.ndim, *values.shape, *[1] * (7 - values.ndim)]
    head = struct.pack("<i35xb", HEADER_BYTES, 0) + struct.pack("<8h", *dim) + struct.pack("<3fh", 0, 0, 0, intent)
    head += struct.pack("<3h", kind, 8 * values.dtype.itemsize, 0)
    head += struct.pack("<8f", 1, *edges, 1, 1, 1, 1) + struct.pack("<3f", start, 1, 0)
    head += struct.pack("<hbB4f2i", 0, 0, 2, 0, 0, 0, 0, 0, 0)  # lengths in millimetres
    head += bytes(80 + 24) + struct.pack("<2h6f", 0, 1, 0, 0, 0, 0, 0, 0)
    head += struct.pack("<12f", *rows.ravel()) + b"palpate".ljust(16, b"\0") + b"n+1\0"
    _write(path, head + extended, values, path.name.lower().endswith(".gz"))


def _write_nrrd(path: Path, values: NDArray[Any], affine: Floats, fields: Mapping[str, str]) -> None:
    rows = METRES_TO_MILLIMETRES @ affine
    axes = [f"({','.join(f'{x:.9g}' for x in rows[:3, k])})" for k in range(3)]
    vectors = " ".join(["none"] * (values.ndim - 3) + axes)
    lines = {
        **fields, "space": "left-posterior-superior", "sizes": " ".join(map(str, values.shape)),
        "space directions": vectors, "space origin": f"({','.join(f'{x:.9g}' for x in rows[:3, 3])})",
        "endian": "little", "encoding": "gzip",
    }  # fmt: skip
    order = sorted(lines, key=lambda name: name.endswith(":"))  # key and value pairs after the fields
    text = "NRRD0005\n" + "".join(f"{name}{'=' if name.endswith(':') else ': '}{lines[name]}\n" for name in order)
    _write(path, text.encode() + b"\n", values, packed=True, plain=len(text.encode()) + 1)


def _write(path: Path, head: bytes, values: NDArray[Any], packed: bool, plain: int = 0) -> None:
    """Write a header and the voxels, the first axis fastest; packed but for the first `plain` bytes."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(path) as partial, partial.open("wb") as file:
        file.write(head[:plain])
        into: Any = gzip.GzipFile("", "wb", 6, file, mtime=0) if packed else file
        into.write(head[plain:])
        for part in values.transpose():  # without a second array of all voxels
            into.write(np.ascontiguousarray(part).tobytes())
        if packed:
            into.close()
