"""Fitted parameters: the ones that made the curves, as often as their standard errors say."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import palpate as pt
from palpate.tissue.fitting import fit
from palpate.tissue.homogeneous import DEFORMATION_KINDS, nominal_stress
from palpate.tissue.measurement_files import read_measurements
from palpate.tissue.measurements import Measurement

EXAMPLES = Path(__file__).parents[2] / "examples"
NOISE = 200.0  # [Pa]


@dataclass(frozen=True, kw_only=True)
class Stiffening(pt.materials.Material):
    """W = mu/(2b) [exp(b x) - 1], x = I1 - 3 - 2 ln J: one parameter that the stress is not linear in."""

    mu: float
    b: float

    def _check_parameters(self):
        if self.mu <= 0 or self.b <= 0:
            raise pt.InputError(f"mu = {self.mu}, b = {self.b} are not positive")

    @property
    def shear_modulus(self):
        return self.mu

    @property
    def shear_bulk_modulus(self):
        return 2 / 3 * self.mu

    @staticmethod
    def energy(I1, I2, J, c):
        return c[0] / (2 * c[1]) * np.expm1(c[1] * (I1 - 3 - 2 * np.log(J)))

    @staticmethod
    def first(I1, I2, J, c):
        f = c[0] / 2 * np.exp(c[1] * (I1 - 3 - 2 * np.log(J)))
        return f, 0.0, -2 * f / J

    @staticmethod
    def second(I1, I2, J, c):
        raise NotImplementedError


@dataclass(frozen=True, kw_only=True)
class Powers(Stiffening):
    """Sum of C (l1^a + l2^a + l3^a - 3 - a ln J): terms (C, a) in one field, nested and of any number."""

    mu: float = 1.0
    b: float = 1.0
    terms: tuple[tuple[float, float], ...]

    def _check_parameters(self):
        if min(C for C, _ in self.terms) <= 0 or 0 in [a for _, a in self.terms]:
            raise pt.InputError(f"terms = {self.terms} are not positive, or without power")

    @property
    def shear_modulus(self):
        return sum(C * a**2 for C, a in self.terms) / 2

    @property
    def shear_bulk_modulus(self):
        return 2 / 3 * self.shear_modulus

    def stress(self, F):
        u, stretches, v = np.linalg.svd(F)
        slopes = sum(C * a * (stretches**a - 1) for C, a in self.terms) / stretches
        J = np.linalg.det(F)[..., None, None]
        cofactor = J * np.swapaxes(np.linalg.inv(F), -1, -2)
        return (u * slopes[..., None, :]) @ v + self.lame * (J - 1) * cofactor


HELD = {"mu": 1.0, "b": 1.0}  # what `Powers` inherits and does not use


def curves(material, kinds=("uniaxial", "shear"), noise=NOISE, seed=0, points=21):
    """Curves of a law with noise."""
    random = np.random.default_rng(seed)
    made = []
    for kind in kinds:
        deformation = np.linspace(0, 0.8, points) if kind == "shear" else np.linspace(0.75, 1.5, points)
        stress = nominal_stress(material, kind, deformation) + noise * random.normal(size=points)
        made.append(Measurement(kind=kind, deformation=deformation, stress=stress, deviation=NOISE))
    return made


def rubbery(**changed):
    return pt.materials.MooneyRivlin(**({"C1": 8e3, "C2": 3e3, "density": 1060.0, "poisson": 0.5} | changed))


def stiff(poisson=0.5):
    return Stiffening(mu=6e3, b=1.5, density=1060.0, poisson=poisson)


@pytest.mark.slow
@pytest.mark.parametrize("kind", [kind for kind in DEFORMATION_KINDS if kind != "shear"])
@pytest.mark.parametrize("poisson", [0.3, 0.49, 0.5])
def test_parameters_are_recovered_from_curves_without_noise(kind, poisson):
    if kind != "planar":  # which tells C1 + C2 only
        fitted = fit(pt.materials.MooneyRivlin, curves(rubbery(poisson=poisson), [kind], noise=0), poisson=poisson)
        assert fitted.parameters == pytest.approx({"C1": 8e3, "C2": 3e3}, rel=1e-5)
        assert fitted.material == rubbery(poisson=poisson, **fitted.parameters)
        assert fitted.curves[0].r_squared > 1 - 1e-9
    fitted = fit(Stiffening, curves(stiff(poisson), [kind], noise=0), poisson=poisson, starts=3)
    assert fitted.parameters == pytest.approx({"mu": 6e3, "b": 1.5}, rel=1e-5)


def test_a_linear_fit_is_the_one_of_the_normal_equations():
    measured = curves(rubbery())
    fitted = fit(pt.materials.MooneyRivlin, measured)
    slopes = [
        np.concatenate([nominal_stress(rubbery(**one), m.kind, m.deformation) for m in measured])
        for one in ({"C1": 1.0, "C2": 0.0}, {"C1": 1.0, "C2": 1.0})
    ]
    A = np.stack([slopes[0], slopes[1] - slopes[0]], axis=1)
    stress = np.concatenate([m.stress for m in measured])
    expected, rest, _, _ = np.linalg.lstsq(A, stress, rcond=None)
    np.testing.assert_allclose(list(fitted.parameters.values()), expected, rtol=1e-7)
    np.testing.assert_allclose(fitted.covariance, np.linalg.inv(A.T @ A) * rest[0] / (len(stress) - 2), rtol=1e-5)
    assert len(fitted.starts) == 1  # of a law linear in its parameters


def test_points_are_weighted_by_their_deviations():
    first, second = curves(rubbery(), noise=0)
    wrong = Measurement(kind="shear", deformation=second.deformation, stress=2 * second.stress, deviation=1e3 * NOISE)
    fitted = fit(pt.materials.MooneyRivlin, [first, wrong])
    assert fitted.parameters == pytest.approx({"C1": 8e3, "C2": 3e3}, rel=1e-3)
    assert fitted.curves[1].r_squared < 0.9


@pytest.mark.slow
@pytest.mark.parametrize(
    ("law", "truth", "start"), [(pt.materials.MooneyRivlin, rubbery(), {}), (Stiffening, stiff(), {"b": 1.0})]
)
def test_standard_errors_cover_the_true_parameters_at_their_level(law, truth, start):
    seeds = 100
    z = np.empty((seeds, 2))
    for seed in range(seeds):
        fitted = fit(law, curves(truth, seed=seed), start=start, starts=1)
        errors = fitted.standard_errors
        z[seed] = [(value - getattr(truth, name)) / errors[name] for name, value in fitted.parameters.items()]
    within = np.mean(np.abs(z) < 1.96, axis=0)
    # 95 % of runs, up to four standard deviations of their count
    np.testing.assert_allclose(within, 0.95, atol=4 * np.sqrt(0.05 * 0.95 / seeds))
    np.testing.assert_allclose(z.mean(axis=0), 0, atol=4 / np.sqrt(seeds))
    np.testing.assert_allclose(z.std(axis=0), 1, atol=4 / np.sqrt(2 * seeds))


@pytest.mark.slow
def test_the_covariance_is_that_of_a_bootstrap():
    one = fit(Stiffening, curves(stiff()), starts=1)
    again, seeds = [], 100
    for seed in range(seeds):
        made = curves(one.material, seed=1000 + seed)
        again.append(list(fit(Stiffening, made, start=one.parameters, starts=1).parameters.values()))
    drawn = np.cov(np.array(again).T)
    estimated = np.sqrt(np.mean([c.rms**2 for c in one.curves]) * 42 / 40) / NOISE  # the bootstrap knows the noise
    expected = one.covariance / estimated**2
    np.testing.assert_allclose(np.sqrt(np.diag(drawn)), np.sqrt(np.diag(expected)), rtol=4 / np.sqrt(2 * seeds))
    correlation = [c[0, 1] / np.sqrt(c[0, 0] * c[1, 1]) for c in (drawn, expected)]
    assert correlation[0] == pytest.approx(correlation[1], abs=4 * (1 - correlation[1] ** 2) / np.sqrt(seeds))


def pulled():
    """Tension of a law with one negative power: positive powers come near, and no way leads past zero."""
    truth = Powers(terms=((400.0, -6.0),), density=1060.0, poisson=0.5)
    deformation = np.linspace(1.0, 1.6, 30)
    return Measurement(kind="uniaxial", deformation=deformation, stress=nominal_stress(truth, "uniaxial", deformation))


def test_several_starts_find_the_global_minimum_that_one_start_misses():
    options = {"start": {"terms": ((1.0, 3.0),)}, "fixed": HELD}
    alone = fit(Powers, pulled(), starts=1, **options)
    assert alone.parameters["terms[0][1]"] > 0
    fitted = fit(Powers, pulled(), starts=8, **options)
    assert fitted.parameters == pytest.approx({"terms[0][0]": 400.0, "terms[0][1]": -6.0}, rel=1e-5)
    costs = [start.cost for start in fitted.starts]
    assert len(costs) == 8
    assert costs == sorted(costs)
    assert costs[0] < 1e-6 * alone.starts[0].cost
    assert costs[-1] == pytest.approx(alone.starts[0].cost, rel=1e-3)  # the other minimum shows in the table


def test_the_same_seed_gives_the_same_starts_and_another_one_others():
    options = {"start": {"terms": ((1.0, 3.0),)}, "fixed": HELD}
    first, again, other = (fit(Powers, pulled(), starts=4, seed=seed, **options) for seed in (1, 1, 2))
    begun = [sorted(start.first["terms[0][1]"] for start in found.starts) for found in (first, again, other)]
    assert begun[0] == begun[1]
    assert begun[0] != begun[2]


def test_parameters_in_nested_sequences_are_fitted_and_named_by_index():
    truth = Powers(terms=((500.0, 4.0), (300.0, -5.0)), density=1060.0, poisson=0.5)
    made = curves(truth, ("uniaxial", "equibiaxial", "shear"), noise=0)
    fitted = fit(Powers, made, start={"terms": ((1.0, 2.0), (1.0, -2.0))}, fixed=HELD)
    assert list(fitted.parameters) == ["terms[0][0]", "terms[0][1]", "terms[1][0]", "terms[1][1]"]
    ordered = sorted(fitted.material.terms)
    np.testing.assert_allclose(ordered, sorted(truth.terms), rtol=1e-4)
    held = fit(Powers, made, start={"terms": ((500.0, 4.0), (1.0, -2.0))}, fixed=HELD | {"terms[0][1]": 4.0})
    assert "terms[0][1]" not in held.parameters
    assert held.material.terms[0][1] == 4.0
    assert held.parameters["terms[1][1]"] == pytest.approx(-5.0, rel=1e-4)


def test_bounds_are_kept_and_a_parameter_at_a_bound_is_reported():
    fitted = fit(Stiffening, curves(stiff()), bounds={"b": (2.0, 9.0)})
    assert fitted.parameters["b"] == 2.0
    assert np.isnan(fitted.standard_errors["b"])
    assert np.isfinite(fitted.standard_errors["mu"])
    assert "b lies on its bound 2" in fitted.remarks
    assert all(2.0 <= start.first["b"] <= 9.0 for start in fitted.starts)
    within = fit(Stiffening, curves(stiff()), bounds={"b": (0.5, 9.0)})
    assert within.parameters["b"] == pytest.approx(1.5, rel=0.1)
    assert within.remarks == ()


def test_the_range_of_a_parameter_of_a_law_is_kept():
    truth = curves(rubbery(C2=0.0), ("uniaxial", "equibiaxial"))
    # less stress than any C2 of the law's could make
    pressed = [
        Measurement(kind=m.kind, deformation=m.deformation, stress=m.stress * m.deformation**-0.2) for m in truth
    ]
    fitted = fit(pt.materials.MooneyRivlin, pressed)
    assert fitted.parameters["C2"] == 0.0
    assert "C2 lies on its bound 0" in fitted.remarks
    only = fit(pt.materials.NeoHookean, pressed)
    assert fitted.parameters["C1"] == pytest.approx(2 * only.parameters["C1"], rel=1e-6)
    assert fitted.standard_errors["C1"] == pytest.approx(2 * only.standard_errors["C1"], rel=1e-4)


def test_a_fixed_parameter_is_not_changed():
    fitted = fit(pt.materials.MooneyRivlin, curves(rubbery()), fixed={"C2": 1e3})
    assert fitted.material.C2 == 1e3
    assert list(fitted.parameters) == ["C1"]
    assert fitted.covariance.shape == (1, 1)
    assert fitted.parameters["C1"] == pytest.approx(10e3, rel=0.05)  # together nearly the shear modulus


@pytest.mark.parametrize("kind", ["planar", "shear"])  # which tell C1 + C2 only
def test_parameters_that_the_curves_do_not_determine_are_reported(kind):
    fitted = fit(pt.materials.MooneyRivlin, curves(rubbery(), [kind]))
    assert "the curves do not determine C1, C2" in fitted.remarks
    assert fitted.standard_errors == {"C1": np.inf, "C2": np.inf}
    assert fitted.condition > 1e6
    assert sum(fitted.parameters.values()) == pytest.approx(11e3, rel=0.02)
    better = fit(pt.materials.MooneyRivlin, curves(rubbery(), ["uniaxial"]))
    assert better.condition < 1e3
    assert better.remarks == ()


def test_a_parameter_lost_in_noise_is_reported():
    noisy = curves(stiff(), noise=0.0, points=8)
    small = [
        Measurement(
            kind=m.kind, deformation=d, stress=nominal_stress(stiff(), m.kind, d) + 20 * np.sin(9.0 * np.arange(8))
        )
        for m in noisy
        for d in [np.linspace(0, 0.05, 8) + (m.kind != "shear")]
    ]
    fitted = fit(Stiffening, small)
    assert any(
        "the standard error of b exceeds its value" in remark or "do not determine b" in remark
        for remark in fitted.remarks
    )


def test_systematic_residuals_of_a_wrong_law_are_reported():
    made = curves(stiff(), ("uniaxial",), noise=1.0, points=40)
    wrong, right = fit(pt.materials.NeoHookean, made), fit(Stiffening, made)
    assert wrong.curves[0].correlation > 0.8
    assert any("residuals of curve 1, uniaxial are systematic" in remark for remark in wrong.remarks)
    assert right.remarks == ()


def test_the_report_has_the_errors_of_the_curves_and_the_stability_of_the_law():
    made = curves(rubbery(), ("uniaxial", "shear"))
    fitted = fit(pt.materials.MooneyRivlin, made)
    for curve, measured in zip(fitted.curves, made, strict=True):
        wrong = nominal_stress(fitted.material, measured.kind, measured.deformation) - measured.stress
        assert curve.rms == pytest.approx(np.sqrt(np.mean(wrong**2)))
        assert curve.rms == pytest.approx(NOISE, rel=0.5)
        assert curve.r_squared == pytest.approx(1 - np.var(wrong) / np.var(measured.stress), abs=1e-3)
    cost = sum(np.sum((c.rms / NOISE) ** 2) * c.points for c in fitted.curves) / 2
    assert fitted.starts[0].cost == pytest.approx(cost)
    assert fitted.stability.stable
    low, high = fitted.stability.stretches
    assert low < 0.75
    assert high == pytest.approx(1.5)
    text = fitted.summary()
    for part in ("MooneyRivlin, Poisson's ratio 0.5", "C1 = ", "curve 2, shear: rms", "stable for principal stretches"):
        assert part in text


def test_fits_of_treloars_rubber_give_the_published_moduli():
    """Treloar (Trans. Faraday Soc. 40, 59, 1944) compares his curves with Gaussian theory of 4 kg/cm^2."""
    measured = read_measurements(EXAMPLES / "rubber_treloar.csv")
    small = [
        Measurement(kind=m.kind, deformation=m.deformation[chosen], stress=m.stress[chosen])
        for m in measured
        for chosen in [m.deformation <= 2.0]
    ]
    fitted = fit(pt.materials.NeoHookean, small)
    assert fitted.material.shear_modulus == pytest.approx(4 * 98066.5, rel=0.1)
    both = fit(pt.materials.MooneyRivlin, small)
    assert sum(c.rms**2 * c.points for c in both.curves) < 0.9 * sum(c.rms**2 * c.points for c in fitted.curves)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"start": {"C3": 1.0}}, "a parameter of MooneyRivlin must be one of C1, C2, got C3"),
        ({"fixed": {"C3": 1.0}}, "a parameter of MooneyRivlin must be one of C1, C2, got C3"),
        ({"bounds": {"C3": (0.0, 1.0)}}, "a parameter of MooneyRivlin must be one of C1, C2, got C3"),
        ({"start": {"C1": -1.0}}, r"C1 must be in \(0, inf\) Pa, got -1.0"),
        ({"start": {"C1": "soft"}}, "C1 must be a number, got 'soft'"),
        (
            {"start": {"C1": 5.0}, "bounds": {"C1": (10.0, 20.0)}},
            r"start of C1 must be in \[10, 20\], got .*5.0.*",
        ),
        ({"bounds": {"C1": (3.0, 2.0)}}, r"bounds of C1 must overlap \[0, inf\], got \(3, 2\)"),
        ({"bounds": {"C2": (-3.0, -2.0)}}, r"bounds of C2 must overlap .*, got \(-3, -2\)"),
        ({"fixed": {"C1": 1.0, "C2": 1.0}}, "fixed must leave at least one free parameter"),
        ({"fixed": {"C1": np.nan}}, "fixed C1 must be .*, got nan"),
        ({"starts": 0}, "starts"),
        ({"poisson": 0.6}, r"poisson must be in \[0, 0.499\], got 0.6"),
        ({"density": -1.0}, "density must be .*, got -1.0"),
        ({"measurements": []}, "measurements must have at least one curve"),
    ],
)
def test_invalid_fits_are_refused(options, message):
    options = {"measurements": curves(rubbery())} | options
    with pytest.raises(pt.InputError, match=message):
        fit(pt.materials.MooneyRivlin, **options)


def test_a_sequence_without_a_length_and_too_few_points_are_refused():
    with pytest.raises(pt.InputError, match="terms of Powers must have start values"):
        fit(Powers, curves(rubbery()))
    short = Measurement(kind="uniaxial", deformation=[1.0, 1.1], stress=[0.0, 1.0])
    with pytest.raises(pt.InputError, match="measurements must have more than 2 points, got 2; give more"):
        fit(pt.materials.MooneyRivlin, short)


@pytest.mark.parametrize("name", ["MooneyRivlin", "mooneyrivlin", "mooney-rivlin", "Mooney_Rivlin", "MOONEY RIVLIN"])
def test_a_law_by_its_name_is_fitted_as_its_class(name):
    measured = curves(rubbery())
    assert fit(name, measured).parameters == fit(pt.materials.MooneyRivlin, measured).parameters
    assert type(fit(name, measured).material) is pt.materials.MooneyRivlin


@pytest.mark.parametrize(
    ("law", "message"),
    [
        ("yeho", "law must be one of ArrudaBoyce, .*, Yeoh, or its class, got 'yeho'; did you mean Yeoh"),
        ("", "law must be one of ArrudaBoyce, .*, or its class, got ''$"),
        (None, "law must be one of .*, got None$"),
        (stiff(), "law must be one of .*, got "),
        (pt.materials.Material, "law must be one of .*, got <class"),
        (pt.materials.Fibres, "law must be one of .*, got <class"),
    ],
)
def test_another_object_than_a_law_is_refused_with_the_list_of_laws(law, message):
    with pytest.raises(pt.InputError, match=message):
        fit(law, curves(rubbery()))


def test_curves_of_another_type_are_refused():
    with pytest.raises(pt.InputError, match="measurements must be Measurement objects, got array"):
        fit("yeoh", [np.zeros((5, 2))])
