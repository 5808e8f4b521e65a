"""NRRD: values, frames and layers, and the segments of 3D Slicer."""

from __future__ import annotations

import numpy as np
import pytest
from label_files import AFFINE, blocks, nrrd

from palpate.faults import FileFormatError
from palpate.surface.labels.nrrd import read_nrrd

METRES = np.diag([1e-3, 1e-3, 1e-3, 1.0])


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("endian", ["little", "big"])
@pytest.mark.parametrize("dtype", ["u1", "i2", "f4"])
def test_values_and_positions_are_those_of_the_header(dtype, endian, packed):
    labels = read_nrrd(nrrd(blocks(dtype), packed=packed, endian=endian))
    assert np.array_equal(labels.layers[0], blocks())
    assert np.allclose(labels.affine, METRES @ AFFINE)
    assert (labels.space, labels.notes) == ("LPS", ())


@pytest.mark.parametrize(
    ("space", "signs"), [("RAS", (-1, -1, 1)), ("right-anterior-superior", (-1, -1, 1)), ("LAS", (1, -1, 1))]
)
def test_every_anatomical_space_is_turned_to_lps(space, signs):
    assert np.allclose(read_nrrd(nrrd(blocks(), space=space)).affine, np.diag([*signs, 1]) @ METRES @ AFFINE)


def test_without_a_space_it_is_lps_with_a_note_and_of_another_one_sides_are_unknown():
    labels = read_nrrd(nrrd(blocks(), space=""))
    assert np.allclose(labels.affine, METRES @ AFFINE)
    assert (labels.space, labels.notes) == ("LPS", ("it states no space: taken as LPS, as ITK does",))
    assert read_nrrd(nrrd(blocks(), space="3D-right-handed")).space == ""


def test_layers_hold_segments_that_overlap_with_their_names():
    second = (blocks() > 0).astype("u1")
    lines = [
        "Segment0_Name:=liver", "Segment0_Layer:=0", "Segment0_LabelValue:=1",
        "Segment1_Name:=stomach", "Segment1_Layer:=0", "Segment1_LabelValue:=7",
        "Segment2_Name:=both", "Segment2_Layer:=1", "Segment2_LabelValue:=1",
        "Segment3_Name:=spleen", "Segment3_Layer:=1", "Segment3_LabelValue:=4",
    ]  # fmt: skip
    data = nrrd(np.stack([blocks(), second]), kinds="list domain domain domain", lines=lines)
    labels = read_nrrd(data)
    assert [(each.name, each.layer, each.value, each.count) for each in labels.segments] == [
        ("liver", 0, 1, 80), ("stomach", 0, 7, 45), ("both", 1, 1, 125)
    ]  # fmt: skip
    assert len({each.number for each in labels.segments}) == 3
    assert labels.absent == ("spleen",)
    assert all(layer.flags.f_contiguous for layer in labels.layers)


def test_an_old_slicer_wrote_ras_and_the_origin_of_the_uncropped_image():
    lines = ["Segmentation_Extent:=3 14 4 13 5 12", "Segment0_Name:=bladder"]
    values = (blocks() > 0).astype("u1")[..., None]
    data = nrrd(values, space="", lines=lines)
    begin, end = data.index(b"space directions"), data.index(b"\nendian")
    origin_begin, origin_end = data.index(b"space origin"), data.index(b"\nSegmentation")
    data = (
        data[:begin] + b"space directions: (2,0,0,0) (0,3,0,0) (0,0,4,0) (0,0,0,1)" + data[end:origin_begin]
        + b"space origin: (10,20,30,0)" + data[origin_end:]
    )  # fmt: skip
    labels = read_nrrd(data)
    expected = np.diag([2.0, 3.0, 4.0, 1.0])
    expected[:3, 3] = [10 + 3 * 2, 20 + 4 * 3, 30 + 5 * 4]
    assert np.allclose(labels.affine, np.diag([-1, -1, 1, 1]) @ METRES @ expected)
    assert labels.segments[0].name == "bladder"


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ((b"encoding: gzip", b"encoding: bzip2"), "raw or gzip"),
        ((b"sizes: 12 10 8", b"sizes: 4294967296 4294967296 4294967296"), r"at most 2\^29"),
        ((b"sizes: 12 10 8", b"sizes: 12 -10 8"), "whole numbers"),
        ((b"sizes: 12 10 8", b"sizes: 12 10"), "of 3 axes, got 2"),
        ((b"sizes: 12 10 8", b"sizes: 12 10 9"), "cut short"),
        ((b"type: uchar", b"type: block"), "that of numbers"),
        ((b"dimension: 3", b"dimension: 7"), "2 to 4"),
        ((b"# made by a test", b"data file: /etc/passwd"), "in the same file"),
        ((b"# made by a test", b"byte skip: 9"), "byte skip must be 0"),
        ((b"(1.8999999999999999,", b"(nan,"), "orientation"),
        ((b"NRRD0005", b"NURD0005"), "begin with NRRD000"),
        ((b"\n\n", b"\n"), "blank line"),
    ],
)
def test_headers_that_lie_are_refused_by_name(change, message):
    data = nrrd(blocks())
    assert change[0] in data
    with pytest.raises(FileFormatError, match=message):
        read_nrrd(data.replace(*change, 1))


def test_colours_and_series_are_refused():
    four = np.stack([blocks()] * 3)
    with pytest.raises(FileFormatError, match="got rgb-color"):
        read_nrrd(nrrd(four, kinds="RGB-color domain domain domain"))
    with pytest.raises(FileFormatError, match="must be one volume"):
        read_nrrd(nrrd(four))
