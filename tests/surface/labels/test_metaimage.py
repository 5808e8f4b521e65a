"""MetaImage: values and positions, and headers that lie or name other files."""

from __future__ import annotations

import numpy as np
import pytest
from label_files import AFFINE, blocks, metaimage

from palpate.core.faults import FileFormatError
from palpate.surface.labels.metaimage import read_metaimage


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("dtype", ["u1", "i2", "f4"])
def test_values_and_positions_are_those_of_the_header(dtype, packed):
    labels = read_metaimage(metaimage(blocks(dtype), packed=packed))
    assert np.array_equal(labels.layers[0], blocks())
    assert np.allclose(labels.affine, np.diag([1e-3, 1e-3, 1e-3, 1]) @ AFFINE)
    assert labels.space == "LPS"


UPRIGHT = np.array([[2.0, 0, 0, 10], [0, 2, 0, 20], [0, 0, 3, 30], [0, 0, 0, 1]])
TURNED = "0 1 0 -1 0 0 0 0 1"


@pytest.mark.parametrize(
    ("lines", "without", "words"),
    [
        (["ElementSize = 2 2 3", f"Rotation = {'1 0 0 0 1 0 0 0 1'}", "Position = 10 20 30"], (), None),
        (["AnatomicalOrientation = RAI", "CenterOfRotation = 0 0 0", "DistanceUnits = mm"], (), None),
        (["AnatomicalOrientation = LPS", "ElementToIntensityFunctionSlope = 1"], (), None),  # of other writers
        (["AnatomicalOrientation = ???"], (), None),
        (["ElementSize = 2 2 5"], (), "ElementSpacing and ElementSize differ by up to 15 mm: ElementSpacing was taken"),
        ([f"Rotation = {TURNED}"], (), "TransformMatrix and Rotation differ by up to"),
        ([f"Orientation = {TURNED}", "Rotation = 1 0 0 0 1 0 0 0 1"], ("TransformMatrix",), "Rotation and Orientation"),
        (["Position = 10 20 34"], (), "Offset and Position differ by up to 4 mm: Offset was taken"),
        (["Origin = 10 20 30", "Position = 9 20 30"], ("Offset",), "Origin and Position differ by up to 1 mm"),
        (["AnatomicalOrientation = LPI"], (), "AnatomicalOrientation LPI is not that of its matrix, RAI"),
        (["DistanceUnits = cm"], (), "DistanceUnits 'cm' were not used: its lengths were taken as mm"),
        (["CenterOfRotation = 5 5 5"], (), "CenterOfRotation was not used"),
        (["ElementToIntensityFunctionOffset = 3"], (), "ElementToIntensityFunctionOffset was not used"),
    ],
)
def test_a_note_says_which_of_two_statements_was_taken_as_by_itk(lines, without, words):
    labels = read_metaimage(metaimage(blocks(), affine=UPRIGHT, lines=lines, without=without))
    assert np.allclose(labels.affine, np.diag([1e-3, 1e-3, 1e-3, 1]) @ UPRIGHT)
    assert len(labels.notes) == (words is not None)
    assert all(words in note for note in labels.notes)


def test_origin_counts_before_offset_and_negative_spacings_turn_an_axis_around_as_in_itk():
    origin = read_metaimage(metaimage(blocks(), affine=UPRIGHT, lines=["Origin = 10 20 34"]))
    assert np.allclose(origin.affine[:3, 3], [0.010, 0.020, 0.034])
    assert "Origin and Offset differ by up to 4 mm: Origin was taken" in origin.notes[0]
    spacing = ["ElementSpacing = -2 2 3"]
    turned = read_metaimage(metaimage(blocks(), affine=UPRIGHT, lines=spacing, without=("ElementSpacing",)))
    assert np.allclose(turned.affine[:3, :3], 1e-3 * np.diag([-2, 2, 3]))
    assert "spacing of -2 x 2 x 3 mm turns an axis around" in turned.notes[0]
    long = ["TransformMatrix = 2 0 0 0 1 0 0 0 1"]
    scaled = read_metaimage(metaimage(blocks(), affine=UPRIGHT, lines=long, without=("TransformMatrix",)))
    assert np.allclose(scaled.affine[:3, :3], 1e-3 * np.diag([4, 2, 3]))
    assert "matrix makes voxels of 4 x 2 x 3 mm of its spacing of 2 x 2 x 3 mm" in scaled.notes[0]


def test_without_a_spacing_voxels_are_of_a_millimetre_with_a_note():
    labels = read_metaimage(metaimage(blocks(), affine=UPRIGHT, without=("ElementSpacing",)))
    assert np.allclose(labels.voxel_edges, 1e-3)
    assert labels.notes == ("it states no ElementSpacing: voxels of 1 mm are taken",)


def test_a_field_that_is_given_twice_is_refused():
    for lines in (["Offset = 1 2 3"], ["ElementByteOrderMSB = True"]):
        with pytest.raises(FileFormatError, match=r"must state .* two different ones"):
            read_metaimage(metaimage(blocks(), affine=UPRIGHT, lines=lines))


@pytest.mark.parametrize(
    ("options", "change", "message"),
    [
        ({"data_file": "/etc/passwd"}, (b"", b""), "in the same file"),
        ({"data_file": "slices%03d.raw 1 9 1"}, (b"", b""), "in the same file"),
        ({"lines": ["ElementNumberOfChannels = 3"]}, (b"", b""), "3 channels"),
        ({}, (b"MET_UCHAR", b"MET_UCHAR_ARRAY"), "numbers of labels"),
        ({}, (b"DimSize = 12 10 8", b"DimSize = 12 10 9"), "cut short"),
        ({}, (b"DimSize = 12 10 8", b"DimSize = 99999 99999 9999"), r"at most 2\^29"),
        ({}, (b"DimSize = 12 10 8", b"DimSize = nan 1 1"), "whole numbers"),
        ({}, (b"NDims = 3", b"NDims = 4"), "2 or 3"),
        ({}, (b"ElementSpacing = ", b"ElementSpacing = x "), "ElementSpacing must be 3 numbers"),
        ({"lines": ["ElementSize = nan 2 3"]}, (b"", b""), "ElementSize must be finite numbers, got 'nan 2 3'"),
        ({}, (b"TransformMatrix = ", b"Transformed = "), None),
        ({}, (b"ElementDataFile", b"Element"), "end with ElementDataFile"),
        ({}, (b"BinaryData = True", b"BinaryData = False"), "must be binary"),
    ],
)
def test_headers_that_lie_are_refused_by_name(options, change, message):
    data = metaimage(blocks(), **options)
    assert change[0] in data
    data = data.replace(*change, 1)
    if message is None:  # without a matrix the axes are those of the frame
        affine = read_metaimage(data).affine
        assert np.allclose(affine[:3, :3], np.diag(1e-3 * np.linalg.norm(AFFINE[:3, :3], axis=0)))
        return
    with pytest.raises(FileFormatError, match=message):
        read_metaimage(data)
