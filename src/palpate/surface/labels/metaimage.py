"""MetaImage files of labels (.mha, and .mhd with its voxels inside), in LPS as ITK writes them."""

from __future__ import annotations

import math
import re

import numpy as np

from palpate.core.arrays import Floats
from palpate.core.faults import FileFormatError
from palpate.surface.formats.common import printable_word
from palpate.surface.labels.agreement import difference_of_maps, lengths_agree, lengths_text
from palpate.surface.labels.label_map import LabelMap, as_grid, in_metres
from palpate.surface.labels.voxels import Unpacker, checked_shape, label_values, numbers_of, segments_of

NUMPY_TYPES = {
    "MET_CHAR": "i1", "MET_UCHAR": "u1", "MET_SHORT": "i2", "MET_USHORT": "u2", "MET_INT": "i4", "MET_UINT": "u4",
    "MET_LONG": "i4", "MET_ULONG": "u4", "MET_LONG_LONG": "i8", "MET_ULONG_LONG": "u8", "MET_FLOAT": "f4",
    "MET_DOUBLE": "f8",
}  # fmt: skip
MAX_HEADER_LINES, MAX_LINE = 1000, 100_000


def read_metaimage(data: bytes, name: str = "image.mha") -> LabelMap:
    """Return the label map of a MetaImage file."""
    fields, begin = _header(data)
    where = fields.get("ElementDataFile", "")
    if where != "LOCAL":
        raise FileFormatError(
            f"its voxels must be in the same file, got the name of another, {printable_word(where.encode())}; save it "
            "as .mha"
        )

    def given(default: str, *keys: str) -> str:
        return next((fields[key] for key in keys if key in fields), default)

    kind = NUMPY_TYPES.get(fields.get("ElementType", ""))
    if kind is None or given("1", "ElementNumberOfChannels") != "1":
        what = given("", "ElementNumberOfChannels") + " channels of " + fields.get("ElementType", "no type")
        raise FileFormatError(
            f"its voxels must be numbers of labels, got {printable_word(what.strip().encode())}; save the labels "
            "themselves"
        )
    if given("True", "BinaryData").lower() != "true" or given("0", "HeaderSize") != "0":
        raise FileFormatError("its voxels must be binary and follow its header; save it again, such as with 3D Slicer")
    axes = int(numbers_of(fields.get("NDims", "").encode(), 1, "its NDims")[0])
    if axes not in (2, 3):
        raise FileFormatError(f"its NDims must be 2 or 3, got {axes}; save one volume of labels")
    sizes = numbers_of(fields.get("DimSize", "").encode(), axes, "its DimSize")
    if not np.isfinite(sizes).all() or np.any(sizes != np.rint(sizes)):
        raise FileFormatError("its DimSize must be whole numbers, got others")
    shape = checked_shape([*map(int, sizes), *[1] * (3 - axes)])
    orders = {fields[key].lower() for key in ("BinaryDataByteOrderMSB", "ElementByteOrderMSB") if key in fields}
    if len(orders) > 1:
        raise FileFormatError("its header must state one order of bytes, got two different ones; save it again")
    order = ">" if "true" in orders else "<"
    dtype = np.dtype(order + kind)
    affine, notes = _affine(fields, shape, axes)
    file = Unpacker(memoryview(data)[begin:], given("False", "CompressedData").lower() == "true")
    values = np.frombuffer(file.read(math.prod(shape) * dtype.itemsize), dtype).reshape(shape, order="F")
    if not file.ends():
        notes.append("it holds more than its header states, which was left out")
    values, more = label_values(values)
    layers, segments, absent = segments_of([values], {})
    return LabelMap(name, layers, in_metres(affine, 1e-3), segments, "LPS", (*notes, *more), absent)


