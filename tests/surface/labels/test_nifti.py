"""NIfTI: values and positions by the standard, names of TotalSegmentator, and headers that lie."""

from __future__ import annotations

import gzip
import struct

import numpy as np
import pytest
from label_files import AFFINE, RAS_TO_LPS, blocks, caret, nifti

from palpate.core.faults import FileFormatError
from palpate.surface.labels.nifti import read_nifti


def in_metres(affine, metres=1e-3):
    return RAS_TO_LPS @ np.diag([metres, metres, metres, 1.0]) @ affine


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("wide", [False, True])
@pytest.mark.parametrize("dtype", ["u1", "i2", "f4", "i4"])
def test_values_and_positions_are_those_of_the_header(dtype, wide, order):
    values = blocks(dtype)
    labels = read_nifti(nifti(values, order=order, wide=wide))
    assert np.array_equal(labels.layers[0], values)
    assert np.allclose(labels.affine, in_metres(AFFINE), atol=1e-9 if wide else 1e-8)
    assert [(each.number, each.count) for each in labels.segments] == [(1, 80), (7, 45)]
    assert (labels.space, labels.notes) == ("LPS", ())


def test_a_quaternion_turns_the_voxels_and_qfac_mirrors_the_last_axis():
    angle, edges, offset = 0.7, np.array([1.5, 2.0, 3.0]), (5.0, 6.0, 7.0)
    qform = (edges, (0.0, 0.0, np.sin(angle / 2)), offset, -1)
    cos, sin = np.cos(angle), np.sin(angle)
    expected = np.eye(4)
    expected[:3, :3] = np.array([[cos, -sin, 0], [sin, cos, 0], [0, 0, -1]]) * edges
    expected[:3, 3] = offset
    assert np.allclose(read_nifti(nifti(blocks(), sform=None, qform=qform)).affine, in_metres(expected), atol=1e-8)


SFORM = np.array([[2.0, 0, 0, -39], [0, 2, 0, -39], [0, 0, 3, -39], [0, 0, 0, 1]])
EDGES, OFFSET = (2.0, 2.0, 3.0), (-39.0, -39.0, -39.0)


@pytest.mark.parametrize(
    ("qform", "changes", "words"),
    [
        ((EDGES, (0, 0, 0), OFFSET, 1), {}, None),
        ((EDGES, (1e-5, 0, 0), OFFSET, 0), {}, None),  # of rounding, and qfac 0, which is 1
        ((EDGES, (0, 0, 0), (-29.0, -39.0, -39.0), 1), {}, "by up to 10 mm"),
        (((2.2, 2.0, 3.0), (0, 0, 0), OFFSET, 1), {}, "by up to 2.3 mm"),
        ((EDGES, (0, 0, 0), OFFSET, -1), {}, "mm, and are mirror images"),
        ((EDGES, (0, 0, 1), OFFSET, 1), {}, "by up to 59.7 mm"),
        ((EDGES, (0, 0, 1), OFFSET, 1), {"codes": [1, 2]}, "by up to 59.7 mm"),  # ITK takes the qform of these
        ((EDGES, (np.nan, 0, 0), OFFSET, 1), {}, "qform has numbers that are not finite"),
        (((0, 0, 0), (0, 0, 0), OFFSET, 1), {}, "by up to"),
        (None, {}, None),
        (None, {"pixdim": [1, 0, 0, 0, 1, 1, 1, 1]}, None),  # no size is stated
        (None, {"pixdim": [1, 2, 2, 5, 1, 1, 1, 1]}, "pixdim states voxels of 2 x 2 x 5 mm, its sform 2 x 2 x 3 mm"),
        (None, {"pixdim": [1, 2.01, 2, 3, 1, 1, 1, 1]}, None),
    ],
)
def test_the_sform_wins_and_a_note_says_how_far_the_qform_or_the_sizes_are(qform, changes, words):
    labels = read_nifti(nifti(blocks(), sform=SFORM, qform=qform, **changes))
    assert np.allclose(labels.affine, in_metres(SFORM), atol=1e-8)
    assert len(labels.notes) == (words is not None)
    assert all(words in note and "the sform was taken" in note for note in labels.notes)


