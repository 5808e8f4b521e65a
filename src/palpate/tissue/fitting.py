"""Parameters of a law from measured curves, by nonlinear least squares from several starts."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from palpate.arrays import Floats
from palpate.describe import Described, Fact
from palpate.faults import InputError, UnitWarning, integer_in_range
from palpate.tissue.ellipticity import MaterialStability, material_stability
from palpate.tissue.fit_problem import FitProblem
from palpate.tissue.fit_starts import starts as begin
from palpate.tissue.homogeneous import deformation_gradient, nominal_stress
from palpate.tissue.materials import Material
from palpate.tissue.measurements import Measurement
from palpate.tissue.parameters import field_metadata

__all__ = ["CurveFit", "Fit", "FitStart", "fit"]


EVALUATIONS = 200  # of the residuals, from one start
ROUGH = 1e-5  # relative change of cost at which a start has ended; the best goes on
TIGHT = 1e-11  # relative change of cost at which the best start has ended
CONDITION = 1e6  # of the slopes; beyond it differences cannot tell parameters apart
AS_GOOD = 1e-3  # relative difference of cost between starts that ended alike
PATTERN = 3.0  # standard deviations of the correlation between neighbours of so many points of noise
EXACT = 1e-6  # differences of stress below, relative, are rounding
NARROW = (0.8, 1.25)  # stretches that stability is always checked in


@dataclass(frozen=True)
class CurveFit:
    """How one curve is met.

    Attributes
    ----------
    name, kind : str
    points : int
    rms : float [Pa]
        Root mean square of the differences of stress.
    r_squared : float
        1 less the share of the stresses' variance that the law misses.
    correlation : float
        Between the differences of neighbouring points: near 0 for noise, near 1 where the law has another shape.
    """

    name: str
    kind: str
    points: int
    rms: float
    r_squared: float
    correlation: float


@dataclass(frozen=True)
class FitStart:
    """Where a start began, where it ended, at what cost (half the sum of squared residuals), and whether at rest."""

    first: dict[str, float]
    values: dict[str, float]
    cost: float
    converged: bool


@dataclass(frozen=True, eq=False)
class Fit(Described):
    """A law fitted to curves.

    Attributes
    ----------
    material : Material
        The law with the parameters found.
    parameters : dict
        Found, by name; numbers in a sequence as ``C[0]``. Without those that were fixed.
    covariance : (k, k) array
        Of the parameters in their order, s^2 (J^T J)^-1 with s^2 the mean square of the residuals over their degrees
        of freedom: of independent errors, and to first order. NaN for a parameter on its bound, infinite variance for
        one that the curves do not determine.
    curves : tuple of CurveFit
    starts : tuple of FitStart
        The best first.
    condition : float
        Of the slopes, each parameter's scaled to length 1.
    remarks : tuple of str
        What a careful reader of the parameters should know.
    measurements : tuple of Measurement
    """

    material: Material
    parameters: dict[str, float]
    covariance: Floats
    curves: tuple[CurveFit, ...]
    starts: tuple[FitStart, ...]
    condition: float
    remarks: tuple[str, ...]
    measurements: tuple[Measurement, ...]

    def _facts(self) -> list[Fact]:
        law, errors = type(self.material), self.standard_errors
        return [
            ("law", law.__name__, ""),
            *((name, f"{value:.3g} +- {errors[name]:.2g}", field_metadata(law, name).get("unit", ""))
              for name, value in self.parameters.items()),
            ("curves", len(self.curves), ""),
            ("points", sum(curve.points for curve in self.curves), ""),
            ("least R^2", float(min(curve.r_squared for curve in self.curves)), ""),
            ("largest rms", float(max(curve.rms for curve in self.curves)), "Pa"),
            ("verdict", "stable" if self.stability.stable else "not stable", ""),
            ("remarks", len(self.remarks), ""),
            *(("remark", remark, "") for remark in self.remarks),
        ]  # fmt: skip

    @property
    def standard_errors(self) -> dict[str, float]:
        """Standard deviation of every parameter."""
        return dict(zip(self.parameters, np.sqrt(np.diagonal(self.covariance)).tolist(), strict=True))

    @property
    def stretches(self) -> tuple[float, float]:
        """Least and largest principal stretch of the specimens."""
        reached = [deformation_gradient(self.material, m.kind, m.deformation) for m in self.measurements]
        principal = np.linalg.svd(np.concatenate(reached), compute_uv=False)
        return float(principal.min()), float(principal.max())

    @cached_property
    def stability(self) -> MaterialStability:
        """Whether the law is sound for all stretches between the least and the largest of the specimens."""
        low, high = self.stretches
        return material_stability(self.material, (min(low, NARROW[0]), max(high, NARROW[1])))

    def summary(self) -> str:
        """Return everything a person wants to know, as lines of text."""
        law, width = type(self.material).__name__, max(map(len, self.parameters))
        errors = self.standard_errors
        return "\n".join(
            [
                f"{law}, Poisson's ratio {self.material.poisson:g}",
                *(f"  {name:{width}} = {value:.5g} +- {errors[name]:.2g}" for name, value in self.parameters.items()),
                *(f"  {c.name}: rms {c.rms:.3g} Pa, R^2 {c.r_squared:.5f}, {c.points} points" for c in self.curves),
                *(f"  note: {remark}" for remark in self.remarks),
                f"  {self.stability.text}",
            ]
        )


def fit(
    law: type[Material],
    measurements: Measurement | Sequence[Measurement],
    *,
    start: Mapping[str, Any] | None = None,
    bounds: Mapping[str, tuple[float, float]] | None = None,
    fixed: Mapping[str, Any] | None = None,
    starts: int = 8,
    seed: int = 0,
    density: float = 1060.0,
    poisson: float = 0.5,
) -> Fit:
    """Fit the parameters of a law to measured curves.

    Least squares of (stress of the law - measured stress) / deviation over all points of all curves, by a trust
    region with bounds (Branch, Coleman and Li, SIAM J. Sci. Comput. 21, 1, 1999), from several starts. Least squares
    of a nonlinear law have several minima in general (Ogden, Saccomandi and Sgura, Comput. Mech. 34, 484, 2004).

    Parameters
    ----------
    law : type of Material
        Such as `NeoHookean`. Its fields, numbers or sequences of numbers, are the parameters.
    measurements : Measurement or sequence of them
    start : dict, optional
        Where the first start begins; needed for fields that are sequences, to say how long they are. Parameters that
        the stress is linear in are taken from linear least squares in every start.
    bounds : dict, optional
        Pairs (least, largest) by name, within what the law allows; those of a sequence by its name or one by one,
        ``C[0]``. Other starts are drawn evenly between bounds (of positive numbers, between their logarithms), and
        where none are given, about the first start: within a factor of 1000, or of 8 with either sign.
    fixed : dict, optional
        Values of parameters that are not fitted.
    starts : int
        At least 1. A law linear in all its parameters needs one and takes one.
    seed : int
        Of the other starts.
    density : float [kg/m^3]
        Of the material; no curve depends on it. Liver and muscle have about 1060.
    poisson : float
        Of the material. 0.5, the default, takes the volume for constant; say what a solid is to have, at most 0.499.

    Returns
    -------
    Fit

    Raises
    ------
    InputError
        A name that the law does not have, a start that it refuses or that lies outside of bounds, fewer points than
        parameters, nothing to fit, or a law that has no finite stress at a measured deformation.
    """
    curves = (measurements,) if isinstance(measurements, Measurement) else tuple(measurements)
    if not curves:
        raise InputError("measurements are empty: give at least one curve")
    starts, seed = integer_in_range("starts", starts, 1), integer_in_range("seed", seed, 0)
    with np.errstate(all="ignore"), warnings.catch_warnings():
        # trial parameters may overflow a law, and be far from those of tissue; such trials are stepped back from
        warnings.simplefilter("ignore", UnitWarning)
        problem = FitProblem(law, curves, start or {}, bounds or {}, fixed or {}, density, poisson)
        ended = [(first, _minimum(problem, better, ROUGH)) for first, better in begin(problem, starts, seed)]
        ended.sort(key=lambda pair: pair[1].cost)
        ended[0] = ended[0][0], _minimum(problem, ended[0][1].x, TIGHT)
        found = _described(problem, ended)
    found.material.warn_of_units()
    return found


def _minimum(problem: FitProblem, first: Floats, tolerance: float) -> Any:
    from scipy.optimize import least_squares

    if not np.all(np.isfinite(problem.residuals(first))):
        law = problem.layout.law.__name__
        raise InputError(f"{law} has no finite stress at a measured deformation: give another start")
    return least_squares(
        problem.residuals,
        np.clip(first, np.nextafter(problem.low, np.inf), np.nextafter(problem.high, -np.inf)),
        problem.jacobian,
        bounds=(problem.low, problem.high),
        x_scale="jac",
        max_nfev=EVALUATIONS,
        ftol=tolerance,
        xtol=min(tolerance, 1e-8),
        gtol=min(tolerance, 1e-10),
    )


def _described(problem: FitProblem, ended: list[tuple[Floats, Any]]) -> Fit:
    x = problem.settled(ended[0][1].x)
    covariance, condition, remarks = _certainty(problem, x)
    table = tuple(
        FitStart(
            dict(zip(problem.names, first.tolist(), strict=True)),
            dict(zip(problem.names, solved.x.tolist(), strict=True)),
            float(solved.cost) * problem.unit**2,
            solved.status > 0,
        )
        for first, solved in ended
    )
    alike = sum(one.cost <= (1 + AS_GOOD) * table[0].cost for one in table)
    if len(table) > 1 and alike == 1:
        remarks.append(f"only 1 of {len(table)} starts ended at the least cost: try more")
    if not table[0].converged:
        remarks.append(f"the best start had not converged after {EVALUATIONS} evaluations")
    material = problem.material(x)
    curves = tuple(_curve(material, i, m) for i, m in enumerate(problem.measurements, 1))
    remarks += [
        f"the law misses {curve.name} in a pattern (correlation {curve.correlation:.2f} between neighbours): "
        "errors are not independent, and larger than their standard errors say"
        for curve in curves
        if curve.correlation > PATTERN / np.sqrt(curve.points)
    ]
    named = dict(zip(problem.names, x.tolist(), strict=True))
    return Fit(material, named, covariance, curves, table, condition, tuple(remarks), problem.measurements)


def _certainty(problem: FitProblem, x: Floats) -> tuple[Floats, float, list[str]]:
    """Covariance, condition number and what they do not tell."""
    bound = problem.on_bound(x)
    remarks = [f"{problem.names[k]} lies on its bound {x[k]:.4g}" for k in np.flatnonzero(bound)]
    covariance = np.full((len(x), len(x)), np.nan)
    inner = np.flatnonzero(~bound)
    if not len(inner):
        return covariance, 1.0, remarks
    J, r = problem.jacobian(x)[:, inner], problem.residuals(x)
    norms = np.linalg.norm(J, axis=0)
    norms = np.where(norms > 0, norms, 1.0)
    _, singular, V = np.linalg.svd(J / norms, full_matrices=False)
    weak = singular < singular[0] / CONDITION
    inverse = V.T @ (np.where(weak, 0.0, 1 / singular**2)[:, None] * V)
    block = inverse / np.outer(norms, norms) * float(r @ r) / (len(r) - len(inner))
    lost = inner[np.any(np.abs(V[weak]) > 0.1, axis=0)] if np.any(weak) else inner[:0]
    covariance[np.ix_(inner, inner)] = block
    covariance[lost, lost] = np.inf
    if len(lost):
        remarks.append(f"the curves do not determine {', '.join(problem.names[k] for k in lost)}")
    errors = np.sqrt(np.diagonal(covariance))
    remarks += [
        f"{problem.names[k]} is uncertain by more than itself: {x[k]:.3g} +- {errors[k]:.2g}"
        for k in inner
        if np.isfinite(errors[k]) and errors[k] > abs(x[k])
    ]
    return covariance, float(singular[0] / singular[-1]) if singular[-1] else np.inf, remarks


def _curve(material: Material, number: int, measured: Measurement) -> CurveFit:
    stress = measured.stress
    wrong = nominal_stress(material, measured.kind, measured.deformation) - stress
    spread = float(np.sum((stress - stress.mean()) ** 2))
    r_squared = 1 - float(wrong @ wrong) / spread if spread > 0 else np.nan
    name = measured.name or f"curve {number}, {measured.kind}"
    rms = float(np.sqrt(np.mean(wrong**2)))
    exact = rms <= EXACT * float(np.abs(stress).max())
    correlation = 0.0 if exact else float(wrong[1:] @ wrong[:-1]) / float(wrong @ wrong)
    return CurveFit(name, measured.kind, len(stress), rms, r_squared, correlation)
