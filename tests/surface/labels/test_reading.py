"""Label maps from files: the example's and those of the shared data, hostile ones, names, and limits of size."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest
from label_files import RAS_TO_LPS, blocks, metaimage, nifti, nrrd

from palpate.core.faults import FileFormatError, InputError
from palpate.surface.checks import check_surface
from palpate.surface.files import read_surface
from palpate.surface.formats.names import LABEL_FORMATS, listed_formats
from palpate.surface.labels.label_map import mask_of
from palpate.surface.labels.reading import READER_BY_FORMAT, is_label_map, read_label_map

EXAMPLE = Path(__file__).parents[3] / "examples" / "trunk.nii.gz"
DATA = Path(__file__).parents[4] / "shared" / "data" / "labels"
shared = pytest.mark.skipif(not DATA.is_dir(), reason="the data for developers are not here")

CENTROID = np.array([-15.91, 1.54, -11.89])  # [mm, RAS] of liver and tumour in every made file
VOLUME = 1.9913e-3  # [m^3]
MADE = [
    "liver_2mm_ras.nii.gz", "liver_5mm_slices_lps.nii.gz", "liver_oblique_qform_only.nii.gz",
    "liver_sform_qform_conflict.nii.gz", "liver_metres.nii.gz", "liver_float_0988.nii.gz", "liver_4d_one.nii.gz",
    "liver_int16_big_endian.nii", "liver_sheared_layers.seg.nrrd", "liver_oblique.mha", "liver_deep_tumour.nii.gz",
]  # fmt: skip


@pytest.fixture(scope="module")
def liver():
    """The voxels 1 of the liver and 2 of its tumour in the example, and their grid (4, 4) [mm] in RAS and in LPS."""
    labels = read_label_map(EXAMPLE)
    organ, tumour = (mask_of(labels, name) for name in ("liver", "liver_tumor"))
    voxels = np.zeros(organ.shape, "u1")
    for value, mask in enumerate((organ, tumour), 1):
        voxels[tuple(slice(k, k + n) for k, n in zip(mask.start, mask.voxels.shape, strict=True))][mask.voxels] = value
    lps = np.diag([1e3, 1e3, 1e3, 1.0]) @ labels.affine
    return voxels, RAS_TO_LPS @ lps, lps


WRITTEN = {
    "a.nii": lambda voxels, ras, lps: nifti(voxels.astype("i2"), sform=ras),
    "big endian.nii": lambda voxels, ras, lps: nifti(voxels.astype("i2"), sform=ras, order=">"),
    "floats.nii": lambda voxels, ras, lps: nifti(voxels.astype("f4"), sform=ras),
    "metres.nii": lambda voxels, ras, lps: nifti(voxels, sform=np.diag([1e-3, 1e-3, 1e-3, 1.0]) @ ras, units=1),
    "of 4 axes.nii": lambda voxels, ras, lps: nifti(voxels[..., None], sform=ras),
    "mirrored.nii": lambda voxels, ras, lps: nifti(voxels[::-1], sform=ras @ mirror(voxels)),
    "a.nrrd": lambda voxels, ras, lps: nrrd(voxels, affine=lps),
    "a.mha": lambda voxels, ras, lps: metaimage(voxels, affine=lps),
}


def mirror(voxels):
    """The map of voxels from those counted the other way along the first axis."""
    map = np.diag([-1.0, 1.0, 1.0, 1.0])
    map[0, 3] = len(voxels) - 1
    return map


@pytest.mark.parametrize("name", WRITTEN)
def test_the_liver_of_the_example_has_its_volume_and_place_in_every_format(name, liver, tmp_path):
    (tmp_path / name).write_bytes(WRITTEN[name](*liver))
    expected = mask_of(read_label_map(EXAMPLE), ["liver", "liver_tumor"])
    labels = read_label_map(tmp_path / name)
    mask = mask_of(labels, ["1", "2"])
    assert labels.space == "LPS"
    assert mask.volume == pytest.approx(expected.volume, rel=1e-6)
    middles = [each.positions(np.argwhere(each.voxels) + each.start).mean(axis=0) for each in (mask, expected)]
    np.testing.assert_allclose(*middles, atol=1e-7)


@shared
@pytest.mark.parametrize("name", MADE)
def test_the_liver_has_its_volume_and_place_in_every_file(name):
    labels = read_label_map(DATA / name)
    mask = mask_of(labels, ["liver", "tumour"] if "seg" in name else ["1", "2"])
    positions = mask.positions(np.argwhere(mask.voxels) + mask.start)
    assert labels.space == "LPS"
    assert mask.volume == pytest.approx(VOLUME, rel=2e-3)
    assert np.allclose(positions.mean(axis=0) * 1e3, CENTROID * [-1, -1, 1], atol=0.15)


@shared
def test_the_bladder_of_an_old_slicer_lies_where_the_patient_has_it():
    labels = read_label_map(DATA / "bladder_old_slicer.seg.nrrd")
    mask = mask_of(labels)
    positions = mask.positions(np.argwhere(mask.voxels) + mask.start) * 1e3 * [-1, -1, 1]  # RAS
    assert np.allclose(positions.min(axis=0), [-29.3, -21.5, -65.0], atol=1.0)
    assert np.allclose(positions.max(axis=0), [36.1, 59.6, -5.0], atol=2.6)


def test_names_of_a_trunk_come_from_its_header():
    labels = read_label_map(EXAMPLE)
    assert len(labels.segments) == 62
    assert next(each.name for each in labels.segments if each.number == 5) == "liver"


@shared
@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("x_dim9.nii", "3 axes, got 9"),
        ("x_negative_dim.nii", "got -5"),
        ("x_offset.nii", "begin at byte"),
        ("x_singular.nii.gz", "orientation"),
        ("x_overflow.nrrd", r"at most 2\^29"),
        ("x_other_file.mha", "in the same file"),
        ("x_bomb.nii.gz", "voxels of 0 alone"),
        ("liver_cut_short.nii.gz", "cut short"),
    ],
)
def test_hostile_files_are_refused_in_a_line_that_names_them(name, message):
    with pytest.raises(FileFormatError, match=message) as caught:
        read_label_map(DATA / name)
    assert name in str(caught.value)


def test_names_of_a_file_replace_those_that_it_lacks(tmp_path):
    (tmp_path / "a.nii").write_bytes(nifti(blocks()))
    (tmp_path / "names.json").write_text('{"liver": 1, "stomach": 7, "aorta": 8}', encoding="utf-8")
    labels = read_label_map(tmp_path / "a.nii", tmp_path / "names.json")
    assert [each.name for each in labels.segments] == ["liver", "stomach"]
    assert labels.absent == ("aorta",)
    assert [each.name for each in read_label_map(tmp_path / "a.nii").segments] == ["label 1", "label 7"]


def test_every_format_of_the_table_has_a_reader():
    assert list(READER_BY_FORMAT) == list(LABEL_FORMATS)
    assert all(name in listed_formats() for name in LABEL_FORMATS.values())


def test_formats_are_told_by_their_suffixes(tmp_path):
    for name in ("a.nii", "a.NII.GZ", "a.seg.nrrd", "a.mha", "a.mhd", "a.dcm"):
        assert is_label_map(name)
    for name in ("a.stl.gz", "a.nrrdx", "nii", "liver"):
        assert not is_label_map(name)
    (tmp_path / "a.nii.gz").write_bytes(nifti(blocks()))
    with pytest.raises(FileFormatError, match="must be compressed by gzip"):
        read_label_map(tmp_path / "a.nii.gz")
    with pytest.raises(FileNotFoundError):
        read_label_map(tmp_path / "nowhere.nii")


@pytest.mark.parametrize("name", ["IM0001", "1.2.840.55", "volume.img"])
def test_a_file_whose_name_lacks_its_suffix_is_refused_with_the_right_one(name, tmp_path):
    heads = {
        ".dcm": bytes(128) + b"DICM", ".nrrd": nrrd(blocks()), ".mha": metaimage(blocks()),
        ".nii": nifti(blocks()), ".nii.gz": gzip.compress(nifti(blocks(), wide=True)),
    }  # fmt: skip
    for suffix, data in heads.items():
        (tmp_path / name).write_bytes(data)
        for read in (read_label_map, read_surface):
            with pytest.raises(FileFormatError, match=rf"by its first bytes, .*: rename it to end in \{suffix}$"):
                read(tmp_path / name)
    (tmp_path / name).write_bytes(b"else")
    with pytest.raises(FileFormatError, match="must be"):
        read_surface(tmp_path / name)


def test_of_a_folder_of_dicom_files_the_segmentation_is_named(tmp_path):
    (tmp_path / "IM0001").write_bytes(bytes(128) + b"DICM" + b"1.2.840.10008.5.1.4.1.1.2")
    with pytest.raises(FileFormatError, match="a folder of DICOM images without a segmentation"):
        read_surface(tmp_path)
    (tmp_path / "IM0002").write_bytes(bytes(128) + b"DICM" + b"1.2.840.10008.5.1.4.1.1.66.4")
    with pytest.raises(FileFormatError, match=r"give its DICOM segmentation, IM0002, and let its name end in \.dcm"):
        read_surface(tmp_path)
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileFormatError, match="not a regular file"):
        read_surface(tmp_path / "empty")


def test_notes_and_a_size_that_no_organ_has_are_warnings_of_the_surface(tmp_path):
    voxels = np.pad(np.ones((20, 20, 20), "u1"), 2)
    for edge, warns in ((2.0, False), (0.2, True), (40.0, True)):
        (tmp_path / "a.nii").write_bytes(nifti(voxels, sform=np.diag([edge, edge, edge, 1.0])))
        surface = read_surface(tmp_path / "a.nii")
        said = [each for each in surface.warnings if "is not that of an organ" in each and "scale=" in each]
        assert len(said) == warns
        assert not [each for each in check_surface(surface).problems if each.name == "scale"]  # it is said once
    assert read_surface(tmp_path / "a.nii", scale=0.1).warnings == ()
    voxels[12] = 0
    (tmp_path / "a.nii").write_bytes(nifti(voxels, sform=np.diag([2.0, 2.0, 2.0, 1.0]), scl=[3, 0]))
    for part, message in (
        ("3", r"of 2 pieces, .*; a\.nii: its labels are its numbers times scl_slope 3"),
        ("1", "must be one"),
    ):
        with pytest.raises(InputError, match=message):
            read_surface(tmp_path / "a.nii", part=part)


def test_unforeseen_errors_of_a_reader_become_one_line(tmp_path):
    data = bytearray(nifti(blocks()))
    data[40:42] = b"\xff\x7f"
    (tmp_path / "a.nii").write_bytes(data)
    with pytest.raises(FileFormatError, match=r"a\.nii"):
        read_label_map(tmp_path / "a.nii")
