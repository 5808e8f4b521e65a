"""Bodies with fibres: stress, slope of the energy, directions by node, energy kept, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import brentq

import palpate as pt

pytestmark = [pytest.mark.slow, pytest.mark.each_kind(name=["by node", "the heart"])]

REST = {"density": 1000.0, "poisson": 0.45}
TISSUE = pt.materials.MooneyRivlin(C1=10e3, C2=0, **REST)
X, SLANTED = np.array([1.0, 0.0, 0.0]), np.array([0.6, 0.8, 0.0])
HGO = {"k1": 20e3, "k2": 3.0, "dispersion": 0.05}
HEART = {"C": 2e3, "bf": 8.0, "bt": 2.0, "bfs": 4.0}


def around(points):
    """Directions that turn about the z axis."""
    a = np.stack([-points[:, 1] - 0.01, points[:, 0] + 0.01, np.zeros(len(points))], axis=1)
    return a / np.linalg.norm(a, axis=1, keepdims=True)


KINDS = {
    "one": pt.materials.Fibres(**HGO, directions=X),
    "two": pt.materials.Fibres(**HGO, directions=np.array([X, SLANTED])),
    "by node": pt.materials.Fibres(**HGO, directions=around),
    "two by node": pt.materials.Fibres(
        **HGO, directions=lambda points: np.stack([around(points), np.tile(X, (len(points), 1))])
    ),
    "the heart": pt.materials.Guccione(**HEART, directions=around),
}


def block(fibres, material=TISSUE, **options):
    cloud = pt.box((0.02, 0.02, 0.015), 0.005, 0.2)
    return pt.Solid(cloud, material, **{"form": "energy", "stiffness_damping": 0.0, "fibres": fibres} | options)


@pytest.mark.parametrize("name", KINDS)
def test_a_uniform_deformation_has_the_stress_of_the_laws(name):
    body, F = block(KINDS[name]), np.array([[1.2, 0.1, 0.0], [-0.05, 0.9, 0.1], [0.0, 0.2, 1.05]])
    u = body.cloud.points @ (F - np.eye(3)).T
    every = np.tile(F, (len(u), 1, 1))
    expected = TISSUE.stress(F) + body.fibres.stress(every)
    np.testing.assert_allclose(body.stress(u), expected, atol=1e-9 * np.abs(expected).max())
    energy = TISSUE.strain_energy(F) + body.fibres.energy(every)
    assert body.strain_energy(u) == pytest.approx(float(body.volumes @ energy), rel=1e-9)


@pytest.mark.parametrize("name", KINDS)
def test_forces_are_minus_the_slope_of_the_energy(name):
    body, random = block(KINDS[name]), np.random.default_rng(0)
    for size in (1e-4, 6e-4):
        u, along = (random.standard_normal((len(body.cloud), 3)) for _ in range(2))
        step, u = 1e-8, size * u
        slope = (body.strain_energy(u + step * along) - body.strain_energy(u - step * along)) / (2 * step)
        work = float(np.sum(body.force(u) * body.volumes[:, None] * along))
        assert -work == pytest.approx(slope, rel=1e-6, abs=1e-9 * np.abs(body.force(u)).max())


def test_fibres_squeezed_along_their_direction_have_no_force():
    F = np.diag([0.8, 0.8**-0.5, 0.8**-0.5])
    with_, without = block(pt.materials.Fibres(**{**HGO, "dispersion": 0.0}, directions=X)), block(None)
    u = with_.cloud.points @ (F - np.eye(3)).T
    np.testing.assert_array_equal(with_.force(u), without.force(u))


def test_a_pulled_bar_stretches_as_its_laws_say():
    tissue, (k1, k2) = pt.materials.MooneyRivlin(C1=10e3, C2=0.0, density=1000.0, poisson=0.49), (20e3, 3.0)
    bar = pt.Solid(
        pt.box((0.04, 0.01, 0.01), 0.0025), tissue, "x-", form="energy", stiffness_damping=5e-4,
        fibres=pt.materials.Fibres(k1=k1, k2=k2, directions=X),
    )  # fmt: skip

    def stress(stretches):
        F = np.diag([stretches[0], stretches[1], stretches[1]])
        return tissue.stress(F) + pt.materials.Fibres(k1=k1, k2=k2, directions=X).stress(F)

    stretch = 1.12
    free = brentq(lambda side: stress((stretch, side))[1, 1], 0.8, 1.0)
    traction = stress((stretch, free))[0, 0]
    pull = [pt.SurfaceForce("x+", force=lambda t: (traction * 1e-4 * min(t / 0.1, 1.0), 0.0, 0.0))]
    run = pt.rollout(bar, pull, duration=0.2, every=0.05, progress=False)
    u, x = run.displacements[-1][:, 0], bar.cloud.points[:, 0]
    middle = (x > 0.014) & (x < 0.031)
    found = 1 + np.polyfit(x[middle], u[middle], 1)[0]
    assert found - 1 == pytest.approx(stretch - 1, rel=0.02)


def test_energy_is_conserved_while_fibres_become_taut_and_slack():
    cloud = pt.box((0.03, 0.01, 0.01), 0.0025)
    bar = pt.Solid(
        cloud, TISSUE, "x-", form="energy", stiffness_damping=0.0,
        fibres=pt.materials.Fibres(k1=20e3, k2=3.0, directions=np.array([X, SLANTED])),
    )  # fmt: skip
    x, y, z = cloud.points.T
    bent = np.stack([-2.0 * (y - 0.005) * x, x**2, 0 * z], axis=1)
    run = pt.rollout(bar, [], duration=0.03, every=0.001, step=1e-5, displacement=bent, progress=False)
    whole = run.strain + run.kinetic
    assert np.abs(whole / whole[0] - 1).max() < 2e-3
    assert run.kinetic.max() > 0.5 * whole[0]


def test_the_stable_step_accounts_for_slack_fibres():
    """At rest half of all small motions leave them slack; a step for that half lets stiff fibres blow up."""
    tight = block(pt.materials.Fibres(k1=2e6, k2=1.0, directions=X))
    both, _ = tight.highest_frequency(np.zeros_like(tight.cloud.points), tight.fixed_mask)
    squeezed = -0.02 * tight.cloud.points * [1.0, -0.5, -0.5]
    assert tight.highest_frequency(squeezed, tight.fixed_mask)[0] > 0.9 * both
    assert block(None).highest_frequency(squeezed, tight.fixed_mask)[0] < 0.5 * both


def test_galerkin_models_have_the_fibres():
    body = block(KINDS["two"], fixed="x-", stiffness_damping=1e-5)
    push = [pt.SurfaceForce("x+", force=lambda t: (0.3 * np.sin(200 * t), 0.1, 0.0))]
    run = pt.rollout(body, push, duration=0.01, every=0.0005, progress=False)
    errors = pt.relative_errors(
        run, pt.rollout(pt.galerkin(body, run, modes=12), push, duration=0.01, every=0.0005, progress=False)
    )
    assert errors.displacement < 0.02


def test_fibres_in_unsupported_models_are_refused():
    fibres = KINDS["one"]
    with pytest.raises(pt.InputError, match="form='energy'"):
        block(fibres, form="strong")
    with pytest.raises(pt.InputError, match="law of finite strain"):
        block(fibres, pt.materials.LinearElastic(mu=1e3, **REST))
    with pytest.raises(pt.InputError, match=r"must be palpate\.materials\.Fibres"):
        block(X)
    with pytest.raises(pt.InputError, match="must have 100 nodes, as the body, got 7"):
        block(pt.materials.Fibres(**HGO, directions=np.tile(X, (7, 1))))
    with pytest.raises(pt.InputError, match="unit vectors"):
        block(pt.materials.Fibres(**HGO, directions=lambda points: points))
