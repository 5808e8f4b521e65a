"""A blade in a run: the force of a steady cut, its energy balance, out and in again, and bad input."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import palpate as pt

pytestmark = pytest.mark.slow

SPACING, THICKNESS, TOUGHNESS = 2e-3, 6e-3, 5.0
SIZE = (32e-3, 20e-3, THICKNESS)
# the edge along z of the sheet, cutting towards x
ACROSS = Rotation.from_matrix([[0, 0, -1], [0, 1, 0], [1, 0, 0]]).as_rotvec()
EDGE = [(-6e-3, 0, 0), (6e-3, 0, 0)]
SPEED = 0.1  # [m/s]


def sheet(stiffness=8e3):
    tissue = pt.materials.MooneyRivlin(C1=stiffness, C2=0, density=1000.0, poisson=0.45)
    return pt.Solid(pt.box(SIZE, SPACING, jitter=0.2), tissue, fixed="x+")


def knife(blade, motion=lambda t: -3e-3 + SPEED * t):
    place = lambda t: (motion(t), 0.5 * SIZE[1] + 0.2e-3, 0.5 * THICKNESS)  # noqa: E731
    return pt.tools.Contact(blade, lambda t: (place(t), ACROSS), name="knife")


@pytest.fixture(scope="module")
def steady_cut():
    blade = pt.tools.Blade(EDGE, toughness=TOUGHNESS)
    return pt.rollout(sheet(), [knife(blade)], duration=0.16, every=0.01, progress=False)


def test_the_force_of_a_steady_cut_is_toughness_times_thickness(steady_cut):
    force = steady_cut.reactions["knife"][7:, 0].mean()
    assert force == pytest.approx(TOUGHNESS * THICKNESS, rel=0.05)


def test_the_cut_area_is_that_of_the_way_of_the_blade(steady_cut):
    way = -3e-3 + SPEED * steady_cut.times[-1]
    recoil = np.abs(steady_cut.displacements[-1]).max()
    assert steady_cut.cut_area[-1] == pytest.approx(way * THICKNESS, abs=(recoil + 0.5 * SPACING) * THICKNESS)
    assert np.all(np.diff(steady_cut.cut_area) >= 0)


def test_the_energy_balance_of_a_blade_closes(steady_cut):
    run = steady_cut
    assert np.abs(run.balance).max() <= 5e-3 * run.external[-1]
    fracture = run.edge_work[-1] + run.released_energy[-1]
    assert fracture == pytest.approx(TOUGHNESS * run.cut_area[-1], rel=0.05)
    assert np.abs(run.released_energy).max() <= 0.05 * run.external[-1]


@pytest.mark.parametrize("speed", [1.0, 2.0])
def test_the_force_of_a_fast_blade_is_that_of_a_slow_one(speed):
    blade = pt.tools.Blade(EDGE, toughness=TOUGHNESS)
    fast = knife(blade, lambda t: -3e-3 + speed * t)
    run = pt.rollout(sheet(), [fast], duration=0.018 / speed, every=0.0018 / speed, progress=False)
    fracture = run.edge_work[-1] + run.released_energy[-1]
    assert fracture == pytest.approx(TOUGHNESS * run.cut_area[-1], rel=0.05)
    assert run.reactions["knife"][4:, 0].mean() == pytest.approx(TOUGHNESS * THICKNESS, rel=0.1)


def test_a_support_bears_the_force_of_the_blade(steady_cut):
    run = steady_cut
    momentum = np.einsum("n,tnc->tc", sheet().masses, run.velocities)[:, 0]
    forces = run.reactions["knife"][1:, 0].sum() * 0.01
    support = np.trapezoid(run.reactions["x+"][:, 0], run.times)
    assert forces + support == pytest.approx(momentum[-1] - momentum[0], abs=0.2 * forces)


def test_cuts_and_their_energies_are_stored(steady_cut, tmp_path):
    steady_cut.save(tmp_path / "run.h5")
    again = pt.Trajectory.load(tmp_path / "run.h5")
    for name in ("cut_area", "released_energy", "edge_work", "friction_work", "release_rate", "cuts"):
        np.testing.assert_array_equal(getattr(again, name), getattr(steady_cut, name))
    assert len(again.cuts)


def test_out_and_in_again_costs_the_toughness_of_the_new_area_only():
    def motion(t):  # in, out, in again a little further
        return float(np.interp(t, [0.0, 0.15, 0.3, 0.45, 0.5], [-3e-3, 12e-3, -3e-3, 12e-3, 15e-3]))

    run = pt.rollout(
        sheet(), [knife(pt.tools.Blade(EDGE, toughness=TOUGHNESS), motion)], duration=0.5, every=0.05, progress=False
    )
    first, second, end = (run.cut_area[k] for k in (3, 9, 10))
    assert second - first <= 0.1 * first
    assert end - second == pytest.approx(3e-3 * THICKNESS, rel=0.35)
    work = run.edge_work + run.released_energy
    assert work[9] - work[3] <= 0.12 * work[3]


def test_a_curved_blade_that_is_drawn_out_along_its_edge_cuts_nothing():
    tissue = pt.materials.MooneyRivlin(C1=1500.0, C2=0, density=1060.0, poisson=0.45)
    body = pt.Solid(pt.box((0.06, 0.03, 0.02), 5e-3, jitter=0.2), tissue, fixed="z-")
    edge = [(-0.012, 0, 0.004), (-0.006, 0, 0.001), (0, 0, 0), (0.006, 0, 0.001), (0.012, 0, 0.004)]

    def motion(t):
        down, out = min(t, 0.25), max(t - 0.25, 0.0)
        return 0.02 + 0.06 * out, 0.015, 0.021 - 0.036 * down + 0.03 * out

    knife = pt.tools.Contact(pt.tools.Blade(edge, toughness=5.0), motion)
    run = pt.rollout(body, [knife], duration=0.5, every=0.025)
    area, work = run.cut_area, run.edge_work + run.released_energy
    assert area[18] < 1.02 * area[13]  # from 0.325 s, when the edge no longer pushes, until it leaves the body
    assert area[-1] < 1.05 * area[13]
    assert not run.friction_work.any()
    # pieces of the edge that enter the body cut without a force until the next cut
    assert work[10] == pytest.approx(5.0 * area[10], rel=0.08)
    assert work[10] - work[5] == pytest.approx(5.0 * (area[10] - area[5]), rel=0.03)


def test_friction_adds_the_shear_stress_on_both_sides():
    runs = [
        pt.rollout(
            sheet(), [knife(pt.tools.Blade(EDGE, TOUGHNESS, friction=stress, height=8e-3))],
            duration=0.16, every=0.01, progress=False,
        )
        for stress in (0.0, 100.0)
    ]  # fmt: skip
    without, with_friction = (run.reactions["knife"][-4:, 0].mean() for run in runs)
    assert with_friction - without == pytest.approx(2 * 100.0 * 8e-3 * THICKNESS, rel=0.3)
    assert np.abs(runs[1].balance).max() <= 5e-3 * runs[1].external[-1]


def test_the_thickness_of_a_blade_wedges_the_cut_apart():
    """Without a thickness the faces stay together; the balance of the run closes all the same."""
    wedge = 1.5e-3
    openings = []
    for thickness in (0.0, wedge):
        blade = pt.tools.Blade(EDGE, toughness=TOUGHNESS, wedge=thickness, height=20e-3)
        body = sheet()
        run = pt.rollout(body, [knife(blade)], duration=0.16, every=0.01, progress=False)
        x, y = body.cloud.points[:, 0], body.cloud.points[:, 1] - 0.5 * SIZE[1] - 0.2e-3
        near = (x < 8e-3) & (np.abs(y) < SPACING)
        sides = [run.displacements[-1][near & side, 1].mean() for side in (y > 0, y < 0)]
        openings.append(sides[0] - sides[1])
        assert np.abs(run.balance).max() <= 0.02 * run.external[-1]
    assert abs(openings[0]) < 0.2 * wedge
    assert 0.5 * wedge < openings[1] < 1.2 * wedge


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"edge": [(0, 0, 0)]}, "at least two points"),
        ({"edge": [(0, 0, 0), (0, 0, 0)]}, "must have a length"),
        ({"edge": [(0, 0, 0), (0, 1, 0)]}, "plane y = 0"),
        ({"edge": [(1, 0, 0), (0, 0, 0)]}, "ascending x"),
        ({"toughness": -1.0}, "toughness of a Blade"),
        ({"wedge": np.nan}, "wedge of a Blade"),
    ],
)
def test_bad_blades_are_refused(options, message):
    with pytest.raises(pt.InputError, match=message):
        pt.tools.Blade(**({"edge": EDGE, "toughness": TOUGHNESS} | options))


def test_a_blade_that_begins_inside_is_refused():
    blade = knife(pt.tools.Blade(EDGE, TOUGHNESS), lambda t: 5e-3)
    with pytest.raises(pt.InputError, match="must start outside the body"):
        pt.rollout(sheet(), [blade], duration=0.01, every=0.01, progress=False)


def test_a_blade_that_reaches_a_support_ends_the_run_with_its_frames():
    blade = knife(pt.tools.Blade(EDGE, toughness=0.0), lambda t: -2e-3 + 1.2 * t)
    with pytest.raises(pt.DivergenceError, match="which a support or a tool holds") as error:
        pt.rollout(sheet(), [blade], duration=0.05, every=0.005, progress=False)
    assert len(error.value.trajectory.times) > 3


def test_a_blade_that_returns_to_its_taut_cut_does_not_warn_of_tearing():
    pulls = [
        pt.PrescribedMotion(side, lambda _, t, sign=sign: (0.0, sign * 0.45e-3 * min(t / 0.05, 1.0), 0.0))
        for side, sign in (("y-", -1.0), ("y+", 1.0))
    ]
    way = lambda t: float(np.interp(t, [0.06, 0.12, 0.18, 0.3], [-3e-3, 8e-3, 2e-3, 14e-3]))  # noqa: E731
    body = pt.Solid(pt.box((24e-3, 18e-3, THICKNESS), SPACING), sheet(16e3).material, (), mass_damping=100.0)
    place = lambda t: ((way(t), 9.2e-3, 0.5 * THICKNESS), ACROSS)  # noqa: E731
    blade = pt.tools.Contact(pt.tools.Blade(EDGE, toughness=TOUGHNESS), place, name="knife")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run = pt.rollout(body, [blade, *pulls], duration=0.23, every=0.01, progress=False)
    assert run.release_rate[12] > 0.1
    assert run.cut_area[-1] > 45e-6


def test_a_run_in_which_tissue_would_tear_ahead_of_the_blade_warns():
    blade = knife(pt.tools.Blade(EDGE, toughness=0.2), lambda t: -3e-3 + SPEED * max(t - 0.06, 0.0))
    pull = [
        pt.SurfaceForce(side, lambda t, sign=sign: (0, sign * 0.3 * min(t / 0.05, 1.0), 0))
        for side, sign in (("y+", 1), ("y-", -1))
    ]
    with pytest.warns(UserWarning, match="would tear ahead of Contact 'knife'"):
        run = pt.rollout(sheet(), [blade, *pull], duration=0.16, every=0.01, progress=False)
    assert run.release_rate[-1] > 0.2
    assert np.abs(run.reactions["knife"][-1, 0]) < 0.02 * 0.2 * THICKNESS


def test_only_solids_in_the_energy_form_are_cut():
    blade = knife(pt.tools.Blade(EDGE, TOUGHNESS))
    body = pt.Solid(
        pt.box(SIZE, SPACING),
        pt.materials.MooneyRivlin(C1=16e3, C2=0, density=1000.0, poisson=0.45),
        "x+",
        form="strong",
    )
    with pytest.raises(pt.InputError, match="model of a Blade"):
        pt.rollout(body, [blade], duration=0.01, every=0.01, progress=False)


def test_two_blades_are_refused():
    blades = [pt.tools.Contact(pt.tools.Blade(EDGE, TOUGHNESS), (-0.1, 0, 0), name=name) for name in ("a", "b")]
    with pytest.raises(pt.InputError, match="one Blade at most"):
        pt.rollout(sheet(), blades, duration=0.01, every=0.01, progress=False)


def test_a_body_with_planes_of_symmetry_is_not_cut():
    body = pt.Solid(pt.box(SIZE, SPACING), sheet().material, ["x+", pt.SymmetryPlane("z-")])
    with pytest.raises(pt.InputError, match="no planes of symmetry"):
        pt.rollout(body, [knife(pt.tools.Blade(EDGE, TOUGHNESS))], duration=0.01, every=0.01, progress=False)
