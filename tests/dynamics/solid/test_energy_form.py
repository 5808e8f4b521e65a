"""The solid's forces as the slope of an energy: derivatives, balances, closed forms and finite elements."""

from __future__ import annotations

from functools import cache

import numba
import numpy as np
import pytest
from scipy.linalg import eigvalsh
from scipy.optimize import brentq
from scipy.sparse.linalg import splu

import palpate as pt
from palpate.dynamics.nodal.stability import stiffness
from palpate.reduction.basis.linear_modes import rest_stiffness, vibration_modes

pytestmark = [
    pytest.mark.quick(model=["mooney-rivlin"], law=["mooney-rivlin"]),
    pytest.mark.each_kind(model=["mooney-rivlin", "ogden"], law=["mooney-rivlin", "ogden"]),
]

SIDE = 0.02
STRETCHED = np.eye(3) + np.array([[0.3, 0.2, -0.1], [0.0, -0.2, 0.1], [0.1, 0.0, 0.1]])
LAWS = {
    "neo-hookean": pt.materials.NeoHookean(C1=20e3, density=1000, poisson=0.4),
    "mooney-rivlin": pt.materials.MooneyRivlin(C1=20e3, C2=15e3, density=1000, poisson=0.49),
    "ogden": pt.materials.Ogden(C=(5e3, 300.0, 500.0), alpha=(1.3, 5.0, -2.0), density=1000, poisson=0.4),
}
CLOUDS = {
    "lattice": pt.box((3 * SIDE, 0.75 * SIDE, 0.75 * SIDE), spacing=SIDE / 4),
    "small lattice": pt.box((SIDE,) * 3, spacing=SIDE / 3),  # its nodes share no stencils
    "jitter": pt.box((SIDE,) * 3, spacing=SIDE / 4, jitter=0.2),
    "more jitter": pt.box((SIDE,) * 3, spacing=SIDE / 4, jitter=0.3, seed=1),
}
# by validation/finite_elements.py, circular frequencies [rad/s] of a clamped block, 60 x 20 x 20 mm: first and second
# bending, first and second torsion, first axial and third bending
FINITE_ELEMENTS = {
    0.3: (62.91, 286.7, 178.69, 535.8, 314.59, 628.5),
    0.49: (68.52, 301.8, 178.87, 536.3, 342.51, 652.7),
    0.499: (68.82, 302.5, 178.88, 536.4, 343.95, 653.8),
}


# of a block of 100 x 20 x 20 mm at 0.45: bending, torsion and axial (validation/reference/finite_elements.json)
LONG_BLOCK = (25.234, 107.028, 200.331)


def silicone(poisson):
    return pt.materials.MooneyRivlin(C1=60e3, C2=1.2e3, density=1120, poisson=poisson)


def energy_form(cloud, material, fixed=(), **options):
    return pt.Solid(cloud, material, fixed, form="energy", **options)


@pytest.fixture(params=CLOUDS)
def cloud(request):
    return CLOUDS[request.param]


@pytest.fixture(params=LAWS)
def model(request, cloud):
    return energy_form(cloud, LAWS[request.param])


@cache
def beam_errors(cells):
    """Relative errors of the first bending, torsion and axial frequency of a beam with some cells across."""
    model = energy_form(pt.box((0.1, 0.02, 0.02), 0.02 / cells), silicone(0.45), "x-")
    shapes, frequencies = vibration_modes(model, 8)
    y, z = (model.cloud.points[:, 1:] - 0.01).T
    turn = np.abs(np.sum(y * shapes[:, :, 2] - z * shapes[:, :, 1], axis=1))
    along = np.abs(shapes[:, :, 0].mean(axis=1))
    return frequencies[[0, np.argmax(turn), np.argmax(along)]] / LONG_BLOCK - 1


def some_state(cloud, seed=0):
    """A large smooth deformation with noise on it."""
    random = np.random.default_rng(seed)
    X = cloud.points
    smooth = 0.1 * SIDE * np.sin(X / SIDE @ random.uniform(-3, 3, (3, 3)))
    return X @ (STRETCHED - np.eye(3)).T + smooth + 0.05 * cloud.spacing * random.normal(size=X.shape)


