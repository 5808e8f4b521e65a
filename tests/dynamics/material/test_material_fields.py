"""Bodies whose law has other parameters in other places, and their reduced models."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import palpate as pt
from palpate.reduction.basis.linear_modes import rest_stiffness

pytestmark = pytest.mark.slow

GIVEN = {"density": 1000.0, "poisson": 0.45}
SOFT, FIRM = pt.materials.Gent(mu=8e3, Jm=3.0, **GIVEN), pt.materials.Gent(mu=20e3, Jm=0.8, **GIVEN | {"poisson": 0.4})
FIBRES = {"k1": 10e3, "k2": 2.0, "directions": (1.0, 0.0, 0.0)}


def cloud_of(spacing=0.005, size=(0.04, 0.02, 0.02)):
    cloud = pt.box(size, spacing)
    return replace(cloud, groups=cloud.groups | {"far": np.flatnonzero(cloud.points[:, 0] > size[0] / 2 + 1e-9)})


def body(materials, **options):
    return pt.Solid(cloud_of(), materials, "x-", form="energy", **{"stiffness_damping": 2e-5} | options)


def bent(points):
    return 4e-4 * np.sin(150 * points + np.array([0.0, 1.0, 2.0])) * (points[:, :1] / 0.04)


@pytest.mark.parametrize("prony", [None, pt.materials.Prony(shares=0.5, times=0.02)])
def test_away_from_the_interface_each_part_answers_as_its_own_material(prony):
    soft, firm = replace_prony(SOFT, prony), replace_prony(FIRM, prony)
    mixed = body({"": soft, "far": firm}, fibres=pt.materials.Fibres(**FIBRES))
    alone = [body(m, fibres=pt.materials.Fibres(**FIBRES)) for m in (soft, firm)]
    u = bent(mixed.cloud.points)
    far = np.isin(np.arange(len(u)), mixed.cloud.group("far"))
    # stresses depend on the smoothed pressure, which nodes near the interface share; shear parts do not
    F = mixed.deformation_gradient(u)
    for model, part in zip(alone, (~far, far), strict=True):
        np.testing.assert_allclose(mixed.tissue.shear_stress(F)[part], model.tissue.shear_stress(F)[part], rtol=1e-12)
    deep = np.isin(mixed.cloud.points[:, 0], [0.0, 0.04])  # no stencil of a stencil reaches the other part
    expected = np.where(far[:, None], alone[1].force(u), alone[0].force(u))
    found = mixed.force(u)
    near = np.abs(mixed.cloud.points[:, 0] - 0.02) < 0.011
    assert np.abs(found - expected)[near].max() > 1e-3 * np.abs(expected).max()
    np.testing.assert_allclose(found[deep], expected[deep], atol=2e-3 * np.abs(expected).max())


def replace_prony(material, prony):
    return replace(material, bulk=None, prony=prony)


@pytest.mark.parametrize("prony", [None, pt.materials.Prony(shares=0.5, times=0.02)])
def test_forces_are_the_slope_of_the_energy(prony):
    material = {"": replace_prony(SOFT, prony), "far": replace_prony(FIRM, prony)}
    model = body(material, fibres=pt.materials.Fibres(**FIBRES), stiffness={"x+": 1.5})
    u, rng, step = bent(model.cloud.points), np.random.default_rng(0), 1e-8
    for _ in range(4):
        direction = rng.standard_normal(u.shape)
        slope = (model.strain_energy(u + step * direction) - model.strain_energy(u - step * direction)) / (2 * step)
        work = np.sum(model.volumes[:, None] * model.force(u) * direction)
        assert -work == pytest.approx(slope, rel=1e-5)


def test_materials_that_are_multiples_equal_stiffness_factors():
    stiff = pt.materials.Gent(mu=3 * SOFT.mu, Jm=SOFT.Jm, **GIVEN)
    one = body({"": SOFT, "far": stiff})
    other = body(SOFT, stiffness={"far": 3.0})
    u = bent(one.cloud.points)
    expected = other.force(u)
    np.testing.assert_allclose(one.force(u), expected, atol=1e-11 * np.abs(expected).max())
    assert one.strain_energy(u) == pytest.approx(other.strain_energy(u), rel=1e-11)
    np.testing.assert_allclose(rest_stiffness(one).toarray(), rest_stiffness(other).toarray(), atol=1e-6)


def test_the_stiffness_at_rest_is_that_of_the_forces():
    model = body({"": SOFT, "far": FIRM})
    matrix, rng = rest_stiffness(model), np.random.default_rng(1)
    direction = 1e-7 * rng.standard_normal((len(model.cloud), 3))
    change = (model.force(-direction) - model.force(direction)) / 2 * model.volumes[:, None]
    np.testing.assert_allclose(matrix @ direction.ravel(), change.ravel(), atol=1e-5 * np.abs(change).max())


def test_materials_by_node_equal_materials_by_group():
    cloud = cloud_of()
    far = np.isin(np.arange(len(cloud)), cloud.group("far"))
    by_node = body([FIRM if is_far else SOFT for is_far in far])
    u = bent(cloud.points)
    np.testing.assert_allclose(by_node.force(u), body({"": SOFT, "far": FIRM}).force(u), atol=1e-9)
    np.testing.assert_array_equal(body({"": SOFT}).force(u), body(SOFT).force(u))
    assert body({"": FIRM, "x-": SOFT}).material == FIRM


def test_a_reduced_model_has_the_materials_of_the_parts(tmp_path):
    prony = pt.materials.Prony(shares=0.5, times=0.02)
    model = body({"": replace_prony(SOFT, prony), "far": replace_prony(FIRM, prony)})
    loads = [pt.SurfaceForce("x+", force=lambda t: np.sin(150 * t) ** 2 * np.array([0.3, 0.1, 0.0]))]
    run = pt.rollout(model, loads, duration=0.03, every=0.001, progress=False)
    assert np.abs(run.balance).max() < 0.01 * np.abs(run.external).max()
    few = pt.hyper_reduce(model, run, modes=6)
    again = pt.rollout(few, loads, duration=0.03, every=0.001, progress=False)
    assert pt.relative_errors(run, again).displacement < 0.08
    assert again.dissipated[-1] == pytest.approx(run.dissipated[-1], rel=0.05)
    pt.save(few, tmp_path / "bar.rom")
    loaded, a = pt.load(tmp_path / "bar.rom"), 1e-4 * np.ones(6) / few.body.sizes
    assert loaded.data.tissue.regions.materials == few.data.tissue.regions.materials
    np.testing.assert_array_equal(loaded.data.tissue.regions.which, few.data.tissue.regions.which)
    for each in (few, loaded):  # both at rest
        each.state(each.prepare(loads))
    np.testing.assert_allclose(loaded.body.force(a), few.body.force(a), rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize(
    ("materials", "message"),
    [
        ({"": SOFT, "far": pt.materials.NeoHookean(C1=1e3, **GIVEN)}, "one law.*Gent and NeoHookean"),
        ({"": SOFT, "far": pt.materials.Gent(mu=1e3, Jm=1.0, density=900.0, poisson=0.45)}, "one density"),
        ({"": SOFT, "far": pt.materials.Gent(mu=1e3, Jm=1.0, **GIVEN, volumetric="mixed")}, "one volumetric form"),
        ({"": SOFT, "far": pt.materials.Gent(mu=1e3, Jm=1.0, **GIVEN, split="isochoric")}, "one split"),
        ({"": SOFT, "far": replace_prony(SOFT, pt.materials.Prony(shares=1.0, times=1.0))}, "one Prony series"),
        ({"": SOFT, "far": pt.materials.Gent(mu=1e3, Jm=1.0, density=1000.0, poisson=0.5)}, "compressible"),
        ({"far": FIRM}, "must cover all nodes"),
        ({"": SOFT, "nowhere": FIRM}, "nowhere"),
        ({"": SOFT, "far": 5.0}, "must be palpate's materials, got 5.0"),
        ([SOFT, FIRM], "must have one entry for each of the 225 nodes, got 2"),
    ],
)
def test_incompatible_materials_are_refused(materials, message):
    with pytest.raises(pt.InputError, match=message):
        body(materials)


def test_the_strong_form_and_membranes_refuse_several_materials():
    with pytest.raises(pt.InputError, match="form='energy'"):
        pt.Solid(cloud_of(), {"": SOFT, "far": FIRM}, "x-", form="strong")
    with pytest.raises(pt.InputError, match="one material"):
        pt.Membrane(pt.disc(0.1, 0.02), {"": SOFT}, 1e-3)
