"""Loads that cannot be, and what is said about them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import palpate as pt

MOVE = pt.PrescribedMotion("tip", (0, 0, 1e-4))


@pytest.mark.parametrize(
    ("load", "message"),
    [
        (lambda: pt.Traction("top", force=(1, 0, 0)), "unknown group 'top'"),
        (lambda: pt.PrescribedMotion("top", (0, 0, 0)), "unknown group 'top'"),
        (lambda: pt.Traction("x-", force=(1, 0, 0)), "'x-': .* fixed or driven"),
        (lambda: pt.PrescribedMotion("x-", (0, 0, 0)), "group 'x-': its nodes 0, 1, .* already fixed or driven"),
        (lambda: pt.PrescribedMotion("y-", (0, 0, 0)), "group 'y-'.*already fixed or driven"),
        (lambda: pt.Traction("x+"), "'x+'.*give either force .* or pressure"),
        (lambda: pt.Traction("x+", force=(1, 0, 0), pressure=1.0), "'x+'.*give either force .* or pressure"),
        (lambda: pt.Traction("x+", force=(1, 0)), "force of Traction on 'x+' must be "),
        (lambda: pt.Traction("x+", force="strong"), "force of Traction on 'x+' must be "),
        (lambda: pt.Traction("x+", force=lambda t: (1, 0)), "force of Traction on 'x+' must be "),
        (
            lambda: pt.Traction("x+", force=lambda t: (np.nan, 0, 0)),
            r"force of Traction on 'x\+' is not finite at t = 0",
        ),
        (
            lambda: pt.Traction("x+", force=lambda t: (1 / (t < 1e-4) if t < 1e-4 else np.inf, 0, 0)),
            "not finite at t = ",
        ),
        (lambda: pt.Traction("x+", pressure=lambda t: np.inf), r"pressure of Traction on 'x\+' is not finite"),
        (lambda: pt.Traction("x+", pressure=np.nan), r"pressure of Traction on 'x\+' is not finite"),
        (lambda: pt.Gravity((0, 0)), "acceleration of Gravity must be "),
        (lambda: pt.Gravity((0, 0, np.inf)), "acceleration of Gravity is not finite"),
        (lambda: pt.PrescribedMotion("tip", (np.nan, 0, 0)), "PrescribedMotion of 'tip' is not finite"),
        (lambda: pt.PrescribedMotion("tip", lambda p, t: p * np.nan), "PrescribedMotion of 'tip' is not finite"),
        (lambda: "push", "'push' is not a load: use Traction, Gravity or PrescribedMotion"),
    ],
)
def test_a_load_that_cannot_be_is_refused_by_name(held, load, message):
    with pytest.raises(pt.InputError, match=message.replace("'x+'", r"'x\+'")):
        pt.rollout(held, [load()], duration=1e-3, every=5e-4)


@pytest.mark.parametrize(
    "load",
    [
        pt.PrescribedMotion("tip", (0, 0)),
        pt.PrescribedMotion("tip", "down"),
        pt.PrescribedMotion("tip", lambda p, t: np.zeros((7, 3))),
        pt.Traction("x+", pressure="high"),
        pt.Traction("x+", pressure=lambda t: (1, 2, 3)),
    ],
)
def test_a_load_of_the_wrong_shape_is_refused_by_name(held, load):
    with pytest.raises(pt.InputError, match=load.group.replace("+", r"\+")):
        pt.rollout(held, [load], duration=1e-3, every=5e-4)


def test_two_motions_of_one_node_are_refused(held):
    with pytest.raises(pt.InputError, match=r"'tip'.*already fixed or driven"):
        pt.rollout(held, [pt.PrescribedMotion("x+", (0, 0, 0)), MOVE], duration=1e-3, every=5e-4)


def test_a_traction_on_a_driven_group_is_refused(held):
    loads = [pt.Traction("x+", force=(1, 0, 0)), pt.PrescribedMotion("x+", (0, 0, 0))]
    with pytest.raises(pt.InputError, match="fixed or driven; load another group"):
        pt.rollout(held, loads, duration=1e-3, every=5e-4)


def test_a_traction_on_nodes_that_are_no_face_is_refused(bar, tissue):
    inside = replace(bar, groups={**bar.groups, "deep": np.array([21, 22])})
    model = pt.FullModel(inside, tissue, viscosity=0.0)
    with pytest.raises(pt.InputError, match="'deep' does not lie on one face"):
        model.drive([pt.Traction("deep", force=(1, 0, 0))])


def test_tractions_on_one_group_add_up(held):
    loads = [pt.Traction("x+", force=(1, 0, 0)), pt.Traction("x+", force=(0, 2, 0)), pt.Gravity((0, 0, 1))]
    loads.append(pt.Traction("x+", pressure=1000.0))
    drive = held.drive(loads)
    total = held.external_force(held.state(drive), drive).sum(axis=0)
    np.testing.assert_allclose(total, (1 - 1000 * 0.015**2, 2, held.masses.sum()), rtol=1e-12)
