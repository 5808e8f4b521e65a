"""NRRD: values, frames and layers, and the segments of 3D Slicer."""

from __future__ import annotations

import numpy as np
import pytest
from label_files import AFFINE, blocks, nrrd

from palpate.core.faults import FileFormatError, InputError
from palpate.surface.labels.label_map import choose_segments, part_names
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
    assert [(each.name, each.number, each.label, each.layer, each.value, each.count) for each in labels.segments] == [
        ("stomach", 7, None, 0, 7, 45), ("liver", 8, 1, 0, 1, 80), ("both", 9, 1, 1, 1, 125)
    ]  # fmt: skip
    assert labels.absent == ("spleen",)
    assert all(layer.flags.f_contiguous for layer in labels.layers)


LAYERS = [
    "Segment0_Name:=spleen", "Segment0_Layer:=0", "Segment0_LabelValue:=1",
    "Segment1_Name:=liver", "Segment1_Layer:=0", "Segment1_LabelValue:=7",
    "Segment2_Name:=tumour", "Segment2_Layer:=1", "Segment2_LabelValue:=1",
]  # fmt: skip
LIST = "list domain domain domain"


def layered(lines=LAYERS, kinds=LIST):
    return nrrd(np.stack([blocks(), (blocks() > 0).astype("u1")]), kinds=kinds, lines=lines)


def test_a_label_value_finds_its_own_segment_and_one_of_several_is_refused_with_the_choices():
    labels = read_nrrd(layered())
    for part, name in (("7", "liver"), ("liver", "liver"), ("8", "spleen"), ("9", "tumour"), ("label 9", "tumour")):
        assert [each.name for each in choose_segments(labels, part)] == [name]
    with pytest.raises(InputError, match="got '1', which is of several: give spleen, tumour"):
        choose_segments(labels, "1")
    assert part_names(labels) == ["liver", "spleen", "tumour"]
    unnamed = read_nrrd(layered([line for line in LAYERS if "Name" not in line]))
    assert part_names(unnamed) == ["7", "8", "9"]
    assert [each.name for each in unnamed.segments] == ["label 7", "label 1", "label 1"]
    with pytest.raises(InputError, match="'label 1', which 8 and 9 have; give a number"):
        choose_segments(unnamed, "label 1")
    named = unnamed.with_names({7: "liver", 1: "spleen", 9: "tumour"})
    assert [each.name for each in named.segments] == ["liver", "label 1", "tumour"]
    assert named.absent == ()


def test_a_name_that_is_the_number_of_another_is_refused_with_the_choices():
    labels = read_nrrd(nrrd(blocks(), lines=["Segment0_Name:=7", "Segment0_LabelValue:=1", "Segment1_LabelValue:=7"]))
    assert part_names(labels) == ["1", "label 7"]
    assert [choose_segments(labels, part)[0].number for part in part_names(labels)] == [1, 7]
    with pytest.raises(InputError, match="got '7', which is of several: give 1, label 7"):
        choose_segments(labels, "7")


