"""Fit of a law to measured curves by nonlinear least squares from several starts."""

from __future__ import annotations

import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, cast

import numpy as np

from palpate.core.arrays import Floats
from palpate.core.describe import Described, Fact
from palpate.core.faults import InputError, UnitWarning, brief, integer_in_range
from palpate.core.plotting import plot_fit
from palpate.tissue.catalogue import law_class
from palpate.tissue.ellipticity import MaterialStability, material_stability
from palpate.tissue.fit_problem import FitProblem
from palpate.tissue.fit_starts import starting_points
from palpate.tissue.homogeneous import deformation_gradient, nominal_stress, rest
from palpate.tissue.materials import Material
from palpate.tissue.measurements import Measurement
from palpate.tissue.parameters import field_metadata

MAX_EVALUATIONS = 200  # of the residuals, for each start
COARSE_TOLERANCE = 1e-5  # relative change of cost at the end of each start
FINE_TOLERANCE = 1e-11  # relative change of cost at the end of the best start, which continues
MAX_CONDITION = 1e6  # of the Jacobian; beyond it parameters are not identifiable
COST_TOLERANCE = 1e-3  # relative difference of cost of equivalent starts
CORRELATION_LIMIT = 3.0  # standard deviations of the lag-1 correlation of white noise
EXACT_RESIDUAL = 1e-6  # relative differences of stress below it are rounding errors
CURVE_POINTS = 200  # of a plotted curve
MIN_CHECKED_STRETCHES = (0.8, 1.25)  # smallest range of the stability check


@dataclass(frozen=True)
class CurveFit(Described):
    """Residual statistics of one curve.

    Attributes
    ----------
    name, kind : str
    points : int
    rms : float [Pa]
        Root mean square of the differences of stress.
    r_squared : float
        Coefficient of determination.
    correlation : float
        Lag-1 correlation of the residuals: near 0 for noise, near 1 for a systematic misfit.

    Examples
    --------
    >>> import numpy as np
    >>> import palpate as pt
    >>> stretch = np.linspace(1.0, 1.4, 9)
    >>> stress = 2 * 1.1e3 * (stretch - stretch**-2)
    >>> curve = pt.materials.Measurement(kind="uniaxial", deformation=stretch, stress=stress)
    >>> result = pt.materials.fit(pt.materials.NeoHookean, curve)
    >>> round(result.curves[0].r_squared, 6)
    1.0
    """

    name: str
    kind: str
    points: int
    rms: float
    r_squared: float
    correlation: float

    def _facts(self) -> list[Fact]:
        return [
            ("name", self.name, ""),
            ("kind", self.kind, ""),
            ("points", self.points, ""),
            ("rms", self.rms, "Pa"),
            ("r_squared", self.r_squared, ""),
            ("correlation", self.correlation, ""),
        ]


@dataclass(frozen=True)
class FitStart(Described):
    """Result of one start of a fit.

    Parameters
    ----------
    first, values : dict
        First and last parameters by name.
    cost : float
        Half the sum of squared residuals.
    converged : bool

    Examples
    --------
    >>> import numpy as np
    >>> import palpate as pt
    >>> stretch = np.linspace(1.0, 1.4, 9)
    >>> stress = 2 * 1.1e3 * (stretch - stretch**-2)
    >>> curve = pt.materials.Measurement(kind="uniaxial", deformation=stretch, stress=stress)
    >>> result = pt.materials.fit(pt.materials.NeoHookean, curve)
    >>> result.starts[0].converged
    True
    """

    first: dict[str, float]
    values: dict[str, float]
    cost: float
    converged: bool

    def _facts(self) -> list[Fact]:
        values = ", ".join(f"{name}={value:.4g}" for name, value in self.values.items())
        return [("values", values, ""), ("cost", self.cost, ""), ("converged", self.converged, "")]


