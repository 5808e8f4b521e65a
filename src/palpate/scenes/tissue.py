"""Materials and fibres of a scene's tissue."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from difflib import get_close_matches
from typing import Any

import numpy as np

from palpate.core.faults import InputError
from palpate.core.parameters import quantity
from palpate.scenes.description import Fibre, Tissue
from palpate.tissue.catalogue import FIBRE_LAWS, LAWS, CatalogueEntry
from palpate.tissue.fibres import FibreLaw
from palpate.tissue.liver import SHEAR_MODULUS
from palpate.tissue.materials import Material
from palpate.tissue.prony import Prony
from palpate.tissue.small_strain import LinearElastic
from palpate.tissue.symbolic_law import Hyperelastic


def material_of(tissue: Tissue, changes: Mapping[str, Any] | None = None) -> Material:
    """Return the material of a tissue, with changed parameters of a region.

    Parameters that are left out are those of the law's example in the catalogue; the example of the neo-Hookean
    law is liver.
    """
    relaxation = tissue.relaxation
    prony = relaxation and Prony(shares=relaxation.shares, times=relaxation.times, bulk_shares=relaxation.bulk_shares)
    base: dict[str, Any] = {
        "density": tissue.density, "poisson": tissue.poisson, "prony": prony,
        "volumetric": tissue.volumetric, "split": tissue.split,
    }  # fmt: skip
    values = {**tissue.parameters, **(changes or {})}
    if tissue.energy:
        return Hyperelastic(
            tissue.energy, **base, **{name: _number(name, value, "Pa", name) for name, value in values.items()}
        )
    law = _entry("law", tissue.law, LAWS)
    parameters = dict(law.example)
    if law.name == "NeoHookean":
        parameters["C1"] = SHEAR_MODULUS / 2
    return law.kind(**base, **parameters | _parameters(law, values))


def offered_laws(tissue: Tissue) -> tuple[str, ...]:
    """Return the names of the laws that a tissue may have in place of its own, that first; none for a text."""
    if tissue.energy:
        return ()
    special = tissue.volumetric != "quadratic" or tissue.split != "coupled"  # which small strain does not have
    others = (law.name for law in LAWS if law.name != tissue.law and not (special and law.kind is LinearElastic))
    return (tissue.law, *others)


def of_law(tissue: Tissue, name: str) -> Tissue:
    """Return a tissue of another law with the same shear modulus and Poisson's ratio at rest.

    The parameters are those of the law's example in the catalogue, with moduli scaled by one factor.
    """
    if name == tissue.law:
        return tissue
    law = _entry("law", name, LAWS)
    example = law.kind(density=tissue.density, poisson=tissue.poisson, **law.example)
    factor = material_of(tissue).shear_modulus / example.shear_modulus
    units = {parameter.name: parameter.unit for parameter in law.parameters}

    def scaled(key: str, value: Any) -> Any:
        if isinstance(value, tuple):
            return tuple(scaled(key, each) for each in value)
        return factor * value if units[key] == "Pa" else value

    return replace(tissue, law=name, parameters={key: scaled(key, value) for key, value in law.example.items()})


def parameters_text(tissue: Tissue) -> str:
    """Return the parameters of a tissue's law for people, such as ``C1 = 60 kPa, C2 = 1.2 kPa``."""
    law, material = _entry("law", tissue.law, LAWS), material_of(tissue)
    texts = []
    for parameter in law.parameters:
        value = getattr(material, parameter.name)
        values = value if isinstance(value, tuple) else (value,)
        in_unit = [1e-3 * each for each in values] if parameter.unit == "Pa" else values
        unit = {"Pa": " kPa", "": ""}.get(parameter.unit, f" {parameter.unit}")
        texts.append(f"{parameter.name} = {', '.join(f'{each:.3g}' for each in in_unit)}{unit}")
    return "; ".join(texts)


def fibres_of(fibre: Fibre) -> FibreLaw:
    """Return the fibre law of a section; raise `InputError` for wrong parameters."""
    law = _entry("law", fibre.law, FIBRE_LAWS)
    directions = np.array(fibre.directions, dtype=float).reshape(-1, 3)
    if not len(directions):
        raise InputError("directions of fibres must hold a direction, got none; give one such as [[1, 0, 0]]")
    lengths = np.linalg.norm(directions, axis=1, keepdims=True)
    if not np.all(lengths > 0):
        raise InputError("directions of fibres must not be zero, got a zero; give a direction such as [1, 0, 0]")
    return law.kind(directions=directions / lengths, **_parameters(law, fibre.parameters))


def _entry(name: str, word: str, entries: Sequence[CatalogueEntry]) -> Any:
    entries_by_name = {entry.name: entry for entry in entries}
    if word not in entries_by_name:
        near = get_close_matches(word[:60], entries_by_name, 1)
        remedy = f"did you mean {near[0]}?" if near else "palpate laws lists them"
        raise InputError(f"{name} must be one of {', '.join(entries_by_name)}, got {word!r:.60}; {remedy}")
    return entries_by_name[word]


def _parameters(law: CatalogueEntry, entries: Mapping[str, Any]) -> dict[str, Any]:
    """Return the parameters of a law in SI units."""
    units = {parameter.name: parameter.unit for parameter in law.parameters}
    values = {}
    for key, value in entries.items():
        if key not in units:
            near = get_close_matches(str(key)[:60], units, 1)
            remedy = f"did you mean {near[0]}?" if near else "palpate laws lists them"
            raise InputError(f"parameters must be {', '.join(units)} for {law.name}, got {key!r:.60}; {remedy}")
        values[key] = _number(key, value, units[key], key)
    return values


def _number(name: str, value: Any, unit: str, key: str) -> Any:
    """Return a number, or a tuple of numbers, in SI units."""
    if isinstance(value, list | tuple):
        return tuple(_number(name, each, unit, key) for each in value)
    try:
        return quantity(value, unit)
    except InputError as error:
        raise InputError(f"{name} {error}") from None