def symmetric_stiffness(model, displacements=None):
    """Tangent [1/s^2] of the free nodes in coordinates times the root of their volume."""
    root = np.sqrt(np.repeat(model.volumes[~model.fixed_mask], 3))
    return stiffness(model, displacements) * root[:, None] / root


@pytest.mark.parametrize("seed", [0, 1])
def test_forces_are_minus_the_slope_of_the_energy(model, seed):
    u = some_state(model.cloud, seed)
    direction, step = np.random.default_rng(seed + 10).normal(size=u.shape), 1e-6 * model.cloud.spacing
    ahead, behind = (model.strain_energy(u + s * step * direction) for s in (1, -1))
    work = -np.sum(model.volumes[:, None] * model.force(u) * direction)
    assert work == pytest.approx((ahead - behind) / (2 * step), rel=1e-6)


def test_every_force_is_the_slope_of_the_energy_by_its_node(cloud):
    model = energy_form(cloud, LAWS["mooney-rivlin"])
    u = some_state(cloud)
    force, step = model.force(u) * model.volumes[:, None], 1e-6 * cloud.spacing
    for i in range(0, len(cloud), 5):
        for c in range(3):
            change = np.zeros_like(u)
            change[i, c] = step
            slope = (model.strain_energy(u + change) - model.strain_energy(u - change)) / (2 * step)
            assert -force[i, c] == pytest.approx(slope, abs=1e-6 * np.abs(force).max())


def test_the_tangent_is_symmetric_in_the_volumes(model):
    K = symmetric_stiffness(model, some_state(model.cloud))
    np.testing.assert_allclose(K, K.T, atol=1e-8 * np.abs(K).max())


def test_a_rigid_motion_gives_no_energy_stress_or_force(model, rotation):
    u = model.cloud.points @ (rotation - np.eye(3)).T + (0.1, 0.2, 0.3)
    bulk = model.material.bulk_modulus
    assert abs(model.strain_energy(u)) < 1e-12 * bulk * model.cloud.volumes.sum()
    np.testing.assert_allclose(model.stress(u), 0, atol=1e-10 * bulk)
    np.testing.assert_allclose(model.force(u), 0, atol=1e-9 * bulk / model.cloud.spacing)


def test_energy_and_forces_turn_with_the_frame(model, rotation):
    u = some_state(model.cloud)
    force = model.force(u)
    turned = (model.cloud.points + u) @ rotation.T - model.cloud.points
    assert model.strain_energy(turned) == pytest.approx(model.strain_energy(u), rel=1e-10)
    np.testing.assert_allclose(model.force(turned), force @ rotation.T, atol=1e-9 * np.abs(force).max())


def test_forces_of_a_free_body_keep_momentum_and_angular_momentum(model):
    u = some_state(model.cloud)
    force = model.volumes[:, None] * model.force(u)
    np.testing.assert_allclose(force.sum(axis=0), 0, atol=1e-12 * np.abs(force).sum())
    moment = np.cross(model.cloud.points + u, force)
    np.testing.assert_allclose(moment.sum(axis=0), 0, atol=1e-11 * np.abs(moment).sum())


def test_a_uniform_deformation_has_the_materials_energy_and_stress(model):
    u = model.cloud.points @ (STRETCHED - np.eye(3)).T
    energy, P = model.material.strain_energy(STRETCHED), model.material.stress(STRETCHED)
    volume = np.ptp(model.cloud.points, axis=0).prod()
    assert model.strain_energy(u) == pytest.approx(energy * volume, rel=1e-10)
    np.testing.assert_allclose(model.stress(u), np.broadcast_to(P, (len(u), 3, 3)), atol=1e-8 * np.abs(P).max())
    virial = (model.volumes[:, None] * model.force(u)).T @ model.cloud.points
    np.testing.assert_allclose(virial, -P * volume, atol=1e-8 * np.abs(P).max() * volume)


