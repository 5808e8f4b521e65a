"""VTP files: PolyData in XML, with text, base64 or raw arrays, compressed by zlib or not."""

from __future__ import annotations

import base64
import binascii
import re
import zlib
from dataclasses import dataclass, field
from typing import Any
from xml.parsers import expat

import numpy as np
from numpy.typing import NDArray

from palpate.core.arrays import Floats, Ints
from palpate.core.faults import FileFormatError
from palpate.surface.formats.common import Parts, check_indices, fans, printable_word, read_count, read_numbers, strips

NUMPY_TYPES = {
    "Int8": "i1", "UInt8": "u1", "Int16": "i2", "UInt16": "u2", "Int32": "i4", "UInt32": "u4", "Int64": "i8",
    "UInt64": "u8", "Float32": "f4", "Float64": "f8",
}  # fmt: skip
MAX_EXPANSION = 64  # of all arrays together over the file; that of surfaces is below 10
MAX_ARRAYS = 100_000  # and pieces
BLOCK_COST = 128  # bytes that a compressed block counts as
NEEDED_SECTIONS = ("Points", "Polys", "Strips")


@dataclass
class _Array:
    attributes: dict[str, str]
    text: list[str] = field(default_factory=list)


@dataclass
class _VtpFile:
    """Content of the XML, and the bytes of appended data."""

    appended: bytes
    coded: bool
    room: int  # bytes that arrays may still expand to
    attributes: dict[str, str] = field(default_factory=dict)
    pieces: list[tuple[dict[str, str], dict[tuple[str, str], _Array]]] = field(default_factory=list)
    arrays: int = 0  # and pieces
    space: _Array | None = None  # text of the frame, as 3D Slicer writes it

    def count_array(self) -> int:
        self.arrays += 1
        return self.arrays


def read_vtp(data: bytes) -> Parts:
    """Return the surface of a VTP file: polygons and strips of its pieces."""
    file = _parse(data)
    if file.attributes.get("type") != "PolyData":
        raise FileFormatError("it must be a VTKFile of type PolyData")
    if file.attributes.get("compressor", "vtkZLibDataCompressor") != "vtkZLibDataCompressor":
        raise FileFormatError(
            f"its compressor must be zlib, got {printable_word(file.attributes['compressor'].encode())}"
        )
    vertices: list[Floats] = []
    triangles: list[Ints] = []
    before = 0
    for attributes, arrays in file.pieces:
        n = read_count(attributes.get("NumberOfPoints", "0"), "points", len(data) * MAX_EXPANSION)
        points = [array for (section, _), array in arrays.items() if section == "Points"]
        if n == 0 or not points:
            continue
        values = _values(file, points[0])
        if len(values) != 3 * n:
            raise FileFormatError(f"it states {n} points and has {len(values)} coordinates")
        vertices.append(values.astype(float).reshape(-1, 3))
        for section, split in (("Polys", fans), ("Strips", strips)):
            faces = split(*_cells(file, arrays, section))
            if faces.size and faces.max() >= n:
                raise FileFormatError(f"its {section} must have points below {n}, got {faces.max()}")
            triangles.append(faces + before)
        before += n
    if not sum(map(len, triangles)):
        raise FileFormatError("it must have Points, and Polys or Strips")
    return {"": lambda: (np.concatenate(vertices), np.concatenate(triangles))}


def space_of_vtp(data: bytes) -> str:
    """Return the frame that a VTP file states in a field array SPACE; empty for other files."""
    if b'Name="SPACE"' not in data:
        return ""
    file = _parse(data)
    text = b"" if file.space is None else bytes(_values(file, file.space).astype(np.uint8)).strip(b"\0")
    return text.decode() if text in (b"LPS", b"RAS") else ""


def _parse(data: bytes) -> _VtpFile:
    """Read the XML without definitions of documents or entities; appended data, which is not XML, is cut out first."""
    appended, coded = b"", False
    begin = data.find(b"<AppendedData")
    opened = data.find(b">", begin) + 1 if begin >= 0 else 0
    mark = re.compile(rb"\s*_").match(data, opened) if opened else None
    if mark:
        end = data.rfind(b"</AppendedData>")
        if end < mark.end():
            raise FileFormatError("its AppendedData does not end")
        appended, coded = data[mark.end() : end], b"base64" in data[begin:opened]
        data = data[: mark.end()] + data[end:]
    file = _VtpFile(appended, coded, MAX_EXPANSION * (len(data) + len(appended)))
    section, deeper = "", 0  # elements inside an array, whose text is not the array's
    array: _Array | None = None

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal section, array, deeper
        if array is not None:
            deeper += 1
        elif name == "VTKFile":
            file.attributes = attributes
        elif name in ("Piece", "DataArray") and file.count_array() > MAX_ARRAYS:
            raise FileFormatError(f"it must have at most {MAX_ARRAYS} pieces and arrays; join its pieces")
        elif name == "Piece":
            file.pieces.append((attributes, {}))
        elif name in NEEDED_SECTIONS and file.pieces:
            section = name
        elif name == "Array" and attributes.get("Name") == "SPACE" and attributes.get("type") == "String":
            array = file.space = _Array(attributes | {"type": "Int8"})  # codes of letters
        elif name == "DataArray" and section:
            array = file.pieces[-1][1].setdefault((section, attributes.get("Name", "")), _Array(attributes))

    def end_of(name: str) -> None:
        nonlocal section, array, deeper
        if deeper:
            deeper -= 1
            return
        section = "" if name == section else section
        array = None if name in ("DataArray", "Array") else array

    def text_of(text: str) -> None:
        if array is not None and not deeper:
            array.text.append(text)

    def refuse(*_: Any) -> None:
        raise FileFormatError("it must not define a document type or entities")

    parser = expat.ParserCreate("utf-8")
    parser.buffer_text = True
    parser.StartElementHandler, parser.EndElementHandler = start, end_of
    parser.CharacterDataHandler = text_of
    parser.StartDoctypeDeclHandler = parser.EntityDeclHandler = refuse
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        raise FileFormatError(f"its XML is not well formed ({error})") from None
    return file


