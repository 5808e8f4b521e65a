"""The membrane against closed forms, an axisymmetric solution, and itself turned or laid out otherwise."""

from __future__ import annotations

import importlib
import sys
from dataclasses import dataclass, replace

import numpy as np
import pytest
from numba import get_num_threads, set_num_threads
from scipy.special import jn_zeros

import palpate as pt
from palpate.meshfree.consistent import consistent_gradient

pytestmark = [pytest.mark.slow, pytest.mark.each_kind(law=["NeoHookean", "Ogden"])]

RADIUS, THICKNESS, C1 = 0.1, 1e-5, 0.17e6


@dataclass(frozen=True, kw_only=True)
class Coupled(pt.materials.Material):
    """A law of the tests, whose every derivative by I1 and I2 matters."""

    c: float

    def _check_parameters(self):
        assert self.c > 0

    @property
    def shear_modulus(self):
        return 4.0 * self.c

    @property
    def shear_bulk_modulus(self):
        return 0.0

    @staticmethod
    def energy(I1, I2, J, c):
        x, y = I1 - 3.0, I2 - 3.0
        return c[0] * (x + y + 0.3 * x * x + 0.2 * x * y + 0.1 * y * y)

    @staticmethod
    def first(I1, I2, J, c):
        x, y = I1 - 3.0, I2 - 3.0
        return c[0] * (1.0 + 0.6 * x + 0.2 * y), c[0] * (1.0 + 0.2 * x + 0.2 * y), 0.0

    @staticmethod
    def second(I1, I2, J, c):
        return 0.6 * c[0], 0.2 * c[0], 0.2 * c[0], 0.0, 0.0, 0.0


LAWS = {
    "NeoHookean": pt.materials.NeoHookean(C1=C1, density=1200.0, poisson=0.5),
    "MooneyRivlin": pt.materials.MooneyRivlin(C1=0.3e6, C2=0.05e6, density=1000.0, poisson=0.5),
    "Coupled": Coupled(c=0.1e6, density=1100.0, poisson=0.5),
    "Ogden": pt.materials.Ogden(C=(0.2e6, 0.01e6), alpha=(1.3, -4.0), density=1000.0, poisson=0.5),
}
CLOUDS = {
    "rings": pt.disc(RADIUS, 0.01),
    "hexagonal": pt.disc(RADIUS, 0.01, "hexagonal"),
    "jittered": pt.disc(RADIUS, 0.01, jitter=0.2, seed=2),
    "rectangle": pt.sheet([(0, 0), (0.1, 0), (0.1, 0.06), (0, 0.06)], 0.01),
}
STRETCHED = np.array([[1.2, 0.1], [0.05, 1.1], [0.1, 0.2]])  # taut
NARROWED = np.array([[1.3, 0.1], [0.05, 0.7], [0.1, 0.2]])  # wrinkled
SHRUNK = np.array([[0.9, 0.1], [0.0, 0.8], [0.1, 0.1]])  # slack


def sheet(cloud="rings", law="NeoHookean", **options):
    cloud = CLOUDS[cloud] if isinstance(cloud, str) else cloud
    return pt.Membrane(cloud, LAWS[law], THICKNESS, options.pop("fixed", "rim"), **options)


def uniform(model, F):
    """Displacements of the mounted sheet that give it the deformation gradient F."""
    return model.cloud.points @ (F / model.prestretch - np.eye(3, 2)).T


def inside(model):
    return np.setdiff1d(np.arange(len(model.cloud)), model.cloud.group("rim"))


def energy_of(law, F, relaxed):
    """Energy density of an incompressible sheet, from its principal stretches."""
    l1, l2 = np.linalg.svd(F, compute_uv=False)
    if relaxed:
        l1 = max(l1, 1.0)
        l2 = max(l2, l1**-0.5)
    if law.variables == "stretches":
        return law.energy(l1, l2, 1 / (l1 * l2), law.coefficients)
    squares = np.array([l1, l2, 1 / (l1 * l2)]) ** 2
    return law.energy(squares.sum(), squares[0] * squares[1] + squares[2] * squares[:2].sum(), 1.0, law.coefficients)


