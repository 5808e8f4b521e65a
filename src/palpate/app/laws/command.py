"""The command ``palpate laws``: every law of tissue, fibres, relaxation and volume, with its parameters."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from palpate.app.common.console import print_json
from palpate.tissue.catalogue import FIBRE_LAWS, LAWS, RELAXATION, CatalogueEntry, Law
from palpate.tissue.volumetric import FORM_BY_NAME, QUADRATIC

LAWS_TEXT = """\
Strain energies W [J/m^3]. To each comes a volumetric part U(J), last in this list, with lame from the given poisson
or bulk modulus. x = I1 - 3 - 2 ln J and q(a) = l1^a + l2^a + l3^a - 3 - a ln J, which are the printed I1 - 3 and
l1^a + l2^a + l3^a - 3 where the volume stays. All laws also take density [kg/m^3], and poisson in [0, 0.499] or bulk
[Pa]; for a membrane poisson=0.5. Formulas, sources and curves: docs/reference/laws.md
"""
FIBRES_TEXT = """\
Fibres, Solid(form="energy", fibres=...): the energy of a family of unit vectors a, to be given as directions=...,
by Cbar = J^(-2/3) C, E = (Cbar - I) / 2, I1bar = tr Cbar, I4bar = a . Cbar a.
"""
RELAXATION_TEXT = """\
Relaxation, prony=...: an energy that is added to that of any law and decays, mu its shear modulus at rest.
"""
VOLUMETRIC_TEXT = """\
Volumetric part, volumetric=...: U(J), the same bulk modulus at rest.
"""


def laws(as_json: bool) -> int:
    """Print all laws, for people or for machines; return 0."""
    if as_json:
        print_json(
            {
                "laws": [_entry(law) for law in LAWS],
                "fibre_laws": [_entry(law) for law in FIBRE_LAWS],
                "relaxation": _entry(RELAXATION),
                "volumetric": [
                    {"name": name, "energy": _volumetric(name), "default": name == QUADRATIC} for name in FORM_BY_NAME
                ],
            }
        )
        return 0
    for head, entries in ((LAWS_TEXT, LAWS), (FIBRES_TEXT, FIBRE_LAWS), (RELAXATION_TEXT, (RELAXATION,))):
        print(head)
        for entry in entries:
            print("\n".join(_lines(entry)), end="\n\n")
    print(VOLUMETRIC_TEXT)
    for name in FORM_BY_NAME:
        print(f"{name}\n  U = {_volumetric(name)}{'; by default' if name == QUADRATIC else ''}\n")
    return 0


def _volumetric(name: str) -> str:
    return f"lame {FORM_BY_NAME[name].formula}"


def _entry(entry: CatalogueEntry) -> dict[str, Any]:
    law_entry = {
        "name": entry.name,
        "energy": entry.formula,
        "parameters": [asdict(parameter) for parameter in entry.parameters],
        "note": entry.note,
        "reference": entry.reference,
        "example": entry.example,
    }
    if isinstance(entry, Law):
        law_entry |= {"variables": entry.kind.variables, "shear_modulus": entry.shear_modulus}
    return law_entry


def _lines(entry: CatalogueEntry) -> list[str]:
    parameters = (f"{p.name}{f' [{p.unit}]' if p.unit else ''} in {p.range}" for p in entry.parameters)
    lines = [f"{entry.name}", f"  W = {entry.formula}", f"  {', '.join(parameters)}"]
    if entry.note:
        lines.append(f"  {entry.note}")
    modulus = f"shear modulus {entry.shear_modulus}; " if isinstance(entry, Law) else ""
    return [*lines, f"  {modulus}{entry.reference}"]
