"""Plots hold the arrays of their objects, and name the extra where a plotting package is missing."""

from __future__ import annotations

import sys
from dataclasses import replace
from xml.etree import ElementTree

import matplotlib.pyplot as plt
import numpy as np
import pytest

import palpate as pt
from palpate.core.plotting import MAX_SHAPES, body_svg, curve_svg

NAMES = "{http://www.w3.org/2000/svg}"


@pytest.fixture(autouse=True)
def _close():
    yield
    plt.close("all")


def test_a_trajectory_plots_forces_energies_and_displacements(run):
    axes = run.plot("force")
    times, sizes = axes.get_lines()[0].get_data()
    np.testing.assert_array_equal(times, run.times)
    np.testing.assert_allclose(sizes, np.linalg.norm(run.reactions["x-"], axis=1))
    assert axes.get_ylabel() == "force [N]"
    energies = {line.get_label(): line.get_ydata() for line in run.plot("energy").get_lines()}
    assert set(energies) == {"kinetic", "strain", "external", "dissipated"}
    np.testing.assert_array_equal(energies["strain"], run.strain)
    largest, mean = (line.get_ydata() for line in run.plot("displacement").get_lines())
    size = np.linalg.norm(run.displacements, axis=2)
    np.testing.assert_allclose(largest, size.max(axis=1))
    np.testing.assert_allclose(mean, size.mean(axis=1))


def test_plots_are_drawn_into_given_axes(run):
    axes = plt.figure().subplots()
    assert run.plot("force", axes) is axes


def test_an_unknown_quantity_is_refused_with_those_that_are_known(run):
    with pytest.raises(pt.InputError, match="what must be 'displacement', 'force', 'energy' or 'trust', got 'stress'"):
        run.plot("stress")


def test_a_basis_plots_its_singular_values(run, held):
    basis = pt.pod(run, held.weights, modes=3)
    modes, others = (line.get_xydata() for line in basis.plot().get_lines())
    relative = basis.singular_values / basis.singular_values[0]
    np.testing.assert_allclose(modes[:, 1], relative[:3])
    np.testing.assert_allclose(others[:, 1], relative[3:])


def test_a_fit_plots_its_points_and_the_stress_of_its_law():
    stretches = np.linspace(1.0, 1.5, 6)
    stress = 2e3 * (stretches - stretches**-2)  # of a neo-Hookean bar that keeps its volume, 2 C1 = 2 kPa
    curve = pt.materials.Measurement(kind="uniaxial", deformation=stretches, stress=stress, name="bar")
    found = pt.materials.fit(pt.materials.NeoHookean, curve)
    points, law = (line.get_xydata() for line in found.plot().get_lines())
    np.testing.assert_array_equal(points, np.column_stack([stretches, stress]))
    np.testing.assert_allclose(law[:, 1], 2e3 * (law[:, 0] - law[:, 0] ** -2), atol=1e-6)
    with pytest.raises(pt.InputError, match="curve must be"):
        found.plot(1)


def test_a_cloud_plots_its_surface(bar):
    axes = bar.plot()
    assert axes.name == "3d"
    assert len(axes.collections[0].get_facecolor()) > 0
    np.testing.assert_allclose(axes.get_zlim3d(), (0, 0.015), atol=2e-3)
    plane = pt.disc(0.1, 0.02).plot()
    assert plane.name == "3d"


@pytest.fixture(scope="module")
def hung(bar, tissue):
    """The bar in equilibrium under its weight, 100 times as large."""
    return pt.equilibrium(pt.Solid(bar, tissue, fixed="x-"), pt.Gravity((0, 0, -981)))


