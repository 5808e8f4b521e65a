"""Least-squares problem of a law and measured curves: residuals, Jacobian and bounds.

Where a law rejects a vector of parameters, the residuals are NaN and the trust region retries with
a smaller step. Differences use the allowed side.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.core.arrays import Floats
from palpate.core.faults import InputError, number_in_range
from palpate.tissue.homogeneous import isochoric_stress, nominal_stress
from palpate.tissue.materials import Material
from palpate.tissue.measurements import Measurement
from palpate.tissue.parameters import Layout, field_metadata, flatten

RELATIVE_STEP = 6e-6  # of differences: the cube root of the rounding error
SMALL_MODULUS_RATIO = 1e-3  # smallest step size of a modulus, over the largest modulus
BOUND_TOLERANCE = 1e-4  # relative change of the residual norm


class FitProblem:
    """Residuals of a law's free parameters against measurements, with arguments of `palpate.tissue.fitting.fit`.

    `names` are those of the k free parameters, which start at `first` (k,) between `low` and `high` (k,). `draw_bounds`
    (k, 2) are bounds for the random starts; NaN where none were given. `moduli` (k,) is True where the stress is linear
    in a parameter. `target` (n,) are the measured stresses over their deviations and the `unit`, the scale of the
    stresses over their deviations.
    """

    def __init__(
        self,
        law: type[Material],
        measurements: Sequence[Measurement],
        start: Mapping[str, Any],
        bounds: Mapping[str, tuple[float, float]],
        fixed: Mapping[str, Any],
        density: float,
        poisson: float,
    ) -> None:
        self.layout = Layout(law, _merge_values(start, fixed))
        self.measurements = tuple(measurements)
        self._rest: dict[str, float] = {"density": density, "poisson": poisson}
        self._all = self.layout.first.copy()
        constant = {place for name, value in flatten(fixed).items() for place in self._fix(name, value)}
        self._free = [k for k in range(len(self._all)) if k not in constant]
        if not self._free:
            raise InputError("fixed must leave at least one free parameter, got all parameters")
        self.names = tuple(self.layout.names[k] for k in self._free)
        stress = np.concatenate([m.stress for m in self.measurements])
        deviation = np.concatenate([np.asarray(m.deviation) for m in self.measurements])
        self.unit = float(np.sqrt(np.mean((stress / deviation) ** 2))) or 1.0
        self._deviation = deviation * self.unit
        self.target = stress / self._deviation
        if len(stress) <= len(self.names):
            raise InputError(f"measurements must have more than {len(self.names)} points, got {len(stress)}; give more")
        self.first = self._all[self._free]
        self.material(self.first)  # raises the law's own error for an invalid start
        self.low, self.high = np.array([self._law_bounds(k) for k in range(len(self.names))]).T
        self.draw_bounds = np.full((len(self.names), 2), np.nan)
        self._set_bounds(bounds, set(flatten(start)))
        self.material(self.first)
        self.moduli = self._find_moduli()

    def _fix(self, name: str, value: float) -> list[int]:
        places = self.layout.places(name)
        self._all[places] = value
        return places

    def _law_bounds(self, k: int) -> tuple[float, float]:
        """Return the bounds of a parameter in the law: those of its field, or zero if it rejects negative numbers."""
        metadata = field_metadata(self.layout.law, self.names[k])
        if "low" in metadata:
            return metadata["low"], metadata["high"]
        negative = self.first.copy()
        negative[k] = -abs(negative[k])
        try:
            self.material(negative)
        except InputError:
            return 0.0, math.inf
        return -math.inf, math.inf

    def _set_bounds(self, bounds: Mapping[str, tuple[float, float]], given: set[str]) -> None:
        for name, (low, high) in bounds.items():
            for k in [self._free.index(place) for place in self.layout.places(name) if place in self._free]:
                least, most = max(low, self.low[k]), min(high, self.high[k])
                if not least < most:
                    allowed = f"[{self.low[k]:g}, {self.high[k]:g}]"
                    raise InputError(f"bounds of {name} must overlap {allowed}, got ({low:g}, {high:g})")
                self.draw_bounds[k] = self.low[k], self.high[k] = least, most
                if self.names[k] in given:
                    number_in_range(f"start of {self.names[k]}", self.first[k], least, most)
                elif np.isfinite(most - least):
                    self.first[k] = np.sqrt(least * most) if least > 0 else (least + most) / 2
                else:
                    self.first[k] = min(max(self.first[k], least), most)

    def _find_moduli(self) -> NDArray[np.bool_]:
        are_moduli = np.zeros(len(self.names), dtype=bool)
        start = self.isochoric(self.first)
        for k, value in enumerate(self.first):
            step = (value or 1.0) * np.eye(len(are_moduli))[k]
            once, twice = (self.isochoric(self.first + times * step) - start for times in (1, 2))
            largest = np.abs(once).max()
            are_moduli[k] = largest > 0 and np.abs(twice - 2 * once).max() < 1e-9 * (largest + np.abs(start).max())
        return are_moduli

    def material(self, x: Floats) -> Material:
        """Return the material of a vector of free parameters; raises `InputError` if the law rejects it."""
        vector = self._all.copy()
        vector[self._free] = x
        rest: dict[str, Any] = dict(self._rest)
        return self.layout.law(**self.layout.arguments(vector), **rest)

    def residuals(self, x: Floats) -> Floats:
        """Return the scaled differences of stress, (n,); NaN if the law rejects `x`."""
        return self._predict(x, nominal_stress) - self.target

    def isochoric(self, x: Floats) -> Floats:
        """Return the scaled stresses at constant volume, (n,); NaN if the law rejects `x`."""
        return self._predict(x, isochoric_stress)

    def _predict(self, x: Floats, stress: Callable[[Material, str, Floats], Floats]) -> Floats:
        try:
            material = self.material(x)
        except InputError:
            return np.full(len(self.target), np.nan)
        stresses = np.concatenate([stress(material, m.kind, m.deformation) for m in self.measurements])
        return stresses / self._deviation

    def jacobian(self, x: Floats) -> Floats:
        """Return the Jacobian of the residuals, (n, k), by differences within the bounds."""
        center, columns = self.residuals(x), []
        largest = np.abs(x[self.moduli]).max(initial=0.0)
        sizes = np.maximum(
            np.abs(x), np.where(self.moduli, SMALL_MODULUS_RATIO * largest, np.where(x == 0, SMALL_MODULUS_RATIO, 0.0))
        )
        for k, value in enumerate(x):
            sides = []
            for sign in (1, -1):
                moved = x.copy()
                moved[k] += sign * RELATIVE_STEP * sizes[k]
                shifted = self.residuals(moved)
                inside = self.low[k] <= moved[k] <= self.high[k] and np.all(np.isfinite(shifted))
                sides.append((shifted, moved[k]) if inside else (center, value))
            (ahead, right), (behind, left) = sides
            columns.append((ahead - behind) / (right - left) if right > left else np.zeros_like(center))
        return np.stack(columns, axis=1)

    def on_bound(self, x: Floats) -> NDArray[np.bool_]:
        """Return the parameters on a bound, up to a negligible change of the residuals."""
        slopes = np.linalg.norm(self.jacobian(x), axis=0)
        negligible = BOUND_TOLERANCE * np.linalg.norm(self.residuals(x)) + 1e-9
        return (slopes > 0) & (slopes * np.minimum(x - self.low, self.high - x) < negligible)

    def snap_to_bounds(self, x: Floats) -> Floats:
        """Return `x` with parameters near a bound moved onto it, if the law allows."""
        nearer = np.where(x - self.low < self.high - x, self.low, self.high)
        exact = np.where(self.on_bound(x), nearer, x)
        return exact if np.all(np.isfinite(self.residuals(exact))) else x


def _merge_values(start: Mapping[str, Any], fixed: Mapping[str, Any]) -> dict[str, Any]:
    """Return the given values by field; an element of a sequence is fixed by its own name, `C[0]`."""
    for name, value in flatten(fixed).items():
        number_in_range(f"fixed {name}", value)
    return {**start, **{name: value for name, value in fixed.items() if "[" not in name}}