@pytest.mark.parametrize("supports", [(), [pt.SymmetryPlane("y-")]])
def test_compiled_deformation_gradients_are_those_of_the_stencils(supports):
    """Recordings hold displacements in single precision."""
    body = energy_form(CLOUDS["lattice"], LAWS["neo-hookean"], supports)
    u = np.random.default_rng(0).standard_normal((len(body.cloud), 3)).astype(np.float32) * np.float32(1e-3)
    expected = body.stencils.gradient(body.mirror.vectors(u.astype(float))) + np.eye(3)
    for displacements in (u, u.astype(float)):
        np.testing.assert_allclose(body.deformation_gradient(displacements), expected, atol=1e-12)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("name", CLOUDS)
def test_uniform_stress_moves_no_inner_node(name, law):
    cloud = CLOUDS[name]
    model = energy_form(cloud, LAWS[law])
    P = model.material.stress(STRETCHED)
    force = model.force(cloud.points @ (STRETCHED - np.eye(3)).T) * cloud.spacing / np.abs(P).max()
    inside = np.setdiff1d(np.arange(len(cloud)), cloud.face_nodes)
    np.testing.assert_allclose(force[inside], 0, atol=1e-8)
    # at the faces it is the traction, which the gradients change by a few per cent at most
    expected = -(cloud.boundary_vectors() * cloud.volumes[:, None]) @ P.T * cloud.spacing / np.abs(P).max()
    np.testing.assert_allclose(force * model.volumes[:, None], expected, atol=0.1 * np.abs(expected).max())


@pytest.mark.slow
@pytest.mark.parametrize(("cells", "limits"), [(3, (0.025, 0.07, 0.005)), (5, (0.006, 0.022, 0.003))])
def test_the_lowest_frequencies_of_a_beam_near_those_of_finite_elements(cells, limits):
    errors = beam_errors(cells)
    assert (errors > 0).all()
    assert (errors < limits).all()


def test_the_frequencies_of_a_beam_converge_with_order_2_and_first_order_at_the_clamp():
    """The corner of the clamp is singular. Its error is all that the axial frequency has."""
    coarse, fine = beam_errors(3), beam_errors(5)
    bending, torsion, axial = np.log(coarse / fine) / np.log(5 / 3)
    assert min(bending, torsion) > 2.0
    assert axial > 0.8


@pytest.fixture(scope="module")
def deep():
    """A lattice whose middle is out of reach of the faces."""
    return pt.box((0.06,) * 3, spacing=0.005)


def wave_frequency(model, number, polarised):
    """Circular frequency [rad/s] that the force on the middle node gives a plane wave, 0 where nothing resists."""
    X = model.cloud.points - model.cloud.points.mean(axis=0)
    middle = int(np.argmin(np.linalg.norm(X, axis=1)))
    u = 1e-9 * np.cos(X @ number)[:, None] * polarised
    square = -model.force(u)[middle] @ polarised / (model.material.density * 1e-9)
    return np.sqrt(square) if square > 0 else 0.0


@pytest.mark.slow
@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.45, 0.49])
@pytest.mark.parametrize("wave", ["P", "S"])
def test_plane_waves_travel_at_the_speeds_of_p_and_s_waves(deep, poisson, wave):
    material = pt.materials.MooneyRivlin(C1=40e3, C2=0, density=1000, poisson=poisson)
    model = energy_form(deep, material)
    mu, bulk = material.shear_modulus, material.bulk_modulus
    speed = np.sqrt(((bulk + 4 / 3 * mu) if wave == "P" else mu) / 1000)
    along = np.array([2.0, 1.0, 2.0]) / 3
    polarised = along if wave == "P" else np.array([1.0, -2.0, 0.0]) / np.sqrt(5)
    errors = []
    for wavelength in (0.08, 0.16):  # 16 and 32 nodes
        number = 2 * np.pi / wavelength
        errors.append(abs(wave_frequency(model, number * along, polarised) / number / speed - 1))
    assert errors[0] < 0.06
    assert errors[1] < errors[0] / 3.5  # second order


