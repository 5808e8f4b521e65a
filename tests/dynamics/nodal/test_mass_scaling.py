"""More mass for the fastest modes: the spectrum, equilibria and motions, against bodies without it."""

from __future__ import annotations

from typing import Any

import numba
import numpy as np
import pytest

import palpate as pt
from palpate.compiled.reference import StoredRecord
from palpate.dynamics.contact.tools import Forceps
from palpate.dynamics.nodal.mass_scaling import default_modes, scaled_mass, without_nodes
from palpate.dynamics.nodal.stability import stiffness
from palpate.realtime.bodies.full_body import step_statistics

pytestmark = pytest.mark.slow

SIZE, SPACING, BALL, PERIOD = (0.03, 0.03, 0.02), 0.005, 0.012, 1e-3  # [m], [s]
HOME = np.array([0.015, 0.015, SIZE[2] + BALL + 0.0005])
MODES = 8


@pytest.fixture(scope="module")
def block() -> pt.Solid:
    law = pt.materials.MooneyRivlin(C1=2e3, C2=0.0, density=1000.0, poisson=0.45)  # compiled for others, too
    return pt.Solid(pt.box(SIZE, SPACING, jitter=0.3), law, "z-", mass_damping=20.0)


def ball(path=tuple(HOME), friction=0.0) -> pt.tools.Contact:
    return pt.tools.Contact(pt.tools.Sphere(BALL), path, friction=friction)


def held_force(body, u) -> np.ndarray:
    """Return the force (3,) [N] that holds the free nodes of a body at displacements (n, 3)."""
    return -(body.nodal_force(u) * body.volumes[:, None])[~body.fixed_mask].sum(axis=0)


def press(model, ways) -> tuple[np.ndarray, np.ndarray]:
    """Return forces (p, 3) and displacements of a body under a ball that moves down by the ways [m]."""
    q, v, report, forces = *np.zeros((2, len(model.rest))), np.zeros(20), []
    data = StoredRecord(model.data)
    for way in ways:
        target = np.zeros(12)
        target[2] = -way
        model.advance(data, q, v, target, PERIOD, report)
        assert report[0] == 0.0
        forces.append(report[8:11].copy())
    return np.array(forces), q.reshape(-1, 3)


def dense_frequencies(body, mass_scaling) -> np.ndarray:
    """Return all frequencies [rad/s] of a body at rest with the additional mass of the used shapes."""
    basis, operator = body.free_directions.toarray(), stiffness(body)  # M^-1 K of the free directions
    masses = basis.T @ np.repeat(body.masses, 3)[:, None]
    shapes = basis.T @ dense_shapes(body, mass_scaling)[:, mass_scaling.used]
    return np.sort(np.sqrt(np.linalg.eigvals(operator - shapes @ (shapes.T @ (masses * operator))).real))


def dense_shapes(body, mass_scaling) -> np.ndarray:
    shapes = np.zeros((3 * len(body.cloud), len(mass_scaling.used)))
    for k in range(len(mass_scaling.used)):
        part = slice(*mass_scaling.start[k : k + 2])
        shapes[3 * mass_scaling.nodes[part, None] + np.arange(3), k] = mass_scaling.shapes[part]
    return shapes


def test_the_fastest_modes_are_slower_and_no_other(block):
    mass_scaling, highest = scaled_mass(block, block.fixed_mask, MODES)
    plain, _ = scaled_mass(block, block.fixed_mask, 0)
    assert len(mass_scaling.used) == MODES
    before, after = (dense_frequencies(block, each) for each in (plain, mass_scaling))
    assert after[-1] < 0.9 * before[-1]
    assert highest == pytest.approx(after[-1], rel=0.03)
    assert mass_scaling.plain_frequency == plain.plain_frequency == pytest.approx(before[-1], rel=0.03)
    np.testing.assert_allclose(after[:40], before[:40], rtol=1e-4)


@pytest.mark.quick
def test_local_shapes_add_the_mass_of_the_modes(block):
    mass_scaling, highest = scaled_mass(block, block.fixed_mask, MODES)
    shapes, shares = dense_shapes(block, mass_scaling), 1.0 - (highest / mass_scaling.frequencies) ** 2
    products = shapes.T @ (np.repeat(block.masses, 3)[:, None] * shapes)
    np.testing.assert_allclose(np.diag(mass_scaling.mixing @ mass_scaling.mixing.T), shares, atol=2e-2)
    np.testing.assert_allclose(np.linalg.eigvalsh(products), np.sort(shares), atol=2e-2)  # parts are left out
    assert np.linalg.eigvalsh(products).max() < 1.0  # so that the mass is positive definite


def test_a_step_is_longer_and_an_equilibrium_the_same(block):
    ways = 0.004 * np.minimum(np.arange(1, 801) / 300, 1.0)
    plain, slowed = (pt.realtime_model(block, contact=ball(), scaled_modes=k) for k in (0, MODES))
    assert slowed.data.body.resting_frequency < 0.9 * plain.data.body.resting_frequency
    statistics, rest = step_statistics(slowed.data), plain.data.body.resting_frequency
    assert statistics["tailored_modes"] == MODES
    assert statistics["step_gain"] == rest / slowed.data.body.resting_frequency
    (force, u), (other, w) = press(plain, ways), press(slowed, ways)
    assert step_statistics(slowed.data)["repeated"] == 0
    assert force[-100:, 2].mean() < -0.1
    for forces, at in ((force, u), (other, w)):  # sweeps of contact end at 1 % of the largest impulse
        np.testing.assert_allclose(forces[-100:].mean(axis=0), held_force(block, at), atol=5e-3 * np.abs(force).max())
    np.testing.assert_allclose(w, u, atol=5e-3 * np.abs(u).max())


