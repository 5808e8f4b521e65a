"""NIfTI-1 and NIfTI-2 images of labels (https://nifti.nimh.nih.gov), with the names that TotalSegmentator writes.

The sform gives the positions of voxels if its code is positive, else the qform, else the sizes of voxels alone; a note
says in what the others differ from what was taken. nibabel takes the sform, too; ITK takes the qform where its code is
1 and that of the sform is not, and sizes from `pixdim`.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.core.arrays import Floats
from palpate.core.faults import FileFormatError
from palpate.core.files import shortened
from palpate.surface.formats.first_bytes import GZIP_MAGIC
from palpate.surface.labels.agreement import difference_of_maps, lengths_agree, lengths_text
from palpate.surface.labels.label_map import RAS_TO_LPS, LabelMap, as_grid, in_metres
from palpate.surface.labels.voxels import Unpacker, checked_shape, label_values, segments_of

NUMPY_TYPES = {
    2: "u1", 4: "i2", 8: "i4", 16: "f4", 64: "f8", 256: "i1", 512: "u2", 768: "u4", 1024: "i8", 1280: "u8",
}  # fmt: skip
REFUSED_TYPES = {
    1: "single bits", 32: "complex numbers", 128: "colours (RGB)", 1536: "numbers of 128 bits", 2304: "colours (RGBA)",
}  # fmt: skip
METRES_BY_CODE = {0: 1e-3, 1: 1.0, 2: 1e-3, 3: 1e-6}  # unknown, metre, millimetre, micrometre
MAX_OFFSET = 1 << 24  # bytes before the voxels
NORM_ROUNDING = 1e-5  # of the squared length of a quaternion in single precision
HALF_TURN_ROUNDING = 1e-7  # of one minus it, from which NIfTI's own library turns by 180 degrees
CARET_NAMES = 0  # code of extensions that hold names
# `<Label Key="5" ...><![CDATA[liver]]></Label>`
NAME_PATTERN = re.compile(rb'<Label [^<>]{0,200}?Key="(\d{1,9})"[^<>]{0,200}>\s{0,9}(?:<!\[CDATA\[)?([^\]<>]{1,200})')


def read_nifti(data: bytes, name: str = "image.nii") -> LabelMap:
    """Return the label map of a NIfTI file, also one compressed by gzip."""
    file = Unpacker(data, data[:2] == GZIP_MAGIC)
    head = file.read(4)
    sizes = {struct.pack(order + "i", size): (order, size) for order in "<>" for size in (348, 540)}
    if bytes(head) not in sizes:
        raise FileFormatError("it must begin with the size of a NIfTI header, 348 or 540, got others")
    order, size = sizes[bytes(head)]
    head += file.read(size - 4)
    wide = size == 540
    if bytes(head[4:7] if wide else head[344:347]) != (b"n+2" if wide else b"n+1"):
        raise FileFormatError("its voxels must be in the same file, got a header alone; save it as one .nii file")

    def numbers(form: str, at: int) -> tuple[Any, ...]:
        return struct.unpack_from(order + form, head, at)

    dim = [int(each) for each in numbers("8q" if wide else "8h", 16 if wide else 40)]
    code, bits = numbers("2h", 12 if wide else 70)
    offset = numbers("q", 168)[0] if wide else numbers("f", 108)[0]
    slope, intercept = numbers("2d", 176) if wide else numbers("2f", 112)
    shape = _shape(dim)
    kind = NUMPY_TYPES.get(int(code))
    if kind is None:
        what = REFUSED_TYPES.get(int(code), f"data type {int(code)}")
        raise FileFormatError(f"its voxels must be numbers of labels, got {what}; save the labels as whole numbers")
    if not size <= offset <= MAX_OFFSET:
        raise FileFormatError(f"its voxels must begin at byte {size} to {MAX_OFFSET}, got {offset:g}")
    affine, space, notes = _affine(numbers, wide, shape)
    extensions = bytes(file.read(int(offset) - size))
    dtype = np.dtype(order + kind)
    if bits != 8 * dtype.itemsize:
        notes.append(f"its bitpix states {bits} bits a voxel, its data type {8 * dtype.itemsize}, which were taken")
    values = np.frombuffer(file.read(int(np.prod(shape)) * dtype.itemsize), dtype).reshape(shape, order="F")
    if not file.ends():
        notes.append("it holds more than its header states, which was left out")
    if np.isfinite([slope, intercept]).all() and slope != 0 and (slope, intercept) != (1.0, 0.0):
        values = _scaled(values, slope, intercept)
        notes.append(f"its labels are its numbers times scl_slope {slope:g} plus scl_inter {intercept:g}")
    values, more = label_values(values)
    names = dict[int, str]()
    for key, text in _names(extensions, order):
        word = text.decode("utf-8", "replace")
        if names.setdefault(int(key), word) != word:
            notes.append(f"its label {int(key)} has two names, the first was taken: {shortened(names[int(key)])}")
    layers, segments, absent = segments_of([values], {(0, key): (key, names[key]) for key in names})
    return LabelMap(name, layers, affine, segments, space, (*notes, *more), absent)


def _scaled(values: NDArray[Any], slope: float, intercept: float) -> NDArray[Any]:
    """Return the values that a header scales; raise where that takes whole numbers to others."""
    scaled = values * np.float32(slope) + np.float32(intercept)
    whole_numbers = float(slope).is_integer() and float(intercept).is_integer()
    if values.dtype.kind != "f" and not whole_numbers and not (scaled.min() >= 0 and scaled.max() <= 1):
        raise FileFormatError(
            f"its scl_slope and scl_inter must take its whole numbers to labels, got {slope:g} and {intercept:g}; set "
            "them to 1 and 0 if its numbers are labels"
        )
    return np.asarray(scaled)


def _shape(dim: list[int]) -> tuple[int, ...]:
    """Return the numbers of voxels along three axes."""
    if not 2 <= dim[0] <= 7:
        raise FileFormatError(f"it must have 3 axes, got {dim[0]}; save one volume")
    sizes = dim[1 : dim[0] + 1] + [1] * (3 - dim[0])
    if any(each > 1 for each in sizes[3:]):
        raise FileFormatError(
            f"it must be one volume, got {' x '.join(map(str, sizes[3:]))} of them (a time series or channels); save "
            "one volume of labels"
        )
    return checked_shape(sizes[:3])


def _affine(
    numbers: Callable[[str, int], tuple[Any, ...]], wide: bool, shape: tuple[int, ...]
) -> tuple[Floats, str, list[str]]:
    """Return the map from indices to positions [m], its frame, and notes."""
    if wide:
        spacing, (qform, sform), units = numbers("8d", 104), numbers("2i", 344), int(numbers("i", 500)[0])
        turn, rows = numbers("6d", 352), numbers("12d", 400)
    else:
        spacing, (qform, sform), units = numbers("8f", 76), numbers("2h", 252), int(numbers("B", 123)[0])
        turn, rows = numbers("6f", 256), numbers("12f", 280)
    metres = METRES_BY_CODE.get(units & 7)
    if metres is None:
        raise FileFormatError(f"its unit of length must be metre, millimetre or micrometre, got code {units & 7}")
    edges, notes = np.abs(spacing[1:4]), list[str]()
    if min(spacing[1:4]) < 0:
        notes.append(
            f"its pixdim has a negative length, {min(spacing[1:4]):g}: taken as positive, as qfac alone mirrors"
        )
    if sform <= 0 and not (np.isfinite(edges).all() and edges.all()):
        raise FileFormatError(
            f"its pixdim must be the edges of a voxel, got {lengths_text(edges)}; write them into the header"
        )
    by_turn, turn_notes = _turned(turn, edges, spacing[0]) if qform > 0 else (None, [])
    notes += turn_notes
    if sform > 0:
        by_rows = as_grid(np.vstack([np.reshape(rows, (3, 4)), np.eye(4)[3]]))
        notes += _sform_notes(by_rows, by_turn, edges, shape, 1e3 * metres)
        return RAS_TO_LPS @ in_metres(by_rows, metres), "LPS", notes
    if by_turn is not None:
        return RAS_TO_LPS @ in_metres(by_turn, metres), "LPS", notes
    notes.append("it does not state how the patient lies: sizes of its voxels alone are used, without left and right")
    return in_metres(np.diag([*edges, 1.0]), metres), "", notes


def _turned(turn: tuple[float, ...], edges: Floats, factor: float) -> tuple[Floats, list[str]]:
    """Return the map of a quaternion (b, c, d), an offset and qfac, and notes; as NIfTI's own library reads it."""
    notes, affine, square = list[str](), np.eye(4), float(np.dot(turn[:3], turn[:3]))
    b, c, d = turn[:3]
    a = np.sqrt(max(1.0 - square, 0.0))
    if square > 1.0 - HALF_TURN_ROUNDING:
        a, (b, c, d) = 0.0, np.array(turn[:3]) / np.sqrt(square)
    if square > 1.0 + NORM_ROUNDING:
        notes.append(f"its quaternion must have a length of at most 1, got {np.sqrt(square):.4g}: scaled to 1")
    if factor not in (-1.0, 0.0, 1.0):
        notes.append(f"its qfac must be 1 or -1, got {factor:g}: taken as {-1 if factor < 0 else 1}")
    rotation = np.array(
        [
            [a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)],
            [2 * (b * c + a * d), a * a + c * c - b * b - d * d, 2 * (c * d - a * b)],
            [2 * (b * d - a * c), 2 * (c * d + a * b), a * a + d * d - b * b - c * c],
        ]
    )
    rotation[:, 2] *= -1.0 if factor < 0 else 1.0
    affine[:3, :3], affine[:3, 3] = rotation * edges, turn[3:]
    return affine, notes