@pytest.mark.slow
@pytest.mark.parametrize("number", [(1, 0, 0), (1, 1, 0), (1, 1, 1)])
@pytest.mark.parametrize("polarised", [(1, 0, 0), (0, 1, 0)])
def test_the_shortest_waves_have_energy(deep, number, polarised):
    """No gradient at the nodes sees a wave of two spacings: what the fit misses must."""
    model = energy_form(deep, pt.materials.MooneyRivlin(C1=40e3, C2=0, density=1000, poisson=0.3))
    short = wave_frequency(model, np.pi / deep.spacing * np.array(number), np.array(polarised, dtype=float))
    assert short > np.sqrt(model.material.shear_modulus / 1000) / deep.spacing


@pytest.mark.slow
@pytest.mark.parametrize(("poisson", "jitter"), [(0.3, 0.0), (0.49, 0.0), (0.49, 0.2), (0.499, 0.0)])
def test_the_lowest_vibrations_are_those_of_finite_elements(poisson, jitter):
    model = energy_form(pt.box((0.06, 0.02, 0.02), 0.005, jitter), silicone(poisson), "x-")
    K = symmetric_stiffness(model)
    found = np.sqrt(eigvalsh((K + K.T) / 2, subset_by_index=(0, 7)))
    first, second, torsion, torsion2, axial, third = FINITE_ELEMENTS[poisson]
    np.testing.assert_allclose(found[:6], (first, first, torsion, second, second, axial), rtol=0.06 if jitter else 0.04)
    np.testing.assert_allclose(found[6:], (torsion2, third), rtol=0.08)


@pytest.mark.slow
@pytest.mark.parametrize("poisson", [0.3, 0.49])
def test_a_beam_five_nodes_across_bends_as_far_as_in_closed_form(poisson):
    """The clamp holds the sections' width, too: finite elements bend by 2.7 % less at 0.49."""
    length, side = 0.2, 0.02
    material, force = silicone(poisson), 1e-6
    cloud = pt.box((length, side, side), side / 4)
    model = energy_form(cloud, material, "x-")
    prepared = model.prepare([pt.SurfaceForce("x+", force=(0, 0, force))])
    u, free = np.zeros_like(cloud.points), ~model.fixed_mask
    push = (model.masses[:, None] * model.acceleration(model.state(prepared), prepared))[free]
    loose = np.repeat(free, 3)
    u[free] = splu(rest_stiffness(model)[loose][:, loose]).solve(push.ravel()).reshape(-1, 3)
    shares = np.linalg.norm(cloud.area_vectors("x+"), axis=1)
    tip = shares / shares.sum() @ u[cloud.group("x+"), 2]
    young, shear = 2 * material.shear_modulus * (1 + poisson), 5 / 6 * material.shear_modulus
    timoshenko = force * length**3 / (young * side**4 / 4) + force * length / (shear * side**2)
    assert tip == pytest.approx(timoshenko, rel=0.04)
    assert 2 * model.strain_energy(u) == pytest.approx(force * tip, rel=2e-3)  # Clapeyron's theorem


@pytest.mark.slow
@pytest.mark.parametrize("poisson", [0.3, 0.49, 0.499])
@pytest.mark.parametrize(
    ("cloud", "stretch"),
    [(name, stretch) for name in ("small lattice", "jitter", "more jitter") for stretch in (0.6, 4.0)]
    + [("lattice", 0.9), ("lattice", 4.0)],  # it buckles sooner
    indirect=["cloud"],
)
def test_a_pulled_or_pressed_body_is_stable(cloud, poisson, stretch):
    """With a smoothing that does not keep integrals, none was at 0.49 and four-fold stretch."""
    material = silicone(poisson)

    def sides(lateral):
        return material.stress(np.diag([stretch, lateral, lateral]))[1, 1]

    lateral = brentq(sides, 0.4, 1.4)
    model = energy_form(cloud, material, ("x-", "x+"))
    K = symmetric_stiffness(model, cloud.points * (np.array([stretch, lateral, lateral]) - 1))
    wave = material.shear_modulus / material.density * (np.pi / np.ptp(cloud.points[:, 0])) ** 2  # of shear, squared
    assert eigvalsh((K + K.T) / 2, subset_by_index=(0, 0))[0] > 0.1 * wave


