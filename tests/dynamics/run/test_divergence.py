"""Bodies that fall or fly as a whole do not diverge, and errors of those that do name the reason and its remedy."""

from __future__ import annotations

from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import palpate as pt
from palpate.dynamics.run.divergence import deformation_size

LAW = pt.materials.NeoHookean(C1=500.0, density=1000.0, poisson=0.4)
SIZE, SPACING = (0.03, 0.02, 0.02), 0.005  # [m]
GRAVITY = pt.Gravity((0.0, 0.0, -9.81))


def bar(**options):
    return pt.Solid(pt.box(SIZE, SPACING), LAW, **options)


def spin(body, displacements, velocities):
    """The angular momentum (3,) [kg m^2/s] about the centre of mass."""
    masses, places = body.masses / body.masses.sum(), body.cloud.points + displacements
    arms, moving = places - masses @ places, velocities - masses @ velocities
    return body.masses @ np.cross(arms, moving)


def test_a_rigid_motion_of_each_piece_does_not_deform_it():
    points = pt.box(SIZE, SPACING).points
    pieces = (points[:, 0] > 0.016).astype(int)
    turned = Rotation.from_rotvec([1.0, 2.0, -0.5]).apply(points) - points + np.array([5.0, 0.0, -40.0])
    assert deformation_size(points, turned, np.zeros(len(points), dtype=int)) < 1e-13
    apart = np.where(pieces[:, None] == 1, turned, 0.0)
    assert deformation_size(points, apart, pieces) < 1e-13
    assert deformation_size(points, apart, 0 * pieces) > 1.0
    mirrored = points * [1.0, 1.0, -1.0] - points
    assert deformation_size(points, mirrored, 0 * pieces) > 0.005
    sheet = pt.disc(0.05, 0.01).points
    standing = np.column_stack([0.0 * sheet[:, 0], sheet]) - np.pad(sheet, ((0, 0), (0, 1)))
    assert deformation_size(sheet, standing, np.zeros(len(sheet), dtype=int)) < 1e-13
    turned[3, 1] = np.nan
    assert deformation_size(points, turned, 0 * pieces) == np.inf


@pytest.mark.slow
@pytest.mark.parametrize("form", ["energy", "strong"])
def test_a_body_without_supports_falls_with_its_shape(form):
    run = pt.rollout(bar(form=form, fixed=()), [GRAVITY], duration=1.0, every=0.25, progress=False)
    for time, moved in zip(run.times, run.displacements, strict=True):  # 163 times its size
        np.testing.assert_allclose(moved[:, 2], -0.5 * 9.81 * time**2, rtol=1e-9)
        np.testing.assert_allclose(moved, np.broadcast_to(moved.mean(axis=0), moved.shape), atol=1e-12)
    assert run.strain[-1] < 1e-12


@pytest.mark.slow
def test_a_sheet_and_a_reduced_body_without_supports_fall_with_their_shape():
    rubber = pt.materials.NeoHookean(C1=0.17e6, density=1200.0, poisson=0.5)
    body = bar(fixed=())
    shaken = pt.SurfaceForce("x+", force=lambda t: (0.002 * np.sin(60 * t), 0.0, 0.0))
    trained = pt.rollout(body, [GRAVITY, shaken], duration=0.3, every=0.003, progress=False)
    reduced = pt.hyper_reduce(body, trained, modes=6)
    sheet = pt.Membrane(pt.disc(0.05, 0.01), rubber, 1e-3, ())
    for model, duration, error in ((sheet, 2.0, 1e-9), (reduced, 1.0, 3e-3), (reduced.with_step(1e-3), 1.0, 3e-3)):
        with nullcontext() if model is sheet else pytest.warns(pt.TrustWarning):
            run = pt.rollout(model, [GRAVITY], duration=duration, every=duration / 4, progress=False)
        fall = 0.5 * 9.81 * duration**2  # the modes of the reduced body err by 0.2 % in its direction
        assert run.strain[-1] < 1e-6
        np.testing.assert_allclose(
            run.displacements[-1], np.tile([0.0, 0.0, -fall], (len(model.cloud), 1)), atol=error * fall
        )


