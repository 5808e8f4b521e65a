"""DICOM SEG: the extra that reads it, and files of the shared data against highdicom's description of them."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from label_files import blocks, dicom

from palpate.core.faults import FileFormatError, InputError
from palpate.surface.labels.dicom import DEFLATED_SYNTAX, read_dicom
from palpate.surface.labels.label_map import mask_of
from palpate.surface.labels.reading import read_label_map

DATA = Path(__file__).parents[4] / "shared" / "data" / "labels"
STRAIGHT = [(0, 0, 5 * k) for k in range(8)]  # [mm]
pydicom_or_not = find_spec("pydicom") is not None


def test_without_pydicom_the_extra_is_named(monkeypatch):
    monkeypatch.setattr("palpate.core.extras.find_spec", lambda name: None)
    with pytest.raises(InputError, match=r"requires pydicom.*palpate\[dicom\]"):
        read_dicom(b"")


@pytest.mark.skipif(not pydicom_or_not, reason="pydicom is not installed")
class TestWithPydicom:
    def test_other_files_are_refused(self):
        for data in (b"", b"DICM" * 100, bytes(128) + b"DICM" + bytes(200)):
            with pytest.raises(FileFormatError):
                read_dicom(data)
        with pytest.raises(FileFormatError, match="deflated"):
            read_dicom(bytes(128) + b"DICM" + DEFLATED_SYNTAX)

    @pytest.mark.skipif(not DATA.is_dir(), reason="the data for developers are not here")
    def test_a_liver_with_slices_left_out_has_its_volume_and_place(self):
        labels = read_label_map(DATA / "liver_oblique_seg.dcm")
        assert [each.name for each in labels.segments] == ["Liver", "Mass", "Stomach"]
        mask = mask_of(labels, ["Liver", "Mass"])
        positions = mask.positions(np.argwhere(mask.voxels) + mask.start)
        assert mask.volume == pytest.approx(1.9913e-3, rel=5e-3)
        assert np.allclose(positions.mean(axis=0) * 1e3, [15.91, -1.54, -11.89], atol=0.3)

    @pytest.mark.skipif(not DATA.is_dir(), reason="the data for developers are not here")
    def test_segments_that_overlap_are_in_layers_and_fractions_are_cut(self):
        labels = read_label_map(DATA / "tiny_overlap_seg.dcm")
        assert len(labels.segments) == 2
        assert len({each.layer for each in labels.segments}) == 2
        assert read_label_map(DATA / "tiny_fractional_seg.dcm").notes == ("its fractions were cut at one half",)

    def test_a_volume_has_its_values_and_place(self):
        for kind in ("BINARY", "LABELMAP"):
            frames = blocks().transpose(2, 1, 0) == 1
            labels = read_dicom(dicom(frames, STRAIGHT, kind=kind, thickness=5.0))
            assert np.array_equal(labels.layers[0], blocks() == 1)
            assert np.allclose(labels.affine, 1e-3 * np.diag([1.0, 1.0, 5.0, 1e3]))
            assert labels.notes == ()

    def test_frames_of_a_tilted_gantry_are_a_sheared_image(self):
        places = [(0, 2 * k, 5 * k) for k in range(8)]
        labels = read_dicom(dicom(blocks().transpose(2, 1, 0) == 1, places, thickness=5.0))
        assert np.allclose(labels.affine[:3, 2], [0, 2e-3, 5e-3])
        assert labels.notes == (
            "its slices are sheared by 21.8 degrees, as of a tilted gantry: its image was taken so",
        )

    def test_frames_that_leave_slices_out_have_those_that_the_file_states(self):
        labels = read_dicom(dicom(np.ones((5, 6, 6)), [(0, 0, 10 * k) for k in range(5)], between=5.0))
        assert labels.shape == (6, 6, 9)
        assert labels.voxel_volume == pytest.approx(5e-9)
        assert not labels.layers[0][:, :, 1::2].any()
        assert "nearest frames 10 mm" in labels.notes[0]
        wide = read_dicom(dicom(np.ones((5, 6, 6)), [(0, 0, 10 * k) for k in range(5)], thickness=5.0))
        assert wide.shape == (6, 6, 5)
        assert "SliceThickness is 5 mm" in wide.notes[0]

    def test_segments_that_share_voxels_are_in_layers_with_their_numbers(self):
        frames, places = np.ones((16, 6, 6)), STRAIGHT * 2
        labels = read_dicom(dicom(frames, places, [2] * 8 + [5] * 8, {2: "liver", 5: "tumour"}, thickness=5.0))
        assert [(each.number, each.name, each.layer, each.count) for each in labels.segments] == [
            (2, "liver", 0, 288), (5, "tumour", 1, 288)
        ]  # fmt: skip
        assert labels.notes == ()

    @pytest.mark.parametrize(
        ("places", "changes", "message"),
        [
            (2, {"times": [1] * 8 + [2] * 8}, r"frames of 2 times or phases \(TemporalPositionIndex 1; Temp.* 2\)"),
            (2, {"times": [1] * 8 + [2] * 8, "numbers": [1] * 8 + [2] * 8}, "2 times or phases"),
            (2, {}, r"got 2 frames of liver at the same place \(slice 1\), as of phases"),
            (2, {"stacks": ["1"] * 8 + ["2"] * 8}, "or its 2 stacks; save one of them"),
            (2, {"kind": "LABELMAP"}, "2 frames of its label map at the same place"),
            (2, {"kind": "FRACTIONAL", "MaximumFractionalValue": 1}, "2 frames of liver at the same place"),
            (1, {"places": [(0, 0, "nan"), *STRAIGHT[1:]]}, "at finite places"),
            (1, {"turns": {3: (0, 1, 0, -1, 0, 0)}}, "must be parallel"),
            (1, {"turn": (1, 0, 0, 0.5, 1, 0)}, "two unit vectors at right angles"),
            (1, {"spacings": [[1.0, 1.0]] * 7 + [[1.0, 2.0]]}, "pixels of one size, got 1 x 1 mm to 1 x 2 mm"),
            (1, {"spacings": [[-1.0, 1.0]] * 8}, "PixelSpacing must be above 0, got -1 x 1 mm"),
            (1, {"kind": "FRACTIONAL", "MaximumFractionalValue": 0}, "MaximumFractionalValue must be at least 1"),
            (1, {"names": {1: "liver"}, "SegmentSequence": "twice"}, "numbers of their own, got 1 for 2 of them"),
        ],
    )
    def test_series_and_frames_that_do_not_fit_are_refused_by_their_reason(self, places, changes, message):
        if changes.get("SegmentSequence"):
            from pydicom.dataset import Dataset

            twice = [Dataset(), Dataset()]
            for each in twice:
                each.SegmentNumber, each.SegmentLabel = 1, "liver"
            changes = {"SegmentSequence": twice}
        changes = {"thickness": 5.0, "places": STRAIGHT * places} | changes
        with pytest.raises(FileFormatError, match=message):
            read_dicom(dicom(np.ones((8 * places, 6, 6)), **changes))

    def test_an_index_of_times_is_a_time_series(self):
        from pydicom.dataset import Dataset

        pointers = [Dataset(), Dataset()]
        for each, tag in zip(pointers, (0x0062000B, 0x00209128), strict=True):
            each.DimensionIndexPointer = tag
        frames = {"numbers": [1] * 4 + [2] * 4, "names": {1: "systole", 2: "diastole"}, "thickness": 5.0}
        data = dicom(np.ones((8, 6, 6)), STRAIGHT, **frames, DimensionIndexSequence=pointers)
        with pytest.raises(FileFormatError, match=r"frames of 8 times or phases \(index 1; index 2\)"):
            read_dicom(data)

    def test_one_frame_must_have_a_thickness(self):
        frame = np.ones((1, 6, 6))
        with pytest.raises(FileFormatError, match="one slice must have a thickness, got neither SliceThickness"):
            read_dicom(dicom(frame, STRAIGHT[:1]))
        assert read_dicom(dicom(frame, STRAIGHT[:1], thickness=4.0)).voxel_edges[2] == pytest.approx(4e-3)

    def test_the_padding_of_a_label_map_is_outside(self):
        frames = np.where(blocks() == 0, 9, blocks()).transpose(2, 1, 0)
        options = {"kind": "LABELMAP", "thickness": 5.0, "names": {1: "liver", 7: "stomach"}}
        labels = read_dicom(dicom(frames, STRAIGHT, PixelPaddingValue=9, **options))
        assert [(each.name, each.count) for each in labels.segments] == [("liver", 80), ("stomach", 45)]
        options["names"] = {0: "lung", 7: "stomach"}
        with pytest.raises(FileFormatError, match="numbers of at least 1, got 0"):
            read_dicom(dicom(np.where(frames == 1, 0, frames), STRAIGHT, PixelPaddingValue=9, **options))
