"""Label maps whose names lack the suffix of their format, as DICOM files of an archive do, by their first bytes."""

from __future__ import annotations

import os
import zlib
from itertools import islice
from pathlib import Path, PurePath

from palpate.core.faults import FileFormatError
from palpate.core.files import shortened
from palpate.surface.formats.names import GZIP_SUFFIX, LABEL_FORMATS, SURFACE_FORMATS, format_of

SEGMENTATION_CLASSES = ("1.2.840.10008.5.1.4.1.1.66.4", "1.2.840.10008.5.1.4.1.1.66.7")  # SEG, and SEG of label maps
GZIP_MAGIC = b"\x1f\x8b"
HEAD_BYTES, MAX_LISTED = 4096, 1000  # of a file whose name does not state its format; files of a folder
# suffix of a file that has bytes at a place
MAGIC_BYTES = (
    (".dcm", 128, b"DICM"), (".nrrd", 0, b"NRRD000"), (".nii", 344, b"n+1\0"), (".nii", 4, b"n+2\0"),
    (".mha", 0, b"ObjectType"),
)  # fmt: skip


def refuse_misnamed(path: Path) -> None:
    """Raise `FileFormatError` for a label map whose name lacks its suffix, and for a folder of DICOM files."""
    if os.path.isdir(path):  # False also for a name that is too long
        files = sorted(each for each in islice(path.iterdir(), MAX_LISTED) if _suffix_of(each) == ".dcm")
        segmentations = [each.name for each in files if _states_segmentation(each)]
        if segmentations:
            name = shortened(segmentations[0])
            raise FileFormatError(
                f"{path} is a folder: give its DICOM segmentation, {name}, and let its name end in .dcm"
            )
        if files:
            raise FileFormatError(f"{path} is a folder of DICOM images without a segmentation; segment them first")
        return
    suffix = "" if format_of(path)[0] in (*LABEL_FORMATS, *SURFACE_FORMATS) else _suffix_of(path)
    if suffix:
        raise FileFormatError(
            f"{path} is {LABEL_FORMATS[format_of(PurePath('a' + suffix))[0]]} by its first bytes, not by its name: "
            f"rename it to end in {suffix}"
        )


def _suffix_of(path: Path) -> str:
    """Return the suffix that the first bytes of a regular file ask for; empty for other files."""
    head, packed = _head(path)
    suffix = next((suffix for suffix, at, magic in MAGIC_BYTES if head[at : at + len(magic)] == magic), "")
    return f"{suffix}.{GZIP_SUFFIX}" if packed and suffix == ".nii" else suffix


def _states_segmentation(path: Path) -> bool:
    return any(each.encode() in _head(path)[0] for each in SEGMENTATION_CLASSES)


def _head(path: Path) -> tuple[bytes, bool]:
    """Return the first bytes of a regular file, and whether they were compressed by gzip."""
    try:
        if not path.is_file():
            return b"", False
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
        if head[:2] != GZIP_MAGIC:
            return head, False
        return zlib.decompressobj(32 + zlib.MAX_WBITS).decompress(head, HEAD_BYTES), True
    except (OSError, ValueError, zlib.error):
        return b"", False
