"""The displayed surface of a reduced model, compared with the displacements of the model."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.realtime.bodies.display_surface import Surface

pytestmark = pytest.mark.slow

SIZE, BALL = (0.048, 0.048, 0.024), 0.015


@pytest.fixture(scope="module")
def pressed():
    """A reduced block, and the last state of a press on it."""
    body = pt.Solid(
        pt.box(SIZE, 0.006),
        pt.materials.MooneyRivlin(C1=4e3, C2=0, density=1000, poisson=0.4),
        "z-",
        form="energy",
        stiffness_damping=1e-4,
    )
    motion = lambda time: (0.024, 0.024, SIZE[2] + BALL + 0.001 - 0.004 * min(time / 0.1, 1.0))  # noqa: E731
    load = pt.tools.Contact(pt.tools.Sphere(BALL), motion)
    run = pt.rollout(body, [load], duration=0.12, every=0.005)
    model = pt.hyper_reduce(body, run, modes=0, enrichment=pt.vibration_modes(body, 12)[0])
    prepared = model.prepare([load])
    state = model.state(prepared)
    for _ in range(40):
        step = model.stable_step(state, prepared)[0]
        steps = int(np.ceil(0.005 / step))
        state = model.advance(state, prepared, 0.005 / steps, steps)[0]
    return model, prepared, state


def test_vertices_are_at_the_displacements_of_the_model(pressed):
    model, prepared, state = pressed
    surface = Surface(model)
    push = state.contact_state.surface_forces[0]
    on = np.flatnonzero(push.any(axis=1))
    nodal = model.displacement(state, prepared, surface.nodes)
    met = surface.displacements(state.coordinates, on, push[on], np.zeros(len(on), bool), np.zeros(len(on), int))
    expected = surface.patch_displacements(nodal.astype(np.float32))
    np.testing.assert_allclose(met, expected, atol=2e-3 * np.abs(nodal).max())
    middle = int(np.argmin(np.linalg.norm(surface.rest - (0.024, 0.024, SIZE[2]), axis=1)))
    assert met[middle, 2] == pytest.approx(-0.003, abs=2e-4)  # where the ball is
    assert nodal[middle, 2] < -0.004


def test_bonded_nodes_have_their_forces_without_smoothing(pressed):
    model, _, _ = pressed
    surface, load = Surface(model), pt.tools.Grasp((0.024, 0.024, SIZE[2]), 0.008, (0.024, 0.024, SIZE[2] + 0.002))
    prepared = model.prepare([load])
    state = model.state(prepared)
    for _ in range(10):
        steps = int(np.ceil(0.005 / model.stable_step(state, prepared)[0]))
        state = model.advance(state, prepared, 0.005 / steps, steps)[0]
    push = state.contact_state.surface_forces[0]
    on = np.flatnonzero(push.any(axis=1))
    nodal = model.displacement(state, prepared, surface.nodes)
    seen = surface.displacements(state.coordinates, on, push[on], np.ones(len(on), bool), np.zeros(len(on), int))
    np.testing.assert_allclose(seen, nodal, atol=2e-3 * np.abs(nodal).max())


def test_triangles_are_those_of_the_cloud(pressed):
    model, _, _ = pressed
    surface = Surface(model)
    np.testing.assert_array_equal(surface.nodes[surface.triangles], model.cloud.triangles)
    np.testing.assert_allclose(surface.rest, model.cloud.points[surface.nodes], rtol=1e-6)


def test_stress_is_that_of_the_law_for_the_gradient_of_the_modes(pressed):
    model, _, state = pressed
    surface = Surface(model)
    u = np.tensordot(state.coordinates, model.body.vectors, 1)
    F, P = model.body.gradient(u) + np.eye(3), model.stress(u)[surface.nodes]
    F = F[surface.nodes]
    cauchy = P @ F.swapaxes(1, 2) / np.linalg.det(F)[:, None, None]
    size = np.abs(cauchy).max()
    np.testing.assert_allclose(surface.cauchy(state.coordinates), cauchy, atol=1e-3 * size)
    principal = np.linalg.eigvalsh(cauchy)
    mises = np.sqrt(0.5 * sum((principal[:, a] - principal[:, b]) ** 2 for a, b in ((0, 1), (1, 2), (2, 0))))
    moved = np.zeros_like(surface.rest)
    np.testing.assert_allclose(surface.scalar("stress", state.coordinates, moved), mises, atol=2e-3 * size)
    pressure = -principal.sum(axis=1) / 3
    np.testing.assert_allclose(surface.scalar("pressure", state.coordinates, moved), pressure, atol=2e-3 * size)
    with pytest.raises(pt.InputError, match="'displacement', 'stress', 'pressure'"):
        surface.scalar("heat", state.coordinates, moved)
