"""Cloud, tissue and supports of a body in a file: header attributes and arrays, and their validation."""

from __future__ import annotations

import json
from typing import Any

import numpy as np

from palpate.dynamics.loads.supports import Support, support_from, supports_of
from palpate.dynamics.material.tissue import Tissue
from palpate.faults import InputError, number_in_range
from palpate.files import json_of, shortened
from palpate.meshfree.cloud import Cloud
from palpate.reduction.storage.material import (
    describe_fibres,
    describe_material,
    describe_regions,
    fibres_of,
    material_of,
    regions_of,
)
from palpate.sealed import ArrayFile

__all__ = [
    "BODY_ATTRIBUTES",
    "BODY_LAYOUT",
    "REGIONS_LAYOUT",
    "Arrays",
    "Header",
    "Layout",
    "body_arrays",
    "body_header",
    "body_of",
    "check_header",
    "check_shapes",
    "check_values",
    "mapping_in",
    "read_arrays",
    "supports_in",
]

Header = dict[str, Any]
Arrays = dict[str, np.ndarray[Any, Any]]
Layout = dict[str, tuple[str, tuple[str | int, ...]]]

MAX_NUMBER = 1e30  # in a file, in SI units

# One line per dataset: its type, and its shape in sizes that all datasets share.
BODY_LAYOUT: Layout = {
    "cloud/points": ("<f8", ("nodes", "space")),
    "cloud/volumes": ("<f8", ("nodes",)),
    "cloud/face_nodes": ("<i8", ("faces",)),
    "cloud/face_normals": ("<f8", ("faces", "space")),
    "cloud/face_areas": ("<f8", ("faces",)),
    "cloud/group_sizes": ("<i8", ("groups",)),
    "cloud/group_nodes": ("<i8", ("members",)),
    "cloud/triangles": ("<i8", ("triangles", 3)),
    "stiffness": ("<f8", ("nodes",)),
    "fibres/directions": ("<f8", ("families", "nodes", 3)),
}
REGIONS_LAYOUT: Layout = {"regions": ("<i8", ("nodes",))}  # with several materials
# datasets of node numbers
NODE_ARRAYS = (
    "cloud/face_nodes",
    "cloud/group_nodes",
    "cloud/triangles",
    "cubature/nodes",
    "compliance/nodes",
    "interior/nodes",
)
BODY_ATTRIBUTES: dict[str, type] = {
    "material": str, "parameters": str, "regions": str, "expression": str, "prony": str, "fibres": str,
    "groups": list, "spacing": float, "supports": str, "stiffness_damping": float,
}  # fmt: skip
# attributes of bodies that need them; without one it is 0
OPTIONAL_ATTRIBUTES: dict[str, type] = {"mass_damping": float}


def body_header(
    cloud: Cloud, tissue: Tissue, supports: tuple[Support, ...], stiffness_damping: float, mass_damping: float
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


def body_arrays(cloud: Cloud, tissue: Tissue) -> Arrays:
    """Return the arrays of a body, with ``"regions"`` if it has several materials."""
    groups = list(cloud.groups.values())
    values: dict[str, Any] = {name: getattr(cloud, name.removeprefix("cloud/"), None) for name in BODY_LAYOUT} | {
        "cloud/group_sizes": [len(nodes) for nodes in groups],
        "cloud/group_nodes": [node for nodes in groups for node in nodes],
        "stiffness": tissue.stiffness if len(tissue.stiffness) else np.ones(tissue.nodes),
        "fibres/directions": np.zeros((0, tissue.nodes, 3)) if tissue.fibres is None else tissue.fibres.directions,
    }
    layout = BODY_LAYOUT
    if tissue.regions is not None:
        layout, values = BODY_LAYOUT | REGIONS_LAYOUT, values | {"regions": tissue.regions.which}
    return {name: np.asarray(values[name], dtype=dtype) for name, (dtype, _) in layout.items()}


def body_of(header: Header, arrays: Arrays) -> tuple[Cloud, Tissue, tuple[Support, ...]]:
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
    return cloud, Tissue(material, regions, factors, fibres, count), supports


def supports_in(header: Header) -> tuple[Support, ...]:
    """Return the supports of a header."""
    listed = _json("supports", header["supports"])
    if not isinstance(listed, list) or not all(isinstance(values, dict) for values in listed):
        raise InputError("header supports is not a list of mappings")
    return supports_of(support_from(values) for values in listed)


def read_arrays(file: ArrayFile, prefix: str, layout: Layout) -> Arrays:
    """Return the arrays of a file whose names begin with a prefix; refuse others than those of a layout."""
    names = {name.removeprefix(prefix) for name in file.arrays if name.startswith(prefix)}
    if names != layout.keys():
        odd = sorted(names ^ layout.keys())[0]
        raise InputError(f"array {shortened(odd)} is {'missing' if odd in layout else 'not one of a model'}")
    return {name: file.read(prefix + name) for name in layout}


def check_header(header: Header, attributes: dict[str, type]) -> None:
    """Refuse a header that does not have these attributes, of these types."""
    expected = attributes | {name: kind for name, kind in OPTIONAL_ATTRIBUTES.items() if name in header}
    if header.keys() != expected.keys():
        odd = sorted(header.keys() ^ expected.keys())[0]
        raise InputError(f"header {shortened(odd)} is {'missing' if odd in expected else 'not one of a model'}")
    for name, kind in expected.items():
        given: Any = header[name]
        if not (type(given) is kind or (kind is float and type(given) is int)):
            raise InputError(f"header {name} must be of type {kind.__name__}, got {given!r:.60}")
        if isinstance(given, list) and not (all(isinstance(n, str) for n in given) and len(set(given)) == len(given)):
            raise InputError(f"header {name} must be a list of different names, got {given!r:.60}")


def check_shapes(arrays: Arrays, layout: Layout, sizes: dict[str | int, int]) -> None:
    """Refuse arrays of other types and shapes than those of a layout; add the sizes that they share."""
    for name, (dtype, shape) in layout.items():
        data = arrays[name]
        expected = tuple(sizes.get(size, size) for size in shape)
        fits = len(expected) == data.ndim and all(
            length == size or isinstance(size, str) for length, size in zip(data.shape, expected, strict=True)
        )
        if not fits or data.dtype != dtype:
            description = f"({', '.join(map(str, expected))}) of {dtype}"
            raise InputError(f"array {name} has shape {data.shape} of {data.dtype.str}, expected {description}")
        sizes.update(zip(shape, data.shape, strict=True))


def check_values(arrays: Arrays) -> None:
    """Refuse numbers that no body has."""
    count = len(arrays["cloud/points"])
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise InputError(f"array {name} holds numbers that are not finite")
        if array.dtype.kind == "f" and array.size and np.abs(array).max() > MAX_NUMBER:
            raise InputError(f"array {name} holds numbers beyond {MAX_NUMBER:g}")
        if name in NODE_ARRAYS and not np.all((array >= 0) & (array < count)):
            raise InputError(f"array {name} names nodes outside 0..{count - 1}")
    if not np.all(arrays["stiffness"] > 0):
        raise InputError("array stiffness holds stiffness that are not positive")
    sizes, members = arrays["cloud/group_sizes"], len(arrays["cloud/group_nodes"])
    if np.any(sizes < 1) or sizes.sum() != members:
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
