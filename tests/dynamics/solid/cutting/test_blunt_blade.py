"""A blunt blade: the front ahead of it starts and stops at the toughness, its energies, and bad input.

The sides of a strip move apart. Its front then releases the energy per area of the strip far ahead (Rivlin and Thomas,
J. Polym. Sci. 10, 1953).
"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import palpate as pt
from palpate.dynamics.run.model import State
from palpate.dynamics.solid.cutting.blunt import energy_release

SPACING, STRETCH = 2.5e-3, 0.3
SIZE = (50e-3, 22.5e-3, 7.5e-3)
MIDDLE, END = 0.5 * SIZE[1] + 0.15 * SPACING, 17.5e-3  # between nodes, and the end of the cut [m]
# the edge along z of the strip, cutting towards x
ACROSS = Rotation.from_matrix([[0, 0, -1], [0, 1, 0], [1, 0, 0]]).as_rotvec()
EDGE = [(-7e-3, 0, 0), (7e-3, 0, 0)]


def notch(body, end, middle=MIDDLE):
    a, b, c, d = (-6e-3, middle, -6e-3), (end, middle, -6e-3), (end, middle, 12e-3), (-6e-3, middle, 12e-3)
    return pt.cut(body, [(a, b, c), (a, c, d)])


def strip():
    tissue = pt.materials.MooneyRivlin(C1=1e3, C2=0, density=1000.0, poisson=0.45)
    return pt.Solid(pt.box(SIZE, SPACING, jitter=0.2, seed=4), tissue, fixed="y-", mass_damping=20.0)


def sides_apart(stretch):
    return pt.PrescribedMotion("y+", (0.0, stretch * SIZE[1], 0.0))


def at_rest(toughness, place=(-10e-3, MIDDLE, 3.75e-3)):
    return pt.tools.Contact(pt.tools.Blade(EDGE, toughness, sharp=False), (place, ACROSS), name="wedge")


@pytest.fixture(scope="module")
def stretched():
    body = strip()
    u = pt.equilibrium(body, [sides_apart(STRETCH)]).displacements
    energies = body.evaluate(u).energy_density * body.volumes
    column = np.rint(body.cloud.points[:, 0] / SPACING).astype(int)
    release = float(np.bincount(column, energies)[8:13].mean() / (SPACING * SIZE[2]))
    opened = notch(body, END)
    return opened, pt.equilibrium(opened, [sides_apart(STRETCH)], displacement=u).displacements, release


def test_the_energy_release_of_a_strip_is_its_energy_per_area(stretched):
    body, u, release = stretched
    front, ahead = np.array([(END, MIDDLE, z) for z in (-3e-3, 3.75e-3, 10.5e-3)]), np.tile([1.0, 0.0, 0.0], (3, 1))
    state = State(u, np.zeros_like(u))
    assert energy_release(body, state, front, ahead) == pytest.approx(release, rel=0.05)
    assert energy_release(body, state, front + 0.1 * ahead, ahead) == 0.0


def test_a_front_does_not_start_below_the_toughness(stretched):
    body, u, release = stretched
    loads = [sides_apart(STRETCH), at_rest(release / 0.94)]
    run = pt.rollout(body, loads, duration=0.05, every=0.01, displacement=u)
    assert not run.cut_area.any()
    assert len(run.cuts) == len(body.cut_surface.triangles)


def test_a_front_starts_above_the_toughness_and_stops_below(stretched):
    body, u, release = stretched
    toughness = release / 1.08

    def sides(points, time):  # the energy release falls to 0.9 of the toughness after 0.08 s
        stretch = STRETCH * np.interp(time, [0.0, 0.08, 0.12], [1.0, 1.0, np.sqrt(0.9 / 1.08)])
        return np.tile([0.0, stretch * SIZE[1], 0.0], (len(points), 1))

    loads = [pt.PrescribedMotion("y+", sides), at_rest(toughness)]
    run = pt.rollout(body, loads, duration=0.2, every=0.01, displacement=u)
    way = run.cut_area / SIZE[2]
    assert way[8] > 1.5 * SPACING
    assert way[-1] == way[12]
    assert way[-1] < 20e-3
    assert np.all(np.diff(way) >= 0)
    assert not run.edge_work.any()
    assert run.released_energy[-1] == pytest.approx(toughness * run.cut_area[-1], rel=0.15)
    assert np.abs(run.balance).max() <= 5e-3 * run.strain[0]


@pytest.mark.slow
def test_a_front_runs_ahead_of_a_wedge_whose_work_is_the_toughness_times_the_area():
    tissue = pt.materials.MooneyRivlin(C1=8e3, C2=0, density=1000.0, poisson=0.45)
    size, middle = (44e-3, 22e-3, 6e-3), 11.3e-3
    sheet = pt.Solid(pt.box(size, 2e-3, jitter=0.2), tissue, fixed="x+", mass_damping=10.0)
    blade = pt.tools.Blade(EDGE, toughness=1.0, wedge=16e-3, height=30e-3, sharp=False)
    wedge = pt.tools.Contact(blade, lambda t: ((-3e-3 + 0.1 * t, middle, 3e-3), ACROSS), name="wedge")
    run = pt.rollout(notch(sheet, 12e-3, middle), [wedge], duration=0.2, every=0.01)
    edge = -3e-3 + 0.1 * run.times
    assert not run.cut_area[edge < 8e-3].any()
    front = 12e-3 + run.cut_area[-1] / size[2]
    assert edge[-1] + 1e-3 < front < edge[-1] + 6e-3
    spent = run.external[-1] - run.strain[-1] - run.kinetic[-1]
    assert spent == pytest.approx(1.0 * run.cut_area[-1], rel=0.1)
    assert np.abs(run.balance).max() <= 1e-2 * run.external[-1]


@pytest.mark.slow
def test_a_run_ends_with_its_frames_where_the_edge_reaches_the_front():
    blade = pt.tools.Blade(EDGE, toughness=100.0, sharp=False)
    push = pt.tools.Contact(blade, lambda t: ((-3e-3 + 0.5 * t, MIDDLE, 3.75e-3), ACROSS), name="wedge")
    with pytest.raises(pt.DivergenceError, match="stay behind the front") as error:
        pt.rollout(notch(strip(), END), [push], duration=0.06, every=0.01)
    assert len(error.value.trajectory.times) == 5  # it is there after 41 ms


def test_a_body_without_a_cut_ahead_is_refused():
    with pytest.raises(pt.InputError, match="must have a cut ahead"):
        pt.rollout(strip(), [at_rest(1.0)], duration=0.01, every=0.01)


def test_a_blunt_blade_that_begins_inside_is_refused():
    with pytest.raises(pt.InputError, match="must start outside the body"):
        pt.rollout(notch(strip(), END), [at_rest(1.0, (30e-3, MIDDLE, 3.75e-3))], duration=0.01, every=0.01)


def test_other_values_of_sharp_are_refused():
    with pytest.raises(pt.InputError, match="sharp of a Blade must be True or False"):
        pt.tools.Blade(EDGE, 1.0, sharp=0.5)
