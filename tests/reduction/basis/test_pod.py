"""Modes of snapshots: orthonormality, the identity (27), and sizes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import palpate as pt


@pytest.fixture(scope="module")
def weights():
    return np.random.default_rng(0).uniform(0.1, 1.0, 30)


@pytest.fixture(scope="module")
def snapshots():
    random = np.random.default_rng(1)
    decay = np.diag(10.0 ** -np.arange(12))
    return (random.normal(size=(12, 12)) @ decay @ random.normal(size=(12, 90))).reshape(12, 30, 3)


def inner(one, other, weights):
    return np.einsum("n,inc,jnc->ij", weights, one, other)


def norms(fields, weights):
    return np.einsum("n,inc,inc->i", weights, fields, fields)


def test_modes_are_orthonormal_in_the_inner_product(snapshots, weights):
    basis = pt.pod(snapshots, weights, modes=8)
    np.testing.assert_allclose(inner(basis.modes, basis.modes, weights), np.eye(8), atol=1e-12)


@pytest.mark.parametrize("modes", [1, 3, 7, 11])
def test_the_projection_error_is_the_sum_of_the_other_eigenvalues_27(snapshots, weights, modes):
    basis = pt.pod(snapshots, weights, modes=modes)
    left = snapshots - basis.lift(basis.project(snapshots))
    total = norms(snapshots, weights).sum()
    assert norms(left, weights).sum() == pytest.approx(np.sum(basis.singular_values[modes:] ** 2), abs=1e-14 * total)
    assert basis.lost_energy * total == pytest.approx(norms(left, weights).sum(), abs=1e-14 * total)


@pytest.mark.parametrize("count", [12, 120], ids=["wide", "tall"])
def test_singular_values_and_modes_are_those_of_numpy(weights, count):
    snapshots = np.random.default_rng(2).normal(size=(count, 30, 3))
    basis = pt.pod(snapshots, weights, modes=10)
    roots = np.repeat(np.sqrt(weights), 3)
    _, values, rows = np.linalg.svd(snapshots.reshape(count, -1) * roots, full_matrices=False)
    np.testing.assert_allclose(basis.singular_values, values, atol=1e-12 * values[0])
    cosine = np.sum(rows[:10] * (basis.modes.reshape(10, -1) * roots), axis=1)
    np.testing.assert_allclose(np.abs(cosine), 1, rtol=1e-9)


def test_small_singular_values_are_accurate(snapshots, weights):
    roots = np.repeat(np.sqrt(weights), 3)
    exact = np.linalg.svd(snapshots.reshape(12, -1) * roots, compute_uv=False)
    found = pt.pod(snapshots, weights, modes=1).singular_values
    np.testing.assert_allclose(found, exact, atol=1e-14 * exact[0])


@pytest.mark.parametrize("tolerance", [0.3, 1e-2, 1e-5])
def test_a_tolerance_selects_the_fewest_modes_that_meet_it(snapshots, weights, tolerance):
    basis = pt.pod(snapshots, weights, tolerance=tolerance)
    assert np.sqrt(basis.lost_energy) <= tolerance
    assert len(basis) == 1 or np.sqrt(basis.truncated(len(basis) - 1).lost_energy) > tolerance


def test_no_other_basis_of_that_size_has_a_smaller_projection_error(snapshots, weights):
    basis = pt.pod(snapshots, weights, modes=3)
    other = pt.pod(snapshots[:6], weights, modes=3)
    left = norms(snapshots - other.lift(other.project(snapshots)), weights).sum()
    assert basis.lost_energy * norms(snapshots, weights).sum() <= left


def test_projecting_lifted_coordinates_gives_the_coordinates(snapshots, weights):
    basis = pt.pod(snapshots, weights, modes=5)
    coordinates = np.random.default_rng(0).normal(size=(4, 5))
    np.testing.assert_allclose(basis.project(basis.lift(coordinates)), coordinates, atol=1e-12)
    np.testing.assert_allclose(basis.project(basis.lift(coordinates[0])), coordinates[0], atol=1e-12)


def test_truncating_keeps_the_first_modes(snapshots, weights):
    basis = pt.pod(snapshots, weights, modes=8)
    np.testing.assert_allclose(
        np.abs(inner(basis.truncated(3).modes, pt.pod(snapshots, weights, modes=3).modes, weights)),
        np.eye(3),
        atol=1e-9,
    )
    with pytest.raises(pt.InputError, match=r"modes must be .*, got 9"):
        basis.truncated(9)


def test_several_trajectories_count_as_one_set_of_snapshots(run, held):
    halves = [replace(run, displacements=part) for part in (run.displacements[:30], run.displacements[30:])]
    together = pt.pod(run, held.weights, modes=4)
    apart = pt.pod(halves, held.weights, modes=4)
    np.testing.assert_allclose(apart.singular_values, together.singular_values, rtol=1e-10, atol=1e-18)
    np.testing.assert_allclose(apart.modes, together.modes, atol=1e-9 * np.abs(together.modes).max())
    assert apart.snapshots == 61


def test_many_snapshots_of_many_nodes_use_bounded_memory():
    resource = pytest.importorskip("resource")
    snapshots = np.random.default_rng(0).normal(size=(100, 5000, 3))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    pt.pod(snapshots, np.ones(5000), modes=5)
    grown = (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * 1024
    assert grown < 5 * snapshots.nbytes


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({}, "modes or tolerance must be given"),
        ({"modes": 3, "tolerance": 0.1}, "modes or tolerance must be given"),
        ({"modes": 13}, "modes must be at most 12, the independent shapes of 12 snapshots, got 13"),
        ({"modes": 0}, "modes must be .*, got 0"),
        ({"modes": 2.5}, "modes must be .*, got 2.5"),
        ({"tolerance": 0.0}, "tolerance must be .*, got 0.0"),
        ({"tolerance": 1.5}, "tolerance must be .*, got 1.5"),
        ({"modes": 1, "snapshots": np.zeros((4, 30, 3))}, "snapshots must be non-zero"),
        ({"modes": 1, "snapshots": np.full((4, 30, 3), np.nan)}, "snapshots must be finite"),
        ({"modes": 1, "snapshots": np.ones((4, 29, 3))}, r"shape \(L, 30, 3\), got \(4, 29, 3\)"),
    ],
)
def test_arguments_that_do_not_fit_are_refused(snapshots, weights, change, message):
    with pytest.raises(pt.InputError, match=message):
        pt.pod(change.pop("snapshots", snapshots), weights, **change)


def test_copies_of_one_snapshot_have_one_mode(snapshots, weights):
    copies = np.repeat(snapshots[:1], 5, axis=0)
    assert len(pt.pod(copies, weights, tolerance=1e-6)) == 1
    with pytest.raises(pt.InputError, match="modes must be at most 1"):
        pt.pod(copies, weights, modes=2)
