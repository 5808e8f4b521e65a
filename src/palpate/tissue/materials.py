"""Isotropic strain energies: the contract of a law, and the two laws of the paper's examples.

A material is a strain energy per reference volume [J/m^3], split as

    W(F) = W_s(I1, I2, J) + U(J)

into a *shear part* W_s and a *volumetric part* U. The collocation differentiates W_s directly. The
pressure p = U'(J) is smoothed before it is differentiated, so that nearly incompressible tissue
does not lock. Here I1 = tr C, I2 = (I1^2 - tr C^2) / 2, J = det F, C = F^T F. The volumetric part
of every law is

    U(J) = lame / 2 (J - 1)^2,

or another of the usual forms (`palpate.tissue.volumetric`). `lame` follows from the given bulk
modulus at rest.

A new law is a frozen dataclass with its parameters, `shear_modulus`, `shear_bulk_modulus` and three
static functions `energy`, `first` and `second` of the invariants and the tuple of coefficients. The
compiled kernels inline the functions; elsewhere they are called with arrays. So they are limited to
arithmetic and NumPy functions. A law of the principal stretches is a `StretchLaw`
(`palpate.tissue.stretch_laws`). `palpate.tissue.catalogue` lists all laws.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, fields
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from palpate.core.describe import Described, Fact
from palpate.core.faults import InputError, brief, check_names, number_in_range, warn_of_unit
from palpate.core.parameters import check_parameters, parameter
from palpate.tissue.isochoric import COUPLED, check_split, isochoric
from palpate.tissue.prony import Prony
from palpate.tissue.volumetric import QUADRATIC, volumetric_form

MAX_POISSON = 0.499  # largest ratio with verified stability of the split pressure
EQUAL_MODULI_TOLERANCE = 1e-12  # relative difference of equal moduli
EXPECTED_DENSITIES = 100.0, 20_000.0  # [kg/m^3]; other densities are probably in another unit
EXPECTED_MODULI = 1.0, 1e8  # [Pa] shear moduli; others are probably in another unit


@dataclass(frozen=True, kw_only=True)
class Material(Described, ABC):
    """Strain energy, its derivatives, and density.

    Parameters
    ----------
    density : float [kg/m^3]
        Density of the reference state.
    poisson : float, optional
        Poisson's ratio at rest, 0 to 0.499, or 0.5 for the incompressible material of a membrane.
        Give this or `bulk`; both only if they are consistent.
    bulk : float, optional [Pa]
        Bulk modulus at rest.
    prony : Prony, optional
        Viscoelastic relaxation; the law is the equilibrium response.
    volumetric : str
        Form of the volumetric part U(J): ``"quadratic"`` lame / 2 (J - 1)^2, ``"logarithmic"`` lame
        / 2 (ln J)^2, or ``"mixed"`` lame / 4 (J^2 - 1 - 2 ln J). All have the same bulk modulus at
        rest.
    split : str
        ``"coupled"``: W_s(C), which also resists a change of volume. ``"isochoric"``: W_s(J^(-2/3)
        C), so that only U(J) resists it and `lame` is the bulk modulus
        (`palpate.tissue.isochoric`). Both agree in an incompressible material.

    Raises
    ------
    InputError
        A parameter is out of range, a form or split is unknown, or `poisson` and `bulk` are both
        missing or inconsistent; or the law has no such parameter.

    Warns
    -----
    UnitWarning
        A density or a shear modulus at rest is far from that of tissue, and probably in another
        unit.

    Attributes
    ----------
    variables : str
        Arguments of the law: ``"invariants"`` I1, I2, J; ``"stretches"`` l1, l2, l3; or ``"small
        strain"``.

    Examples
    --------
    >>> import numpy as np
    >>> import palpate as pt
    >>> law = pt.materials.NeoHookean(C1=1.1e3, density=1060, poisson=0.45)
    >>> law.stress(np.diag([1.1, 1.0, 1.0])).round(1).tolist()
    [[2400.0, 0.0, 0.0], [0.0, 2178.0, 0.0], [0.0, 0.0, 2178.0]]
    """

    variables: ClassVar[str] = "invariants"

    density: float = parameter("kg/m^3", help="density", above=0.0)
    poisson: float | None = parameter("", None, "Poisson's ratio at rest", low=0.0, high=MAX_POISSON)
    bulk: float | None = parameter("Pa", None, "bulk modulus at rest", low=0.0)
    prony: Prony | None = None
    volumetric: str = QUADRATIC
    split: str = COUPLED
    _public = (
        "bulk_modulus", "coefficients", "energy", "first", "incompressible", "second", "shear_modulus", "strain_energy",
        "stress",
    )  # fmt: skip

    def __new__(cls, *unnamed: Any, **values: Any) -> Self:
        units = {f.name: f.metadata.get("unit", "") for f in fields(cls)}
        parameters = {name: unit for name, unit in units.items() if name not in Material.__dataclass_fields__}
        if unnamed:
            names = ", ".join(f"{name}=..." for name in (*parameters, "density", "poisson"))
            raise InputError(f"arguments of {cls.__name__} must have names, got {brief(unnamed[0])}; give {names}")
        check_names(cls.__name__, values, parameters | units)
        return super().__new__(cls)

    def _facts(self) -> list[Fact]:
        base = Material.__dataclass_fields__
        prony, compressible = self.prony, not self.incompressible
        return [
            *((f.name, getattr(self, f.name), f.metadata.get("unit", "")) for f in fields(self) if f.name not in base),
            ("density", float(self.density), "kg/m^3"),
            ("poisson", f"{self.poisson:.4g}", ""),
            ("shear modulus", float(self.shear_modulus), "Pa"),
            ("bulk modulus", self.bulk_modulus if compressible else None, "Pa"),
            ("energy", getattr(self, "expression", None), ""),  # of a symbolic law
            ("volumetric", self.volumetric if self.volumetric != QUADRATIC else None, ""),
            ("split", self.split if self.split != COUPLED else None, ""),
            ("relaxation times", None if prony is None else prony.times, "s"),
            ("relaxation shares", None if prony is None else prony.shares, ""),
        ]

    def __post_init__(self) -> None:
        if self.prony is not None and not isinstance(self.prony, Prony):
            raise InputError(f"prony must be a palpate.materials.Prony, got {brief(self.prony)}")
        volumetric_form(self.volumetric)
        if self.volumetric != QUADRATIC and self.variables == "small strain":
            raise InputError(f"volumetric must be {QUADRATIC!r} for small strain, got {brief(self.volumetric)}")
        if check_split(self.split) != COUPLED and self.variables == "small strain":
            raise InputError(f"split must be {COUPLED!r} for small strain, got {brief(self.split)}")
        self._check_parameters()
        if self.poisson is None and self.bulk is None:
            raise InputError("poisson or bulk must be given, got neither; give either poisson or bulk")
        modulus = None if self.bulk is None else number_in_range("bulk", self.bulk, 0.0, unit="Pa")
        try:
            mu = self.shear_modulus
            self._complete(number_in_range("the shear modulus at rest", mu, 0.0, open_low=True, unit="Pa"))
            if not self.incompressible:
                number_in_range("the bulk modulus at rest", self.bulk_modulus, 0.0, unit="Pa")
                number_in_range("the Lame coefficient at rest", self.lame, unit="Pa")
        except ArithmeticError as error:
            raise InputError(
                f"the moduli of {type(self).__name__} at rest must be finite, got {error}; change its parameters"
            ) from None
        if modulus is not None:
            if not np.isclose(modulus, self.bulk_modulus, rtol=1e-9, atol=0.0):
                raise InputError(
                    f"bulk must be {self.bulk:g} Pa with poisson = {self.poisson:g}, got {modulus:g} Pa; give either "
                    f"poisson or bulk"
                )
            object.__setattr__(self, "bulk", modulus)  # bit for bit
        self.warn_of_units()

    def warn_of_units(self) -> None:
        """Warn of a density or a shear modulus at rest that is far from that of tissue."""
        name, mu = type(self).__name__, self.shear_modulus
        warn_of_unit(f"the density of {name}", self.density, *EXPECTED_DENSITIES, "kg/m^3", "densities are in kg/m^3")
        warn_of_unit(f"the shear modulus of {name}", mu, *EXPECTED_MODULI, "Pa", "moduli are in pascals")

    def _complete(self, mu: float) -> None:
        """Set `bulk` from `poisson`, or `poisson` from `bulk`, for a shear modulus [Pa]."""
        if self.incompressible:
            object.__setattr__(self, "bulk", np.inf)
        elif self.poisson is not None:
            check_parameters(self, left_out=("bulk",))
            object.__setattr__(self, "bulk", 2 * mu * (1 + self.poisson) / (3 * (1 - 2 * self.poisson)))
        else:
            low, high = (2 * mu * (1 + nu) / (3 * (1 - 2 * nu)) for nu in (0.0, MAX_POISSON))
            bulk = number_in_range("bulk", self.bulk, low * (1 - 1e-9), high * (1 + 1e-9), unit="Pa")  # type: ignore[arg-type]
            object.__setattr__(self, "poisson", (3 * bulk - 2 * mu) / (2 * (3 * bulk + mu)))

    def _check_parameters(self) -> None:
        """Check the density and the law's own parameters; Poisson's ratio follows with the moduli."""
        check_parameters(self, left_out=("poisson", "bulk"))

    @property
    @abstractmethod
    def shear_modulus(self) -> float:
        """Shear modulus at rest [Pa]."""

    @property
    @abstractmethod
    def shear_bulk_modulus(self) -> float:
        """Contribution of the coupled shear part to the bulk modulus at rest [Pa]."""

    @property
    def law(self) -> type[Material]:
        """Class of the functions in use: the material's, or its isochoric counterpart."""
        return type(self) if self.split == COUPLED else isochoric(type(self))

    @property
    def incompressible(self) -> bool:
        """Whether Poisson's ratio is 0.5, so that the law does not define the pressure."""
        return self.poisson == 0.5

    @property
    def bulk_modulus(self) -> float:
        """Bulk modulus at rest [Pa]."""
        assert self.bulk is not None
        return self.bulk

    @property
    def lame(self) -> float:
        """Coefficient of the volumetric part U(J) [Pa], its second derivative at rest."""
        difference = self.bulk_modulus - self.shear_share
        return 0.0 if abs(difference) <= EQUAL_MODULI_TOLERANCE * self.bulk_modulus else difference

    @property
    def shear_share(self) -> float:
        """Contribution of W_s to the bulk modulus at rest [Pa]: `shear_bulk_modulus`, or zero if isochoric."""
        return self.shear_bulk_modulus if self.split == COUPLED else 0.0

    @property
    def coefficients(self) -> tuple[float, ...]:
        """Parameters of the law, in the order of its fields, as arguments of its functions."""
        base = {f.name for f in fields(Material)}
        return tuple(float(getattr(self, f.name)) for f in fields(self) if f.name not in base)

    @staticmethod
    @abstractmethod
    def energy(I1: Any, I2: Any, J: Any, c: tuple[float, ...]) -> Any:
        """Return W_s [J/m^3]."""

    @staticmethod
    @abstractmethod
    def first(I1: Any, I2: Any, J: Any, c: tuple[float, ...]) -> tuple[Any, Any, Any]:
        """Return the derivatives of W_s by I1, I2, J."""

    @staticmethod
    @abstractmethod
    def second(I1: Any, I2: Any, J: Any, c: tuple[float, ...]) -> tuple[Any, Any, Any, Any, Any, Any]:
        """Return the second derivatives of W_s by (I1 I1), (I1 I2), (I2 I2), (I1 J), (I2 J), (J J)."""

    def strain_energy(self, F: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the energy W [J/m^3] for deformation gradients of shape (..., 3, 3)."""
        self._refuse_incompressible()
        measure, _ = volumetric_form(self.volumetric).measure(self._dilatation(F))
        return np.asarray(self.shear_energy(F) + self.lame / 2 * measure**2)

    def shear_energy(self, F: NDArray[np.float64], coefficients: tuple[Any, ...] | None = None) -> NDArray[np.float64]:
        """Return the shear part W_s [J/m^3] of the energy for F of shape (..., 3, 3).

        `coefficients`, arrays (...), replace the material's own.
        """
        I1, I2, J = _invariants(F)
        J = np.where(J > 0, J, np.nan)  # inverted bodies have no energy
        return np.asarray(self.law.energy(I1, I2, J, coefficients or self.coefficients))

    def stress(self, F: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the first Piola-Kirchhoff stress dW/dF [Pa], (..., 3, 3): the transpose of (21)."""
        self._refuse_incompressible()
        return np.asarray(
            self.shear_stress(F) + (self.lame * self.pressure_slope(F))[..., None, None] * self.cofactor(F)
        )

    def pressure_slope(self, F: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the pressure U'(J) over `lame`, shape (...), for F of shape (..., 3, 3)."""
        return np.asarray(volumetric_form(self.volumetric).pressure(self._dilatation(F))[0])

    def shear_stress(self, F: NDArray[np.float64], coefficients: tuple[Any, ...] | None = None) -> NDArray[np.float64]:
        """Return the first Piola-Kirchhoff stress [Pa] of W_s; parameters as for `shear_energy`."""
        I1, I2, J = (i[..., None, None] for i in _invariants(F))
        values = self.coefficients if coefficients is None else tuple(c[..., None, None] for c in coefficients)
        W1, W2, WJ = self.law.first(I1, I2, J, values)
        C = np.swapaxes(F, -1, -2) @ F
        return np.asarray(2 * W1 * F + 2 * W2 * (I1 * F - F @ C) + WJ * self.cofactor(F))

    def cofactor(self, F: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the cofactor dJ/dF = cof F, the factor of the pressure in the stress, of shape (..., 3, 3)."""
        return np.asarray(np.linalg.det(F)[..., None, None] * np.swapaxes(np.linalg.inv(F), -1, -2))

    def _dilatation(self, F: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(np.linalg.det(F) - 1)

    def _refuse_incompressible(self) -> None:
        if self.incompressible:
            raise InputError("poisson must be below 0.5 for the stress of a solid, got 0.5; use 0.499, or a Membrane")


@dataclass(frozen=True, kw_only=True)
class ShearLaw(Material):
    """Law whose first parameter is its shear modulus at rest, with 2/3 of it in the bulk modulus.

    Parameters
    ----------
    mu : float [Pa]
        Positive.
    density, poisson, bulk
        As for `Material`.
    """

    mu: float = parameter("Pa", above=0.0)

    @property
    def shear_modulus(self) -> float:
        return self.mu

    @property
    def shear_bulk_modulus(self) -> float:
        return 2 / 3 * self.mu


def _invariants(F: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    C = np.swapaxes(F, -1, -2) @ F
    I1 = np.trace(C, axis1=-2, axis2=-1)
    return I1, (I1**2 - np.einsum("...ij,...ij", C, C)) / 2, np.linalg.det(F)


@dataclass(frozen=True, kw_only=True)
class NeoHookean(Material):
    """Neo-Hookean law, equation (17), with the factor as printed.

    W = C1 (I1 - 3) - 2 C1 ln J + lame / 2 (J - 1)^2,  shear modulus 2 C1.

    Parameters
    ----------
    C1 : float [Pa]
        Positive.
    density, poisson, bulk
        As for `Material`.

    Examples
    --------
    >>> import palpate as pt
    >>> law = pt.materials.NeoHookean(C1=1.1e3, density=1060, poisson=0.45)
    >>> round(law.shear_modulus, 3), round(law.bulk_modulus, 3)
    (2200.0, 21266.667)
    """

    C1: float = parameter("Pa", above=0.0)

    @property
    def shear_modulus(self) -> float:
        return 2 * self.C1

    @property
    def shear_bulk_modulus(self) -> float:
        return 4 / 3 * self.C1

    @staticmethod
    def energy(I1, I2, J, c):
        return c[0] * (I1 - 3.0) - 2.0 * c[0] * np.log(J)

    @staticmethod
    def first(I1, I2, J, c):
        return c[0], 0.0, -2.0 * c[0] / J

    @staticmethod
    def second(I1, I2, J, c):
        return 0.0, 0.0, 0.0, 0.0, 0.0, 2.0 * c[0] / (J * J)


@dataclass(frozen=True, kw_only=True)
class MooneyRivlin(Material):
    """Mooney-Rivlin law, equation (16), with the factors as printed.

    W = C1/2 (I1 - 3) + C2/2 (I2 - 3) - (C1 + 2 C2) ln J + lame / 2 (J - 1)^2,  shear modulus C1 + C2.

    Parameters
    ----------
    C1 : float [Pa]
        Positive.
    C2 : float [Pa]
        Not negative.
    density, poisson, bulk
        As for `Material`.

    Examples
    --------
    >>> import palpate as pt
    >>> law = pt.materials.MooneyRivlin(C1=60e3, C2=1.2e3, density=1120, poisson=0.49)
    >>> round(law.shear_modulus, 3), round(law.bulk_modulus, 3)
    (61200.0, 3039600.0)
    """

    C1: float = parameter("Pa", above=0.0)
    C2: float = parameter("Pa", low=0.0)

    @property
    def shear_modulus(self) -> float:
        return self.C1 + self.C2

    @property
    def shear_bulk_modulus(self) -> float:
        return 2 / 3 * (self.C1 + self.C2) + 2 * self.C2

    @staticmethod
    def energy(I1, I2, J, c):
        return 0.5 * c[0] * (I1 - 3.0) + 0.5 * c[1] * (I2 - 3.0) - (c[0] + 2.0 * c[1]) * np.log(J)

    @staticmethod
    def first(I1, I2, J, c):
        return 0.5 * c[0], 0.5 * c[1], -(c[0] + 2.0 * c[1]) / J

    @staticmethod
    def second(I1, I2, J, c):
        return 0.0, 0.0, 0.0, 0.0, 0.0, (c[0] + 2.0 * c[1]) / (J * J)
