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

from palpate.dynamics.material.kinematics import Kinematics
from palpate.faults import InputError, integer_in_range, number_in_range
from palpate.files import plain
from palpate.reduction.contact.compliance import NO_COMPLIANCE
from palpate.reduction.hyper.cubature import Cubature
from palpate.reduction.hyper.data import UNLIMITED_SCALE, ReducedData
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.storage.body import (
    BODY_ATTRIBUTES,
    BODY_LAYOUT,
    REGIONS_LAYOUT,
    Arrays,
    Header,
    Layout,
    body_arrays,
    body_header,
    body_of,
    check_header,
    check_shapes,
    check_values,
    mapping_in,
    read_arrays,
    supports_in,
)
from palpate.reduction.storage.compliance import (
    COMPLIANCE_ARRAYS,
    INTERIOR_LAYOUT,
    STEPS_LAYOUT,
    pack_flexibilities,
    read_compliance,
    unpack_flexibilities,
)
from palpate.sealed import ArrayFile, loading, open_sealed, write_sealed

__all__ = ["MODEL_REMEDY", "contents", "load_hyper_reduced", "model_of", "save_hyper_reduced"]

FORMAT, VERSION = "palpate reduced model", 14
OLDER_VERSIONS = (12, 13)  # also read
NEW_ATTRIBUTES = {"speed_scale", "nearness_scale"}  # that older files lack; their error bounds have another meaning
MODEL_REMEDY = "copy the file again, or train the model again"
MAX_NAME_LENGTH = 200  # characters of a scene's name
MAX_ADVICE_LENGTH = 1000  # characters

