"""The laws as docs/reference/laws.md prints them, for finite elements and closed forms: SymPy derives them.

Nothing here calls a law of palpate: its class gives the name and the parameters, and everything else, moduli at rest
included, comes from the printed energy as a function of the principal stretches. Energies of fibres are differentiated
by a complex step. All quantities are in SI units.
"""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np
import sympy

import palpate as pt
from palpate.tissue.catalogue import LAWS

STRETCHES = sympy.symbols("l1:4", positive=True)
I1 = sum(s**2 for s in STRETCHES)
I2 = sum(s**2 * t**2 for s, t in zip(STRETCHES, STRETCHES[1:] + STRETCHES[:1], strict=True))
J = STRETCHES[0] * STRETCHES[1] * STRETCHES[2]
x = I1 - 3 - 2 * sympy.log(J)
VOLUMETRIC = {
    "quadratic": (J - 1) ** 2 / 2,
    "logarithmic": sympy.log(J) ** 2 / 2,
    "mixed": (J**2 - 1 - 2 * sympy.log(J)) / 4,
}


def q(a: Any) -> Any:
    return sum(s**a for s in STRETCHES) - 3 - a * sympy.log(J)


EXPRESSIONS = {law.name: law.expression for law in LAWS} | {"VolumeOnly": "Integer(0)"}
SYMBOLS = {
    **{str(s): s for s in STRETCHES}, "I1": I1, "I2": I2, "J": J, "x": x, "q": q,
    "log": sympy.log, "exp": sympy.exp, "Integer": sympy.Integer,
}  # fmt: skip
BARS = {"I1bar": I1 * J ** sympy.Rational(-2, 3), "I2bar": I2 * J ** sympy.Rational(-4, 3), "I1": I1, "I2": I2, "J": J}


def printed_energy(law: pt.materials.Material) -> Any:
    """The energy W_s of a law, in SymPy's symbols of the stretches."""
    base = {f.name for f in fields(pt.materials.Material)}
    own = {f.name: getattr(law, f.name) for f in fields(law) if f.name not in base}
    text = getattr(law, "expression", None)
    if text is None:
        return eval(EXPRESSIONS[type(law).__name__], SYMBOLS | own)
    return sympy.sympify(text, locals={**BARS, **{str(s): s for s in STRETCHES}}).subs(own)


class Printed:
    """A law's printed energy with its volumetric part.

    Parameters
    ----------
    law : pt.materials.Material
        Compressible; not LinearElastic.

    Attributes
    ----------
    shear, lame : float
        Shear modulus at rest and coefficient of the volumetric part [Pa].
    density, slopes, bends : functions of three stretches
        W [J/m^3], its three derivatives, and its six second ones: 11, 22, 33, 12, 13, 23.
    """

    def __init__(self, law: pt.materials.Material) -> None:
        energy, even = printed_energy(law), sympy.Symbol("l", positive=True)
        rest = dict.fromkeys(STRETCHES, 1)
        found = [sympy.diff(energy, STRETCHES[0], s).subs(rest) for s in STRETCHES[:2]]
        self.shear = float(found[0] - found[1]) / 2 or law.shear_modulus  # VolumeOnly's is what it is told
        own = float(sympy.diff(energy.subs(dict.fromkeys(STRETCHES, even)), even, 2).subs(even, 1)) / 9
        self.lame = 2 * self.shear * (1 + law.poisson) / (3 * (1 - 2 * law.poisson)) - own
        whole = energy + self.lame * VOLUMETRIC[law.volumetric]
        first = [sympy.diff(whole, s) for s in STRETCHES]
        pairs = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))
        second = [sympy.diff(first[i], STRETCHES[j]) for i, j in pairs]
        self.density, self.slopes, self.bends = (
            sympy.lambdify(STRETCHES, each, "numpy", cse=True) for each in (whole, first, second)
        )

    def stress(self, F: np.ndarray) -> np.ndarray:
        """First Piola-Kirchhoff stress [Pa] for F of shape (..., 3, 3): dW/dl_i along the principal directions."""
        turned, stretches, directions = np.linalg.svd(F)
        slopes = np.stack(np.broadcast_arrays(*self.slopes(*np.moveaxis(stretches, -1, 0))), axis=-1)
        return (turned * slopes[..., None, :]) @ directions


class Small:
    """Hooke's law of the small strain."""

    def __init__(self, law: pt.materials.LinearElastic) -> None:
        self.mu, self.lame = law.mu, 2 * law.mu * law.poisson / (1 - 2 * law.poisson)

    def stress(self, F: np.ndarray) -> np.ndarray:
        strain = (F + np.swapaxes(F, -1, -2)) / 2 - np.eye(3)
        return 2 * self.mu * strain + self.lame * np.trace(strain, axis1=-2, axis2=-1)[..., None, None] * np.eye(3)


def fibre_energy(fibres: pt.materials.FibreLaw, F: np.ndarray) -> np.ndarray:
    """Energy [J/m^3] of straight families of fibres, for F of shape (..., 3, 3), complex too."""
    C = np.swapaxes(F, -1, -2) @ F
    C = C * (np.linalg.det(F) ** (-2 / 3))[..., None, None]
    total = np.zeros(F.shape[:-2], dtype=F.dtype)
    for a in fibres.directions:
        if isinstance(fibres, pt.materials.Fibres):
            kappa = fibres.dispersion
            E = kappa * (np.trace(C, axis1=-2, axis2=-1) - 3) + (1 - 3 * kappa) * (a @ C @ a - 1)
            E = np.where(E.real > 0, E, 0)
            total = total + fibres.k1 / (2 * fibres.k2) * (np.exp(fibres.k2 * E**2) - 1)
        else:
            frame = np.linalg.qr(np.column_stack([a, np.eye(3)]))[0]  # its first column lies along a
            E = frame.T @ ((C - np.eye(3)) / 2) @ frame
            Q = fibres.bf * E[..., 0, 0] ** 2 + 2 * fibres.bfs * (E[..., 0, 1] ** 2 + E[..., 0, 2] ** 2)
            Q = Q + fibres.bt * (E[..., 1, 1] ** 2 + E[..., 2, 2] ** 2 + 2 * E[..., 1, 2] ** 2)
            total = total + fibres.C / 2 * (np.exp(Q) - 1)
    return total


class Reinforced:
    """A law and fibres in it."""

    def __init__(self, law: pt.materials.Material, fibres: pt.materials.FibreLaw) -> None:
        self.law, self.fibres = printed(law), fibres

    def stress(self, F: np.ndarray) -> np.ndarray:
        P, step = self.law.stress(F), 1e-30
        for i, j in np.ndindex(3, 3):
            changed = F.astype(complex)
            changed[..., i, j] += 1j * step
            P[..., i, j] += fibre_energy(self.fibres, changed).imag / step
        return P


def printed(law: pt.materials.Material, fibres: pt.materials.FibreLaw | None = None) -> Printed | Small | Reinforced:
    """The printed law of one of palpate's, with fibres or without."""
    if fibres is not None:
        return Reinforced(law, fibres)
    return Small(law) if isinstance(law, pt.materials.LinearElastic) else Printed(law)
