"""Label maps that are damaged or forged: headers that lie, bombs, sheared axes, other types, cut streams, nested DICOM.

`fuzz.py` runs these trials as kinds ``labels nii``, ``labels nii.gz``, ``labels nrrd``, ``labels mha`` and, with
pydicom, ``labels dcm``. A trial fails if a file takes more than 2 s of computing time beyond 1 µs for each voxel that
its header states, or if another file than the trial's own is opened.
"""

from __future__ import annotations

import gzip
import io
import re
import struct
import sys
import time
import zlib
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

import palpate as pt
from palpate.surface.files import surface_of_labels
from palpate.surface.labels.reading import read_label_map

Rng = np.random.Generator

MAX_SECONDS, SECONDS_PER_VOXEL = 2.0, 1e-6  # of computing time
BOMB_BYTES = 1 << 24  # to which a forged stream unpacks
NUMBERS = ("0", "-1", "1", "2", "7", "255", "65536", "1e9", "2147483648", "4294967296", "nan", "inf", "1e-300", "x", "")
SHORTS = (0, 1, 2, 3, 4, 7, 9, 16, 64, 128, 256, 512, 1024, 2304, 32767, -1, -32768)


def organs(rng: Rng) -> np.ndarray:
    """Return an image of two organs, or of noise."""
    size = int(rng.integers(8, 28))
    x, y, z = np.meshgrid(*[np.arange(size) - size / 2] * 3, indexing="ij")
    values = (x * x + y * y + z * z < (0.4 * size) ** 2).astype("u1") * (1 + (x > 0))
    if rng.random() < 0.2:
        values = values * (rng.random(values.shape) < rng.random())
    return values.astype(rng.choice(["u1", "<i2", "<f4"]))


def nifti(rng: Rng, values: np.ndarray) -> bytes:
    """Return a NIfTI-1 file of which some numbers of the header are others."""
    head = bytearray(348)
    code = {"u1": 2, "i2": 4, "f4": 16}[values.dtype.str[1:]]
    struct.pack_into("<i", head, 0, 348)
    struct.pack_into("<8h", head, 40, 3, *values.shape, 1, 1, 1, 1)
    struct.pack_into("<2h", head, 70, code, 8 * values.itemsize)
    struct.pack_into("<8f", head, 76, 1, 2, 2, 2, 1, 1, 1, 1)
    struct.pack_into("<3f", head, 108, 352, 0, 0)
    head[123] = 2
    struct.pack_into("<2h", head, 252, int(rng.integers(2)), int(rng.integers(2)))
    struct.pack_into("<12f", head, 280, *np.ravel(_affine(rng)[:3]))
    head[344:348] = b"n+1\0"
    for _ in range(int(rng.integers(3))):
        at = int(rng.choice([*range(40, 56, 2), 70, 108, 112, 116, 123, 252, 254, *range(256, 328, 4)]))
        form = "<f" if at >= 256 or 76 <= at < 120 else "B" if at == 123 else "<h"
        number = float(rng.choice([0, -1, 1e-30, 1e30, np.nan, np.inf, 352, 1e6, 0.3])) if form == "<f" else (
            int(rng.integers(256)) if form == "B" else int(rng.choice(SHORTS)))  # fmt: skip
        struct.pack_into(form, head, at, number)
    extension = b"\0\0\0\0"
    if rng.random() < 0.3:
        text = b'<Label Key="1" A="%s"><![CDATA[%s]]></Label>' % (b"a" * int(rng.integers(300)), b"n" * 9)
        text *= int(rng.integers(1, 2000))
        extension = b"\1\0\0\0" + struct.pack("<2i", int(rng.choice([len(text) + 8, 8, 0, -1, 2**30])), 0) + text
        struct.pack_into("<f", head, 108, 348 + len(extension))
    return bytes(head) + extension + values.tobytes(order="F")