def test_the_step_is_the_limit_of_the_highest_frequency_and_no_damping_is_needed(bar, tissue):
    model = energy_form(bar, tissue, "x-")
    K = symmetric_stiffness(model)
    highest = np.sqrt(eigvalsh((K + K.T) / 2)[-1])
    report = model.stability
    assert report.highest_frequency == pytest.approx(highest, rel=0.02)
    assert report.needed == 0
    assert model.stiffness_damping == report.used == pytest.approx(0.1 / report.highest_frequency)
    assert energy_form(bar, tissue, "x-", stiffness_damping=0.0).stability.step == pytest.approx(
        1.7 / highest, rel=0.02
    )


def test_the_centre_of_mass_follows_the_forces_exactly(cloud, tissue):
    model = energy_form(cloud, tissue)
    loads = [pt.SurfaceForce("x+", force=(0.0, 0.1, -0.2)), pt.Gravity((1.0, 0.0, 0.0))]
    prepared, u = model.prepare(loads), some_state(cloud)
    rate = model.masses @ model.acceleration(model.state(prepared, u), prepared)
    size = model.volumes @ np.abs(model.force(u)).sum(axis=1)
    np.testing.assert_allclose(rate, (1000 * cloud.volumes.sum(), 0.1, -0.2), atol=1e-12 * size)


@pytest.mark.quick(jitter=[0.0])
@pytest.mark.parametrize("jitter", [0.0, 0.2], ids=["lattice", "jitter"])
def test_energy_balances_up_to_the_square_of_the_step(tissue, pull, jitter):
    model = energy_form(pt.box((0.03, 0.015, 0.015), 0.005, jitter), tissue, "x-", stiffness_damping=0.0)
    missed = []
    for part in (8, 32):
        run = pt.rollout(model, [pull], duration=0.005, every=0.0005, step=model.stability.step / part)
        missed.append(np.abs(run.balance).max() / run.external.max())
        assert not run.dissipated.any()
    assert run.kinetic.max() > 0.1 * run.external.max()
    assert missed[1] < 1e-6
    assert missed[1] < missed[0] / 12


@pytest.mark.slow
def test_a_free_vibration_keeps_its_energy_without_damping_and_loses_it_with(bar, tissue):
    u = np.zeros_like(bar.points)
    u[:, 2] = 5 * bar.points[:, 0] ** 2
    for stiffness_damping in (0.0, None):
        run = pt.rollout(
            energy_form(bar, tissue, "x-", stiffness_damping=stiffness_damping),
            displacement=u,
            duration=0.03,
            every=5e-4,
        )
        total = run.kinetic + run.strain
        assert run.kinetic.max() > 0.3 * total[0]
        early, late = total[1:11].mean(), total[-10:].mean()
        if stiffness_damping is None:
            assert np.diff(total).max() < 1e-3 * total[0]
            assert late < 0.98 * early
        else:
            np.testing.assert_allclose(total, total[0], rtol=0.01)
            assert late == pytest.approx(early, rel=1e-3)


def test_the_reaction_of_a_tool_is_the_slope_of_the_energy_by_its_motion(bar, tissue):
    model = energy_form(bar, tissue, "x-")
    motion = pt.PrescribedMotion("x+", (1e-3, 2e-4, -3e-4))
    prepared = model.prepare([motion])
    u = 1e-4 * np.random.default_rng(0).normal(size=bar.points.shape)
    state = model.state(prepared, u)
    forces, step = model.outputs(state, prepared).reactions, 1e-8
    for group in ("x+", "x-"):
        for c in range(3):
            change = np.zeros_like(u)
            change[bar.group(group), c] = step
            ahead, behind = (model.strain_energy(state.coordinates + s * change) for s in (1, -1))
            assert forces[group][c] == pytest.approx(
                (ahead - behind) / (2 * step), abs=1e-6 * np.abs(forces["x+"]).max()
            )


