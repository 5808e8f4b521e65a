"""The generated liver, and the published one from a file that is at hand."""

from __future__ import annotations

import hashlib
import shutil
from pathlib import Path

import numpy as np
import pytest

import palpate as pt
from palpate.scenes import published
from palpate.scenes.published import LIVER_PART

DATA = Path(__file__).parents[3] / "shared" / "data" / "hra"


@pytest.fixture(scope="module")
def liver():
    return pt.liver_surface(0.004)


def test_the_liver_is_one_closed_solid_of_the_given_volume(liver):
    checked = pt.io.check_surface(liver)
    assert checked.problems == ()
    assert (checked.components, checked.euler) == (1, 2)
    assert checked.volume == pytest.approx(1.5e-3, rel=1e-9)
    assert pt.liver_surface(0.004, volume=2e-3).volume == pytest.approx(2e-3, rel=1e-9)


@pytest.mark.slow
def test_a_smaller_liver_has_the_same_shape(liver):
    smaller = pt.liver_surface(0.002, volume=1.5e-3 / 8)
    np.testing.assert_allclose(np.ptp(smaller.vertices, axis=0), np.ptp(liver.vertices, axis=0) / 2, rtol=1e-3)


def test_the_liver_has_human_proportions(liver):
    # adults: 20 to 25 cm wide, 13 to 17 high and deep; most of it in the right lobe
    wide, deep, high = np.ptp(liver.vertices, axis=0)
    assert 0.19 < wide < 0.25
    assert 0.12 < deep < 0.17
    assert 0.12 < high < 0.17
    cloud = pt.fill(liver, 0.012)
    middle = 0.5 * (liver.vertices[:, 0].min() + liver.vertices[:, 0].max())
    assert 0.6 < cloud.volumes[cloud.points[:, 0] < middle].sum() / 1.5e-3 < 0.85


@pytest.mark.slow
def test_the_area_of_the_liver_converges_with_the_resolution(liver):
    areas = [pt.liver_surface(h).area for h in (0.008, 0.002)]
    assert abs(liver.area - areas[1]) < 0.5 * abs(areas[0] - areas[1])


def test_the_liver_is_the_same_every_time(liver):
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
    body = pt.io.fetch_liver(tmp_path, source="https://nowhere.invalid/VH_F_Liver.glb")
    assert LIVER_PART in body.name
    assert pt.io.check_surface(body).errors == ()


def test_a_download_with_another_checksum_is_refused(tmp_path):
    (tmp_path / "other.glb").write_bytes(b"another file")
    with pytest.raises(pt.FileFormatError, match="SHA-256 differs"):
        pt.io.fetch_liver(tmp_path / "kept", source=(tmp_path / "other.glb").as_uri())
    assert not (tmp_path / "kept").exists()


def test_a_damaged_cached_file_is_downloaded_again(tmp_path, monkeypatch):
    cube = Path(tmp_path, "cube.stl")
    cube.write_bytes(b"what is published")
    monkeypatch.setattr(published, "LIVER_SHA256", hashlib.sha256(b"what is published").hexdigest())
    monkeypatch.setattr(published, "read_surface", lambda path, **options: path.read_bytes())
    (tmp_path / published.LIVER_FILE).write_bytes(b"cut short")
    for _ in range(2):
        assert pt.io.fetch_liver(tmp_path, source=cube.as_uri()) == b"what is published"
        cube.unlink(missing_ok=True)  # the second time, the file that was kept is taken


def test_invalid_and_unreachable_addresses_are_errors(tmp_path):
    with pytest.raises(pt.InputError, match="source must be an address, got 'liver'"):
        pt.io.fetch_liver(tmp_path, source="liver")
    with pytest.raises(OSError, match="No such file"):
        pt.io.fetch_liver(tmp_path, source=(tmp_path / "none.glb").as_uri())
