"""Deformed label maps: exact for homogeneous motions, and unchanged at rest."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import palpate as pt
from palpate.core.faults import InputError
from palpate.surface.labels.deformed import body_segments, deform, resampling_field
from palpate.surface.labels.label_map import LabelMap, Segment

EDGES = np.array([0.002, 0.002, 0.0025])  # [m]
ORIGIN = np.array([-0.03, 0.01, 0.02])
SPACING = 0.006


def label_map() -> LabelMap:
    """Return a map of a block with an inclusion, and of a neighbour."""
    values = np.zeros((40, 36, 30), dtype=np.uint8)
    values[8:28, 8:26, 6:22], values[14:18, 14:18, 10:13], values[30:35, 8:26, 6:22] = 1, 2, 3
    names = {1: "block", 2: "inclusion", 3: "neighbour"}
    segments = tuple(Segment(k, name, 0, k, int((values == k).sum())) for k, name in names.items())
    affine = np.diag([*EDGES, 1.0])
    affine[:3, 3] = ORIGIN
    return LabelMap("block.nii", (values,), affine, segments)


def block() -> tuple[np.ndarray, np.ndarray]:
    """Return the nodes and the triangles of the body that fills the block."""
    low, high = ORIGIN + EDGES * [7.5, 7.5, 5.5], ORIGIN + EDGES * [27.5, 25.5, 21.5]
    cloud = pt.box(tuple(high - low), spacing=SPACING)
    return cloud.points + low, cloud.triangles


def deformed(gradient: np.ndarray, shift: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the numbers of the deformed map and the field, for a motion about the middle of the block."""
    labels, (rest, triangles) = label_map(), block()
    middle = rest.mean(axis=0)
    motion = (rest - middle) @ gradient.T + middle + shift - rest
    field, distance = resampling_field(labels, rest, motion, SPACING)
    return deform(labels, body_segments(labels, rest, triangles), field, distance, SPACING)[0], field


def test_a_body_consists_of_the_labels_that_lie_in_it():
    names = [each.name for each in body_segments(label_map(), *block())]
    assert names == ["block", "inclusion"]


def test_a_map_of_another_body_is_refused():
    rest, triangles = block()
    with pytest.raises(InputError, match="labels must be the map of the recorded body"):
        body_segments(label_map(), rest + 0.5, triangles)
    with pytest.raises(InputError, match="whose image is elsewhere"):
        resampling_field(label_map(), rest + 0.5, 0 * rest, SPACING)


def test_a_body_at_rest_has_the_same_map_and_no_displacements():
    numbers, field = deformed(np.eye(3), np.zeros(3))
    assert np.array_equal(numbers, label_map().layers[0])
    assert not field.any()


def test_segments_that_overlap_stay_in_their_layers():
    labels, (rest, triangles) = label_map(), block()
    over = np.zeros_like(labels.layers[0])
    over[14:18, 8:26, 6:22] = 1
    segments = (*labels.segments, Segment(4, "vessel", 1, 1, int(over.sum()), 1))
    labels = replace(labels, layers=(*labels.layers, over), segments=segments)
    motion = np.broadcast_to([0.0, 3 * EDGES[1], 0.0], rest.shape)
    field, distance = resampling_field(labels, rest, motion, SPACING)
    parts = body_segments(labels, rest, triangles)
    assert [each.name for each in parts] == ["block", "inclusion", "vessel"]
    numbers = deform(labels, parts, field, distance, SPACING)
    for layer, number in ((0, 1), (0, 2), (1, 4)):
        rest_value = 1 if layer else number
        moved = np.roll(labels.layers[layer] == rest_value, 3, axis=1)
        assert np.array_equal(numbers[layer] == number, moved)


def test_a_shift_by_whole_voxels_moves_the_body_alone():
    numbers, _ = deformed(np.eye(3), np.array([0.0, 3 * EDGES[1], 0.0]))
    values = label_map().layers[0]
    body, moved = np.isin(values, [1, 2]), np.zeros_like(values)
    moved[:, 3:] = np.where(body, values, 0)[:, :-3]
    expected = np.where(moved > 0, moved, np.where(body, 0, values))
    assert np.array_equal(numbers, expected)


def test_a_homogeneous_deformation_is_exact_to_the_voxel():
    gradient = np.array([[1.1, 0.2, 0.0], [0.0, 0.95, 0.1], [0.05, 0.0, 0.96]])
    numbers, field = deformed(gradient, np.zeros(3))
    labels, (rest, _) = label_map(), block()
    middle = rest.mean(axis=0)
    places = np.indices(labels.shape).reshape(3, -1).T * EDGES + ORIGIN
    sources = (places - middle) @ np.linalg.inv(gradient).T + middle
    near = np.linalg.norm(field.reshape(-1, 3), axis=1) > 0
    assert np.abs((field.reshape(-1, 3) + places - sources)[near]).max() < 1e-7
    indices = np.rint((sources - ORIGIN) / EDGES).astype(int)
    inside = np.all((indices >= 0) & (indices < labels.shape), axis=1)
    expected = np.zeros(len(places), dtype=int)
    expected[inside] = labels.layers[0][tuple(indices[inside].T)]
    for number in (1, 2):
        differ = (numbers.ravel() == number) != (expected == number)
        assert differ.sum() <= 0.005 * (expected == number).sum()