@pytest.mark.quick(jitter=[0.0])
@pytest.mark.skipif(numba.config.NUMBA_NUM_THREADS < 2, reason="this machine has one core")
@pytest.mark.parametrize("jitter", [0.0, 0.2], ids=["lattice", "jitter"])
def test_any_number_of_threads_gives_the_same_bits(tissue, pull, jitter):
    cloud = pt.box((0.03, 0.015, 0.015), 0.003, jitter)
    runs = []
    try:
        for threads in (1, 2):
            numba.set_num_threads(threads)
            runs.append(pt.rollout(energy_form(cloud, tissue, "x-"), [pull], duration=0.01, every=0.005))
    finally:
        numba.set_num_threads(numba.config.NUMBA_NUM_THREADS)
    for name in ("steps", "displacements", "velocities", "kinetic", "strain", "external", "dissipated"):
        np.testing.assert_array_equal(getattr(runs[0], name), getattr(runs[1], name))
    np.testing.assert_array_equal(runs[0].reactions["x-"], runs[1].reactions["x-"])


@pytest.mark.filterwarnings("ignore")
def test_a_body_turned_inside_out_has_no_energy(model):
    assert np.isnan(model.strain_energy(-1.5 * model.cloud.points * (1, 0, 0)))


@pytest.mark.parametrize("form", ["weak", "Energy", "", None])
def test_an_unknown_form_is_refused(small_cloud, tissue, form):
    with pytest.raises(pt.InputError, match=rf"form must be 'strong' or 'energy', got {form!r}"):
        pt.Solid(small_cloud, tissue, form=form)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"stiffness_damping": -1e-5}, "stiffness_damping must be .*, got -1e-05"),
        ({"neighbours": 9}, "neighbours must be .*, got 9"),
        ({"half_cell": 2.0}, "half_cell must be left out in the energy form, got 2.0; use form='strong'"),
        ({"smoothing": 4}, "smoothing must be .*, got 4"),
        ({"fixed": "left"}, "group must be one of .*, got 'left'"),
    ],
)
def test_arguments_out_of_range_are_refused_by_name(small_cloud, tissue, arguments, message):
    with pytest.raises(pt.InputError, match=message):
        energy_form(small_cloud, tissue, **arguments)


@pytest.mark.parametrize("form", ["energy", "strong"])
def test_a_uniform_pressure_is_recovered_exactly(form):
    cloud = CLOUDS["jitter"]
    body = pt.Solid(cloud, silicone(0.3), "x-", form=form)
    grown = 1e-3 * cloud.points
    expected = body.material.lame * (1.001**3 - 1)
    np.testing.assert_allclose(body.recovered_pressure(grown), expected, rtol=1e-6)


def test_a_recovered_pressure_hardly_alternates():
    cloud = CLOUDS["lattice"]
    body = pt.Solid(cloud, silicone(0.499), form="energy")
    board = 1.0 - 2.0 * (np.rint(cloud.points / cloud.spacing).sum(axis=1) % 2)
    slope = cloud.points @ np.array([2.0, -1.0, 3.0])
    fitted = body._recovery.fit(np.column_stack([board, slope]))
    assert np.abs(fitted[:, 0]).max() < 0.25
    np.testing.assert_allclose(fitted[:, 1], slope, atol=1e-9)


@pytest.mark.slow
def test_the_pressure_of_a_region_is_recovered_with_its_own_modulus():
    cloud, soft, firm = CLOUDS["lattice"], silicone(0.3), silicone(0.45)
    body = pt.Solid(cloud, {"": soft, "x+": firm}, form="energy")
    found = body.recovered_pressure(1e-3 * cloud.points)
    away = cloud.points[:, 0] < SIDE
    np.testing.assert_allclose(found[away], soft.lame * (1.001**3 - 1), rtol=1e-6)
    assert found[cloud.group("x+")].min() > 1.5 * found[away].max()