def numerical_stress(law, F, relaxed):
    stress, step = np.empty((3, 2)), 1e-6
    for i, a in np.ndindex(3, 2):
        change = np.zeros((3, 2))
        change[i, a] = step
        stress[i, a] = (energy_of(law, F + change, relaxed) - energy_of(law, F - change, relaxed)) / (2 * step)
    return stress


@pytest.mark.parametrize("relaxed", [True, False])
@pytest.mark.parametrize("F", [STRETCHED, NARROWED, SHRUNK], ids=["taut", "wrinkled", "slack"])
@pytest.mark.parametrize("law", LAWS)
def test_stress_is_the_slope_of_the_energy(law, F, relaxed):
    model = sheet(law=law, relaxed=relaxed)
    u = uniform(model, F)
    expected = numerical_stress(LAWS[law], F, relaxed)
    np.testing.assert_allclose(model.stress(u), np.broadcast_to(expected, (len(u), 3, 2)), atol=1e-3)
    density = energy_of(LAWS[law], F, relaxed)
    assert model.strain_energy(u) == pytest.approx(density * model.volumes.sum(), rel=1e-9, abs=1e-15)


@pytest.mark.parametrize("F", [STRETCHED, NARROWED], ids=["taut", "wrinkled"])
@pytest.mark.parametrize("cloud", CLOUDS)
def test_uniform_stress_moves_no_inner_node(cloud, F):
    model = sheet(cloud, "Coupled")
    force = model.force(uniform(model, F))
    assert np.abs(force[inside(model)]).max() < 1e-9 * 0.1e6 / model.cloud.spacing


@pytest.mark.parametrize("relaxed", [True, False])
@pytest.mark.parametrize("law", LAWS)
def test_forces_are_the_slope_of_the_energy(law, relaxed):
    model = sheet("jittered", law, relaxed=relaxed, prestretch=1.05)
    rng = np.random.default_rng(0)
    points = model.cloud.points
    u = 0.003 * np.column_stack([np.sin(40 * points[:, 1]), np.cos(30 * points[:, 0]), np.sin(50 * points[:, 0])])
    u[:, 1] -= points[:, 1] * np.abs(points[:, 1])  # narrower and narrower towards the rim
    states = np.bincount(model.tension(u), minlength=3)
    assert states[1] > 10
    assert states[2] > 10
    direction, step = rng.standard_normal(u.shape), 1e-8
    slope = (model.strain_energy(u + step * direction) - model.strain_energy(u - step * direction)) / (2 * step)
    work = -np.sum(model.volumes[:, None] * model.force(u) * direction)
    assert work == pytest.approx(slope, rel=2e-6)


def test_a_turned_sheet_has_turned_forces(rotation):
    model = sheet("jittered", "MooneyRivlin")
    X = np.column_stack([model.cloud.points, np.zeros(len(model.cloud))])
    u = 0.003 * np.sin(40 * X[:, [1, 0, 1]])
    turned = (X + u) @ rotation.T - X
    force = model.force(u)
    np.testing.assert_allclose(model.force(turned), force @ rotation.T, atol=1e-9 * np.abs(force).max())


