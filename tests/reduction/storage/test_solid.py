"""A full body comes back from a file as it was."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.core.faults import InputError
from palpate.core.sealed import open_sealed, write_sealed
from palpate.reduction.storage.solid import body_contents, body_in

pytestmark = pytest.mark.slow

LAW = pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1000.0, poisson=0.45)
STIFF = pt.materials.MooneyRivlin(C1=8e3, C2=1e3, density=1000.0, poisson=0.45)


def written_and_read(body, path, **changed):
    """Return the body that is read from the file of a body, whose header was changed."""
    header, arrays = body_contents(body)
    write_sealed(path, "body", 1, header | changed, arrays, {})
    file = open_sealed(path, "body", 1)
    return body_in({name: value for name, value in file.header.items() if name in header}, file, "")


def test_a_body_of_two_materials_is_made_again_with_its_forces(tmp_path, small_cloud):
    cloud = small_cloud.with_group("stiff", small_cloud.points[:, 0] > 0.0075)
    body = pt.Solid(cloud, {"": LAW, "stiff": STIFF}, "z-", mass_damping=8.0, stiffness_damping=1e-4)
    again = written_and_read(body, tmp_path / "body")
    assert again.tissue.regions.materials == (LAW, STIFF)
    assert (again.supports, again.mass_damping, again.stiffness_damping) == (body.supports, 8.0, 1e-4)
    u = np.random.default_rng(0).standard_normal(cloud.points.shape) * 1e-4
    np.testing.assert_array_equal(again.force(u), body.force(u))


def test_a_sheet_is_made_again_with_its_forces(tmp_path):
    rubber = pt.materials.NeoHookean(C1=0.17e6, density=1200.0, poisson=0.5)
    body = pt.Membrane(pt.disc(0.05, 0.01), rubber, 1e-3, "rim", prestretch=1.05, relaxed=False, neighbours=15)
    again = written_and_read(body, tmp_path / "sheet")
    assert (again.thickness, again.prestretch, again.relaxed, again.neighbours) == (1e-3, 1.05, False, 15)
    assert again.stability.step == body.stability.step
    u = np.random.default_rng(0).standard_normal((len(body.cloud), 3)) * 1e-4
    np.testing.assert_array_equal(again.force(u), body.force(u))
    with pytest.raises(InputError, match=r"thickness must be in \(0, inf\) m"):
        written_and_read(body, tmp_path / "thin", thickness=0.0)
