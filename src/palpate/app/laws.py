"""The command ``palpate laws``: every material law, with its parameters."""

from __future__ import annotations

from dataclasses import asdict
from typing import Any

from palpate.app.console import print_json
from palpate.tissue.catalogue import LAWS, Law

__all__ = ["laws"]

HEAD = """\
Strain energies W [J/m^3]. To each comes lame/2 (J - 1)^2, with lame from the asked-for poisson or bulk modulus, or
another form: volumetric="logarithmic" is lame/2 (ln J)^2, volumetric="mixed" is lame/4 (J^2 - 1 - 2 ln J).
x = I1 - 3 - 2 ln J and q(a) = l1^a + l2^a + l3^a - 3 - a ln J, which are the printed I1 - 3 and l1^a + l2^a + l3^a - 3
where the volume stays. All laws also take density [kg/m^3], and poisson in [0, 0.499] or bulk [Pa]; for a membrane
poisson=0.5. Formulas, sources and curves: docs/laws.md
"""


def laws(as_json: bool) -> int:
    """Print all laws, for people or for machines; return 0."""
    if as_json:
        print_json({"laws": [_entry(law) for law in LAWS]})
        return 0
    print(HEAD)
    for law in LAWS:
        print("\n".join(_lines(law)), end="\n\n")
    return 0


def _entry(law: Law) -> dict[str, Any]:
    return {
        "name": law.name,
        "energy": law.formula,
        "variables": law.kind.variables,
        "shear_modulus": law.shear_modulus,
        "parameters": [asdict(parameter) for parameter in law.parameters],
        "note": law.note,
        "reference": law.reference,
        "example": law.example,
    }


def _lines(law: Law) -> list[str]:
    parameters = (f"{p.name}{f' [{p.unit}]' if p.unit else ''} in {p.range}" for p in law.parameters)
    lines = [f"{law.name}", f"  W = {law.formula}", f"  {', '.join(parameters)}"]
    if law.note:
        lines.append(f"  {law.note}")
    return [*lines, f"  shear modulus {law.shear_modulus}; {law.reference}"]
