"""Snapshots that are decomposed block by block: as those in memory, within the bound that is told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import subspace_angles

import palpate as pt
from palpate.reduction.basis import incremental_pod as incremental
from palpate.reduction.basis.incremental_pod import decompose
from palpate.reduction.basis.snapshots import Snapshots
from palpate.reduction.basis.strain_pod import main_modes

pytestmark = pytest.mark.slow

BLOCK = 8


@pytest.fixture(scope="module")
def weights():
    return np.random.default_rng(1).uniform(0.5, 2.0, 60)


@pytest.fixture(scope="module")
def snapshots():
    """Seventy snapshots whose singular values fall from 1 to 1e-9."""
    random = np.random.default_rng(0)
    left, _ = np.linalg.qr(random.normal(size=(70, 70)))
    right, _ = np.linalg.qr(random.normal(size=(180, 70)))
    return ((left * np.geomspace(1, 1e-9, 70)) @ right.T).reshape(70, 60, 3)


@pytest.fixture
def small_blocks(monkeypatch):
    monkeypatch.setattr(incremental, "MAX_BLOCK", BLOCK)


@pytest.fixture(scope="module")
def files(run, tmp_path_factory):
    """A run in two files, of 20 and 41 frames."""
    folder, paths = tmp_path_factory.mktemp("runs"), []
    for part in (slice(0, 20), slice(20, None)):
        own = {name: getattr(run, name)[part] for name in (
            "times", "displacements", "velocities", "kinetic", "strain", "external", "dissipated", "steps"
        )}  # fmt: skip
        reactions = {name: force[part] for name, force in run.reactions.items()}
        paths.append(folder / f"{len(paths)}.h5")
        replace(run, **own, reactions=reactions).save(paths[-1])
    return paths


def blocks(snapshots, size=BLOCK):
    return (snapshots[k : k + size].copy() for k in range(0, len(snapshots), size))


@pytest.mark.parametrize("allowed", [0.0, 1e-8, 1e-4])
def test_singular_values_are_within_the_bound_and_never_too_large(snapshots, weights, allowed):
    roots = np.repeat(np.sqrt(weights), 3)
    rows = snapshots.reshape(70, -1) * roots
    exact = np.linalg.svd(rows, compute_uv=False)
    found = decompose(blocks(snapshots), lambda u: u * weights[:, None], allowed)
    assert (found.dropped > 0) == (allowed > 0)
    assert found.dropped <= 9 * allowed
    values = np.zeros(70)
    values[: len(found.values)] = found.values[:70]
    rounding = 1e-14 * exact[0] ** 2
    assert np.all(values**2 <= exact**2 + rounding)
    assert np.all(exact**2 - values**2 <= found.dropped + rounding)


@pytest.mark.parametrize("count", [3, 10, 20])
@pytest.mark.parametrize("allowed", [0.0, 1e-8])
def test_the_reported_projection_error_is_the_true_one(snapshots, weights, allowed, count):
    roots = np.repeat(np.sqrt(weights), 3)
    rows = snapshots.reshape(70, -1) * roots
    found = decompose(blocks(snapshots), lambda u: u * weights[:, None], allowed, least=count)
    q, _ = np.linalg.qr((found.shapes(count).reshape(count, -1) * roots).T)
    missed = np.sum((rows - (rows @ q) @ q.T) ** 2)
    best = np.sum(np.linalg.svd(rows, compute_uv=False)[count:] ** 2)
    assert best * (1 - 1e-9) <= missed <= np.sum(found.values[count:] ** 2) + found.dropped + 1e-14
    assert missed <= best + found.dropped + 1e-14


def test_a_pod_by_blocks_equals_that_of_all_snapshots(snapshots, weights, small_blocks, monkeypatch):
    found = pt.pod(snapshots, weights, modes=12)
    monkeypatch.setattr(incremental, "MAX_BLOCK", 800)
    exact = pt.pod(snapshots, weights, modes=12)
    np.testing.assert_allclose(found.singular_values[:12], exact.singular_values[:12], rtol=1e-6)
    flat = [(basis.modes * np.sqrt(weights)[:, None]).reshape(12, -1) for basis in (found, exact)]
    np.testing.assert_allclose(flat[0] @ flat[0].T, np.eye(12), atol=1e-12)
    cosines = np.linalg.svd(flat[0] @ flat[1].T, compute_uv=False)
    assert cosines.min() > 1 - 1e-6
    assert found.lost_energy == pytest.approx(exact.lost_energy, rel=0.05)
    assert found.dropped > 0


def test_snapshots_from_files_equal_those_in_memory(run, files):
    stored = Snapshots(files)
    assert (len(stored), stored.lengths, stored.nodes) == (61, [20, 41], len(run.points))
    np.testing.assert_array_equal(np.concatenate(list(stored.blocks(9))), run.displacements)
    which = np.array([0, 19, 20, 60])
    np.testing.assert_array_equal(np.array(list(stored.each(which))), run.displacements[which])


def test_modes_from_files_are_those_from_memory_bit_by_bit(files, held):
    together = [pt.Trajectory.load(path) for path in files]
    stored, loaded = pt.pod(files, held.weights, modes=4), pt.pod(together, held.weights, modes=4)
    np.testing.assert_array_equal(stored.modes, loaded.modes)


def test_the_products_of_strain_are_those_of_the_gradients(held):
    u, v = np.random.default_rng(0).normal(size=(2, len(held.cloud), 3))
    expected = np.einsum("n,ncd,ncd->", held.volumes, held.stencils.gradient(u), held.stencils.gradient(v))
    found = np.sum(u * (held.stencils.products(held.volumes) @ v))
    size = np.sqrt(np.prod([np.sum(w * (held.stencils.products(held.volumes) @ w)) for w in (u, v)]))
    assert abs(found - expected) < 1e-12 * size


def test_modes_of_strain_by_blocks_span_those_of_all_snapshots(run, held, monkeypatch):
    body = held.energy_form()
    whole, _ = main_modes(body, run.displacements, 6)
    monkeypatch.setattr(incremental, "MAX_BLOCK", BLOCK)
    found, lost = main_modes(body, Snapshots(run), 6)
    assert 0.0 < lost <= incremental.DROP_TOLERANCE
    angles = subspace_angles(found.reshape(6, -1).T, whole.reshape(6, -1).T)
    assert np.cos(angles).min() > 1 - 1e-6


def test_a_model_trained_on_files_equals_one_trained_in_memory(bar, tissue, files, calm):
    body = pt.Solid(bar, tissue, fixed="x-", form="energy", stiffness_damping=calm)
    stored = pt.hyper_reduce(body, files, modes=4)
    loaded = pt.hyper_reduce(body, [pt.Trajectory.load(path) for path in files], modes=4)
    np.testing.assert_array_equal(stored.data.trial_and_test_basis, loaded.data.trial_and_test_basis)
    np.testing.assert_array_equal(stored.data.cubature.weights, loaded.data.cubature.weights)


@pytest.mark.parametrize("change", ["missing", "truncated", "text"])
def test_files_that_are_not_a_run_are_refused(files, tmp_path, held, change):
    path = tmp_path / "run.h5"
    content = files[0].read_bytes()
    if change != "missing":
        path.write_bytes(content[: len(content) // 2] if change == "truncated" else b"text")
    with pytest.raises(FileNotFoundError if change == "missing" else pt.FileFormatError, match="run"):
        pt.pod([files[0], path], held.weights, modes=2)


def test_runs_of_different_bodies_are_refused(files, free, held, tmp_path):
    other = pt.rollout(free, [pt.Gravity()], duration=1e-3, every=1e-3)
    with pytest.raises(pt.InputError, match="must have the same nodes"):
        pt.pod([files[0], other], held.weights, modes=2)
