"""DICOM SEG: the extra that reads it, and files of the shared data against highdicom's description of them."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from palpate.faults import FileFormatError, InputError
from palpate.surface.labels.dicom import DEFLATED_SYNTAX, read_dicom
from palpate.surface.labels.label_map import mask_of
from palpate.surface.labels.reading import read_label_map

DATA = Path(__file__).parents[4] / "shared" / "data" / "labels"
pydicom_or_not = find_spec("pydicom") is not None


def test_without_pydicom_the_extra_is_named(monkeypatch):
    monkeypatch.setattr("palpate.extras.find_spec", lambda name: None)
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