def test_distances_between_forms_are_in_the_unit_of_the_file():
    metres = np.diag([1e-3, 1e-3, 1e-3, 1]) @ SFORM
    qform = (np.array(EDGES) * 1e-3, (0, 0, 0), np.array(OFFSET) * 1e-3 + [0.01, 0, 0], 1)
    (note,) = read_nifti(nifti(blocks(), sform=metres, qform=qform, units=1)).notes
    assert "by up to 10 mm" in note


@pytest.mark.parametrize(
    ("qform", "words", "turned"),
    [
        (((-2.0, 2.0, 3.0), (0, 0, 0), OFFSET, 1), "pixdim has a negative length, -2", [2, 2, 3]),
        ((EDGES, (0, 0, 0), OFFSET, -0.5), "qfac must be 1 or -1, got -0.5: taken as -1", [2, 2, -3]),
        ((EDGES, (0, 0, 0), OFFSET, np.nan), "qfac must be 1 or -1, got nan: taken as 1", [2, 2, 3]),
        ((EDGES, (0, 0, 1.5), OFFSET, 1), "quaternion must have a length of at most 1, got 1.5: scaled", [-2, -2, 3]),
    ],
)
def test_what_a_qform_must_not_state_is_repaired_with_a_note(qform, words, turned):
    labels = read_nifti(nifti(blocks(), sform=None, qform=qform))
    assert np.allclose(labels.affine[:3, :3], in_metres(np.diag([*turned, 1.0]))[:3, :3], atol=1e-8)
    (note,) = labels.notes
    assert words in note


def test_a_wrong_number_of_bits_is_named():
    labels = read_nifti(nifti(blocks(), bitpix=[16]))
    assert labels.notes == ("its bitpix states 16 bits a voxel, its data type 8, which were taken",)


def test_a_quaternion_of_half_a_turn_may_be_rounded():
    axis = np.array([0.36, 0.48, 0.8])
    labels = read_nifti(nifti(blocks(), sform=None, qform=(EDGES, axis * (1 + 2e-6), OFFSET, 1)))
    expected = (2 * np.outer(axis, axis) - np.eye(3)) * EDGES
    assert np.allclose(labels.affine[:3, :3], in_metres(np.vstack([np.c_[expected, OFFSET], np.eye(4)[3]]))[:3, :3])
    assert labels.notes == ()


def test_the_sform_wins_and_without_codes_left_and_right_are_unknown():
    labels = read_nifti(nifti(blocks(), sform=None, codes=[0, 0], pixdim=[1, 2, 3, 4, 1, 1, 1, 1]))
    assert np.allclose(labels.affine, np.diag([2e-3, 3e-3, 4e-3, 1]))
    assert labels.space == ""
    assert "how the patient lies" in labels.notes[0]


@pytest.mark.parametrize(("units", "metres"), [(0, 1e-3), (1, 1.0), (2, 1e-3), (3, 1e-6), (10, 1e-3)])
def test_the_unit_of_length_counts(units, metres):
    assert np.allclose(read_nifti(nifti(blocks(), units=units)).affine, in_metres(AFFINE, metres))


