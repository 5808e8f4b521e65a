"""The stated error of a force: of the nodes of this body, as far as it was measured."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from palpate.app.models.force_error import FORCE_STUDIES, force_error_text


@pytest.mark.parametrize("study", FORCE_STUDIES)
def test_the_errors_are_those_of_the_study(study):
    file = Path(__file__).parents[3] / "docs" / "validation" / "elements.json"
    rows = [
        (row["nodes"], ball)
        for row in json.loads(file.read_text(encoding="utf-8"))["results"]
        for ball in row["balls"]
        if study.radius - 0.05 < ball["radius"] < study.radius + 0.05 and row["case"] != "cylinder"
    ]
    errors = [abs(error) for _, ball in rows for error in ball["errors"][1:] if error is not None]
    nodes = [count for count, _ in rows]
    assert (min(nodes), max(nodes)) == (study.fewest, study.most)
    assert len(errors) > 10
    assert (np.median(errors), max(errors)) == pytest.approx((study.median, study.largest), abs=6e-4)


@pytest.mark.parametrize(("nodes", "text"), [
    (678, "not known for 678 nodes: 6 % in the median and 16 % at most on five organs of 1,582 to 1,799 nodes"),
    (1582, "6 % in the median and 16 % at most, measured on five organs of 1,582 to 1,799 nodes, with balls of 1.2 s"),
    (2309, "about 5 % in the median and 13 % at most, between those of five organs of 1,582 to 1,799 and 2,962 to"),
    (3000, "3 % in the median and 10 % at most, measured on five organs of 2,962 to 3,224 nodes, with balls of 1.5 s"),
    (12000, "not known for 12,000 nodes: 3 % in the median and 10 % at most on five organs of 2,962 to 3,224 nodes"),
])  # fmt: skip
def test_the_error_is_of_the_nodes_of_this_body(nodes, text):
    assert force_error_text(nodes).startswith(text)


def test_between_the_studies_errors_change_evenly():
    few, many = FORCE_STUDIES
    assert f"about {100 * few.largest:.0f} %" in force_error_text(few.most + 1).replace("6 % in the median and ", "")
    assert f"{100 * many.largest:.0f} % at most" in force_error_text(many.fewest - 1)
