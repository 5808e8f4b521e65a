"""The drawn surface of a cut body: the line of the cut follows both of its rims."""

from __future__ import annotations

import numpy as np
import pytest

import palpate as pt
from palpate.meshfree.cut.surface import swept
from palpate.realtime.bodies.cut_display import CutFullSurface
from palpate.realtime.bodies.full_surface import FullSurface

SIZE, SPACING, PLACE = (0.05, 0.04, 0.02), 5e-3, 0.0213
START, END, DEPTH = 0.0112, 0.0388, 6e-3
NOTHING = np.zeros(0, dtype=int), np.zeros((0, 3)), np.zeros(0, dtype=bool), np.zeros(0, dtype=int)
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module", params=[0.0, 0.2], ids=["regular", "irregular"])
def shown(request):
    """The surface of a block with a straight cut at a y, from one x to another."""
    tissue = pt.materials.MooneyRivlin(C1=1500.0, C2=0, density=1060.0, poisson=0.45)
    block = pt.Solid(pt.box(SIZE, SPACING, jitter=request.param), tissue, fixed="z-")
    x = np.linspace(START, END, 13)
    rows = [
        np.column_stack([x, np.full(13, PLACE), np.full(13, SIZE[2] + z)]) for z in (4e-3, 0.0, -0.5 * DEPTH, -DEPTH)
    ]
    opened = pt.cut(block, swept(np.array(rows)))
    return CutFullSurface(opened, FullSurface(block))


def line_places(shown, positions):
    """The ends (l, 2, 3) of the pieces of the line for positions of the vertices."""
    ends = shown.cut_line.ends.reshape(-1, 2, 2).astype(float)
    shares = np.concatenate([1.0 - ends.sum(axis=2, keepdims=True), ends], axis=2)
    assert shares.min() > -1e-6
    return np.einsum("lek,lkc->lec", shares, positions[shown.cut_line.corners])


def test_the_line_is_that_of_the_cut(shown):
    length, area, depth = shown.cut_measures
    assert length == pytest.approx(END - START, rel=1e-4)
    assert area == pytest.approx((END - START) * DEPTH, rel=1e-4)
    assert depth == pytest.approx(DEPTH, rel=1e-4)
    places = line_places(shown, shown.rest.astype(float))
    np.testing.assert_allclose(places[..., 1:], np.broadcast_to([PLACE, SIZE[2]], (*places.shape[:2], 2)), atol=1e-6)
    assert places[..., 0].min() == pytest.approx(START, abs=1e-6)
    assert places[..., 0].max() == pytest.approx(END, abs=1e-6)


def test_the_line_goes_with_both_rims_of_a_cut_that_opens(shown):
    parted = 1e-3 * np.sign(shown.model.cloud.points[:, 1] - PLACE)[:, None] * [0.0, 1.0, 0.0]
    positions = shown.rest + shown.displacements(parted.ravel(), *NOTHING)
    places = line_places(shown, positions.astype(float))
    lengths = np.linalg.norm(places[:, 1] - places[:, 0], axis=1)
    for side in (-1.0, 1.0):
        rim = np.all(side * (places[..., 1] - PLACE) > 5e-4, axis=1)
        assert lengths[rim].sum() > 0.4 * (END - START)  # the drawn cut closes in the triangles of its ends
