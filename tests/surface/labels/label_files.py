"""Label maps written byte by byte from the specifications of their formats, and an image with known voxels."""

from __future__ import annotations

import gzip
import struct
import zlib

import numpy as np

# [mm] of an oblique and sheared grid, as rows (x, y, z), in RAS for NIfTI
AFFINE = np.array([[1.9, 0.3, 0.1, -40.0], [-0.2, 1.4, 0.2, 12.0], [0.1, 0.1, 3.0, -7.0], [0, 0, 0, 1]])
# forms and places of the fields of a header
FIELDS = {
    "dim": "8h 40", "datatype": "h 70", "bitpix": "h 72", "pixdim": "8f 76", "vox_offset": "f 108", "scl": "2f 112",
    "codes": "2h 252", "quatern": "6f 256", "srow": "12f 280", "xyzt_units": "B 123",
}  # fmt: skip
WIDE_FIELDS = {
    "dim": "8q 16", "datatype": "h 12", "bitpix": "h 14", "pixdim": "8d 104", "vox_offset": "q 168", "scl": "2d 176",
    "codes": "2i 344", "quatern": "6d 352", "srow": "12d 400", "xyzt_units": "i 500",
}  # fmt: skip
RAS_TO_LPS = np.diag([-1.0, -1.0, 1.0, 1.0])


def blocks(dtype="u1"):
    """Return an image (12, 10, 8) of labels 1, a box, and 7, another one at its side."""
    values = np.zeros((12, 10, 8), dtype=dtype)
    values[2:6, 3:8, 2:6] = 1
    values[6:9, 3:8, 2:5] = 7
    return values


def ball(radius=9.0, size=24, dtype="u1"):
    """Return a ball of label 1 in a cube of voxels."""
    axes = np.arange(size) - (size - 1) / 2
    x, y, z = np.meshgrid(axes, axes, axes, indexing="ij")
    return (x * x + y * y + z * z <= radius * radius).astype(dtype)


def caret(names):
    """Return the extension of a NIfTI file in which TotalSegmentator writes names by number."""
    labels = "".join(f'<Label Key="{k}" Red="0.5" Alpha="1"><![CDATA[{name}]]></Label>' for k, name in names.items())
    text = f"<?xml version='1.0'?><CaretExtension><LabelTable>{labels}</LabelTable></CaretExtension>".encode()
    text += b"\0" * (-(len(text) + 8) % 16)
    return b"\1\0\0\0" + struct.pack("<2i", len(text) + 8, 0) + text


def nifti(values, *, sform=AFFINE, qform=None, units=2, order="<", wide=False, extension=b"\0\0\0\0", **changes):
    """Return a NIfTI file; `qform` is (voxel edges, quaternion b c d, offset, qfac); `changes` are by field."""
    code = {"u1": 2, "i2": 4, "i4": 8, "f4": 16, "f8": 64, "i1": 256, "u2": 512, "u4": 768}[values.dtype.str[1:]]
    sizes = (1, 1, 1) if sform is None else np.linalg.norm(sform[:3, :3], axis=0)
    edges, turn, offset, factor = qform or (sizes, (0, 0, 0), (0, 0, 0), 1)
    at = WIDE_FIELDS if wide else FIELDS
    size = 540 if wide else 348
    shape = list(values.shape) + [1] * (7 - values.ndim)
    fields = {
        "dim": [values.ndim, *shape], "datatype": [code], "bitpix": [8 * values.itemsize],
        "pixdim": [factor, *edges, 1, 1, 1, 1], "vox_offset": [size + len(extension)], "scl": [0, 0],
        "codes": [int(qform is not None), int(sform is not None)], "quatern": [*turn, *offset],
        "srow": np.ravel((np.eye(4) if sform is None else sform)[:3]), "xyzt_units": [units],
    } | changes  # fmt: skip
    head = bytearray(size)
    struct.pack_into(order + "i", head, 0, size)
    for key, numbers in fields.items():
        form, place = at[key].split()
        struct.pack_into(order + form, head, int(place), *numbers)
    if wide:
        head[4:12] = b"n+2\0\r\n\x1a\n"
    else:
        head[344:348] = b"n+1\0"
    return bytes(head) + extension + values.astype(values.dtype.newbyteorder(order)).tobytes(order="F")


