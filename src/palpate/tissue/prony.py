"""Viscoelastic relaxation as a Prony series."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from palpate.core.arrays import Floats
from palpate.core.describe import Described, Fact
from palpate.core.faults import InputError, check_names
from palpate.core.parameters import check_parameters, parameter

MAX_BRANCHES = 64  # a few per decade of time are enough; each has history variables at every node


@dataclass(frozen=True, kw_only=True)
class Prony(Described):
    """Prony series of viscoelastic overstresses, in addition to the equilibrium stress of a law.

    The law is the equilibrium response. Branch i is a Maxwell element in parallel to it, of finite
    isochoric strain (Holzapfel and Simo, Int. J. Solids Struct. 33, 1996). Its strain A_i follows
    the tissue and relaxes,

        dA_i/dt = dC̄/dt - A_i / tau_i,     C̄ = J^(-2/3) C,

    it stores ``s_i mu/4 |A_i|^2`` and dissipates ``s_i mu/2 |A_i|^2 / tau_i``, with mu the law's shear
    modulus at rest. The dissipation is never negative. At small strain the relaxation modulus is

        mu (1 + sum of s_i exp(-t / tau_i)),

    and the storage and loss moduli are mu (1 + sum of s_i (w tau_i)^2 / (1 + (w tau_i)^2)) and
    mu sum of s_i w tau_i / (1 + (w tau_i)^2).

    Parameters
    ----------
    shares : float or sequence of float
        s_i, ratio of each branch's shear modulus to the law's at rest; positive. At most 64
        branches.
    times : float or sequence of float [s]
        Relaxation times tau_i, positive; one for each share.
    bulk_shares : float or sequence of float, optional
        Ratios for the bulk modulus, with the same times: branches of J - 1. By default the volume
        does not relax.

    Raises
    ------
    InputError
        A number is out of range, or the lengths differ.

    Examples
    --------
    >>> import palpate as pt
    >>> branch = pt.materials.Prony(shares=0.5, times=0.1)
    >>> law = pt.materials.NeoHookean(C1=1.1e3, density=1060, poisson=0.45, prony=branch)
    >>> float(branch.relaxation(0.0)), round(float(branch.relaxation(0.1)), 4)
    (1.5, 1.1839)
    """

    shares: tuple[float, ...] = parameter(
        help="modulus of each branch over that of the law", above=0.0, most=MAX_BRANCHES
    )
    times: tuple[float, ...] = parameter("s", help="relaxation times", above=0.0, most=MAX_BRANCHES)
    bulk_shares: tuple[float, ...] = parameter("", (), "the same for the bulk modulus", low=0.0, most=MAX_BRANCHES)

    def __new__(cls, *unnamed: Any, **parameters: Any) -> Self:
        check_names(cls.__name__, parameters, {f.name: f.metadata["unit"] for f in fields(cls)})
        return super().__new__(cls)

    def _facts(self) -> list[Fact]:
        return [
            ("branches", len(self.times), ""),
            ("shares", self.shares, ""),
            ("times", self.times, "s"),
            ("bulk shares", self.bulk_shares or None, ""),
            ("modulus at once over that at rest", 1 + sum(self.shares), ""),
        ]

    def __post_init__(self) -> None:
        check_parameters(self)
        if not self.shares or len(self.shares) != len(self.times):
            raise InputError(
                f"shares and times must have equal, non-zero length, got {len(self.shares)} and {len(self.times)}"
            )
        if self.bulk_shares and len(self.bulk_shares) != len(self.times):
            raise InputError(
                f"bulk_shares must be empty or as long as times, got lengths {len(self.bulk_shares)} and "
                f"{len(self.times)}"
            )

    def relaxation(self, times: Floats) -> Floats:
        """Return the relaxation modulus over the equilibrium modulus, 1 + sum of s_i exp(-t / tau_i), at times [s]."""
        decay = np.exp(-np.asarray(times, dtype=float)[..., None] / np.array(self.times))
        return np.asarray(1 + decay @ np.array(self.shares))

    def complex_modulus(self, frequencies: Floats) -> NDArray[np.complex128]:
        """Return the complex modulus over the equilibrium modulus at angular frequencies [rad/s]."""
        iw_tau = 1j * np.asarray(frequencies, dtype=float)[..., None] * np.array(self.times)
        return np.asarray(1 + (iw_tau / (1 + iw_tau)) @ np.array(self.shares))
