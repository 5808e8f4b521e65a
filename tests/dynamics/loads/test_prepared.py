"""Loads that cannot be, and what is said about them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

import palpate as pt

MOVE = pt.PrescribedMotion("tip", (0, 0, 1e-4))


@pytest.mark.parametrize(
    ("load", "message"),
    [
        (lambda: pt.SurfaceForce("top", force=(1, 0, 0)), "group must be one of .*, got 'top'"),
        (lambda: pt.PrescribedMotion("top", (0, 0, 0)), "group must be one of .*, got 'top'"),
        (lambda: pt.SurfaceForce("x-", force=(1, 0, 0)), "got 'x-', which is all fixed or prescribed"),
        (lambda: pt.PrescribedMotion("x-", (0, 0, 0)), "got 'x-', whose nodes 0, 1, .* already fixed or prescribed"),
        (lambda: pt.PrescribedMotion("y-", (0, 0, 0)), "got 'y-'.*already fixed or prescribed"),
        (lambda: pt.SurfaceForce("x+"), "'x+' must have a force .* or a moment .*, got neither; .* Pressure"),
        (lambda: pt.Pressure("top", 1.0), "group must be one of .*, got 'top'"),
        (lambda: pt.Pressure("x-", 1.0), "group of Pressure must have free nodes, got 'x-'"),
        (lambda: pt.SurfaceForce("x+", moment=(1, 0)), "moment of SurfaceForce on 'x+' must be "),
        (lambda: pt.SurfaceForce("x+", moment=2.0), "moment of SurfaceForce on 'x+' must be "),
        (
            lambda: pt.SurfaceForce("x+", force=(1, 0, 0), moment=lambda t: (np.inf, 0, 0)),
            r"moment of SurfaceForce on 'x\+' must be finite, got .* at t = 0",
        ),
        (lambda: pt.SurfaceForce("x+", force=(1, 0)), "force of SurfaceForce on 'x+' must be "),
        (lambda: pt.SurfaceForce("x+", force="strong"), "force of SurfaceForce on 'x+' must be "),
        (lambda: pt.SurfaceForce("x+", force=lambda t: (1, 0)), "force of SurfaceForce on 'x+' must be "),
        (
            lambda: pt.SurfaceForce("x+", force=lambda t: (np.nan, 0, 0)),
            r"force of SurfaceForce on 'x\+' must be finite, got .* at t = 0",
        ),
        (
            lambda: pt.SurfaceForce("x+", force=lambda t: (1 / (t < 1e-4) if t < 1e-4 else np.inf, 0, 0)),
            "must be finite, got .* at t = ",
        ),
        (lambda: pt.Pressure("x+", lambda t: np.inf), r"pressure of Pressure on 'x\+' must be finite"),
        (lambda: pt.Pressure("x+", np.nan), r"pressure of Pressure on 'x\+' must be finite"),
        (lambda: pt.Pressure("x+", "high"), r"pressure of Pressure on 'x\+' must be a number, got 'high'"),
        (lambda: pt.Pressure("x+", None), r"pressure of Pressure on 'x\+' must be a number, got None"),
        (lambda: pt.Gravity((0, 0)), "acceleration of Gravity must be "),
        (lambda: pt.Gravity((0, 0, np.inf)), "acceleration of Gravity must be finite"),
        (lambda: pt.PrescribedMotion("tip", (np.nan, 0, 0)), "PrescribedMotion of 'tip' must be finite"),
        (lambda: pt.PrescribedMotion("tip", lambda p, t: p * np.nan), "PrescribedMotion of 'tip' must be finite"),
        (lambda: "push", "loads must be of SurfaceForce, .*Pressure, Gravity, PrescribedMotion, .* got 'push'"),
    ],
)
def test_invalid_loads_are_refused_by_name(held, load, message):
    with pytest.raises(pt.InputError, match=message.replace("'x+'", r"'x\+'")):
        pt.rollout(held, [load()], duration=1e-3, every=5e-4)


@pytest.mark.parametrize(
    "load",
    [
        pt.PrescribedMotion("tip", lambda p, t: np.zeros((7, 3))),
        pt.Pressure("x+", lambda t: (1, 2, 3)),
    ],
)
def test_values_of_a_wrong_shape_are_refused_by_name(held, load):
    with pytest.raises(pt.InputError, match=load.group.replace("+", r"\+")):
        pt.rollout(held, [load], duration=1e-3, every=5e-4)


@pytest.mark.parametrize("value", [5, (0, 0, -5, 1), (0, 0), "down", (0, 0, np.nan), (0, 0, np.inf), ("a", "b", "c")])
@pytest.mark.parametrize(
    "load",
    [
        lambda value: pt.SurfaceForce("x+", force=value),
        lambda value: pt.SurfaceForce("x+", force=(1, 0, 0), moment=value),
        lambda value: pt.PrescribedMotion("x+", value),
        pt.Gravity,
    ],
)
def test_constants_are_checked_when_the_load_is_made(load, value):
    with pytest.raises(pt.InputError, match=r"of (SurfaceForce|PrescribedMotion|Gravity).* must be (three|finite)"):
        load(value)
    load(lambda *_: value)


def test_two_motions_of_one_node_are_refused(held):
    with pytest.raises(pt.InputError, match=r"'tip'.*already fixed or prescribed"):
        pt.rollout(held, [pt.PrescribedMotion("x+", (0, 0, 0)), MOVE], duration=1e-3, every=5e-4)


def test_a_surface_force_on_a_prescribed_group_is_refused(held):
    loads = [pt.SurfaceForce("x+", force=(1, 0, 0)), pt.PrescribedMotion("x+", (0, 0, 0))]
    with pytest.raises(pt.InputError, match="all fixed or prescribed; load another group"):
        pt.rollout(held, loads, duration=1e-3, every=5e-4)


def test_a_surface_force_on_nodes_that_are_not_a_face_is_refused(bar, tissue):
    inside = replace(bar, groups={**bar.groups, "deep": np.array([21, 22])})
    model = pt.Solid(inside, tissue, form="strong", stiffness_damping=0.0)
    with pytest.raises(pt.InputError, match="'deep' must lie on one face"):
        model.prepare([pt.SurfaceForce("deep", force=(1, 0, 0))])


def test_surface_forces_and_pressures_on_one_group_add_up(held):
    loads = [pt.SurfaceForce("x+", force=(1, 0, 0)), pt.SurfaceForce("x+", force=(0, 2, 0)), pt.Gravity((0, 0, 1))]
    loads.append(pt.Pressure("x+", 1000.0))
    prepared = held.prepare(loads)
    total = held.external_force(held.state(prepared), prepared).sum(axis=0)
    np.testing.assert_allclose(total, (1 - 1000 * 0.015**2, 2, held.masses.sum()), rtol=1e-12)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("group", ["x+", "y+", "z-", "patch"])
def test_forces_of_a_moment_sum_to_the_moment_and_to_zero_force(bar, tissue, group, axis):
    patch = bar.group("x+")[[0, 1, 6, 11]]  # lies skew to the axes, its centroid at no node
    model = pt.Solid(replace(bar, groups={**bar.groups, "patch": patch}), tissue, form="strong", stiffness_damping=0.0)
    moment = 2.0 * np.eye(3)[axis]
    prepared = model.prepare([pt.SurfaceForce(group, moment=moment)])
    force = model.external_force(model.state(prepared), prepared)
    np.testing.assert_allclose(force.sum(axis=0), 0, atol=1e-12 * np.abs(force).sum())
    about = np.array([0.1, -0.2, 0.3])  # no force: the moment is the same about any point
    np.testing.assert_allclose(
        np.cross(bar.points - about, force).sum(axis=0), moment, atol=1e-11 * np.abs(force).sum()
    )
    reach = 2.5 * bar.spacing if group == "patch" else 0.0  # the patches of its nodes, which do not fill the face
    far = cKDTree(bar.points[model.cloud.group(group)]).query(bar.points)[0] > reach
    np.testing.assert_array_equal(force[far], 0)


def test_force_and_moment_in_one_load_equal_two_loads(held):
    force, moment = (1.0, 2.0, 3.0), (0.1, -0.2, 0.3)
    both = pt.SurfaceForce("x+", force=lambda t: force, moment=lambda t: moment)
    apart = [
        pt.SurfaceForce("x+", force=force),
        pt.Pressure("z+", 10.0),
        pt.SurfaceForce("x+", moment=moment),
    ]
    fields = []
    for loads in ([pt.Pressure("z+", 10.0), both], apart):
        prepared = held.prepare(loads)
        fields.append(held.external_force(held.state(prepared), prepared))
    np.testing.assert_allclose(fields[0], fields[1], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("group", [[-1], [-1, -2], [-1, -2, -3, -4]], ids=["node", "pair", "edge"])
def test_a_moment_on_nodes_in_one_line_is_refused_by_name(bar, tissue, group):
    cloud = replace(bar, groups={**bar.groups, "line": np.sort(bar.group("x+")[group])})
    model = pt.Solid(cloud, tissue, form="strong", stiffness_damping=0.0)
    with pytest.raises(pt.InputError, match=r"SurfaceForce 'line' must be a face .*one line or at one point"):
        model.prepare([pt.SurfaceForce("line", force=(1, 0, 0), moment=(1, 0, 0))])
    model.prepare([pt.SurfaceForce("line", force=(1, 0, 0))])


@pytest.mark.slow
def test_a_moment_on_a_sheet_acts_on_its_face_and_not_on_its_edge():
    cloud = pt.sheet([(0, 0), (0.1, 0), (0.1, 0.1), (0, 0.1)], spacing=0.02)
    cloud = replace(cloud, groups={**cloud.groups, "face": np.arange(len(cloud))})
    model = pt.Membrane(
        cloud, pt.materials.NeoHookean(C1=20e3, density=1000.0, poisson=0.5), thickness=1e-3, prestretch=1.1
    )
    prepared = model.prepare([pt.SurfaceForce("face", moment=(1.0, 2.0, 3.0))])
    force = model.external_force(model.state(prepared), prepared)
    arms = np.pad(cloud.points, ((0, 0), (0, 1)))
    np.testing.assert_allclose(force.sum(axis=0), 0, atol=1e-12 * np.abs(force).sum())
    np.testing.assert_allclose(np.cross(arms, force).sum(axis=0), (1.0, 2.0, 3.0), rtol=1e-12)
    with pytest.raises(pt.InputError, match=r"SurfaceForce 'edge1' must be a face .*one line"):
        model.prepare([pt.SurfaceForce("edge1", moment=(0.0, 0.0, 1.0))])


def twist_rate(cells, tissue, moment, width=0.015):
    """Turn per length [1/m] of a square bar at rest, half-way between its held and its twisted end."""
    cloud = pt.box((2 * width, width, width), spacing=width / cells)
    model = pt.Solid(cloud, tissue, form="strong", fixed="x-", stiffness_damping=0.0)
    prepared = model.prepare([pt.SurfaceForce("x+", moment=(moment, 0, 0))])
    unknown = np.flatnonzero(np.repeat(~model.fixed_mask, 3))
    stiffness = np.empty((len(unknown), len(unknown)))
    for column, k in enumerate(unknown):
        u = np.zeros((len(cloud), 3))
        u.flat[k] = -1e-8
        stiffness[:, column] = model.force(u).flat[unknown] / 1e-8
    pulled = model.half_cell * model.external_force(model.state(prepared), prepared) / model.volumes[:, None]
    u = np.zeros((len(cloud), 3))
    u.flat[unknown] = np.linalg.solve(stiffness, pulled.flat[unknown])
    turns = []
    for x in (width - width / cells, width + width / cells):
        section = np.isclose(cloud.points[:, 0], x)
        y, z = cloud.points[section, 1:].T - width / 2
        turns.append((y @ u[section, 2] - z @ u[section, 1]) / (y @ y + z @ z))
    return (turns[1] - turns[0]) / (2 * width / cells)


@pytest.mark.slow
def test_a_square_bar_twists_by_saint_venants_formula(tissue):
    """G J per turn with J = 0.1406 width^4 [Timoshenko and Goodier, Theory of Elasticity, section 109]."""
    moment = 1e-6
    expected = moment / (tissue.shear_modulus * 0.1406 * 0.015**4)
    coarse, fine = (twist_rate(cells, tissue, moment) for cells in (3, 4))
    limit = (16 * fine - 9 * coarse) / (16 - 9)  # the error falls as the square of the spacing
    assert abs(fine - expected) < abs(coarse - expected)
    assert limit == pytest.approx(expected, rel=0.02)


@pytest.mark.parametrize(
    ("load", "said"),
    [
        (lambda: pt.PrescribedMotion("x+", lambda t: (t, 0, 0)), r"a function of points and time, got .* \(t\)"),
        (lambda: pt.SurfaceForce("x+", force=lambda: (1, 0, 0)), r"force .* must be a function of time, got .* \(\)"),
        (
            lambda: pt.tools.Contact(pt.tools.Sphere(0.01), lambda p, t: (t, 0, 1)),
            "motion .* must be a function of time",
        ),
    ],
)
def test_functions_of_other_arguments_are_refused(load, said):
    bar = pt.Solid(
        pt.box((0.03, 0.015, 0.015), 0.005), pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1e3, poisson=0.4), "x-"
    )
    with pytest.raises(pt.InputError, match=said):
        pt.rollout(bar, [load()], duration=0.01, every=0.01, progress=False)
