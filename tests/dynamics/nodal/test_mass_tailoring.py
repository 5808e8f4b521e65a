"""More mass for the fastest modes: the spectrum, equilibria and motions, against bodies without it."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import pytest

import palpate as pt
from palpate.dynamics.contact.tools import Forceps
from palpate.dynamics.nodal.mass_tailoring import tailored_mass, without_nodes
from palpate.dynamics.nodal.stability import stiffness
from palpate.realtime.bodies.full_body import step_statistics

SIZE, SPACING, BALL, PERIOD = (0.03, 0.03, 0.02), 0.005, 0.012, 1e-3  # [m], [s]
HOME = np.array([0.015, 0.015, SIZE[2] + BALL + 0.0005])
MODES = 8


@pytest.fixture(scope="module")
def block() -> pt.Solid:
    law = pt.materials.NeoHookean(C1=1e3, density=1000.0, poisson=0.45)
    return pt.Solid(pt.box(SIZE, SPACING, jitter=0.3), law, "z-", mass_damping=20.0)


def ball(path=tuple(HOME), friction=0.0) -> pt.tools.Contact:
    return pt.tools.Contact(pt.tools.Sphere(BALL), path, friction=friction)


def held_force(body, u) -> np.ndarray:
    """Return the force (3,) [N] that holds the free nodes of a body at displacements (n, 3)."""
    return -(body.nodal_force(u) * body.volumes[:, None])[~body.fixed_mask].sum(axis=0)


def press(model, ways) -> tuple[np.ndarray, np.ndarray]:
    """Return forces (p, 3) and displacements of a body under a ball that moves down by the ways [m]."""
    q, v, report, forces = *np.zeros((2, len(model.rest))), np.zeros(20), []
    for way in ways:
        target = np.zeros(12)
        target[2] = -way
        model.advance(model.data, q, v, target, PERIOD, report)
        assert report[0] == 0.0
        forces.append(report[8:11].copy())
    return np.array(forces), q.reshape(-1, 3)


def test_the_fastest_modes_are_slower_and_no_other(block):
    tailoring, highest = tailored_mass(block, block.fixed_mask, MODES)
    basis, count = block.free_directions.toarray(), len(tailoring.shares)
    assert count == MODES
    operator = stiffness(block)  # M^-1 K of the free directions
    shapes = np.zeros((3 * len(block.cloud), count))
    for k in range(count):
        part = slice(*tailoring.start[k : k + 2])
        shapes[3 * tailoring.nodes[part, None] + np.arange(3), k] = tailoring.shapes[part]
    masses = np.repeat(block.masses, 3)[:, None]
    np.testing.assert_allclose(shapes.T @ (masses * shapes), np.eye(count), atol=2e-2)  # parts are left out
    shapes, masses = basis.T @ shapes, basis.T @ masses
    slowed = operator - shapes @ (tailoring.shares[:, None] * (shapes.T @ (masses * operator)))
    before, after = (np.sort(np.sqrt(np.linalg.eigvals(each).real)) for each in (operator, slowed))
    assert after[-1] < 0.9 * before[-1]
    assert highest == pytest.approx(after[-1], rel=0.03)
    np.testing.assert_allclose(after[:40], before[:40], rtol=1e-4)


def test_a_step_is_longer_and_an_equilibrium_the_same(block):
    ways = 0.004 * np.minimum(np.arange(1, 801) / 300, 1.0)
    plain, slowed = (pt.realtime_model(block, contact=ball(), tailored_modes=k) for k in (0, MODES))
    assert slowed.data.resting_frequency < 0.9 * plain.data.resting_frequency
    assert step_statistics(slowed.data)["tailored_modes"] == MODES
    (force, u), (other, w) = press(plain, ways), press(slowed, ways)
    assert step_statistics(slowed.data)["repeated"] == 0
    assert force[-100:, 2].mean() < -0.1
    for forces, at in ((force, u), (other, w)):  # sweeps of contact end at 1 % of the largest impulse
        np.testing.assert_allclose(forces[-100:].mean(axis=0), held_force(block, at), atol=5e-3 * np.abs(force).max())
    np.testing.assert_allclose(w, u, atol=5e-3 * np.abs(u).max())


def test_a_press_is_that_of_a_run(block):
    path = lambda t: tuple(HOME - [0.0, 0.0, 0.0045 * np.sin(np.pi * min(t / 0.3, 1.0)) ** 2])  # noqa: E731
    model = pt.realtime_model(block, contact=ball(friction=0.3), tailored_modes=MODES)
    means = press(model, [HOME[2] - path(k * PERIOD)[2] for k in range(1, 301)])[0].reshape(30, 10, 3).mean(axis=1)
    run = pt.rollout(block, [ball(path, 0.3)], duration=0.3, every=0.01, progress=False)
    force = run.reactions["tool"][1:]
    np.testing.assert_allclose(means, force, atol=0.015 * np.abs(force).max())
    np.testing.assert_allclose(means.sum(axis=0)[2], force.sum(axis=0)[2], rtol=3e-3)


@pytest.mark.parametrize("modes", [0, MODES])
def test_forceps_report_the_force_that_holds_the_body(block, modes):
    model: Any = pt.realtime_model(block, contact=ball(), tailored_modes=modes)
    model.change_tool(Forceps(0.006, (0.015, 0.015, SIZE[2])), np.array([*HOME, 1.0, 0.0, 0.0, 0.0]), 0.0)
    forces, u = press(model, -0.004 * np.minimum(np.arange(1, 801) / 200, 1.0))
    assert forces[-1, 2] > 0.1
    np.testing.assert_allclose(forces[-1], held_force(block, u), atol=1e-5 * forces[-1, 2])


def test_modes_at_changed_nodes_are_left_out(block):
    tailoring, highest = tailored_mass(block, block.fixed_mask, MODES)
    changed = np.zeros(len(block.cloud), dtype=bool)
    assert without_nodes(tailoring, changed)[1] == 0.0
    fastest = int(tailoring.frequencies.argmax())
    part = slice(*tailoring.start[fastest : fastest + 2])
    changed[tailoring.nodes[part][np.abs(tailoring.shapes[part]).sum(axis=1).argmax()]] = True
    left, frequency = without_nodes(tailoring, changed)
    assert left.shares[fastest] == 0.0
    assert frequency == tailoring.frequencies.max() > highest


def test_small_bodies_keep_their_mass_by_default(block):
    assert step_statistics(pt.realtime_model(block, contact=ball()).data)["tailored_modes"] == 0
    assert not len(tailored_mass(block, block.fixed_mask, 0)[0].shares)


def test_bodies_with_and_without_modes_share_compiled_code(block):
    kinds = {numba.typeof(tailored_mass(block, block.fixed_mask, modes)[0]) for modes in (0, MODES)}
    assert len(kinds) == 1


@pytest.mark.parametrize("modes", [-1, 2.5, 201])
def test_a_wrong_number_of_modes_is_refused(block, modes):
    with pytest.raises(pt.InputError, match="tailored_modes"):
        pt.realtime_model(block, contact=ball(), tailored_modes=modes)
