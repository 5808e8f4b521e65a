"""The loop of a device at a late wall: its energy against the closed form, and what the controller takes away."""

from __future__ import annotations

import haply
import pytest


@pytest.mark.parametrize(("stiffness", "delay"), [(200.0, 0.0), (1000.0, 2e-3)])
def test_a_late_wall_needs_the_damping_of_the_closed_form(stiffness, delay):
    assert haply.needed_damping(stiffness, delay, False) == pytest.approx(
        stiffness * (1.5 * haply.PERIOD + delay), rel=0.01
    )
    assert haply.needed_damping(stiffness, delay, True) == pytest.approx(stiffness * 1.5 * haply.PERIOD, rel=0.01)


def test_the_account_makes_a_wall_passive_that_is_not():
    alone = haply.press(3000.0, 3e-3, 0.1, local=False, account=False, seconds=1.0)
    whole = haply.press(3000.0, 3e-3, 0.1, local=True, account=True, seconds=1.0)
    assert alone["end"] > 0.05  # [J]
    assert whole["most"] < 1e-3


def test_a_soft_wall_is_left_as_it_is():
    without, whole = (haply.press(100.0, 1e-3, 0.2, True, account, seconds=1.0) for account in (False, True))
    assert whole["acceleration"] == pytest.approx(without["acceleration"], rel=0.5)
    assert whole["most"] < 1e-5