def _sform_notes(
    by_rows: Floats, by_turn: Floats | None, edges: Floats, shape: tuple[int, ...], millimetres: float
) -> list[str]:
    """Return in what the qform, or else the sizes of voxels, differ from the sform, which is taken."""
    if by_turn is None:
        sizes = np.linalg.norm(by_rows[:3, :3], axis=0)
        stated = np.isfinite(edges) & (edges > 0)
        if lengths_agree(sizes[stated], edges[stated]):
            return []
        texts = [lengths_text(each, millimetres) for each in (edges, sizes)]
        return [f"its pixdim states voxels of {texts[0]}, its sform {texts[1]}: the sform was taken"]
    if not np.isfinite(by_turn).all():
        return ["its qform has numbers that are not finite: the sform was taken"]
    apart = difference_of_maps(by_rows, by_turn, shape, millimetres)
    return [f"its sform and qform differ by {apart}: the sform was taken"] if apart else []


def _names(extensions: bytes, order: str) -> list[tuple[bytes, bytes]]:
    """Return numbers and names in the extensions of a header, after whose first four bytes they begin."""
    pairs, at = list[tuple[bytes, bytes]](), 4
    while extensions[:1] > b"\0" and at + 8 <= len(extensions):
        size, code = struct.unpack_from(order + "2i", extensions, at)
        if size < 16 or at + size > len(extensions):
            break
        if code == CARET_NAMES:
            pairs += NAME_PATTERN.findall(extensions, at + 8, at + size)
        at += size
    return pairs