def test_a_free_sheet_keeps_its_momenta():
    model = sheet("hexagonal", fixed=())
    X = np.column_stack([model.cloud.points, np.zeros(len(model.cloud))])
    u = 0.003 * np.sin(40 * X[:, [1, 0, 1]])
    force = model.volumes[:, None] * model.force(u)
    np.testing.assert_allclose(force.sum(axis=0), 0, atol=1e-12 * np.abs(force).sum())
    assert np.abs(force).max() > 0


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("stretch", [1.0, 1.001, 1.2, 2.0])
def test_stress_in_simple_and_equal_tension_is_that_of_the_energy(law, stretch):
    model, W = sheet(law=law), LAWS[law]
    step = 1e-5
    above, below = (stretch + step, stretch - step)
    slope = np.subtract(*(energy_of(W, np.diag([s, s**-0.5]), False) for s in (above, below))) / (2 * step)
    expected = stretch * slope
    for width in (stretch**-0.5, 0.9 * stretch**-0.5):  # as wide as it likes, and wrinkled
        found = model.principal_stress(uniform(model, np.eye(3, 2) * [stretch, width]))
        np.testing.assert_allclose(found, np.broadcast_to([expected, 0.0], found.shape), atol=1e-4 * C1)
    slope = np.subtract(*(energy_of(W, np.diag([s, s]), False) for s in (above, below))) / (2 * step)
    found = model.principal_stress(uniform(model, np.eye(3, 2) * stretch))
    np.testing.assert_allclose(found, stretch * slope / 2, atol=1e-4 * C1)


def test_no_stress_is_compressive_by_default():
    rng = np.random.default_rng(4)
    model, plain = sheet("jittered"), sheet("jittered", relaxed=False)
    u = 0.004 * rng.standard_normal((len(model.cloud), 3))
    assert set(model.tension(u)) == {0, 1, 2}
    assert model.principal_stress(u).min() > -1e-9 * C1
    assert plain.principal_stress(u).min() < -0.1 * C1


def test_tension_states_and_the_wrinkled_area_are_those_of_the_stretches():
    model = sheet()
    area = np.pi * RADIUS**2
    for F, state in ((STRETCHED, 2), (NARROWED, 1), (SHRUNK, 0)):
        assert set(model.tension(uniform(model, F))) == {state}
        assert model.wrinkled_area(uniform(model, F)) == pytest.approx(area if state == 1 else 0.0)
    half = np.where(model.cloud.points[:, :1] > 0, uniform(model, NARROWED), uniform(model, STRETCHED))
    assert 0.4 * area < model.wrinkled_area(half) < 0.7 * area


@pytest.mark.parametrize("prestretch", [1.0, 1.01, 1.5])
def test_prestretch_tightens_a_sheet_of_the_same_mass(prestretch):
    model = sheet(law="MooneyRivlin", prestretch=prestretch)
    assert model.volumes.sum() == pytest.approx(np.pi * RADIUS**2 / prestretch**2 * THICKNESS, rel=1e-9)
    rest = np.zeros((len(model.cloud), 3))
    stress = 2 * (prestretch**2 - prestretch**-4) * (0.15e6 + 0.025e6 * prestretch**2)
    np.testing.assert_allclose(model.principal_stress(rest), stress, atol=1e-3)
    assert np.abs(model.force(rest)[inside(model)]).max() < 1e-9 * 0.3e6 / model.cloud.spacing


@pytest.mark.parametrize("cloud", ["rings", "hexagonal", "jittered"])
def test_a_taut_sheet_vibrates_at_the_zeros_of_bessel(cloud):
    prestretch = 1.05
    model = sheet(cloud, prestretch=prestretch, stiffness_damping=0.0)
    free, step = inside(model), 1e-8
    tangent = np.empty((len(free), len(free)))
    for column, node in enumerate(free):
        u = np.zeros((len(model.cloud), 3))
        u[node, 2] = step
        tangent[:, column] = -model.force(u)[free, 2] / (step * 1200)
    found = np.sort(np.sqrt(np.linalg.eigvals(tangent).real))[:4]
    speed = prestretch * np.sqrt(2 * C1 * (1 - prestretch**-6) / 1200)
    zeros = np.array([jn_zeros(order, 1)[0] for order in (0, 1, 1, 2)])
    np.testing.assert_allclose(found, speed / RADIUS * zeros, rtol=0.005)


def run_to_rest(model, loads, u, seconds=0.4, damping=60.0):
    prepared, state = model.prepare(loads), pt.State(u, np.zeros_like(u))
    while state.time < seconds:
        step = model.stable_step(state, prepared)[0]
        state = model.advance(state, prepared, step, 50)[0]
        state = pt.State(state.coordinates, state.velocities * np.exp(-50 * step * damping), state.time)
    return state, prepared