@pytest.mark.slow
@pytest.mark.parametrize(("form", "damping"), [("energy", 0.0), ("energy", None), ("strong", None)])
def test_a_thrown_body_that_turns_keeps_its_momenta_and_energy(form, damping):
    """Stiffness damping takes beta w^2 of the spin per second, and twice that of its energy; nothing else does."""
    body = bar(form=form, fixed=(), stiffness_damping=damping)
    turning = np.array([3.0, 5.0, 20.0])
    start = np.array([2.0, 0.0, 5.0]) + np.cross(turning, body.cloud.points - body.cloud.points.mean(axis=0))
    run = pt.rollout(body, [GRAVITY], velocity=start, duration=1.0, every=0.1, progress=False)
    centre = body.masses @ run.displacements[-1] / body.masses.sum()
    np.testing.assert_allclose(centre, [2.0, 0.0, 5.0 - 0.5 * 9.81], atol=1e-6)
    spins = np.array([spin(body, *each) for each in zip(run.displacements, run.velocities, strict=True)])
    lost = np.linalg.norm(spins - spins[0], axis=1).max() / np.linalg.norm(spins[0])
    assert lost <= 1.5 * body.stiffness_damping * turning @ turning + 1e-6
    height = run.displacements @ np.array([0.0, 0.0, 1.0]) @ body.masses / body.masses.sum()
    energy = run.kinetic + run.strain + 9.81 * body.masses.sum() * height
    own = run.kinetic[0] - 0.5 * body.masses.sum() * 29.0  # of the rotation
    assert np.abs(energy - energy[0]).max() <= (3.0 * body.stiffness_damping * turning @ turning + 2e-4) * own


@pytest.mark.slow
def test_a_piece_that_a_cut_frees_falls_with_its_shape():
    """It slides along the other face and off it, and then touches nothing: the rest is held to its face."""
    cloud = pt.box((0.04, 0.02, 0.02), 0.0025)
    cloud = replace(cloud, groups={**cloud.groups, "rest": np.flatnonzero(cloud.points[:, 0] < 0.0205)})
    a, b, c, d = ([0.021, y, z] for y, z in ((-0.01, -0.01), (0.03, -0.01), (0.03, 0.03), (-0.01, 0.03)))
    body = pt.cut(pt.Solid(cloud, LAW, fixed="rest"), np.array([[a, b, c], [a, c, d]]))
    assert len(np.unique(body.pieces)) == 2
    run = pt.rollout(body, [GRAVITY], duration=1.0, every=0.25, progress=False)
    piece = run.displacements[-1][body.loose_nodes]
    assert len(piece) > 500
    np.testing.assert_allclose(piece, np.tile([0.0, 0.0, -0.5 * 9.81], (len(piece), 1)), atol=1e-9)


@pytest.mark.slow
def test_a_piece_that_is_pushed_and_turns_as_it_falls_goes_on():
    """The rest sags under its weight, pushes the piece, and swings through its place: no contact at a distance."""
    a, b, c, d = ([0.021, y, z] for y, z in ((-0.01, -0.01), (0.03, -0.01), (0.03, 0.03), (-0.01, 0.03)))
    body = pt.cut(pt.Solid(pt.box((0.04, 0.02, 0.02), 0.0025), LAW, fixed="x-"), np.array([[a, b, c], [a, c, d]]))
    run = pt.rollout(body, [GRAVITY], duration=1.0, every=0.1, progress=False)
    assert run.complete
    loose = body.loose_nodes
    assert deformation_size(body.cloud.points[loose], run.displacements[-1][loose], 0 * loose) < 2e-4
    assert run.displacements[-1][loose, 2].mean() == pytest.approx(-0.5 * 9.81, rel=1e-3)


def plate(name, height, speed=0.0, up=False):
    turn = (0.0, 0.0, 0.0) if up else (np.pi, 0.0, 0.0)
    return pt.tools.Contact(pt.tools.Plane(), lambda t: ((0.015, 0.01, height - speed * t), turn), name=name)


