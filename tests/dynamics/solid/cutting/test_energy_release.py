"""The energy release rate of a front by a domain integral: zero without a crack, and that of an edge crack."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

import palpate as pt
from palpate.dynamics.solid.cutting.energy_release import release_rate
from palpate.meshfree.cut.surface import swept

sys.path.append(str(Path(__file__).parents[4] / "validation"))

import cut_taut

pytestmark = pytest.mark.slow

SPACING, PLANE = 2e-3, 0.5 * cut_taut.SHEET[1] + 0.2e-3


def front(end, direction=(1.0, 0.0, 0.0)):
    """Pieces of a straight front through a sheet, their directions, and their lengths."""
    z = np.linspace(0.0, cut_taut.THICKNESS, 7)
    points = np.column_stack([np.full(7, end), np.full(7, PLANE), z])
    return np.stack([points[:-1], points[1:]], axis=1), np.tile(direction, (6, 1)), np.diff(z)


@pytest.mark.parametrize("end", [0.0, 1e-3, 10e-3])  # also where the domain ends at the surface
def test_a_front_in_uncut_tissue_under_uniform_strain_releases_nothing(end):
    cloud = pt.box((*cut_taut.SHEET, cut_taut.THICKNESS), SPACING, jitter=0.2)
    body = pt.Solid(cloud, cut_taut.TISSUE, ())
    u = cloud.points @ np.array([[0.1, 0.05, 0.0], [0.02, -0.1, 0.0], [0.0, 0.03, 0.06]])
    evaluation = body.evaluate(u)
    rate = release_rate(body, u, evaluation, *front(end))
    assert abs(rate) < 1e-3 * evaluation.energy_density.mean() * SPACING


@pytest.mark.parametrize("poisson", [0.3, 0.45])
def test_an_edge_crack_releases_the_energy_of_the_closed_form(poisson):
    tissue = pt.materials.MooneyRivlin(C1=16e3, C2=0.0, density=1000.0, poisson=poisson)
    cloud = pt.box((*cut_taut.SHEET, cut_taut.THICKNESS), SPACING)
    body = pt.Solid(cloud, tissue, [pt.Roller(side) for side in ("x+", "y-", "z-")])
    stress, end = 50.0, 10e-3  # [Pa], small strain
    force = stress * cut_taut.SHEET[0] * cut_taut.THICKNESS
    ends = np.array([-6e-3, end])[:, None]
    edges = np.stack(np.broadcast_arrays(ends, PLANE, np.linspace(-6e-3, 12e-3, 9)), axis=2)
    opened = pt.cut(body, swept(edges))
    u = pt.equilibrium(opened, [pt.SurfaceForce("y+", force=(0.0, force, 0.0))]).displacements
    rate = release_rate(opened, u, opened.evaluate(u), *front(end))
    expected = cut_taut.edge_crack(stress, np.array([end]), 2 * 16e3 * (1 + poisson))[0]
    assert rate == pytest.approx(expected, rel=0.05)
