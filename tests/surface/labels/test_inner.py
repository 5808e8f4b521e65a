"""What lies in an organ of a label map, and by which rule it joins the body: blocks in blocks, of many names."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.surface.labels.inner import inner_labels
from palpate.surface.labels.label_map import LabelMap, Segment, segments_mask
from palpate.surface.labels.mask_surface import largest_piece

EDGE = 0.002  # [m]
ORGAN = slice(6, 26)


def blocks(organ: str, *inner: tuple[str, tuple[slice, slice, slice]]) -> LabelMap:
    """Return a cube of 20 voxels in an image of 32, with blocks in it."""
    values = np.zeros((32, 32, 32), dtype=np.uint8)
    values[ORGAN, ORGAN, ORGAN] = 1
    for number, (_, box) in enumerate(inner, 2):
        values[box] = number
    return map_of([values], [organ, *(name for name, _ in inner)])


def map_of(layers, names):
    """Return a map whose segments have the numbers from 1, each in the first layer that has it."""
    segments = []
    for number, name in enumerate(names, 1):
        layer = next(k for k, values in enumerate(layers) if (values == number).any())
        segments.append(Segment(number, name, layer, number, int((layers[layer] == number).sum())))
    return LabelMap("blocks.nii", tuple(layers), np.diag([EDGE, EDGE, EDGE, 1.0]), tuple(segments))


def found(labels: LabelMap, organ: int = 0) -> dict[str, tuple[bool, str]]:
    """Return what lies in a segment: whether it joins, and the rule."""
    return {each.segment.name: (each.joins, each.why) for each in inner_labels(labels, [labels.segments[organ]])}


def cube(at: int, size: int) -> tuple[slice, slice, slice]:
    return (slice(at, at + size),) * 3


@pytest.mark.parametrize(("organ", "inner", "joins", "rule"), [
    ("liver", "liver_tumor", True, "a lesion by its name"),
    ("label 1", "Mass", True, "a lesion by its name"),
    ("kidney_left", "kidney_cyst_left", True, "a lesion by its name"),
    ("Liver", "hepatic vessels", True, "a vessel or duct by its name"),
    ("liver", "liver_segment_4", True, "a part by its name"),
    ("liver", "lung_right", False, "another organ by its name"),
    ("liver", "inferior_vena_cava", False, "another organ by its name"),
    ("kidney_left", "kidney_cyst_right", False, "another organ by its name"),
    ("label 1", "label 2", True, "by its shares: 100 % of what is around it, 1.6 % of the volume"),
    ("liver", "ablation", True, "by its shares: 100 % of what is around it, 1.6 % of the volume"),
])  # fmt: skip
def test_a_label_joins_by_its_name_or_by_its_shares_and_another_organ_never(organ, inner, joins, rule):
    assert found(blocks(organ, (inner, cube(12, 5)))) == {inner: (joins, rule)}


def test_the_place_of_what_is_left_out_is_that_of_the_body():
    flat, cubic = (slice(8, 24), slice(8, 24), slice(12, 14)), cube(16, 8)
    for box, place in ((flat, "filled with the organ's tissue"), (cubic, "left empty")):
        labels = blocks("liver", ("stomach", box))
        (inner,) = inner_labels(labels, labels.segments[:1])
        assert (inner.joins, inner.place) == (False, place)
        organ = largest_piece(segments_mask(labels, labels.segments[:1])).voxels
        assert bool(organ[tuple(slice(s.start - 6, s.stop - 6) for s in box)].all()) is place.startswith("filled")


def test_a_tiny_label_without_a_telling_name_is_left_out_and_a_tiny_lesion_joins():
    both = blocks("liver", ("label 2", cube(9, 1)), ("tumour", cube(18, 1)))
    assert {name: joins for name, (joins, _) in found(both).items()} == {"label 2": False, "tumour": True}


def test_a_label_that_is_most_of_the_organ_joins_by_its_name_alone():
    assert found(blocks("kidney", ("label 2", cube(7, 18))))["label 2"][0] is False
    assert found(blocks("kidney", ("renal_medulla", cube(7, 18))))["renal_medulla"][0] is True


@pytest.mark.parametrize("name", ["tumour", "lung_right", "label 2", "liver_vessels"])
def test_what_the_edge_of_the_image_cuts_never_joins(name):
    values = np.zeros((20, 20, 20), dtype=np.uint8)
    values[4:16, 4:16, :14], values[8:12, 8:12, :4] = 1, 2
    assert found(map_of([values], ["liver", name])) == {name: (False, "cut by the edge of the image")}


def test_an_axis_of_one_voxel_has_no_edge():
    values = np.zeros((20, 20, 1), dtype=np.uint8)
    values[4:16, 4:16], values[8:12, 8:12] = 1, 2
    assert found(map_of([values], ["liver", "tumour"]))["tumour"][0] is True


def test_what_lies_next_to_the_organ_or_half_in_it_is_not_in_it():
    bump, half = (slice(26, 29), slice(10, 13), slice(10, 13)), (slice(24, 30), slice(14, 17), slice(14, 17))
    assert found(blocks("liver", ("tumour", bump), ("lesion", half))) == {}


def test_a_nodule_just_under_the_surface_joins_by_its_name_and_an_unnamed_label_does_not():
    top = (slice(12, 16), slice(12, 16), slice(22, 26))
    assert found(blocks("liver", ("nodule", top)))["nodule"][0] is True
    assert found(blocks("label 1", ("label 2", top)))["label 2"][0] is False


def test_what_lies_in_a_lesion_lies_in_the_organ():
    labels = blocks("liver", ("tumour", cube(10, 9)), ("necrosis", cube(12, 5)), ("spleen", cube(13, 1)))
    assert {name: joins for name, (joins, _) in found(labels).items()} == {
        "tumour": True,
        "necrosis": True,
        "spleen": False,
    }


def test_a_lesion_in_another_layer_joins_and_another_organ_there_leaves_no_hole():
    whole = np.zeros((32, 32, 32), dtype=np.uint8)
    whole[ORGAN, ORGAN, ORGAN] = 1
    other = np.zeros_like(whole)
    other[cube(8, 4)], other[cube(16, 4)] = 2, 3
    assert found(map_of([whole, other], ["liver", "tumour", "spleen"])) == {"tumour": (True, "a lesion by its name")}


def test_the_place_of_a_label_that_is_left_out_is_filled_or_stays_empty():
    labels = blocks("liver", ("spleen", cube(10, 2)), ("stomach", cube(15, 6)))
    small, large = inner_labels(labels, [labels.segments[0]])
    assert (small.place, large.place) == ("filled with the organ's tissue", "left empty")
    assert small.volume == pytest.approx(8 * EDGE**3)


def test_labels_lie_in_the_union_of_several():
    values = np.zeros((32, 32, 32), dtype=np.uint8)
    values[6:16, ORGAN, ORGAN], values[16:26, ORGAN, ORGAN], values[12:20, 12:20, 12:20] = 1, 2, 3
    labels = map_of([values], ["liver_left", "liver_right", "tumour"])
    assert [found(labels, k) for k in (0, 1)] == [{}, {}]
    (tumour,) = inner_labels(labels, labels.segments[:2])
    assert tumour.joins
