"""Catalogue of the material laws, the fibre laws and the relaxation.

Command line, files, tests and validation read the laws from this list only.
"""

from __future__ import annotations

import inspect
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from functools import cached_property
from typing import Any

from palpate.core.faults import InputError, brief, interval
from palpate.core.parameters import declared
from palpate.tissue.fibres import FibreLaw, Fibres, Guccione
from palpate.tissue.invariant_laws import ArrudaBoyce, Fung, Gent, StVenantKirchhoff, Yeoh
from palpate.tissue.materials import Material, MooneyRivlin, NeoHookean
from palpate.tissue.prony import Prony
from palpate.tissue.small_strain import LinearElastic
from palpate.tissue.stretch_laws import Exponential, Logarithmic, Ogden


@dataclass(frozen=True)
class Parameter:
    """Parameter of a law."""

    # name, unit: the unit of a dimensionless parameter is empty
    name: str
    unit: str
    range: str  # interval of allowed values, such as ``"(0, inf)"``


@dataclass(frozen=True)
class CatalogueEntry:
    """Catalogue entry of a class with parameters."""

    kind: type[Material] | type[FibreLaw] | type[Prony]  # class of the material, the fibre law or the relaxation
    formula: str  # energy, for display
    reference: str  # source of the law
    example: dict[str, Any]  # parameters of a soft tissue, without density and Poisson's ratio
    note: str = ""  # constraints on the parameters beyond their ranges, and remarks

    @property
    def name(self) -> str:
        """Name of the class, as `palpate` exports it."""
        return self.kind.__name__

    @cached_property
    def parameters(self) -> tuple[Parameter, ...]:
        """Parameters of the class that have a range, in order."""
        declarations = (f for f in declared(self.kind) if f.name not in Material.__dataclass_fields__)
        return tuple(Parameter(f.name, f.metadata["unit"], _range(f.metadata)) for f in declarations)


@dataclass(frozen=True, kw_only=True)
class Law(CatalogueEntry):
    """Catalogue entry of an isotropic material law.

    Its formula is the energy without the volumetric part U(J), with x = I1 - 3 - 2 ln J and q(a) = l1^a + l2^a + l3^a -
    3 - a ln J.

    `expression` is the formula as a Python expression of the parameters, ``I1``, ``I2``, ``J``, ``x``, ``q``, ``l1``,
    ``l2``, ``l3``, ``log`` and ``exp``. Tests and finite elements compare the compiled functions with it. It is empty
    for small strain.

    `shear_modulus` is the formula of the shear modulus at rest; its value is near 10 kPa with the parameters of the
    example.
    """

    kind: type[Material]
    expression: str
    shear_modulus: str


def _range(about: Mapping[str, Any]) -> str:
    return interval(about["low"], about["high"], open_low=about["open_low"])


