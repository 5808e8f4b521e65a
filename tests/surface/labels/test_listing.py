"""Lists of labels: likely organs first, with volumes and pieces, and the choice that they offer."""

from __future__ import annotations

import numpy as np
import pytest
from label_files import ball, caret, nifti

import palpate as pt
from palpate.core.faults import ChoiceError
from palpate.surface.labels.listing import choice_of_labels, label_rows
from palpate.surface.labels.nifti import read_nifti

NAMES = {1: "hip_left", 2: "liver", 3: "lung", 4: "lung"}


@pytest.fixture
def data():
    values = np.zeros((40, 30, 30), dtype="u1")
    values[:24, :24, :24] = 2 * ball(5.0)
    values[25:] = 1
    values[0, :3, 0], values[0, 5:7, 0] = 3, 4
    values[2, 5:7, 0] = 3
    return nifti(values, sform=np.diag([2.0, 2.0, 2.0, 1.0]), extension=caret(NAMES))


def test_likely_organs_are_first_with_volume_pieces_and_the_edge(data):
    labels = read_nifti(data, "trunk.nii")
    rows = label_rows(labels)
    assert [(each.number, each.pieces, each.at_edge) for each in rows] == [
        (2, 1, False), (3, 2, True), (4, 1, True), (1, 1, True)
    ]  # fmt: skip
    assert rows[0].volume == pytest.approx(np.count_nonzero(ball(5.0)) * 8e-9)
    assert [each.part for each in rows] == ["liver", "3", "4", "hip_left"]


def test_a_file_of_several_labels_offers_a_choice(data, tmp_path):
    (tmp_path / "trunk.nii").write_bytes(data)
    with pytest.raises(
        ChoiceError, match=r"part must be given for trunk.nii, a label map of 4 labels, .*'liver'"
    ) as error:
        pt.io.read_surface(tmp_path / "trunk.nii")
    assert error.value.choice == {"part": "liver"}
    title, first, *_ = error.value.table.splitlines()
    assert title.split()[:4] == ["number", "name", "ml", "pieces"]
    assert first.split() == ["2", "liver", f"{np.count_nonzero(ball(5.0)) * 8e-3:.1f}", "1"]
    assert str(choice_of_labels(read_nifti(data, "trunk.nii"))) == str(error.value)


def test_parts_of_a_label_map_are_one_body_of_known_units(data, tmp_path):
    path = tmp_path / "trunk.nii"
    path.write_bytes(data)
    surface = pt.io.read_surface(path, part="liver", scale=2.0)
    assert surface.volume == pytest.approx(8 * np.count_nonzero(ball(5.0)) * 8e-9, rel=2e-3)
    assert (surface.unit, surface.space, surface.name) == (1e-3, "LPS", "trunk.nii, part liver")
    with pytest.raises(pt.InputError, match="units must be omitted for label maps"):
        pt.io.read_surface(path, part="liver", units="m")
    (tmp_path / "names.txt").write_text("2 organ\n", encoding="utf-8")
    assert pt.io.read_surface(path, part="organ", labels=tmp_path / "names.txt").closed
    with pytest.raises(pt.InputError, match="labels must be omitted"):
        pt.io.read_surface(_tetrahedron(tmp_path), units="mm", labels=tmp_path / "names.txt")


def _tetrahedron(folder):
    path = folder / "body.off"
    path.write_text("OFF\n4 4 0\n0 0 0\n60 0 0\n0 60 0\n0 0 60\n3 0 2 1\n3 0 1 3\n3 1 2 3\n3 0 3 2\n", encoding="utf-8")
    return path
