"""Errors of runs that are known beforehand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import palpate as pt
from palpate.reduction.training.errors import contact_errors


def test_a_run_has_no_error_against_itself(run):
    assert pt.relative_errors(run, run).as_dict() == {"displacement": 0, "velocity": 0, "energy": 0, "reaction": 0}


def test_the_error_of_a_scaled_run_is_its_scale(run):
    other = replace(
        run,
        displacements=1.03 * run.displacements,
        velocities=0.9 * run.velocities,
        reactions={"x-": 1.2 * run.reactions["x-"]},
        kinetic=1.5 * run.kinetic,
        strain=1.5 * run.strain,
    )
    errors = pt.relative_errors(run, other)
    energy, force = run.kinetic + run.strain, np.linalg.norm(run.reactions["x-"], axis=1)
    assert errors.displacement == pytest.approx(0.03)
    assert errors.velocity == pytest.approx(0.1)
    assert errors.energy == pytest.approx(0.5 * energy.mean() / energy.max())
    assert errors.reaction == pytest.approx(0.2 * force.mean() / force.max())


def test_the_displacement_error_is_equation_34(run):
    other = replace(
        run, displacements=run.displacements + 1e-6 * np.random.default_rng(0).normal(size=run.displacements.shape)
    )
    per_snapshot = [
        np.linalg.norm(b - a, axis=1).sum() / np.linalg.norm(a, axis=1).sum()
        for a, b in zip(run.displacements[1:], other.displacements[1:], strict=True)  # the first does not move
    ]
    assert pt.relative_errors(run, other).displacement == pytest.approx(np.mean(per_snapshot))


def test_a_single_wrong_snapshot_counts_as_one_of_all(run):
    wrong = run.displacements.copy()
    wrong[7] *= 2
    assert pt.relative_errors(run, replace(run, displacements=wrong)).displacement == pytest.approx(1 / 60)


def test_the_reaction_error_is_that_of_the_worst_support(run):
    force = run.reactions["x-"]
    one = replace(run, reactions={"a": force, "b": force})
    other = replace(run, reactions={"a": force, "b": 2 * force})
    size = np.linalg.norm(force, axis=1)
    assert pt.relative_errors(one, other).reaction == pytest.approx(size.mean() / size.max())


def test_runs_at_rest_have_no_error(run):
    still = {name: 0 * getattr(run, name) for name in ("displacements", "velocities", "kinetic", "strain")}
    rest = replace(run, **still, reactions={"x-": 0 * run.reactions["x-"]})
    assert set(pt.relative_errors(rest, rest).as_dict().values()) == {0}


@pytest.mark.parametrize("change", ["times", "frames", "nodes"])
def test_runs_that_cannot_be_compared_are_refused(run, change):
    other = {
        "times": lambda: replace(run, times=1.1 * run.times),
        "frames": lambda: replace(run, times=run.times[:-1], displacements=run.displacements[:-1]),
        "nodes": lambda: replace(run, displacements=run.displacements[:, :-1]),
    }[change]()
    with pytest.raises(pt.InputError, match="different times or numbers of nodes"):
        pt.relative_errors(run, other)


def contact_scratch(run):
    """A run with two reactions of tools: one pushes ever harder, the other does nothing."""
    force = np.linspace(0.0, 1.0, len(run.times))[:, None] * [0.0, 0.0, -2.0]
    return replace(run, reactions={"ball": force, "idle": 0 * force})


def test_forces_of_tools_count_where_they_are_a_tenth_of_the_largest(run):
    full = contact_scratch(run)
    other = full.reactions["ball"] * 1.1
    other[: len(run.times) // 20] += 100.0  # while the tool hardly pushes
    nodes = np.arange(len(run.points))
    errors = contact_errors(full, replace(full, reactions=full.reactions | {"ball": other}), ["ball", "idle"], nodes)
    assert errors.force == pytest.approx(0.1)
    assert errors.force_95 == pytest.approx(0.1)
    assert errors.surface_95 == errors.farthest_95 == 0


def test_the_surface_is_measured_by_its_largest_displacement(run):
    full, nodes = contact_scratch(run), np.argsort(run.points[:, 0])[-3:]  # far from the support
    moved, distance_scale = run.displacements.copy(), np.linalg.norm(run.displacements[:, nodes], axis=2).max()
    moved[:, nodes[1]] += [0.0, 0.2 * distance_scale, 0.0]
    moved[:, np.argmin(run.points[:, 0])] += 1.0  # none of the surface asked for
    errors = contact_errors(full, replace(full, displacements=moved), ["ball"], nodes)
    assert errors.farthest_95 == pytest.approx(0.2)
    assert errors.surface_95 == pytest.approx(0.2)
    assert errors.force == errors.force_95 == 0


def test_tools_without_contact_have_no_errors(run):
    full = contact_scratch(run)
    assert contact_errors(full, full, ["idle"], np.arange(3)) is None
    assert contact_errors(full, full, [], np.arange(3)) is None
