"""What is to be changed about models with large errors, by their figures."""

from __future__ import annotations

import warnings
from functools import cache

import numpy as np
import pytest

import palpate as pt
from palpate.reduction.training.advice import advice


def report(modes=24, runs=16, explained=0.9, failed=0, force=0.4, surface=0.1, contact=True, known=0.05, unseen=0.06):
    """A report of a model with some figures."""
    mean = {"force": force, "surface_95": surface} if contact else {"displacement": force, "reaction": surface}
    held = {"runs": [{"failed": k < failed} for k in range(4)], "projection_error": unseen, "mean": mean}
    return {
        "modes": modes, "training_runs": runs, "compliance_explained": explained, "projection_error": known,
        "held_out": held | ({"contact": {"mean": mean}} if contact else {}),
    }  # fmt: skip


@pytest.mark.parametrize(
    ("figures", "parts", "others"),
    [
        ({"modes": 12}, ["40% in force and 10% in surface", "use more modes than 12"], ["paths", "spacing"]),
        ({"modes": 64, "runs": 4}, ["use more paths than 4"], ["modes than", "spacing"]),
        ({"modes": 64, "explained": 0.2}, ["smaller spacing or a larger tool", "explains 20%"], ["paths than"]),
        ({"modes": 64}, ["use a smaller depth"], ["paths than", "modes than"]),
        ({"contact": False, "known": 0.3}, ["40% in displacement", "use more modes than 24"], ["paths than"]),
        ({"contact": False, "unseen": 0.3}, ["use more paths than 16", "30% of the held-out"], ["modes than"]),
        ({"contact": False}, ["use more modes than 24"], ["paths than"]),
        ({"failed": 1, "force": np.inf}, ["failed on 1 of 4", "use more paths than 16 or more modes than 24"], []),
    ],
)
def test_the_change_follows_from_the_figures(figures, parts, others):
    text = advice(report(**figures))
    assert all(part in text for part in parts)
    assert not any(part in text for part in others)


@pytest.mark.parametrize("contact", [True, False])
def test_small_errors_need_no_change(contact):
    assert advice(report(force=0.3, surface=0.3, contact=contact)) is None
    assert advice(report(force=0.3, surface=0.31, contact=contact)) is not None


@cache
def bar_with_runs():
    """A bar with two runs, pulled along it and across."""
    tissue = pt.materials.MooneyRivlin(C1=20e3, C2=0.0, density=1000.0, poisson=0.4)
    body = pt.Solid(pt.box((0.02, 0.015, 0.015), 0.005), tissue, "x-")
    loads = [
        [pt.SurfaceForce("x+", force=lambda t, aim=aim: np.sin(np.pi * t / 0.02) ** 2 * np.array(aim))]
        for aim in ((0.3, 0.0, 0.0), (0.0, 0.3, 0.0))
    ]
    return body, [(each, pt.rollout(body, each, duration=0.02, every=0.001)) for each in loads]


def test_a_model_that_has_not_seen_the_motion_warns_and_keeps_the_advice():
    body, ((pull, seen), (push, unseen)) = bar_with_runs()
    with pytest.warns(pt.TrustWarning, match="in displacement and .* use more paths than 1") as caught:
        model = pt.hyper_reduce(body, seen, modes=3, held_out=[(push, unseen)])
    assert caught[0].filename == __file__
    assert model.report["advice"] == str(caught[0].message)
    assert model.report["cubature"] == 1e-3  # the default without tools in contact
    found = model.report["held_out"]
    missed = unseen.displacements - np.tensordot(
        model.body.project(unseen.displacements), model.data.trial_and_test_basis[:3], 1
    )
    expected = np.linalg.norm(missed) / np.linalg.norm(unseen.displacements)
    assert found["projection_error"] == pytest.approx(expected)
    assert expected > 0.5
    with warnings.catch_warnings(action="error"):
        assert "advice" not in pt.hyper_reduce(body, [seen, unseen], modes=8, held_out=[(pull[0], seen)]).report