def _affine(rng: Rng) -> np.ndarray:
    """Return an affine map, sometimes sheared, thin, huge or mirrored."""
    affine = np.diag([*rng.choice([2.0, 2.0, 2.0, 0.1, 30.0, -2.0, 1e-3, 99.0], 3), 1.0])
    if rng.random() < 0.3:
        affine[:3, :3] += rng.normal(size=(3, 3))
    return affine


def nrrd(rng: Rng, values: np.ndarray) -> bytes:
    """Return an NRRD file, packed or not, of which some numbers of the header are others."""
    affine = _affine(rng)
    kind = {"u1": "uchar", "i2": "short", "f4": "float"}[values.dtype.str[1:]]
    vectors = " ".join("(" + ",".join(map(str, affine[:3, k])) + ")" for k in range(3))
    packed = bool(rng.integers(2))
    lines = [
        "NRRD0004", f"type: {kind}", "dimension: 3", "space: left-posterior-superior",
        "sizes: " + " ".join(map(str, values.shape)), f"space directions: {vectors}", "kinds: domain domain domain",
        "endian: little", f"encoding: {'gzip' if packed else 'raw'}", "space origin: (0,0,0)",
        "Segment0_Name:=liver", "Segment0_LabelValue:=1", "Segment0_Layer:=0",
    ]  # fmt: skip
    if rng.random() < 0.2:
        lines.insert(2, "data file: /etc/passwd")
    data = values.tobytes(order="F")
    return _lying("\n".join(lines), rng) + b"\n\n" + (_packed(rng, data, gzip.compress) if packed else data)


def metaimage(rng: Rng, values: np.ndarray) -> bytes:
    """Return a MetaImage file of which some numbers of the header are others."""
    kind = {"u1": "MET_UCHAR", "i2": "MET_SHORT", "f4": "MET_FLOAT"}[values.dtype.str[1:]]
    packed = bool(rng.integers(2))
    lines = [
        "NDims = 3", "BinaryData = True", f"CompressedData = {packed}",
        "TransformMatrix = " + " ".join(map(str, np.ravel(_affine(rng)[:3, :3]))), "Offset = 0 0 0",
        "ElementSpacing = 2 2 2", "DimSize = " + " ".join(map(str, values.shape)), f"ElementType = {kind}",
        f"ElementDataFile = {rng.choice(['LOCAL'] * 9 + ['/etc/passwd'])}",
    ]  # fmt: skip
    data = values.tobytes(order="F")
    return _lying("\n".join(lines), rng) + b"\n" + (_packed(rng, data, zlib.compress) if packed else data)


def _lying(text: str, rng: Rng) -> bytes:
    """Return a header of which up to two numbers are others."""
    for _ in range(int(rng.integers(3))):
        numbers = list(re.finditer(r"(?<=[ (,=:])-?\d[\d.e+-]*", text))
        match = numbers[int(rng.integers(len(numbers)))]
        text = text[: match.start()] + str(rng.choice(NUMBERS)) + text[match.end() :]
    return text.encode()


def _packed(rng: Rng, data: bytes, compress: Callable[[bytes], bytes]) -> bytes:
    """Return a stream, which sometimes is cut, holds much more than it should, or is of many members."""
    how = rng.random()
    if how < 0.1:
        return compress(data + bytes(int(rng.integers(BOMB_BYTES))))
    if how < 0.2:
        return compress(data)[: int(rng.integers(1, len(data) + 1))]
    if how < 0.25:
        return compress(b"") * int(rng.integers(30_000)) + compress(data)
    return compress(data)


