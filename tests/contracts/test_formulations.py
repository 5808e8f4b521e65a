"""The contract of every formulation with an energy: its points, pressures and stress are those of its forces."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from contract_models import FIBRES, MODES, RELAXING, block, lean, membrane, mirrored, pull, run, solid

import palpate as pt
from palpate.dynamics.nodal.energy_model import EnergyModel

QUICK = ["solid", "strong"]
pytestmark = [
    pytest.mark.quick(name=QUICK),
    pytest.mark.each_kind(name=[*QUICK, "mirrored", "membrane", "relaxing", "fibres", "membrane at rest"]),
]


def everything() -> pt.Solid:
    """Return a block with all that tissue may have at once."""
    series = pt.materials.Prony(shares=(0.6,), times=(5e-3,))
    common = {"density": 1000.0, "prony": series, "volumetric": "logarithmic", "split": "isochoric"}
    laws = {
        "": pt.materials.Gent(mu=10e3, Jm=3.0, poisson=0.45, **common),
        "x+": pt.materials.Gent(mu=25e3, Jm=0.9, poisson=0.4, **common),
    }
    fibres = pt.materials.Fibres(k1=5e3, k2=2.0, dispersion=0.1, directions=(1.0, 0.0, 0.0))
    return pt.Solid(block(), laws, "x-", stiffness={"y+": 3.0}, stiffness_damping=1e-5, fibres=fibres)


def sheet(**options) -> pt.Membrane:
    full = membrane()
    return pt.Membrane(full.cloud, full.material, 1e-3, "rim", stiffness_damping=1e-5, **options)


FORMULATIONS = {
    "solid": lambda: solid("energy"),
    "strong": lambda: solid("strong").energy_form(),
    "relaxing": lambda: solid("energy", RELAXING),
    "fibres": lambda: solid("energy", fibres=FIBRES),
    "everything": everything,
    "mirrored": mirrored,
    "membrane": membrane,
    "membrane at rest": sheet,
    "membrane without wrinkles": lambda: sheet(prestretch=1.02, relaxed=False),
}


@pytest.fixture(scope="module", params=FORMULATIONS)
def name(request):
    return request.param


@pytest.fixture(scope="module")
def body(name):
    return FORMULATIONS[name]()


@pytest.fixture(scope="module")
def fields(body):
    """Random displacements (t, n, 3) on the supports, more than there are nodes."""
    n = len(body.cloud)
    random = np.random.default_rng(0).standard_normal((n + 10, n, 3))
    return body.supported.project(0.01 * body.cloud.spacing * random)


def test_a_body_with_an_energy_is_its_own_energy_form(body):
    assert isinstance(body, EnergyModel)
    assert body.energy_form() is body


def test_the_energy_form_of_the_strong_form_is_the_same_body():
    strong = solid("strong", alpha=3.0)
    body = strong.energy_form()
    assert isinstance(body, EnergyModel)
    assert body.cloud is strong.cloud
    for name in ("material", "supports", "stiffness_damping", "mass_damping", "neighbours", "kinematics"):
        assert getattr(body, name) == getattr(strong, name)


def test_points_share_out_the_volume(body, fields):
    points = body.at_points(fields[:2])
    np.testing.assert_allclose(np.bincount(points.nodes, points.volumes), body.elastic_volumes, rtol=1e-12)


def test_the_inner_product_is_symmetric_and_positive(body, fields):
    some = fields[:4]
    products = np.einsum("anc,bnc->ab", some, body.inner_product()(some))
    np.testing.assert_allclose(products, products.T, atol=1e-12 * np.abs(products).max())
    assert np.linalg.eigvalsh(products).min() > 0


def test_forces_and_energy_of_all_points_and_pressures_are_those_of_the_body(body, fields):
    """The defining identity of hyper-reduction. As many modes as nodes hold every pressure."""
    loads = [lean() if body.kinematics.sheet else pull()]
    data = pt.hyper_reduce(body, run(body, loads), modes=MODES, cubature=0.0).data
    pressure = body.pressure_moments(fields, len(body.cloud))
    if len(pressure):
        cubature = replace(data.cubature, pressure=pressure)
        data = replace(data, sampled=replace(data.sampled, cubature=cubature))
    whole = pt.ReducedModel(data, single=False)
    columns, random = data.trial_and_test_basis[: whole.count], np.random.default_rng(1)
    whole.state(whole.prepare(loads))
    for size in (1e-4, 1e-3):
        a = size * random.uniform(-1, 1, whole.count) / whole.body.sizes
        u = np.tensordot(a, columns, 1)
        expected = np.einsum("n,mnc,nc->m", body.volumes, columns, body.force(u))
        np.testing.assert_allclose(whole.body.force(a), expected, atol=1e-9 * np.abs(expected).max())
        assert whole.body.energy(a) == pytest.approx(body.strain_energy(u), rel=1e-9)
