"""Names of labels from JSON, color tables and descriptions."""

from __future__ import annotations

import pytest

from palpate.core.faults import FileFormatError
from palpate.surface.labels.names import read_names

SNAP = '# ITK-SnAP\n    0  0 0 0  0  0  0  "Clear Label"\n    5  255 0 0  1 1 1  "Liver, left"\n'


@pytest.mark.parametrize(
    ("file", "text", "names"),
    [
        ("a.json", '{"5": "liver", "6": "stomach"}', {5: "liver", 6: "stomach"}),
        ("a.json", '{"liver": 5}', {5: "liver"}),
        ("dataset.json", '{"labels": {"background": 0, "liver": 5, "whole": [1, 2]}}', {0: "background", 5: "liver"}),
        ("a.ctbl", "# Color table\n0 None 0 0 0 0\n5 liver_left 221 130 101 255\n", {0: "None", 5: "liver_left"}),
        ("a.txt", SNAP, {0: "Clear Label", 5: "Liver, left"}),
        ("a.txt", "5 liver\n6: stomach wall\n", {5: "liver", 6: "stomach wall"}),
    ],
)  # fmt: skip
def test_names_are_read_by_number(tmp_path, file, text, names):
    (tmp_path / file).write_text(text, encoding="utf-8")
    assert read_names(tmp_path / file) == names


@pytest.mark.parametrize("text", ["liver\n", "", "{}", "[1]", '{"a": ', '{"5": 6}', "9" * 400 + " liver"])
def test_other_texts_are_refused(tmp_path, text):
    (tmp_path / "a.txt").write_text(text, encoding="utf-8")
    with pytest.raises(FileFormatError, match=r"a\.txt"):
        read_names(tmp_path / "a.txt")