def bomb(rng: Rng) -> bytes:
    """Return a NIfTI file of few bytes that rightly states many voxels."""
    size = int(rng.integers(60, 200))
    values = np.zeros((size,) * 3, dtype="u1")
    step = int(rng.integers(2, 40))
    values[:: int(rng.choice([1, step])), ::step, :: int(rng.choice([1, step]))] = 1
    values[: size // 2, : size // 2, : size // 2] = 2
    return gzip.compress(nifti(np.random.default_rng(1), values), 1)


def compose(suffix: str, rng: Rng) -> bytes:
    """Return a file of a format."""
    if suffix == "nii.gz" and rng.random() < 0.1:
        return bomb(rng)
    values = organs(rng)
    if suffix.startswith("nii"):
        data = nifti(rng, values)
        return _packed(rng, data, gzip.compress) if suffix == "nii.gz" else data
    return nrrd(rng, values) if suffix == "nrrd" else metaimage(rng, values)


def dicom(folder: Path) -> bytes:
    """Return a small DICOM SEG file of two segments that overlap."""
    from pydicom.dataset import Dataset, FileMetaDataset
    from pydicom.sequence import Sequence
    from pydicom.uid import ExplicitVRLittleEndian

    def item(**values: Any) -> Any:
        made = Dataset()
        for key, value in values.items():
            setattr(made, key, value)
        return made

    size, frames = 12, []
    for segment in (1, 2):
        for z in range(8):
            plane = [item(ImagePositionPatient=[0, 0, 3.0 * z])]
            number = [item(ReferencedSegmentNumber=segment)]
            frames.append(item(PlanePositionSequence=plane, SegmentIdentificationSequence=number))
    pixels = np.zeros((16, size, size), dtype=bool)
    pixels[1:7, 3:9, 3:9], pixels[10:15, 2:8, 2:8] = True, True
    measures = [item(PixelSpacing=[2, 2], SliceThickness=3)]
    shared = item(
        PixelMeasuresSequence=measures, PlaneOrientationSequence=[item(ImageOrientationPatient=[1, 0, 0, 0, 1, 0])]
    )
    file = item(
        SOPClassUID="1.2.840.10008.5.1.4.1.1.66.4", Modality="SEG", SegmentationType="BINARY", Rows=size, Columns=size,
        NumberOfFrames=16, SamplesPerPixel=1, BitsAllocated=1, BitsStored=1, HighBit=0, PixelRepresentation=0,
        SharedFunctionalGroupsSequence=[shared], PerFrameFunctionalGroupsSequence=frames,
        SegmentSequence=Sequence([item(SegmentNumber=k, SegmentLabel=f"organ {k}") for k in (1, 2)]),
        PixelData=np.packbits(pixels.ravel(), bitorder="little").tobytes(),
    )  # fmt: skip
    file.file_meta = FileMetaDataset()
    file.file_meta.TransferSyntaxUID = ExplicitVRLittleEndian
    file.file_meta.MediaStorageSOPClassUID = file.SOPClassUID
    file.file_meta.MediaStorageSOPInstanceUID = file.SOPInstanceUID = "1.2.3"
    stream = io.BytesIO()
    file.save_as(stream, enforce_file_format=True)
    return stream.getvalue()


def read_and_use(path: Path, rng: Rng) -> str:
    """Read a label map and make the surface of one of its labels; check the time and which files were opened."""
    opened = list[str]()
    watching = [True]

    def watch(event: str, arguments: tuple[Any, ...]) -> None:
        if watching[0] and event == "open" and isinstance(arguments[0], str):
            opened.append(arguments[0])

    sys.addaudithook(watch)
    began, voxels = time.process_time(), 0
    try:
        labels = read_label_map(path)
        voxels = labels.layers[0].size * len(labels.layers)
        segment = labels.segments[int(rng.integers(len(labels.segments)))]
        answer = "accepted" if surface_of_labels(labels, str(segment.number)).closed else "an open surface"
    except pt.InputError as error:
        answer = "refused" if "\n" not in str(error) else "a message that is not one line"
    finally:
        watching[0] = False
    seconds = time.process_time() - began
    others = {each for each in opened if each.endswith(("passwd", ".raw")) or "etc/" in each}
    if others:
        return f"opened {sorted(others)}"
    return answer if seconds <= MAX_SECONDS + SECONDS_PER_VOXEL * voxels else f"slow: {seconds:.1f} s, {voxels} voxels"


SUFFIXES = ("nii", "nii.gz", "nrrd", "mha", *(("dcm",) if find_spec("pydicom") else ()))
