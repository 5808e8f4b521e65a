"""The paper's membrane, as printed."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.scenes.membrane import AFTER, membrane, tool_tip

pytestmark = pytest.mark.slow

COARSE = 0.02


@pytest.fixture(scope="module")
def case():
    return membrane(spacing=COARSE)


@pytest.mark.parametrize("time", [0.0, 0.03, 0.0999, 0.1001, 0.15, 0.2])
def test_the_tool_tip_is_equation_35(time):
    assert tool_tip(time) == pytest.approx(0.1 * time if time < 0.1 else 0.0, abs=1e-15)


@pytest.mark.parametrize("after", AFTER)
def test_the_tool_tip_is_at_its_height_when_it_stops(after):
    for time in (0.1, sum(1000 * [1e-4])):  # as printed, and with the rounding of a run
        assert tool_tip(time, after) == pytest.approx(0.01)


def test_the_tool_tip_can_be_held():
    assert tool_tip(0.15, "hold") == pytest.approx(0.01)


def test_the_tool_tip_does_not_move_before_the_run():
    assert tool_tip(-0.1) == 0.0


def test_the_sheet_has_the_size_mass_and_stiffness_printed(case):
    model = case.model
    assert np.linalg.norm(model.cloud.points, axis=1).max() == pytest.approx(0.1)
    assert model.masses.sum() == pytest.approx(1200 * np.pi * 0.1**2 * 1e-5)
    assert model.material.shear_modulus == pytest.approx(2 * 0.17e6)
    assert model.fixed == ("rim",)
    assert (case.duration, case.every) == (0.2, 0.002)


def test_the_tool_moves_the_central_node_across_the_sheet(case):
    cloud = case.model.cloud
    np.testing.assert_array_equal(cloud.group("tool"), cloud.group("centre"))
    prepared = case.model.prepare(case.loads)
    schedule = prepared.schedule(np.array([0.05, 0.2]))
    np.testing.assert_allclose(schedule.motion[:, 0], [(0.0, 0.0, 0.005), (0.0, 0.0, 0.0)])
    assert schedule.constrained.all()


def test_a_wide_tool_moves_all_nodes_within_its_radius():
    cloud = membrane(spacing=COARSE, tool_radius=0.04).model.cloud
    within = np.flatnonzero(np.linalg.norm(cloud.points, axis=1) < 0.041)
    np.testing.assert_array_equal(cloud.group("tool"), within)
    assert len(within) == 1 + 6 + 12


def test_a_tool_lets_go_after_a_tenth_of_a_second():
    case = membrane(spacing=COARSE, after="release")
    holds = case.model.prepare(case.loads).schedule(np.array([0.1, 0.1001])).constrained[:, 0]
    np.testing.assert_array_equal(holds, [True, False])


def test_the_scene_has_its_parameters():
    case = membrane(spacing=COARSE, tool_radius=0.02, prestretch=1.2, layout="hexagonal", jitter=0.1, seed=3)
    expected = {"spacing": COARSE, "tool_radius": 0.02, "prestretch": 1.2, "jitter": 0.1, "seed": 3}
    expected |= {"after": "return", "layout": "hexagonal"}
    assert case.parameters == expected


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("spacing", 0.0),
        ("spacing", 1e-6),
        ("spacing", np.nan),
        ("spacing", 0.06),
        ("tool_radius", -0.01),
        ("tool_radius", 0.002),
        ("tool_radius", 0.09),
        ("prestretch", 0.5),
        ("jitter", 0.4),
        ("seed", -1),
        ("after", "stay"),
    ],
)
def test_values_out_of_range_are_refused_by_name(name, value):
    with pytest.raises(pt.InputError, match=rf"{name} must"):
        membrane(**{"spacing": COARSE, name: value})


def test_an_unknown_layout_is_refused():
    with pytest.raises(pt.InputError, match="layout"):
        membrane(spacing=COARSE, layout="random")
