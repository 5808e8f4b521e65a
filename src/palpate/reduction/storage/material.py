"""Conversion of materials and fibres to header attributes of a model's file, and back."""

from __future__ import annotations

import json
from dataclasses import asdict, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.core.faults import InputError, brief, number_in_range
from palpate.tissue import symbolic_law
from palpate.tissue.catalogue import FIBRE_LAWS, LAWS
from palpate.tissue.fibres import FibreLaw, VolumeOnly
from palpate.tissue.isochoric import COUPLED
from palpate.tissue.materials import Material
from palpate.tissue.prony import Prony
from palpate.tissue.regions import Regions
from palpate.tissue.volumetric import QUADRATIC

LAW_BY_NAME = {law.name: law.kind for law in LAWS} | {"VolumeOnly": VolumeOnly}
FIBRE_LAW_BY_NAME: dict[str, Any] = {law.name: law.kind for law in FIBRE_LAWS}
SYMBOLIC_LAW = "Hyperelastic"


def describe_material(material: Material) -> dict[str, str]:
    """Return the attributes of a material: ``material``, ``parameters``, ``expression`` and ``prony``."""
    name, expression = type(material).__name__, getattr(material, "expression", "")
    law = symbolic_law.law_of(expression) if name == SYMBOLIC_LAW and expression else LAW_BY_NAME.get(name)
    if type(material) is not law:
        raise InputError(f"the law of {material} is not one of palpate's: it cannot be kept in a file")
    parameters = {f.name: getattr(material, f.name) for f in fields(material) if f.name != "prony"}
    if material.volumetric == QUADRATIC:  # the default of the file
        del parameters["volumetric"]
    if material.split == COUPLED:  # the default of the file
        del parameters["split"]
    if material.incompressible:  # there is no finite bulk modulus
        del parameters["bulk"]
    return {
        "material": name,
        "parameters": json.dumps(parameters),
        "expression": expression,
        "prony": json.dumps(asdict(material.prony) if material.prony else {}),
    }


def material_of(name: Any, parameters: Any, expression: Any, prony: Any) -> Material:
    """Return the material of attributes from `describe_material`, after full validation."""
    if not isinstance(name, str) or (name != SYMBOLIC_LAW and name not in LAW_BY_NAME):
        raise InputError(f"unknown material {brief(name)}: the laws are {', '.join(sorted(LAW_BY_NAME))}")
    law: Any = symbolic_law.law_of(expression) if name == SYMBOLIC_LAW else LAW_BY_NAME[name]
    entries = _mapping("parameters", parameters)
    forms = {"volumetric": entries.pop("volumetric", QUADRATIC), "split": entries.pop("split", COUPLED)}
    expected = {field.name for field in fields(law)} - {"prony", *forms}
    if entries.get("poisson") == 0.5:
        expected.discard("bulk")
    if entries.keys() != expected:
        raise InputError(f"{name} has the parameters {sorted(expected)}, not {brief(sorted(entries))}")
    values = {key: _numbers(key, value) for key, value in entries.items()}
    series = _mapping("prony", prony)
    if series.keys() - {field.name for field in fields(Prony)}:
        raise InputError(f"attribute prony has {brief(sorted(series))}")
    branches = {key: _numbers(key, value) for key, value in series.items()}
    if series and not {"shares", "times"} <= series.keys():
        raise InputError(f"attribute prony has {brief(sorted(series))}, not shares and times")
    relaxation: Any = {"prony": Prony(**branches)} if branches else {}
    material: Material = law(**values, **relaxation, **forms)
    return material


def _mapping(name: str, value: Any) -> dict[str, Any]:
    """Return a copy of a mapping with string keys; refuse anything else."""
    if not isinstance(value, dict) or not all(isinstance(key, str) for key in value):
        raise InputError(f"attribute {name} is {brief(value)}, not a mapping of names")
    return value.copy()


def _numbers(name: str, value: Any) -> Any:
    """Return a number, or a tuple of numbers; refuse text and truth values."""
    if isinstance(value, list | tuple):
        return tuple(_number(f"{name}[{i}]", entry) for i, entry in enumerate(value))
    return _number(name, value)


def _number(name: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InputError(f"{name} must be a number, got {brief(value)}")
    return number_in_range(name, value)


def describe_regions(regions: Regions | None) -> str:
    """Return the attribute of the materials of a body: the parameters of each; an empty list for one material."""
    if regions is None:
        return "[]"
    return json.dumps([json.loads(describe_material(material)["parameters"]) for material in regions.materials])


def regions_of(value: Any, which: NDArray[np.int64], material: Material) -> Regions | None:
    """Return the regions of nodes (n,) from the attribute of `describe_regions` and the first material."""
    if not isinstance(value, list) or not all(isinstance(each, dict) for each in value):
        raise InputError("attribute regions is not a list of materials")
    if not value:
        return None
    if len(value) > len(which):
        raise InputError(
            f"attribute regions has {len(value)} materials for {len(which)} nodes: allowed is one for each"
        )
    about = describe_material(material)
    prony = json.loads(about["prony"])
    made = [material_of(about["material"], each, about["expression"], prony) for each in value]
    if made[0] != material or not np.all((which >= 0) & (which < len(made))):
        raise InputError("dataset regions does not belong to the materials of the attribute regions")
    return Regions(tuple(made), which)


def describe_fibres(fibres: FibreLaw | None) -> str:
    """Return the attribute of fibres without their directions; an empty mapping for none."""
    if fibres is None:
        return "{}"
    if type(fibres) is not FIBRE_LAW_BY_NAME.get(type(fibres).__name__):
        raise InputError(f"the law of {fibres} is not one of palpate's: it cannot be kept in a file")
    parameters = {f.name: getattr(fibres, f.name) for f in fields(fibres) if f.name != "directions"}
    return json.dumps({"law": type(fibres).__name__, **parameters})


def fibres_of(value: Any, directions: NDArray[np.float64]) -> FibreLaw | None:
    """Return fibres with directions (families, n, 3) from the attribute of `describe_fibres`."""
    entries = _mapping("fibres", value)
    if directions.ndim != 3 or directions.dtype.kind not in "iuf":
        raise InputError(f"directions of fibres have shape {directions.shape}: allowed is (families, nodes, 3)")
    if not entries:
        if len(directions):
            raise InputError("there are directions of fibres, but no law of them")
        return None
    name = entries.pop("law", None)
    if not isinstance(name, str) or name not in FIBRE_LAW_BY_NAME:
        raise InputError(f"unknown law of fibres {brief(name)}: the laws are {', '.join(sorted(FIBRE_LAW_BY_NAME))}")
    law: Any = FIBRE_LAW_BY_NAME[name]
    expected = {f.name for f in fields(law)} - {"directions"}
    if entries.keys() != expected:
        raise InputError(f"fibres of {name} have {sorted(expected)}, not {brief(sorted(entries))}")
    values = {key: _number(key, value) for key, value in entries.items()}
    fibres: FibreLaw = law(**values, directions=directions)
    return fibres