LAWS: tuple[Law, ...] = (
    Law(
        kind=NeoHookean, shear_modulus="2 C1",
        formula="C1 x",
        expression="C1*x",
        reference="Banihani, Rabczuk, Almomani, Math. Probl. Eng. 2013, equation (17)",
        example={"C1": 5e3},
    ),
    Law(
        kind=MooneyRivlin, shear_modulus="C1 + C2",
        formula="C1/2 (I1 - 3) + C2/2 (I2 - 3) - (C1 + 2 C2) ln J",
        expression="C1/2*(I1 - 3) + C2/2*(I2 - 3) - (C1 + 2*C2)*log(J)",
        reference="Mooney, J. Appl. Phys. 11, 582, 1940; equation (16)",
        example={"C1": 8e3, "C2": 2e3},
    ),
    Law(
        kind=Ogden, shear_modulus="1/2 sum of C_i alpha_i^2",
        formula="sum of C_i q(alpha_i)",
        expression="sum(Ci*q(ai) for Ci, ai in zip(C, alpha))",
        reference="Ogden, Proc. R. Soc. A 326, 565, 1972; equation (14)",
        example={"C": (800.0, 120.0), "alpha": (4.0, -7.5)},
        note="1 to 16 terms; alpha_i is nonzero",
    ),
    Law(
        kind=Exponential, shear_modulus="1/2 (C1 C2 alpha1^2 + C3 alpha2^2)",
        formula="C1 [exp(C2 q(alpha1)) - 1] + C3 q(alpha2)",
        expression="C1*(exp(C2*q(alpha1)) - 1) + C3*q(alpha2)",
        reference="Gao, Lister, Desai, Ann. Biomed. Eng. 38, 505, 2010; equation (18)",
        example={"C1": 2e3, "C2": 1.5, "C3": 3e3, "alpha1": 2.0, "alpha2": 1.5},
        note="alpha1 and alpha2 are nonzero",
    ),
    Law(
        kind=Logarithmic, shear_modulus="1/2 (C1 C2 alpha1^2 + C3 alpha2^2)",
        formula="-C1 ln(1 - C2 q(alpha1)) + C3 q(alpha2)",
        expression="-C1*log(1 - C2*q(alpha1)) + C3*q(alpha2)",
        reference="Gao, Lister, Desai, Ann. Biomed. Eng. 38, 505, 2010; equation (19)",
        example={"C1": 10e3, "C2": 0.35, "C3": 3e3, "alpha1": 2.0, "alpha2": 1.5},
        note="alpha1 and alpha2 are nonzero; continued by a parabola from C2 q(alpha1) = 0.95",
    ),
    Law(
        kind=Yeoh, shear_modulus="2 C1",
        formula="C1 x + C2 x^2 + C3 x^3",
        expression="C1*x + C2*x**2 + C3*x**3",
        reference="Yeoh, Rubber Chem. Technol. 63, 792, 1990",
        example={"C1": 5e3, "C2": 1e3, "C3": 200.0},
        note="C2 > -sqrt(3 C1 C3), or C2 >= 0",
    ),
    Law(
        kind=Gent, shear_modulus="mu",
        formula="-mu/2 Jm ln(1 - x/Jm)",
        expression="-mu/2*Jm*log(1 - x/Jm)",
        reference="Gent, Rubber Chem. Technol. 69, 59, 1996",
        example={"mu": 10e3, "Jm": 3.0},
        note="continued by a parabola from x = 0.95 Jm",
    ),
    Law(
        kind=ArrudaBoyce, shear_modulus="mu (1 + 3/(5N) + 99/(175N^2) + ...)",
        formula="five terms of the eight chains' series in 3 + x",
        expression="mu*(x/2 + ((3 + x)**2 - 9)/(20*N) + 11*((3 + x)**3 - 27)/(1050*N**2)"
        " + 19*((3 + x)**4 - 81)/(7000*N**3) + 519*((3 + x)**5 - 243)/(673750*N**4))",
        reference="Arruda, Boyce, J. Mech. Phys. Solids 41, 389, 1993",
        example={"mu": 7.5e3, "N": 2.5},
    ),
    Law(
        kind=Fung, shear_modulus="mu",
        formula="mu/(2b) [exp(b x) - 1]",
        expression="mu/(2*b)*(exp(b*x) - 1)",
        reference="Fung, Am. J. Physiol. 213, 1532, 1967; Demiray, J. Biomech. 5, 309, 1972",
        example={"mu": 10e3, "b": 0.6},
    ),
    Law(
        kind=StVenantKirchhoff, shear_modulus="mu",
        formula="mu tr E^2,  E = (C - I) / 2",
        expression="mu/4*((l1**2 - 1)**2 + (l2**2 - 1)**2 + (l3**2 - 1)**2)",
        reference="Holzapfel, Nonlinear Solid Mechanics, Wiley 2000",
        example={"mu": 10e3},
        note="softens in compression",
    ),
    Law(
        kind=LinearElastic, shear_modulus="mu",
        formula="mu e : e,  e = sym(F - I), with lame/2 (tr e)^2 for the bulk term",
        expression="",
        reference="Landau, Lifshitz, Theory of Elasticity, section 4",
        example={"mu": 10e3},
        note="small strain only, not objective; full-model solids only, not membranes",
    ),
)  # fmt: skip

FIBRE_LAWS: tuple[CatalogueEntry, ...] = (
    CatalogueEntry(
        kind=Fibres,
        formula="k1/(2 k2) [exp(k2 <E>^2) - 1],  E = dispersion (I1bar - 3) + (1 - 3 dispersion) (I4bar - 1)",
        reference="Gasser, Ogden, Holzapfel, J. R. Soc. Interface 3, 15, 2006",
        example={"k1": 20e3, "k2": 5.0, "dispersion": 0.1},
        note="one or two families; <E> is E where it is positive, else 0: in tension only",
    ),
    CatalogueEntry(
        kind=Guccione,
        formula="C/2 [exp(Q) - 1],  Q = bf E11^2 + bt (E22^2 + E33^2 + 2 E23^2) + 2 bfs (E12^2 + E13^2)",
        reference="Guccione, McCulloch, Waldman, J. Biomech. Eng. 113, 42, 1991",
        example={"C": 2e3, "bf": 8.0, "bt": 2.0, "bfs": 4.0},
        note="one family, 1 along it; VolumeOnly(mu=...) is the material of tissue that has no other energy",
    ),
)

RELAXATION = CatalogueEntry(
    kind=Prony,
    formula="sum of shares_i mu/4 |A_i|^2,  dA_i/dt = dCbar/dt - A_i / times_i",
    reference="Simo, Comput. Methods Appl. Mech. Eng. 60, 153, 1987; Holzapfel, Simo, Int. J. Solids Struct. 33, 1996",
    example={"shares": (0.5, 0.3), "times": (0.02, 0.3)},
    note="a share and a time for each branch; bulk_shares as many, or none",
)


def law_class(law: type[Material] | str) -> type[Material]:
    """Return the class of a law, by itself or by its name, whatever the case, with or without hyphens."""
    if isinstance(law, type) and issubclass(law, Material) and not inspect.isabstract(law):
        return law
    classes, near = {each.name.lower(): each.kind for each in LAWS}, []
    if isinstance(law, str):
        name = law.replace("-", "").replace("_", "").replace(" ", "").lower()
        if name in classes:
            return classes[name]
        near = get_close_matches(name[:60], classes, 1)
    names = ", ".join(sorted(kind.__name__ for kind in classes.values()))
    remedy = f"; did you mean {classes[near[0]].__name__}?" if near else ""
    raise InputError(f"law must be one of {names}, or its class, got {brief(law)}{remedy}")
