"""MetaImage files of labels (.mha, and .mhd with its voxels inside), in LPS as ITK writes them."""

from __future__ import annotations

import math

import numpy as np

from palpate.faults import FileFormatError
from palpate.surface.formats.common import printable_word
from palpate.surface.labels.label_map import LabelMap, in_metres
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
    order = ">" if given("", "BinaryDataByteOrderMSB", "ElementByteOrderMSB").lower() == "true" else "<"
    dtype = np.dtype(order + kind)
    affine, notes = np.eye(4), tuple[str, ...]()
    edges = numbers_of(given("1 " * axes, "ElementSpacing", "ElementSize").encode(), axes, "its ElementSpacing")
    identity = " ".join(map(str, np.eye(axes).ravel()))
    text = given(identity, "TransformMatrix", "Rotation", "Orientation")
    turn = numbers_of(text.encode(), axes * axes, "its TransformMatrix").reshape(axes, axes)
    origin = numbers_of(given("0 " * axes, "Offset", "Position", "Origin").encode(), axes, "its Offset")
    affine[:axes, :axes], affine[:axes, 3] = turn.T * edges, origin  # a row for each axis of the image
    file = Unpacker(memoryview(data)[begin:], given("False", "CompressedData").lower() == "true")
    values = np.frombuffer(file.read(math.prod(shape) * dtype.itemsize), dtype).reshape(shape, order="F")
    if not file.ends():
        notes = ("it holds more than its header states, which was left out",)
    layers, segments, absent = segments_of([label_values(values)], {})
    return LabelMap(name, layers, in_metres(affine, 1e-3), segments, "LPS", notes, absent)


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
        fields[key.strip()] = value.strip()
        if key.strip() == "ElementDataFile":
            return fields, at
    raise FileFormatError("its header must be lines of KEY = VALUE that end with ElementDataFile, got others")
