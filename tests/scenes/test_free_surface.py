"""The free surface of a body: areas, normals, what supports hold, and what tools cover."""

from __future__ import annotations

import numpy as np
import pytest
from tool_bodies import Body, ball, filled

import palpate as pt
from palpate.scenes.free_surface import FreeSurface


def press(place, radius, depth, slide=(0.0, 0.0, 0.0)):
    """A ball that presses down at a place and slides."""
    place, slide, up = np.array(place), np.array(slide), np.array([0.0, 0.0, 1.0])

    def motion(time):
        return place + time * slide + (radius + 0.002 - (0.002 + depth) * np.sin(np.pi * time)) * up

    return pt.tools.Contact(pt.tools.Sphere(radius), motion)


def test_areas_and_normals_of_a_ball():
    surface = FreeSurface(Body(filled(lambda x, y, z: ball(x, y, z, 0.03), (0.03,) * 3, 0.004)))
    assert surface.areas.sum() == pytest.approx(4 * np.pi * 0.03**2, rel=0.02)
    radial = surface.points / np.linalg.norm(surface.points, axis=1)[:, None]
    assert np.einsum("sa,sa->s", surface.normals, radial).min() > 0.98
    assert np.einsum("sa,sa->s", surface.smoothed_normals(0.01), radial).min() > 0.998


def test_smoothed_normals_do_not_mix_the_sides_of_a_plate():
    surface = FreeSurface(Body(pt.box((0.1, 0.1, 0.012), 0.004)))
    flat = (np.abs(surface.points[:, :2] - 0.05) < 0.025).all(axis=1)
    normals = surface.smoothed_normals(0.02)[flat]
    np.testing.assert_allclose(normals, np.sign(surface.points[flat, 2:] - 0.006) * [0.0, 0.0, 1.0], atol=1e-12)


def test_a_press_covers_a_disc_of_its_radius_on_its_side_only():
    surface = FreeSurface(Body(pt.box((0.1, 0.1, 0.02), 0.0025), ("x-",)))
    mask = surface.covered((press((0.05, 0.05, 0.02), 0.02, 0.005),), 1.0)
    assert (surface.points[mask, 2] == 0.02).all()
    assert surface.areas[mask].sum() == pytest.approx(np.pi * 0.02**2, rel=0.05)
    total = surface.areas[~surface.held].sum()
    assert surface.share(mask) == pytest.approx(surface.areas[mask].sum() / total)
    slid = surface.covered((press((0.05, 0.05, 0.02), 0.02, 0.005, (0.02, 0.0, 0.0)),), 1.0)
    assert surface.areas[slid].sum() > 1.3 * surface.areas[mask].sum()
    corner = surface.covered((press((0.01, 0.05, 0.02), 0.02, 0.005),), 1.0)
    assert not (corner & surface.held).any()


def test_what_does_not_touch_covers_nothing():
    surface = FreeSurface(Body(pt.box((0.1, 0.1, 0.02), 0.005)))
    above = press((0.05, 0.05, 0.03), 0.02, 0.005)
    push = pt.PrescribedMotion("x+", lambda points, time: np.zeros_like(points))
    assert not surface.covered((above, push, pt.Gravity((0.0, 0.0, -9.81))), 1.0).any()


def test_forceps_cover_what_they_hold():
    surface = FreeSurface(Body(pt.box((0.1, 0.1, 0.02), 0.005)))
    grasp = pt.tools.Grasp((0.05, 0.05, 0.02), 0.011, (0.05, 0.05, 0.02))
    held = grasp.with_group(surface.cloud).group("grasp")
    np.testing.assert_array_equal(surface.nodes[surface.covered((grasp,), 1.0)], held)