def _affine(fields: dict[str, str], shape: tuple[int, ...], axes: int) -> tuple[Floats, list[str]]:
    """Return the map from indices to positions [mm], and notes on what its header states otherwise.

    Of words for the same, the first of those below is taken, as ITK takes it.
    """

    def stated(words: tuple[str, ...], count: int, default: Floats) -> dict[str, Floats]:
        values = {word: numbers_of(fields[word].encode(), count, f"its {word}") for word in words if word in fields}
        for word, numbers in values.items():
            if not np.isfinite(numbers).all():
                raise FileFormatError(f"its {word} must be finite numbers, got {printable_word(fields[word].encode())}")
        return values or {words[0]: default}

    def placed(spacing: Floats, turn: Floats, origin: Floats) -> Floats:
        affine = np.eye(4)
        affine[:axes, :axes], affine[:axes, 3] = turn.reshape(axes, axes).T * spacing, origin  # a row for each axis
        return affine

    notes = list[str]()
    words = [
        stated(("ElementSpacing", "ElementSize"), axes, np.ones(axes)),
        stated(("TransformMatrix", "Rotation", "Orientation"), axes * axes, np.eye(axes).ravel()),
        stated(("Origin", "Offset", "Position"), axes, np.zeros(axes)),
    ]
    spacing, turn, origin = (next(iter(each.values())) for each in words)
    affine = as_grid(placed(spacing, turn, origin))
    others = [
        [placed(each, turn, origin) for each in words[0].values()],
        [placed(spacing, each, origin) for each in words[1].values()],
        [placed(spacing, turn, each) for each in words[2].values()],
    ]
    for names, maps in zip(words, others, strict=True):
        taken = next(iter(names))
        for word, other in zip(names, maps, strict=True):
            apart = difference_of_maps(affine, other, shape)
            notes += [f"its {taken} and {word} differ by {apart}: {taken} was taken, as ITK does"] if apart else []
    if not fields.keys() & {"ElementSpacing", "ElementSize"}:
        notes.append("it states no ElementSpacing: voxels of 1 mm are taken")
    edges = np.linalg.norm(affine[:axes, :axes], axis=0)
    if not lengths_agree(edges, np.abs(spacing)):
        notes.append(
            f"its matrix makes voxels of {lengths_text(edges)} of its spacing of {lengths_text(spacing)}: the former "
            "were taken, as ITK does"
        )
    if (spacing < 0).any():
        notes.append(f"its spacing of {lengths_text(spacing)} turns an axis around, as ITK reads it")
    if axes == 2:
        notes.append("it has two axes: the thickness of its slice is not stated, 1 mm was taken")
    return affine, [*notes, *_unused(fields, affine)]


def _unused(fields: dict[str, str], affine: Floats) -> list[str]:
    """Return notes on statements that ITK does not use, where they are not those of the map (4, 4)."""
    notes, letters = list[str](), fields.get("AnatomicalOrientation", "").upper()
    ahead = "".join(
        ("RL", "AP", "IS")[row][int(affine[row, column] > 0)]
        for column, row in enumerate(np.abs(affine[:3, :3]).argmax(axis=0))
    )
    behind = ahead.translate(str.maketrans("RLAPIS", "LRPASI"))  # ITK names the sides from which axes come
    if re.fullmatch("[RL][AP][IS]", "".join(sorted(letters, key="RLAPIS".find))) and letters not in (ahead, behind):
        notes.append(f"its AnatomicalOrientation {letters} is not that of its matrix, {behind}, which was taken")
    if fields.get("DistanceUnits", "mm").lower() not in ("mm", "?"):
        unit = printable_word(fields["DistanceUnits"].encode())
        notes.append(f"its DistanceUnits {unit} were not used: its lengths were taken as mm, as ITK does")
    for word, usual in (("CenterOfRotation", 0.0), ("ElementToIntensityFunctionSlope", 1.0),
                        ("ElementToIntensityFunctionOffset", 0.0)):  # fmt: skip
        if word in fields and any(each != usual for each in _numbers(fields[word])):
            notes.append(f"its {word} was not used, as ITK does")
    return notes


def _numbers(text: str) -> list[float]:
    try:
        return [float(each) for each in text.split()]
    except ValueError:
        return []


def _header(data: bytes) -> tuple[dict[str, str], int]:
    """Return the fields of a header, which ends with ElementDataFile, and the place after it."""
    fields, at = dict[str, str](), 0
    for _ in range(MAX_HEADER_LINES):
        end = data.find(b"\n", at, at + MAX_LINE)
        if end < 0:
            break
        key, sign, value = data[at:end].decode("utf-8", "replace").partition("=")
        at = end + 1
        if not sign:
            break
        if fields.setdefault(key.strip(), value.strip()) != value.strip():
            word = printable_word(key.strip().encode())
            raise FileFormatError(f"its header must state {word} once, got two different ones; save it again")
        if key.strip() == "ElementDataFile":
            return fields, at
    raise FileFormatError("its header must be lines of KEY = VALUE that end with ElementDataFile, got others")
