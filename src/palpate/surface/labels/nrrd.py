"""NRRD images of labels (https://teem.sourceforge.net/nrrd), and those of 3D Slicer with names and layers."""

from __future__ import annotations

import re
from collections.abc import Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.core.arrays import Floats
from palpate.core.faults import FileFormatError
from palpate.surface.formats.common import printable_word
from palpate.surface.labels.agreement import lengths_agree, lengths_text
from palpate.surface.labels.label_map import RAS_TO_LPS, LabelMap, as_grid
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
OTHER_SPELLINGS = {"centers": "centerings", "axismins": "axis mins", "axismaxs": "axis maxs", "lineskip": "line skip",
           "byteskip": "byte skip", "datafile": "data file"}  # fmt: skip
MAX_HEADER = 1 << 22  # bytes
MAX_SEGMENTS = 10_000
COLOUR_KINDS = ("rgb-color", "rgba-color", "vector", "covariant-vector", "3-color", "4-color", "3-vector", "complex")
VECTOR_PATTERN = re.compile(r"none|\([^()]*\)")
NO_THICKNESS = "it has two axes: the thickness of its slice is not stated, {:.3g} mm was taken"
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
    if np.dtype(kind).itemsize > 1 and fields.get("endian", "").lower() not in ("little", "big"):
        raise FileFormatError(
            f"its endian must be little or big, got {_word(fields.get('endian', ''))}; add the line 'endian: little', "
            "the order of bytes of nearly all computers"
        )
    dtype = np.dtype((">" if fields.get("endian", "").lower() == "big" else "<") + kind)
    axes = int(numbers_of(fields.get("dimension", "").encode(), 1, "its dimension")[0])
    if not 2 <= axes <= 4:
        raise FileFormatError(f"its dimension must be 2 to 4, got {axes}; save one volume of labels")
    sizes = checked_shape([_whole(each) for each in fields.get("sizes", "").split()])
    if len(sizes) != axes:
        raise FileFormatError(f"its sizes must be of {axes} axes, got {len(sizes)}")
    old = axes == 4 and "Segmentation_Extent" in keys and "space" not in fields  # of Slicer before 4.11
    layer_axis = _layer_axis(fields, sizes, old)
    names = _names(keys, old, 1 if layer_axis is None else sizes[layer_axis])
    spatial = [a for a in range(axes) if a != layer_axis]
    affine, space, notes = _affine(fields, keys, spatial, [sizes[a] for a in spatial], old)
    file = Unpacker(memoryview(data)[begin:], encoding != "raw")
    values = np.frombuffer(file.read(int(np.prod(sizes)) * dtype.itemsize), dtype).reshape(sizes, order="F")
    if not file.ends():
        notes.append("it holds more than its header states, which was left out")
    volumes = list[NDArray[Any]]()
    for layer in _layers(values, layer_axis):
        volume, more = label_values(layer)
        volumes.append(volume)
        notes += more
    layers, segments, absent = segments_of(volumes, names)
    return LabelMap(name, layers, affine, segments, space, tuple(dict.fromkeys(notes)), absent)


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
        into, key = keys, key.strip()
        if not sign:
            key, _, value = line.partition(":")
            into, key = fields, OTHER_SPELLINGS.get(key.strip().lower(), key.strip().lower())
        if into.setdefault(key, value.strip()) != value.strip() and (not sign or SEGMENT_PATTERN.fullmatch(key)):
            raise FileFormatError(f"its header must state {_word(key)} once, got two different ones; save it again")
    if "data file" in fields:
        where = _word(fields["data file"])
        raise FileFormatError(
            f"its voxels must be in the same file, got the name of another, {where}; save it as .nrrd"
        )
    for key in ("line skip", "byte skip"):
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
    """Return the axis of layers, if there is one; raise for axes of times, colours or vectors."""
    kinds = fields.get("kinds", "").lower().split()[: len(sizes)]
    colours = next((each for each in kinds if each in COLOUR_KINDS), None)
    if colours:
        raise FileFormatError(f"its voxels must be numbers of labels, got {colours}; save the labels themselves")
    if fields.get("space", "").lower().endswith("-time") or ("time" in kinds and sizes[kinds.index("time")] > 1):
        raise FileFormatError("it must be one volume, got a time series; save one volume of labels")
    if len(sizes) < 4:
        if "list" in kinds and sizes[kinds.index("list")] > 1:
            raise FileFormatError("it must be one volume, got a list of pictures; save one volume of labels")
        return None
    if old:
        return 3
    vectors = VECTOR_PATTERN.findall(fields.get("space directions", ""))
    words = kinds if "list" in kinds else vectors
    other_axes = [a for a, word in enumerate(words[:4]) if word in ("list", "none")]
    if len(other_axes) == 1:
        return other_axes[0]
    if sizes[3] == 1:
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
    fields: dict[str, str], keys: dict[str, str], axes: list[int], sizes: list[int], old: bool
) -> tuple[Floats, str, list[str]]:
    """Return the map from indices to positions [m], its frame, and notes."""
    affine, stated, notes = np.eye(4), fields.get("space", "").lower(), list[str]()
    words = VECTOR_PATTERN.findall(fields.get("space directions", ""))
    if not words:
        return _spaced(fields, axes, sizes)
    if len(words) <= max(axes):
        raise FileFormatError("its space directions must be one for each axis, got fewer")
    _check_dimension(fields, 4 if old else 3)
    for column, axis in enumerate(axes[:3]):
        affine[:3, column] = _vector(words[axis], old)
    if len(axes) == 2:
        affine[:3, 2] = np.cross(affine[:3, 0], affine[:3, 1])
        affine[:3, 2] /= np.sqrt(np.linalg.norm(affine[:3, 2])) or 1.0
    if "space origin" in fields:
        affine[:3, 3] = _vector(fields["space origin"], old)
    if old:
        extent = numbers_of(keys["Segmentation_Extent"].encode(), 6, "its Segmentation_Extent")
        affine[:3, 3] += affine[:3, :3] @ extent[::2]
    metres, more = _units(fields, "space units", range(3))
    affine = np.diag([*metres, 1.0]) @ as_grid(affine)
    if len(axes) == 2:
        notes.append(NO_THICKNESS.format(1e3 * np.linalg.norm(affine[:3, 2])))
    notes += more + _axis_notes(fields, axes, np.linalg.norm(affine[:3, :3], axis=0), metres)
    if old:
        return RAS_TO_LPS @ as_grid(affine), "LPS", notes
    if not stated:
        notes.append("it states no space: taken as LPS, as ITK does")
        stated = "lps"
    if stated not in SIGNS_BY_SPACE:
        notes.append(f"its space {_word(stated)} does not state how the patient lies: left and right are not known")
        return as_grid(affine), "", notes
    return np.diag([*SIGNS_BY_SPACE[stated], 1.0]) @ as_grid(affine), "LPS", notes


