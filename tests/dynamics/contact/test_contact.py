"""Tools that touch a body: what they may do to it, and what they do exactly."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.dynamics.contact.geometry import compute_patch_positions, coulomb, gap, rotation, signed_distance

SIDE = 0.015
TOP = np.array([SIDE / 2, SIDE / 2, SIDE])
BALL = pt.tools.Sphere(0.008)
SHAPES = [
    pt.tools.Sphere(0.01),
    pt.tools.Capsule(0.004, 0.02),
    pt.tools.Plane(),
    pt.tools.Punch(0.01),
    pt.tools.Punch(0.01, 0.003),
]


@pytest.fixture
def cube(small_cloud, tissue):
    """The smallest box, standing on its lower face; new for every test."""
    return pt.Solid(small_cloud, tissue, fixed="z-", form="energy")


@pytest.fixture
def loose(small_cloud, tissue):
    """The smallest box, held nowhere; new for every test."""
    return pt.Solid(small_cloud, tissue, form="energy")


def press(depth, time=0.02, radius=0.008):
    """Motion of a ball that starts at the top and is `depth` inside where the top was after `time`, then stays."""
    return lambda t: TOP + np.array([0.001, 0.0, radius - depth * min(max(t, 0.0) / time, 1.0)])


def run(model, *loads, duration=0.03, **more):
    return pt.rollout(model, loads, duration=duration, every=1e-3, progress=False, **more)


def gaps(places, times, tool, motion):
    """Signed distances (f, n) of places (f, n, 3) to a tool that does not turn."""
    frame, result = np.zeros((3, 4)), np.zeros(places.shape[:2])
    for f, time in enumerate(times):
        rotation(np.array([*motion(time), 1.0, 0.0, 0.0, 0.0]), frame)
        for i, place in enumerate(places[f]):
            result[f, i] = gap(tool.kind, np.array(tool.sizes), frame, *place)[0]
    return result


# shapes and laws


@pytest.mark.parametrize("tool", SHAPES)
def test_the_normal_is_the_slope_of_the_distance_and_leads_to_the_surface(tool):
    sizes, h = np.array(tool.sizes), 1e-7
    points = np.random.default_rng(0).uniform(-0.02, 0.02, (200, 3))
    for p in points:
        g, *normal = signed_distance(tool.kind, sizes, *p)
        slopes = [
            (signed_distance(tool.kind, sizes, *(p + d))[0] - signed_distance(tool.kind, sizes, *(p - d))[0]) / (2 * h)
            for d in h * np.eye(3)
        ]
        assert np.linalg.norm(normal) == pytest.approx(1.0, abs=1e-12)
        assert np.allclose(slopes, normal, atol=1e-4)
        assert signed_distance(tool.kind, sizes, *(p - g * np.array(normal)))[0] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("tool", "place", "distance"),
    [
        (pt.tools.Sphere(0.01), (0.0, 0.03, 0.04), 0.04),
        (pt.tools.Capsule(0.004, 0.02), (0.0, 0.0, 0.02), 0.006),
        (pt.tools.Capsule(0.004, 0.02), (0.005, 0.0, 0.005), 0.001),
        (pt.tools.Plane(), (3.0, 2.0, -0.5), -0.5),
        (pt.tools.Punch(0.01), (0.0, 0.002, -0.003), 0.003),
        (pt.tools.Punch(0.01, 0.0), (0.013, 0.0, -0.004), 0.005),
        (pt.tools.Punch(0.01), (0.0, 0.012, 0.05), 0.002),
    ],
)
def test_signed_distances_are_those_of_elementary_geometry(tool, place, distance):
    assert signed_distance(tool.kind, np.array(tool.sizes), *place)[0] == pytest.approx(distance, abs=1e-15)


def test_friction_sticks_inside_coulombs_cone_and_slides_on_it():
    assert np.allclose(coulomb(1.0, 0.5, 0.3, -0.4, 7.0, 0.0, 0.0, 1.0), (-0.3, 0.4, 0.0))
    assert np.allclose(coulomb(1.0, 0.5, 3.0, -4.0, 7.0, 0.0, 0.0, 1.0), (-0.3, 0.4, 0.0))
    assert np.allclose(coulomb(1.0, 0.0, 3.0, -4.0, 7.0, 0.0, 0.0, 1.0), 0.0)


# momentum and energy


@pytest.mark.quick(form=["energy"])
@pytest.mark.parametrize("form", ["energy", "strong"])
def test_the_tools_impulse_is_the_momentum_that_a_free_body_gains(small_cloud, tissue, form):
    stiffness_damping = {"energy": None, "strong": 6e-5}[form]
    model = pt.Solid(small_cloud, tissue, form=form, stiffness_damping=stiffness_damping)
    trajectory = run(model, pt.tools.Contact(BALL, press(0.003), friction=0.4))
    weights = model.weights * tissue.density
    impulse = np.cumsum(trajectory.reactions["tool"] * 1e-3, axis=0)
    if form == "energy":  # whose steps are in single precision
        gained = np.einsum("n,fnc->fc", weights, trajectory.velocities)
        assert np.allclose(gained, impulse, rtol=0.0, atol=1e-7 * abs(impulse).max())
    assert impulse[-1, 2] < 0


def test_the_tools_moment_is_the_angular_momentum_that_a_free_body_gains(loose):
    # the body flies against a ball that stands still, about whose centre moments are taken
    place = TOP + np.array([0.003, -0.002, 0.008])
    start = np.tile([0.01, 0.0, 0.1], (len(loose.cloud), 1))
    trajectory = run(loose, pt.tools.Contact(BALL, place, friction=0.5), velocity=start, duration=0.01)
    arms = trajectory.points + trajectory.displacements - place
    turning = np.einsum("n,fnc->fc", loose.masses, np.cross(arms, trajectory.velocities))
    impulse = np.cumsum(trajectory.moments["tool"] * 1e-3, axis=0)
    assert np.allclose(turning - turning[0], impulse, atol=0.01 * np.abs(impulse).max())


@pytest.mark.parametrize("friction", [0.0, 0.3])
def test_the_energy_balance_closes_with_the_work_of_tools_and_friction(cube, friction):
    slide = lambda t: press(0.002)(t) + np.array([0.1 * max(t - 0.02, 0.0), 0.0, 0.0])  # noqa: E731
    trajectory = run(cube, pt.tools.Contact(BALL, slide, friction=friction), duration=0.06, step=5e-5)
    assert np.abs(trajectory.balance).max() < 2e-3 * trajectory.external.max()
    # the tool's work from its own forces and its own motion
    forces, way = trajectory.reactions["tool"][1:], np.diff([slide(t) for t in trajectory.times], axis=0)
    assert np.sum(forces * way) == pytest.approx(trajectory.external[-1], rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("until", [np.inf, 0.015])
def test_the_energy_balance_closes_with_a_tool_next_to_forceps(cube, until):
    grasp = pt.tools.Grasp((0.0, 0.0, SIDE), 0.004, lambda t: np.array([-0.05 * t, 0.0, SIDE + 0.05 * t]), until=until)
    trajectory = run(cube, pt.tools.Contact(BALL, press(0.003), friction=0.3), grasp, step=5e-5)
    held = grasp.with_group(cube.cloud).group("grasp")
    contact_forces, borne = trajectory.contact_forces, -trajectory.reactions["grasp"]
    on_held = contact_forces[np.isin(contact_forces[:, 1], held)]
    np.add.at(borne, on_held[:, 0].astype(int), on_held[:, 2:])
    assert np.abs(borne[1:15]).max() > 1e-3 * np.abs(trajectory.reactions["tool"]).max()  # a share of the ball's force
    assert np.abs(trajectory.balance).max() < 2e-3 * trajectory.external.max()


@pytest.mark.slow
def test_a_balls_force_is_that_of_hertz(tissue):
    radius, depth, d, nu = 0.02, 0.03, 1.6e-3, 0.45
    model = pt.Solid(pt.box((0.06, 0.06, depth), 0.003), tissue, "z-", form="energy", stiffness_damping=6e-5)
    way = lambda t: (0.03, 0.03, depth + radius - d * min(t / 0.02, 1.0))  # noqa: E731
    trajectory = pt.rollout(
        model, [pt.tools.Contact(pt.tools.Sphere(radius), way)], duration=0.03, every=2e-3, progress=False
    )
    a, b = -(1.2876 - 1.4678 * nu + 1.3442 * nu**2) / (1 - nu), (0.6387 - 1.0277 * nu + 1.5164 * nu**2) / (1 - nu)
    x, pi = np.sqrt(radius * d) / depth, np.pi  # for a layer of finite depth: Dimitriadis et al., Biophys. J. 82, 2002
    layer = 1 - 2 * a / pi * x + 4 * a**2 / pi**2 * x**2 - 8 / pi**3 * (a**3 + 4 * pi**2 / 15 * b) * x**3
    layer += 16 * a / pi**4 * (a**3 + 3 * pi**2 / 5 * b) * x**4
    hertz = 8 / 3 * tissue.shear_modulus / (1 - nu) * np.sqrt(radius) * d**1.5 * layer
    # finite elements are 3 % below it at this depth; nodes that tools touch one by one are 19 %
    assert -trajectory.reactions["tool"][-3:, 2].mean() == pytest.approx(hertz, rel=0.08)


@pytest.mark.slow
def test_friction_dissipates_energy_and_frictionless_contact_does_not(cube):
    slide = lambda t: press(0.002)(t) + np.array([0.1 * max(t - 0.02, 0.0), 0.0, 0.0])  # noqa: E731
    lost = [run(cube, pt.tools.Contact(BALL, slide, mu), duration=0.05).dissipated for mu in (0.0, 0.3)]
    friction = np.diff(lost[1])[25:]
    assert friction.min() > -0.03 * friction.max()  # the sweeps end at 3 % of the largest impulse
    assert friction.sum() > 5 * np.abs(friction).max()
    assert lost[1][-1] - lost[1][20] > 5 * (lost[0][-1] - lost[0][20])


def test_the_support_bears_the_force_of_the_tool(cube):
    trajectory = run(cube, pt.tools.Contact(BALL, press(0.002)), duration=0.1)
    rest = trajectory.reactions["tool"][-30:].mean(axis=0)
    assert rest[2] < -1e-3
    assert np.allclose(trajectory.reactions["z-"][-30:].mean(axis=0), -rest, atol=0.01 * abs(rest[2]))


# what contact must not do


def test_a_tool_never_pulls_and_separates_at_once(cube):
    way = press(0.003)
    back = lambda t: way(t) + np.array([0.0, 0.0, 0.8 * max(t - 0.02, 0.0)])  # noqa: E731
    trajectory = run(cube, pt.tools.Contact(BALL, back), duration=0.04)
    force = trajectory.reactions["tool"][:, 2]
    assert force.max() <= 0.0
    assert force[15] < 0
    assert np.all(force[28:] == 0.0)
    assert np.all(trajectory.moments["tool"][28:] == 0.0)


def places_of_patches(model, displacements):
    """Places (f, n, 3) of the patches of a body that tools touch."""
    places, contacts = np.zeros_like(displacements), model.prepare([pt.tools.Contact(BALL, (1.0, 1.0, 1.0))]).contacts
    for u, into in zip(displacements, places, strict=True):
        compute_patch_positions(contacts, u, into)
    return places


@pytest.mark.slow
def test_no_patch_enters_a_small_fast_tool(tissue):
    thin = pt.box((0.03, 0.03, 0.006), spacing=0.002)
    model = pt.Solid(thin, tissue, fixed="x-", form="energy")
    ball = pt.tools.Sphere(0.004)
    drop = lambda t: np.array([0.02, 0.015, 0.006 + 0.0041 - 0.5 * t])  # noqa: E731
    trajectory = run(model, pt.tools.Contact(ball, drop), duration=0.012)
    surface, nodes = np.unique(thin.face_nodes), trajectory.points + trajectory.displacements
    assert (
        gaps(places_of_patches(model, trajectory.displacements), trajectory.times, ball, drop)[:, surface].min() > -2e-6
    )
    assert gaps(nodes, trajectory.times, ball, drop).min() > -0.05 * 0.002
    under = np.argmin(np.linalg.norm(thin.points - [0.02, 0.015, 0.006], axis=1))
    assert trajectory.displacements[-1, under, 2] < -0.005  # it went with the tool


def test_a_tool_that_passes_between_nodes_raises(tissue):
    block = pt.box((0.02, 0.02, 0.016), spacing=0.002)
    model = pt.Solid(block, tissue, fixed="z-", form="energy")
    drop = lambda t: np.array([0.011, 0.011, 0.016 + 0.0021 - 2.0 * t])  # noqa: E731
    with pytest.raises(pt.DivergenceError, match=r"'tool' passed between the nodes .* larger tool") as caught:
        run(model, pt.tools.Contact(pt.tools.Sphere(0.002001), drop), duration=0.005)
    assert not caught.value.trajectory.complete


def test_two_tools_pinch_and_their_forces_add_up(loose):
    low, high = (0.0075, 0.0075, -0.008), (0.0075, 0.0075, SIDE + 0.008)
    pinch = [
        pt.tools.Contact(BALL, lambda t, s=s, at=at: at + np.array([0, 0, s * 0.1 * t]), name=name)
        for name, at, s in (("below", low, 1), ("above", high, -1))
    ]
    trajectory = run(loose, *pinch, duration=0.02)
    below, above = trajectory.reactions["below"], trajectory.reactions["above"]
    assert above[-1, 2] < -1e-2
    momentum = np.einsum("n,fnc->fc", loose.masses, trajectory.velocities)
    assert np.allclose(np.cumsum(below + above, axis=0) * 1e-3, momentum, atol=1e-9 * abs(above).max())
    assert np.allclose(below[:, 2], -above[:, 2], rtol=0.01, atol=1e-3 * abs(above).max())


@pytest.mark.slow
def test_patches_between_two_planes_enter_neither(loose):
    turned = np.array([0.0, np.pi / 2, 0.0])  # its normal is +x
    start = np.tile([-0.1, 0.0, -0.1], (len(loose.cloud), 1))
    walls = [
        pt.tools.Contact(pt.tools.Plane(), (0, 0, 0), name="floor"),
        pt.tools.Contact(pt.tools.Plane(), lambda t: ((0, 0, 0), turned)),
    ]
    trajectory = run(loose, *walls, velocity=start, duration=0.01)
    assert places_of_patches(loose, trajectory.displacements)[..., [0, 2]].min() > -5e-6
    assert np.einsum("n,nc->c", loose.masses, trajectory.velocities[-1])[[0, 2]].min() > 0  # thrown back by both


@pytest.mark.slow
def test_equal_runs_are_equal_to_the_bit(cube):
    runs = [run(cube, pt.tools.Contact(BALL, press(0.002), friction=0.2), duration=0.01) for _ in range(2)]
    assert np.array_equal(runs[0].displacements, runs[1].displacements)
    assert np.array_equal(runs[0].reactions["tool"], runs[1].reactions["tool"])


# friction


@pytest.mark.slow
def test_a_block_slides_down_a_slope_as_coulomb_says(loose):
    mu, down, normal, before = 0.3, 4.0, 9.0, 0.2
    start = np.tile([before, 0.0, 0.0], (len(loose.cloud), 1))
    loads = [pt.Gravity((down, 0.0, -normal)), pt.tools.Contact(pt.tools.Plane(), (0.0, 0.0, 0.0), mu)]
    trajectory = run(loose, *loads, velocity=start, duration=0.1)
    velocity = np.einsum("n,nc->c", loose.masses, trajectory.velocities[-1]) / loose.masses.sum()
    # the normal impulse is known from the momentum along the normal, the tangential is mu times that
    assert velocity[0] - before == pytest.approx(0.1 * (down - mu * normal), rel=0.03)
    force = trajectory.reactions["tool"][1:]
    assert np.sum(force[:, 0]) == pytest.approx(-mu * np.sum(force[:, 2]), rel=1e-3)


def test_a_block_that_friction_can_hold_stays(loose):
    loads = [pt.Gravity((2.0, 0.0, -9.0)), pt.tools.Contact(pt.tools.Plane(), (0.0, 0.0, 0.0), 0.8)]
    trajectory = run(loose, *loads, duration=0.1)
    speed = 0.1 * 2.0  # without friction
    velocity = np.einsum("n,nc->c", loose.masses, trajectory.velocities[-1]) / loose.masses.sum()
    assert abs(velocity[0]) < 0.05 * speed
    ratio = np.abs(trajectory.reactions["tool"][1:, 0]).max() / np.abs(trajectory.reactions["tool"][1:, 2]).max()
    assert ratio < 0.8


@pytest.mark.slow
def test_a_plane_dragged_over_the_body_has_forces_on_coulombs_cone(cube):
    mu, turned = 0.25, np.array([0.0, 1.0, 0.0, 0.0])  # a plane that faces down
    drag = lambda t: ([0.3 * max(t - 0.02, 0.0), 0, SIDE - 0.001 * min(t / 0.02, 1)], turned)  # noqa: E731
    trajectory = run(cube, pt.tools.Contact(pt.tools.Plane(), drag, mu), duration=0.1)
    force = trajectory.reactions["tool"][-20:]
    assert np.allclose(
        np.hypot(force[:, 0], force[:, 1]) / -force[:, 2], mu, rtol=5e-3
    )  # nodes slide a little aside, too
    assert force[:, 0].min() > 0


@pytest.mark.slow
def test_a_turning_tool_turns_sticking_tissue(cube):
    def twist(t):
        return [SIDE / 2, SIDE / 2, SIDE - 0.001 * min(t / 0.02, 1)], [0.0, 0.0, 5.0 * max(t - 0.02, 0.0)]

    trajectory = run(cube, pt.tools.Contact(pt.tools.Punch(0.012), twist, 10.0), duration=0.05)
    top = cube.cloud.group("z+")
    arms = cube.cloud.points[top] - TOP
    before, after = places_of_patches(cube, trajectory.displacements[[20, -1]])[:, top] - TOP
    moved = after - before
    inner = np.hypot(arms[:, 0], arms[:, 1]) < 0.005
    assert inner.sum() == 4
    turned = np.array([[np.cos(0.15), -np.sin(0.15)], [np.sin(0.15), np.cos(0.15)]])
    places = before[inner, :2]
    assert np.allclose(moved[inner, :2], places @ turned.T - places, atol=2e-5)
    assert trajectory.moments["tool"][-1, 2] > 0


@pytest.mark.slow
def test_a_ball_presses_a_membrane_from_either_side():
    cloud = pt.disc(0.05, 0.005)
    law = pt.materials.NeoHookean(C1=1e4, density=1000.0, poisson=0.5)
    sheet = pt.Membrane(cloud, law, 1e-3, fixed="rim", prestretch=1.1)
    ball, forces = pt.tools.Sphere(0.012), []
    for side in (1, -1):
        way = lambda t, side=side: np.array([0.0, 0.0, side * (0.012 - 0.2 * min(t, 0.03))])  # noqa: E731
        trajectory = run(sheet, pt.tools.Contact(ball, way), duration=0.1)
        flat = np.pad(trajectory.points, ((0, 0), (0, 1)))
        places = flat + trajectory.displacements - np.array([way(t) for t in trajectory.times])[:, None]
        assert np.linalg.norm(places, axis=2).min() > 0.012 - 1e-9
        assert np.abs(trajectory.balance).max() < 5e-3 * trajectory.external.max()
        means = [trajectory.reactions[name][-30:, 2].mean() for name in ("tool", "rim")]
        assert means[0] * side < 0
        assert means[1] == pytest.approx(-means[0], rel=0.03)
        forces.append(means[0])
    assert forces[0] == pytest.approx(-forces[1], rel=1e-6)
    with pytest.raises(pt.InputError, match=r"must be at least .* got 0.008 m; use a larger tool"):
        run(sheet, pt.tools.Contact(BALL, (0, 0, 1)))


# motions, files, bad input


@pytest.mark.slow
def test_sampled_and_computed_motions_are_the_same(cube):
    times = np.array([0.0, 0.02, 0.03])
    samples = times, np.array([press(0.002)(t) for t in times])
    runs = [run(cube, pt.tools.Contact(BALL, motion), duration=0.025) for motion in (press(0.002), samples)]
    # a rounding of the motion can change the number of sweeps
    assert np.allclose(runs[0].displacements, runs[1].displacements, rtol=0.0, atol=1e-8)


def test_sampled_turns_are_interpolated_on_the_great_arc():
    tool = pt.tools.Contact(pt.tools.Plane(), ([0.0, 1.0], np.zeros((2, 3)), [[0, 0, 0], [0, 1.0, 0]]))
    quaternion = tool.poses(np.array([0.5]))[0, 3:]
    assert np.allclose(quaternion, [np.cos(0.25), 0, np.sin(0.25), 0])


def test_forceps_hold_turn_and_release_tissue(cube):
    def lift(t):
        return TOP + np.array([0, 0, 0.1 * min(t, 0.02)]), [0, 0, 10.0 * min(t, 0.02)]

    grasp = pt.tools.Grasp(TOP, 0.004, lift, until=0.03, name="forceps")
    trajectory = run(cube, grasp, duration=0.06)
    near = np.linalg.norm(cube.cloud.points - TOP, axis=1) < 0.004
    assert near.sum() == 4
    c, s = np.cos(0.2), np.sin(0.2)
    arms = cube.cloud.points[near] - TOP
    turned = arms @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]).T - arms + [0, 0, 0.002]
    assert np.allclose(trajectory.displacements[25, near], turned, atol=1e-12)
    assert trajectory.reactions["forceps"][25, 2] > 0
    assert np.all(trajectory.reactions["forceps"][31:] == 0.0)
    assert np.abs(trajectory.displacements[-1, near] - turned).max() > 5e-4


@pytest.mark.slow
def test_a_tool_touches_nodes_that_forceps_have_released(cube):
    grasp = pt.tools.Grasp(TOP, 0.004, lambda t: TOP + np.array([0, 0, -0.002 * min(t / 0.01, 1)]), until=0.012)
    roof = pt.tools.Contact(pt.tools.Plane(), ([0, 0, SIDE - 0.0005], [0.0, 1.0, 0, 0]), group="grasp")
    with_group = grasp.with_group(cube.cloud)
    model = pt.Solid(with_group, cube.material, fixed="z-", form="energy")
    trajectory = run(model, grasp, roof, duration=0.04)
    assert np.all(trajectory.reactions["tool"][:12] == 0.0)
    assert trajectory.reactions["tool"][-15:, 2].max() < 0
    assert trajectory.displacements[-1, with_group.group("grasp"), 2].max() <= -0.0005 + 1e-9


def test_moments_of_tools_are_stored_and_joined(cube, tmp_path):
    loads = [pt.tools.Contact(BALL, press(0.002), friction=0.3)]
    first = run(cube, *loads, duration=0.01)
    last = first.displacements[-1], first.velocities[-1]
    second = run(cube, *loads, duration=0.01, start=0.01, displacement=last[0], velocity=last[1])
    both = first.concatenate(second)
    both.save(tmp_path / "run.h5")
    read = pt.Trajectory.load(tmp_path / "run.h5")
    assert read.moments["tool"].shape == (21, 3)
    assert np.array_equal(read.moments["tool"], both.moments["tool"])
    assert np.abs(second.reactions["tool"][1:, 2]).min() > 0  # contact goes on


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: pt.tools.Sphere(-1.0), r"radius of a Sphere must be .*, got -1.0"),
        (lambda: pt.tools.Sphere(np.nan), "radius of a Sphere"),
        (lambda: pt.tools.Capsule(0.01, 0.0), "length of a Capsule"),
        (lambda: pt.tools.Punch(0.01, 0.02), "rounding of a Punch"),
        (lambda: pt.tools.Contact("ball", (0, 0, 0)), "of Contact 'tool' must be a Sphere, .* got 'ball'"),
        (lambda: pt.tools.Contact(BALL, (0, 0, 0), -0.1), "friction of Contact 'tool' must be .*, got -0.1"),
        (lambda: pt.tools.Contact(BALL, lambda t: (np.nan, 0, 0)), "'tool' must be finite, got .* at t = 0"),
        (lambda: pt.tools.Contact(BALL, lambda t: (0, 0)), r"'tool' must be a position \(3,\)"),
        (lambda: pt.tools.Contact(BALL, lambda t: (TOP * 2, (0, 0, 0, 0))), "must have a length above 0"),
        (lambda: pt.tools.Contact(BALL, lambda t: (TOP * 2, (0, np.inf, 0))), "must be a finite rotation vector"),
        (lambda: pt.tools.Contact(BALL, ([0, 1], np.zeros((3, 3)))), "must have shapes"),
        (lambda: pt.tools.Contact(BALL, ([1, 0], np.zeros((2, 3)))), "must have ascending times"),
        (lambda: pt.tools.Contact(BALL, 2 * TOP, group="top"), "group must be one of .*, got 'top'"),
        (
            lambda: pt.tools.Contact(BALL, 2 * TOP, name="z-"),
            "must differ from supports and prescribed groups, got 'z-'",
        ),
        (
            lambda: pt.tools.Contact(pt.tools.Sphere(0.004), 2 * TOP),
            "must be at least 0.005 m .* got 0.004 m",
        ),
        (
            lambda: pt.tools.Contact(BALL, TOP),
            r"'tool' must start outside .* a depth of 0.00\d* m at nodes",
        ),
        (
            lambda: pt.tools.Contact(BALL, lambda t: TOP + np.array([0, 0, 0.1 - 100 * t])),
            "must be at most 0.004 m in a step",
        ),
    ],
)
def test_invalid_tools_are_refused_by_name(cube, make, message):
    with pytest.raises(pt.InputError, match=message):
        run(cube, make(), duration=2e-3)


@pytest.mark.parametrize("pose", [5, None, "down", (), (0, 0), (0, 0, 1, 2), (0, 0, np.nan), {"z": 1}])
@pytest.mark.parametrize("load", [lambda at: pt.tools.Contact(BALL, at), lambda at: pt.tools.Grasp(TOP, 0.004, at)])
def test_a_constant_pose_is_checked_when_the_tool_is_made(load, pose):
    with pytest.raises(pt.InputError, match=r"motion of (Contact 'tool'|Grasp 'grasp') must be (a position|finite)"):
        load(pose)
    load(lambda t: pose)


def test_two_tools_of_one_name_are_refused(cube):
    with pytest.raises(pt.InputError, match="must be unique, got 'tool' twice"):
        run(cube, *[pt.tools.Contact(BALL, 2 * TOP)] * 2)