def test_layers_without_numbers_of_their_own_are_one_for_each_segment_as_in_slicer():
    labels = read_nrrd(
        nrrd(np.stack([blocks(), blocks() // 7]), kinds=LIST, lines=["Segment0_Name:=a", "Segment1_Name:=b"])
    )
    assert [(each.name, each.layer, each.value) for each in labels.segments if each.name in "ab"] == [
        ("a", 0, 1), ("b", 1, 1)
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (lambda: layered([]), "segments in each of its 2 layers, got none in layer 0, as a time series has"),
        (lambda: layered(LAYERS[:6]), "got none in layer 1"),
        (lambda: layered(LAYERS, "time domain domain domain"), "got a time series"),
        (lambda: layered(LAYERS, "vector domain domain domain"), "got vector"),
        (lambda: layered([*LAYERS[:6], "Segment2_Name:=b", "Segment2_Layer:=0", "Segment2_LabelValue:=7"]),
         "values of their own, got 'liver' and 'b' of value 7 in layer 0"),
        (lambda: layered([*LAYERS, "Segment0_LabelValue:=7"]), "must state 'Segment0_LabelValue' once"),
        (lambda: nrrd(blocks(), kinds="domain domain time"), "got a time series"),
        (lambda: nrrd(blocks(), kinds="domain domain list"), "got a list of pictures"),
        (lambda: nrrd(blocks(), space="left-posterior-superior-time"), "got a time series"),
    ],
)  # fmt: skip
def test_series_colours_and_layers_without_segments_are_refused(data, message):
    with pytest.raises(FileFormatError, match=message):
        read_nrrd(data())


CUBES = np.diag([2.0, 2.0, 3.0, 1.0])


@pytest.mark.parametrize(
    ("lines", "words"),
    [
        ([], []),
        (["spacings: 2 2 3", "thicknesses: nan nan 3", "space dimension: 3"], []),
        (
            ["spacings: 2 2 5"],
            ["spacings state 2 x 2 x 5 mm, its space directions 2 x 2 x 3 mm: the directions were taken"],
        ),
        (["thicknesses: nan nan 5"], ["thicknesses state 5 mm, its space directions 3 mm"]),
        (["axis mins: 0 0 9", "centers: cell cell cell"], ["axis mins and maxs were not used"]),
        (['space units: "mm" "parsec" "mm"'], ["parsec' is not known: taken as mm", "are mixed"]),
    ],
)
def test_directions_win_and_notes_say_what_else_the_header_states(lines, words):
    labels = read_nrrd(nrrd(blocks(), affine=CUBES, lines=lines))
    assert np.allclose(labels.affine, METRES @ CUBES)
    assert len(labels.notes) == len(words)
    assert all(word in note for word, note in zip(words, labels.notes, strict=True))


def test_each_axis_of_space_has_its_own_unit():
    labels = read_nrrd(nrrd(blocks(), lines=['space units: "mm" "cm" "m"']))
    assert np.allclose(labels.affine, np.diag([1e-3, 1e-2, 1.0, 1.0]) @ AFFINE)
    assert labels.notes == ("its space units are mixed, 'mm', 'cm', 'm': each axis has its own",)
    same = read_nrrd(nrrd(blocks(), lines=['space units: "cm" "cm" "cm"']))
    assert np.allclose(same.affine, np.diag([1e-2, 1e-2, 1e-2, 1.0]) @ AFFINE)
    assert same.notes == ()


def spaced(*lines):
    """Return a file whose header states no space."""
    head, _, voxels = nrrd(blocks(), packed=False, lines=lines).partition(b"\n\n")
    others = [line for line in head.split(b"\n") if not line.startswith(b"space")]
    return b"\n".join(others) + b"\n\n" + voxels


@pytest.mark.parametrize(
    ("lines", "edges", "words"),
    [
        (["spacings: 2 2 3"], [2, 2, 3], []),
        (["spacings: 0.2 0.2 0.3", 'units: "cm" "cm" "cm"'], [2, 2, 3], []),
        (["spacings: -2 2 3"], [2, 2, 3], ["spacings are negative: their sizes were taken"]),
        (["axis mins: 0 0 0", "axis maxs: 24 20 24"], [2, 2, 3], []),
        (["axis mins: 0 0 0", "axis maxs: 22 18 21", "centerings: node node node"], [2, 2, 3], []),
        ([], [1, 1, 1], ["it states no spacings: voxels of 1 mm are taken"]),
        (["spacings: 2 2 3", "axis mins: 5 6 7", "axis maxs: 29 26 31"], [2, 2, 3], []),
        (["spacings: 2 2 3", "axis mins: 0 0 0", "axis maxs: 22 18 21"], [2, 2, 3], []),  # between nodes
        (
            ["spacings: 2 2 3", "axis mins: 0 0 0", "axis maxs: 24 20 40"],
            [2, 2, 3],
            ["axis mins and maxs make voxels of 2 x 2 x 5 mm, its spacings 2 x 2 x 3 mm: the latter were taken"],
        ),
    ],
)
def test_without_a_space_sizes_alone_are_used(lines, edges, words):
    labels = read_nrrd(spaced(*lines))
    assert np.allclose(labels.affine, 1e-3 * np.diag([*edges, 1e3]))
    assert labels.space == ""
    assert list(labels.notes[1:]) == [each if each.startswith("it ") else f"its {each}" for each in words]


def test_what_needs_space_directions_is_named_without_them_and_spacings_are_of_all_axes():
    data = spaced("spacings: 2 2 3").replace(b"\n\n", b'\nspace origin: (1,2,3)\nspace units: "cm" "cm" "cm"\n\n', 1)
    note = read_nrrd(data).notes[-1]
    assert note == "what it states as space origin and space units was not used: it has no space directions"
    with pytest.raises(FileFormatError, match="spacings must be one for each axis, got 2"):
        read_nrrd(spaced("spacings: 2 2"))


@pytest.mark.parametrize("line", ["Segment0_LabelValue:=x", "Segment0_LabelValue:=-1", "Segment0_Layer:=1.5"])
def test_a_segment_whose_value_or_layer_is_not_a_whole_number_is_refused(line):
    with pytest.raises(FileFormatError, match=r"Segment0_\w+ must be a whole number, got"):
        read_nrrd(nrrd(blocks(), lines=["Segment0_Name:=liver", line]))


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
        ((b"# made by a test", b"space dimension: 2"), "space dimension must be 3, as its vectors have, got '2'"),
        ((b"# made by a test", b"sizes: 8 10 12"), "must state 'sizes' once"),
        ((b"\n\n", b"\n"), "blank line"),
    ],
)
def test_headers_that_lie_are_refused_by_name(change, message):
    data = nrrd(blocks())
    assert change[0] in data
    with pytest.raises(FileFormatError, match=message):
        read_nrrd(data.replace(*change, 1))


def test_the_order_of_bytes_must_be_stated_where_it_matters():
    for packed in (False, True):
        with pytest.raises(FileFormatError, match=r"endian must be little or big, .*; add the line 'endian: little'"):
            read_nrrd(nrrd(blocks("i2"), packed=packed).replace(b"endian: little\n", b""))
        assert read_nrrd(nrrd(blocks(), packed=packed).replace(b"endian: little\n", b"")).notes == ()


def test_colours_and_series_are_refused():
    four = np.stack([blocks()] * 3)
    with pytest.raises(FileFormatError, match="got rgb-color"):
        read_nrrd(nrrd(four, kinds="RGB-color domain domain domain"))
    with pytest.raises(FileFormatError, match="must be one volume"):
        read_nrrd(nrrd(four))
