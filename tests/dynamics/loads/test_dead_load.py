"""A load that derives from `DeadLoad` acts on every kind of model without a change of any of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest

import palpate as pt
from palpate.dynamics.loads.dead_load import DeadLoad, ForcePattern
from palpate.reduction.lti.system import force_inputs

pytestmark = pytest.mark.slow


@dataclass(frozen=True)
class Pinch(DeadLoad):
    """Two opposite forces on the nodes of a group, outward from its middle."""

    group: str
    force: float

    @property
    def labels(self):
        return ("pinch",)

    def pattern(self, cloud, areas):
        nodes = cloud.group(self.group)
        side = np.sign(cloud.points[nodes, 1] - cloud.points[nodes, 1].mean())
        return ForcePattern(nodes, (side[:, None, None] * [0.0, 1.0, 0.0]) / np.abs(side).sum())

    def amplitudes(self, times):
        return np.full((len(times), 1), self.force)


@pytest.fixture(scope="module")
def body():
    cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    tissue = pt.materials.MooneyRivlin(C1=10e3, C2=0.0, density=1000.0, poisson=0.4)
    return pt.Solid(cloud, tissue, fixed="x-", form="energy")


@pytest.fixture(scope="module")
def run(body):
    return pt.rollout(body, [Pinch("x+", 0.05)], duration=4e-3, every=4e-4, progress=False)


def spread_of(run, cloud):
    """Return how far the two sides of the loaded face have gone apart at the end [m]."""
    nodes = cloud.group("x+")
    side = np.sign(cloud.points[nodes, 1] - cloud.points[nodes, 1].mean())
    return float(np.mean(run.displacements[-1, nodes, 1] * side))


def test_a_user_dead_load_does_the_work_of_its_forces_on_the_full_model(body, run):
    assert spread_of(run, body.cloud) > 1e-5
    balance = run.kinetic + run.strain + run.dissipated - run.external
    assert np.abs(balance).max() < 1e-2 * run.external[-1]


@pytest.mark.parametrize("reduce", [pt.galerkin, pt.hyper_reduce])
def test_a_user_dead_load_acts_on_reduced_models(body, run, reduce):
    own = pt.rollout(reduce(body, run, modes=8), [Pinch("x+", 0.05)], duration=4e-3, every=4e-4, progress=False)
    assert spread_of(own, body.cloud) == pytest.approx(spread_of(run, body.cloud), rel=0.05)


@pytest.mark.parametrize("load", [Pinch("x+", 0.05), pt.SurfaceForce("x+", moment=(1e-5, 2e-5, -3e-5))])
def test_the_inputs_of_a_linear_system_are_the_nodal_forces_of_unit_amplitudes(body, load):
    prepared = body.prepare([load])
    columns, names = force_inputs(body, prepared, np.repeat(body.masses, 3))
    assert names == [f"{label} on x+" for label in load.labels]
    expected = body.external_force(body.state(prepared), prepared).ravel()
    assert np.abs(expected).max() > 1e-4
    np.testing.assert_allclose(load.amplitudes(np.zeros(1))[0] @ columns, expected, atol=1e-12)


def test_the_amplitudes_of_a_dead_load_are_inputs_of_a_linear_model(body):
    """Twice the load, twice the motion."""
    model = pt.lti.reduce_linear(pt.lti.linearise(body, [Pinch("x+", 0.05)], outputs=["x+"]), "modal", modes=20)
    runs = [
        pt.rollout(model, [Pinch("x+", force)], duration=2e-3, every=2e-4, progress=False) for force in (0.01, 0.02)
    ]
    assert spread_of(runs[0], body.cloud) > 1e-9
    np.testing.assert_allclose(runs[1].displacements, 2 * runs[0].displacements, rtol=1e-9, atol=1e-18)


def test_a_linear_model_refuses_a_dead_load_that_its_system_lacks(body):
    system = pt.lti.linearise(body, [pt.SurfaceForce("x+", force=(1, 0, 0))], outputs=["x+"])
    model = pt.lti.reduce_linear(system, "modal", modes=4)
    with pytest.raises(pt.InputError, match=r"those of the linear system \(SurfaceForce on 'x\+'\), got"):
        model.prepare([Pinch("x+", 1.0)])
