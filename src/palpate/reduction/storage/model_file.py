"""File of a reduced model: a sealed HDF5 file (`palpate.core.sealed`) with data only.

Arrays have names such as ``cloud/points`` and ``cubature/weights``, and short values are in the header.
Basis vectors have single precision: they determine displacements and masses. Forces
depend on the gradients, which have double precision.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from palpate.core.faults import InputError, integer_in_range, number_in_range
from palpate.core.files import plain
from palpate.core.sealed import MIN_POSITIVE, Array, ArrayFile, loading, open_sealed, typed, write_sealed
from palpate.dynamics.material.kinematics import Kinematics
from palpate.reduction.contact.compliance import NO_COMPLIANCE
from palpate.reduction.hyper.cubature import Cubature
from palpate.reduction.hyper.data import (
    UNLIMITED_SCALE,
    ReducedData,
    SampledBasis,
    Scales,
    TrainedRange,
    TrialAndTestBasis,
)
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.storage.body import (
    BODY_ATTRIBUTES,
    MAX_NUMBER,
    Arrays,
    Declared,
    Header,
    body_arrays,
    body_declared,
    body_header,
    body_of,
    check_body,
    check_header,
    mapping_in,
    read_arrays,
    supports_in,
)
from palpate.reduction.storage.compliance import (
    COMPLIANCE_ARRAYS,
    INTERIOR_ARRAYS,
    STEPS_ARRAY,
    pack_flexibilities,
    read_compliance,
    unpack_flexibilities,
)

FORMAT, VERSION = "palpate reduced model", 14
OLDER_VERSIONS = (12, 13)  # also read
NEW_ATTRIBUTES = {"speed_scale", "nearness_scale"}  # that older files lack; their error bounds have another meaning
MODEL_REMEDY = "copy the file again, or train the model again"
MAX_NAME_LENGTH = 200  # characters of a scene's name
MAX_ADVICE_LENGTH = 1000  # characters

MODEL_ARRAYS: Declared = {
    "volumes": Array(("nodes",), low=MIN_POSITIVE, most=MAX_NUMBER, unit="m^3"),
    "basis_vectors": Array(("basis_vectors", "nodes", 3), "<f4", most=MAX_NUMBER),
    "cubature/nodes": Array(("cubature_points",), "<i8", index_of="nodes"),
    "cubature/weights": Array(("cubature_points",), low=0.0, most=MAX_NUMBER, unit="m^3"),
    "cubature/pressure": Array(("moments", "cubature_points"), most=MAX_NUMBER),
    "gradients": Array(("cubature_points", "basis_vectors", 9), most=MAX_NUMBER),
    "constant": Array(("basis_vectors", "basis_vectors"), most=MAX_NUMBER),
    "training_states": Array(("states", "coordinates"), most=MAX_NUMBER),
} | COMPLIANCE_ARRAYS
CURVE_KEYS = ("bound", "exponent", "largest_trust", "least_trust", "median", "typical_size")  # of an expected error
ATTRIBUTE_TYPES: dict[str, type] = BODY_ATTRIBUTES | {
    "prescribed": list, "wave_speed": float, "modes": int, "lifting_count": int, "residual": float,
    "distance_scale": float, "report": str,
    "sheet": bool, "prestretch": float, "relaxed": bool, "taut_frequency": float,
    "residual_fields": int, "residual_scale": float, "load_scale": float,
    "flexibility_scale": float, "speed_scale": float, "nearness_scale": float, "bonded_scale": float,
    "trained_tools": int,
    "step": float, "single": bool,
}  # fmt: skip


def save_hyper_reduced(model: ReducedModel, path: str | Path) -> None:
    """Write a model to a sealed HDF5 file, completely or not at all.

    Derivatives at its cubature points are written in double precision.
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
    if _data(header, _checked(header, unpack_flexibilities(packed))).tissue.material != data.tissue.material:
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
        "distance_scale": float(data.scales.distance_scale),
        "residual_fields": int(data.residual_fields),
        "residual_scale": float(data.scales.residual_scale),
        "load_scale": float(data.scales.load_scale),
        "flexibility_scale": float(data.scales.flexibility_scale),
        "speed_scale": float(data.scales.speed_scale),
        "nearness_scale": float(data.scales.nearness_scale),
        "trained_tools": int(data.scales.trained_tools),
        "sheet": data.kinematics.sheet,
        "prestretch": float(data.kinematics.prestretch),
        "relaxed": data.kinematics.relaxed,
        "taut_frequency": float(data.trained.taut_frequency),
        "bonded_scale": float((data.compliance or NO_COMPLIANCE).bonded_scale),
        "report": json.dumps(plain(data.report)),
    }


def _arrays(data: ReducedData) -> Arrays:
    compliance = data.compliance or NO_COMPLIANCE
    values: dict[str, Any] = {f"compliance/{name}": array for name, array in compliance._asdict().items()}
    declared = MODEL_ARRAYS
    if compliance.interior is not None:
        declared = declared | INTERIOR_ARRAYS
        values |= {f"interior/{name}": array for name, array in compliance.interior._asdict().items()}
        values["interior/factor"] = [compliance.interior.factor]
    values |= {
        "volumes": data.volumes,
        "basis_vectors": data.basis.vectors,
        "cubature/nodes": data.cubature.nodes,
        "cubature/weights": data.cubature.weights,
        "cubature/pressure": data.cubature.pressure,
        "gradients": data.sampled.gradients,
        "constant": data.sampled.constant,
        "training_states": data.trained.states,
    }
    return body_arrays(data.cloud, data.tissue) | typed(values, declared)