def _spaced(fields: dict[str, str], axes: list[int], sizes: list[int]) -> tuple[Floats, str, list[str]]:
    """Return the map [m] of sizes of voxels alone, its frame, and notes."""
    notes = ["it does not state how the patient lies: sizes of its voxels alone are used, without left and right"]
    edges = _along(fields, "spacings", axes)
    low, high = _along(fields, "axis mins", axes), _along(fields, "axis maxs", axes)
    if not np.isfinite(edges).any() and np.isfinite(high - low).all():
        nodes = [word == "node" for word in fields.get("centerings", "").lower().split()]
        steps = [size - (len(nodes) > axis and nodes[axis]) for axis, size in zip(axes, sizes, strict=True)]
        edges = (high - low) / np.maximum(steps, 1)
    elif not np.isfinite(edges).any():
        edges = np.ones(len(axes))
        notes.append("it states no spacings: voxels of 1 mm are taken")
    if (edges < 0).any():
        notes.append("its spacings are negative: their sizes were taken")
    elif np.isfinite(high - low).all():
        notes += _mins_notes(edges, np.abs(high - low), sizes)
    unused = [key for key in ("space origin", "space units") if key in fields]
    if unused:
        notes.append(f"what it states as {' and '.join(unused)} was not used: it has no space directions")
    metres, more = _units(fields, "units", axes)
    affine = np.eye(4) * 1e-3
    affine[3, 3] = 1.0
    affine[: len(axes), : len(axes)] = np.diag(np.abs(edges) * metres)
    if not np.isfinite(edges).all():
        raise FileFormatError(f"its spacings must be the edges of a voxel, got {lengths_text(edges)}; write them again")
    return as_grid(affine), "", notes + more + [NO_THICKNESS.format(1.0)] * (len(axes) == 2)


def _mins_notes(edges: Floats, lengths: Floats, sizes: list[int]) -> list[str]:
    """Return in what lengths from the least to the largest position differ from edges of cells, or between nodes."""
    for less in (0, 1):
        if lengths_agree(np.abs(edges), lengths / np.maximum(np.array(sizes) - less, 1)):
            return []
    text = lengths_text(lengths / np.array(sizes))
    return [f"its axis mins and maxs make voxels of {text}, its spacings {lengths_text(np.abs(edges))}: the latter "
            "were taken"]  # fmt: skip