@dataclass(frozen=True, eq=False)
class Fit(Described):
    """Result of the fit of a law to curves.

    Attributes
    ----------
    material : Material
        Law with the fitted parameters.
    parameters : dict
        Fitted parameters by name; elements of a sequence as ``C[0]``. Fixed parameters are not
        included.
    covariance : (k, k) array
        First-order covariance of the parameters for independent errors, s^2 (J^T J)^-1, with s^2
        the sum of squared residuals over their degrees of freedom. NaN for a parameter on its
        bound, infinite variance for an undetermined one.
    curves : tuple of CurveFit
    starts : tuple of FitStart
        Sorted by cost.
    condition : float
        Condition number of the Jacobian with normalised columns.
    remarks : tuple of str
        Warnings about the parameters.
    measurements : tuple of Measurement

    Examples
    --------
    >>> import numpy as np
    >>> import palpate as pt
    >>> stretch = np.linspace(1.0, 1.4, 9)
    >>> stress = 2 * 1.1e3 * (stretch - stretch**-2)
    >>> curve = pt.materials.Measurement(kind="uniaxial", deformation=stretch, stress=stress)
    >>> result = pt.materials.fit(pt.materials.NeoHookean, curve)
    >>> result.material.poisson, result.remarks
    (0.5, ())
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
            ("status", "stable" if self.stability.stable else "not stable", ""),
            ("remarks", len(self.remarks), ""),
            *(("remark", remark, "") for remark in self.remarks),
        ]  # fmt: skip

    @property
    def standard_errors(self) -> dict[str, float]:
        """Standard deviation of every parameter."""
        return dict(zip(self.parameters, np.sqrt(np.diagonal(self.covariance)).tolist(), strict=True))

    @property
    def stretches(self) -> tuple[float, float]:
        """Smallest and largest principal stretch of the specimens."""
        reached = [deformation_gradient(self.material, m.kind, m.deformation) for m in self.measurements]
        principal = np.linalg.svd(np.concatenate(reached), compute_uv=False)
        return float(principal.min()), float(principal.max())

    @cached_property
    def stability(self) -> MaterialStability:
        """Stability of the law in the range of stretches of the specimens."""
        low, high = self.stretches
        return material_stability(
            self.material, (min(low, MIN_CHECKED_STRETCHES[0]), max(high, MIN_CHECKED_STRETCHES[1]))
        )

    def plot(self, curve: int = 0, axes: Any = None) -> Any:
        """Plot the measured points of a curve, and the stress of the law.

        Parameters
        ----------
        curve : int
            Index in `curves`.
        axes : matplotlib.axes.Axes, optional
            New ones by default.

        Returns
        -------
        matplotlib.axes.Axes

        Raises
        ------
        InputError
            There is no such curve, or matplotlib is not installed.
        """
        measured = self.measurements[integer_in_range("curve", curve, 0, len(self.curves) - 1)]
        ends = (rest(measured.kind), *measured.deformation)
        along = np.linspace(min(ends), max(ends), CURVE_POINTS)
        labels = ("shear" if measured.kind == "shear" else "stretch", "nominal stress [Pa]")
        fitted = along, nominal_stress(self.material, measured.kind, along)
        return plot_fit((measured.deformation, measured.stress), fitted, labels, self.curves[curve].name, axes)

    def summary(self) -> str:
        """Return a summary as lines of text."""
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
    law: type[Material] | str,
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

    The residuals are (stress of the law - measured stress) / deviation at all points of all curves.
    A bounded trust region minimises their squares (Branch, Coleman and Li, SIAM J. Sci. Comput. 21,
    1, 1999) from several starts, because a nonlinear law has several minima in general (Ogden,
    Saccomandi and Sgura, Comput. Mech. 34, 484, 2004).

    Parameters
    ----------
    law : type of Material, or str
        Law, such as `NeoHookean`, or its name, such as ``"yeoh"`` or ``"mooney-rivlin"``. Its fields, numbers or
        sequences of numbers, are the parameters.
    measurements : Measurement or sequence of them
    start : dict, optional
        Parameters of the first start; required for sequences, whose length they define. Parameters
        in which the stress is linear follow from linear least squares in every start.
    bounds : dict, optional
        Pairs (lower, upper) by name, within the range of the law; for a sequence by its name or by
        element, ``C[0]``. Other starts are drawn uniformly between bounds, or between their
        logarithms for positive numbers. Without bounds they are drawn about the first start: within
        a factor of 1000, or of 8 with either sign.
    fixed : dict, optional
        Values of parameters that are not fitted.
    starts : int
        Number of starts, at least 1. A law that is linear in all parameters uses one.
    seed : int
        Seed of the other starts.
    density : float [kg/m^3]
        Density of the material; no curve depends on it. Liver and muscle have about 1060.
    poisson : float
        Poisson's ratio of the material. The default, 0.5, is incompressible; a solid needs at most
        0.499.

    Returns
    -------
    Fit

    Raises
    ------
    InputError
        The law or a name is unknown, a start is invalid or out of bounds, there are too few points, no
        parameter is free, or the stress of the law is not finite at a measured deformation.

    Examples
    --------
    >>> import numpy as np
    >>> import palpate as pt
    >>> stretch = np.linspace(1.0, 1.4, 9)
    >>> stress = 2 * 1.1e3 * (stretch - stretch**-2)
    >>> curve = pt.materials.Measurement(kind="uniaxial", deformation=stretch, stress=stress)
    >>> result = pt.materials.fit(pt.materials.NeoHookean, curve)
    >>> round(result.parameters["C1"], 3)
    1100.0
    """
    kind, curves = law_class(law), (measurements,) if isinstance(measurements, Measurement) else tuple(measurements)
    for curve in curves:
        if not isinstance(cast(object, curve), Measurement):
            raise InputError(f"measurements must be Measurement objects, got {brief(curve)}; make one of each curve")
    if not curves:
        raise InputError("measurements must have at least one curve, got none")
    starts, seed = integer_in_range("starts", starts, 1), integer_in_range("seed", seed, 0)
    with np.errstate(all="ignore"), warnings.catch_warnings():
        # trial parameters may overflow, or be far from those of tissue; the trust region then shrinks
        warnings.simplefilter("ignore", UnitWarning)
        problem = FitProblem(kind, curves, start or {}, bounds or {}, fixed or {}, density, poisson)
        solutions = [
            (first, _minimise(problem, better, COARSE_TOLERANCE))
            for first, better in starting_points(problem, starts, seed)
        ]
        solutions.sort(key=lambda pair: pair[1].cost)
        solutions[0] = solutions[0][0], _minimise(problem, solutions[0][1].x, FINE_TOLERANCE)
        fitted = _build_fit(problem, solutions)
    fitted.material.warn_of_units()
    return fitted


