"""Volumetric energies U(J): three usual forms.

Each is U(J) = lame / 2 g(J)^2 with a measure g of the change of volume. g = 0 and g' = 1 at rest,
so that all have the same bulk modulus there:

    quadratic     g = J - 1                                U = lame / 2 (J - 1)^2
    logarithmic   g = ln J                                 U = lame / 2 (ln J)^2
    mixed         g = +- sqrt((J^2 - 1) / 2 - ln J)        U = lame / 4 (J^2 - 1 - 2 ln J)

The first is the paper's. The second (Hencky) and the third (Simo, Taylor, Comput. Methods Appl.
Mech. Eng. 51, 1985) have infinite energy at J = 0. The pressure p = U'(J) of the second decreases
beyond J = e. The measure g can be smoothed and sampled, and its square remains an energy
(`palpate.dynamics.solid.energy_form`).

The functions take x = J - 1, which avoids cancellation near rest. The compiled kernels inline
them; elsewhere they are called with arrays.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from palpate.core.faults import InputError, brief


@dataclass(frozen=True)
class Volumetric:
    """Form of U(J)."""

    name: str
    formula: str  # u / lame
    measure: Any  # returns g and g'(J) for J - 1
    pressure: Any  # returns U'(J) / lame and U''(J) / lame for J - 1


def _quadratic_measure(x):
    return x, 1.0


def _quadratic_pressure(x):
    return x, 1.0


def _logarithmic_measure(x):
    return np.log1p(x), 1.0 / (1.0 + x)


def _logarithmic_pressure(x):
    r = 1.0 / (1.0 + x)
    g = np.log1p(x)
    return g * r, (1.0 - g) * r * r


def _mixed_measure(x):
    # g^2 = x^2 (1/2 + (x - ln(1 + x)) / x^2), with a series for the difference near rest
    series = 1 / 2 - x * (1 / 3 - x * (1 / 4 - x * (1 / 5 - x * (1 / 6 - x * (1 / 7 - x * (1 / 8 - x / 9))))))
    small = 1.0 * (np.abs(x) < 0.02)  # sums, because `np.where` allocates in compiled code
    safe = small + (1.0 - small) * x
    root = np.sqrt(0.5 + small * series + (1.0 - small) * (safe - np.log1p(safe)) / (safe * safe))
    return x * root, 0.5 * (2.0 + x) / ((1.0 + x) * root)


def _mixed_pressure(x):
    r = 1.0 / (1.0 + x)
    return 0.5 * x * (2.0 + x) * r, 0.5 * (1.0 + r * r)


QUADRATIC = "quadratic"
FORM_BY_NAME = {
    form.name: form
    for form in (
        Volumetric(QUADRATIC, "(J - 1)^2 / 2", _quadratic_measure, _quadratic_pressure),
        Volumetric("logarithmic", "(ln J)^2 / 2", _logarithmic_measure, _logarithmic_pressure),
        Volumetric("mixed", "(J^2 - 1 - 2 ln J) / 4", _mixed_measure, _mixed_pressure),
    )
}


def volumetric_form(name: str) -> Volumetric:
    """Return a form by its name."""
    if not isinstance(name, str) or name not in FORM_BY_NAME:
        raise InputError(f"volumetric must be one of {', '.join(map(repr, FORM_BY_NAME))}, got {brief(name)}")
    return FORM_BY_NAME[name]