# One line per dataset: its type, and its shape in sizes that all datasets share.
MODEL_LAYOUT: Layout = BODY_LAYOUT | {
    "volumes": ("<f8", ("nodes",)),
    "basis_vectors": ("<f4", ("basis_vectors", "nodes", 3)),
    "cubature/nodes": ("<i8", ("integration_points",)),
    "cubature/weights": ("<f8", ("integration_points",)),
    "cubature/pressure": ("<f8", ("moments", "integration_points")),
    "gradients": ("<f8", ("integration_points", "basis_vectors", 9)),
    "constant": ("<f8", ("basis_vectors", "basis_vectors")),
    "training_states": ("<f8", ("states", "coordinates")),
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
CURVE_KEYS = ("bound", "exponent", "largest_trust", "least_trust", "median", "typical_size")  # of an expected error
ATTRIBUTE_TYPES: dict[str, type] = BODY_ATTRIBUTES | {
    "prescribed": list, "wave_speed": float, "modes": int, "lifting_count": int, "residual": float,
    "distance_scale": float, "report": str,
    "sheet": bool, "prestretch": float, "relaxed": bool, "taut_frequency": float,
    "residual_fields": int, "residual_scale": float, "load_scale": float,
    "flexibility_scale": float, "speed_scale": float, "nearness_scale": float, "bonded_scale": float,
    "step": float, "single": bool,
}  # fmt: skip


def save_hyper_reduced(model: ReducedModel, path: str | Path) -> None:
    """Write a model to a sealed HDF5 file, completely or not at all.

    Parameters
    ----------
    model : ReducedModel
        Derivatives at its integration points are written in double precision.
    """
    write_sealed(Path(path), FORMAT, VERSION, *contents(model), deflate=True)


def load_hyper_reduced(path: str | Path) -> ReducedModel:
    """Read a reduced model with its step rule and precision."""
    path = Path(path)
    with loading(path, MODEL_REMEDY):
        file = open_sealed(path, FORMAT, VERSION, OLDER_VERSIONS)
        return model_of(file.header, file)


# writing


def contents(model: ReducedModel) -> tuple[Header, Arrays]:
    """Return the header and the arrays of a model's file."""
    data, rule = model.data, {"step": float(model.step or 0.0), "single": bool(model.single)}
    header, arrays = _header(data) | rule, _arrays(data)
    check_header(header, ATTRIBUTE_TYPES)
    _step_rule(header)
    packed = pack_flexibilities(arrays)
    if _data(header, _check_shapes(header, unpack_flexibilities(packed))).tissue.material != data.tissue.material:
        raise InputError(f"the file would not give {data.tissue.material} back")
    return header, packed


def _header(data: ReducedData) -> Header:
    return {
        **body_header(data.cloud, data.tissue, data.supports, data.stiffness_damping, data.mass_damping),
        "prescribed": list(data.prescribed),
        "wave_speed": float(data.wave_speed),
        "modes": int(data.modes),
        "lifting_count": int(data.lifting_count),
        "residual": float(data.cubature.residual),
        "distance_scale": float(data.distance_scale),
        "residual_fields": int(data.residual_fields),
        "residual_scale": float(data.residual_scale),
        "load_scale": float(data.load_scale),
        "flexibility_scale": float(data.flexibility_scale),
        "speed_scale": float(data.speed_scale),
        "nearness_scale": float(data.nearness_scale),
        "sheet": data.kinematics.sheet,
        "prestretch": float(data.kinematics.prestretch),
        "relaxed": data.kinematics.relaxed,
        "taut_frequency": float(data.taut_frequency),
        "bonded_scale": float((data.compliance or NO_COMPLIANCE).bonded_scale),
        "report": json.dumps(plain(data.report)),
    }


def _arrays(data: ReducedData) -> Arrays:
    compliance = data.compliance or NO_COMPLIANCE
    values: dict[str, Any] = body_arrays(data.cloud, data.tissue)
    layout = MODEL_LAYOUT if "regions" not in values else MODEL_LAYOUT | REGIONS_LAYOUT
    values |= {f"compliance/{name}": getattr(compliance, name) for name in COMPLIANCE_ARRAYS}
    if compliance.interior is not None:
        layout = layout | INTERIOR_LAYOUT
        values |= {f"interior/{name}": array for name, array in compliance.interior._asdict().items()}
        values["interior/factor"] = [compliance.interior.factor]
    return {
        name: np.asarray(values[name] if name in values else attrgetter(name.replace("/", "."))(data), dtype=dtype)
        for name, (dtype, _) in layout.items()
    }


# reading


def model_of(header: Header, file: ArrayFile, prefix: str = "") -> ReducedModel:
    """Return the model of a header and of the arrays of a file whose names begin with a prefix."""
    header = header if NEW_ATTRIBUTES & header.keys() else _converted(header)
    check_header(header, ATTRIBUTE_TYPES)
    layout = _layout(header, f"{prefix}interior/nodes" in file.arrays)
    steps = STEPS_LAYOUT if f"{prefix}compliance/steps" in file.arrays else {}
    arrays = unpack_flexibilities(read_arrays(file, prefix, layout | steps))
    return ReducedModel(_data(header, _check_shapes(header, arrays)), **_step_rule(header))


def _converted(header: Header) -> Header:
    """Return the header of an older file: without limits of speed and nearness, and without its error bounds."""
    check_header(header, {name: kind for name, kind in ATTRIBUTE_TYPES.items() if name not in NEW_ATTRIBUTES})
    report = mapping_in("report", header["report"])
    held_out = report.get("held_out")
    if isinstance(held_out, dict):
        report = report | {"held_out": {name: value for name, value in held_out.items() if name != "expected_error"}}
    return header | dict.fromkeys(NEW_ATTRIBUTES, UNLIMITED_SCALE) | {"report": json.dumps(report)}


def _layout(header: Header, interior: bool) -> dict[str, tuple[str, tuple[str | int, ...]]]:
    layout = MODEL_LAYOUT if header["regions"] == "[]" else MODEL_LAYOUT | REGIONS_LAYOUT
    return layout | INTERIOR_LAYOUT if interior else layout


def _check_shapes(header: Header, arrays: Arrays) -> Arrays:
    """Return arrays of the types and shapes of the layout; refuse others."""
    modes = integer_in_range("modes", header["modes"], 1)
    coordinates = modes + integer_in_range("lifting_count", header["lifting_count"], 0)
    sizes: dict[str | int, int] = {
        "space": 2 if header["sheet"] else 3,
        "groups": len(header["groups"]),
        "coordinates": coordinates,
        "basis_vectors": coordinates
        + 3 * len(supports_in(header))
        + integer_in_range("residual_fields", header["residual_fields"], 0),
    }
    check_shapes(arrays, _layout(header, "interior/nodes" in arrays), sizes)
    return arrays


def _data(header: Header, arrays: Arrays) -> ReducedData:
    """Return the data of a model; refuse values out of range."""
    _check_values(arrays)
    values: dict[str, Any] = arrays | {"basis_vectors": arrays["basis_vectors"].astype(float)}
    cloud, tissue, supports = body_of(header, values)
    if bool(header["prescribed"]) != bool(header["lifting_count"]):
        raise InputError(
            f"header lifting_count must be positive for models with prescribed groups only, got "
            f"{header['lifting_count']} for {len(header['prescribed'])} groups"
        )
    for name in header["prescribed"]:
        cloud.group(name)
    residual = number_in_range("residual", header["residual"], 0.0)
    return ReducedData(
        cloud=cloud,
        tissue=tissue,
        supports=supports,
        prescribed=tuple(header["prescribed"]),
        volumes=values["volumes"],
        stiffness_damping=number_in_range("stiffness_damping", header["stiffness_damping"], 0.0, unit="s"),
        mass_damping=number_in_range("mass_damping", header.get("mass_damping", 0.0), 0.0, unit="1/s"),
        wave_speed=number_in_range("wave_speed", header["wave_speed"], 0.0, unit="m/s"),
        basis_vectors=values["basis_vectors"],
        modes=header["modes"],
        lifting_count=header["lifting_count"],
        cubature=Cubature(values["cubature/nodes"], values["cubature/weights"], values["cubature/pressure"], residual),
        gradients=values["gradients"],
        constant=values["constant"],
        training_states=values["training_states"],
        distance_scale=number_in_range("distance_scale", header["distance_scale"], 0.0, open_low=True, unit="m"),
        residual_fields=header["residual_fields"],
        residual_scale=number_in_range("residual_scale", header["residual_scale"], 0.0, open_low=True, unit="m"),
        load_scale=number_in_range("load_scale", header["load_scale"], 0.0, 1.0, open_low=True),
        flexibility_scale=number_in_range(
            "flexibility_scale", header["flexibility_scale"], 0.0, open_low=True, unit="J"
        ),
        speed_scale=number_in_range("speed_scale", header["speed_scale"], 0.0, open_low=True, unit="m/s"),
        nearness_scale=number_in_range("nearness_scale", header["nearness_scale"], 0.0, open_low=True),
        report=_report(mapping_in("report", header["report"])),
        kinematics=Kinematics(
            header["sheet"], number_in_range("prestretch", header["prestretch"], 1.0), header["relaxed"]
        ),
        taut_frequency=number_in_range("taut_frequency", header["taut_frequency"], 0.0, unit="rad/s"),
        compliance=read_compliance(values, number_in_range("bonded_scale", header["bonded_scale"], 0.0, open_low=True)),
    )


def _report(report: dict[str, Any]) -> dict[str, Any]:
    """Return a report; refuse entries that palpate reads and that have other types than it writes."""
    held_out, scene = report.get("held_out", {"mean": {}}), report.get("scene")
    if not isinstance(report.get("advice", ""), str) or len(report.get("advice", "")) > MAX_ADVICE_LENGTH:
        raise InputError(f"header report holds advice that is not a text of at most {MAX_ADVICE_LENGTH} characters")
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
    levels = {"level", "least_level"}
    if not isinstance(curves, dict) or not levels < curves.keys() <= levels | {"displacement", "force"}:
        raise InputError("header report holds expected errors without levels and displacement")
    for name in sorted(levels):
        number_in_range(name, curves[name], 0.0, 1.0)
    for quantity in curves.keys() - levels:
        if not isinstance(curves[quantity], dict) or curves[quantity].keys() != {*CURVE_KEYS}:
            raise InputError(f"header report holds an expected error of the {quantity} without {', '.join(CURVE_KEYS)}")
        for name in CURVE_KEYS:
            number_in_range(name, curves[quantity][name], 0.0)


def _step_rule(header: Header) -> Header:
    """Return the arguments of the step rule, and whether the model has single precision."""
    step = number_in_range("step", header["step"], 0.0, unit="s")
    return {"step": step or None, "single": header["single"]}


def _check_values(arrays: Arrays) -> None:
    check_values(arrays)
    if not len(arrays["training_states"]):
        raise InputError("array training_states must hold at least one state")
    if np.any(arrays["cubature/weights"] < 0):
        raise InputError("array cubature/weights holds negative weights")
    if not np.all(arrays["volumes"] > 0):
        raise InputError("array volumes holds volumes that are not positive")
