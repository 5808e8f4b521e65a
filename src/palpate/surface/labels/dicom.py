"""DICOM SEG files (part 3 of the standard, A.51): binary, fractional and label map segmentations.

pydicom parses the file; frames may have any order, and empty ones may be left out.
"""

from __future__ import annotations

import io
import warnings
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.arrays import Floats, Ints
from palpate.extras import require
from palpate.faults import FileFormatError, InputError
from palpate.files import shortened
from palpate.surface.labels.label_map import LabelMap, in_metres
from palpate.surface.labels.voxels import MAX_VOXELS, checked_shape, segments_of

SEGMENTATION_CLASSES = ("1.2.840.10008.5.1.4.1.1.66.4", "1.2.840.10008.5.1.4.1.1.66.7")  # SEG, and SEG of label maps
PLAIN_SYNTAXES = ("1.2.840.10008.1.2", "1.2.840.10008.1.2.1", "1.2.840.10008.1.2.2")  # uncompressed
RUN_LENGTH = "1.2.840.10008.1.2.5"
DEFLATED_SYNTAX = b"1.2.840.10008.1.2.1.99"  # whole file, which pydicom would unpack without a limit
HEAD_BYTES = 4096  # in which the file states its transfer syntax
SAME_PLACE = 1e-3  # [mm] along the normal
OFF_GRID = 0.1  # of a step, by which slices may be off
MIN_FRACTION = 0.5  # of the maximum, from which a voxel belongs to a segment


def read_dicom(data: bytes, name: str = "image.dcm") -> LabelMap:
    """Return the label map of a DICOM SEG file."""
    require("pydicom", "reading DICOM SEG files")
    import pydicom

    if DEFLATED_SYNTAX in data[:HEAD_BYTES]:
        raise FileFormatError("it must not be deflated; save it again without compression")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return _label_map(pydicom.dcmread(io.BytesIO(data)), name)
    except InputError:
        raise
    except Exception as error:  # pydicom raises nine kinds and more
        why = shortened(" ".join(str(error).split()), 80)
        raise FileFormatError(f"it is damaged or not a segmentation ({type(error).__name__}: {why})") from error


def _label_map(file: Any, name: str) -> LabelMap:
    if str(file.get("SOPClassUID", "")) not in SEGMENTATION_CLASSES:
        kind = shortened(str(file.get("Modality", "none")), 20)
        raise FileFormatError(f"it must be a DICOM segmentation (SEG), got modality {kind!r}; segment it first")
    frames, rows, columns = int(file.get("NumberOfFrames", 1)), int(file.Rows), int(file.Columns)
    checked_shape([columns, rows, frames], "the number of its voxels")
    groups = file.get("PerFrameFunctionalGroupsSequence", [])
    if len(groups) != frames:
        raise FileFormatError(f"it must describe each of its {frames} frames, got {len(groups)}")
    kind = str(file.SegmentationType)
    shared = file.SharedFunctionalGroupsSequence[0] if file.get("SharedFunctionalGroupsSequence") else None
    affine, slices, count = _grid(groups, shared)
    shape = checked_shape([columns, rows, count], "the box of its frames")
    pixels = _pixels(file, frames, rows, columns)
    names = {int(each.SegmentNumber): str(each.get("SegmentLabel", "")) for each in file.SegmentSequence}
    notes: tuple[str, ...] = ()
    if kind == "LABELMAP":
        layers = [np.zeros(shape, dtype=pixels.dtype, order="F")]
        for frame, place in zip(pixels, slices, strict=True):
            layers[0][:, :, place] = frame.T
        known = {(0, number): (number, text) for number, text in names.items() if number}
    else:
        if kind == "FRACTIONAL":
            pixels = pixels >= MIN_FRACTION * float(file.MaximumFractionalValue)
            notes = ("its fractions were cut at one half",)
        numbers = [int(_first(g, shared, "SegmentIdentificationSequence").ReferencedSegmentNumber) for g in groups]
        layers, places = _stacked(pixels, slices, numbers, shape)
        known = {(place, number): (number, names.get(number, "")) for number, place in places.items()}
        known |= {(0, number): (number, text) for number, text in names.items() if number not in places}
    kept, segments, absent = segments_of(layers, known)
    return LabelMap(name, kept, in_metres(affine, 1e-3), segments, "LPS", notes, absent)


def _first(group: Any, shared: Any, key: str) -> Any:
    """Return the item of a functional group of a frame, or of all frames."""
    item = group.get(key) or (shared.get(key) if shared is not None else None)
    if not item:
        raise FileFormatError(f"each of its frames must have a {key}, got none")
    return item[0]