@pytest.fixture(scope="module")
def axisymmetric(pytestconfig):
    """The solver of the axisymmetric equations, which stands in validation/."""
    sys.path.append(str(pytestconfig.rootpath / "validation"))
    return importlib.import_module("axisymmetric")


@pytest.mark.parametrize("layout", ["rings", "hexagonal"])
def test_a_pushed_sheet_takes_the_axisymmetric_shape(layout, axisymmetric):
    expected = axisymmetric.poke(RADIUS, THICKNESS, axisymmetric.neo_hookean(C1), 0.01, 0.02)
    cloud = pt.disc(RADIUS, 0.005, layout).within("tool", (0.0, 0.0), 0.02)
    model = sheet(cloud)
    radius = np.linalg.norm(cloud.points, axis=1)
    u = np.zeros((len(cloud), 3))
    u[:, 2] = 0.01 * np.clip((RADIUS - radius) / 0.08, 0, 1)
    state, prepared = run_to_rest(model, [pt.PrescribedMotion("tool", (0.0, 0.0, 0.01))], u)
    mean = np.sum(cloud.volumes * state.coordinates[:, 2]) / cloud.volumes.sum()
    force = model.outputs(pt.State(state.coordinates, 0 * u), prepared).reactions
    assert mean == pytest.approx(expected.mean_deflection, rel=0.02)
    assert force["tool"][2] == pytest.approx(expected.force, rel=0.06)
    np.testing.assert_allclose(force["tool"] + force["rim"], 0, atol=0.01 * force["tool"][2])


@pytest.mark.parametrize("cloud", ["rings", "hexagonal", "jittered"])
def test_an_inflated_sheet_rises_as_high_as_the_axisymmetric_one(cloud, axisymmetric):
    expected = axisymmetric.inflate(RADIUS, THICKNESS, axisymmetric.neo_hookean(C1), 10.0).height
    model = sheet(cloud)
    u = np.zeros((len(model.cloud), 3))
    u[:, 2] = 0.03 * (1 - np.sum(model.cloud.points**2, axis=1) / RADIUS**2)
    state, _ = run_to_rest(model, [pt.Pressure("face", -10.0)], u)
    assert state.coordinates[model.cloud.group("centre")[0], 2] == pytest.approx(expected, rel=0.01)


def test_a_strip_pulled_at_its_edge_is_in_simple_tension():
    cloud = CLOUDS["rectangle"]
    model = sheet(cloud, fixed=())
    stretch = 1.3
    stress = 2 * C1 * (stretch - stretch**-2)
    force = stress * 0.06 * THICKNESS
    loads = [pt.SurfaceForce("edge1", force=(force, 0.0, 0.0)), pt.SurfaceForce("edge3", force=(-force, 0.0, 0.0))]
    state = pt.State(uniform(model, np.eye(3, 2) * [stretch, stretch**-0.5]), np.zeros((len(cloud), 3)))
    acceleration = model.acceleration(state, model.prepare(loads))
    largest = force / (1200 * THICKNESS * 0.06 * cloud.spacing)
    assert np.abs(acceleration).max() < 1e-9 * largest
    assert np.abs(model.acceleration(state, model.prepare(()))).max() > 0.5 * largest


def run(cloud="rings", after="return", duration=0.15, **options):
    cloud = (CLOUDS[cloud] if isinstance(cloud, str) else cloud).within("tool", (0.0, 0.0), 1e-6)
    model = sheet(cloud, **options)
    motion = lambda X, t: (0, 0, 0.1 * t if t <= 0.1 * (1 + 1e-9) else 0.0 if after == "return" else 0.01)  # noqa: E731
    tool = pt.PrescribedMotion("tool", motion, until=0.1 if after == "release" else np.inf)
    return model, pt.rollout(model, [tool], duration=duration, every=0.0025, progress=False)


