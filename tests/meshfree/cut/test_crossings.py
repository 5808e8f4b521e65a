"""Lines that cross triangles: a tree of boxes against all triangles, one at a time."""

from __future__ import annotations

import numpy as np
import pytest

from palpate.compiled.code_cache import cached_njit
from palpate.meshfree.cut.crossings import ANY_COMPONENT, crosses, first_crossings, triangle_tree

pytestmark = pytest.mark.slow

SPACING = 0.1


@cached_njit()
def _crossed(tree, lines, component, result):
    for k in range(len(lines)):
        a, b = lines[k, 0], lines[k, 1]
        result[k] = crosses(tree, a[0], a[1], a[2], b[0], b[1], b[2], component)


def crossed(triangles, components, lines, component=ANY_COMPONENT, *, in_boxes=True):
    tree, result = triangle_tree(triangles, components, SPACING), np.zeros(len(lines), dtype=np.bool_)
    if not in_boxes:  # every line meets them
        tree.boxes[:, 3:] = 1e3
    _crossed(tree, lines, component, result)
    return result


def sheet(random):
    """Triangles of a bent sheet, in random order."""
    x, y = (each.ravel() for each in np.meshgrid(np.arange(12.0), np.arange(9.0), indexing="ij"))
    corner = lambda i, j: np.column_stack([i, j, 0.3 * np.sin(i) + 0.1 * j])  # noqa: E731
    a, b, c, d = corner(x, y), corner(x + 1, y), corner(x + 1, y + 1), corner(x, y + 1)
    return SPACING * random.permutation(np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]))


def scattered(random, count=80):
    """Triangles of all sizes and directions, from a hundredth of the spacing to twelve spacings."""
    sizes = SPACING * 10.0 ** random.uniform(-2, 1, (count, 1, 1))
    return random.uniform(0, 12 * SPACING, (count, 1, 3)) + sizes * random.uniform(-1, 1, (count, 3, 3))


def lines_near(triangles, random, count=4000):
    """Lines in the box of triangles, some from their planes and corners, along axes, and without length."""
    low, high = triangles.min(axis=(0, 1)) - SPACING, triangles.max(axis=(0, 1)) + SPACING
    start = random.uniform(low, high, (count, 3))
    start[::3] = random.permuted(triangles.reshape(-1, 3), axis=0)[np.arange(len(start[::3])) % (3 * len(triangles))]
    on = random.dirichlet(np.ones(3), len(start[1::3]))
    start[1::3] = np.einsum("kc,kcd->kd", on, triangles[random.integers(len(triangles), size=len(on))])
    ways = SPACING * random.uniform(-3, 3, (count, 3))
    ways[::4, random.integers(3)] = 0.0
    ways[::5] *= [0.0, 0.0, 1.0]
    ways[:10] = 0.0
    return np.stack([start, start + ways], axis=1)


@pytest.mark.parametrize("make", [sheet, scattered])
@pytest.mark.parametrize("component", [ANY_COMPONENT, 1])
def test_boxes_change_no_crossing(make, component):
    random = np.random.default_rng(3)
    triangles = make(random)
    components, lines = random.integers(0, 3, len(triangles)), lines_near(triangles, random)
    pairs = zip(triangles, components, strict=True)
    each = [crossed(t[None], np.array([c]), lines, component, in_boxes=False) for t, c in pairs]
    expected = np.any(each, axis=0)
    assert 0.05 < expected.mean() < 0.95
    np.testing.assert_array_equal(crossed(triangles, components, lines, component), expected)


def test_lines_cross_where_the_first_crossing_has_a_share():
    random = np.random.default_rng(5)
    triangles = sheet(random)
    lines = random.uniform(0, 9 * SPACING, (2000, 2, 3)) * [1.0, 1.0, 0.1]
    shares = np.empty(len(lines))
    first_crossings(lines, triangles, shares)
    np.testing.assert_array_equal(crossed(triangles, np.zeros(len(triangles), np.int64), lines), np.isfinite(shares))


def test_nothing_crosses_a_tree_without_triangles():
    lines = np.random.default_rng(0).uniform(size=(10, 2, 3))
    assert not crossed(np.zeros((0, 3, 3)), np.zeros(0, np.int64), lines).any()
