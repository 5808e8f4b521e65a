"""The generated liver, and the published one from a file that is at hand."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import palpate as pt
from palpate.scenes.published import PART

DATA = Path(__file__).parents[3] / "shared" / "data" / "hra"


@pytest.fixture(scope="module")
def liver():
    return pt.liver_surface(0.004)


def test_the_liver_is_one_closed_solid_of_the_wished_volume(liver):
    found = pt.check_surface(liver)
    assert found.problems == ()
    assert (found.components, found.euler) == (1, 2)
    assert found.volume == pytest.approx(1.5e-3, rel=1e-9)
    assert pt.liver_surface(0.004, volume=2e-3).volume == pytest.approx(2e-3, rel=1e-9)


def test_it_has_a_livers_proportions(liver):
    # adults: 20 to 25 cm wide, 13 to 17 high and deep; most of it in the right lobe
    wide, deep, high = np.ptp(liver.vertices, axis=0)
    assert 0.19 < wide < 0.25
    assert 0.12 < deep < 0.17
    assert 0.12 < high < 0.17
    cloud = pt.fill(liver, 0.012)
    middle = 0.5 * (liver.vertices[:, 0].min() + liver.vertices[:, 0].max())
    assert 0.6 < cloud.volumes[cloud.points[:, 0] < middle].sum() / 1.5e-3 < 0.85


def test_it_converges_with_the_resolution(liver):
    areas = [pt.liver_surface(h).area for h in (0.008, 0.002)]
    assert abs(liver.area - areas[1]) < 0.5 * abs(areas[0] - areas[1])


def test_it_is_the_same_every_time(liver):
    again = pt.liver_surface(0.004)
    assert np.array_equal(again.vertices, liver.vertices)
    assert np.array_equal(again.triangles, liver.triangles)


@pytest.mark.parametrize("arguments", [{"resolution": 0.05}, {"volume": -1.0}])
def test_parameters_out_of_range_are_named(arguments):
    with pytest.raises(pt.InputError, match=next(iter(arguments))):
        pt.liver_surface(**arguments)


@pytest.mark.skipif(not DATA.is_dir(), reason="the published liver is not at hand")
def test_the_published_liver_comes_from_the_cache(tmp_path):
    shutil.copy(DATA / "VH_F_Liver.glb", tmp_path)
    body = pt.fetch_liver(tmp_path, source="https://nowhere.invalid/VH_F_Liver.glb")
    assert PART in body.name
    assert pt.check_surface(body).errors == ()


def test_another_file_in_its_place_is_not_taken(tmp_path, monkeypatch):
    import pooch

    monkeypatch.setattr(pooch, "retrieve", _download_of_another)
    with pytest.raises(pt.FileFormatError, match="SHA-256 differs"):
        pt.fetch_liver(tmp_path, source="https://nowhere.invalid/VH_F_Liver.glb")


def _download_of_another(url, known_hash, fname, path):
    """What pooch does after a download: write it, and compare."""
    import pooch.hashes

    path.mkdir(exist_ok=True)
    (path / fname).write_bytes(b"another file")
    pooch.hashes.hash_matches(str(path / fname), known_hash, strict=True)
    raise AssertionError("the hash of another file must not match")
