"""File of a reduced model: a sealed HDF5 file (`palpate.sealed`) with data only.

Arrays have the names of `ReducedData` (``cloud/points``, ``cubature/weights`` ...), and short values are
in the header. Basis vectors have single precision: they determine displacements and masses. Forces
depend on the gradients, which have double precision.
"""

from __future__ import annotations

import json
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from palpate.dynamics.loads.supports import Support, support_from, supports_of
from palpate.dynamics.material.tissue import Tissue
from palpate.faults import InputError, integer_in_range, number_in_range
from palpate.files import json_of, plain, shortened
from palpate.meshfree.cloud import Cloud
from palpate.reduction.contact.compliance import NO_COMPLIANCE
from palpate.reduction.hyper.cubature import Cubature
from palpate.reduction.hyper.material_point import Kinematics
from palpate.reduction.hyper.model import ReducedData, ReducedModel
from palpate.reduction.storage.compliance import COMPLIANCE, INTERIOR, read_compliance
from palpate.reduction.storage.material import (
    describe_fibres,
    describe_material,
    describe_regions,
    fibres_of,
    material_of,
    regions_of,
)
from palpate.sealed import ArrayFile, loading, open_sealed, write_sealed

__all__ = ["REMEDY", "contents", "load_hyper_reduced", "model_of", "save_hyper_reduced"]

Header = dict[str, Any]
Arrays = dict[str, np.ndarray[Any, Any]]

FORMAT, VERSION = "palpate reduced model", 12
REMEDY = "copy the file again, or train the model again"
MAX_NAME_LENGTH = 200  # characters of a scene's name
MAX_NUMBER = 1e30  # in a file, in SI units

# One line per dataset: its type, and its shape in sizes that all datasets share.
LAYOUT: dict[str, tuple[str, tuple[str | int, ...]]] = {
    "cloud/points": ("<f8", ("nodes", "space")),
    "cloud/volumes": ("<f8", ("nodes",)),
    "cloud/face_nodes": ("<i8", ("faces",)),
    "cloud/face_normals": ("<f8", ("faces", "space")),
    "cloud/face_areas": ("<f8", ("faces",)),
    "cloud/group_sizes": ("<i8", ("groups",)),
    "cloud/group_nodes": ("<i8", ("members",)),
    "cloud/triangles": ("<i8", ("triangles", 3)),
    "volumes": ("<f8", ("nodes",)),
    "stiffness": ("<f8", ("nodes",)),
    "basis_vectors": ("<f4", ("basis_vectors", "nodes", 3)),
    "cubature/nodes": ("<i8", ("integration_points",)),
    "cubature/weights": ("<f8", ("integration_points",)),
    "cubature/pressure": ("<f8", ("moments", "integration_points")),
    "gradients": ("<f8", ("integration_points", "basis_vectors", 9)),
    "constant": ("<f8", ("basis_vectors", "basis_vectors")),
    "training_states": ("<f8", ("states", "coordinates")),
    "fibres/directions": ("<f8", ("families", "nodes", 3)),
    "compliance/nodes": ("<i8", ("touched",)),
    "compliance/carriers": ("<i8", ("touched", "carried")),
    "compliance/weights": ("<f8", ("touched", "carried")),
    "compliance/flexibility": ("<f4", ("carriers", "carriers")),
    "compliance/nearby": ("<i8", ("touched", "nearby")),
    "compliance/near_field": ("<f4", ("touched", "nearby", 3, 3)),
    "compliance/patches": ("<i8", ("touched", "patched")),
    "compliance/shares": ("<f8", ("touched", "patched")),
    "compliance/stiffening": ("<f8", (2,)),
}
# with several materials
REGIONS: dict[str, tuple[str, tuple[str | int, ...]]] = {"regions": ("<i8", ("nodes",))}
# datasets of node numbers
NODES = (
    "cloud/face_nodes",
    "cloud/group_nodes",
    "cloud/triangles",
    "cubature/nodes",
    "compliance/nodes",
    "interior/nodes",
)
CURVE = ("bound", "exponent", "largest_trust", "least_size", "least_trust", "median")  # of an expected error
ATTRIBUTES = {
    "material": str, "parameters": str, "regions": str, "expression": str, "prony": str, "fibres": str,
    "groups": list, "spacing": float, "supports": str, "prescribed": list,
    "stiffness_damping": float, "wave_speed": float, "modes": int, "lifting_count": int, "residual": float,
    "distance_scale": float, "report": str,
    "sheet": bool, "prestretch": float, "relaxed": bool, "taut_frequency": float,
    "residual_fields": int, "residual_scale": float, "load_scale": float,
    "flexibility_scale": float, "bonded_scale": float,
    "step": float, "single": bool,
}  # fmt: skip
OPTIONAL = {"mass_damping": float}  # attributes of models that need them; without one it is 0


