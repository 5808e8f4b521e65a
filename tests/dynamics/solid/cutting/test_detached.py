"""Pieces that a cut detaches are removed: the rest does not change, and tools and gravity pass by what is gone."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.realtime.bodies.cut_display import CutFullSurface
from palpate.realtime.bodies.full_surface import FullSurface

pytestmark = pytest.mark.slow

SPACING = 1e-3
SIZE = np.array([9, 8, 10]) * SPACING
TISSUE = pt.materials.MooneyRivlin(C1=500.0, C2=0.0, poisson=0.45, density=1000.0)
ACROSS = 5.3e-3  # height of a cut that divides the block


def layer(height, normal_tilt=0.0, start=-5e-3):
    """Triangles across the block at a height, from a place along x to far beyond."""
    ends = [(x, y, height + normal_tilt * x) for x in (start, 20e-3) for y in (-5e-3, 20e-3)]
    a, b, c, d = ends
    return [(a, b, c), (b, d, c)]


@pytest.fixture(scope="module", params=["lattice", "jittered"])
def block(request):
    cloud = pt.box(SIZE, SPACING, jitter=0.25 if request.param == "jittered" else 0.0, seed=1)
    return pt.Solid(cloud, TISSUE, "z-")


@pytest.fixture(scope="module")
def halves(block):
    """The block with both halves, with the supported one alone, and the nodes of the other."""
    upper = block.cloud.points[:, 2] > ACROSS
    return pt.cut(block, layer(ACROSS)), pt.cut(block, layer(ACROSS), detached="remove"), upper


def test_a_body_cut_through_keeps_the_supported_half(halves):
    complete, rest, upper = halves
    np.testing.assert_array_equal(rest.removed_nodes, np.flatnonzero(upper))
    assert not len(complete.removed_nodes)
    assert len(rest.volumes) == len(complete.volumes)


def test_forces_and_energy_of_the_rest_stay(halves):
    complete, rest, upper = halves
    u = 0.02 * SPACING * np.random.default_rng(0).normal(size=(len(upper), 3))
    before, after = complete.force(u), rest.force(u)
    np.testing.assert_allclose(after[~upper], before[~upper], rtol=0, atol=1e-13 * np.abs(before).max())
    assert not after[upper].any()
    density = complete.evaluate(u).energy_density
    assert rest.strain_energy(u) == pytest.approx(complete.volumes[~upper] @ density[~upper], rel=1e-12)


def test_the_rest_moves_as_it_does_next_to_a_piece_that_is_kept(halves):
    complete, rest, upper = halves
    velocity = np.where(upper[:, None], (0.0, 0.0, 0.3), (0.05, 0.0, -0.02))  # the piece flies away
    pushed, alone = (
        pt.rollout(body, duration=4e-3, every=1e-3, velocity=velocity, progress=False) for body in (complete, rest)
    )
    gone = alone.displacements[:, upper]
    assert not gone.any()
    scale = np.abs(alone.displacements).max()
    np.testing.assert_allclose(
        alone.displacements[:, ~upper], pushed.displacements[:, ~upper], rtol=0, atol=1e-3 * scale
    )
    moving = 0.5 * rest.masses[~upper] @ np.sum(alone.velocities[:, ~upper] ** 2, axis=2).T
    np.testing.assert_allclose(alone.kinetic, moving, rtol=1e-12)
    assert np.abs(alone.balance).max() <= 1e-3 * alone.kinetic[0]


def test_gravity_pulls_the_rest_only(halves):
    _, rest, upper = halves
    state = pt.equilibrium(rest, [pt.Gravity((0, 0, -9.81))])
    assert state.reactions["z-"][2] == pytest.approx(9.81 * rest.masses[~upper].sum(), rel=1e-5)
    assert not state.displacements[upper].any()


@pytest.mark.parametrize("piece", ["kept", "removed"])
def test_a_tool_touches_no_removed_piece(halves, piece):
    body = halves[0] if piece == "kept" else halves[1]
    motion = lambda t: (0.5 * SIZE[0], 0.5 * SIZE[1], SIZE[2] + 3.2e-3 - 0.2 * t)  # noqa: E731
    ball = pt.tools.Contact(pt.tools.Sphere(3e-3), motion)
    run = pt.rollout(body, [ball], duration=0.015, every=0.005, progress=False)
    pressed = run.reactions["tool"][-1, 2]
    assert pressed < 0 if piece == "kept" else pressed == 0
    deeper = pt.rollout(halves[1], [ball], duration=0.04, every=0.04, progress=False)
    assert deeper.reactions["tool"][-1, 2] < 0  # the rest


def test_a_blade_meets_the_rest_only(halves):
    rest, across = halves[1], (0.0, 0.0, 0.5 * np.pi)
    motion = lambda t: ((4.4e-3, 0.5 * SIZE[1], SIZE[2] + 0.6e-3 - 0.4 * t), across)  # noqa: E731
    knife = pt.tools.Contact(pt.tools.Blade([(-8e-3, 0, 0), (8e-3, 0, 0)], toughness=0.1), motion, name="knife")
    run = pt.rollout(rest, [knife], duration=0.019, every=0.001, progress=False)
    at = motion(0.0)[0][2] - 0.4 * run.times  # of the edge
    above = at > ACROSS + 0.1 * SPACING
    assert not run.cut_area[above].any()
    assert not run.reactions["knife"][above].any()
    assert run.cut_area[-1] > 0
    assert run.cuts[:, 3::3].min() < ACROSS


def test_a_released_sliver_goes(block):
    body = pt.cut(block, layer(SIZE[2] - 0.5 * SPACING), detached="remove")
    top = np.flatnonzero(block.cloud.points[:, 2] > SIZE[2] - 0.5 * SPACING)
    np.testing.assert_array_equal(body.removed_nodes, top)


def test_a_piece_that_hangs_on_stays(block):
    body = pt.cut(block, layer(ACROSS, start=2e-3), detached="remove")
    assert not len(body.removed_nodes)


def test_pieces_that_were_removed_stay_removed(halves, block):
    _, rest, upper = halves
    again = pt.cut(rest, layer(2.4e-3), detached="remove")
    np.testing.assert_array_equal(again.removed_nodes, np.flatnonzero(block.cloud.points[:, 2] > 2.4e-3))
    second = pt.cut(rest, layer(2.4e-3))
    np.testing.assert_array_equal(second.removed_nodes, np.flatnonzero(upper))
    assert len(rest.removed_nodes) == upper.sum()


def test_of_a_body_without_supports_the_largest_piece_stays():
    cloud = pt.box(SIZE, SPACING)
    body = pt.cut(pt.Solid(cloud, TISSUE), layer(3.3e-3), detached="remove")
    np.testing.assert_array_equal(body.removed_nodes, np.flatnonzero(cloud.points[:, 2] < 3.3e-3))


def test_removed_pieces_are_not_drawn(halves, block):
    rest = halves[1]
    surface = CutFullSurface(rest, FullSurface(block))
    drawn = surface.rest[np.unique(surface.triangles)]
    assert drawn[:, 2].max() <= ACROSS + 0.1 * SPACING
    assert np.abs(drawn[:, 2] - ACROSS).min() < 1e-6  # the face of the cut


def test_bad_arguments_are_refused(halves, block):
    with pytest.raises(pt.InputError, match="detached must be 'keep' or 'remove'"):
        pt.cut(block, layer(ACROSS), detached="delete")
    pull = pt.PrescribedMotion("z+", (0.0, 0.0, 1e-3))
    with pytest.raises(pt.InputError, match="must have no removed nodes"):
        pt.equilibrium(halves[1], [pull])
