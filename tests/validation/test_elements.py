"""Full bodies of 1,600 nodes against the finite elements of docs/validation/elements_truth.json.

The bounds are the errors that docs/claims/elements.md states, rounded up.
"""

from __future__ import annotations

import elements
import elements_cases
import numpy as np
import pytest
import result_files

pytestmark = pytest.mark.slow

SCALE = 1.26  # of the spacing of 3,000 nodes
BOUNDS = {  # of the frequencies, sag, patch and smooth pressure
    "generated": (0.025, 0.03, 0.05, 0.08),
    "slab": (0.015, 0.03, 0.08, 0.03),
    "kidney": (0.04, 0.08, 0.04, 0.02),
}


@pytest.fixture(scope="module")
def truths():
    return result_files.read("elements_truth", {})["cases"]


def case(name):
    try:
        return elements_cases.case(name)
    except FileNotFoundError as error:
        pytest.skip(str(error))


@pytest.mark.parametrize("name", BOUNDS)
def test_linear_responses_agree_with_finite_elements(name, truths):
    case(name)
    row = elements.compare(name, {**truths[name], "balls": []}, SCALE, seed=0)
    assert 1450 < row["nodes"] < 1850
    for quantity, bound in zip(("frequencies", "sag", "patch", "smooth"), BOUNDS[name], strict=True):
        assert np.abs(row[quantity]).max() < bound, quantity


def test_the_force_of_a_small_ball_agrees_with_finite_elements(truths):
    balls = [ball for ball in truths["slab"]["balls"] if ball["radius"] == 0.0099]
    row = elements.compare("slab", {"frequencies": truths["slab"]["frequencies"], "balls": balls}, SCALE, seed=0)
    assert 1.1 < row["balls"][0]["radius"] < 1.3
    assert np.abs(row["balls"][0]["errors"]).max() < 0.13