def save_hyper_reduced(model: ReducedModel, path: str | Path) -> None:
    """Write a model to a sealed HDF5 file, completely or not at all.

    Parameters
    ----------
    model : ReducedModel
        Derivatives at its integration points are written in double precision.
    path : path

    Raises
    ------
    InputError
        The file could not be read back: a custom material, or numbers that are not finite.
    OSError
        The path is not writable or the disk is full. An existing file is unchanged.
    """
    write_sealed(Path(path), FORMAT, VERSION, *contents(model))


def load_hyper_reduced(path: str | Path) -> ReducedModel:
    """Read a reduced model with its step rule and precision.

    Raises
    ------
    FileNotFoundError
        The file does not exist.
    FileFormatError
        The file is truncated, changed, of another kind or version, or inconsistent. The message names the
        file and the fault.
    """
    path = Path(path)
    with loading(path, REMEDY):
        file = open_sealed(path, FORMAT, VERSION)
        return model_of(file.header, file)


# writing


def contents(model: ReducedModel) -> tuple[Header, Arrays]:
    """Return the header and the arrays of a model's file.

    Raises
    ------
    InputError
        `model_of` would refuse the model.
    """
    data, rule = model.data, {"step": float(model.step or 0.0), "single": bool(model.single)}
    header, arrays = _header(data) | rule, _arrays(data)
    _check_header(header)
    _step_rule(header)
    if _data(header, _check_shapes(header, arrays)).tissue.material != data.tissue.material:
        raise InputError(f"the file would not give {data.tissue.material} back")
    return header, arrays


def _header(data: ReducedData) -> Header:
    return {
        **describe_material(data.tissue.material),
        "fibres": describe_fibres(data.tissue.fibres),
        "regions": describe_regions(data.tissue.regions),
        "groups": list(data.cloud.groups),
        "spacing": float(data.cloud.spacing),
        "supports": json.dumps([support.values() for support in data.supports]),
        "prescribed": list(data.prescribed),
        "stiffness_damping": float(data.stiffness_damping),
        "wave_speed": float(data.wave_speed),
        "modes": int(data.modes),
        "lifting_count": int(data.lifting_count),
        "residual": float(data.cubature.residual),
        "distance_scale": float(data.distance_scale),
        "residual_fields": int(data.residual_fields),
        "residual_scale": float(data.residual_scale),
        "load_scale": float(data.load_scale),
        "flexibility_scale": float(data.flexibility_scale),
        "sheet": data.kinematics.sheet,
        "prestretch": float(data.kinematics.prestretch),
        "relaxed": data.kinematics.relaxed,
        "taut_frequency": float(data.taut_frequency),
        "bonded_scale": float((data.compliance or NO_COMPLIANCE).bonded_scale),
        "report": json.dumps(plain(data.report)),
        **({"mass_damping": float(data.mass_damping)} if data.mass_damping else {}),
    }


def _arrays(data: ReducedData) -> Arrays:
    groups = list(data.cloud.groups.values())
    compliance, tissue = data.compliance or NO_COMPLIANCE, data.tissue
    values: dict[str, Any] = {
        "cloud/group_sizes": [len(nodes) for nodes in groups],
        "cloud/group_nodes": [node for nodes in groups for node in nodes],
        "stiffness": tissue.stiffness if len(tissue.stiffness) else np.ones(tissue.nodes),
        "regions": None if tissue.regions is None else tissue.regions.which,
        "fibres/directions": np.zeros((0, tissue.nodes, 3)) if tissue.fibres is None else tissue.fibres.directions,
        **{f"compliance/{name}": getattr(compliance, name) for name in COMPLIANCE},
    }
    layout = LAYOUT if tissue.regions is None else LAYOUT | REGIONS
    if compliance.interior is not None:
        layout = layout | INTERIOR
        values |= {f"interior/{name}": array for name, array in compliance.interior._asdict().items()}
        values["interior/factor"] = [compliance.interior.factor]
    return {
        name: np.asarray(values[name] if name in values else attrgetter(name.replace("/", "."))(data), dtype=dtype)
        for name, (dtype, _) in layout.items()
    }


# reading


def model_of(header: Header, file: ArrayFile, prefix: str = "") -> ReducedModel:
    """Return the model of a header and of the arrays of a file whose names begin with a prefix.

    Raises
    ------
    InputError
        The content is not that of a reduced model.
    """
    _check_header(header)
    layout = _layout(header, f"{prefix}interior/nodes" in file.arrays)
    own = {name.removeprefix(prefix) for name in file.arrays if name.startswith(prefix)}
    if own != layout.keys():
        odd = sorted(own ^ layout.keys())[0]
        raise InputError(f"array {shortened(odd)} is {'missing' if odd in layout else 'not one of a model'}")
    arrays = {name: file.read(prefix + name) for name in layout}
    return ReducedModel(_data(header, _check_shapes(header, arrays)), **_step_rule(header))


