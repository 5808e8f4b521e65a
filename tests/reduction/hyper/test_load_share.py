"""Loads that the coordinates of a reduced model cannot feel raise its error indicator."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
import pytest

import palpate as pt
from palpate.dynamics.nodal.coarse_grid import static_estimate
from palpate.reduction.hyper.data import ReducedData
from palpate.reduction.hyper.load_share import MAX_LOAD_SCALE, MIN_LOAD_SCALE, static_response
from palpate.reduction.training.calibrate_indicator import Measures, calibrate_scales, error_indicators

pytestmark = pytest.mark.slow

SOFT = pt.materials.MooneyRivlin(C1=60e3, C2=1.2e3, density=1120.0, poisson=0.45)
DURATION, EVERY = 0.1, 0.01


def ramp(t: float) -> float:
    return float(np.sin(0.5 * np.pi * min(t / 0.05, 1.0)) ** 2)


def end_force(force, group: str = "x+") -> pt.SurfaceForce:
    return pt.SurfaceForce(group, force=lambda t: ramp(t) * np.asarray(force, dtype=float))


def run(model, loads):
    return pt.rollout(model, loads, duration=DURATION, every=EVERY, progress=False)


def states(model, trajectory):
    coordinates, velocities = (model.body.project(each) for each in (trajectory.displacements, trajectory.velocities))
    return [pt.State(*each) for each in zip(coordinates, velocities, trajectory.times, strict=True)]


@pytest.fixture(scope="module")
def beam() -> pt.Solid:
    return pt.Solid(pt.box((0.1, 0.02, 0.02), 0.005), SOFT, "x-")


@pytest.fixture(scope="module")
def pulled(beam) -> pt.ReducedModel:
    """A beam trained on its axial pull alone, whose modes share the symmetry of that load."""
    held_out = [end_force((3.0, 0.0, 0.0))]
    return pt.hyper_reduce(
        beam, run(beam, [end_force((5.0, 0.0, 0.0))]), modes=5, held_out=[(held_out, run(beam, held_out))]
    )


@pytest.mark.parametrize("poisson", [0.3, 0.49])
def test_the_static_estimate_is_near_the_equilibrium(poisson):
    law = pt.materials.NeoHookean(C1=60e3, density=1120.0, poisson=poisson)
    model = pt.Solid(pt.box((0.1, 0.02, 0.02), 0.005), law, "x-")
    springs = np.zeros(len(model.cloud))
    response = static_estimate(model.cloud, model.volumes, model.tissue, model.supported, model.fixed_mask, springs)
    cases = {
        "pull": ([pt.SurfaceForce("x+", force=(1e-3, 0.0, 0.0))], 0.08),
        "side": ([pt.SurfaceForce("x+", force=(0.0, 1e-4, 0.0))], 0.2),
        "weight": ([pt.Gravity((0.0, 0.0, -1e-3))], 0.2),
        "pinch": ([pt.SurfaceForce("y+", force=(0, -1e-3, 0)), pt.SurfaceForce("y-", force=(0, 1e-3, 0))], 0.3),
    }
    for name, (loads, share) in cases.items():
        prepared = model.prepare(loads)
        found = response(model.external_force(model.state(prepared), prepared))
        expected = pt.equilibrium(model, loads).displacements
        assert np.linalg.norm(found - expected) < share * np.linalg.norm(expected), name


@pytest.mark.parametrize(
    "loads",
    [
        [end_force((0.0, 1.0, 0.0))],
        [pt.Gravity((0.0, 0.0, -9.81))],
        [end_force((0.0, 0.0, 0.3), "y+"), end_force((0.0, 0.0, -0.3), "y-")],
        [end_force((0.2, 0.2, 0.0))],
    ],
    ids=["sideways", "weight", "twist", "oblique"],
)
def test_a_load_across_the_symmetry_of_the_training_is_not_trusted(pulled, loads):
    prepared, own = pulled.prepare(loads), run(pulled, loads)
    assert all(pulled.trust(state, prepared) > 1 for state in states(pulled, own)[1:])


@pytest.mark.quick
def test_the_trained_load_has_a_small_share(pulled, beam):
    loads = [end_force((4.0, 0.0, 0.0))]
    prepared = pulled.prepare(loads)
    shares = [pulled.load_share(state, prepared) for state in states(pulled, run(pulled, loads))]
    assert shares[0] == 0.0  # no load
    assert max(shares) < pulled.data.scales.load_scale
    assert pulled.data.scales.load_scale >= MIN_LOAD_SCALE


def test_no_calibration_trusts_a_load_outside_the_coordinates():
    """Held-out frames with large shares and a wide tail."""
    random = np.random.default_rng(0)
    numbers = random.random((20, 50)) ** -2.0
    runs = [
        Measures(one, random.permutation(one), np.linspace(0.5, 1.0, 50), *np.zeros((2, 50, 1)), *np.zeros((2, 50)))
        for one in numbers
    ]
    found = calibrate_scales(runs, 0.95)
    assert found.load_scale == MAX_LOAD_SCALE < 1
    assert all(error_indicators(run, found).max() >= 1 / MAX_LOAD_SCALE for run in runs)


def test_a_small_load_next_to_a_trained_one_counts_for_little(pulled):
    loads = [end_force((4.0, 0.0, 0.0)), pt.SurfaceForce("x+", force=(0.0, 1e-4, 0.0))]
    prepared, own = pulled.prepare(loads), run(pulled, loads)
    shares = [pulled.load_share(state, prepared) for state in states(pulled, own)]
    assert shares[0] > 0.9
    assert max(shares[2:]) < pulled.data.scales.load_scale


def test_a_sheet_under_a_load_in_its_plane_is_not_trusted_after_a_push():
    corners = 0.02 * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    law = pt.materials.NeoHookean(C1=10e3, density=1000.0, poisson=0.5)
    sheet = pt.Membrane(pt.sheet(corners, 0.002), law, 1e-3, "rim", prestretch=1.1)

    def push(*force: float) -> list[pt.SurfaceForce]:
        return [pt.SurfaceForce("face", force=lambda t: ramp(t) * np.array(force))]

    model = pt.hyper_reduce(sheet, run(sheet, push(0.0, 0.0, 0.01)), modes=3)
    rest = pt.State(np.zeros(3), np.zeros(3), 0.05)
    assert model.load_share(rest, model.prepare(push(0.0, 0.0, 0.01))) < 0.3
    assert model.load_share(rest, model.prepare(push(0.01, 0.0, 0.0))) > 0.95
    assert model.trust(rest, model.prepare(push(0.003, 0.01, 0.0))) > 1


def test_a_free_body_counts_the_rigid_motion_that_its_modes_lack():
    body = pt.Solid(pt.box((0.06, 0.02, 0.02), 0.005), SOFT)

    def pull(one: float, other: float) -> list[pt.SurfaceForce]:
        return [end_force((one, 0.0, 0.0)), end_force((other, 0.0, 0.0), "x-")]

    model = pt.hyper_reduce(body, run(body, pull(5.0, -5.0)), modes=4)
    rest = pt.State(np.zeros(4), np.zeros(4), 0.05)
    assert model.load_share(rest, model.prepare(pull(5.0, -5.0))) < 0.2
    assert model.load_share(rest, model.prepare(pull(5.0, 0.0))) > 0.9
    assert model.load_share(rest, model.prepare([pt.Gravity((0.0, 0.0, -9.81))])) > 0.9


def test_foundations_support_a_body_in_the_static_response(beam):
    """On stiff springs at its end the static response of a beam is nearly that of the beam clamped there."""
    springs = np.zeros(len(beam.cloud))
    springs[beam.cloud.group("x-")] = 1e6
    free = replace(beam_data(beam), supports=())
    forces = np.zeros((len(beam.cloud), 3))
    forces[beam.cloud.group("x+"), 1] = 1.0
    clamped, held = (static_response(data, k)(forces) for data, k in ((beam_data(beam), 0 * springs), (free, springs)))
    assert np.linalg.norm(held - clamped) < 0.2 * np.linalg.norm(clamped)


def beam_data(beam: pt.Solid) -> ReducedData:
    return pt.hyper_reduce(beam, run(beam, [end_force((1.0, 0.0, 0.0))]), modes=1).data


@pytest.mark.quick
def test_a_trajectory_holds_trust_and_warns_once(pulled, tmp_path):
    side = [end_force((0.0, 1.0, 0.0))]
    with pytest.warns(pt.TrustWarning, match=r"reached 3.33 at t = .* s, above 1.*full model") as told:
        run = pt.rollout(
            pulled, side, duration=DURATION, every=EVERY, progress=False, file=(path := tmp_path / "run.h5")
        )
    assert len(told) == 1
    prepared = pulled.prepare(side)
    np.testing.assert_allclose(run.trust, [pulled.trust(state, prepared) for state in states(pulled, run)], rtol=1e-6)
    np.testing.assert_array_equal(run.displacement_bounds[1:], np.inf)  # no held-out run had such a number
    loaded = pt.Trajectory.load(path)
    for name in ("trust", "displacement_bounds", "force_bounds"):
        np.testing.assert_array_equal(getattr(loaded, name), getattr(run, name))
    joined = run.concatenate(replace(run, times=run.times + run.times[-1]))
    assert len(joined.trust) == len(joined.displacement_bounds) == len(joined.times)
    assert dict(fact[:2] for fact in run._facts())["largest error indicator"] == pytest.approx(run.trust.max())


def test_runs_inside_the_training_do_not_warn_and_full_models_have_no_trust(pulled, beam):
    with warnings.catch_warnings(action="error"):
        own = run(pulled, [end_force((3.0, 0.0, 0.0))])
    assert own.trust.max() <= 1
    assert np.isfinite(own.displacement_bounds).all()
    full = run(beam, [end_force((2.5, 0.0, 0.0))])
    assert not len(full.trust)
    with pytest.raises(pt.InputError, match="no error indicator"):
        full.plot("trust")


@pytest.mark.parametrize("modes", [2, 5, 8])
def test_the_training_motion_itself_is_trusted_without_held_out_runs(beam, modes):
    """However many modes there are: their residual on it is small, and its scale must not be smaller."""
    load = [end_force((4.0, 0.0, 0.0))]
    model = pt.hyper_reduce(beam, run(beam, load), modes=modes)
    with warnings.catch_warnings(action="error"):
        own = run(model, load)
    assert own.trust.max() <= 1


def test_wrong_predictions_under_untrained_loads_are_not_trusted():
    """Random symmetric bars, each trained on a symmetric load, under random loads outside the span."""
    random, wrong = np.random.default_rng(0), 0
    for _ in range(12):
        size = (0.06 + 0.04 * random.random(), 0.02, 0.02)
        law = pt.materials.NeoHookean(
            C1=float(random.uniform(1e3, 1e5)), density=1100.0, poisson=float(random.uniform(0.3, 0.49))
        )
        body = pt.Solid(pt.box(size, 0.005), law, "x-")
        scale = 2 * law.shear_modulus * 4e-4  # [N], about a strain of 1
        axis = np.eye(3)[random.integers(3)]
        train = [end_force(0.1 * scale * axis * (1.0 if axis[0] else 0.02))]
        model = pt.hyper_reduce(body, run(body, train), modes=4)
        for _ in range(3):
            direction = random.standard_normal(3)
            loads = [end_force(scale * direction * (0.02, 2e-3, 2e-3)), pt.Gravity(5.0 * random.standard_normal(3))]
            full, own, prepared = run(body, loads), run(model, loads), model.prepare(loads)
            error = np.linalg.norm(own.displacements - full.displacements, axis=(1, 2)).max()
            error /= np.linalg.norm(full.displacements, axis=(1, 2)).max()
            trust = max(model.trust(state, prepared) for state in states(model, own))
            wrong += error > 0.3
            assert error < 0.3 or trust > 1, (size, law, direction)
    assert wrong > 10


def ramped(displacement):
    return lambda points, t: ramp(t) * np.asarray(displacement, dtype=float)


@pytest.mark.slow  # prescribed motions of this body
def test_a_shaken_face_is_not_trusted_by_modes_of_its_pull():
    """The inertia of the body bends it sideways, where it has no modes."""
    bar = pt.Solid(pt.box((0.12, 0.02, 0.02), 0.005), SOFT, "x-")
    pulled = [pt.PrescribedMotion("x+", ramped((5e-3, 0.0, 0.0)))]
    model = pt.hyper_reduce(bar, run(bar, pulled), modes=6, prescribed="x+")
    shaken = [pt.PrescribedMotion("x+", lambda X, t: (0.0, 5e-4 * np.sin(2 * np.pi * 40 * t), 0.0))]
    full, fast = (pt.rollout(m, shaken, duration=0.05, every=0.0025, progress=False) for m in (bar, model))
    assert pt.relative_errors(full, fast).displacement > 0.3
    assert fast.trust[1:].max() > 1
    prepared, loads = model.prepare(pulled), model.prepare(shaken)
    assert max(model.load_share(state, prepared) for state in states(model, run(model, pulled))) < MIN_LOAD_SCALE
    moved = states(model, fast)
    shares = np.array([model.load_share(state, loads) for state in moved])
    assert np.quantile(shares, 0.75) > 0.8


def test_a_sheet_moved_in_its_plane_is_not_trusted_by_modes_of_its_deflection():
    cloud = pt.disc(0.1, 0.01)
    cloud = cloud.within("tool", (0.0, 0.0), 0.015)
    law = pt.materials.NeoHookean(C1=0.17e6, density=1200.0, poisson=0.5)
    sheet = pt.Membrane(cloud, law, 1e-3, "rim", prestretch=1.05)
    pushed = [pt.PrescribedMotion("tool", ramped((0.0, 0.0, 5e-3)))]
    moved = [pt.PrescribedMotion("tool", ramped((5e-4, 0.0, 0.0)))]
    model = pt.hyper_reduce(sheet, run(sheet, pushed), modes=8, prescribed="tool")
    full, fast = run(sheet, moved), run(model, moved)
    assert pt.relative_errors(full, fast).displacement > 0.5
    assert np.all(fast.trust[1:] > 1)
    assert run(model, pushed).trust.max() < 1
