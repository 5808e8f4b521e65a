"""A full body of two materials comes back from a file as it was."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.core.sealed import open_sealed, write_sealed
from palpate.reduction.storage.solid import body_contents, body_in

pytestmark = pytest.mark.slow

LAW = pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1000.0, poisson=0.45)
STIFF = pt.materials.MooneyRivlin(C1=8e3, C2=1e3, density=1000.0, poisson=0.45)


def test_a_body_of_two_materials_is_made_again_with_its_forces(tmp_path, small_cloud):
    cloud = small_cloud.with_group("stiff", small_cloud.points[:, 0] > 0.0075)
    body = pt.Solid(cloud, {"": LAW, "stiff": STIFF}, "z-", mass_damping=8.0, stiffness_damping=1e-4)
    header, arrays = body_contents(body)
    write_sealed(tmp_path / "body", "body", 1, header, arrays, {})
    file = open_sealed(tmp_path / "body", "body", 1)
    again = body_in({name: value for name, value in file.header.items() if name in header}, file, "")
    assert again.tissue.regions.materials == (LAW, STIFF)
    assert (again.supports, again.mass_damping, again.stiffness_damping) == (body.supports, 8.0, 1e-4)
    u = np.random.default_rng(0).standard_normal(cloud.points.shape) * 1e-4
    np.testing.assert_array_equal(again.force(u), body.force(u))