def _grid(groups: Any, shared: Any) -> tuple[Floats, Ints, int]:
    """Return the map from indices to positions [mm], the slice of each frame, and the number of slices."""
    turns = np.array([_numbers(_first(g, shared, "PlaneOrientationSequence").ImageOrientationPatient) for g in groups])
    if np.ptp(turns, axis=0).max() > SAME_PLACE:
        raise FileFormatError(
            "its frames must be parallel, got different orientations; save a segmentation of one image"
        )
    along, down = turns[0, :3], turns[0, 3:]
    normal = np.cross(along, down)
    measures = _first(groups[0], shared, "PixelMeasuresSequence")
    spacing = _numbers(measures.PixelSpacing)
    corners = np.array([_numbers(_first(g, shared, "PlanePositionSequence").ImagePositionPatient) for g in groups])
    heights = corners @ normal
    steps = np.diff(np.sort(heights))
    steps = steps[steps > SAME_PLACE]
    step = float(measures.get("SpacingBetweenSlices") or measures.get("SliceThickness") or 0.0)
    if len(steps):
        step = float(np.ptp(heights) / np.rint(np.ptp(heights) / steps.min()))
    slices = np.rint((heights - heights.min()) / step)
    if not np.all(np.abs(heights - heights.min() - slices * step) <= OFF_GRID * step):
        raise FileFormatError("its slices must have equal distances, got others; resample it, such as with 3D Slicer")
    if slices.max() > MAX_VOXELS:
        raise FileFormatError("its slices must be at most 2^29, got more")
    affine = np.eye(4)
    affine[:3, :3] = np.column_stack([along * spacing[1], down * spacing[0], normal * step])
    affine[:3, 3] = corners[np.argmin(heights)]
    return affine, slices.astype(np.int64), int(slices.max()) + 1


def _numbers(values: Any) -> Floats:
    return np.array([float(each) for each in values])


def _pixels(file: Any, frames: int, rows: int, columns: int) -> NDArray[Any]:
    """Return the pixels of all frames, shape (frames, rows, columns)."""
    syntax, bits = str(file.file_meta.TransferSyntaxUID), int(file.BitsAllocated)
    if int(file.get("SamplesPerPixel", 1)) != 1 or bits not in (1, 8, 16):
        raise FileFormatError(f"its pixels must be of one channel of 1, 8 or 16 bits, got {bits} bits or colours")
    if syntax == RUN_LENGTH:
        return np.asarray(file.pixel_array).reshape(frames, rows, columns)
    if syntax not in PLAIN_SYNTAXES:
        raise FileFormatError("its pixels must not be compressed as a picture, such as JPEG; save it uncompressed")
    count = frames * rows * columns
    raw = np.frombuffer(file.PixelData, np.uint8)
    if len(raw) < (count * bits + 7) // 8:
        raise FileFormatError(
            f"it is cut short: it must have {(count * bits + 7) // 8} bytes of pixels, got {len(raw)}"
        )
    if bits == 1:
        pixels = np.unpackbits(raw, count=count, bitorder="little").view(bool)
    elif bits == 8:
        pixels = raw[:count]
    else:
        pixels = raw[: 2 * count].view(">u2" if syntax == PLAIN_SYNTAXES[2] else "<u2")
    return pixels.reshape(frames, rows, columns)


def _stacked(
    pixels: NDArray[Any], slices: Ints, numbers: list[int], shape: tuple[int, ...]
) -> tuple[list[NDArray[Any]], dict[int, int]]:
    """Return layers in which segments do not overlap, and the layer of each segment."""
    kind = np.uint8 if max(numbers) <= 0xFF else np.uint16
    layers, places = list[NDArray[Any]](), dict[int, int]()
    for number in sorted(set(numbers)):
        frames = [k for k, each in enumerate(numbers) if each == number]
        place = next(
            (
                at
                for at, layer in enumerate(layers)
                if not any((layer[:, :, slices[k]].T * (pixels[k] != 0)).any() for k in frames)
            ),
            len(layers),
        )
        if place == len(layers):
            checked_shape([*shape[:2], shape[2] * (place + 1)], "its overlapping segments")
            layers.append(np.zeros(shape, dtype=kind, order="F"))
        for k in frames:
            layers[place][:, :, slices[k]][(pixels[k] != 0).T] = number
        places[number] = place
    return layers, places
