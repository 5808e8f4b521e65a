"""Cloud, tissue and supports of a body in a file: header attributes and arrays, and their validation."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from palpate.core.faults import InputError, number_in_range
from palpate.core.files import json_of, shortened
from palpate.core.sealed import MIN_POSITIVE, Array, ArrayFile, check_arrays, check_names, typed
from palpate.dynamics.loads.supports import Support, support_from, supports_of
from palpate.dynamics.material.tissue import TissueField
from palpate.meshfree.cloud import Cloud
from palpate.reduction.storage.material import (
    describe_fibres,
    describe_material,
    describe_regions,
    fibres_of,
    material_of,
    regions_of,
)

Header = dict[str, Any]
Arrays = dict[str, np.ndarray[Any, Any]]
Declared = dict[str, Array]

MAX_NUMBER = 1e30  # in a file, in SI units

BODY_ARRAYS: Declared = {
    "cloud/points": Array(("nodes", "space"), most=MAX_NUMBER, unit="m"),
    "cloud/volumes": Array(("nodes",), most=MAX_NUMBER, unit="m^3"),
    "cloud/face_nodes": Array(("faces",), "<i8", index_of="nodes"),
    "cloud/face_normals": Array(("faces", "space"), most=MAX_NUMBER),
    "cloud/face_areas": Array(("faces",), most=MAX_NUMBER, unit="m^2"),
    "cloud/group_sizes": Array(("groups",), "<i8", low=1),
    "cloud/group_nodes": Array(("members",), "<i8", index_of="nodes"),
    "cloud/triangles": Array(("triangles", 3), "<i8", index_of="nodes"),
    "stiffness": Array(("nodes",), low=MIN_POSITIVE, most=MAX_NUMBER),
    "fibres/directions": Array(("families", "nodes", 3), most=MAX_NUMBER),
}
SEVERAL_MATERIALS: Declared = {"regions": Array(("nodes",), "<i8")}
BODY_ATTRIBUTES: dict[str, type] = {
    "material": str, "parameters": str, "regions": str, "expression": str, "prony": str, "fibres": str,
    "groups": list, "spacing": float, "supports": str, "stiffness_damping": float,
}  # fmt: skip
# attributes of bodies that need them; without one it is 0
OPTIONAL_ATTRIBUTES: dict[str, type] = {"mass_damping": float}


def body_header(
    cloud: Cloud, tissue: TissueField, supports: tuple[Support, ...], stiffness_damping: float, mass_damping: float
) -> Header:
    """Return the header attributes of a body."""
    return {
        **describe_material(tissue.material),
        "fibres": describe_fibres(tissue.fibres),
        "regions": describe_regions(tissue.regions),
        "groups": list(cloud.groups),
        "spacing": float(cloud.spacing),
        "supports": json.dumps([support.values() for support in supports]),
        "stiffness_damping": float(stiffness_damping),
        **({"mass_damping": float(mass_damping)} if mass_damping else {}),
    }


def body_arrays(cloud: Cloud, tissue: TissueField) -> Arrays:
    """Return the arrays of a body, with ``"regions"`` if it has several materials."""
    groups = list(cloud.groups.values())
    values: dict[str, Any] = {name: getattr(cloud, name.removeprefix("cloud/"), None) for name in BODY_ARRAYS} | {
        "cloud/group_sizes": [len(nodes) for nodes in groups],
        "cloud/group_nodes": [node for nodes in groups for node in nodes],
        "stiffness": tissue.stiffness if len(tissue.stiffness) else np.ones(tissue.nodes),
        "fibres/directions": np.zeros((0, tissue.nodes, 3)) if tissue.fibres is None else tissue.fibres.directions,
    }
    if tissue.regions is None:
        return typed(values, BODY_ARRAYS)
    return typed(values | {"regions": tissue.regions.which}, BODY_ARRAYS | SEVERAL_MATERIALS)


def body_declared(header: Header) -> Declared:
    """Return the arrays of a body with a header."""
    return BODY_ARRAYS if header["regions"] == "[]" else BODY_ARRAYS | SEVERAL_MATERIALS


def body_of(header: Header, arrays: Arrays) -> tuple[Cloud, TissueField, tuple[Support, ...]]:
    """Return the body of a header and of arrays of integers and floats that were checked."""
    values, count = arrays, len(arrays["cloud/points"])
    ends = np.cumsum(values["cloud/group_sizes"])
    groups = np.split(values["cloud/group_nodes"], ends[:-1]) if len(ends) else []
    cloud = Cloud(
        values["cloud/points"], values["cloud/volumes"], values["cloud/face_nodes"], values["cloud/face_normals"],
        values["cloud/face_areas"], dict(zip(header["groups"], groups, strict=True)), values["cloud/triangles"],
        number_in_range("spacing", header["spacing"], 0.0, open_low=True, unit="m"),
    )  # fmt: skip
    supports = supports_in(header)
    for support in supports:
        cloud.group(support.group)
    material = material_of(
        header["material"],
        mapping_in("parameters", header["parameters"]),
        header["expression"],
        mapping_in("prony", header["prony"]),
    )
    regions = regions_of(_json("regions", header["regions"]), values.get("regions", np.zeros(0, dtype=int)), material)
    factors = values["stiffness"] if np.any(values["stiffness"] != 1.0) else np.zeros(0)
    fibres = fibres_of(mapping_in("fibres", header["fibres"]), values["fibres/directions"])
    return cloud, TissueField(material, regions, factors, fibres, count), supports


def supports_in(header: Header) -> tuple[Support, ...]:
    """Return the supports of a header."""
    listed = _json("supports", header["supports"])
    if not isinstance(listed, list) or not all(isinstance(values, dict) for values in listed):
        raise InputError("header supports is not a list of mappings")
    return supports_of(support_from(values) for values in listed)


def read_arrays(file: ArrayFile, prefix: str, declared: Declared) -> Arrays:
    """Return the arrays of a file whose names begin with a prefix; refuse others than the declared ones."""
    check_names((name.removeprefix(prefix) for name in file.arrays if name.startswith(prefix)), declared)
    return {name: file.read(prefix + name) for name in declared}


def check_header(header: Header, attributes: dict[str, type]) -> None:
    """Refuse a header that does not have these attributes, of these types."""
    expected = attributes | {name: kind for name, kind in OPTIONAL_ATTRIBUTES.items() if name in header}
    if header.keys() != expected.keys():
        odd = sorted(header.keys() ^ expected.keys())[0]
        raise InputError(f"header {shortened(odd)} is {'missing' if odd in expected else 'not one of a model'}")
    for name, kind in expected.items():
        value: Any = header[name]
        if not (type(value) is kind or (kind is float and type(value) is int)):
            raise InputError(f"header {name} must be of type {kind.__name__}, got {value!r:.60}")
        if isinstance(value, list) and not (all(isinstance(n, str) for n in value) and len(set(value)) == len(value)):
            raise InputError(f"header {name} must be a list of different names, got {value!r:.60}")


def check_body(arrays: Arrays, declared: Declared, sizes: dict[str, int]) -> None:
    """Refuse arrays that are not as declared, and groups that do not share out their nodes."""
    check_arrays(arrays, declared, sizes)
    members = len(arrays["cloud/group_nodes"])
    if arrays["cloud/group_sizes"].sum() != members:
        raise InputError(f"array cloud/group_sizes does not share out the {members} entries of cloud/group_nodes")


def mapping_in(name: str, text: str) -> dict[str, Any]:
    """Return the mapping of a header attribute."""
    values = _json(name, text)
    if not isinstance(values, dict):
        raise InputError(f"header {name} is not a mapping")
    return values


def _json(name: str, text: str) -> Any:
    try:
        return json_of(text)
    except InputError as error:
        raise InputError(f"header {name}: {error}") from error