def test_a_body_is_drawn_where_it_is_with_the_colours_of_a_quantity(hung):
    axes = hung.plot("stress")
    z = (hung.model.cloud.points + hung.displacements)[:, 2]
    np.testing.assert_allclose(axes.get_zlim3d(), (z.min(), z.max()), atol=2e-3)
    assert z.min() < -5e-3
    stress = hung.model.cauchy_stress(hung.displacements)
    shear = stress - np.trace(stress, axis1=1, axis2=2)[:, None, None] / 3 * np.eye(3)
    largest = np.sqrt(1.5 * (shear**2).sum(axis=(1, 2))).max()
    colour_bar = axes.figure.axes[1]
    assert colour_bar.get_ylabel() == "von Mises stress [kPa]"
    assert colour_bar.get_ylim() == pytest.approx((0.0, 1e-3 * largest))
    assert len(np.unique(axes.collections[0].get_facecolor(), axis=0)) > 20
    assert [axes.get_xlabel(), axes.get_zlabel()] == ["x [m]", "z [m]"]


def test_pressure_has_colours_on_both_sides_of_zero(hung):
    low, high = hung.plot("pressure").figure.axes[1].get_ylim()
    assert low == -high < 0
    assert hung.plot().figure.axes[1].get_ylabel() == "displacement [mm]"


def test_a_body_at_rest_and_an_unknown_quantity(hung):
    assert len(hung.model.plot().figure.axes) == 1
    with pytest.raises(pt.InputError, match="what must be 'displacement' or 'stress' or 'pressure', got 'strain'"):
        hung.plot("strain")
    with pytest.raises(pt.InputError, match=r"displacements must have shape \(112, 3\), got \(5, 3\)"):
        hung.model.plot("stress", displacements=np.zeros((5, 3)))


def test_a_cloud_without_triangles_plots_its_nodes(bar):
    bare = replace(bar, triangles=np.zeros((0, 3), dtype=np.int64))
    assert len(bare.plot().collections[0].get_offsets()) == len(bar)
    assert len(list(ElementTree.fromstring(bare._picture()).iter(f"{NAMES}circle"))) == len(bar)


def test_a_missing_package_is_named_with_the_extra_that_holds_it(monkeypatch, run, held, bar):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.setitem(sys.modules, "matplotlib.pyplot", None)
    for plot in (run.plot, pt.pod(run, held.weights, modes=2).plot, bar.plot):
        with pytest.raises(pt.InputError, match=r"plot requires matplotlib, .*; pip install 'palpate\[plot\]'"):
            plot()


def test_a_picture_of_a_box_shows_the_three_faces_in_front(bar):
    polygons = list(ElementTree.fromstring(bar._picture()).iter(f"{NAMES}polygon"))
    cells = 6 * 3 + 6 * 3 + 3 * 3
    assert len(polygons) == 2 * cells


def test_pictures_are_small():
    points = np.random.default_rng(0).uniform(size=(20_000, 3))
    triangles = np.arange(19_998).reshape(-1, 3)
    drawn = body_svg(points, triangles)
    assert len(list(ElementTree.fromstring(drawn))) <= MAX_SHAPES
    curve = curve_svg(np.arange(1e5), np.arange(1e5) ** 2, "time [s]", "a < b")
    assert len(curve) < 10_000
    assert "a &lt; b: 0 to 1e+10" in curve


@pytest.mark.parametrize("values", [[], [1.0], [1.0, np.nan]])
def test_a_curve_without_finite_values_has_no_picture(values):
    assert curve_svg(np.arange(float(len(values))), np.array(values), "x", "y") == ""


def test_a_run_without_frames_prints_and_has_no_picture(run):
    nothing = {name: getattr(run, name)[:0] for name in ("times", "displacements", "velocities", "kinetic", "strain")}
    nothing |= {name: getattr(run, name)[:0] for name in ("external", "dissipated", "steps")}
    empty = replace(run, **nothing, reactions={"x-": np.zeros((0, 3))}, complete=False)
    assert "0 frames" in repr(empty)
    assert "stopped before its end" in repr(empty)
    assert "<svg" not in empty._repr_html_()
