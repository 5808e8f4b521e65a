"""Writers of label maps and fields: what is written is read back, and headers hold what the formats require."""

from __future__ import annotations

import gzip
import struct

import numpy as np
import pytest

from palpate.core.faults import InputError
from palpate.surface.labels.label_map import Segment
from palpate.surface.labels.reading import read_label_map
from palpate.surface.labels.writers import check_volume_name, write_field, write_labels, write_layers

AFFINE = np.array([[1.9, 0.3, 0.1, -40], [-0.2, 1.4, 0.2, 12], [0.1, 0.1, 3, -7], [0, 0, 0, 1e3]]) * 1e-3  # LPS [m]
NAMES = {1: "liver", 7: "mass a&b"}


def blocks() -> np.ndarray:
    values = np.zeros((12, 10, 8), dtype=np.uint32)
    values[2:6, 3:8, 2:6], values[6:9, 3:8, 2:5] = 1, 7
    return values


@pytest.mark.parametrize("suffix", [".nii", ".nii.gz", ".nrrd"])
@pytest.mark.parametrize("factor", [1, 10_000], ids=["short", "long"])
def test_a_written_label_map_is_read_back(tmp_path, suffix, factor):
    path, values = tmp_path / f"map{suffix}", factor * blocks()
    write_labels(path, values, AFFINE, {factor * number: name for number, name in NAMES.items()})
    labels = read_label_map(path)
    np.testing.assert_allclose(labels.affine, AFFINE, rtol=0, atol=1e-8)
    assert labels.space == "LPS"
    assert {each.number: each.name for each in labels.segments} == {factor * k: name for k, name in NAMES.items()}
    for segment in labels.segments:
        assert np.array_equal(labels.layers[segment.layer] == segment.value, values == segment.number)


def overlapping() -> tuple[list[np.ndarray], list[Segment]]:
    """Return two layers, of spleen and liver, and of a tumour of the spleen's number that overlaps both."""
    first, second = blocks(), np.zeros((12, 10, 8), dtype=np.uint32)
    second[4:8, 3:8, 2:4] = 9
    first[first == 1] = 8
    return [first, second], [
        Segment(7, "liver", 0, 7, 45), Segment(8, "spleen", 0, 1, 80, 1), Segment(9, "tumour", 1, 1, 40, 1)
    ]  # fmt: skip


def test_layers_of_nrrd_are_read_back_with_their_numbers(tmp_path):
    layers, segments = overlapping()
    assert write_layers(tmp_path / "map.seg.nrrd", layers, AFFINE, segments) == []
    labels = read_label_map(tmp_path / "map.seg.nrrd")
    assert [(each.name, each.number, each.label, each.count) for each in labels.segments] == [
        ("liver", 7, None, 45), ("spleen", 8, 1, 80), ("tumour", 9, 1, 40)
    ]  # fmt: skip
    for segment, number in zip(labels.segments, (7, 8, 9), strict=True):
        assert np.array_equal(labels.layers[segment.layer] == segment.value, layers[segment.layer] == number)


def test_what_nifti_cannot_hold_is_said(tmp_path):
    layers, segments = overlapping()
    notes = write_layers(tmp_path / "map.nii", layers, AFFINE, segments)
    assert notes == [
        "liver lost 20 of its 45 voxels to labels that overlap it: a name that ends in .seg.nrrd keeps all",
        "spleen lost 20 of its 80 voxels to labels that overlap it: a name that ends in .seg.nrrd keeps all",
    ]
    labels = read_label_map(tmp_path / "map.nii")
    assert {each.name: each.count for each in labels.segments} == {"liver": 25, "spleen": 60, "tumour": 40}


def test_a_layer_without_segments_is_not_written(tmp_path):
    layers, segments = overlapping()
    path = tmp_path / "map.nrrd"
    assert write_layers(path, layers, AFFINE, segments[2:]) == []
    assert {each.name: each.count for each in read_label_map(path).segments} == {"tumour": 40}


def field() -> np.ndarray:
    return 1e-3 * np.random.default_rng(1).normal(size=(4, 3, 2, 3))


def test_a_field_of_nifti_has_five_axes_and_vectors_in_ras(tmp_path):
    write_field(tmp_path / "field.nii.gz", field(), AFFINE)
    data = gzip.decompress((tmp_path / "field.nii.gz").read_bytes())
    assert struct.unpack_from("<8h", data, 40) == (5, 4, 3, 2, 1, 3, 1, 1)
    intent, kind = struct.unpack_from("<2h", data, 68)
    assert (intent, kind) == (1006, 16)  # displacement vectors of float32
    rows = np.array(struct.unpack_from("<12f", data, 280)).reshape(3, 4)
    np.testing.assert_allclose(rows, 1e3 * np.array([-1, -1, 1])[:, None] * AFFINE[:3], rtol=1e-6)
    start = int(struct.unpack_from("<f", data, 108)[0])
    values = np.frombuffer(data[start:], "<f4").reshape(3, 2, 3, 4).transpose(3, 2, 1, 0)
    np.testing.assert_allclose(values, 1e3 * field() * [-1, -1, 1], rtol=1e-6)


def test_a_field_of_nrrd_has_vectors_in_lps_and_states_that_it_resamples(tmp_path):
    write_field(tmp_path / "field.nrrd", field(), AFFINE)
    head, _, packed = (tmp_path / "field.nrrd").read_bytes().partition(b"\n\n")
    lines = head.decode().splitlines()
    assert "kinds: vector domain domain domain" in lines
    assert "sizes: 3 4 3 2" in lines
    assert "space: left-posterior-superior" in lines
    assert "displacement field type:=resampling" in lines
    values = np.frombuffer(gzip.decompress(packed), "<f4").reshape(2, 3, 4, 3).transpose(2, 1, 0, 3)
    np.testing.assert_allclose(values, 1e3 * field(), rtol=1e-6)


def test_other_names_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"out must end in \.nii, \.nii\.gz, \.nrrd, got 'map\.mha'; choose another"):
        check_volume_name(tmp_path.joinpath("map.mha").relative_to(tmp_path), "out")


def test_more_voxels_than_nifti_counts_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"at most 32767 voxels an axis, got 40000; use \.nrrd"):
        write_labels(tmp_path / "map.nii", np.zeros((40_000, 1, 1), dtype=int), AFFINE, {})
    assert not list(tmp_path.iterdir())
