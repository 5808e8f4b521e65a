"""Errors of runs that are known beforehand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import palpate as pt


def test_a_run_has_no_error_against_itself(run):
    assert pt.errors(run, run).as_dict() == {"displacement": 0, "velocity": 0, "energy": 0, "reaction": 0}


def test_a_scaled_run_is_wrong_by_its_scale(run):
    other = replace(
        run,
        displacements=1.03 * run.displacements,
        velocities=0.9 * run.velocities,
        reactions={"x-": 1.2 * run.reactions["x-"]},
        kinetic=1.5 * run.kinetic,
        strain=1.5 * run.strain,
    )
    found = pt.errors(run, other)
    energy, force = run.kinetic + run.strain, np.linalg.norm(run.reactions["x-"], axis=1)
    assert found.displacement == pytest.approx(0.03)
    assert found.velocity == pytest.approx(0.1)
    assert found.energy == pytest.approx(0.5 * energy.mean() / energy.max())
    assert found.reaction == pytest.approx(0.2 * force.mean() / force.max())


def test_the_displacement_error_is_equation_34(run):
    other = replace(
        run, displacements=run.displacements + 1e-6 * np.random.default_rng(0).normal(size=run.displacements.shape)
    )
    per_snapshot = [
        np.linalg.norm(b - a, axis=1).sum() / np.linalg.norm(a, axis=1).sum()
        for a, b in zip(run.displacements[1:], other.displacements[1:], strict=True)  # the first does not move
    ]
    assert pt.errors(run, other).displacement == pytest.approx(np.mean(per_snapshot))


def test_a_single_wrong_snapshot_counts_with_its_share(run):
    wrong = run.displacements.copy()
    wrong[7] *= 2
    assert pt.errors(run, replace(run, displacements=wrong)).displacement == pytest.approx(1 / 60)


def test_the_worst_support_counts(run):
    force = run.reactions["x-"]
    one = replace(run, reactions={"a": force, "b": force})
    other = replace(run, reactions={"a": force, "b": 2 * force})
    size = np.linalg.norm(force, axis=1)
    assert pt.errors(one, other).reaction == pytest.approx(size.mean() / size.max())


def test_runs_at_rest_have_no_error(run):
    still = {name: 0 * getattr(run, name) for name in ("displacements", "velocities", "kinetic", "strain")}
    rest = replace(run, **still, reactions={"x-": 0 * run.reactions["x-"]})
    assert set(pt.errors(rest, rest).as_dict().values()) == {0}


@pytest.mark.parametrize("change", ["times", "frames", "nodes"])
def test_runs_that_cannot_be_compared_are_refused(run, change):
    other = {
        "times": lambda: replace(run, times=1.1 * run.times),
        "frames": lambda: replace(run, times=run.times[:-1], displacements=run.displacements[:-1]),
        "nodes": lambda: replace(run, displacements=run.displacements[:, :-1]),
    }[change]()
    with pytest.raises(pt.InputError, match="different times or numbers of nodes"):
        pt.errors(run, other)
