"""Every law in reduced models: the same energy as the full model's, its relaxation, and the file."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest

import palpate as pt
from palpate.dynamics.material.kinematics import Kinematics
from palpate.reduction.hyper.material_point import material_point
from palpate.reduction.storage.material import describe_material, material_of
from palpate.tissue.catalogue import LAWS

pytestmark = pytest.mark.slow

REST = {"density": 1000.0, "poisson": 0.45}
SOLID = [law for law in LAWS if law.kind.variables != "small strain"]
COMPILED = ("NeoHookean", "Yeoh", "Gent", "Ogden", "Logarithmic")  # of each kind one or two: compiling takes long
INVARIANT, STRETCH = (next(law for law in SOLID if law.name == name) for name in ("NeoHookean", "Ogden"))
SERIES = pt.materials.Prony(shares=(0.6, 0.3), times=(2e-3, 2e-2))


def course(t):
    return np.sin(300 * t) ** 2


PULL = [pt.SurfaceForce("x+", force=lambda t: course(t) * np.array([0.3, 0.05, -0.02]))]


def block(material):
    return pt.Solid(pt.box((0.03, 0.01, 0.01), 0.0025), material, "x-", form="energy", stiffness_damping=1e-5)


def rollout(model, loads=PULL, **options):
    return pt.rollout(model, loads, **({"duration": 0.02, "every": 0.0005, "progress": False} | options))


def shaped(body, count=6):
    """Random smooth states in place of a run."""
    rng, points = np.random.default_rng(0), body.cloud.points
    fields = np.stack([
        points[:, :1] * (rng.uniform(-0.5, 0.5, (3, 3)) @ points.T).T / 0.01
        + 2e-4 * np.sin(points @ rng.uniform(-200, 200, (3, 3))) * points[:, :1] / 0.03
        for _ in range(3 * count)
    ])  # fmt: skip
    fields *= 1.5e-3 / np.abs(fields).max()
    f = len(fields)
    return pt.Trajectory(
        "states", np.arange(f) * 1e-3, fields, np.zeros_like(fields), {}, *np.zeros((4, f)), np.arange(f), points
    )


@pytest.mark.each_kind(law=[INVARIANT, STRETCH])
@pytest.mark.parametrize("law", [law for law in SOLID if law.name in COMPILED], ids=lambda law: law.name)
def test_stress_is_the_derivative_of_the_energy_of_a_point_crushed_or_not(law):
    material = law.kind(**law.example, **REST)
    point, coefficients = material_point(material, Kinematics())
    rng = np.random.default_rng(0)
    crushed = 0
    for scale in (0.1, 0.3, 0.9, 0.9, 0.9):
        for _ in range(6):
            d = scale * rng.uniform(-1, 1, 9)
            P, cofactor, dilatation = point.stress(*d, coefficients)
            crushed += dilatation < -0.9
            F = np.eye(3) + d.reshape(3, 3)
            assert dilatation == pytest.approx(np.linalg.det(F) - 1, abs=1e-12)
            np.testing.assert_allclose(np.reshape(cofactor, (3, 3)) @ F.T, np.linalg.det(F) * np.eye(3), atol=1e-12)
            density, _ = point.density(*d, coefficients)
            if dilatation > -0.9:
                assert density == pytest.approx(float(material.shear_energy(F)), rel=1e-9, abs=1e-9)
            steps = 1e-6 * np.eye(9)
            slopes = [
                (point.density(*(d + s), coefficients)[0] - point.density(*(d - s), coefficients)[0]) / 2e-6
                for s in steps
            ]
            np.testing.assert_allclose(P, slopes, rtol=1e-5, atol=1e-5 * np.abs(slopes).max())
    assert crushed > 2


@pytest.mark.each_kind(law=[STRETCH])
@pytest.mark.parametrize("law", [law for law in SOLID if law.name in ("Gent", "Ogden")], ids=lambda law: law.name)
def test_all_nodes_are_the_galerkin_model(law):
    check_galerkin(block(law.kind(**law.example, **REST)))


def check_galerkin(body, share=1e-6):
    run = shaped(body)
    trained = pt.hyper_reduce(body, run, modes=6, cubature=0.0, pressures=1000)
    model = pt.ReducedModel(trained.data, single=False)
    columns = model.data.trial_and_test_basis[: model.count]
    for u in run.displacements[::5]:
        a = np.linalg.lstsq(columns.reshape(6, -1).T, u.ravel(), rcond=None)[0]
        u = np.tensordot(a, columns, 1)
        expected = np.einsum("n,mnc,nc->m", body.volumes, columns, body.force(u))
        np.testing.assert_allclose(model.body.force(a), expected, rtol=share, atol=share * np.abs(expected).max())
        assert model.body.energy(a) == pytest.approx(body.strain_energy(u), rel=share)


@pytest.mark.release
@pytest.mark.parametrize(("name", "form"), [("Gent", "mixed"), ("Ogden", "logarithmic")])
def test_all_nodes_are_the_galerkin_model_in_every_form_of_the_volumetric_part(name, form):
    # the pressures of the states span those of their projections but for what g has of higher order
    law = next(law for law in SOLID if law.name == name)
    check_galerkin(block(law.kind(**law.example, **REST, volumetric=form)), 5e-6)


@pytest.mark.release
@pytest.mark.parametrize("form", ["logarithmic", "mixed"])
def test_a_sampled_body_in_another_form_has_the_slope_of_its_energy_crushed_or_not(form):
    body = block(pt.materials.NeoHookean(C1=5e3, **REST, volumetric=form))
    model = pt.ReducedModel(pt.hyper_reduce(body, shaped(body), modes=6).data, single=False)
    point, _ = material_point(body.material, Kinematics())
    values = np.array([point.measure(x) for x in (-3.0, -0.95, -0.9, -0.5, 0.0, 0.7)])
    assert np.diff(values[:, 0]).min() > 0
    assert values[0, 1] == values[1, 1] == pytest.approx(values[2, 1])  # a tangent below a tenth of the volume
    rng = np.random.default_rng(0)
    for size in (1e-4, 1e-3, 1e-2):
        a = size * rng.normal(size=6)
        steps = 1e-6 * size * np.eye(6)
        slopes = [(model.body.energy(a + s) - model.body.energy(a - s)) / (2e-6 * size) for s in steps]
        np.testing.assert_allclose(model.body.force(a), -np.array(slopes), atol=1e-5 * np.abs(slopes).max())


def test_a_reduced_model_in_another_form_reproduces_the_full_run_and_is_stored(tmp_path):
    body = block(pt.materials.NeoHookean(C1=5e3, **REST, volumetric="mixed"))
    run = rollout(body, step=2.5e-5)
    model = pt.hyper_reduce(body, run, modes=12)
    assert pt.relative_errors(run, rollout(model, step=2.5e-5)).displacement < 0.035
    pt.save(model, tmp_path / "mixed.rom")
    loaded = pt.load(tmp_path / "mixed.rom")
    assert loaded.material == body.material
    a = 1e-4 * np.ones(12)
    np.testing.assert_array_equal(loaded.body.force(a), model.body.force(a))


@pytest.mark.parametrize("law", SOLID, ids=lambda law: law.name)
def test_every_law_is_restored_from_its_description(law):
    held = REST | {"volumetric": "logarithmic"}
    for rest in (REST, held, {"density": 1000.0, "bulk": 123456.789}, {"density": 1000.0, "poisson": 0.5}):
        material = law.kind(**law.example, **rest, prony=SERIES)
        said = describe_material(material)
        back = material_of(
            said["material"], json.loads(said["parameters"]), said["expression"], json.loads(said["prony"])
        )
        assert back == material


@pytest.mark.release
def test_a_symbolic_law_is_stored_as_text(tmp_path):
    law = pt.materials.Hyperelastic("C1*(I1bar - 3) + C2*(exp(I1bar - 3) - 1)", C1=4e3, C2=1e3, prony=SERIES, **REST)
    body = block(law)
    model = pt.hyper_reduce(body, shaped(body), modes=4)
    pt.save(model, tmp_path / "own.rom")
    loaded = pt.load(tmp_path / "own.rom")
    assert type(loaded.material) is type(law)
    assert loaded.material == body.material
    a = 1e-4 * np.ones(4)
    np.testing.assert_array_equal(loaded.body.force(a), model.body.force(a))


@pytest.mark.release
def test_a_hyper_reduced_sheet_supports_laws_of_the_stretches():
    cloud = pt.disc(0.1, 0.0125).within("tool", (0.0, 0.0), 1e-6)
    law = pt.materials.Ogden(C=(0.05e6, 0.02e6), alpha=(2.0, 4.0), density=1200.0, poisson=0.5)
    sheet = pt.Membrane(cloud, law, 1e-5, "rim")
    push = [pt.PrescribedMotion("tool", lambda points, t: (0.0, 0.0, 0.1 * max(t, 0.0)))]
    run = pt.rollout(sheet, push, duration=0.05, every=0.0025, progress=False)
    model = pt.hyper_reduce(sheet, run, modes=6, prescribed="tool", cubature=0.0)
    precise = pt.ReducedModel(model.data, single=False)
    columns = model.data.trial_and_test_basis[: model.count]
    a = np.linalg.lstsq(columns.reshape(model.count, -1).T, run.displacements[-1].ravel(), rcond=None)[0]
    u = np.tensordot(a, columns, 1)
    expected = np.einsum("n,mnc,nc->m", sheet.volumes, columns, sheet.force(u))
    np.testing.assert_allclose(precise.body.force(a), expected, atol=1e-8 * np.abs(expected).max())


# relaxation


@pytest.fixture(scope="module")
def relaxing():
    body = block(pt.materials.MooneyRivlin(C1=10e3, C2=0.0, prony=SERIES, **REST))
    run = rollout(body)
    return body, run, pt.hyper_reduce(body, run, modes=12)


def test_a_relaxing_reduced_model_reproduces_the_full_run(relaxing):
    body, run, model = relaxing
    again = rollout(model)
    errors = pt.relative_errors(run, again)
    assert errors.displacement < 0.05
    assert errors.reaction < 0.02
    assert again.dissipated[-1] == pytest.approx(run.dissipated[-1], rel=0.02)
    assert again.dissipated[-1] > 0.2 * np.abs(again.external).max()
    assert np.abs(again.balance).max() < 5e-3 * np.abs(again.external).max()
    # a model that forgot would be another one
    calm = replace(model.data.tissue, material=replace(body.material, prony=None))
    easy = pt.ReducedModel(replace(model.data, tissue=calm))
    assert pt.relative_errors(run, rollout(easy)).displacement > 0.2


def test_with_all_nodes_the_branches_have_the_energy_of_the_full_model(relaxing):
    body, run, _ = relaxing
    whole = pt.ReducedModel(pt.hyper_reduce(body, run, modes=8, cubature=0.0, pressures=1000).data, single=False)
    prepared, loads = whole.prepare(PULL), body.prepare(PULL)
    state = whole.state(prepared)
    for _ in range(20):
        state = whole.advance(state, prepared, 2e-5, 10)[0]
    u, v = whole.displacement(state, prepared), whole.velocity(state, prepared)
    whole.outputs(state, prepared)
    own = whole.body.energy(state.coordinates, state.history)
    # the same memory in the full model: its strains are those of the same displacements
    history = body.state(loads).history
    other = whole.state(prepared)
    for _ in range(200):
        other = whole.advance(other, prepared, 2e-5, 1)[0]
        moved = whole.displacement(other, prepared) + body.stiffness_damping * whole.velocity(other, prepared)
        history, _ = body.history_after(moved, history, 2e-5)
    assert body.strain_energy(u, history) == pytest.approx(own, rel=2e-3)
    assert np.abs(v).max() > 0


def test_the_engine_updates_the_history_and_a_reset_clears_it():
    body = block(pt.materials.MooneyRivlin(C1=10e3, C2=0.0, prony=pt.materials.Prony(shares=0.5, times=0.1), **REST))
    grasp = [pt.PrescribedMotion("x+", lambda points, t: (2e-3 * course(t), 0.0, 0.0))]
    model = pt.hyper_reduce(body, rollout(body, grasp), modes=10, prescribed="x+")
    live = pt.realtime_model(model)
    q, v, report = live.rest.copy(), np.zeros(len(live.rest)), np.zeros(8 + len(live.tool))

    def held(periods):
        forces = []
        for k in range(periods):
            live.advance(live.data, q, v, live.tool[:, 0] * 1e-3 * min(k / 40, 1.0), 1e-3, report)
            assert report[0] == 0
            forces.append(report[8:] @ live.tool[:, 0])
        return np.array(forces)

    first = held(800)
    # after t = 40 ms: 1 + 0.5 (1 - exp(-0.4)) / 0.4 exp(-(t - 40 ms) / 100 ms), what rings cancels in the mean
    times = np.arange(60, 100) * 1e-3
    expected = 1 + 0.5 * -np.expm1(-0.4) / 0.4 * np.exp(-(times.mean() - 0.04) / 0.1)
    assert first[60:100].mean() / first[-100:].mean() == pytest.approx(expected, rel=0.05)
    q[:], v[:] = live.rest, 0.0
    np.testing.assert_allclose(held(800), first, rtol=1e-6, atol=1e-6 * np.abs(first).max())


def test_trust_and_forces_of_a_state_are_those_of_its_history(relaxing):
    body, run, _ = relaxing
    model = pt.hyper_reduce(body, run, modes=12, held_out=[(PULL, run)])
    prepared = model.prepare(PULL)
    early = model.advance(model.state(prepared), prepared, 1e-5, 300)[0]
    trust, forces = model.trust(early, prepared), model.outputs(early, prepared).reactions["x-"]
    late = model.advance(early, prepared, 1e-5, 600)[0]
    assert model.trust(late, prepared) != trust
    assert model.trust(early, prepared) == trust  # whatever was evaluated last
    np.testing.assert_array_equal(model.outputs(early, prepared).reactions["x-"], forces)
    # almost all frames of the run that it was calibrated on are trusted
    assert model.trust(late, prepared) < 1.5
    again = pt.hyper_reduce(body, run, modes=12, held_out=[(PULL, run)])
    assert again.data.scales.residual_scale == model.data.scales.residual_scale


def test_step_selection_for_relaxing_tissue_has_explicit_steps(relaxing):
    _, _, model = relaxing
    chosen = pt.select_time_step(model, PULL, duration=0.004, tolerance=0.5)
    assert chosen.step is None
    assert [rule["step"] for rule in chosen.report["stepping"]["rules"]] == [None]


def test_unsupported_relaxation_is_refused(relaxing):
    body, run, model = relaxing
    with pytest.raises(pt.InputError, match="stepped explicitly"):
        model.with_step(1e-3)
    with pytest.raises(pt.InputError, match=r"use palpate\.hyper_reduce"):
        pt.galerkin(body, run, modes=4)
    linear = next(law for law in LAWS if law.kind.variables == "small strain")
    soft = block(linear.kind(**linear.example, **REST))
    with pytest.raises(pt.InputError, match="small strain"):
        pt.hyper_reduce(soft, shaped(soft), modes=4)
