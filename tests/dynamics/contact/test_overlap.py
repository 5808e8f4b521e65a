"""Tools that are in each other are found, and those that only touch or are apart are not."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.dynamics.contact.blade import Blade
from palpate.dynamics.contact.overlap import tools_overlap
from palpate.dynamics.contact.shapes import Capsule, Forceps, Plane, Punch, Sphere

UPRIGHT = (1.0, 0.0, 0.0, 0.0)
ALONG_X = (np.sqrt(0.5), 0.0, np.sqrt(0.5), 0.0)  # z of the tool to x
BALL, ROD, PUNCH = Sphere(0.01), Capsule(0.004, 0.06), Punch(0.008, 0.001)


def at(x, y, z, turn=UPRIGHT):
    return np.array([x, y, z, *turn])


@pytest.mark.parametrize(
    ("tool", "pose", "other", "turn", "apart"),
    [  # of tools that touch each other, the other at the origin, and the direction in which they part
        (BALL, at(0.02, 0, 0), BALL, UPRIGHT, (1, 0, 0)),
        (BALL, at(0.014, 0, 0), ROD, UPRIGHT, (1, 0, 0)),
        (BALL, at(0, 0, 0.044), ROD, UPRIGHT, (0, 0, 1)),
        (ROD, at(0, 0.008, 0), ROD, ALONG_X, (0, 1, 0)),
        (BALL, at(0, 0, -0.01), PUNCH, UPRIGHT, (0, 0, -1)),
        (BALL, at(0.018, 0, 0.1), PUNCH, UPRIGHT, (1, 0, 0)),
        (PUNCH, at(0.016, 0, 0.05), PUNCH, UPRIGHT, (1, 0, 0)),
        (BALL, at(0, 0, 0.01), Plane(), UPRIGHT, (0, 0, 1)),
    ],
)
def test_tools_overlap_from_their_touch_on(tool, pose, other, turn, apart):
    way, fixed = 1e-4 * np.array([*apart, 0, 0, 0, 0]), (other, at(0, 0, 0, turn))
    for moved, expected in ((pose + way, False), (pose - way, True)):
        assert tools_overlap(tool, moved, *fixed) is expected
        assert tools_overlap(*fixed, tool, moved) is expected


def test_a_ball_deep_in_another_is_found():
    assert tools_overlap(Sphere(0.002), at(0, 0, 0), Sphere(0.05), at(0, 0, 0.01))


def test_blades_and_forceps_have_no_extent():
    blade = Blade(edge=[(-0.02, 0, 0), (0.02, 0, 0)], toughness=1.0)
    for tool in (blade, Forceps(0.01, (0, 0, 0))):
        assert not tools_overlap(tool, at(0, 0, 0), BALL, at(0, 0, 0))
