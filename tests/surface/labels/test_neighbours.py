"""What touches an organ, of blocks whose contacts are counted by hand."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.surface.labels.label_map import LabelMap, Segment, mask_of
from palpate.surface.labels.neighbours import contact_distance, cut_faces, touching_segments

EDGE = 0.002  # [m]
NAMES = {1: "organ", 2: "nodule", 3: "floor", 4: "far", 5: "bump"}


def label_map() -> LabelMap:
    """Return a cube of 12 voxels with a nodule inside, a bump on it, a floor under it and a far block."""
    values = np.zeros((30, 30, 30), dtype=np.uint8)
    values[6:18, 6:18, 6:18] = 1
    values[9:12, 9:12, 9:12] = 2
    values[6:18, 6:18, 2:6] = 3
    values[22:26, 22:26, 22:26] = 4
    values[18:21, 10:13, 10:13] = 5
    segments = tuple(Segment(k, name, 0, k, int((values == k).sum())) for k, name in NAMES.items())
    return LabelMap("cube.nii", (values,), np.diag([EDGE, EDGE, EDGE, 1.0]), segments)


def test_segments_that_touch_have_the_share_of_the_boundary_that_is_near():
    labels = label_map()
    organ = mask_of(labels, ["organ", "nodule"])
    inner = tuple(each for each in labels.segments if each.name in ("organ", "nodule"))
    found = {each.segment.name: each.share for each in touching_segments(labels, organ, 1.01 * EDGE, inner)}
    boundary = 12**3 - 10**3
    assert found == {"floor": pytest.approx(12 * 12 / boundary), "bump": pytest.approx(9 / boundary)}


def test_an_organ_at_the_edge_of_the_image_has_cut_faces_there():
    labels = label_map()
    assert cut_faces(mask_of(labels, "organ")) == []
    values = np.zeros((12, 12, 12), dtype=np.uint8)
    values[:, 2:10, 4:] = 1
    affine = np.array([[0.0, EDGE, 0, 1], [-EDGE, 0, 0, 2], [0, 0, EDGE, 3], [0, 0, 0, 1]])  # the first axis is -y
    cut = LabelMap("cut.nii", (values,), affine, (Segment(1, "organ", 0, 1, int(values.sum())),))
    organ = mask_of(cut, "organ")
    faces = {tuple(np.round(face.normal).astype(int)): face for face in cut_faces(organ)}
    assert faces.keys() == {(0, -1, 0), (0, 1, 0), (0, 0, -1)}
    top = faces[(0, 0, -1)]
    np.testing.assert_allclose(top.point, [1 + 5.5 * EDGE, 2 - 5.5 * EDGE, 3 + 11 * EDGE])
    assert top.share == pytest.approx(12 * 8 / len(organ.boundary()))
    inside = organ.positions(np.argwhere(organ.voxels) + organ.start)
    for face in faces.values():
        assert ((inside - face.point) @ face.normal > -1e-9).all()


def test_the_distance_of_contact_follows_spacing_and_voxels():
    assert contact_distance(np.array([1e-3, 1e-3, 5e-3]), spacing=0.010) == pytest.approx(7.5e-3)
    assert contact_distance(np.array([1e-3, 1e-3, 1e-3]), spacing=0.010) == pytest.approx(5e-3)
