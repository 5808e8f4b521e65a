"""How a law holds its volume: the three usual forms of U(J), by name.

Each is U(J) = lame / 2 g(J)^2 with a measure g of the volume's change, g = 0 and g' = 1 at rest, so that all have one
bulk modulus there:

    quadratic     g = J - 1                                U = lame / 2 (J - 1)^2
    logarithmic   g = ln J                                 U = lame / 2 (ln J)^2
    mixed         g = +- sqrt((J^2 - 1) / 2 - ln J)        U = lame / 4 (J^2 - 1 - 2 ln J)

The first is the law's of the paper. The second (Hencky) and the third (Simo, Taylor, Comput. Methods Appl. Mech. Eng.
51, 1985) have no finite energy at J = 0; of the second p = U'(J) falls again beyond J = e. A squared measure is what a
smoothing and a few moments can be taken of, so that the energy stays one (`palpate.dynamics.solid.energy_form`).

The functions take x = J - 1, of which nothing is lost near rest, are inlined in the compiled kernels, and take whole
arrays elsewhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from palpate.faults import InputError, brief

__all__ = ["FORMS", "QUADRATIC", "Volumetric", "volumetric_form"]


@dataclass(frozen=True)
class Volumetric:
    """A form of U(J).

    Parameters
    ----------
    name : str
    formula : str
        U over lame.
    measure : function
        Of J - 1: g and g'(J).
    pressure : function
        Of J - 1: U'(J) / lame and U''(J) / lame.
    """

    name: str
    formula: str
    measure: Any
    pressure: Any


def _quadratic_measure(x):  # type: ignore[no-untyped-def]
    return x, 1.0


def _quadratic_pressure(x):  # type: ignore[no-untyped-def]
    return x, 1.0


def _logarithmic_measure(x):  # type: ignore[no-untyped-def]
    return np.log1p(x), 1.0 / (1.0 + x)


def _logarithmic_pressure(x):  # type: ignore[no-untyped-def]
    r = 1.0 / (1.0 + x)
    g = np.log1p(x)
    return g * r, (1.0 - g) * r * r


def _mixed_measure(x):  # type: ignore[no-untyped-def]
    # g^2 = x^2 (1/2 + (x - ln(1 + x)) / x^2), where near rest a series takes the place of the difference
    series = 1 / 2 - x * (1 / 3 - x * (1 / 4 - x * (1 / 5 - x * (1 / 6 - x * (1 / 7 - x * (1 / 8 - x / 9))))))
    near = np.abs(x) < 0.02
    safe = np.where(near, 1.0, x)
    root = np.sqrt(0.5 + np.where(near, series, (safe - np.log1p(safe)) / (safe * safe)))
    return x * root, 0.5 * (2.0 + x) / ((1.0 + x) * root)


def _mixed_pressure(x):  # type: ignore[no-untyped-def]
    r = 1.0 / (1.0 + x)
    return 0.5 * x * (2.0 + x) * r, 0.5 * (1.0 + r * r)


QUADRATIC = "quadratic"
FORMS = {
    form.name: form
    for form in (
        Volumetric(QUADRATIC, "(J - 1)^2 / 2", _quadratic_measure, _quadratic_pressure),
        Volumetric("logarithmic", "(ln J)^2 / 2", _logarithmic_measure, _logarithmic_pressure),
        Volumetric("mixed", "(J^2 - 1 - 2 ln J) / 4", _mixed_measure, _mixed_pressure),
    )
}


def volumetric_form(name: str) -> Volumetric:
    """Return a form by its name.

    Raises
    ------
    InputError
        Names the forms.
    """
    if not isinstance(name, str) or name not in FORMS:
        raise InputError(f"volumetric = {brief(name)}: allowed are {', '.join(map(repr, FORMS))}")
    return FORMS[name]