# reading


def model_of(header: Header, file: ArrayFile, prefix: str = "") -> ReducedModel:
    """Return the model of a header and of the arrays of a file whose names begin with a prefix."""
    header = {"trained_tools": 1} | header  # older files lack it
    header = header if NEW_ATTRIBUTES & header.keys() else _converted(header)
    check_header(header, ATTRIBUTE_TYPES)
    declared = _declared(header, f"{prefix}interior/nodes" in file.arrays)
    steps = STEPS_ARRAY if f"{prefix}compliance/steps" in file.arrays else {}
    arrays = unpack_flexibilities(read_arrays(file, prefix, declared | steps))
    return ReducedModel(_data(header, _checked(header, arrays)), **_step_rule(header))


def _converted(header: Header) -> Header:
    """Return the header of an older file: without limits of speed and nearness, and without its error bounds."""
    check_header(header, {name: kind for name, kind in ATTRIBUTE_TYPES.items() if name not in NEW_ATTRIBUTES})
    report = mapping_in("report", header["report"])
    held_out = report.get("held_out")
    if isinstance(held_out, dict):
        report = report | {"held_out": {name: value for name, value in held_out.items() if name != "expected_error"}}
    return header | dict.fromkeys(NEW_ATTRIBUTES, UNLIMITED_SCALE) | {"report": json.dumps(report)}


def _declared(header: Header, interior: bool) -> Declared:
    return body_declared(header) | MODEL_ARRAYS | (INTERIOR_ARRAYS if interior else {})


def _checked(header: Header, arrays: Arrays) -> Arrays:
    """Return arrays that are as declared; refuse others."""
    modes = integer_in_range("modes", header["modes"], 1)
    coordinates = modes + integer_in_range("lifting_count", header["lifting_count"], 0)
    sizes = {
        "space": 2 if header["sheet"] else 3,
        "groups": len(header["groups"]),
        "coordinates": coordinates,
        "basis_vectors": coordinates
        + 3 * len(supports_in(header))
        + integer_in_range("residual_fields", header["residual_fields"], 0),
    }
    check_body(arrays, _declared(header, "interior/nodes" in arrays), sizes)
    if not len(arrays["training_states"]):
        raise InputError("array training_states must hold at least one state")
    return arrays


def _data(header: Header, arrays: Arrays) -> ReducedData:
    """Return the data of a model; refuse values out of range."""
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
        basis=TrialAndTestBasis(
            values["basis_vectors"], header["modes"], header["lifting_count"], header["residual_fields"]
        ),
        sampled=SampledBasis(
            Cubature(values["cubature/nodes"], values["cubature/weights"], values["cubature/pressure"], residual),
            values["gradients"],
            values["constant"],
        ),
        trained=TrainedRange(
            values["training_states"],
            _scales(header),
            number_in_range("taut_frequency", header["taut_frequency"], 0.0, unit="rad/s"),
        ),
        report=_report(mapping_in("report", header["report"])),
        kinematics=Kinematics(
            header["sheet"], number_in_range("prestretch", header["prestretch"], 1.0), header["relaxed"]
        ),
        compliance=read_compliance(values, number_in_range("bonded_scale", header["bonded_scale"], 0.0, open_low=True)),
    )


def _scales(header: Header) -> Scales:
    """Return the scales of the error indicator; refuse values out of range."""
    return Scales(
        distance_scale=number_in_range("distance_scale", header["distance_scale"], 0.0, open_low=True, unit="m"),
        residual_scale=number_in_range("residual_scale", header["residual_scale"], 0.0, open_low=True, unit="m"),
        load_scale=number_in_range("load_scale", header["load_scale"], 0.0, 1.0, open_low=True),
        flexibility_scale=number_in_range(
            "flexibility_scale", header["flexibility_scale"], 0.0, open_low=True, unit="J"
        ),
        speed_scale=number_in_range("speed_scale", header["speed_scale"], 0.0, open_low=True, unit="m/s"),
        nearness_scale=number_in_range("nearness_scale", header["nearness_scale"], 0.0, open_low=True),
        trained_tools=integer_in_range("trained_tools", header["trained_tools"], 1),
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
    known = levels | {"displacement", "force", "forgetting"}  # older files lack the last
    if not isinstance(curves, dict) or not levels < curves.keys() <= known:
        raise InputError("header report holds expected errors without levels and displacement")
    for name in sorted(levels):
        number_in_range(name, curves[name], 0.0, 1.0)
    number_in_range("forgetting", curves.get("forgetting", 0.0), 0.0)
    for quantity in curves.keys() & {"displacement", "force"}:
        if not isinstance(curves[quantity], dict) or curves[quantity].keys() != {*CURVE_KEYS}:
            raise InputError(f"header report holds an expected error of the {quantity} without {', '.join(CURVE_KEYS)}")
        for name in CURVE_KEYS:
            number_in_range(name, curves[quantity][name], 0.0)


def _step_rule(header: Header) -> Header:
    """Return the arguments of the step rule, and whether the model has single precision."""
    step = number_in_range("step", header["step"], 0.0, unit="s")
    return {"step": step or None, "single": header["single"]}