def dicom(frames, places, numbers=None, names=None, *, kind="BINARY", turn=(1, 0, 0, 0, 1, 0), **changes):
    """Return a DICOM SEG file (which needs pydicom).

    Places are those of the frames [mm]; `changes` of measures (``thickness``, ``between``) are of all frames, or lists
    of one for each, and those of ``times`` and ``stacks`` are for each. Other changes are attributes of the file.
    """
    from io import BytesIO

    from pydicom.dataset import Dataset, FileMetaDataset

    def item(**attributes):
        made = Dataset()
        for key, value in attributes.items():
            setattr(made, key, value)
        return made

    each = {key: changes.pop(key, None) for key in ("times", "stacks", "turns", "spacings")}
    measures = {word: changes.pop(key, None) for key, word in
                (("thickness", "SliceThickness"), ("between", "SpacingBetweenSlices"))}  # fmt: skip
    file, meta, bits = Dataset(), FileMetaDataset(), 1 if kind == "BINARY" else 8
    meta.TransferSyntaxUID = "1.2.840.10008.1.2.1"
    meta.MediaStorageSOPClassUID = "1.2.840.10008.5.1.4.1.1.66." + ("7" if kind == "LABELMAP" else "4")
    meta.MediaStorageSOPInstanceUID = file.SOPInstanceUID = "1.2.3.4"
    file.file_meta, file.SOPClassUID, file.Modality, file.SegmentationType = meta, meta[0x20002].value, "SEG", kind
    file.NumberOfFrames, file.Rows, file.Columns = frames.shape
    file.SamplesPerPixel, file.PhotometricInterpretation, file.PixelRepresentation = 1, "MONOCHROME2", 0
    file.BitsAllocated, file.BitsStored, file.HighBit = bits, bits, bits - 1
    groups = []
    for k, place in enumerate(places):
        lengths = {word: value[k] if isinstance(value, list) else value for word, value in measures.items()}
        stated = {word: value for word, value in lengths.items() if value is not None}
        content = {"TemporalPositionIndex": each["times"], "StackID": each["stacks"]}
        content = {word: value[k] for word, value in content.items() if value is not None}
        spacing = [1.0, 1.0] if each["spacings"] is None else each["spacings"][k]
        group = {
            "PixelMeasuresSequence": [item(PixelSpacing=spacing, **stated)],
            "PlaneOrientationSequence": [item(ImageOrientationPatient=list((each["turns"] or {}).get(k, turn)))],
            "PlanePositionSequence": [item(ImagePositionPatient=[float(x) for x in place])],
            "FrameContentSequence": [item(DimensionIndexValues=[1, k + 1], **content)],
        }
        if kind != "LABELMAP":
            number = numbers[k] if numbers else 1
            group["SegmentIdentificationSequence"] = [item(ReferencedSegmentNumber=number)]
        groups.append(item(**group))
    file.PerFrameFunctionalGroupsSequence = groups
    names = (names or {1: "liver"}).items()
    file.SegmentSequence = [item(SegmentNumber=number, SegmentLabel=name) for number, name in names]
    flat = frames.astype("u1").ravel()
    data = (np.packbits(flat, bitorder="little") if bits == 1 else flat).tobytes()
    file.PixelData = data + bytes(len(data) % 2)
    for key, value in changes.items():
        setattr(file, key, value)
    into = BytesIO()
    file.save_as(into, enforce_file_format=True)
    return into.getvalue()


def nrrd(values, *, space="left-posterior-superior", affine=AFFINE, kinds="", packed=True, lines=(), endian="little"):
    """Return an NRRD file; the axis of layers, if there is one, is the first."""
    kind = {"u1": "uchar", "i2": "short", "i4": "int", "f4": "float", "u4": "uint"}[values.dtype.str[1:]]
    vectors = ["(" + ",".join(f"{x:.17g}" for x in affine[:3, k]) + ")" for k in range(3)]
    head = ["NRRD0005", "# made by a test", f"type: {kind}", f"dimension: {values.ndim}"]
    head += [f"space: {space}"] * bool(space) + ["sizes: " + " ".join(map(str, values.shape))]
    head += ["space directions: " + " ".join(["none"] * (values.ndim - 3) + vectors)]
    head += [f"kinds: {kinds}"] * bool(kinds) + [f"endian: {endian}", f"encoding: {'gzip' if packed else 'raw'}"]
    head += ["space origin: (" + ",".join(f"{x:.17g}" for x in affine[:3, 3]) + ")", *lines]
    data = values.astype(values.dtype.newbyteorder("<" if endian == "little" else ">")).tobytes(order="F")
    return "\n".join(head).encode() + b"\n\n" + (gzip.compress(data) if packed else data)


def metaimage(values, *, affine=AFFINE, packed=True, lines=(), data_file="LOCAL", without=()):
    """Return a MetaImage file, without some of its fields."""
    edges = np.linalg.norm(affine[:3, :3], axis=0)
    kind = {"u1": "MET_UCHAR", "i2": "MET_SHORT", "f4": "MET_FLOAT"}[values.dtype.str[1:]]
    data = values.tobytes(order="F")
    data = zlib.compress(data) if packed else data
    rows = {
        "ObjectType": "Image", "NDims": values.ndim, "BinaryData": "True", "BinaryDataByteOrderMSB": "False",
        "CompressedData": packed, "CompressedDataSize": len(data),
        "TransformMatrix": " ".join(f"{x:.17g}" for x in (affine[:3, :3] / edges).T.ravel()),
        "Offset": " ".join(f"{x:.17g}" for x in affine[:3, 3]), "ElementSpacing": " ".join(f"{x:.17g}" for x in edges),
        "DimSize": " ".join(map(str, values.shape)), "ElementType": kind,
    }  # fmt: skip
    text = [f"{key} = {value}" for key, value in rows.items() if key not in without]
    text += [*lines, f"ElementDataFile = {data_file}"]
    return "\n".join(text).encode() + b"\n" + data
