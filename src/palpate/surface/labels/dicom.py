"""DICOM SEG files (part 3 of the standard, A.51): binary, fractional and label map segmentations.

pydicom parses the file; frames may have any order, and empty ones may be left out.
"""

from __future__ import annotations

import io
import warnings
from collections import Counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.core.arrays import Floats, Ints
from palpate.core.extras import require
from palpate.core.faults import FileFormatError, InputError
from palpate.core.files import shortened
from palpate.surface.formats.first_bytes import SEGMENTATION_CLASSES
from palpate.surface.labels.agreement import lengths_agree, lengths_text
from palpate.surface.labels.frames import grid_of_frames
from palpate.surface.labels.label_map import LabelMap, in_metres
from palpate.surface.labels.voxels import checked_shape, segments_of

PLAIN_SYNTAXES = ("1.2.840.10008.1.2", "1.2.840.10008.1.2.1", "1.2.840.10008.1.2.2")  # uncompressed
RUN_LENGTH = "1.2.840.10008.1.2.5"
DEFLATED_SYNTAX = b"1.2.840.10008.1.2.1.99"  # whole file, which pydicom would unpack without a limit
HEAD_BYTES = 4096  # in which the file states its transfer syntax
# functional groups and attributes of frames of a time series
TIME_STATEMENTS = (
    ("FrameContentSequence", "TemporalPositionIndex"), ("TemporalPositionSequence", "TemporalPositionTimeOffset"),
    ("CardiacSynchronizationSequence", "NominalCardiacTriggerDelayTime"),
    ("CardiacSynchronizationSequence", "NominalPercentageOfCardiacPhase"),
    ("RespiratorySynchronizationSequence", "NominalPercentageOfRespiratoryPhase"),
)  # fmt: skip
SAME_TURN, MAX_TURN_ERROR = 1e-3, 1e-2  # of the cosines of frames, and from two unit vectors at right angles
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
    _check_times(file, groups)
    affine, slices, count, notes = grid_of_frames(*_places(groups, shared), _thicknesses(groups, shared))
    shape = checked_shape([columns, rows, count], "the box of its frames")
    pixels = _pixels(file, frames, rows, columns)
    names = _names(file)
    if kind == "LABELMAP":
        _check_places(groups, slices, [0] * frames, names)
        pixels = _without_padding(pixels, file, names)
        layers = [np.zeros(shape, dtype=pixels.dtype, order="F")]
        for frame, place in zip(pixels, slices, strict=True):
            layers[0][:, :, place] = frame.T
        known = {(0, number): (number, text) for number, text in names.items() if number}
    else:
        if kind == "FRACTIONAL":
            most = int(file.MaximumFractionalValue)
            if most < 1:
                raise FileFormatError(f"its MaximumFractionalValue must be at least 1, got {most}; correct it")
            pixels = pixels >= MIN_FRACTION * most
            notes.append("its fractions were cut at one half")
        numbers = [int(_first(g, shared, "SegmentIdentificationSequence").ReferencedSegmentNumber) for g in groups]
        _check_places(groups, slices, numbers, names)
        layers, places = _stacked(pixels, slices, numbers, shape)
        known = {(place, number): (number, names.get(number, "")) for number, place in places.items()}
        known |= {(0, number): (number, text) for number, text in names.items() if number not in places}
    stored, segments, absent = segments_of(layers, known)
    return LabelMap(name, stored, in_metres(affine, 1e-3), segments, "LPS", tuple(notes), absent)


def _names(file: Any) -> dict[int, str]:
    """Return the names of segments by number."""
    pairs = [(int(each.SegmentNumber), str(each.get("SegmentLabel", ""))) for each in file.SegmentSequence]
    for number, times in Counter(number for number, _ in pairs).items():
        if times > 1:
            raise FileFormatError(f"its segments must have numbers of their own, got {number} for {times} of them")
    return dict(pairs)


def _without_padding(pixels: NDArray[Any], file: Any, names: dict[int, str]) -> NDArray[Any]:
    """Return the pixels of a label map, 0 where they have the value that stands for no segment."""
    padding = file.get("PixelPaddingValue")
    if padding in (None, 0):
        return pixels
    if 0 in names and (pixels == 0).any():
        raise FileFormatError("its segments must have numbers of at least 1, got 0 and another value for outside")
    return np.where(pixels == int(padding), pixels.dtype.type(0), pixels)


