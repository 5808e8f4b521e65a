"""Heterogeneous tissue: one law, with different parameters in different regions."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from palpate.core.arrays import Floats
from palpate.core.describe import Described, Fact
from palpate.core.faults import InputError
from palpate.tissue.materials import Material

COMMON_FIELDS = {"split": "split", "volumetric": "volumetric form", "prony": "Prony series", "density": "density"}


@dataclass(frozen=True, eq=False)
class Regions(Described):
    """Assignment of materials of one law to nodes."""

    materials: tuple[Material, ...]  # `modulus_ratio` refers to the first
    which: NDArray[np.int64]  # (n,) int array: index of the material of each node

    def __post_init__(self) -> None:
        first = self.materials[0]
        for other in self.materials[1:]:
            if type(other) is not type(first):
                raise InputError(
                    f"the materials of a body must have one law, got {type(first).__name__} and {type(other).__name__}"
                )
            if len(other.coefficients) != len(first.coefficients):
                raise InputError(f"the materials of a body must have equal numbers of terms of {type(first).__name__}")
            for name, label in COMMON_FIELDS.items():
                if getattr(other, name) != getattr(first, name):
                    mine, its = getattr(first, name), getattr(other, name)
                    raise InputError(f"the materials of a body must have one {label}, got {mine!r} and {its!r}")
        if first.prony is not None and first.prony.bulk_shares:
            raise InputError("bulk_shares must be empty in a body of several materials; use one material or omit them")

    def _facts(self) -> list[Fact]:
        return [
            ("nodes", len(self.which), ""),
            ("materials", len(self.materials), ""),
            ("law", type(self.materials[0]).__name__, ""),
            ("shear moduli", tuple(float(each.shear_modulus) for each in self.materials), "Pa"),
        ]

    def at(self, nodes: Any) -> Self:
        """Return the regions of some nodes."""
        return replace(self, which=self.which[nodes])

    def values(self, name: str) -> Floats:
        """Return an attribute of every node's material, such as ``"lame"``, shape (n,)."""
        return np.array([getattr(material, name) for material in self.materials], dtype=float)[self.which]

    @property
    def coefficients(self) -> Floats:
        """The law's parameters at every node, (n, p)."""
        return np.array([material.coefficients for material in self.materials], dtype=float)[self.which]

    @property
    def modulus_ratio(self) -> Floats:
        """Shear modulus at rest over that of the first material, (n,); scales the branches of a Prony series."""
        return self.values("shear_modulus") / self.materials[0].shear_modulus

    @property
    def lame(self) -> float:
        """Reference value of the volumetric coefficients [Pa]: the largest."""
        return max(material.lame for material in self.materials) or 1.0

    def shear_energy(self, F: Floats) -> Floats:
        """Return W_s [J/m^3] at the nodes, for F of shape (n, 3, 3)."""
        return self.materials[0].shear_energy(F, tuple(self.coefficients.T))

    def shear_stress(self, F: Floats) -> Floats:
        """Return the shear part's first Piola-Kirchhoff stress [Pa] at the nodes, (n, 3, 3)."""
        return self.materials[0].shear_stress(F, tuple(self.coefficients.T))

    def stress(self, F: Floats) -> Floats:
        """Return the first Piola-Kirchhoff stress [Pa] at the nodes, (n, 3, 3)."""
        pressure = self.values("lame") * self.materials[0].pressure_slope(F)
        return self.shear_stress(F) + pressure[:, None, None] * self.materials[0].cofactor(F)
