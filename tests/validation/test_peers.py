"""The page on peers has the figures of the committed result file."""

import importlib.util
import json
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="module")
def peers():
    spec = importlib.util.spec_from_file_location("peers", ROOT / "benchmarks" / "peers.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_page_has_the_table_of_the_result_file(peers):
    assert peers.table() in peers.PAGE.read_text()


def test_every_program_of_the_file_has_three_lattices_unless_it_took_too_long(peers):
    rows = json.loads(peers.RESULT.read_text())["rows"]
    for case in peers.CASES.values():
        for name in peers.PROGRAMS:
            times = [row for row in rows if row["case"] == case.name and row["program"] == name]
            assert len(times) == 3 or times[-1]["seconds_per_second"] * case.duration > peers.MAX_SECONDS


@pytest.mark.parametrize("law", ["neo_hookean", "logarithmic", "saint_venant_kirchhoff", "stable_neo_hookean",
                                 "smith_neo_hookean"])  # fmt: skip
def test_laws_agree_at_small_strain(peers, law):
    stress = getattr(peers, law)
    assert np.abs(stress(np.eye(3))).max() < 1e-9 * peers.SHEAR
    strain = np.array([[2.0, 1.0, 0.0], [1.0, -1.0, 3.0], [0.0, 3.0, 1.5]])
    slope = (stress(np.eye(3) + 1e-6 * strain) - stress(np.eye(3) - 1e-6 * strain)) / 2e-6
    linear = peers.LAME * np.trace(strain) * np.eye(3) + 2 * peers.SHEAR * strain
    np.testing.assert_allclose(slope, linear, rtol=1e-6, atol=1e-6 * peers.SHEAR)


def test_even_strain_of_tetrahedra_has_the_force_of_the_stress_on_the_face(peers):
    rest = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
    F = np.diag([0.8, 1.1, 1.1])
    forces = peers.tetrahedra_force(rest, rest @ F.T, np.array([[0, 1, 2, 3]]), peers.neo_hookean)
    np.testing.assert_allclose(forces.sum(axis=0), 0.0, atol=1e-9)
    np.testing.assert_allclose(forces[1:].T, peers.neo_hookean(F) / 6, rtol=1e-12)


def test_shares_of_a_face_are_those_of_its_area(peers):
    places = np.array([[y, z] for y in (0.0, 0.5, 1.0) for z in (0.0, 0.5, 1.0)])
    np.testing.assert_allclose(peers.end_weights(places), np.outer([1, 2, 1], [1, 2, 1]).ravel() / 16)
