"""The fuzz of label maps: forged files of every format, read and used in this process within bounds."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parents[2] / "validation"))
import fuzz_labels
from fuzz_kinds import damaged

TRIALS = 12


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["nii", "nii.gz", "nrrd", "mha"])
def test_forged_and_damaged_label_maps_are_read_or_refused_in_a_line(suffix, tmp_path, monkeypatch):
    monkeypatch.setattr(fuzz_labels, "MAX_SECONDS", np.inf)  # no test compares a time with a bound
    answers = []
    for number in range(TRIALS):
        rng = np.random.default_rng([5, number])
        data = fuzz_labels.compose(suffix, rng)
        path = tmp_path / f"changed.{suffix}"
        path.write_bytes(damaged(rng, data) if number % 2 else data)
        answers.append(fuzz_labels.read_and_use(path, rng))
    assert set(answers) <= {"accepted", "refused"}
    assert "refused" in answers


def test_the_fuzz_sees_a_reader_that_opens_what_a_header_names(tmp_path, monkeypatch):
    def reading(path):
        raise fuzz_labels.pt.InputError(Path("/etc/passwd").read_text(encoding="utf-8")[:5].replace("\n", " "))

    monkeypatch.setattr(fuzz_labels, "read_label_map", reading)
    assert fuzz_labels.read_and_use(tmp_path / "a.nii", np.random.default_rng(0)) == "opened ['/etc/passwd']"
