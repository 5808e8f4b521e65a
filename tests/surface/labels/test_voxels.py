"""Voxels of labels: values that are not labels are refused by name, large ones become smaller."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.core.faults import FileFormatError
from palpate.surface.labels.voxels import label_values, segments_of


def read(values):
    return segments_of([label_values(np.asarray(values))[0]], {})


def test_a_ct_is_refused_by_name():
    rng = np.random.default_rng(0)
    for image in (
        rng.integers(-1000, 1500, (20, 20, 20), dtype="i2"),
        rng.integers(0, 4000, (20, 20, 20), dtype="u2"),
        rng.integers(0, 256, (20, 20, 20), dtype="u1"),
        rng.normal(0, 300, (20, 20, 20)),
    ):
        with pytest.raises(FileFormatError, match=r"image of intensities from .* segment it first"):
            read(image)


def test_probabilities_and_infinite_values_are_refused_by_name():
    with pytest.raises(FileFormatError, match=r"probabilities from 0 to 1; threshold them"):
        read(np.linspace(0, 1, 27).reshape(3, 3, 3))
    for bad in (np.nan, np.inf):
        with pytest.raises(FileFormatError, match="finite"):
            read(np.full((2, 2, 2), bad))
    with pytest.raises(FileFormatError, match="voxels of 0 alone"):
        read(np.zeros((2, 2, 2), dtype="u1"))
    with pytest.raises(FileFormatError, match="intensities"):
        read(np.array([[[0, 2**40]]]))


def test_values_near_whole_numbers_are_rounded():
    assert np.array_equal(label_values(np.array([0.0, 0.988, 2.011]))[0], [0, 1, 2])
    with pytest.raises(FileFormatError, match="intensities"):
        label_values(np.array([0.0, 0.9, 2.0]))


def test_a_hundred_labels_are_not_an_image():
    organs = np.kron(np.arange(150, dtype="i2").reshape(5, 5, 6), np.ones((4, 4, 4), dtype="i2"))
    _, segments, _ = read(organs)
    assert len(segments) == 149


@pytest.mark.parametrize(("outside", "dtype"), [(-1, "i1"), (-1, "f4"), (-9999, "i2")])
def test_one_negative_number_is_outside_and_the_note_names_it(outside, dtype):
    values, notes = label_values(np.array([outside, outside, 1, 3, 0], dtype=dtype))
    assert values.tolist() == [0, 0, 1, 3, 0]
    assert notes == (f"its voxels of {outside}, 40% of all, are taken as outside, as those of 0",)


def test_other_negative_numbers_are_refused_by_name_and_a_ct_as_one():
    with pytest.raises(FileFormatError, match=r"at least 0, got 2 negative ones from -106 to -56; .* more than 8 bits"):
        read(np.array([[[-56, -106, 0, 1]]], dtype="i1"))
    with pytest.raises(FileFormatError, match="a label of at least 1, got voxels of -1 and 0 alone"):
        read(np.array([[[-1, 0]]]))
    ct = np.random.default_rng(0).integers(-1000, 1500, (20, 20, 20), dtype="i2")
    with pytest.raises(FileFormatError, match="image of intensities from -"):
        read(ct)
    ct[ct < 0] = -2000  # outside of the field of view
    with pytest.raises(FileFormatError, match="image of intensities"):
        read(ct)


@pytest.mark.parametrize("dtype", ["u4", "i8", "f8"])
def test_large_values_become_smaller_ones_with_their_numbers(dtype):
    values = np.zeros((3, 3, 3), dtype=dtype)
    values[0], values[1, 1, 1] = 2_000_000_000, 5_000_000
    (layer,), segments, _ = read(values)
    assert [(each.number, each.count) for each in segments] == [(5_000_000, 1), (2_000_000_000, 9)]
    assert layer.dtype.itemsize <= 2
    for each in segments:
        assert np.array_equal(layer == each.value, values == each.number)