def test_a_press_is_that_of_a_run(block):
    path = lambda t: tuple(HOME - [0.0, 0.0, 0.0045 * np.sin(np.pi * min(t / 0.3, 1.0)) ** 2])  # noqa: E731
    model = pt.realtime_model(block, contact=ball(friction=0.3), scaled_modes=MODES)
    means = press(model, [HOME[2] - path(k * PERIOD)[2] for k in range(1, 301)])[0].reshape(30, 10, 3).mean(axis=1)
    run = pt.rollout(block, [ball(path, 0.3)], duration=0.3, every=0.01, progress=False)
    force = run.reactions["tool"][1:]
    np.testing.assert_allclose(means, force, atol=0.015 * np.abs(force).max())
    np.testing.assert_allclose(means.sum(axis=0)[2], force.sum(axis=0)[2], rtol=3e-3)


@pytest.mark.parametrize("modes", [0, MODES])
def test_forceps_report_the_force_that_holds_the_body(block, modes):
    model: Any = pt.realtime_model(block, contact=ball(), scaled_modes=modes)
    model.change_tool(Forceps(0.006, (0.015, 0.015, SIZE[2])), np.array([*HOME, 1.0, 0.0, 0.0, 0.0]), 0.0)
    forces, u = press(model, -0.004 * np.minimum(np.arange(1, 801) / 200, 1.0))
    assert forces[-1, 2] > 0.1
    np.testing.assert_allclose(forces[-1], held_force(block, u), atol=1e-5 * forces[-1, 2])


def test_modes_at_changed_nodes_are_left_out(block):
    mass_scaling, highest = scaled_mass(block, block.fixed_mask, MODES)
    changed = np.zeros(len(block.cloud), dtype=bool)
    assert without_nodes(mass_scaling, changed)[1] == 0.0
    part = slice(*mass_scaling.start[:2])
    changed[mass_scaling.nodes[part][np.abs(mass_scaling.shapes[part]).sum(axis=1).argmax()]] = True
    left, frequency = without_nodes(mass_scaling, changed)
    assert not left.used[0]
    assert highest < frequency <= mass_scaling.frequencies.max()
    assert frequency == pytest.approx(dense_frequencies(block, left)[-1], rel=0.02)
    assert without_nodes(mass_scaling, np.ones_like(changed))[1] == pytest.approx(mass_scaling.frequencies.max())


def vibration_energies(body, modes) -> np.ndarray:
    """Return energies [J] in means over 0.1 s, because velocities belong to the middles of steps, after a pull."""
    model: Any = pt.realtime_model(body, contact=ball(), scaled_modes=modes)
    pose = np.array([*HOME, 1.0, 0.0, 0.0, 0.0])
    model.change_tool(Forceps(0.006, (0.015, 0.015, SIZE[2])), pose, 0.0)
    q, v, report, energies = *np.zeros((2, len(model.rest))), np.zeros(20), []
    for k in range(650):
        if k == 50:
            model.change_tool(None, pose, 0.0)
        model.advance(model.data, q, v, np.array([0.0, 0.0, 1e-4 * k if k < 50 else 0.0, *np.zeros(9)]), PERIOD, report)
        kinetic = 0.5 * body.masses @ np.sum(v.reshape(-1, 3) ** 2, axis=1)
        energies.append(kinetic + body.strain_energy(q.reshape(-1, 3)))
    assert step_statistics(model.data)["energy_gained"] == 0.0
    return np.reshape(energies[50:], (6, 100)).mean(axis=1)


def test_a_free_vibration_decays_as_without_modes(block):
    free = pt.Solid(block.cloud, block.material, "z-")
    expected, found = (vibration_energies(free, modes) for modes in (0, MODES))
    assert np.all(np.diff(found) < 0.0)
    np.testing.assert_allclose(found, expected, rtol=0.02)


def test_bits_are_those_of_one_thread(block):
    before, found = numba.get_num_threads(), []
    for threads in (1, before):
        numba.set_num_threads(threads)
        model = pt.realtime_model(block, contact=ball(friction=0.3), scaled_modes=MODES)
        found.append(press(model, 0.004 * np.sin(0.01 * np.arange(200)) ** 2))
    numba.set_num_threads(before)
    for one, other in zip(*found, strict=True):
        np.testing.assert_array_equal(one, other)


@pytest.mark.quick
def test_small_bodies_keep_their_mass_by_default(block):
    assert step_statistics(pt.realtime_model(block, contact=ball()).data)["tailored_modes"] == 0
    assert not len(scaled_mass(block, block.fixed_mask, 0)[0].used)
    assert [default_modes(nodes) for nodes in (499, 500, 990, 1e6)] == [0, 20, 30, 40]


def test_bodies_with_and_without_modes_share_compiled_code(block):
    kinds = {numba.typeof(scaled_mass(block, block.fixed_mask, modes)[0]) for modes in (0, MODES)}
    assert len(kinds) == 1


@pytest.mark.quick
@pytest.mark.parametrize("modes", [-1, 2.5, 201])
def test_a_wrong_number_of_modes_is_refused(block, modes):
    with pytest.raises(pt.InputError, match="scaled_modes"):
        pt.realtime_model(block, contact=ball(), scaled_modes=modes)
