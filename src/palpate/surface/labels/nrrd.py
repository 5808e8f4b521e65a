"""NRRD images of labels (https://teem.sourceforge.net/nrrd), and those of 3D Slicer with names and layers."""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.arrays import Floats
from palpate.faults import FileFormatError
from palpate.surface.formats.common import printable_word
from palpate.surface.labels.label_map import RAS_TO_LPS, LabelMap, in_metres
from palpate.surface.labels.voxels import Unpacker, checked_shape, label_values, numbers_of, segments_of

NUMPY_TYPES = {
    "i1": ("signed char", "int8", "int8_t"), "u1": ("uchar", "unsigned char", "uint8", "uint8_t"),
    "i2": ("short", "short int", "signed short", "signed short int", "int16", "int16_t"),
    "u2": ("ushort", "unsigned short", "unsigned short int", "uint16", "uint16_t"),
    "i4": ("int", "signed int", "int32", "int32_t"), "u4": ("uint", "unsigned int", "uint32", "uint32_t"),
    "i8": ("longlong", "long long", "long long int", "signed long long", "signed long long int", "int64", "int64_t"),
    "u8": ("ulonglong", "unsigned long long", "unsigned long long int", "uint64", "uint64_t"),
    "f4": ("float",), "f8": ("double",),
}  # fmt: skip
SIGNS_BY_SPACE = {  # of the axes of a frame, from which LPS comes
    "left-posterior-superior": (1, 1, 1), "lps": (1, 1, 1), "right-anterior-superior": (-1, -1, 1),
    "ras": (-1, -1, 1), "left-anterior-superior": (1, -1, 1), "las": (1, -1, 1),
}  # fmt: skip
METRES_BY_UNIT = {"mm": 1e-3, "cm": 1e-2, "m": 1.0, "um": 1e-6, "micron": 1e-6, "µm": 1e-6}
MAX_HEADER = 1 << 22  # bytes
MAX_SEGMENTS = 10_000
COLOUR_KINDS = ("rgb-color", "rgba-color", "vector", "covariant-vector", "3-color", "4-color", "3-vector", "complex")
SEGMENT_PATTERN = re.compile(r"Segment(\d{1,5})_(Name|Layer|LabelValue)")


def read_nrrd(data: bytes, name: str = "image.nrrd") -> LabelMap:
    """Return the label map of an NRRD file."""
    fields, keys, begin = _header(data)
    kind = next((short for short, words in NUMPY_TYPES.items() if fields.get("type", "").lower() in words), None)
    if kind is None:
        raise FileFormatError(f"its type must be that of numbers, got {_word(fields.get('type', ''))}")
    encoding = fields.get("encoding", "").lower()
    if encoding not in ("raw", "gzip", "gz"):
        raise FileFormatError(f"its encoding must be raw or gzip, got {_word(encoding)}; save it with compression")
    if fields.get("endian", "little").lower() not in ("little", "big"):
        raise FileFormatError(f"its endian must be little or big, got {_word(fields['endian'])}")
    dtype = np.dtype((">" if fields.get("endian", "").lower() == "big" else "<") + kind)
    axes = int(numbers_of(fields.get("dimension", "").encode(), 1, "its dimension")[0])
    if not 2 <= axes <= 4:
        raise FileFormatError(f"its dimension must be 2 to 4, got {axes}; save one volume of labels")
    sizes = checked_shape([_whole(each) for each in fields.get("sizes", "").split()])
    if len(sizes) != axes:
        raise FileFormatError(f"its sizes must be of {axes} axes, got {len(sizes)}")
    old = axes == 4 and "Segmentation_Extent" in keys and "space" not in fields  # of Slicer before 4.11
    layer_axis = _layer_axis(fields, sizes, old)
    affine, space, notes = _affine(fields, keys, [a for a in range(axes) if a != layer_axis], old)
    file = Unpacker(memoryview(data)[begin:], encoding != "raw")
    values = np.frombuffer(file.read(int(np.prod(sizes)) * dtype.itemsize), dtype).reshape(sizes, order="F")
    if not file.ends():
        notes += ("it holds more than its header states, which was left out",)
    volumes = [label_values(each) for each in _layers(values, layer_axis)]
    layers, segments, absent = segments_of(volumes, _names(keys, old))
    return LabelMap(name, layers, affine, segments, space, notes, absent)


def _header(data: bytes) -> tuple[dict[str, str], dict[str, str], int]:
    """Return the fields and the keys of a header, and the place after the blank line that ends it."""
    if data[:7] != b"NRRD000":
        raise FileFormatError("it must begin with NRRD000, got others")
    match = re.compile(rb"\r?\n\r?\n").search(data, 0, MAX_HEADER)
    if match is None:
        raise FileFormatError("its header must end with a blank line; its voxels must be in the same file")
    fields, keys = dict[str, str](), dict[str, str]()
    for line in data[: match.start()].decode("utf-8", "replace").splitlines()[1:]:
        if line.startswith("#"):
            continue
        key, sign, value = line.partition(":=")
        if sign:
            keys[key.strip()] = value.strip()
            continue
        key, _, value = line.partition(":")
        fields[key.strip().lower()] = value.strip()
    for key in ("data file", "datafile"):
        if key in fields:
            raise FileFormatError(
                f"its voxels must be in the same file, got the name of another, {_word(fields[key])}; save it as .nrrd"
            )
    for key in ("line skip", "lineskip", "byte skip", "byteskip"):
        if fields.get(key, "0") != "0":
            raise FileFormatError(f"its {key} must be 0, got {_word(fields[key])}; save it again")
    return fields, keys, match.end()


