"""MetaImage: values and positions, and headers that lie or name other files."""

from __future__ import annotations

import numpy as np
import pytest
from label_files import AFFINE, blocks, metaimage

from palpate.faults import FileFormatError
from palpate.surface.labels.metaimage import read_metaimage


@pytest.mark.parametrize("packed", [False, True])
@pytest.mark.parametrize("dtype", ["u1", "i2", "f4"])
def test_values_and_positions_are_those_of_the_header(dtype, packed):
    labels = read_metaimage(metaimage(blocks(dtype), packed=packed))
    assert np.array_equal(labels.layers[0], blocks())
    assert np.allclose(labels.affine, np.diag([1e-3, 1e-3, 1e-3, 1]) @ AFFINE)
    assert labels.space == "LPS"


@pytest.mark.parametrize(
    ("options", "change", "message"),
    [
        ({"data_file": "/etc/passwd"}, (b"", b""), "in the same file"),
        ({"data_file": "slices%03d.raw 1 9 1"}, (b"", b""), "in the same file"),
        ({"lines": ["ElementNumberOfChannels = 3"]}, (b"", b""), "3 channels"),
        ({}, (b"MET_UCHAR", b"MET_UCHAR_ARRAY"), "numbers of labels"),
        ({}, (b"DimSize = 12 10 8", b"DimSize = 12 10 9"), "cut short"),
        ({}, (b"DimSize = 12 10 8", b"DimSize = 99999 99999 9999"), r"at most 2\^29"),
        ({}, (b"DimSize = 12 10 8", b"DimSize = nan 1 1"), "whole numbers"),
        ({}, (b"NDims = 3", b"NDims = 4"), "2 or 3"),
        ({}, (b"ElementSpacing = ", b"ElementSpacing = x "), "ElementSpacing must be 3 numbers"),
        ({}, (b"TransformMatrix = ", b"Transformed = "), None),
        ({}, (b"ElementDataFile", b"Element"), "end with ElementDataFile"),
        ({}, (b"BinaryData = True", b"BinaryData = False"), "must be binary"),
    ],
)
def test_headers_that_lie_are_refused_by_name(options, change, message):
    data = metaimage(blocks(), **options)
    assert change[0] in data
    data = data.replace(*change, 1)
    if message is None:  # without a matrix the axes are those of the frame
        affine = read_metaimage(data).affine
        assert np.allclose(affine[:3, :3], np.diag(1e-3 * np.linalg.norm(AFFINE[:3, :3], axis=0)))
        return
    with pytest.raises(FileFormatError, match=message):
        read_metaimage(data)
