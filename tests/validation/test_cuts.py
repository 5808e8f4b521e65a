"""Cracks with closed forms and random cuts, on coarse clouds; docs/claims/cuts.md has the figures of the study."""

from __future__ import annotations

import cut_cracks
import cut_stability
import cut_strip
import cut_taut
import numpy as np
import pytest

MAX_SHORTER = 1.5  # times by which a cut may shorten the stable step


@pytest.mark.slow
def test_a_penny_of_five_spacings_opens_and_releases_energy_like_the_closed_form():
    (row,) = cut_cracks.penny(5, [0.45], (0.0, 0.0, 1.0), 0.0, 2.0)
    assert row["center"] == pytest.approx(0.0, abs=0.05)
    assert row["release"] == pytest.approx(0.0, abs=0.05)
    assert row["half"] == pytest.approx(0.0, abs=0.07)


@pytest.mark.slow
def test_a_strip_releases_its_energy_per_area():
    row = cut_strip.strip("neo-Hookean", 0.25, 0.0, moving=False, way=2.0)
    assert row["release"] == pytest.approx(0.0, abs=0.05)
    for step in ("0.25", "0.5", "1"):  # at fixed displacements a step of at most a spacing makes no energy
        change = row["changes"][step]
        assert -1.0 < change["low"] <= change["high"] < 0.0


@pytest.mark.slow
@pytest.mark.parametrize("case", [("strip", 0.05, 2e-3, 0.1), ("edge crack", 1200.0, 2e-3, 0.05)])
def test_a_blade_in_taut_tissue_has_the_force_that_the_front_leaves_it(case):
    row = cut_taut.compared(*case)
    assert row["released"][1] > 0.2
    assert len(row["force"]) >= 2
    assert np.abs(row["force"]).max() < 0.06
    assert np.abs(row["cost"]).max() < 0.05
    assert row["across"] < 0.05  # of a push that cuts


@pytest.mark.slow
@pytest.mark.each_kind(seed=[3])
@pytest.mark.parametrize("seed", [3, 4, 20])  # through, a sliver, and less than a spacing from an open cut
def test_a_random_cut_makes_no_energy(seed):
    check(cut_stability.run("box", 0.45, seed))


def check(row):
    """Assert that a cut made no energy and that its step is not much shorter."""
    assert row["stable"], row
    assert row["growth"] <= 0.0, row
    assert row["step_ratio"] <= MAX_SHORTER, row


@pytest.mark.slow
@pytest.mark.parametrize("place", cut_cracks.PLANES)
def test_uniform_stress_along_a_cut_of_an_irregular_cloud_moves_no_node(place):
    assert cut_cracks.patch(place, cut_cracks.JITTER)["cut"] <= 2e-5
    assert cut_cracks.patch(place, 0.0)["change"] <= 2e-5


@pytest.mark.slow
def test_halves_turn_apart_without_energy():
    row = cut_cracks.halves(cut_cracks.JITTER)
    assert abs(row["energy"]) <= 1e-14
    assert row["force"] <= 1e-10


@pytest.mark.slow
@pytest.mark.release
@pytest.mark.parametrize("law", ["Ogden"])  # others in docs/claims/cuts.md
def test_strips_of_other_laws_release_their_energy_at_large_strain(law):
    assert abs(cut_strip.strip(law, 0.5, cut_cracks.JITTER, moving=False, way=2.0)["release"]) <= 0.05


@pytest.mark.slow
@pytest.mark.release
@pytest.mark.parametrize("seed", [14, 17])  # others in docs/claims/cuts.md
def test_random_cuts_of_nearly_incompressible_tissue_make_no_energy(seed):
    check(cut_stability.run("box", 0.49, seed))


@pytest.mark.slow
@pytest.mark.each_kind(seed=[2])
@pytest.mark.parametrize("seed", [2, 48])  # across an open cut, and 0.4 spacings from it
def test_a_blade_that_meets_an_open_cut_makes_little_energy(seed):
    row = cut_stability.advance("box", 0.45, seed)
    assert row["made"] <= 0.05
    assert row["end"] <= 1.0