def _times(group: Any, indices: list[int]) -> tuple[str, ...]:
    """Return what states the time or phase of a frame, also those of its indices of dimensions that are times."""
    content = group.get("FrameContentSequence")
    values = np.atleast_1d(content[0].get("DimensionIndexValues", [])).tolist() if content and indices else []
    words = [f"index {values[k]}" for k in indices if k < len(values)]
    for sequence, word in TIME_STATEMENTS:
        item = group.get(sequence)
        if item and word in item[0]:
            words.append(f"{word} {shortened(str(item[0][word].value), 20)}")
    return tuple(words)


def _check_times(file: Any, groups: Any) -> None:
    """Raise `FileFormatError` for frames of several phases or times."""
    from pydicom.datadict import keyword_for_tag

    dimensions = [str(keyword_for_tag(each.DimensionIndexPointer)) for each in file.get("DimensionIndexSequence", [])]
    indices = [k for k, word in enumerate(dimensions) if word in {name for _, name in TIME_STATEMENTS}]
    times = dict.fromkeys(_times(group, indices) for group in groups)
    if len(times) > 1:
        first, second = (" and ".join(each) or "none" for each in list(times)[:2])
        raise FileFormatError(
            f"it must be one volume, got frames of {len(times)} times or phases ({first}; {second}); save one of them"
        )


def _check_places(groups: Any, slices: Ints, numbers: list[int], names: dict[int, str]) -> None:
    """Raise `FileFormatError` for several frames of a segment at the same place."""
    (place, number), times = Counter(zip(slices.tolist(), numbers, strict=True)).most_common(1)[0]
    if times > 1:
        stacks = {str(each[0].get("StackID", "")) for g in groups if (each := g.get("FrameContentSequence"))} - {""}
        name = shortened(names.get(number) or f"segment {number}") if number else "its label map"
        raise FileFormatError(
            f"it must be one volume, got {times} frames of {name} at the same place (slice {place + 1}), as of phases, "
            f"times or {f'its {len(stacks)} ' * (len(stacks) > 1)}stacks; save one of them"
        )


def _first(group: Any, shared: Any, key: str) -> Any:
    """Return the item of a functional group of a frame, or of all frames."""
    item = group.get(key) or (shared.get(key) if shared is not None else None)
    if not item:
        raise FileFormatError(f"each of its frames must have a {key}, got none")
    return item[0]


def _places(groups: Any, shared: Any) -> tuple[Floats, Floats, Floats]:
    """Return orientation (6,), edges of pixels (2,) [mm] and the places (frames, 3) [mm] of frames."""
    turns = np.array([_numbers(_first(g, shared, "PlaneOrientationSequence").ImageOrientationPatient) for g in groups])
    if np.ptp(turns, axis=0).max() > SAME_TURN:
        raise FileFormatError(
            "its frames must be parallel, got different orientations; save a segmentation of one image"
        )
    axes = turns[0].reshape(2, 3)
    if np.abs(axes @ axes.T - np.eye(2)).max() > MAX_TURN_ERROR:
        raise FileFormatError(
            f"its ImageOrientationPatient must be two unit vectors at right angles, got {axes.round(3).tolist()}; "
            "correct it"
        )
    edges = np.array([_numbers(_first(g, shared, "PixelMeasuresSequence").PixelSpacing) for g in groups])
    if not (np.isfinite(edges).all() and (edges > 0).all()):
        raise FileFormatError(f"its PixelSpacing must be above 0, got {lengths_text(edges.min(axis=0))}; correct it")
    if not lengths_agree(edges[0], edges):
        raise FileFormatError(
            f"its frames must have pixels of one size, got {lengths_text(edges.min(axis=0))} to "
            f"{lengths_text(edges.max(axis=0))}; save a segmentation of one image"
        )
    places = np.array([_numbers(_first(g, shared, "PlanePositionSequence").ImagePositionPatient) for g in groups])
    if not np.isfinite(places).all():
        raise FileFormatError("its frames must be at finite places, got others; correct its ImagePositionPatient")
    return turns[0], edges[0], places


def _thicknesses(groups: Any, shared: Any) -> list[list[float]]:
    """Return the different SpacingBetweenSlices and SliceThickness of frames [mm], those above zero."""
    measures = [_first(g, shared, "PixelMeasuresSequence") for g in groups]
    words = ("SpacingBetweenSlices", "SliceThickness")
    spacings, thicknesses = ({abs(float(each.get(word) or 0.0)) for each in measures} for word in words)
    return [sorted(each for each in lengths if 0.0 < each < np.inf) for lengths in (spacings, thicknesses)]


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
