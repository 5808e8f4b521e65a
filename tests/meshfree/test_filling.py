"""From a surface to a cloud: volumes, areas, spacing, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from closed_surfaces import ball, cube, inverted, joined

import palpate as pt
from palpate.meshfree.gate import nearest_spacing
from palpate.meshfree.stencils import moving_least_squares

SPACING = 0.009


@pytest.fixture(scope="module")
def body():
    return ball()


@pytest.fixture(scope="module")
def cloud(body):
    return pt.fill(body, SPACING)


def test_volumes_sum_to_the_volume_of_the_body(body, cloud):
    assert cloud.volumes.sum() == pytest.approx(body.volume, rel=1e-12)


def test_volumes_integrate_a_quadratic_field_of_a_ball(cloud):
    # the mean of r^2 over a ball is 3/5 R^2; the half cells under the surface cost first order
    mean = cloud.volumes @ np.sum(cloud.points**2, axis=1) / cloud.volumes.sum()
    assert mean == pytest.approx(0.6 * 0.05**2, rel=0.06)


def test_area_vectors_close_and_areas_sum_to_the_area(body, cloud):
    vectors = cloud.face_areas[:, None] * cloud.face_normals
    assert np.abs(vectors.sum(axis=0)).max() < 1e-12 * body.area
    assert cloud.face_areas.sum() == pytest.approx(body.area, rel=0.02)
    assert np.array_equal(cloud.face_nodes, cloud.group("surface"))


def test_the_divergence_theorem_holds_for_the_position(body, cloud):
    # the sum of area vectors times positions is the volume times the unit tensor
    tensor = (cloud.face_areas[:, None] * cloud.face_normals).T @ cloud.points[cloud.face_nodes]
    assert tensor == pytest.approx(body.volume * np.eye(3), abs=0.01 * body.volume)


def test_normals_of_a_ball_are_radial(cloud):
    radial = cloud.points[cloud.face_nodes] / np.linalg.norm(cloud.points[cloud.face_nodes], axis=1)[:, None]
    assert np.sum(radial * cloud.face_normals, axis=1).min() > 0.98


def test_surface_nodes_lie_on_the_surface_and_others_deep_below(cloud):
    radius = np.linalg.norm(cloud.points, axis=1)
    assert radius[cloud.group("surface")] == pytest.approx(0.05, rel=0.02)
    assert radius[cloud.group("inside")].max() < 0.05 - 0.55 * SPACING


def test_nodes_lie_evenly(cloud):
    distance = nearest_spacing(cloud.points) / SPACING
    assert distance[cloud.group("inside")].min() > 0.8
    assert distance[cloud.group("inside")].max() < 1.25
    assert distance[cloud.group("surface")].min() > 0.45


def test_the_triangles_of_the_nodes_are_closed_and_enclose_the_body(body, cloud):
    drawn = pt.Surface(cloud.points[cloud.group("surface")], cloud.triangles)  # those nodes come first
    checked = pt.io.check_surface(drawn)
    assert checked.errors == ()
    assert checked.euler == 2
    assert checked.volume == pytest.approx(body.volume, rel=0.04)
    assert np.array_equal(np.unique(cloud.triangles), cloud.group("surface"))


def test_stencils_of_the_cloud_differentiate_quadratics_exactly(cloud):
    x, y, z = cloud.points.T
    stencils = moving_least_squares(cloud.points, order=2, neighbours=42)
    exact = np.stack([2 * x + y, x, -2 * z], axis=1)
    assert stencils.gradient(x**2 + x * y - z**2) == pytest.approx(exact, abs=1e-10)


def test_equal_seeds_give_equal_clouds_and_others_do_not(body, cloud):
    again, other = pt.fill(body, SPACING), pt.fill(body, SPACING, seed=1)
    assert np.array_equal(again.points, cloud.points)
    assert np.array_equal(again.volumes, cloud.volumes)
    assert len(other) != len(cloud) or not np.array_equal(other.points, cloud.points)


@pytest.mark.parametrize("lattice", ["cubic", "scattered"])
def test_other_lattices_fill_the_body_as_evenly(body, lattice):
    other = pt.fill(body, SPACING, lattice=lattice)
    distance = nearest_spacing(other.points)[other.group("inside")] / SPACING
    assert distance.min() > 0.75
    assert distance.max() < 1.3


def test_nodes_are_denser_near_a_refined_region(body):
    centre = (0.05, 0.0, 0.0)
    refined = pt.fill(body, 0.012, refine=[(centre, 0.01, 0.006)])
    away = np.linalg.norm(refined.points - centre, axis=1)
    distance = nearest_spacing(refined.points)
    assert np.median(distance[away < 0.012]) < 0.65 * np.median(distance[away > 0.06])
    assert refined.volumes.sum() == pytest.approx(body.volume, rel=1e-12)


def test_a_cube_keeps_its_faces():
    body = cube()
    cloud = pt.fill(body, 0.014)
    on = cloud.points[cloud.group("surface")]
    assert np.abs(np.abs(on).max(axis=1) - 0.05).max() < 1e-9
    assert cloud.volumes.sum() == pytest.approx(1e-3, rel=1e-12)


@pytest.mark.parametrize(
    ("surface", "said"),
    [
        (lambda: inverted(ball()), "inside out"),
        (lambda: pt.Surface(ball().vertices, ball().triangles[1:]), "open"),
        (lambda: joined(ball(), ball(centre=(0.1001, 0, 0))), "2 separate bodies"),
        (lambda: joined(ball(), ball(0.03)), "parts inside another face outwards.*place = { part"),
        (lambda: joined(ball(), inverted(ball(0.0495))), "hollow"),
        (lambda: joined(ball(), inverted(ball(0.047))), "walls 3 mm thick on average.*; use at most 0.0012 m"),
        (lambda: joined(ball(), ball(centre=(0.02, 0.003, 0.001))), "pass through each other"),
    ],
)
def test_surfaces_that_cannot_be_filled_are_refused_with_the_reason(surface, said):
    with pytest.raises(pt.InputError, match=said):
        pt.fill(surface(), 0.01)


@pytest.mark.slow
def test_bodies_one_spacing_apart_do_not_share_stencils():
    cloud = pt.fill(joined(ball(), ball(centre=(0.11, 0, 0))), 0.01)
    number = np.zeros(len(cloud))
    number[cloud.group("body 1")] = 1
    body = pt.Solid(cloud, pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1000.0, poisson=0.45))
    near = body.stencils.neighbours
    assert np.array_equal(number[near], np.broadcast_to(number[:, None], near.shape))


@pytest.mark.parametrize(
    ("spacing", "more", "said"),
    [
        (0.05, {}, "too coarse"),
        (1e-4, {}, "at most"),
        (-1.0, {}, "spacing must be .*, got -1.0"),
        (0.01, {"lattice": "random"}, "lattice"),
        (0.01, {"units": "mm"}, "arrays are in metres"),
        (0.01, {"refine": [((0, 0), 0.01, 0.005)]}, r"refine\[0\]"),
        (0.01, {"refine": [((0, 0, 0), 0.01, 0.02)]}, r"refine\[0\] spacing"),
        (0.01, {"seed": -1}, "seed"),
    ],
)
def test_invalid_arguments_are_refused_by_name(body, spacing, more, said):
    with pytest.raises(pt.InputError, match=said):
        pt.fill(body, spacing, **more)


def test_a_body_in_another_becomes_a_cavity_with_a_warning():
    nested = joined(ball(), ball(0.03))
    with pytest.warns(UserWarning, match="became empty cavities: 1, of .* % of the volume.*region"):
        cloud = pt.fill(nested, 0.01, repair=True)
    assert cloud.volumes.sum() == pytest.approx(ball().volume - ball(0.03).volume, rel=1e-6)


OUTER, INNER = 0.05, 0.03  # radii of a hollow ball [m]


@pytest.fixture(scope="module")
def hollow():
    return pt.fill(joined(ball(OUTER), inverted(ball(INNER))), 0.007)


def test_a_cavity_stays_empty_and_nodes_lie_on_its_wall(hollow):
    radius = np.linalg.norm(hollow.points, axis=1)
    wall = hollow.points[hollow.face_nodes]
    away = np.linalg.norm(wall, axis=1)
    inner = away < 0.5 * (OUTER + INNER)
    assert radius.min() > 0.96 * INNER
    assert away[inner] == pytest.approx(INNER, rel=0.04)
    assert inner.sum() > 100
    # normals point out of the tissue: into the cavity, and outwards
    outwards = np.sum(hollow.face_normals * wall, axis=1) / away
    assert outwards[inner].max() < -0.98
    assert outwards[~inner].min() > 0.98


def test_volume_area_and_triangles_of_a_hollow_ball_are_those_of_its_surface(hollow):
    surface = joined(ball(OUTER), inverted(ball(INNER)))
    assert hollow.volumes.sum() == pytest.approx(surface.volume, rel=1e-12)
    assert surface.volume == pytest.approx(4 / 3 * np.pi * (OUTER**3 - INNER**3), rel=0.005)
    vectors = hollow.face_areas[:, None] * hollow.face_normals
    assert np.abs(vectors.sum(axis=0)).max() < 1e-12 * surface.area
    assert hollow.face_areas.sum() == pytest.approx(surface.area, rel=0.03)
    tensor = vectors.T @ hollow.points[hollow.face_nodes]
    assert tensor == pytest.approx(surface.volume * np.eye(3), abs=0.02 * surface.volume)
    mean = hollow.volumes @ np.sum(hollow.points**2, axis=1) / hollow.volumes.sum()
    assert mean == pytest.approx(0.6 * (OUTER**5 - INNER**5) / (OUTER**3 - INNER**3), rel=0.03)
    drawn = pt.Surface(hollow.points[hollow.group("surface")], hollow.triangles)
    assert pt.io.check_surface(drawn).errors == ()
    assert pt.io.check_surface(drawn).components == 2


def test_cavities_finer_than_the_spacing_are_filled_with_a_warning():
    surface = joined(ball(), inverted(ball(0.005, 0.001)))
    with pytest.warns(UserWarning, match="cavities finer than the spacing are filled with tissue: 1"):
        cloud = pt.fill(surface, SPACING)
    assert cloud.volumes.sum() == pytest.approx(ball().volume, rel=1e-12)


def test_bodies_far_apart_share_a_cloud_and_no_stencil():
    cloud = pt.fill(joined(ball(), ball(0.04, centre=(0.2, 0, 0))), 0.01)
    left = cloud.points[:, 0] < 0.1
    assert cloud.volumes[left].sum() == pytest.approx(ball().volume, rel=0.01)
    assert cloud.volumes[~left].sum() == pytest.approx(ball(0.04).volume, rel=0.01)
    x, y, z = cloud.points.T
    gradient = moving_least_squares(cloud.points, order=2, neighbours=42).gradient(np.where(left, x * y, z))
    exact = np.where(left, [y, x, 0 * x], [0 * x, 0 * x, 1 + 0 * x]).T
    assert gradient == pytest.approx(exact, abs=1e-10)


@pytest.mark.slow
def test_a_hollow_ball_is_softer_under_a_press(hollow):
    solid = pt.fill(ball(OUTER), 0.007)
    law = pt.materials.MooneyRivlin(C1=1e3, C2=0.0, density=1000.0, poisson=0.45)
    forces = []
    for cloud in (solid, hollow):
        z = cloud.points[:, 2]
        groups = {"floor": z < -0.8 * OUTER, "top": z > 0.8 * OUTER}
        for name, mask in groups.items():
            cloud = cloud.with_group(name, mask)
        push = pt.PrescribedMotion("top", lambda points, time: (0.0, 0.0, -0.002))
        settled = pt.equilibrium(pt.Solid(cloud, law, "floor"), [push], time=1.0)
        forces.append(-settled.reactions["top"][2])
        assert settled.reactions["floor"] == pytest.approx(-settled.reactions["top"], abs=1e-3 * forces[-1])
    assert 0.2 * forces[0] < forces[1] < 0.8 * forces[0]
