"""Coarse surfaces of the labels around a body."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.surface.labels.label_map import LabelMap
from palpate.surface.labels.surroundings import MAX_SURROUNDING_TRIANGLES, surrounding_surfaces
from palpate.surface.labels.voxels import segments_of

NAMES = {(0, 1): (1, "liver"), (0, 2): (2, "kidney"), (0, 3): (3, "vessel"), (0, 4): (4, "far"), (0, 5): (5, "speck")}
EDGE = 2e-3  # [m] of a voxel
BOXES = {1: ((20, 50), (20, 50), (20, 50)), 2: ((52, 64), (20, 34), (20, 36)), 3: ((10, 70), (10, 14), (30, 34))}


def label_map(axes=(EDGE, EDGE, EDGE), space="LPS"):
    """A cube, a box and a bar next to it, a box far away, and a single voxel."""
    layer = np.zeros((150, 90, 90), dtype=np.uint8, order="F")
    for value, box in BOXES.items():
        layer[tuple(slice(*ends) for ends in box)] = value
    layer[120:150, 60:90, 60:90] = 4
    layer[60, 60, 20] = 5
    affine = np.diag([*axes, 1.0])
    affine[:3, 3] = (0.1, -0.2, 0.3)
    layers, segments, _ = segments_of([layer], NAMES)
    return LabelMap("boxes.nii", layers, affine, segments, space)


@pytest.mark.parametrize("axes", [(EDGE, EDGE, EDGE), (-EDGE, EDGE, EDGE), (EDGE, EDGE, 2 * EDGE)])
def test_labels_near_a_body_are_closed_surfaces_in_their_boxes(axes):
    labels = label_map(axes)
    surfaces = surrounding_surfaces(labels, "liver")
    assert sorted(each.name for each in surfaces) == ["kidney", "vessel"]
    for each in surfaces:
        (segment,) = (s for s in labels.segments if s.name == each.name)
        assert each.closed
        assert each.space == "LPS"
        assert each.volume == pytest.approx(segment.count * labels.voxel_volume, rel=0.2)  # outward, too
        ends = np.array(BOXES[segment.number]) - 0.5
        corners = np.sort(ends.T * np.array(axes) + labels.affine[:3, 3], axis=0)
        margin = 1.5 * max(np.abs(axes))
        assert (each.vertices > corners[0] - margin).all()
        assert (each.vertices < corners[1] + margin).all()
        np.testing.assert_allclose(each.vertices.mean(axis=0), corners.mean(axis=0), atol=EDGE)


@pytest.mark.parametrize("most", [300, 2000, MAX_SURROUNDING_TRIANGLES])
def test_a_number_of_triangles_is_not_exceeded(most):
    surfaces = surrounding_surfaces(label_map(), "liver", most)
    total = sum(len(each.triangles) for each in surfaces)
    assert 0 < total <= most


def test_more_triangles_are_finer():
    labels = label_map()
    few, many = (sum(len(each.triangles) for each in surrounding_surfaces(labels, "liver", n)) for n in (500, 3000))
    assert many > 2 * few


def test_the_labels_of_the_body_are_left_out():
    for parts, others in ((["liver", "kidney"], ["vessel"]), ("kidney#1", ["liver", "vessel"])):
        assert sorted(each.name for each in surrounding_surfaces(label_map(), parts)) == others


def test_a_label_alone_has_no_surroundings():
    assert surrounding_surfaces(label_map(), "far") == ()
