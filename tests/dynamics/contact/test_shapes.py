"""The shapes of tools: distances, normals and outlines agree, and the table by kind makes them."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.dynamics.contact.geometry import signed_distance
from palpate.dynamics.contact.shapes import TOOLS, make_tool, tool_parameters

DRAWN = {name: kind.usual for name, kind in TOOLS.items() if hasattr(kind.shape, "outline")}


def usual(name):
    """Return the tool of a kind with usual parameters, and its distance and normal at a point."""
    tool = make_tool(name, TOOLS[name].usual)
    return tool, lambda point: signed_distance(tool.kind, np.array(tool.sizes), *point)


@pytest.mark.parametrize("name", DRAWN)
def test_the_outline_of_a_shape_is_on_its_surface(name):
    tool, distance = usual(name)
    gaps = [distance((radius, 0.0, height))[0] for radius, height in tool.outline]
    np.testing.assert_allclose(gaps, 0.0, atol=1e-12 * tool.outline.max())


@pytest.mark.parametrize("name", DRAWN)
def test_the_normal_is_the_gradient_of_the_distance_and_has_length_1(name):
    _, distance = usual(name)
    points, step = np.random.default_rng(0).uniform(-0.05, 0.05, (50, 3)), 1e-6
    for point in points:
        _, *normal = distance(point)
        slopes = [(distance(point + step * e)[0] - distance(point - step * e)[0]) / (2 * step) for e in np.eye(3)]
        np.testing.assert_allclose(normal, slopes, atol=1e-6)
        assert np.linalg.norm(normal) == pytest.approx(1.0)


@pytest.mark.parametrize("name", DRAWN)
def test_the_distance_is_positive_outside_the_outline_and_grows_away_from_it(name):
    tool, distance = usual(name)
    extent = np.abs(tool.outline).max()
    for direction in ((1.0, 0.0, 0.0), (0.0, 0.6, 0.8), (0.0, 0.0, -1.0)):
        near, far = (distance(3 * k * extent * np.array(direction))[0] for k in (1, 2))
        assert near > 0
        assert far - near == pytest.approx(3 * extent, rel=0.1)


@pytest.mark.parametrize("name", TOOLS)
def test_each_parameter_of_a_kind_is_a_declared_number_with_a_usual_value_in_its_range(name):
    for parameter, value in TOOLS[name].usual.items():
        about, _ = tool_parameters()[parameter]
        assert about["low"] <= value <= about["high"]
        assert about["help"]


@pytest.mark.parametrize("name", DRAWN)
@pytest.mark.parametrize("wrong", [-0.001, 0.0, np.nan, np.inf, "5 mm", None])
def test_a_wrong_size_is_refused_by_name_with_its_range_and_what_to_give(name, wrong):
    for parameter in TOOLS[name].usual:
        with pytest.raises(pt.InputError, match=rf"{parameter} of a \w+ must be .*, got .*; give .* \[m\]"):
            make_tool(name, {**TOOLS[name].usual, parameter: wrong})
