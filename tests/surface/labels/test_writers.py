"""Writers of label maps and fields: what is written is read back, and headers hold what the formats require."""

from __future__ import annotations

import gzip
import struct

import numpy as np
import pytest

from palpate.faults import InputError
from palpate.surface.labels.reading import read_label_map
from palpate.surface.labels.writers import check_volume_name, write_field, write_labels

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