CRUSHED = {
    "plate": ({"fixed": "z-"}, [plate("plate", 0.0205, 0.1)], 0.2),
    "ball": (
        {"fixed": "z-"},
        [pt.tools.Contact(pt.tools.Sphere(0.01), lambda t: (0.015, 0.01, 0.0305 - 0.1 * t))],
        0.2,
    ),
    "plates about a free body": ({"fixed": ()}, [plate("lower", -0.0005, up=True), plate("upper", 0.0205, 0.1)], 0.2),
    "motion": ({"fixed": "z-"}, [pt.PrescribedMotion("z+", lambda points, t: (0.0, 0.0, -0.4 * t))], 0.1),
    "strong form": ({"fixed": "z-", "form": "strong"}, [plate("plate", 0.0205, 0.1)], 0.2),
    "force": ({"fixed": "z-"}, [pt.SurfaceForce("z+", force=(0.0, 0.0, -60.0))], 0.02),
    "force on a free body": ({"fixed": ()}, [pt.SurfaceForce("z+", force=(0.0, 0.0, -60.0))], 0.02),
    "pressure": ({"fixed": "z-"}, [pt.Pressure("z+", pressure=1e6), GRAVITY], 0.02),
    "gravity": ({"fixed": "z-"}, [pt.Gravity((0.0, 0.0, -98100.0))], 0.02),
}
REASONS = {
    "plate": (
        "Contact 'plate' crushes the tissue with ",
        "End the motion of 'plate' before that time, press less deep",
    ),
    "ball": ("Contact 'tool' crushes the tissue with ", "End the motion of 'tool' before that time, press less deep"),
    "plates about a free body": ("Contact 'upper' crushes the tissue", "The body is free: no support holds it"),
    "motion": ("PrescribedMotion of 'z+' crushes the tissue with ", "or move it less far"),
    "strong form": ("Contact 'plate' crushes the tissue with ", "press less deep"),
    "force": ("SurfaceForce on 'z+' crushes the tissue with 60 N: ", "check the units of both, use a smaller load"),
    "force on a free body": ("SurfaceForce on 'z+' crushes the tissue with 60 N: ", "no support holds it"),
    "pressure": ("Pressure on 'z+' crushes the tissue with 600 N: ", "check the units of both, use a smaller load"),
    "gravity": ("Gravity of 9.81e+04 m/s^2 crushes the tissue with ", "Check the units of acceleration"),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", CRUSHED)
def test_the_error_of_a_crushed_body_names_the_load_the_place_and_what_to_do_about_it(case):
    options, loads, duration = CRUSHED[case]
    reason, remedy = REASONS[case]
    with pytest.raises(pt.DivergenceError) as caught:
        pt.rollout(bar(**options), loads, duration=duration, every=duration / 20, progress=False)
    message = str(caught.value)
    assert message.startswith(reason)
    assert remedy in message
    assert " at node " in message
    assert "compressed to" in message or "turned inside out at node" in message
    assert "more damping" not in message
    assert "finer spacing" not in message
    assert ("The body is free" in message) == (options["fixed"] == ())


@pytest.mark.slow
def test_a_reduced_body_that_is_crushed_names_the_load():
    body = bar(fixed="z-")
    trained = pt.rollout(
        body, [pt.SurfaceForce("z+", force=(0.0, 0.0, -0.1))], duration=0.02, every=1e-3, progress=False
    )
    reduced = pt.hyper_reduce(body, trained, modes=3)
    with pytest.raises(pt.DivergenceError, match=r"^SurfaceForce on 'z\+' (crushes|is too large for) the tissue"):
        pt.rollout(reduced, [pt.SurfaceForce("z+", force=(0.0, 0.0, -1e9))], duration=0.02, every=1e-3, progress=False)


@pytest.mark.slow
def test_velocities_at_the_start_are_named():
    apart = 300.0 * np.random.default_rng(0).standard_normal((len(bar(fixed="z-").cloud), 3))
    with pytest.raises(pt.DivergenceError, match=r"Start from (a smaller displacement or velocity|smaller)"):
        pt.rollout(bar(fixed="z-"), velocity=apart, duration=0.01, every=0.005, progress=False)


@pytest.mark.slow
def test_a_sheet_under_a_pressure_far_too_large_names_it():
    rubber = pt.materials.NeoHookean(C1=0.17e6, density=1200.0, poisson=0.5)
    sheet = pt.Membrane(pt.disc(0.05, 0.01), rubber, 1e-3, "rim", prestretch=1.05)
    with pytest.raises(pt.DivergenceError, match=r"^Pressure on 'face' .* the tissue.*check the units of both"):
        pt.rollout(sheet, [pt.Pressure("face", pressure=1e7)], duration=0.02, every=0.002, progress=False)
