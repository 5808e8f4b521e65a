"""Folders that an export completes or leaves empty."""

from __future__ import annotations

import pytest

import palpate as pt
from palpate.export.folder import check_new, complete_folder


def test_an_export_that_stops_leaves_no_file_and_does_not_block_the_next(tmp_path):
    folder = tmp_path / "made"

    def stop_halfway():
        with complete_folder(folder) as part:
            (part / "half").write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stop_halfway()
    assert list(tmp_path.iterdir()) == []
    (tmp_path / ".made.part").mkdir()  # of a process that was killed
    (tmp_path / ".made.part" / "half").write_text("half")
    check_new(folder)
    folder.mkdir()
    with complete_folder(folder) as part:
        (part / "inner").mkdir()
        (part / "inner" / "file").write_text("all")
        assert list(folder.iterdir()) == []
    assert [path.relative_to(tmp_path).as_posix() for path in sorted(tmp_path.rglob("*"))] == [
        "made", "made/inner", "made/inner/file",
    ]  # fmt: skip
    with pytest.raises(pt.InputError, match="folder must be new or empty"):
        check_new(folder)
