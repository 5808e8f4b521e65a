"""A material and its fibres as numbers and words, and back: what the file of a reduced model says of its tissue."""

from __future__ import annotations

import json
from dataclasses import asdict, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.faults import InputError, brief, number_in_range
from palpate.tissue import symbolic_law
from palpate.tissue.catalogue import FIBRE_LAWS, LAWS
from palpate.tissue.fibres import FibreLaw, VolumeOnly
from palpate.tissue.isochoric import COUPLED
from palpate.tissue.materials import Material
from palpate.tissue.prony import Prony
from palpate.tissue.regions import Regions
from palpate.tissue.volumetric import QUADRATIC

__all__ = ["describe_fibres", "describe_material", "describe_regions", "fibres_of", "material_of", "regions_of"]

KINDS = {law.name: law.kind for law in LAWS} | {"VolumeOnly": VolumeOnly}
FIBRES: dict[str, Any] = {law.name: law.kind for law in FIBRE_LAWS}
OWN = "Hyperelastic"


def describe_material(material: Material) -> dict[str, str]:
    """Return the attributes that describe a material: ``material``, ``parameters``, ``expression`` and ``prony``.

    Raises
    ------
    InputError
        A material that is neither one of the library's nor an energy that is written down.
    """
    name, expression = type(material).__name__, getattr(material, "expression", "")
    known = symbolic_law.law_of(expression) if name == OWN and expression else KINDS.get(name)
    if type(material) is not known:
        raise InputError(f"the law of {material} is not one of palpate's: it cannot be kept in a file")
    parameters = {f.name: getattr(material, f.name) for f in fields(material) if f.name != "prony"}
    if material.volumetric == QUADRATIC:  # which a file means that says nothing
        del parameters["volumetric"]
    if material.split == COUPLED:  # the same
        del parameters["split"]
    if material.incompressible:  # no number says how stiff it is against a change of volume
        del parameters["bulk"]
    return {
        "material": name,
        "parameters": json.dumps(parameters),
        "expression": expression,
        "prony": json.dumps(asdict(material.prony) if material.prony else {}),
    }


def material_of(name: Any, parameters: Any, expression: Any, prony: Any) -> Material:
    """Make a material from what `described` says of it, whatever a file has in its place.

    Raises
    ------
    InputError
        An unknown law, other parameters than it has, or anything but numbers in range.
    """
    if not isinstance(name, str) or (name != OWN and name not in KINDS):
        raise InputError(f"unknown material {brief(name)}: the laws are {', '.join(sorted(KINDS))}")
    law: Any = symbolic_law.law_of(expression) if name == OWN else KINDS[name]
    given = _mapping("parameters", parameters)
    forms = {"volumetric": given.pop("volumetric", QUADRATIC), "split": given.pop("split", COUPLED)}
    wanted = {field.name for field in fields(law)} - {"prony", *forms}
    if given.get("poisson") == 0.5:
        wanted.discard("bulk")
    if given.keys() != wanted:
        raise InputError(f"{name} has the parameters {sorted(wanted)}, not {brief(sorted(given))}")
    values = {key: _numbers(key, value) for key, value in given.items()}
    series = _mapping("prony", prony)
    if series.keys() - {field.name for field in fields(Prony)}:
        raise InputError(f"attribute prony has {brief(sorted(series))}")
    branches = {key: _numbers(key, value) for key, value in series.items()}
    if series and not {"shares", "times"} <= series.keys():
        raise InputError(f"attribute prony has {brief(sorted(series))}, not shares and times")
    relaxation: Any = {"prony": Prony(**branches)} if branches else {}
    material: Material = law(**values, **relaxation, **forms)
    return material


def _mapping(name: str, said: Any) -> dict[str, Any]:
    """Return a copy of a mapping of names; refuse anything else."""
    if not isinstance(said, dict) or not all(isinstance(key, str) for key in said):
        raise InputError(f"attribute {name} is {brief(said)}, not a mapping of names")
    return said.copy()


def _numbers(name: str, said: Any) -> Any:
    """Return a number, or a tuple of numbers; text and truth values are none in a file."""
    if isinstance(said, list | tuple):
        return tuple(_number(f"{name}[{i}]", value) for i, value in enumerate(said))
    return _number(name, said)


def _number(name: str, said: Any) -> float:
    if isinstance(said, bool) or not isinstance(said, int | float):
        raise InputError(f"{name} must be a number, got {brief(said)}")
    return number_in_range(name, said)


def describe_regions(regions: Regions | None) -> str:
    """Return the attribute that describes the materials of a body: the parameters of each; none if there is one."""
    if regions is None:
        return "[]"
    return json.dumps([json.loads(describe_material(material)["parameters"]) for material in regions.materials])


def regions_of(said: Any, which: NDArray[np.int64], material: Material) -> Regions | None:
    """Make the regions of nodes (n,) from what `described_regions` says of them, and the first of their materials.

    Raises
    ------
    InputError
        Parameters that the law does not have or that are out of range, or numbers of materials that do not exist.
    """
    if not isinstance(said, list) or not all(isinstance(each, dict) for each in said):
        raise InputError("attribute regions is not a list of materials")
    if not said:
        return None
    if len(said) > len(which):
        raise InputError(f"attribute regions has {len(said)} materials for {len(which)} nodes: allowed is one for each")
    about = describe_material(material)
    prony = json.loads(about["prony"])
    made = [material_of(about["material"], each, about["expression"], prony) for each in said]
    if made[0] != material or not np.all((which >= 0) & (which < len(made))):
        raise InputError("dataset regions does not belong to the materials of the attribute regions")
    return Regions(tuple(made), which)


def describe_fibres(fibres: FibreLaw | None) -> str:
    """Return the attribute that describes fibres but for their directions; an empty mapping for none.

    Raises
    ------
    InputError
        A law that is not one of the library's.
    """
    if fibres is None:
        return "{}"
    if type(fibres) is not FIBRES.get(type(fibres).__name__):
        raise InputError(f"the law of {fibres} is not one of palpate's: it cannot be kept in a file")
    own = {f.name: getattr(fibres, f.name) for f in fields(fibres) if f.name != "directions"}
    return json.dumps({"law": type(fibres).__name__, **own})


def fibres_of(said: Any, directions: NDArray[np.float64]) -> FibreLaw | None:
    """Make fibres with directions (families, n, 3) from what `described_fibres` says of them.

    Raises
    ------
    InputError
        An unknown law, other parameters than it has, numbers out of range, or directions that do not fit.
    """
    given = _mapping("fibres", said)
    if directions.ndim != 3 or directions.dtype.kind not in "iuf":
        raise InputError(f"directions of fibres have shape {directions.shape}: allowed is (families, nodes, 3)")
    if not given:
        if len(directions):
            raise InputError("there are directions of fibres, but no law of them")
        return None
    name = given.pop("law", None)
    if not isinstance(name, str) or name not in FIBRES:
        raise InputError(f"unknown law of fibres {brief(name)}: the laws are {', '.join(sorted(FIBRES))}")
    law: Any = FIBRES[name]
    wanted = {f.name for f in fields(law)} - {"directions"}
    if given.keys() != wanted:
        raise InputError(f"fibres of {name} have {sorted(wanted)}, not {brief(sorted(given))}")
    values = {key: _number(key, value) for key, value in given.items()}
    fibres: FibreLaw = law(**values, directions=directions)
    return fibres