def test_values_are_scaled_and_rounded_and_names_come_from_the_extension():
    values = blocks("f4") - 0.012 * (blocks() > 0)
    names = {1: "liver", 7: "left <kidney", 9: "spleen"}
    labels = read_nifti(gzip.compress(nifti(values, extension=caret(names))))
    assert [each.number for each in labels.segments] == [1, 7]
    assert labels.segments[0].name == "liver"
    assert labels.absent == ("spleen",)
    twice = caret({1: "liver"}).replace(b"</LabelTable>", b'<Label Key="1"><![CDATA[lung]]></Label></LabelTable>')
    twice = twice[:4] + struct.pack("<i", len(twice) - 4) + twice[8:]
    labels = read_nifti(nifti(blocks(), extension=twice))
    assert labels.segments[0].name == "liver"
    assert labels.notes == ("its label 1 has two names, the first was taken: liver",)
    scaled = read_nifti(nifti(blocks(), scl=[2, 0]))
    assert [each.number for each in scaled.segments] == [2, 14]
    assert scaled.notes == ("its labels are its numbers times scl_slope 2 plus scl_inter 0",)
    with pytest.raises(
        FileFormatError, match=r"scl_slope and scl_inter must take .*, got 0\.3 and 0; set them to 1 and 0"
    ):
        read_nifti(nifti(blocks(), scl=[0.3, 0]))
    for scale in ([0, 5], [np.nan, 0], [1, 0]):
        assert [each.number for each in read_nifti(nifti(blocks(), scl=scale)).segments] == [1, 7]


def test_axes_of_one_are_left_out_and_several_volumes_are_refused():
    assert read_nifti(nifti(blocks()[..., None])).shape == (12, 10, 8)
    assert read_nifti(nifti(blocks()[:, :, 3])).shape == (12, 10, 1)
    for axes, got in (((5,), "5"), ((1, 3), "1 x 3"), ((2, 3), "2 x 3")):
        with pytest.raises(FileFormatError, match=f"must be one volume, got {got} of them"):
            read_nifti(nifti(np.broadcast_to(blocks().reshape(12, 10, 8, *[1] * len(axes)), (12, 10, 8, *axes))))


def test_no_more_is_unpacked_than_the_header_states():
    bomb = gzip.compress(nifti(blocks()) + bytes(10**8), 1)
    labels = read_nifti(bomb)
    assert labels.notes == ("it holds more than its header states, which was left out",)
    parts = gzip.compress(nifti(blocks())[:500]) + gzip.compress(nifti(blocks())[500:])  # members
    assert np.array_equal(read_nifti(parts).layers[0], blocks())


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"dim": [9, 5, 5, 5, 1, 1, 1, 1]}, "3 axes, got 9"),
        ({"dim": [3, 0, 5, 5, 1, 1, 1, 1]}, "axes of 1 to"),
        ({"dim": [3, 32767, 32767, 32767, 1, 1, 1, 1]}, r"at most 2\^29"),
        ({"datatype": [128]}, r"colours \(RGB\)"),
        ({"datatype": [1536]}, "128 bits"),
        ({"datatype": [77]}, "data type 77"),
        ({"vox_offset": [np.nan]}, "begin at byte"),
        ({"vox_offset": [1e30]}, "begin at byte"),
        ({"xyzt_units": [5]}, "unit of length"),
        ({"dim": [3, 12, 10, 9, 1, 1, 1, 1]}, "cut short"),
        (
            {"codes": [0, 0], "pixdim": [1, 2, 2, 0, 1, 1, 1, 1]},
            "pixdim must be the edges of a voxel, got 2 x 2 x 0 mm",
        ),
        ({"srow": [np.nan] * 12}, "orientation"),
        ({"srow": [0.0] * 12}, "orientation"),
        ({"srow": [1.0] * 12}, "orientation"),
    ],
)
def test_headers_that_lie_are_refused_by_name(changes, message):
    with pytest.raises(FileFormatError, match=message):
        read_nifti(nifti(blocks(), **changes))


def test_other_files_and_damaged_ones_are_refused():
    whole = gzip.compress(nifti(blocks()))
    for data, message in (
        (b"", "cut short"),
        (b"\0" * 1000, "size of a NIfTI header"),
        (struct.pack("<i", 348) + bytes(400), "header alone"),
        (whole[: len(whole) // 2], "cut short"),
        (whole[:-8] + b"\1\2\3\4" + whole[-4:], "damaged"),
    ):
        with pytest.raises(FileFormatError, match=message):
            read_nifti(data)
