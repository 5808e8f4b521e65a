"""A linearised body against the nonlinear one."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.io import loadmat, mmread

import palpate as pt
from palpate.dynamics.nodal.stability import stiffness
from palpate.reduction.basis.linear_modes import rest_stiffness
from palpate.reduction.lti.stiffness import coupling, independent_groups, nodal_stiffness

pytestmark = pytest.mark.slow

MOTION = (0.0, 0.0, 0.0)


@pytest.mark.parametrize("form", ["strong_system", "system"])
def test_the_stiffness_is_the_slope_of_the_nonlinear_force(form, request):
    system = request.getfixturevalue(form)
    model = system.model
    expected = stiffness(model) * np.repeat(model.weights * model.material.density, 3)[system.dofs][:, None]
    np.testing.assert_allclose(system.stiffness.toarray(), expected, atol=1e-8 * np.abs(expected).max())
    np.testing.assert_allclose(
        system.damping.toarray(), model.stiffness_damping * system.stiffness.toarray(), rtol=1e-14
    )
    assert system.symmetric == (form == "system")


def test_the_stiffness_at_a_deformed_state_is_the_derivative_of_the_force(energetic):
    u = 4e-4 * np.sin(200 * energetic.cloud.points)
    u[energetic.fixed_mask] = 0.0
    system = pt.lti.linearise(energetic, [pt.Gravity()], ["x+"], u)
    expected = stiffness(energetic, u) * np.repeat(energetic.masses, 3)[system.dofs][:, None]
    np.testing.assert_allclose(system.stiffness.toarray(), expected, atol=1e-7 * np.abs(expected).max())
    at_rest = pt.lti.linearise(energetic, [pt.Gravity()], ["x+"]).stiffness
    assert np.abs(at_rest - system.stiffness).max() > 1e-3 * np.abs(expected).max()
    with pytest.raises(pt.InputError, match="at rest"):
        pt.lti.reduce_linear(system, "modal", 4)


def test_differences_and_stencils_give_the_same_stiffness(energetic):
    u = np.zeros_like(energetic.cloud.points)
    by_differences = nodal_stiffness(energetic, u)
    assembled = rest_stiffness(energetic)
    np.testing.assert_allclose(by_differences.toarray(), assembled.toarray(), atol=1e-8 * np.abs(assembled.data).max())


def test_the_linearised_sheet_has_the_stiffness_of_its_force():
    cloud = pt.sheet([(0.0, 0.0), (0.04, 0.0), (0.04, 0.03), (0.0, 0.03)], spacing=0.005)
    material = pt.materials.NeoHookean(C1=17e3, density=1000.0, poisson=0.5)
    sheet = pt.Membrane(cloud, material, thickness=1e-3, fixed="rim", prestretch=1.1)
    u = np.random.default_rng(0).standard_normal((len(cloud), 3))
    step = 1e-5 * cloud.spacing
    slope = (sheet.force(step * u) - sheet.force(-step * u)) / (2 * step) * sheet.weights[:, None]
    found = (nodal_stiffness(sheet) @ u.ravel()).reshape(-1, 3)
    np.testing.assert_allclose(-found, slope, atol=1e-7 * np.abs(slope).max())


def test_groups_of_columns_share_no_row():
    cloud = pt.box((0.2, 0.02, 0.02), spacing=0.005)
    model = pt.Solid(cloud, pt.materials.NeoHookean(C1=5e3, density=1000.0, poisson=0.45), "x-", form="energy")
    pattern = coupling(model)
    groups = independent_groups(pattern)
    np.testing.assert_array_equal(np.sort(np.concatenate(groups)), np.arange(len(cloud)))
    for group in groups:
        assert pattern[:, group].sum(axis=1).max() <= 1
    assert len(groups) < len(cloud)


@pytest.mark.parametrize("form", ["strong_system", "system"])
def test_the_response_at_zero_frequency_is_the_static_one(form, request):
    system = request.getfixturevalue(form)
    response = system.transfer(0.0)[0].real
    names = list(system.outputs)
    held = [names.index(f"force {axis} of x-") for axis in "xyz"]
    np.testing.assert_allclose(response[held], -np.eye(3), atol=1e-8)  # the support bears the load
    ends = [names.index(f"displacement {axis} of x+") for axis in "xyz"]
    assert np.all(np.diag(response[ends]) > 0)


def test_a_tool_lifts_the_body_without_forces_at_free_nodes(tool_system, energetic):
    forces = (tool_system.whole @ tool_system.lifts.T)[tool_system.dofs]
    assert np.abs(forces).max() < 1e-9 * np.abs(tool_system.static).max()
    assert len(tool_system.lifting) == 6
    # at rest the tool feels what the nonlinear body answers to a small motion of it
    u = 1e-4 * energetic.cloud.spacing * tool_system.lifting[0]
    pulled = -np.sum((energetic.force(u) * energetic.volumes[:, None])[energetic.cloud.group("tip")], axis=0) / (
        1e-4 * energetic.cloud.spacing
    )
    np.testing.assert_allclose(tool_system.static[3:6, 0], pulled, atol=1e-3 * np.abs(pulled).max())


def test_rates_of_forces_have_the_stiffness_damping(system, tool_system):
    for each in (system, tool_system):
        forces = np.array([name.startswith("force") for name in each.outputs])
        beta = each.model.stiffness_damping * forces[:, None]
        np.testing.assert_array_equal(each.rate_output.toarray(), beta * each.output.toarray())
        np.testing.assert_array_equal(each.static_rate, beta * each.static)
    assert tool_system.static_rate.any()


def test_gravity_is_an_input(energetic):
    system = pt.lti.linearise(energetic, [pt.Gravity()], ["x-"])
    weight = energetic.masses.sum()
    np.testing.assert_allclose(system.transfer(0.0)[0].real, -weight * np.eye(3), atol=1e-8 * weight)


def test_matlab_files_hold_the_matrices(strong_system, tmp_path):
    pt.lti.save_matlab(strong_system, tmp_path / "bar.mat")
    found = loadmat(tmp_path / "bar.mat")
    for name, matrix in (("M", strong_system.mass), ("K", strong_system.stiffness), ("B", strong_system.input)):
        np.testing.assert_array_equal(found[name].toarray(), matrix.toarray())
    np.testing.assert_array_equal(3 * (found["node"] - 1) + found["component"] - 1, strong_system.dofs[:, None])
    assert found["inputs"][2, 0].item() == "force z on x+"
    assert [path.name for path in tmp_path.iterdir()] == ["bar.mat"]


def test_matrix_market_files_hold_the_matrices(tool_system, tmp_path):
    pt.lti.save_matrix_market(tool_system, tmp_path / "bar")
    for name, matrix in (("K", tool_system.stiffness), ("Cp", tool_system.output)):
        np.testing.assert_array_equal(mmread(tmp_path / "bar" / f"{name}.mtx").toarray(), matrix.toarray())
    np.testing.assert_array_equal(mmread(tmp_path / "bar" / "S.mtx"), tool_system.static)
    node, component = np.loadtxt(tmp_path / "bar" / "unknowns.txt", dtype=int).T
    np.testing.assert_array_equal(3 * node + component, tool_system.dofs)


@pytest.mark.parametrize(
    ("load", "message"),
    [
        (
            pt.tools.Contact(pt.tools.Sphere(0.01), (0.0, 0.0, 0.1)),
            "must be one of SurfaceForce, .*, got Contact",
        ),
        (pt.Pressure("x+", 10.0), r"got Pressure\(.*; leave it out, or run the nonlinear body"),
        (pt.PrescribedMotion("tip", MOTION), "form='energy'"),
    ],
)
def test_loads_that_are_not_linear_inputs_are_refused(load, message, strong):
    with pytest.raises(pt.InputError, match=message):
        pt.lti.linearise(strong, [load], ["x+"])


def test_a_system_needs_an_output_and_tissue_without_memory(energetic, bar, tissue, soft_pull):
    with pytest.raises(pt.InputError, match="outputs must name a group"):
        pt.lti.linearise(energetic, [soft_pull])
    slow = pt.materials.NeoHookean(
        C1=5e3, density=1000.0, poisson=0.45, prony=pt.materials.Prony(times=(0.1,), shares=(0.3,))
    )
    with pytest.raises(pt.InputError, match="must be without prony"):
        pt.lti.linearise(pt.Solid(bar, slow, "x-", form="energy"), [soft_pull], ["x+"])