def _cells(file: _VtpFile, arrays: dict[tuple[str, str], _Array], section: str) -> tuple[Ints, Ints]:
    if (section, "connectivity") not in arrays or (section, "offsets") not in arrays:
        return np.zeros(0, dtype=np.int64), np.zeros(0, dtype=np.int64)
    corners = check_indices(_values(file, arrays[section, "connectivity"]), "connectivity")
    sizes = np.diff(check_indices(_values(file, arrays[section, "offsets"]), "offsets"), prepend=0)
    if np.any(sizes < 0):
        raise FileFormatError(f"the offsets of its {section} must ascend")
    return corners, sizes


def _values(file: _VtpFile, array: _Array) -> NDArray[Any]:
    kind, form = array.attributes.get("type", ""), array.attributes.get("format", "ascii")
    if kind not in NUMPY_TYPES:
        raise FileFormatError(f"it has an array of unknown type {printable_word(kind.encode())}")
    if form == "ascii":
        return read_numbers("".join(array.text).encode())
    if form == "binary":
        source, coded, at = re.sub(rb"\s+", b"", "".join(array.text).encode()), True, 0
    elif form == "appended":
        source, coded = file.appended, file.coded
        at = read_count(array.attributes.get("offset", ""), "bytes before an array", len(source))
    else:
        raise FileFormatError(f"it has an array of unknown format {printable_word(form.encode())}")
    order = ">" if file.attributes.get("byte_order") == "BigEndian" else "<"
    raw = _bytes(file, source, coded, at, np.dtype(order + NUMPY_TYPES[_header_type(file)]))
    dtype = np.dtype(order + NUMPY_TYPES[kind])
    if len(raw) % dtype.itemsize:
        raise FileFormatError("an array of it ends within a number")
    return np.frombuffer(raw, dtype)


def _header_type(file: _VtpFile) -> str:
    kind = file.attributes.get("header_type", "UInt32")
    if kind not in ("UInt32", "UInt64"):
        raise FileFormatError(f"its header_type must be UInt32 or UInt64, got {printable_word(kind.encode())}")
    return kind


def _bytes(file: _VtpFile, source: bytes, coded: bool, at: int, header: np.dtype[Any]) -> bytes:
    """Return the bytes of an array whose header, one length or those of compressed blocks, begins at `at`."""
    wide = header.itemsize
    if "compressor" not in file.attributes:
        length = int(np.frombuffer(_decode_bytes(source, coded, at, wide)[0], header)[0])
        _reserve_bytes(file, length)
        return _decode_bytes(source, coded, at, wide + length)[0][wide:]
    blocks, each, last = (int(n) for n in np.frombuffer(_decode_bytes(source, coded, at, 3 * wide)[0], header))
    if blocks > len(source) // wide:
        raise FileFormatError(f"an array states {blocks} blocks, for which the file has no room")
    if blocks == 0:
        return b""
    _reserve_bytes(file, (blocks - 1) * each + (last or each) + BLOCK_COST * blocks)
    head, at = _decode_bytes(source, coded, at, (3 + blocks) * wide)
    lengths = [int(n) for n in np.frombuffer(head, header)[3:]]
    _reserve_bytes(file, sum(lengths))
    packed, _ = _decode_bytes(source, coded, at, sum(lengths))
    decoded, begin = [], 0
    for k, length in enumerate(lengths):
        size = last if last and k == blocks - 1 else each
        try:
            block = zlib.decompressobj().decompress(packed[begin : begin + length], size + 1)
        except zlib.error as error:
            raise FileFormatError(f"a compressed block cannot be expanded ({error})") from None
        if len(block) != size:
            raise FileFormatError(f"a compressed block must have {size} bytes")
        decoded.append(block)
        begin += length
    return b"".join(decoded)


def _reserve_bytes(file: _VtpFile, size: int) -> None:
    """Check that arrays do not expand to much more than the file."""
    file.room -= size
    if file.room < 0:
        raise FileFormatError(f"its arrays must not expand to more than {MAX_EXPANSION} times the size of the file")


def _decode_bytes(source: bytes, coded: bool, at: int, size: int) -> tuple[bytes, int]:
    """Return decoded bytes from position `at`, and the position after them."""
    end = at + ((size + 2) // 3 * 4 if coded else size)
    if end > len(source):
        raise FileFormatError("an array of it is cut off")
    if not coded:
        return source[at:end], end
    try:
        decoded = base64.b64decode(source[at:end], validate=True)[:size]
    except (binascii.Error, ValueError):
        raise FileFormatError("an array of it is not valid base64") from None
    if len(decoded) < size:
        raise FileFormatError("an array of it is cut off")
    return decoded, end