def _along(fields: dict[str, str], key: str, axes: list[int]) -> Floats:
    """Return numbers of a field along axes, NaN where it states none."""
    words = fields.get(key, "").split()
    if not words:
        return np.full(len(axes), np.nan)
    if len(words) <= max(axes):
        raise FileFormatError(f"its {key} must be one for each axis, got {len(words)}; write them again")
    return numbers_of(" ".join(words[axis] for axis in axes).encode(), len(axes), f"its {key}")


def _units(fields: dict[str, str], key: str, axes: Iterable[int]) -> tuple[Floats, list[str]]:
    """Return the units of length [m] along axes, by default millimetres, and notes."""
    words = [word.lower() for word in re.findall(r'"([^"]*)"', fields.get(key, ""))]
    axis_units = [words[axis] if axis < len(words) else "" for axis in axes]
    notes = [
        f"its {key} {_word(word)} is not known: taken as mm" for word in dict.fromkeys(axis_units)
        if word not in (*METRES_BY_UNIT, "", "none", "???")
    ]  # fmt: skip
    if len(set(axis_units)) > 1:
        notes.append(f"its {key} are mixed, {', '.join(_word(word) for word in axis_units)}: each axis has its own")
    return np.array([METRES_BY_UNIT.get(word, 1e-3) for word in axis_units]), notes


def _axis_notes(fields: dict[str, str], axes: list[int], edges: Floats, metres: Floats) -> list[str]:
    """Return in what other statements on axes differ from their directions, whose edges [m] were taken."""
    notes = list[str]()
    for key in ("spacings", "thicknesses"):
        lengths = np.abs(_along(fields, key, axes)) * metres[0]
        known = np.isfinite(lengths)
        if not lengths_agree(edges[: len(axes)][known], lengths[known]):
            texts = [lengths_text(each[known], 1e3) for each in (lengths, edges[: len(axes)])]
            notes.append(f"its {key} state {texts[0]}, its space directions {texts[1]}: the directions were taken")
    if any(np.isfinite(_along(fields, key, axes)).any() for key in ("axis mins", "axis maxs")):
        notes.append("its axis mins and maxs were not used: its space directions and origin were")
    return notes


def _check_dimension(fields: dict[str, str], dimension: int) -> None:
    """Raise `FileFormatError` where the space has a stated dimension that is not that of its vectors."""
    stated = fields.get("space dimension", str(dimension))
    if stated != str(dimension):
        raise FileFormatError(f"its space dimension must be {dimension}, as its vectors have, got {_word(stated)}")


def _vector(text: str, old: bool) -> Floats:
    """Return the first three numbers of a vector in parentheses, of which an old file has four."""
    values = numbers_of(text.strip("() ").replace(",", " ").encode(), 4 if old else 3, "a vector of its space")
    return np.asarray(values[:3])


def _names(keys: dict[str, str], old: bool, layers: int) -> dict[tuple[int, int], tuple[int, str]]:
    """Return number and name of segments by layer and value.

    As 3D Slicer reads them, a segment of a file of layers has by default a layer of its own, and the value 1.
    """
    segments: dict[int, dict[str, str]] = {}
    for key, text in keys.items():
        match = SEGMENT_PATTERN.fullmatch(key)
        if match and len(segments) < MAX_SEGMENTS:
            segments.setdefault(int(match[1]), {})[match[2]] = text
    names: dict[tuple[int, int], tuple[int, str]] = {}
    for place, about in sorted(segments.items()):
        layer = about.get("Layer", str(place if layers > 1 or old else 0))
        value = about.get("LabelValue", "1" if layers > 1 or old else str(place + 1))
        for word, text in (("Layer", layer), ("LabelValue", value)):
            if not re.fullmatch(r"\d{1,9}", text):
                raise FileFormatError(
                    f"its Segment{place}_{word} must be a whole number, got {_word(text)}; save it again"
                )
        at, name = (int(layer), int(value)), about.get("Name", "")
        if at in names:
            raise FileFormatError(
                f"its segments must have values of their own, got {_word(names[at][1])} and {_word(name)} of value "
                f"{at[1]} in layer {at[0]}; save it again"
            )
        names[at] = (place + 1 if old else at[1], name)
    unnamed = sorted(set(range(layers)) - {layer for layer, _ in names})
    if layers > 1 and unnamed:
        raise FileFormatError(
            f"it must be one volume, or have segments in each of its {layers} layers, got none in layer {unnamed[0]}, "
            "as a time series has; save one volume of labels"
        )
    return names
