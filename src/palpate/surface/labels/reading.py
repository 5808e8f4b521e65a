"""Label maps from files of the formats in `palpate.surface.formats.names`."""

from __future__ import annotations

from pathlib import Path

from palpate.core.faults import FileFormatError, InputError
from palpate.core.files import read_bytes, shortened
from palpate.surface.formats.first_bytes import GZIP_MAGIC, refuse_misnamed
from palpate.surface.formats.names import LABEL_FORMATS, format_of
from palpate.surface.labels.dicom import read_dicom
from palpate.surface.labels.label_map import LabelMap
from palpate.surface.labels.metaimage import read_metaimage
from palpate.surface.labels.names import read_names
from palpate.surface.labels.nifti import read_nifti
from palpate.surface.labels.nrrd import read_nrrd

READER_BY_FORMAT = {
    "nii": read_nifti, "nrrd": read_nrrd, "mha": read_metaimage, "mhd": read_metaimage, "dcm": read_dicom,
}  # fmt: skip
MAX_BYTES = 1 << 30  # of a file


def is_label_map(path: str | Path) -> bool:
    """Return True for the name of a label map by its suffix."""
    return format_of(Path(path))[0] in LABEL_FORMATS


def read_label_map(path: str | Path, names: str | Path | None = None) -> LabelMap:
    """Read a label map, such as TotalSegmentator, nnU-Net and 3D Slicer write it.

    The file is NIfTI (.nii, .nii.gz), NRRD (.nrrd, .seg.nrrd), MetaImage (.mha, .mhd) or DICOM SEG (.dcm), of at most
    2^29 voxels. `names` is a file of names that it lacks (`palpate.surface.labels.names.read_names`). Other files that
    the file names are not read. Voxels are unpacked after the header's limits are checked, and no more of them than it
    states.

    The map is in metres and, where the file states how the patient lies, in LPS.
    """
    path = Path(path)
    refuse_misnamed(path)
    kind, packed = format_of(path)
    if kind not in LABEL_FORMATS or (packed and kind != "nii"):
        raise FileFormatError(f"{path} must be a label map of {', '.join(LABEL_FORMATS.values())}, got {path.suffix!r}")
    data = read_bytes(path, "label map", MAX_BYTES)
    if packed and data[:2] != GZIP_MAGIC:
        raise FileFormatError(f"{path} must be compressed by gzip, as its name ends in .gz; rename it")
    try:
        labels = READER_BY_FORMAT[kind](data, path.name)
    except InputError as error:
        raise type(error)(f"{path} cannot be read as {LABEL_FORMATS[kind]}: {error}") from error
    except (ArithmeticError, LookupError, MemoryError, RecursionError, TypeError, ValueError) as error:
        why = shortened(str(error))
        raise FileFormatError(f"{path} is damaged ({type(error).__name__}: {why}); save it again") from error
    return labels if names is None else labels.with_names(read_names(names))
