"""Tools against the surface between nodes: its depth in a tool, and what small balls do."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.dynamics.contact.geometry import rotation
from palpate.dynamics.contact.penetration import deepest_triangle

SPACING = 0.005
SIZE = np.array([0.05, 0.05, 0.025])
TISSUE = pt.materials.MooneyRivlin(C1=2e3, C2=0.0, density=1060.0, poisson=0.45)
TOP = np.array([0.0262, 0.0241, 0.025])  # between nodes
UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def block():
    return pt.Solid(pt.box(SIZE, SPACING), TISSUE, fixed="z-", mass_damping=150.0)


def contacts_of(body, tool, place):
    return body.prepare([pt.tools.Contact(tool, tuple(place))]).contacts


@pytest.mark.parametrize("tool", [pt.tools.Sphere(0.006), pt.tools.Capsule(0.006, 0.01), pt.tools.Punch(0.006)])
def test_the_depth_of_a_flat_surface_in_a_tool_is_found(block, tool):
    low = tool.sizes[0] if tool.kind != pt.tools.Punch(0.006).kind else 0.0
    if isinstance(tool, pt.tools.Capsule):
        low = tool.sizes[0] + tool.sizes[1]
    place, frame = TOP + (low - 0.002) * UP, np.zeros((3, 4))
    rotation(np.array([*place, 1.0, 0.0, 0.0, 0.0]), frame)
    contacts = contacts_of(block, tool, TOP + 0.1 * UP)
    still = np.zeros((len(block.cloud), 3))
    depth, triangle = deepest_triangle(contacts, 0, frame, block.cloud.triangles, still, 1e-6)
    assert depth == pytest.approx(0.002, abs=0.08 * SPACING)
    assert np.linalg.norm(block.cloud.points[block.cloud.triangles[triangle]].mean(axis=0) - TOP) < SPACING
    assert deepest_triangle(contacts, 0, frame, block.cloud.triangles, still, 0.0021)[1] == -1


def test_edge_midpoints_are_the_means_of_their_ends(block):
    contacts, n = contacts_of(block, pt.tools.Sphere(0.006), TOP + 0.1 * UP), len(block.cloud)
    ends = contacts.patches.ends[n:]
    np.testing.assert_allclose(contacts.patches.points[n:], block.cloud.points[ends].mean(axis=1))
    weights = np.add.reduceat(contacts.patches.weights, contacts.patches.start[:-1])
    np.testing.assert_allclose(weights, 1.0, atol=1e-12)
    assert len(ends) == len(block.cloud.triangles) * 3 // 2  # of a closed surface


@pytest.mark.slow
@pytest.mark.parametrize("ratio", [1.1, 1.5])
def test_the_force_of_a_small_ball_grows_to_a_depth_of_its_radius(block, ratio):
    """Its force was 0.19 N where finite elements have 1.37 N, when nodes alone were kept out of tools."""
    radius = ratio * SPACING
    path = lambda t: tuple(TOP + radius * (1.02 - 1.02 * min(t / 0.4, 1.0)) * UP)  # noqa: E731
    run = pt.rollout(block, [pt.tools.Contact(pt.tools.Sphere(radius), path)], duration=0.4, every=0.04, progress=False)
    force = -run.reactions["tool"][1:, 2]
    assert np.all(np.diff(force) > 0)
    # at least Hertz's force on a half space, which a layer on a rigid bed exceeds
    depth = 0.9 * radius
    hertz = 8 / 3 * TISSUE.shear_modulus / (1 - 0.45) * np.sqrt(radius) * depth**1.5
    assert force[-1] > 0.8 * hertz


def test_a_fast_ball_is_held_or_refused(block):
    for speed in (1.0, 5.0):
        path = lambda t, v=speed: tuple(TOP + (0.0076 - v * t) * UP)  # noqa: E731
        ball = pt.tools.Contact(pt.tools.Sphere(0.0075), path)
        try:
            run = pt.rollout(block, [ball], duration=0.01 / speed, every=0.001 / speed, progress=False)
        except pt.DivergenceError:
            continue
        assert np.all(run.reactions["tool"][3:, 2] < 0)
