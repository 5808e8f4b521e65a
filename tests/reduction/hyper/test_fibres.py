"""Fibres in reduced models: the same energy as the full model's, at few nodes, and kept in the file."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import palpate as pt

pytestmark = [pytest.mark.slow, pytest.mark.each_kind(body=["one"])]

REST = {"density": 1000.0, "poisson": 0.45}
X = np.array([1.0, 0.0, 0.0])


def around(points):
    """Directions that turn along the body."""
    angle = 40 * points[:, 0]
    return np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)


def two(points):
    return np.stack([around(points), np.tile(X, (len(points), 1))])


KINDS = {
    "one": (
        pt.materials.MooneyRivlin(C1=10e3, C2=0.0, **REST),
        pt.materials.Fibres(k1=20e3, k2=3.0, directions=around),
    ),
    "two": (
        pt.materials.NeoHookean(C1=5e3, **REST),
        pt.materials.Fibres(k1=20e3, k2=3.0, dispersion=0.1, directions=two),
    ),
    "the heart": (
        pt.materials.VolumeOnly(mu=2e3, **REST),
        pt.materials.Guccione(C=2e3, bf=8.0, bt=2.0, bfs=4.0, directions=around),
    ),
}
PULL = [pt.SurfaceForce("x+", force=lambda t: np.sin(200 * t) ** 2 * np.array([0.3, 0.1, -0.05]))]
OPTIONS = {"duration": 0.03, "every": 0.00075, "progress": False}


@pytest.fixture(scope="module", params=KINDS)
def body(request):
    material, fibres = KINDS[request.param]
    cloud = pt.box((0.03, 0.01, 0.01), 0.0025)
    return pt.Solid(cloud, material, "x-", form="energy", stiffness_damping=5e-5, fibres=fibres)


@pytest.fixture(scope="module")
def run(body):
    scale = 0.2 if isinstance(body.material, pt.materials.VolumeOnly) else 1.0
    loads = [pt.SurfaceForce("x+", force=lambda t: scale * PULL[0].force(t))]
    return loads, pt.rollout(body, loads, **OPTIONS)


def test_with_all_nodes_fibres_add_their_work_on_the_columns(body, run):
    data = pt.hyper_reduce(body, run[1], modes=6, cubature=0.0).data
    model, bare = (
        pt.ReducedModel(p, single=False) for p in (data, replace(data, tissue=replace(data.tissue, fibres=None)))
    )
    columns = data.trial_and_test_basis[: model.count]
    slopes = np.stack([body.stencils.gradient(column) for column in columns])
    for a in data.training_states[4::12]:
        F = body.deformation_gradient(np.tensordot(a, columns, 1))
        expected = -np.einsum("n,mnij,nij->m", body.volumes, slopes, body.fibres.stress(F))
        found = model.body.force(a) - bare.body.force(a)
        np.testing.assert_allclose(found, expected, atol=1e-8 * np.abs(model.body.force(a)).max())
        energy = float(body.volumes @ body.fibres.energy(F))
        assert model.body.energy(a) - bare.body.energy(a) == pytest.approx(energy, rel=1e-7)


def test_a_hyper_reduced_model_reproduces_the_full_run(body, run, tmp_path):
    loads, expected = run
    model = pt.hyper_reduce(body, expected, modes=12)
    assert model.report["nodes"] < len(body.cloud) / 2
    errors = pt.relative_errors(expected, pt.rollout(model, loads, **OPTIONS))
    assert errors.displacement < 0.05
    assert errors.reaction < 0.03
    # forces are the slope of the energy, beyond what was trained on too
    random = np.random.default_rng(0)
    precise = pt.ReducedModel(model.data, single=False)
    for scale in (1.0, 5.0):
        a = scale * model.data.training_states[20]
        step = 1e-6 * np.abs(a).max() * random.standard_normal(len(a))
        slope = precise.body.energy(a + step) - precise.body.energy(a - step)
        assert -2 * precise.body.force(a) @ step == pytest.approx(slope, rel=1e-5, abs=1e-9 * precise.body.energy(a))
    # a crushed and turned body has a finite energy and force
    wild = 1e3 * np.abs(model.data.training_states).max() * random.standard_normal(12)
    assert np.isfinite(model.body.energy(wild))
    assert np.isfinite(model.body.force(wild)).all()
    # the file
    pt.save(model, tmp_path / "fibres.rom")
    loaded = pt.load(tmp_path / "fibres.rom")
    assert type(loaded.data.tissue.fibres) is type(body.fibres)
    np.testing.assert_array_equal(loaded.data.tissue.fibres.directions, body.fibres.directions)
    np.testing.assert_array_equal(loaded.body.force(a), model.body.force(a))
    u = model.displacement(model.state(model.prepare(loads)), None)
    np.testing.assert_array_equal(loaded.stress(u), model.stress(u))


def test_without_fibres_the_forces_differ(body, run):
    model = pt.hyper_reduce(body, run[1], modes=12)
    bare = pt.ReducedModel(replace(model.data, tissue=replace(model.data.tissue, fibres=None)))
    a = model.data.training_states[20]
    assert np.linalg.norm(bare.body.force(a) - model.body.force(a)) > 0.1 * np.linalg.norm(model.body.force(a))


def test_user_defined_fibres_are_not_saved(tmp_path):
    class Hair(pt.materials.Fibres):
        pass

    cloud = pt.box((0.02, 0.015, 0.015), 0.005)
    body = pt.Solid(cloud, KINDS["one"][0], "x-", form="energy", fibres=Hair(k1=1e3, k2=1.0, directions=X))
    fields = np.random.default_rng(0).standard_normal((8, len(cloud), 3)) * cloud.points[:, :1] * 1e-2
    zeros = np.zeros((4, 8))
    states = pt.Trajectory("s", np.arange(8.0), fields, 0 * fields, {}, *zeros, np.arange(8), cloud.points)
    model = pt.hyper_reduce(body, states, modes=2)
    with pytest.raises(pt.InputError, match="is not one of palpate's"):
        pt.save(model, tmp_path / "hair.rom")