@pytest.mark.parametrize("after", ["return", "hold", "release"])
@pytest.mark.parametrize("cloud", ["rings", "hexagonal", "jittered"])
def test_a_slack_sheet_keeps_its_energy_under_every_motion_of_the_tool(cloud, after):
    _, found = run(cloud, after)
    energy, pushed = found.kinetic + found.strain, found.times <= 0.1 + 1e-9
    assert np.abs(found.balance[pushed]).max() < 2e-3 * found.external[pushed].max()
    after_jump = energy[~pushed]
    assert np.all(np.diff(after_jump) < 2e-3 * after_jump[0])  # no tool does work then; damping takes
    assert after_jump[-1] > 0.1 * after_jump[0]


@pytest.mark.parametrize("seed", range(5))
def test_jittered_sheets_are_stable(seed):
    _, found = run(pt.disc(RADIUS, 0.01, jitter=0.25, seed=seed), "return", prestretch=1.0)
    energy, pushed = found.kinetic + found.strain, found.times <= 0.1 + 1e-9
    assert np.abs(found.balance[pushed]).max() < 2e-3 * found.external[pushed].max()
    assert np.all(np.diff(energy[~pushed]) < 2e-3 * energy[~pushed][0])


def test_the_sheet_keeps_the_symmetry_of_its_rings():
    model, found = run("rings", "return", 0.13)
    points, u = model.cloud.points, found.displacements
    turn = np.array([[0.5, -np.sqrt(0.75)], [np.sqrt(0.75), 0.5]])
    image = np.argmin(np.linalg.norm(points[None] - (points @ turn.T)[:, None], axis=2), axis=1)
    assert np.abs(points[image] - points @ turn.T).max() < 1e-12
    pushed = found.times <= 0.1 + 1e-9
    np.testing.assert_allclose(u[pushed][:, image, 2], u[pushed][:, :, 2], atol=1e-9)
    np.testing.assert_allclose(u[pushed][:, image, :2], u[pushed][:, :, :2] @ turn.T, atol=1e-9)


def test_all_layouts_have_nearly_the_same_deflection():
    means = []
    for layout, jitter in (("rings", 0.0), ("hexagonal", 0.0), ("rings", 0.1)):
        cloud = pt.disc(RADIUS, 0.005, layout, jitter, 1)
        model = sheet(cloud.within("tool", cloud.points[cloud.group("centre")[0]], 1e-6))
        tool = pt.PrescribedMotion("tool", lambda X, t: (0.0, 0.0, 0.1 * t))
        run = pt.rollout(model, [tool], duration=0.1, every=0.005, progress=False)
        means.append(run.displacements[-1, :, 2] @ cloud.volumes / cloud.volumes.sum())
    assert np.ptp(means) < 0.02 * np.mean(means)


def test_a_released_tool_has_no_force_and_the_sheet_moves_freely():
    _, held = run("rings", "hold", 0.12)
    model, let = run("rings", "release", 0.12)
    until = let.times <= 0.1 + 1e-9
    np.testing.assert_array_equal(let.displacements[until], held.displacements[until])
    assert np.all(let.reactions["tool"][~until] == 0)
    assert np.all(np.abs(held.reactions["tool"][~until, 2]) > 0)
    centre = model.cloud.group("tool")[0]
    assert np.abs(let.displacements[-1, centre, 2] - 0.01) > 1e-3


def test_any_number_of_threads_gives_the_same_bits():
    one, threads = None, get_num_threads()
    try:
        for count in (1, threads):
            set_num_threads(count)
            _, found = run("hexagonal", "release", 0.11)
            one = found.displacements if one is None else one
            np.testing.assert_array_equal(found.displacements, one)
    finally:
        set_num_threads(threads)


