"""A body is chosen on the page: refused choices are reported, and the first good one is yielded with its host."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from palpate.app.view.choose_labels import choose_on_page
from palpate.app.view.server.address import LOOPBACK
from palpate.app.view.server.host import Host
from palpate.app.view.server.label_choice import Chosen, LabelChoice
from palpate.scenes.open_scene import open_scene

sys.path.insert(0, str(Path(__file__).parents[2] / "surface" / "labels"))
from label_files import caret, nifti

ADDRESS = (18720, LOOPBACK, False)


def write(path, names):
    """Write a label map of a cube, and of two pieces that are the second label."""
    values = np.zeros((30, 20, 20), dtype="u1")
    values[2:14, 2:14, 2:14] = 1
    values[18:24, 2:8, 2:8] = values[18:24, 12:18, 12:18] = len(names)
    path.write_bytes(nifti(values, sform=np.diag([3.0, 3.0, 3.0, 1.0]), extension=caret(names)))
    return str(path)


@pytest.fixture
def reported(monkeypatch):
    """Reasons for which choices were refused on the page."""
    reasons = []
    monkeypatch.setattr(Host, "refuse", lambda self, reason: reasons.append(reason))
    return reasons


def test_a_choice_that_makes_no_body_is_reported_and_the_next_is_yielded(tmp_path, monkeypatch, reported, capsys):
    file = write(tmp_path / "two.nii", {1: "liver", 2: "kidneys"})
    choices = iter([Chosen(("kidneys",)), Chosen(("liver",))])
    monkeypatch.setattr(LabelChoice, "wait", lambda self: next(choices))
    listed = []

    def read(parts, without):
        assert without == ()
        listed.append(parts)
        return open_scene(file, part=parts).surface

    with choose_on_page(file, None, read, ADDRESS) as (host, surface):
        assert isinstance(host, Host)
        assert surface.volume == pytest.approx((12 * 3e-3) ** 3, rel=0.01)
        assert host.address.startswith("http://")
    assert listed == [("kidneys",), ("liver",)]
    (reason,) = reported
    assert "2 pieces" in reason
    said = capsys.readouterr()
    assert "--part liver" in said.out + said.err


def test_a_map_of_one_label_needs_no_choice(tmp_path, reported):
    file = write(tmp_path / "one.nii", {1: "liver"})
    with choose_on_page(file, None, lambda parts, without: parts, ADDRESS) as (place, parts):
        assert (place, parts) == (ADDRESS, ())
    assert not reported