def _layout(header: Header, interior: bool) -> dict[str, tuple[str, tuple[str | int, ...]]]:
    layout = LAYOUT if header["regions"] == "[]" else LAYOUT | REGIONS
    return layout | INTERIOR if interior else layout


def _check_header(header: Header) -> None:
    expected = ATTRIBUTES | {name: kind for name, kind in OPTIONAL.items() if name in header}
    if header.keys() != expected.keys():
        odd = sorted(header.keys() ^ expected.keys())[0]
        raise InputError(f"header {shortened(odd)} is {'missing' if odd in expected else 'not one of a model'}")
    for name, kind in expected.items():
        given: Any = header[name]
        if not (type(given) is kind or (kind is float and type(given) is int)):
            raise InputError(f"header {name} must be of type {kind.__name__}, got {given!r:.60}")
        if isinstance(given, list) and not (all(isinstance(n, str) for n in given) and len(set(given)) == len(given)):
            raise InputError(f"header {name} must be a list of different names, got {given!r:.60}")


def _check_shapes(header: Header, arrays: Arrays) -> Arrays:
    """Return arrays of the types and shapes of the layout; refuse others."""
    modes = integer_in_range("modes", header["modes"], 1)
    coordinates = modes + integer_in_range("lifting_count", header["lifting_count"], 0)
    sizes: dict[str | int, int] = {
        "space": 2 if header["sheet"] else 3,
        "groups": len(header["groups"]),
        "coordinates": coordinates,
        "basis_vectors": coordinates
        + 3 * len(_supports(header))
        + integer_in_range("residual_fields", header["residual_fields"], 0),
    }
    for name, (dtype, shape) in _layout(header, "interior/nodes" in arrays).items():
        data = arrays[name]
        expected = tuple(sizes.get(size, size) for size in shape)
        fits = len(expected) == data.ndim and all(
            found == size or isinstance(size, str) for found, size in zip(data.shape, expected, strict=True)
        )
        if not fits or data.dtype != dtype:
            wanted = f"({', '.join(map(str, expected))}) of {dtype}"
            raise InputError(f"array {name} has shape {data.shape} of {data.dtype.str}, expected {wanted}")
        sizes.update(zip(shape, data.shape, strict=True))
    return arrays


def _data(header: Header, arrays: Arrays) -> ReducedData:
    """Return the data of a model; refuse values out of range."""
    _check_values(arrays)
    own: dict[str, Any] = {n: a.astype(int if a.dtype.kind == "i" else float) for n, a in arrays.items()}
    ends = np.cumsum(own["cloud/group_sizes"])
    groups = np.split(own["cloud/group_nodes"], ends[:-1]) if len(ends) else []
    cloud = Cloud(
        own["cloud/points"], own["cloud/volumes"], own["cloud/face_nodes"], own["cloud/face_normals"],
        own["cloud/face_areas"], dict(zip(header["groups"], groups, strict=True)), own["cloud/triangles"],
        number_in_range("spacing", header["spacing"], 0.0, open_low=True, unit="m"),
    )  # fmt: skip
    supports = _supports(header)
    if bool(header["prescribed"]) != bool(header["lifting_count"]):
        raise InputError(
            f"header lifting_count must be positive for models with prescribed groups only, got "
            f"{header['lifting_count']} for {len(header['prescribed'])} groups"
        )
    for name in (*(support.group for support in supports), *header["prescribed"]):
        cloud.group(name)
    residual = number_in_range("residual", header["residual"], 0.0)
    material = material_of(
        header["material"],
        _mapping("parameters", header["parameters"]),
        header["expression"],
        _mapping("prony", header["prony"]),
    )
    regions = regions_of(_json("regions", header["regions"]), own.get("regions", np.zeros(0, dtype=int)), material)
    factors = own["stiffness"] if np.any(own["stiffness"] != 1.0) else np.zeros(0)
    fibres = fibres_of(_mapping("fibres", header["fibres"]), own["fibres/directions"])
    return ReducedData(
        cloud=cloud,
        tissue=Tissue(material, regions, factors, fibres, len(cloud)),
        supports=supports,
        prescribed=tuple(header["prescribed"]),
        volumes=own["volumes"],
        stiffness_damping=number_in_range("stiffness_damping", header["stiffness_damping"], 0.0, unit="s"),
        mass_damping=number_in_range("mass_damping", header.get("mass_damping", 0.0), 0.0, unit="1/s"),
        wave_speed=number_in_range("wave_speed", header["wave_speed"], 0.0, unit="m/s"),
        basis_vectors=own["basis_vectors"],
        modes=header["modes"],
        lifting_count=header["lifting_count"],
        cubature=Cubature(own["cubature/nodes"], own["cubature/weights"], own["cubature/pressure"], residual),
        gradients=own["gradients"],
        constant=own["constant"],
        training_states=own["training_states"],
        distance_scale=number_in_range("distance_scale", header["distance_scale"], 0.0, open_low=True, unit="m"),
        residual_fields=header["residual_fields"],
        residual_scale=number_in_range("residual_scale", header["residual_scale"], 0.0, open_low=True, unit="m"),
        load_scale=number_in_range("load_scale", header["load_scale"], 0.0, 1.0, open_low=True),
        flexibility_scale=number_in_range(
            "flexibility_scale", header["flexibility_scale"], 0.0, open_low=True, unit="J"
        ),
        report=_report(_mapping("report", header["report"])),
        kinematics=Kinematics(
            header["sheet"], number_in_range("prestretch", header["prestretch"], 1.0), header["relaxed"]
        ),
        taut_frequency=number_in_range("taut_frequency", header["taut_frequency"], 0.0, unit="rad/s"),
        compliance=read_compliance(own, number_in_range("bonded_scale", header["bonded_scale"], 0.0, open_low=True)),
    )


