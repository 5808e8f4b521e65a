"""The forces of forceps on the nodes that they hold."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.dynamics.run.trajectory import StoredTrajectory

SIDE, EVERY = 0.015, 1e-3
TOP = np.array([SIDE / 2, SIDE / 2, SIDE])


def lift(time):
    """Up by 1 mm and about z by 0.2 within 10 ms, then at rest."""
    share = np.sin(np.pi / 2 * min(time / 0.01, 1.0)) ** 2
    return TOP + np.array([0.0, 0.0, 1e-3 * share]), (0.0, 0.0, 0.2 * share)


def run(model, *loads, duration=0.03, **more):
    return pt.rollout(model, loads, duration=duration, every=EVERY, progress=False, **more)


def on_nodes(trajectory):
    """Sum (f, 3) of the forces that nodes got in every frame."""
    total = np.zeros((len(trajectory.times), 3))
    np.add.at(total, trajectory.contact_forces[:, 0].astype(int), trajectory.contact_forces[:, 2:])
    return total


@pytest.fixture
def press():
    """A ball that rubs the edge of what is held, so that its patches share nodes with the forceps."""
    way = lambda time: (0.0, 0.0, SIDE + 0.0075 - 0.1 * min(time, 0.02))  # noqa: E731
    return pt.tools.Contact(pt.tools.Sphere(0.006), way, friction=0.3)


@pytest.fixture
def forceps():
    return pt.tools.Grasp(TOP, 0.0085, lift, name="forceps")


def test_nodal_forces_sum_to_the_tool_forces_and_the_momentum_of_a_free_body(small_cloud, tissue, forceps, press):
    model = pt.Solid(small_cloud, tissue, form="energy")
    trajectory = run(model, forceps, press)
    of_tools = sum(trajectory.reactions[name] for name in ("forceps", "tool"))
    size = np.abs(of_tools).max()
    held = forceps.with_group(small_cloud).group("forceps")
    pushed = np.unique(trajectory.contact_forces[:, 1])
    assert set(held) < set(pushed)
    assert trajectory.reactions["tool"][:, 2].min() < -0.01 * size
    np.testing.assert_allclose(on_nodes(trajectory), of_tools, atol=1e-9 * size)
    momentum = np.einsum("n,fnc->fc", model.masses, trajectory.velocities)
    np.testing.assert_allclose(np.cumsum(of_tools, axis=0) * EVERY, momentum, atol=1e-6 * size * EVERY)


@pytest.mark.slow
def test_at_rest_the_force_on_every_bonded_node_is_its_internal_force(small_cloud, tissue, forceps):
    model = pt.Solid(small_cloud, tissue, "z-", form="energy", stiffness_damping=1e-4)
    trajectory = run(model, forceps, duration=0.2)  # ten periods, after which it rests
    held = forceps.with_group(small_cloud).group("forceps")
    last = trajectory.contact_forces[trajectory.contact_forces[:, 0] == len(trajectory.times) - 1]
    np.testing.assert_array_equal(last[:, 1], held)
    own = -(model.volumes[:, None] * model.force(trajectory.displacements[-1]))[held]
    np.testing.assert_allclose(last[:, 2:], own, atol=1e-4 * np.abs(own).max())


@pytest.mark.slow
def test_forceps_that_release_within_a_frame_give_the_momentum_until_then(small_cloud, tissue, forceps):
    model = pt.Solid(small_cloud, tissue, form="energy")
    until = 0.0074
    trajectory = run(model, pt.tools.Grasp(TOP, 0.0085, lift, until=until), duration=0.012)
    force = trajectory.reactions["grasp"]
    assert np.linalg.norm(force[8]) > 0
    assert not force[9:].any()
    np.testing.assert_allclose(on_nodes(trajectory), force, atol=1e-9 * np.abs(force).max())
    momentum = np.einsum("n,fnc->fc", model.masses, trajectory.velocities)
    np.testing.assert_allclose(np.cumsum(force, axis=0) * EVERY, momentum, atol=1e-6 * np.abs(momentum).max())


@pytest.mark.slow
def test_forces_on_nodes_are_those_of_a_grasp_in_the_energy_form_alone(small_cloud, tissue, forceps):
    """A strong form's residuals are not the forces of what holds it; and other motions train lifting functions."""
    cloud = forceps.with_group(small_cloud)
    strong = pt.Solid(cloud, tissue, "z-", form="strong", stiffness_damping=6e-5)
    body = pt.Solid(cloud, tissue, "z-", form="energy")
    motion = pt.PrescribedMotion("forceps", forceps.displacement)
    for model, load in ((strong, forceps), (body, motion)):
        trajectory = run(model, load, duration=0.005)
        assert not len(trajectory.contact_forces)
        assert trajectory.reactions["forceps"][-1].any()


def test_trajectories_and_files_distinguish_touched_from_bonded_nodes(small_cloud, tissue, forceps, press, tmp_path):
    model = pt.Solid(small_cloud, tissue, "z-", form="energy")
    first = run(model, forceps, press, duration=0.02, file=tmp_path / "first.h5")
    held = forceps.with_group(small_cloud).group("forceps")
    np.testing.assert_array_equal(first.bonded, np.isin(first.contact_forces[:, 1], held))
    assert not first.bonded.all()
    last = first.displacements[-1], first.velocities[-1]
    second = run(model, forceps, press, duration=0.01, start=0.02, displacement=last[0], velocity=last[1])
    both = first.concatenate(second)
    both.save(tmp_path / "both.h5")
    np.testing.assert_array_equal(both.bonded, np.isin(both.contact_forces[:, 1], held))
    assert both.contact_forces[:, 0].max() == 30
    for name, expected in (("first", first), ("both", both)):
        for read in (pt.Trajectory.load(tmp_path / f"{name}.h5"), StoredTrajectory(tmp_path / f"{name}.h5")):
            np.testing.assert_array_equal(read.bonded, expected.bonded)
            np.testing.assert_array_equal(read.contact_forces, expected.contact_forces)