def test_consistent_weights_differentiate_linear_fields_and_balance_uniform_stress():
    cloud = CLOUDS["jittered"]
    stencils = pt.moving_least_squares(cloud.points, order=2, neighbours=14)
    edges = cloud.boundary_vectors() * cloud.volumes[:, None]
    weights = consistent_gradient(stencils, cloud.points, cloud.volumes, edges)
    offsets = cloud.points[stencils.neighbours] - cloud.points[:, None]
    np.testing.assert_allclose(
        np.einsum("nka,nkb->nab", weights, offsets), np.broadcast_to(np.eye(2), (len(cloud), 2, 2)), atol=1e-9
    )
    sums = -weights.sum(axis=1) * cloud.volumes[:, None]
    np.add.at(sums, stencils.neighbours, weights * cloud.volumes[:, None, None])
    scale = cloud.volumes.max() / cloud.spacing
    free = inside(sheet("jittered"))
    np.testing.assert_allclose(sums[free], 0, atol=1e-9 * scale)
    np.testing.assert_allclose(sums, edges, atol=0.02 * scale)
    fitted = stencils.first[stencils.row]
    assert np.abs(weights - fitted).max() > 1e-3 * np.abs(fitted).max()


def test_a_sheet_that_is_slack_everywhere_only_drifts():
    model = sheet(fixed=())
    shrunk = -0.1 * np.column_stack([model.cloud.points, np.zeros(len(model.cloud))])
    speed = np.broadcast_to([0.0, 0.0, 0.5], shrunk.shape)
    run = pt.rollout(model, duration=0.01, every=0.01, displacement=shrunk, velocity=speed, progress=False)
    np.testing.assert_allclose(run.displacements[-1], shrunk + 0.01 * speed, atol=1e-12)


def test_a_cloud_without_a_boundary_is_refused():
    nothing = {"face_nodes": np.zeros(0, dtype=int), "face_normals": np.zeros((0, 2)), "face_areas": np.zeros(0)}
    with pytest.raises(pt.CloudError, match="must describe a closed boundary"):
        sheet(replace(CLOUDS["rings"], **nothing))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"thickness": 0.0}, "thickness must be .*, got 0.0"),
        ({"thickness": -1e-5}, "thickness"),
        ({"thickness": np.nan}, "thickness"),
        ({"cloud": pt.box((0.03, 0.03, 0.03), 0.01)}, "plane cloud"),
        ({"material": pt.materials.NeoHookean(C1=1e5, density=1000, poisson=0.45)}, "poisson=0.5"),
        ({"fixed": "edge"}, "group must be one of .*, got 'edge'"),
        ({"prestretch": 0.9}, "prestretch must be .*, got 0.9"),
        ({"stiffness_damping": -1.0}, "stiffness_damping"),
        ({"neighbours": 3}, "neighbours"),
    ],
)
def test_invalid_arguments_are_refused_by_name(change, message):
    options = {"cloud": CLOUDS["rings"], "material": LAWS["NeoHookean"], "thickness": THICKNESS, "fixed": "rim"}
    with pytest.raises(pt.InputError, match=message):
        pt.Membrane(**(options | change))


def test_a_solid_refuses_an_incompressible_material():
    with pytest.raises(pt.InputError, match="compressible"):
        pt.Solid(pt.box((0.03, 0.03, 0.03), 0.01), LAWS["NeoHookean"], form="strong")
    with pytest.raises(pt.InputError, match=r"poisson must be below 0\.5"):
        LAWS["NeoHookean"].stress(np.eye(3))


def test_a_prescribed_node_on_the_rim_is_refused():
    model = sheet(CLOUDS["rings"].within("tool", (RADIUS, 0.0), 0.011))
    with pytest.raises(pt.InputError, match="already fixed"):
        model.prepare([pt.PrescribedMotion("tool", (0.0, 0.0, 0.01))])


def test_a_tool_that_prescribes_all_nodes_is_refused():
    model = sheet(CLOUDS["rings"].within("tool", (0.0, 0.0), 0.095))
    with pytest.raises(pt.InputError, match="must have free nodes, got all"):
        model.prepare([pt.PrescribedMotion("tool", (0.0, 0.0, 0.01))])


def test_a_release_before_the_start_is_refused():
    for until in (-1.0, np.nan, "later", None):
        with pytest.raises(pt.InputError, match="until"):
            pt.PrescribedMotion("tool", (0.0, 0.0, 0.01), until=until)
