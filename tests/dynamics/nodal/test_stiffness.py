"""Bodies whose tissue is stiffer in places: a bar of two parts, a tumour, and their reduced models."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.sparse.linalg import splu

import palpate as pt
from palpate.reduction.basis.linear_modes import rest_stiffness

pytestmark = pytest.mark.slow

TISSUE = pt.materials.MooneyRivlin(C1=10e3, C2=0, density=1000.0, poisson=0.0)
LENGTH, WIDE = 0.08, 0.03


def bar(spacing, ratio, **options):
    cloud = pt.box((LENGTH, WIDE, WIDE), spacing)
    cloud = replace(cloud, groups=cloud.groups | {"far": np.flatnonzero(cloud.points[:, 0] > LENGTH / 2 + 1e-9)})
    return pt.Solid(cloud, TISSUE, "x-", form="energy", stiffness={"far": ratio}, **options)


def stretched(spacing, ratio, force):
    """Displacements of a bar at rest under a small pull, by its stiffness at rest."""
    model = bar(spacing, ratio)
    prepared = model.prepare([pt.SurfaceForce("x+", force=lambda t: (force, 0, 0))])
    loads = model.external_force(model.state(prepared), prepared).ravel()
    free = np.flatnonzero(np.repeat(~model.fixed_mask, 3))
    u = np.zeros(len(loads))
    u[free] = splu(rest_stiffness(model)[free][:, free].tocsc()).solve(loads[free])
    return model, u.reshape(-1, 3)


def stretch(ratio, force, middle=LENGTH / 2):
    """Closed form of the bar's stretch [m]; Young's modulus is twice the shear modulus at nu = 0."""
    return force / (2 * 1e4 * WIDE**2) * (middle + (LENGTH - middle) / ratio)


@pytest.mark.parametrize("ratio", [0.25, 5.0])
@pytest.mark.parametrize("cells", [8, 11])
def test_a_bar_of_two_parts_stretches_as_the_closed_form_says(ratio, cells):
    force, spacing = 1e-5, LENGTH / cells
    model, u = stretched(spacing, ratio, force)
    # with an odd number of cells the interface lies midway between nodes; else the middle nodes are of the near part
    middle = LENGTH / 2 + (spacing / 2 if cells % 2 == 0 else 0.0)
    tip = u[model.cloud.group("x+"), 0].mean()
    assert tip == pytest.approx(stretch(ratio, force, middle), rel=0.03)
    support = np.sum(model.force(u)[model.fixed_mask] * model.volumes[model.fixed_mask, None], axis=0)
    assert support[0] == pytest.approx(force, rel=1e-3)


def test_a_uniform_stiffness_factor_equals_a_stiffer_law():
    cloud = pt.box((0.03, 0.01, 0.01), 0.0025)
    u = 5e-4 * np.sin(150 * cloud.points)
    stiff = pt.materials.MooneyRivlin(C1=30e3, C2=0, density=1000.0, poisson=0.45)
    soft = pt.materials.MooneyRivlin(C1=10e3, C2=0, density=1000.0, poisson=0.45)
    one = pt.Solid(cloud, stiff, "x-", form="energy", stiffness_damping=1e-5)
    other = pt.Solid(cloud, soft, "x-", form="energy", stiffness_damping=1e-5, stiffness=np.full(len(cloud), 3.0))
    expected = one.force(u)
    np.testing.assert_allclose(other.force(u), expected, atol=1e-11 * np.abs(expected).max())
    assert other.strain_energy(u) == pytest.approx(one.strain_energy(u), rel=1e-11)
    assert other.stability.highest_frequency == pytest.approx(one.stability.highest_frequency, rel=1e-6)


def test_forces_are_the_slope_of_the_energy_at_an_interface():
    model = bar(0.005, 7.0)
    rng = np.random.default_rng(0)
    u, step = 5e-4 * rng.standard_normal((len(model.cloud), 3)), 1e-8
    for _ in range(5):
        direction = rng.standard_normal(u.shape)
        slope = (model.strain_energy(u + step * direction) - model.strain_energy(u - step * direction)) / (2 * step)
        work = np.sum(model.volumes[:, None] * model.force(u) * direction)
        assert -work == pytest.approx(slope, rel=1e-5)


def test_a_reduced_model_has_the_stiffer_part(tmp_path):
    model = bar(0.005, 5.0, stiffness_damping=2e-5)
    loads = [pt.SurfaceForce("x+", force=lambda t: np.sin(150 * t) ** 2 * np.array([0.05, 0.01, 0.0]))]
    run = pt.rollout(model, loads, duration=0.03, every=0.001, progress=False)
    whole = pt.ReducedModel(pt.hyper_reduce(model, run, modes=6, cubature=0.0, pressures=1000).data, single=False)
    columns = whole.data.trial_and_test_basis[: whole.count]
    a = np.linalg.lstsq(columns.reshape(6, -1).T, run.displacements[15].ravel(), rcond=None)[0]
    u = np.tensordot(a, columns, 1)
    expected = np.einsum("n,mnc,nc->m", model.volumes, columns, model.force(u))
    np.testing.assert_allclose(whole.body.force(a), expected, atol=1e-8 * np.abs(expected).max())
    few = pt.hyper_reduce(model, run, modes=6)
    assert (
        pt.relative_errors(run, pt.rollout(few, loads, duration=0.03, every=0.001, progress=False)).displacement < 0.08
    )
    pt.save(few, tmp_path / "bar.rom")
    np.testing.assert_array_equal(pt.load(tmp_path / "bar.rom").stress(u), few.stress(u))
    far = model.cloud.group("far")
    ratio = np.linalg.norm(few.stress(u), axis=(1, 2)) / np.linalg.norm(
        few.material.stress(few.body.gradient(u) + np.eye(3)), axis=(1, 2)
    )
    np.testing.assert_allclose(ratio[far], 5.0)


def test_vibration_modes_are_those_of_the_stiffer_body():
    cloud = pt.box((LENGTH, WIDE, WIDE), 0.01)
    soft, stiff = (pt.Solid(cloud, TISSUE, "x-", form="energy", stiffness=np.full(len(cloud), k)) for k in (1.0, 9.0))
    slow, fast = (pt.vibration_modes(model, 4)[1] for model in (soft, stiff))
    np.testing.assert_allclose(fast, 3 * slow, rtol=1e-6)
    root = np.where(cloud.points[:, 0] < LENGTH / 2, 9.0, 1.0)  # a stiff root bends slower than a stiff bar
    partly = pt.Solid(cloud, TISSUE, "x-", form="energy", stiffness=root)
    assert 1.3 * slow[0] < pt.vibration_modes(partly, 1)[1][0] < fast[0]


@pytest.mark.parametrize(
    ("stiffness", "message"),
    [
        ({"nowhere": 2.0}, "nowhere"),
        ({"x+": 0.0}, r"stiffness\['x\+'\] must be .*, got 0"),
        ({"x+": np.nan}, r"stiffness\['x\+'\]"),
        (np.ones(3), "one per node"),
        (-np.ones(625), "positive numbers"),
    ],
)
def test_bad_stiffness_is_refused(stiffness, message):
    cloud = pt.box((0.06, 0.01, 0.01), 0.0025)
    with pytest.raises(pt.InputError, match=message):
        pt.Solid(cloud, TISSUE, "x-", form="energy", stiffness=stiffness)


def test_the_strong_form_refuses_stiffness_factors():
    with pytest.raises(pt.InputError, match="form='energy'"):
        pt.Solid(pt.box((0.06, 0.01, 0.01), 0.0025), TISSUE, "x-", form="strong", stiffness={"x+": 2.0})
