"""Points at which the faces of a cut touch: those kept from the cut before are those of the same cut at once."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.dynamics.contact.geometry import rotation
from palpate.dynamics.run.model import State
from palpate.dynamics.solid.cutting.blade_cut import advance_blade
from palpate.meshfree.cut.face_points import face_points, no_face_points
from palpate.meshfree.cut.surface import changed_spheres, swept

pytestmark = pytest.mark.slow

SPACING = 4e-3
SIZE = (0.03, 0.03, 0.02)
NOTHING_HELD = np.zeros(0, dtype=np.int64)


def block(spacing=SPACING):
    tissue = pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1060.0, poisson=0.45)
    return pt.Solid(pt.box(SIZE, spacing, jitter=0.2), tissue, fixed="z-")


def at_once(body):
    """The points of a body's cut without those of an earlier one."""
    state, corners = body.cut_state, body.cloud.points[body.cloud.triangles]
    return face_points(state.uncut, state.surface, corners, no_face_points(), np.zeros((0, 4)))


def assert_equal(faces, expected):
    for name in ("points", "normals"):
        np.testing.assert_array_equal(getattr(faces, name), getattr(expected, name))
    for side in ("above", "below") if len(expected.points) else ():
        for array, other in zip(getattr(faces, side), getattr(expected, side), strict=True):
            np.testing.assert_array_equal(array, other)


def sheet(start, end, low, high, along_x=True):
    """Rectangle of squares between heights, from one place to another along x or y."""
    across = 0.5 * SIZE[0] + 3e-4
    steps, rows = (max(2, int(abs(b - a) / SPACING)) for a, b in ((start, end), (low, high)))
    places = [[(x, across, z) for x in np.linspace(start, end, steps)] for z in np.linspace(low, high, rows)]
    return swept(np.array(places)[..., [0, 1, 2] if along_x else [1, 0, 2]])


def test_cuts_that_join_and_cross_leave_the_points_of_their_union():
    """The second cut is below the first, with tissue between them, the third joins both, and the last crosses them."""
    body, low, high = block(), 0.6 * SIZE[2], 1.5 * SIZE[2]
    for triangles in (
        sheet(-0.01, 0.012, low, high),
        sheet(-0.01, 0.012, -0.01, 0.35 * SIZE[2]),
        sheet(-0.01, 0.012, 0.35 * SIZE[2], low),
        sheet(-0.01, 0.04, low + SPACING, high, along_x=False),
    ):
        body = pt.cut(body, triangles)
        assert_equal(body.cut_state.faces, at_once(body))


def follow(body, places, turns):
    """Cut a body with a blade in successive places (k, 3) and turns about z (k,); yield every body."""
    blade = pt.tools.Blade([(-0.009, 0, 0), (0.009, 0, 0)], toughness=5.0)
    tool = pt.tools.Contact(blade, (tuple(places[0]), (0.0, 0.0, 0.0)), name="blade")
    u = np.zeros((len(body.cloud), 3))
    u[:, 0] = 0.02 * body.cloud.points[:, 2]
    state, frame = State(u, np.zeros_like(u)), np.eye(3, 4)
    for place, turn in zip(places, turns, strict=True):
        rotation(np.array([*place, np.cos(0.5 * turn), 0.0, 0.0, np.sin(0.5 * turn)]), frame)
        body, cut_front, _, _ = advance_blade(body, state, tool, frame.copy(), NOTHING_HELD)
        state = State(u, np.zeros_like(u), cut_front=cut_front)
        yield body


def test_a_blade_that_turns_withdraws_and_crosses_its_cut_leaves_the_points_of_the_whole_cut():
    ways = ((0.024, 0.008), (0.008, 0.024), (0.024, 0.010))  # in, out, and in again
    heights = np.concatenate([np.arange(a, b, np.sign(b - a) * 0.4 * SPACING) for a, b in ways])
    turns = np.interp(np.arange(len(heights)), [0, 9, 18, 21], [0.0, 0.4, 0.4, 1.9])
    places = np.column_stack([np.full(len(heights), 0.0152), np.full(len(heights), 0.0149), heights])
    count = 0
    for k, body in enumerate(follow(block(), places, turns)):
        if k % 4 == 0 or k == len(heights) - 1:
            faces = body.cut_state.faces
            assert_equal(faces, at_once(body))
            count = len(faces.points)
    assert count > 20


def test_an_advance_leaves_most_points_of_a_long_cut():
    """The weights that are kept are the same arrays: those of a marked cut come back with the mark."""
    body = pt.cut(block(2.5e-3), sheet(-0.01, 0.02, 0.25 * SIZE[2], 1.5 * SIZE[2]))
    state, corners = body.cut_state, body.cloud.points[body.cloud.triangles]
    after = pt.cut(body, sheet(0.02, 0.0206, 0.25 * SIZE[2], 1.5 * SIZE[2])).cut_state
    marked = state.faces._replace(above=state.faces.above._replace(values=np.full_like(state.faces.above.values, 7.0)))
    changed = changed_spheres(state.surface, after.surface)
    faces = face_points(state.uncut, after.surface, corners, marked, changed)
    is_kept = np.all(faces.above.values == 7.0, axis=1)
    assert 0.3 < is_kept.mean() < 1.0
    assert faces.points[is_kept, 0].max() < 0.02 - 2.5e-3
    np.testing.assert_array_equal(faces.above.values[~is_kept], after.faces.above.values[~is_kept])