def _report(report: dict[str, Any]) -> dict[str, Any]:
    """Return a report; refuse entries that palpate reads and that have other types than it writes."""
    held_out, scene = report.get("held_out", {"mean": {}}), report.get("scene")
    mean = held_out.get("mean") if isinstance(held_out, dict) else None
    if not isinstance(mean, dict) or not all(value is None or type(value) in (int, float) for value in mean.values()):
        raise InputError("header report holds errors under held_out that are not numbers")
    if "expected_error" in held_out:
        _check_curves(held_out["expected_error"])
    if "scene" in report:
        parameters = scene.get("parameters") if isinstance(scene, dict) else None
        named = isinstance(scene, dict) and isinstance(scene.get("name"), str) and len(scene["name"]) <= MAX_NAME_LENGTH
        if not named or not isinstance(parameters, dict):
            raise InputError("header report holds a scene without name and parameters")
        if not all(isinstance(value, str | int | float) for value in parameters.values()):
            raise InputError("header report holds parameters of a scene that are neither numbers nor text")
    return report


def _check_curves(curves: Any) -> None:
    """Refuse curves of expected errors that the calibration does not write."""
    if not isinstance(curves, dict) or not {"level"} < curves.keys() <= {"level", "displacement", "force"}:
        raise InputError("header report holds expected errors without level and displacement")
    number_in_range("level", curves["level"], 0.0, 1.0)
    for of in curves.keys() - {"level"}:
        if not isinstance(curves[of], dict) or curves[of].keys() != {*CURVE}:
            raise InputError(f"header report holds an expected error of the {of} without {', '.join(CURVE)}")
        for name in CURVE:
            number_in_range(name, curves[of][name], 0.0)


def _step_rule(header: Header) -> Header:
    """Return the arguments of the step rule, and whether the model has single precision."""
    step = number_in_range("step", header["step"], 0.0, unit="s")
    return {"step": step or None, "single": header["single"]}


def _check_values(arrays: Arrays) -> None:
    count = len(arrays["cloud/points"])
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise InputError(f"array {name} holds numbers that are not finite")
        if array.dtype.kind == "f" and array.size and np.abs(array).max() > MAX_NUMBER:
            raise InputError(f"array {name} holds numbers beyond {MAX_NUMBER:g}")
        if name in NODES and not np.all((array >= 0) & (array < count)):
            raise InputError(f"array {name} names nodes outside 0..{count - 1}")
    if not len(arrays["training_states"]):
        raise InputError("array training_states must hold at least one state")
    if np.any(arrays["cubature/weights"] < 0):
        raise InputError("array cubature/weights holds negative weights")
    for name in ("volumes", "stiffness"):
        if not np.all(arrays[name] > 0):
            raise InputError(f"array {name} holds {name} that are not positive")
    sizes, members = arrays["cloud/group_sizes"], len(arrays["cloud/group_nodes"])
    if np.any(sizes < 1) or sizes.sum() != members:
        raise InputError(f"array cloud/group_sizes does not share out the {members} entries of cloud/group_nodes")


def _supports(header: Header) -> tuple[Support, ...]:
    listed = _json("supports", header["supports"])
    if not isinstance(listed, list) or not all(isinstance(values, dict) for values in listed):
        raise InputError("header supports is not a list of mappings")
    return supports_of(support_from(values) for values in listed)


def _json(name: str, text: str) -> Any:
    try:
        return json_of(text)
    except InputError as error:
        raise InputError(f"header {name}: {error}") from error


def _mapping(name: str, text: str) -> dict[str, Any]:
    values = _json(name, text)
    if not isinstance(values, dict):
        raise InputError(f"header {name} is not a mapping")
    return values