def _minimise(problem: FitProblem, first: Floats, tolerance: float) -> Any:
    from scipy.optimize import least_squares

    if not np.all(np.isfinite(problem.residuals(first))):
        law = problem.layout.law.__name__
        raise InputError(f"the stress of {law} must be finite at the measured deformations; give another start")
    return least_squares(
        problem.residuals,
        np.clip(first, np.nextafter(problem.low, np.inf), np.nextafter(problem.high, -np.inf)),
        problem.jacobian,
        bounds=(problem.low, problem.high),
        x_scale="jac",
        max_nfev=MAX_EVALUATIONS,
        ftol=tolerance,
        xtol=min(tolerance, 1e-8),
        gtol=min(tolerance, 1e-10),
    )


def _build_fit(problem: FitProblem, solutions: list[tuple[Floats, Any]]) -> Fit:
    x = problem.snap_to_bounds(solutions[0][1].x)
    covariance, condition, remarks = _covariance(problem, x)
    table = tuple(
        FitStart(
            dict(zip(problem.names, first.tolist(), strict=True)),
            dict(zip(problem.names, solved.x.tolist(), strict=True)),
            float(solved.cost) * problem.unit**2,
            solved.status > 0,
        )
        for first, solved in solutions
    )
    alike = sum(one.cost <= (1 + COST_TOLERANCE) * table[0].cost for one in table)
    if len(table) > 1 and alike == 1:
        remarks.append(f"only 1 of {len(table)} starts reached the smallest cost: use more starts")
    if not table[0].converged:
        remarks.append(f"the best start had not converged after {MAX_EVALUATIONS} evaluations")
    material = problem.material(x)
    curves = tuple(_curve_fit(material, i, m) for i, m in enumerate(problem.measurements, 1))
    remarks += [
        f"the residuals of {curve.name} are systematic (lag-1 correlation {curve.correlation:.2f}): "
        "errors are not independent, and larger than the standard errors"
        for curve in curves
        if curve.correlation > CORRELATION_LIMIT / np.sqrt(curve.points)
    ]
    named = dict(zip(problem.names, x.tolist(), strict=True))
    return Fit(material, named, covariance, curves, table, condition, tuple(remarks), problem.measurements)


def _covariance(problem: FitProblem, x: Floats) -> tuple[Floats, float, list[str]]:
    """Return covariance, condition number and remarks."""
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
    weak = singular < singular[0] / MAX_CONDITION
    inverse = V.T @ (np.where(weak, 0.0, 1 / singular**2)[:, None] * V)
    block = inverse / np.outer(norms, norms) * float(r @ r) / (len(r) - len(inner))
    lost = inner[np.any(np.abs(V[weak]) > 0.1, axis=0)] if np.any(weak) else inner[:0]
    covariance[np.ix_(inner, inner)] = block
    covariance[lost, lost] = np.inf
    if len(lost):
        remarks.append(f"the curves do not determine {', '.join(problem.names[k] for k in lost)}")
    errors = np.sqrt(np.diagonal(covariance))
    remarks += [
        f"the standard error of {problem.names[k]} exceeds its value: {x[k]:.3g} +- {errors[k]:.2g}"
        for k in inner
        if np.isfinite(errors[k]) and errors[k] > abs(x[k])
    ]
    return covariance, float(singular[0] / singular[-1]) if singular[-1] else np.inf, remarks


def _curve_fit(material: Material, number: int, measured: Measurement) -> CurveFit:
    stress = measured.stress
    wrong = nominal_stress(material, measured.kind, measured.deformation) - stress
    spread = float(np.sum((stress - stress.mean()) ** 2))
    r_squared = 1 - float(wrong @ wrong) / spread if spread > 0 else np.nan
    name = measured.name or f"curve {number}, {measured.kind}"
    rms = float(np.sqrt(np.mean(wrong**2)))
    exact = rms <= EXACT_RESIDUAL * float(np.abs(stress).max())
    correlation = 0.0 if exact else float(wrong[1:] @ wrong[:-1]) / float(wrong @ wrong)
    return CurveFit(name, measured.kind, len(stress), rms, r_squared, correlation)
