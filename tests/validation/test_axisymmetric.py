"""The axisymmetric reference solutions against finite elements, closed forms, and their own energy."""

from __future__ import annotations

import numpy as np
import pytest
from axisymmetric import inflate, mooney_rivlin, neo_hookean, poke
from axisymmetric_elements import minimise
from axisymmetric_table import hencky, komaragiri, point_load_small_strain
from scipy.optimize import brentq

pytestmark = pytest.mark.slow

RADIUS, THICKNESS, C1 = 0.1, 1e-5, 0.17e6
YOUNG = 6 * C1  # of each of the laws below
LAWS = {"neo-hookean": neo_hookean(C1), "mooney-rivlin": mooney_rivlin(1.5 * C1, 0.5 * C1)}
CREASED = neo_hookean(C1, tension_field=True)


def assert_same(shape, elements, rel):
    """Force, height, mean deflection, energy and profile agree."""
    for name in ("force", "height", "mean_deflection", "energy"):
        assert elements[name] == pytest.approx(getattr(shape, name), rel=rel), name
    np.testing.assert_allclose(elements["z"], shape.deflection(elements["mounted"]), atol=rel * shape.height)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize(("tool_radius", "prestretch"), [(0.001, 1.0), (0.02, 1.0), (0.01, 1.1)])
def test_a_poked_sheet_minimises_the_energy(law, tool_radius, prestretch):
    shape = poke(RADIUS, THICKNESS, LAWS[law], 0.01, tool_radius, prestretch)
    minimum = minimise(RADIUS, THICKNESS, LAWS[law], 100, 0.01, tool_radius, prestretch=prestretch)
    assert_same(shape, minimum, rel=1e-6)


@pytest.mark.parametrize("law", LAWS)
def test_an_inflated_sheet_minimises_the_energy(law):
    shape = inflate(RADIUS, THICKNESS, LAWS[law], 10.0)
    assert_same(shape, minimise(RADIUS, THICKNESS, LAWS[law], 100, pressure=10.0), rel=1e-6)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("tool_radius", [1e-4, 1e-2])
def test_a_slightly_poked_sheet_is_linearly_elastic(law, tool_radius):
    """The depth of the closed form is met but for strains, that is, slopes squared."""

    def gap(slope):
        force = poke(RADIUS, THICKNESS, LAWS[law], slope * RADIUS, tool_radius).force
        return point_load_small_strain(RADIUS, THICKNESS, YOUNG, force, tool_radius) / (slope * RADIUS) - 1

    assert abs(gap(1e-3)) < 2e-6
    assert gap(1e-2) / gap(1e-3) == pytest.approx(100, rel=0.02)


@pytest.mark.parametrize("law", LAWS)
def test_a_slightly_inflated_sheet_rises_by_henckys_formula(law):
    """Height goes as pressure^(1/3), strains as its square."""

    def gap(pressure):
        expected = hencky(0.5) * RADIUS * (pressure * RADIUS / (YOUNG * THICKNESS)) ** (1 / 3)
        return inflate(RADIUS, THICKNESS, LAWS[law], pressure).height / expected - 1

    assert abs(gap(1e-4)) < 5e-5
    assert gap(1e-2) / gap(1e-4) == pytest.approx(100 ** (2 / 3), rel=0.02)


def test_the_force_of_a_point_load_is_that_of_the_literature():
    assert point_load_small_strain(1.0, 1.0, 1.0, 1.0) == pytest.approx(komaragiri(0.5), rel=2e-3)


@pytest.mark.parametrize(
    ("law", "depth", "prestretch"),
    [*((law, 0.01, prestretch) for law in LAWS.values() for prestretch in (1.0, 1.1)), (CREASED, 0.03, 0.95)],
)
def test_the_force_of_the_tool_is_the_derivative_of_the_energy(law, depth, prestretch):
    """The slope of the energy over depth, by central differences of fourth order, is the force."""

    def energy(change):
        return poke(RADIUS, THICKNESS, law, depth + change, 0.02, prestretch).energy

    h = 1e-2 * depth
    slope = (8 * (energy(h) - energy(-h)) - energy(2 * h) + energy(-2 * h)) / (12 * h)
    assert slope == pytest.approx(poke(RADIUS, THICKNESS, law, depth, 0.02, prestretch).force, rel=1e-6)


def cords(depth, tool_radius, prestretch):
    """Force [N] on a sheet wrinkled all over: radial cords in simple tension, straight from the tool to the rim.

    Then T1 = 2 C1 (l - l^-2) = K / S, and the length is that of int l dS = [l S] - K / (6 C1) [log(l^3 - 1)].
    """
    S, length = np.array([tool_radius, RADIUS]) / prestretch, np.hypot(RADIUS - tool_radius, depth)

    def excess(K):
        l1 = np.array([brentq(lambda x, T: x - x**-2 - T, 1, 100, args=(T,)) for T in K / (2 * C1 * S)])
        return np.diff(l1 * S - K / (6 * C1) * np.log(l1**3 - 1))[0] - length

    K = brentq(excess, 1e-3 * C1 * RADIUS, 10 * C1 * RADIUS)
    return 2 * np.pi * THICKNESS * K * depth / length


def test_a_sheet_wrinkled_everywhere_has_the_force_of_radial_cords():
    shape = poke(RADIUS, THICKNESS, CREASED, 0.03, 0.02, prestretch=0.95)
    assert np.all(shape.l2 * np.sqrt(shape.l1) < 1)
    assert shape.force == pytest.approx(cords(0.03, 0.02, 0.95), rel=1e-8)
    np.testing.assert_allclose(shape.z, 0.03 * (RADIUS - shape.r) / 0.08, atol=1e-10)


def test_a_sheet_wrinkled_at_its_rim_minimises_the_energy():
    shape = poke(RADIUS, THICKNESS, CREASED, 0.03, 0.02, prestretch=0.98)
    wrinkled = shape.l2 * np.sqrt(shape.l1) < 1 - 1e-6
    assert wrinkled[-1]
    assert not wrinkled[0]
    assert shape.least_hoop_stress == 0
    assert_same(shape, minimise(RADIUS, THICKNESS, CREASED, 100, 0.03, 0.02, prestretch=0.98), rel=1e-6)
    stiff = poke(RADIUS, THICKNESS, neo_hookean(C1), 0.03, 0.02, prestretch=0.98)
    assert stiff.least_hoop_stress < 0
    assert shape.energy < stiff.energy
