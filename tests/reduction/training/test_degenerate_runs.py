"""Runs that hardly train a reduced model end in a model or in an error that gives the reason."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import palpate as pt
from palpate.reduction.training.residual_fields import _triangular_root


@pytest.fixture(scope="module")
def body(bar, tissue):
    return pt.Solid(bar, tissue, fixed="x-", form="energy", stiffness_damping=1e-4)


@pytest.fixture(scope="module")
def run(body):
    pull = pt.SurfaceForce("x+", force=(0.1, 0.0, 0.0))
    return pt.rollout(body, [pull], duration=5e-3, every=1e-3, progress=False)


@pytest.mark.parametrize("scale", [1e-12, 1e-20])
def test_a_run_whose_motion_is_rounding_is_refused(body, run, scale):
    with pytest.raises(pt.InputError, match="trajectories must move the body by at least 5e-13 m, got"):
        pt.hyper_reduce(body, [replace(run, displacements=scale * run.displacements)], modes=2)


def test_a_run_of_small_motions_trains_a_model(body, run):
    model = pt.hyper_reduce(body, [replace(run, displacements=1e-6 * run.displacements)], modes=2)
    assert np.isfinite(model.data.sampled.gradients).all()


def test_a_body_without_lateral_contraction_trains_a_model(bar):
    laws = [pt.materials.MooneyRivlin(C1=c, C2=0.0, density=1e3, poisson=0.0) for c in np.linspace(5.0, 6.0, 60)]
    assert min(law.lame for law in laws) == 0.0  # never below, by rounding
    law = min(laws, key=lambda each: each.bulk_modulus - each.shear_share)
    soft = pt.Solid(bar, law, fixed="x-", form="energy", stiffness_damping=1e-4)
    push = pt.rollout(soft, [pt.Gravity()], duration=5e-3, every=1e-3, progress=False)
    assert np.isfinite(pt.hyper_reduce(soft, [push], modes=2).data.cubature.weights).all()


def test_snapshots_of_inverted_nodes_are_left_out_of_the_pressures(body, run, monkeypatch):

    measure = type(body).smoothed_measure

    def inverted(self, u, work):
        found = measure(self, u, work)
        return np.full_like(found, np.nan) if np.abs(u).max() == np.abs(run.displacements).max() else found

    expected = body.pressure_moments(run.displacements, 1)
    monkeypatch.setattr(type(body), "smoothed_measure", inverted)
    found = body.pressure_moments(run.displacements, 1)
    assert found.shape == expected.shape
    assert np.isfinite(found).all()
    monkeypatch.setattr(type(body), "smoothed_measure", lambda self, u, work: measure(self, u, work) * np.nan)
    with pytest.raises(pt.InputError, match="must keep all volumes positive"):
        body.pressure_moments(run.displacements, 1)


def test_the_triangular_root_is_that_of_cholesky_and_exists_for_singular_matrices():
    draw = np.random.default_rng(3).normal(size=(5, 5))
    np.testing.assert_allclose(
        _triangular_root(draw.T @ draw), np.linalg.cholesky(draw.T @ draw).T, rtol=1e-9, atol=1e-9
    )
    singular = draw[:2].T @ draw[:2] - 1e-15 * np.eye(5)
    with pytest.raises(np.linalg.LinAlgError):
        np.linalg.cholesky(singular)
    root = _triangular_root(singular)
    np.testing.assert_allclose(root.T @ root, singular, atol=1e-12)
    np.testing.assert_array_equal(root, np.triu(root))


def test_a_negative_volumetric_coefficient_is_refused(bar):
    law = pt.materials.MooneyRivlin(C1=8e3, C2=2e3, density=1000.0, poisson=0.0)
    assert law.lame < 0
    body = pt.Solid(bar, law, "x-")
    run = pt.rollout(body, [pt.SurfaceForce("x+", force=(0.05, 0, 0))], duration=2e-3, every=1e-3, progress=False)
    with pytest.raises(pt.InputError, match="volumetric coefficient positive"):
        pt.hyper_reduce(body, run, modes=1)
