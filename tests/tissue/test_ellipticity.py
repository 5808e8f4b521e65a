"""The check of a material's stability, against laws whose loss of ellipticity is known in closed form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.optimize import brentq

import palpate as pt
from palpate.tissue.ellipticity import material_stability, min_wave_modulus


@dataclass(frozen=True, kw_only=True)
class Softening(pt.materials.Material):
    """W = mu/(2b) (1 - exp(-b x)), x = I1 - 3 - 2 ln J.

    Incompressible, Q on a unit vector m across the deformed normal is 2 W1 |N|^2 + 4 W11 (m . F N)^2, with m . F N at
    most the difference of the largest and the least stretch: ellipticity is lost where 2 b (l1 - l3)^2 = 1.
    """

    mu: float = 1e4
    b: float = 2.0

    def _check_parameters(self):
        pass

    @property
    def shear_modulus(self):
        return self.mu

    @property
    def shear_bulk_modulus(self):
        return 2 / 3 * self.mu

    @staticmethod
    def energy(I1, I2, J, c):
        return -c[0] / (2 * c[1]) * np.expm1(-c[1] * (I1 - 3 - 2 * np.log(J)))

    @staticmethod
    def first(I1, I2, J, c):
        f = c[0] / 2 * np.exp(-c[1] * (I1 - 3 - 2 * np.log(J)))
        return f, 0.0, -2 * f / J

    @staticmethod
    def second(I1, I2, J, c):
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class Pressed(Softening):
    """The neo-Hookean energy without the term that frees rest of stress."""

    @staticmethod
    def energy(I1, I2, J, c):
        return c[0] / 2 * (I1 - 3)

    @staticmethod
    def first(I1, I2, J, c):
        return c[0] / 2, 0.0, 0.0


@dataclass(frozen=True, kw_only=True)
class Limited(Softening):
    """A law whose energy ends at I1 - 3 - 2 ln J = 1/b."""

    @staticmethod
    def energy(I1, I2, J, c):
        return -c[0] / (2 * c[1]) * np.log(1 - c[1] * (I1 - 3 - 2 * np.log(J)))

    @staticmethod
    def first(I1, I2, J, c):
        left = 1 - c[1] * (I1 - 3 - 2 * np.log(J))
        f = np.where(left > 0, c[0] / 2 / np.where(left > 0, left, 1), np.nan)
        return f, 0.0, -2 * f / J


@dataclass(frozen=True, kw_only=True)
class Falling(Softening):
    """A law with the wrong sign."""

    @staticmethod
    def energy(I1, I2, J, c):
        return -c[0] / 2 * (I1 - 3 - 2 * np.log(J))

    @staticmethod
    def first(I1, I2, J, c):
        return -c[0] / 2, 0.0, c[0] / J


SPREADS = {  # largest less least stretch of an incompressible specimen
    "uniaxial": lambda s: abs(s - s**-0.5),
    "equibiaxial": lambda s: abs(s - s**-2),
    "planar": lambda s: abs(s - 1 / s),
}


@pytest.mark.parametrize("b", [0.8, 2.0, 5.0])
def test_a_softening_law_loses_ellipticity_where_the_closed_form_says(b):
    report = material_stability(Softening(b=b, density=1000, poisson=0.5), (0.5, 2.0))
    spread = 1 / np.sqrt(2 * b)
    assert not report.stable
    for kind, gap in SPREADS.items():
        below = brentq(lambda s, gap=gap: gap(s) - spread, 0.3, 1)
        above = brentq(lambda s, gap=gap: gap(s) - spread, 1, 3)
        expected = tuple(end if 0.5 <= end <= 2 else None for end in (below, above))
        found = report.limits[kind]
        assert [end is None for end in found] == [end is None for end in expected], kind
        for got, end in zip(found, expected, strict=True):
            assert got is None or got == pytest.approx(end, abs=2e-3)
    assert report.limits["shear"][0] is None
    assert report.limits["shear"][1] == pytest.approx(spread, abs=2e-3)
    assert f"shear: ellipticity is lost at shear {report.limits['shear'][1]:.4g}" in report.text


def test_the_least_modulus_of_a_softening_law_has_its_closed_form():
    b, mu = 2.0, 1e4
    F = np.array([np.diag([s, s**-0.5, s**-0.5]) for s in (1.0, 1.1, 1.25)])
    shift = 0.3 * np.eye(3, k=1)
    F = np.concatenate([F, [np.eye(3) + shift, np.eye(3) + shift.T]])
    stretches = np.linalg.svd(F, compute_uv=False)
    spread = stretches[:, 0] - stretches[:, 2]
    x = np.sum(stretches**2, axis=1) - 3
    expected = mu * np.exp(-b * x) * (1 - 2 * b * spread**2)
    modulus = min_wave_modulus(Softening(b=b, mu=mu, density=1000, poisson=0.5), F)
    assert np.all(modulus >= expected - 1e-3)  # the least over directions that were looked at
    np.testing.assert_allclose(modulus, expected, atol=2e-3 * mu)


def test_waves_of_a_body_at_rest_have_the_moduli_of_linear_elasticity():
    for poisson in (0.2, 0.49):
        material = pt.materials.MooneyRivlin(C1=4e3, C2=1e3, density=1000, poisson=poisson)
        report = material_stability(material)
        assert report.shear_modulus == pytest.approx(5e3, rel=1e-6)
        assert report.bulk_modulus == pytest.approx(material.bulk_modulus, rel=1e-6)
        np.testing.assert_allclose(min_wave_modulus(material, np.eye(3)[None]), 5e3, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("poisson", [0.2, 0.45, 0.499, 0.5])
def test_polyconvex_laws_are_stable(poisson):
    for law in (
        pt.materials.NeoHookean(C1=1e3, density=1000, poisson=poisson),
        pt.materials.MooneyRivlin(C1=1e3, C2=300.0, density=1000, poisson=poisson),
    ):
        report = material_stability(law, (0.4, 2.5))
        assert report.stable, report.text
        assert report.findings == ()
        assert report.min_modulus > 0
        assert all(ends == (None, None) for ends in report.limits.values())
        assert report.text.startswith("stable for principal stretches 0.4 to 2.5")
        report.require()


@pytest.mark.filterwarnings("ignore::palpate.core.faults.UnitWarning")
def test_a_stiffer_law_has_scaled_moduli_and_the_same_limits():
    soft, hard = (material_stability(Softening(mu=mu, density=1000, poisson=0.4)) for mu in (1.0, 1e9))
    assert soft.min_modulus / soft.shear_modulus == pytest.approx(hard.min_modulus / hard.shear_modulus, rel=1e-4)
    for kind in soft.limits:
        for one, other in zip(soft.limits[kind], hard.limits[kind], strict=True):
            assert one == other or one == pytest.approx(other, abs=1e-4)


def test_a_law_with_stress_at_rest_is_refused():
    report = material_stability(Pressed(density=1000, poisson=0.3))
    assert any("the stress at rest must be zero, got 1e+04 Pa" in finding for finding in report.findings)
    with pytest.raises(pt.InputError, match=r"not stable for principal stretches 0.6 to 1.8"):
        report.require()
    # of an incompressible body a pressure is not the law's to tell
    assert material_stability(Pressed(density=1000, poisson=0.5)).stable


def test_a_law_with_a_limiting_stretch_is_reported_at_that_stretch():
    report = material_stability(Limited(b=2.0, density=1000, poisson=0.5), (0.6, 1.8))
    assert any(finding.startswith("not finite, nearest to rest at principal stretches") for finding in report.findings)
    end = brentq(lambda s: s**2 + 2 / s - 3 - 0.5, 1, 3)
    assert report.limits["uniaxial"][1] == pytest.approx(
        end, abs=0.011
    )  # a step of the path, beyond which W is not a number
    assert material_stability(Limited(b=2.0, density=1000, poisson=0.5), (0.85, 1.15)).stable


def test_a_law_with_the_wrong_sign_is_refused_at_rest():
    report = material_stability(Falling(density=1000, poisson=0.5))
    assert "the shear modulus at rest must be in (0, inf) Pa, got -1e+04" in report.findings
    assert any(finding.startswith("not elliptic, worst") for finding in report.findings)


@pytest.mark.parametrize(
    ("ranges", "message"),
    [
        ({"stretches": (0.0, 2.0)}, r"the lower end of stretches must be in \[0.002, 1\], got 0.0"),
        ({"stretches": (0.5, 0.9)}, r"the upper end of stretches must be in \[1, 25\], got 0.9"),
        ({"volumes": (1.1, 1.2)}, "the lower end of volumes must be .*, got 1.1"),
    ],
)
def test_a_range_without_rest_is_refused(ranges, message):
    with pytest.raises(pt.InputError, match=message):
        material_stability(Softening(density=1000, poisson=0.3), **ranges)


@pytest.mark.parametrize("ends", [(0.8,), 3, "ab", (1e-300, 1e300), (0.8, np.nan), (0.8, 1e9), (0.8, 1.2, 1.3)])
def test_ranges_that_are_not_intervals_are_refused(ends):
    with pytest.raises(pt.InputError, match="stretches must be"):
        material_stability(pt.materials.NeoHookean(C1=5e3, density=1000, poisson=0.4), ends)


@pytest.mark.parametrize("C1", [1e306, 4e306, 3e307])
@pytest.mark.filterwarnings("ignore::palpate.core.faults.UnitWarning")
def test_a_law_whose_waves_overflow_is_not_stable(C1):
    try:
        material = pt.materials.NeoHookean(C1=C1, density=1000, poisson=0.45)
    except pt.InputError:
        return
    assert not material_stability(material).stable