def _word(text: str) -> str:
    return printable_word(text.encode())


def _whole(text: str) -> int:
    if not re.fullmatch(r"\d{1,18}", text):
        raise FileFormatError(f"its sizes must be whole numbers, got {_word(text)}")
    return int(text)


def _layer_axis(fields: dict[str, str], sizes: tuple[int, ...], old: bool) -> int | None:
    """Return the axis of layers, if there is one."""
    if len(sizes) < 4:
        return None
    kinds = fields.get("kinds", "").lower().split()
    colours = next((each for each in kinds if each in COLOUR_KINDS), None)
    if colours:
        raise FileFormatError(f"its voxels must be numbers of labels, got {colours}; save the labels themselves")
    if "list" in kinds[:4]:
        return kinds.index("list")
    if old or sizes[3] == 1:
        return 3
    raise FileFormatError(f"it must be one volume, got axes of {' x '.join(map(str, sizes))}; save one volume")


def _layers(values: NDArray[Any], axis: int | None) -> list[NDArray[Any]]:
    """Return volumes of three axes, contiguous in memory."""
    if values.ndim == 2:
        return [values[:, :, None]]
    if axis is None:
        return [values]
    return [np.asfortranarray(np.take(values, k, axis)) for k in range(values.shape[axis])]


def _affine(
    fields: dict[str, str], keys: dict[str, str], axes: list[int], old: bool
) -> tuple[Floats, str, tuple[str, ...]]:
    """Return the map from indices to positions [m], its frame, and notes."""
    affine, stated, notes = np.eye(4), fields.get("space", "").lower(), tuple[str, ...]()
    unit = re.findall(r'"([^"]*)"', fields.get("space units", ""))
    metres = METRES_BY_UNIT.get(unit[0].lower() if unit else "mm", 1e-3)
    words = re.findall(r"none|\([^()]*\)", fields.get("space directions", ""))
    if words:
        if len(words) <= max(axes):
            raise FileFormatError("its space directions must be one for each axis, got fewer")
        for column, axis in enumerate(axes[:3]):
            affine[:3, column] = _vector(words[axis], old)
    else:
        spacings = fields.get("spacings", "").split()
        given = [spacings[axis] for axis in axes[:3]] if len(spacings) > max(axes) else ["1"] * len(axes)
        edges = numbers_of(" ".join(given).encode(), len(given), "its spacings")
        affine[: len(edges), : len(edges)] = np.diag(edges)
        note = "it does not state how the patient lies: sizes of its voxels alone are used, without left and right"
        return in_metres(affine, metres), "", (note,)
    if len(axes) == 2:
        affine[:3, 2] = np.cross(affine[:3, 0], affine[:3, 1])
        affine[:3, 2] /= np.sqrt(np.linalg.norm(affine[:3, 2])) or 1.0
    if "space origin" in fields:
        affine[:3, 3] = _vector(fields["space origin"], old)
    if old:
        extent = numbers_of(keys["Segmentation_Extent"].encode(), 6, "its Segmentation_Extent")
        affine[:3, 3] += affine[:3, :3] @ extent[::2]
        return RAS_TO_LPS @ in_metres(affine, metres), "LPS", ()
    if not stated:
        notes = ("it states no space: taken as LPS, as ITK does",)
        stated = "lps"
    if stated not in SIGNS_BY_SPACE:
        note = f"its space {_word(stated)} does not state how the patient lies: left and right are not known"
        return in_metres(affine, metres), "", (note,)
    return np.diag([*SIGNS_BY_SPACE[stated], 1.0]) @ in_metres(affine, metres), "LPS", notes


def _vector(text: str, old: bool) -> Floats:
    """Return the first three numbers of a vector in parentheses, of which an old file has four."""
    values = numbers_of(text.strip("() ").replace(",", " ").encode(), 4 if old else 3, "a vector of its space")
    return np.asarray(values[:3])


def _names(keys: dict[str, str], old: bool) -> dict[tuple[int, int], tuple[int, str]]:
    """Return number and name of segments by layer and value; an old file has a layer for each."""
    segments: dict[int, dict[str, str]] = {}
    for key, text in keys.items():
        match = SEGMENT_PATTERN.fullmatch(key)
        if match and len(segments) < MAX_SEGMENTS:
            segments.setdefault(int(match[1]), {})[match[2]] = text
    names = {}
    for place, about in sorted(segments.items()):
        layer = about.get("Layer", str(place if old else 0))
        value = about.get("LabelValue", "1" if old else str(place + 1))
        if re.fullmatch(r"\d{1,9}", layer) and re.fullmatch(r"\d{1,9}", value):
            number = place + 1 if old else int(value)
            names[int(layer), int(value)] = (number, about.get("Name", ""))
    return names
