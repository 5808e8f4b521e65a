"""Which explicit steps of a reduced model are repeated: those that gain energy, and no others."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.dynamics.run.model import Model
from palpate.reduction.hyper.model import MAX_ENERGY_ERROR

pytestmark = pytest.mark.slow

SOFT = {"C1": 6e3, "C2": 0.0, "density": 1000.0, "poisson": 0.45}
MAX_STEPS = 1.2  # steps of a run over those without the check
END = 0.1  # [s] of the pull


def bar(stiffness_damping: float) -> pt.Solid:
    cloud = pt.box((0.1, 0.02, 0.02), 0.005)
    return pt.Solid(cloud, pt.materials.MooneyRivlin(**SOFT), "x-", stiffness_damping=stiffness_damping)


def pull(force: float, axis: int = 0, end: float = END) -> list[pt.SurfaceForce]:
    """A force on the free end that starts and ends suddenly."""
    direction = np.eye(3)[axis]
    return [pt.SurfaceForce("x+", force=lambda t: (force if t < end else 0.0) * direction)]


@pytest.fixture(scope="module", params=[0.0, 2e-5, 1e-3])
def trained(request) -> pt.ReducedModel:
    """A bar reduced to the modes of its pull and release, with little or much damping."""
    full = bar(request.param)
    return pt.hyper_reduce(full, pt.rollout(full, pull(0.5), duration=0.3, every=0.01, progress=False), modes=6)


def checked_and_unchecked(model, loads, monkeypatch, *, duration: float, every: float):
    """Return a run whose steps are checked, and one whose steps are accepted unless they are not finite."""
    checked = pt.rollout(model, loads, duration=duration, every=every, progress=False)
    assert checked.complete
    with monkeypatch.context() as patch:
        patch.setattr(pt.ReducedModel, "accept_step", Model.accept_step)
        return checked, pt.rollout(model, loads, duration=duration, every=every, progress=False)


def energy_error(run) -> float:
    """Return the largest error of the energy balance over the largest energy."""
    return float(np.abs(run.balance).max() / max(run.external.max(), (run.kinetic + run.strain).max()))


@pytest.mark.parametrize("every", [0.001, 0.002, 0.005, 0.01])
def test_good_steps_of_a_pull_and_its_release_are_accepted(trained, every, monkeypatch):
    checked, free = checked_and_unchecked(trained, pull(0.5), monkeypatch, duration=0.3, every=every)
    assert checked.steps[-1] <= MAX_STEPS * free.steps[-1]


@pytest.mark.parametrize("every", [0.001, 0.01])
def test_steps_under_a_force_that_the_modes_cannot_feel_are_accepted(trained, every, monkeypatch):
    """The energy is that of rounding."""
    checked, free = checked_and_unchecked(trained, pull(20.0, axis=1), monkeypatch, duration=0.1, every=every)
    assert checked.steps[-1] <= MAX_STEPS * free.steps[-1]


@pytest.mark.parametrize("every", [0.001, 0.01])
def test_steps_far_beyond_training_are_repeated_only_where_they_gain_energy(trained, every, monkeypatch):
    """A force for a stretch of four, forty times that of the training."""
    checked, free = checked_and_unchecked(trained, pull(20.0, end=0.02), monkeypatch, duration=0.05, every=every)
    assert energy_error(checked) < 0.1
    assert checked.steps[-1] <= MAX_STEPS * free.steps[-1] or energy_error(free) > MAX_ENERGY_ERROR


def test_a_body_that_comes_to_rest_keeps_its_steps(monkeypatch):
    full = bar(1e-3)
    short = pull(0.5, end=0.01)
    model = pt.hyper_reduce(full, pt.rollout(full, short, duration=0.05, every=0.001, progress=False), modes=2)
    checked, free = checked_and_unchecked(model, short, monkeypatch, duration=8.0, every=0.05)
    energy = checked.kinetic + checked.strain
    assert energy[-1] < 1e-12 * energy.max()
    assert checked.steps[-1] <= MAX_STEPS * free.steps[-1]


def test_steps_beyond_the_stable_one_are_rejected(trained):
    prepared = trained.prepare(pull(0.5))
    state = trained.state(prepared)
    step = 3 * trained.stable_step(state, prepared)[0]
    with np.errstate(all="ignore"):
        after, report = trained.advance(state, prepared, step, 50)
    assert not trained.accept_step(state, after, report)
