"""Static equilibria: balance of nodal forces, limits of damped runs, closed forms, symmetry, refusals."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import palpate as pt
from palpate.dynamics.nodal.coarse_grid import two_level_preconditioner
from palpate.dynamics.nodal.equilibrium_residual import EquilibriumResidual
from palpate.dynamics.nodal.mixed_newton import conjugate_gradients
from palpate.dynamics.nodal.mixed_stress import added_moduli, split_stress, tangent_moduli
from palpate.dynamics.nodal.stability import stiffness
from palpate.tissue.homogeneous import deformation_gradient, nominal_stress

PULL = (1.6, 0.3, 0.1)


@pytest.fixture(scope="module")
def body(bar, tissue):
    return pt.Solid(bar, tissue, fixed="x-", form="energy")


@pytest.fixture(scope="module")
def pulled(body):
    return pt.equilibrium(body, [pt.SurfaceForce("x+", force=PULL)])


def unbalanced(model, loads, displacements, time=0.0):
    """Norm of the inertia of free nodes that start from displacements at rest, over that of the loads."""
    prepared = model.prepare(loads)
    state = model.state(prepared, displacements, time=time)
    inertia = (model.weights * model.material.density)[:, None] * model.acceleration(state, prepared)
    inertia[prepared.constraint_mask(time)] = 0.0
    return np.linalg.norm(inertia) / np.linalg.norm(model.external_force(state, prepared))


@pytest.mark.quick(form=["energy"])
@pytest.mark.parametrize("form", ["strong", "energy"])
def test_no_free_node_accelerates_and_the_support_bears_the_load(form, bar, tissue):
    model = pt.Solid(bar, tissue, fixed="x-", form=form, stiffness_damping=1e-5)
    loads = [pt.SurfaceForce("x+", force=PULL), pt.Gravity(), pt.Foundation("z-", 1e4)]
    settled = pt.equilibrium(model, loads)
    assert np.abs(settled.displacements).max() > 0.1 * 0.03
    assert unbalanced(model, loads, settled.displacements) < 2e-6
    assert settled.residual <= 1e-6
    alone = pt.equilibrium(model, loads[:1])
    np.testing.assert_allclose(alone.reactions["x-"], -np.array(PULL), atol=1e-5)


@pytest.mark.slow
def test_a_damped_run_ends_at_the_equilibrium_and_a_run_from_it_stays(body, pulled):
    load = pt.SurfaceForce("x+", force=PULL)
    prepared = body.prepare([load])
    state = body.state(prepared)
    while state.time < 0.4:
        step = body.stable_step(state, prepared)[0]
        state = body.advance(state, prepared, step, 10)[0]
        state = replace(state, velocities=state.velocities * np.exp(-10 * step * 60.0))
    largest = np.abs(pulled.displacements).max()
    np.testing.assert_allclose(state.coordinates, pulled.displacements, atol=1e-4 * largest)
    run = pt.rollout(body, [load], duration=0.01, every=0.005, displacement=pulled.displacements)
    np.testing.assert_allclose(run.displacements[-1], pulled.displacements, atol=1e-5 * largest)


@pytest.mark.slow
@pytest.mark.parametrize("form", ["strong", "energy"])
def test_a_bar_between_two_grips_has_the_stretch_and_stress_of_a_testing_machine(form, bar, tissue):
    model = pt.Solid(bar, tissue, form=form, stiffness_damping=1e-5)
    F = deformation_gradient(tissue, "uniaxial", [1.5])[0]

    def motion(points, time):
        return time * points @ (F - np.eye(3)).T

    grips = [pt.PrescribedMotion(end, motion) for end in ("x-", "x+")]
    settled = pt.equilibrium(model, grips, time=1.0)
    np.testing.assert_allclose(settled.displacements, motion(bar.points, 1.0), atol=1e-7)
    np.testing.assert_allclose(settled.reactions["x+"], -settled.reactions["x-"], atol=1e-5)
    if form == "energy":  # the strong form's reactions have the error of its quadrature
        force = nominal_stress(tissue, "uniaxial", [1.5])[0] * 0.015**2
        np.testing.assert_allclose(settled.reactions["x+"], [force, 0, 0], atol=1e-4 * force)


def test_a_small_weight_has_the_linear_response_of_the_stiffness_at_rest(body, bar):
    weight = pt.Gravity((0.0, 0.0, -1e-3))
    settled = pt.equilibrium(body, [weight])
    free = ~body.fixed_mask
    expected = np.linalg.solve(stiffness(body), np.tile(weight.acceleration, free.sum()))
    largest = np.abs(expected).max()
    np.testing.assert_allclose(settled.displacements[free].ravel(), expected, atol=1e-4 * largest)
    np.testing.assert_allclose(settled.reactions["x-"], [0, 0, 1e-3 * body.masses.sum()], atol=1e-10)


def test_a_cube_under_pressure_from_all_sides_shrinks_as_its_law_says(small_cloud, tissue):
    ratio = 0.97
    cauchy = tissue.stress(ratio * np.eye(3)[None])[0, 0, 0] / ratio**2
    sides = ("x-", "x+", "y-", "y+", "z-", "z+")
    loads = [pt.Pressure(side, -cauchy) for side in sides]
    loads += [pt.Foundation(side, 1e-2) for side in sides]  # far softer than the tissue, against rigid motions
    settled = pt.equilibrium(pt.Solid(small_cloud, tissue, form="energy"), loads)
    arms = small_cloud.points - small_cloud.points.mean(axis=0)
    np.testing.assert_allclose(settled.displacements, (ratio - 1) * arms, atol=1e-5 * 0.015)
    assert settled.reactions == {}


def test_prescribed_nodes_are_at_their_displacement_of_the_time_until_their_release(body, bar):
    end = bar.group("x+")
    motion = pt.PrescribedMotion("x+", lambda points, t: (0.01 * t, 0, 0.02 * t), until=1.0)
    settled = pt.equilibrium(body, [motion], time=0.5)
    np.testing.assert_array_equal(settled.displacements[end], np.tile([0.005, 0, 0.01], (len(end), 1)))
    assert not settled.displacements[bar.group("x-")].any()
    np.testing.assert_allclose(settled.reactions["x+"], -settled.reactions["x-"], atol=1e-5)
    released = pt.equilibrium(body, [motion], time=2.0)
    assert released.iterations == 0
    assert not released.displacements.any()


@pytest.mark.slow
def test_a_mirrored_load_has_the_mirrored_equilibrium(body, bar):
    up, down = (pt.equilibrium(body, [pt.SurfaceForce("x+", force=(0.4, 0, z))]) for z in (0.1, -0.1))
    flipped = bar.points * [1, 1, -1] + [0, 0, 0.015]
    order = [int(np.argmin(np.linalg.norm(bar.points - point, axis=1))) for point in flipped]
    np.testing.assert_allclose(down.displacements, up.displacements[order] * [1, 1, -1], atol=1e-7)


def test_the_solution_of_half_the_load_is_a_valid_start(body, pulled):
    half = pt.equilibrium(body, [pt.SurfaceForce("x+", force=[x / 2 for x in PULL])])
    settled = pt.equilibrium(body, [pt.SurfaceForce("x+", force=PULL)], displacement=half.displacements)
    np.testing.assert_allclose(settled.displacements, pulled.displacements, atol=1e-7)


@pytest.mark.slow
def test_a_taut_sheet_sags_under_pressure_as_a_paraboloid():
    cloud = pt.disc(0.1, 0.01)
    tissue = pt.materials.NeoHookean(C1=5e3, density=1000.0, poisson=0.5)
    sheet = pt.Membrane(cloud, tissue, 1e-3, "rim", prestretch=1.1)
    settled = pt.equilibrium(sheet, [pt.Pressure("face", -0.1)])
    nominal = 2 * tissue.C1 * (1.1 - 1.1**-5)
    tension = nominal * 1e-3 / 1.1  # force per mounted length
    radius = np.linalg.norm(cloud.points, axis=1)
    expected = 0.1 * (0.1**2 - radius**2) / (4 * tension)
    np.testing.assert_allclose(np.abs(settled.displacements[:, 2]), expected, atol=0.02 * expected.max())


@pytest.mark.slow
def test_a_slack_sheet_raises_with_the_converged_part_of_the_load():
    tissue = pt.materials.NeoHookean(C1=5e3, density=1000.0, poisson=0.5)
    sheet = pt.Membrane(pt.disc(0.1, 0.02), tissue, 1e-3, "rim")
    with pytest.raises(pt.DivergenceError, match=r"converged up to 0\.0% of the load"):
        pt.equilibrium(sheet, [pt.Gravity()], max_iterations=20)


@pytest.mark.slow
def test_relaxing_tissue_is_fully_relaxed(bar, tissue):
    law = replace(tissue, prony=pt.materials.Prony(shares=(0.5, 0.5), times=(0.01, 0.1)))
    load = pt.SurfaceForce("x+", force=PULL)
    plain = pt.equilibrium(pt.Solid(bar, tissue, fixed="x-", form="energy"), [load])
    relaxed = pt.equilibrium(pt.Solid(bar, law, fixed="x-", form="energy"), [load])
    np.testing.assert_allclose(relaxed.displacements, plain.displacements, atol=1e-7)
    assert relaxed.strain_energy == pytest.approx(plain.strain_energy, rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "force"), [("axial", (100, 0, 0)), ("sideways", (0, 0, 0.1))])
def test_the_beam_of_the_paper_agrees_with_finite_elements(kind, force):
    path = Path(__file__).parents[3] / "validation" / "reference" / "finite_elements.json"
    rows = [row for row in json.loads(path.read_text())[kind] if row["poisson"] == 0.49]
    expected = next(row["mean_tip"] for row in rows if row["force"] == pytest.approx(max(force)))
    cloud = pt.box((0.2, 0.02, 0.02), spacing=0.005)
    law = pt.materials.MooneyRivlin(C1=60e3, C2=1.2e3, density=1120, poisson=0.49)
    beam = pt.Solid(cloud, law, fixed="x-", form="energy")
    settled = pt.equilibrium(beam, [pt.SurfaceForce("x+", force=force)])
    shares = np.linalg.norm(cloud.area_vectors("x+"), axis=1)
    tip = shares @ settled.displacements[cloud.group("x+")] / shares.sum()
    np.testing.assert_allclose(tip, expected, atol=0.02 * np.linalg.norm(expected))


# the parts


@pytest.mark.slow
def test_the_preconditioner_is_symmetric_and_positive_and_a_good_inverse(body, pulled):
    u = pulled.displacements
    equations = EquilibriumResidual(body, body.prepare([]), 0.0, np.zeros_like(u))
    F, moduli = body.deformation_gradient(u), tangent_moduli(equations, u)
    inverse = two_level_preconditioner(body, F, moduli, equations.constrained, equations.springs)
    noise = np.random.default_rng(0).standard_normal((2, *u.shape))
    one, two = (inverse(each) for each in noise)
    assert np.vdot(noise[0], two) == pytest.approx(np.vdot(noise[1], one), rel=1e-9)
    assert np.vdot(noise[0], one) > 0
    assert not one[equations.constrained].any()
    before, step, calls = equations.residual(u), 1e-9, []

    def tangent(direction):
        calls.append(1)
        scale = step / np.abs(direction).max()
        return (before - equations.residual(u + scale * direction)) / scale

    forces = np.where(equations.constrained[:, None], 0.0, noise[0])
    found = conjugate_gradients(tangent, inverse, forces)
    assert len(calls) < 100
    np.testing.assert_allclose(tangent(found), forces, atol=0.05)


def test_moduli_are_those_of_the_law_plus_those_of_the_stress(body, bar, tissue):
    F = np.eye(3) + 0.1 * np.random.default_rng(1).standard_normal((3, 3))
    u = bar.points @ (F - np.eye(3)).T
    equations = EquilibriumResidual(body, body.prepare([]), 0.0, np.zeros_like(u))
    change = 1e-6 * np.random.default_rng(2).standard_normal((3, 3))
    expected = (tissue.stress((F + change)[None]) - tissue.stress((F - change)[None]))[0] / 2
    moduli = tangent_moduli(equations, u)
    scale = np.abs(expected).max()
    for node in (0, 50):
        np.testing.assert_allclose((moduli[node] @ change.ravel()).reshape(3, 3), expected, atol=1e-3 * scale)
    stress = split_stress(equations, u)
    none = type(stress)(0 * stress.pressure, 0 * stress.second)
    half = type(stress)(stress.pressure / 2, stress.second / 2)
    gradients = body.deformation_gradient(u)
    whole = added_moduli(gradients, none, stress)
    np.testing.assert_allclose(2 * added_moduli(gradients, none, half), whole)
    # a rigid rotation turns P = p cof F + F S, so that the stress alone gives its change
    spin = np.array([[0.0, -1, 0.5], [1, 0, -2], [-0.5, 2, 0]])
    turned = (whole[0] @ (spin @ F).ravel()).reshape(3, 3)
    np.testing.assert_allclose(turned, spin @ body.stress(u)[0], atol=1e-9 * np.abs(turned).max())


# refusals


def test_loads_without_static_force_and_unsupported_bodies_are_refused_by_name(body, bar, tissue):
    tool = pt.tools.Contact(pt.tools.Sphere(0.01), lambda t: (np.array([0.0, 0.0, 1.0]), np.array([1.0, 0, 0, 0])))
    with pytest.raises(pt.InputError, match=r"loads of equilibrium must be one of .*, got Contact"):
        pt.equilibrium(body, [tool])
    with pytest.raises(pt.InputError, match=r"model must be supported for an equilibrium, .*; use fixed="):
        pt.equilibrium(pt.Solid(bar, tissue, form="energy"), [pt.Gravity()])
    with pytest.raises(pt.InputError, match=r"model must be a Solid or a Membrane, got 3"):
        pt.equilibrium(3)
    with pytest.raises(pt.InputError, match=r"tolerance must be in \[1e-10, 0.01\], got 1"):
        pt.equilibrium(body, tolerance=1)


def test_one_load_is_taken_as_a_list_of_one(body):
    one, several = pt.equilibrium(body, pt.Gravity()), pt.equilibrium(body, [pt.Gravity()])
    np.testing.assert_array_equal(one.displacements, several.displacements)


def test_a_load_below_rounding_is_in_equilibrium_at_once(body):
    settled = pt.equilibrium(body, [pt.Pressure("x+", 1e-12)])
    assert settled.iterations == 0
    assert not settled.displacements.any()
