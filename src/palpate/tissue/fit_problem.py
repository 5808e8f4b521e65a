"""The least-squares problem of a law against measured curves: residuals, their slopes, and where to start.

A parameter that the stress is linear in (a modulus) needs no guess: every start takes its moduli from linear least
squares, given the others. A law may refuse a vector of parameters; the residuals are NaN there, which the trust region
steps back from, and the slopes are taken on the allowed side.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.faults import InputError, number_in_range
from palpate.tissue.homogeneous import isochoric_stress, nominal_stress
from palpate.tissue.materials import Material
from palpate.tissue.measurements import Measurement
from palpate.tissue.parameters import Layout, flatten

__all__ = ["Problem"]

Floats = NDArray[np.float64]

STEP = 6e-6  # relative, of the slopes: the cube root of the rounding
SPREAD = 8.0  # factor by which a start's nonlinear parameters differ from the first one's, either way
DRAWS = 100  # of a start, until the law takes it
INSIDE = 1e-3  # how far from its bound a start lies at least, relative


class Problem:
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
        Their first start and bounds.
    unit : float
        What makes residuals, stress differences over deviations, of order 1.
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
        self._stress = np.concatenate([m.stress for m in self.measurements])
        self._deviation = np.concatenate([np.asarray(m.deviation) for m in self.measurements])
        self.unit = float(np.sqrt(np.mean((self._stress / self._deviation) ** 2))) or 1.0
        if len(self._stress) <= len(self.names):
            raise InputError(f"{len(self._stress)} points cannot tell {len(self.names)} parameters: give more")
        self.first = self._all[self._free]
        self.material(self.first)  # a start that the law refuses is refused by the law's own words
        self._drawn = np.full((len(self.names), 2), np.nan)
        self.low, self.high = np.array([self._allowed(k) for k in range(len(self.names))]).T
        self._bound(bounds)
        self._moduli = self._find_moduli()

    def _hold(self, name: str, value: float) -> list[int]:
        places = self.layout.places(name)
        self._all[places] = value
        return places

    def _bound(self, bounds: Mapping[str, tuple[float, float]]) -> None:
        for name, (low, high) in bounds.items():
            if not low < high:
                raise InputError(f"bounds of {name} = ({low:g}, {high:g}): the first must be less than the second")
            for place in self.layout.places(name):
                if place in self._free:
                    k = self._free.index(place)
                    self._drawn[k] = low, high
                    self.low[k], self.high[k] = max(low, self.low[k]), min(high, self.high[k])

    def _allowed(self, k: int) -> tuple[float, float]:
        """Bounds that the law itself has: its field names them, or it refuses a negative number."""
        said = self.layout.metadata(self.names[k])
        if "low" in said:
            return said["low"], said["high"]
        negative = self.first.copy()
        negative[k] = -abs(negative[k])
        return (-math.inf if self._taken(negative) else 0.0), math.inf

    def material(self, x: Floats) -> Material:
        """Return the material of a vector of free parameters; raises `InputError` if the law refuses it."""
        vector = self._all.copy()
        vector[self._free] = x
        return self.layout.law(**self.layout.arguments(vector), **self._rest)

    def _taken(self, x: Floats) -> bool:
        try:
            self.material(x)
        except InputError:
            return False
        return True

    def residuals(self, x: Floats) -> Floats:
        """Return differences of stress over their deviations and the unit, (n,); NaN if the law refuses `x`."""
        return (self._predicted(x, nominal_stress) - self._stress) / (self._deviation * self.unit)

    def _predicted(self, x: Floats, stress: Callable[[Material, str, Floats], Floats]) -> Floats:
        try:
            material = self.material(x)
        except InputError:
            return np.full(len(self._stress), np.nan)
        return np.concatenate([stress(material, m.kind, m.deformation) for m in self.measurements])

    def jacobian(self, x: Floats) -> Floats:
        """Return the slopes of the residuals, (n, k), by differences within what is allowed."""
        here, columns = self.residuals(x), []
        for k, value in enumerate(x):
            step = STEP * max(abs(value), INSIDE * abs(self.first[k]))
            sides = []
            for sign in (1, -1):
                moved = x.copy()
                moved[k] += sign * step
                there = self.residuals(moved)
                inside = self.low[k] <= moved[k] <= self.high[k] and np.all(np.isfinite(there))
                sides.append((there, moved[k]) if inside else (here, value))
            (ahead, right), (behind, left) = sides
            columns.append((ahead - behind) / (right - left) if right > left else np.zeros_like(here))
        return np.stack(columns, axis=1)

    def starts(self, count: int, seed: int) -> list[Floats]:
        """Return the first start and others drawn about it or between its bounds; one if the law is linear."""
        nonlinear = ~self._moduli
        self.first = self._with_moduli(self._inside(self.first))
        if not np.any(nonlinear):
            return [self.first]
        random = np.random.default_rng(seed)
        return [self.first, *(self._draw(random, nonlinear) for _ in range(count - 1))]

    def _draw(self, random: np.random.Generator, nonlinear: NDArray[np.bool_]) -> Floats:
        for _ in range(DRAWS):
            x = self.first.copy()
            for k in np.flatnonzero(nonlinear):
                low, high = self._drawn[k]
                if np.isfinite(high - low):
                    evenly = low <= 0
                    x[k] = random.uniform(low, high) if evenly else np.exp(random.uniform(np.log(low), np.log(high)))
                    continue
                x[k] = (abs(x[k]) or 1.0) * np.exp(random.uniform(-1, 1) * np.log(SPREAD))
                x[k] *= random.choice([-1, 1]) if self.low[k] < 0 else 1
            x = self._with_moduli(self._inside(x))
            if np.all(np.isfinite(self.residuals(x))):
                return x
        return self.first.copy()

    def _inside(self, x: Floats) -> Floats:
        """Move a start off its bounds, into the range between them."""
        room = INSIDE * np.minimum(np.maximum(np.abs(x), np.abs(x).max() * self._modular), self.high - self.low)
        return np.clip(x, self.low + room, self.high - room)

    @property
    def _modular(self) -> Floats:
        return self._moduli.astype(float) if hasattr(self, "_moduli") else np.zeros(len(self.names))

    def _find_moduli(self) -> NDArray[np.bool_]:
        """Which parameters the stress is linear in, where the volume stays."""
        found = np.zeros(len(self.names), dtype=bool)
        here = self._predicted(self.first, isochoric_stress)
        for k, value in enumerate(self.first):
            rise = [self._predicted(self._moved(k, share * (value or 1.0)), isochoric_stress) - here for share in (1, 2)]
            largest = np.abs(rise[0]).max()
            found[k] = largest > 0 and np.abs(rise[1] - 2 * rise[0]).max() < 1e-9 * (largest + np.abs(here).max())
        return found

    def _moved(self, k: int, step: float) -> Floats:
        x = self.first.copy()
        x[k] += step
        return x

    def _with_moduli(self, x: Floats) -> Floats:
        """Set the moduli of a start to those of least squares within their bounds, were the volume kept."""
        from scipy.optimize import lsq_linear

        weights = 1 / (self._deviation * self.unit)
        places = np.flatnonzero(self._moduli)
        here = self._predicted(x, isochoric_stress)
        if not len(places) or not np.all(np.isfinite(here)):
            return x
        steps = [x[k] or 1.0 for k in places]
        moved = [x + step * np.eye(len(x))[k] for k, step in zip(places, steps, strict=True)]
        columns = np.stack([self._predicted(m, isochoric_stress) - here for m in moved], axis=1) * weights[:, None]
        norms = np.linalg.norm(columns, axis=0)
        if not np.all(np.isfinite(norms)) or not np.all(norms > 0):
            return x
        scale = steps / norms  # of a modulus, per unit of stress
        target = (self._stress - here) * weights + columns @ (x[places] / steps)
        limits = self.low[places] / scale, self.high[places] / scale
        solved = x.copy()
        solved[places] = scale * lsq_linear(columns / norms, target, bounds=limits).x
        solved = self._inside(solved)
        if np.all(np.isfinite(self.residuals(solved))):
            return solved
        share = float((here * weights) @ (self._stress * weights)) / float((here * weights) @ (here * weights))
        return np.where(self._moduli, abs(share) * x, x)


def _merged(start: Mapping[str, Any], fixed: Mapping[str, Any]) -> dict[str, Any]:
    """Return what is given of each field; a part of a sequence may be fixed by its own name, `C[0]`."""
    for name, value in flatten(fixed).items():
        number_in_range(f"fixed {name}", value)
    return {**start, **{name: value for name, value in fixed.items() if "[" not in name}}
