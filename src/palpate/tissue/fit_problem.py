"""The least-squares problem of a law against measured curves: residuals, their slopes and bounds.

A law may refuse a vector of parameters. The residuals are NaN there, which a trust region steps back from, and slopes
are taken on the allowed side.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.arrays import Floats
from palpate.faults import InputError, number_in_range
from palpate.tissue.homogeneous import isochoric_stress, nominal_stress
from palpate.tissue.materials import Material
from palpate.tissue.measurements import Measurement
from palpate.tissue.parameters import Layout, field_metadata, flatten

__all__ = ["FitProblem"]


STEP = 6e-6  # relative, of the slopes: the cube root of the rounding
SMALL = 1e-3  # share of the largest modulus that one near zero is taken for, in a step
AT_BOUND = 1e-4  # of the norm of the residuals


class FitProblem:
    """Residuals of a law's free parameters against measurements.

    Parameters
    ----------
    law : type of Material
    measurements : sequence of Measurement
    start, bounds, fixed, density, poisson
        As for `palpate.tissue.fitting.fit`.

    Attributes
    ----------
    names : tuple of str
        Of the free parameters.
    first, low, high : (k,) array
        Where the first start begins, and bounds.
    drawn : (k, 2) array
        Bounds between which other starts are drawn; NaN where none were given.
    moduli : (k,) array of bool
        Parameters that the stress is linear in.
    target : (n,) array
        Measured stresses over their deviations and the unit.
    unit : float
        What makes stresses over their deviations of order 1.
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
        self.layout = Layout(law, _merged(start, fixed))
        self.measurements = tuple(measurements)
        self._rest: dict[str, float] = {"density": density, "poisson": poisson}
        self._all = self.layout.first.copy()
        held = {place for name, value in flatten(fixed).items() for place in self._hold(name, value)}
        self._free = [k for k in range(len(self._all)) if k not in held]
        if not self._free:
            raise InputError("every parameter is fixed: nothing is left to fit")
        self.names = tuple(self.layout.names[k] for k in self._free)
        stress = np.concatenate([m.stress for m in self.measurements])
        deviation = np.concatenate([np.asarray(m.deviation) for m in self.measurements])
        self.unit = float(np.sqrt(np.mean((stress / deviation) ** 2))) or 1.0
        self._deviation = deviation * self.unit
        self.target = stress / self._deviation
        if len(stress) <= len(self.names):
            raise InputError(f"{len(stress)} points cannot tell {len(self.names)} parameters: give more")
        self.first = self._all[self._free]
        self.material(self.first)  # a start that the law refuses is refused by the law's own words
        self.low, self.high = np.array([self._allowed(k) for k in range(len(self.names))]).T
        self.drawn = np.full((len(self.names), 2), np.nan)
        self._bound(bounds, set(flatten(start)))
        self.material(self.first)
        self.moduli = self._find_moduli()

    def _hold(self, name: str, value: float) -> list[int]:
        places = self.layout.places(name)
        self._all[places] = value
        return places

    def _allowed(self, k: int) -> tuple[float, float]:
        """Bounds that the law itself has: its field names them, or it refuses a negative number."""
        said = field_metadata(self.layout.law, self.names[k])
        if "low" in said:
            return said["low"], said["high"]
        negative = self.first.copy()
        negative[k] = -abs(negative[k])
        try:
            self.material(negative)
        except InputError:
            return 0.0, math.inf
        return -math.inf, math.inf

    def _bound(self, bounds: Mapping[str, tuple[float, float]], given: set[str]) -> None:
        for name, (low, high) in bounds.items():
            for k in [self._free.index(place) for place in self.layout.places(name) if place in self._free]:
                least, most = max(low, self.low[k]), min(high, self.high[k])
                if not least < most:
                    allowed = f"[{self.low[k]:g}, {self.high[k]:g}]"
                    raise InputError(f"bounds of {name} = ({low:g}, {high:g}) hold no range within {allowed}")
                self.drawn[k] = self.low[k], self.high[k] = least, most
                if self.names[k] in given:
                    number_in_range(f"start of {self.names[k]}", self.first[k], least, most)
                elif np.isfinite(most - least):
                    self.first[k] = np.sqrt(least * most) if least > 0 else (least + most) / 2
                else:
                    self.first[k] = min(max(self.first[k], least), most)

    def _find_moduli(self) -> NDArray[np.bool_]:
        found = np.zeros(len(self.names), dtype=bool)
        here = self.isochoric(self.first)
        for k, value in enumerate(self.first):
            step = (value or 1.0) * np.eye(len(found))[k]
            once, twice = (self.isochoric(self.first + times * step) - here for times in (1, 2))
            largest = np.abs(once).max()
            found[k] = largest > 0 and np.abs(twice - 2 * once).max() < 1e-9 * (largest + np.abs(here).max())
        return found

    def material(self, x: Floats) -> Material:
        """Return the material of a vector of free parameters; raises `InputError` if the law refuses it."""
        vector = self._all.copy()
        vector[self._free] = x
        rest: dict[str, Any] = dict(self._rest)
        return self.layout.law(**self.layout.arguments(vector), **rest)

    def residuals(self, x: Floats) -> Floats:
        """Return differences of stress over their deviations and the unit, (n,); NaN if the law refuses `x`."""
        return self._predicted(x, nominal_stress) - self.target

    def isochoric(self, x: Floats) -> Floats:
        """Return the stresses over their deviations and the unit, (n,), were the volume kept; NaN as `residuals`."""
        return self._predicted(x, isochoric_stress)

    def _predicted(self, x: Floats, stress: Callable[[Material, str, Floats], Floats]) -> Floats:
        try:
            material = self.material(x)
        except InputError:
            return np.full(len(self.target), np.nan)
        found = np.concatenate([stress(material, m.kind, m.deformation) for m in self.measurements])
        return found / self._deviation

    def jacobian(self, x: Floats) -> Floats:
        """Return the slopes of the residuals, (n, k), by differences within what is allowed."""
        here, columns = self.residuals(x), []
        largest = np.abs(x[self.moduli]).max(initial=0.0)
        sizes = np.maximum(np.abs(x), np.where(self.moduli, SMALL * largest, np.where(x == 0, SMALL, 0.0)))
        for k, value in enumerate(x):
            sides = []
            for sign in (1, -1):
                moved = x.copy()
                moved[k] += sign * STEP * sizes[k]
                there = self.residuals(moved)
                inside = self.low[k] <= moved[k] <= self.high[k] and np.all(np.isfinite(there))
                sides.append((there, moved[k]) if inside else (here, value))
            (ahead, right), (behind, left) = sides
            columns.append((ahead - behind) / (right - left) if right > left else np.zeros_like(here))
        return np.stack(columns, axis=1)

    def on_bound(self, x: Floats) -> NDArray[np.bool_]:
        """Return which parameters lie on a bound: to go there would change the residuals by next to nothing."""
        slopes = np.linalg.norm(self.jacobian(x), axis=0)
        nothing = AT_BOUND * np.linalg.norm(self.residuals(x)) + 1e-9
        return (slopes > 0) & (slopes * np.minimum(x - self.low, self.high - x) < nothing)

    def settled(self, x: Floats) -> Floats:
        """Return `x` with what all but lies on a bound right there, if the law takes it."""
        nearer = np.where(x - self.low < self.high - x, self.low, self.high)
        exact = np.where(self.on_bound(x), nearer, x)
        return exact if np.all(np.isfinite(self.residuals(exact))) else x


def _merged(start: Mapping[str, Any], fixed: Mapping[str, Any]) -> dict[str, Any]:
    """Return what is given of each field; a part of a sequence may be fixed by its own name, `C[0]`."""
    for name, value in flatten(fixed).items():
        number_in_range(f"fixed {name}", value)
    return {**start, **{name: value for name, value in fixed.items() if "[" not in name}}
