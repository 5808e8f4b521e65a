"""One file for a reduced model: HDF5, with a checksum, and with nothing in it that could run.

Arrays are datasets with the names they have in `ReducedParts` (``cloud/points``, ``cubature/weights`` ...); what is
short is an attribute. Columns are kept in single precision: they say where the body is and how heavy its motions are,
while forces come from the gradients, which are kept as they are.

The first 512 bytes, which HDF5 leaves to its users, say what the file is and give the SHA-256 of all that follows. It
is verified before HDF5 sees a byte, because a damaged table can keep HDF5 busy for ever.
"""

from __future__ import annotations

import json
import os
import re
from contextlib import suppress
from hashlib import sha256
from io import BytesIO
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from palpate.faults import FileFormatError, InputError, integer_in_range, number_in_range
from palpate.meshfree.cloud import Cloud
from palpate.reduction.compliance import NO_DENTS
from palpate.reduction.cubature import Cubature
from palpate.reduction.points import Kinematics
from palpate.reduction.reduced import ReducedModel, ReducedParts
from palpate.reduction.stored_dents import DENTS, WITHIN, stored_dents
from palpate.reduction.stored_material import (
    described,
    described_fibres,
    described_regions,
    fibres_of,
    material_of,
    regions_of,
)

__all__ = ["load", "save"]

Header = dict[str, Any]
Arrays = dict[str, np.ndarray[Any, Any]]

FORMAT, VERSION, SEAL = "palpate reduced model", 7, 512
PACKED = {"compression": "gzip", "compression_opts": 4, "shuffle": True}

# One line a dataset: its type, and its shape in sizes that all datasets share.
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
    "columns": ("<f4", ("columns", "nodes", 3)),
    "cubature/nodes": ("<i8", ("samples",)),
    "cubature/weights": ("<f8", ("samples",)),
    "cubature/pressure": ("<f8", ("moments", "samples")),
    "gradients": ("<f8", ("samples", "columns", 9)),
    "constant": ("<f8", ("columns", "columns")),
    "trained": ("<f8", ("states", "coordinates")),
    "fibres/directions": ("<f8", ("families", "nodes", 3)),
    "dents/nodes": ("<i8", ("touched",)),
    "dents/carriers": ("<i8", ("touched", "carried")),
    "dents/weights": ("<f8", ("touched", "carried")),
    "dents/flexibility": ("<f4", ("carriers", "carriers")),
    "dents/close": ("<i8", ("touched", "close")),
    "dents/between": ("<f4", ("touched", "close", 3, 3)),
    "dents/patches": ("<i8", ("touched", "patched")),
    "dents/shares": ("<f8", ("touched", "patched")),
    "dents/hardening": ("<f8", (2,)),
}
PLACED: dict[str, tuple[str, tuple[str | int, ...]]] = {
    "regions": ("<i8", ("nodes",))
}  # where there are several materials
NODES = (
    "cloud/face_nodes",
    "cloud/group_nodes",
    "cloud/triangles",
    "cubature/nodes",
    "dents/nodes",
    "inside/nodes",
)  # hold numbers of nodes
ATTRIBUTES = {
    "material": str, "parameters": str, "regions": str, "expression": str, "prony": str, "fibres": str,
    "groups": list, "spacing": float, "fixed": list, "driven": list,
    "viscosity": float, "fastest": float, "modes": int, "lifted": int, "residual": float, "reach": float, "report": str,
    "sheet": bool, "prestretch": float, "relaxed": bool, "slack": float,
    "witnesses": int, "leeway": float, "dents_grip": float, "step": float, "single": bool,
}  # fmt: skip


def save(parts: ReducedParts, path: str | Path, *, step: float | None = None, single: bool = True) -> None:
    """Write a model to an HDF5 file, whole or not at all.

    The file is composed and checked in memory, written beside its place, and put there at once.

    Parameters
    ----------
    parts : ReducedParts
    path : path
    step : float, optional [s]
        Of the implicit rule; by default the steps are explicit.
    single : bool
        Whether the model keeps the derivatives at its samples in single precision; the file has them in double.

    Raises
    ------
    InputError
        Parts that `load` would refuse, such as a material of one's own or numbers that are not finite.
    OSError
        The place cannot be written or the disk is full; a file that was there is unchanged.
    """
    path = Path(path)
    content, partial = (
        _file(parts, {"step": float(step or 0.0), "single": bool(single)}),
        path.with_name(path.name + ".partial"),
    )
    try:
        with open(partial, "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    except OSError as error:
        raise OSError(f"cannot write {path}: {error}; choose another folder or free some space") from error
    finally:
        with suppress(OSError):
            partial.unlink()


def load(path: str | Path) -> ReducedModel:
    """Read a reduced model as it was saved: with its step rule, explicit or implicit, and its precision.

    Raises
    ------
    FileNotFoundError
        There is no such file.
    FileFormatError
        The file is truncated, changed, of another kind or version, or holds what no reduced model can hold: the message
        names the file and what is wrong in it.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"no reduced model at {path}")
    try:
        header, arrays = _content(path.read_bytes())
        return ReducedModel(_parts(header, arrays), **_rule(header))
    except (InputError, np.linalg.LinAlgError) as error:
        raise FileFormatError(f"{path}: {error}") from error


# writing


def _file(parts: ReducedParts, rule: Header) -> bytes:
    """Return the file of a model; refuse what could not be loaded from it."""
    import h5py

    memory = BytesIO()
    with h5py.File(memory, "w", userblock_size=SEAL) as file:
        file.attrs.update(format=FORMAT, version=VERSION, units="SI", **_header(parts), **rule)
        for name, array in _arrays(parts).items():
            file.create_dataset(name, data=array, **(PACKED if array.size else {}))
        header, arrays = _read(file)
        _rule(header)
        if _parts(header, arrays).material != parts.material:
            raise InputError(f"the file would not give {parts.material} back")
    content = memory.getvalue()[SEAL:]
    return _seal(content) + content


def _seal(content: bytes) -> bytes:
    """Return the first bytes of a file whose other bytes are some content."""
    text = f"{FORMAT}\nversion {VERSION}\nsha256 {sha256(content).hexdigest()}\n"
    return text.encode().ljust(SEAL, b"\0")


def _header(parts: ReducedParts) -> Header:
    return {
        **described(parts.material),
        "fibres": described_fibres(parts.fibres),
        "regions": described_regions(parts.regions),
        "groups": list(parts.cloud.groups),
        "spacing": float(parts.cloud.spacing),
        "fixed": list(parts.fixed),
        "driven": list(parts.driven),
        "viscosity": float(parts.viscosity),
        "fastest": float(parts.fastest),
        "modes": int(parts.modes),
        "lifted": int(parts.lifted),
        "residual": float(parts.cubature.residual),
        "reach": float(parts.reach),
        "witnesses": int(parts.witnesses),
        "leeway": float(parts.leeway),
        "sheet": parts.kinematics.sheet,
        "prestretch": float(parts.kinematics.prestretch),
        "relaxed": parts.kinematics.relaxed,
        "slack": float(parts.slack),
        "dents_grip": float((parts.dents or NO_DENTS).grip),
        "report": json.dumps(parts.report, default=lambda value: value.tolist()),
    }


def _arrays(parts: ReducedParts) -> Arrays:
    groups = list(parts.cloud.groups.values())
    dents = parts.dents or NO_DENTS
    listed: dict[str, Any] = {
        "cloud/group_sizes": [len(nodes) for nodes in groups],
        "cloud/group_nodes": [node for nodes in groups for node in nodes],
        "regions": None if parts.regions is None else parts.regions.which,
        "fibres/directions": np.zeros((0, len(parts.cloud), 3)) if parts.fibres is None else parts.fibres.directions,
        **{f"dents/{name}": getattr(dents, name) for name in DENTS},
    }
    layout = LAYOUT if parts.regions is None else LAYOUT | PLACED
    if dents.inside is not None:
        layout = layout | WITHIN
        listed |= {f"inside/{name}": array for name, array in dents.inside._asdict().items()}
        listed["inside/factor"] = [dents.inside.factor]
    return {
        name: np.asarray(listed[name] if name in listed else attrgetter(name.replace("/", "."))(parts), dtype=dtype)
        for name, (dtype, _) in layout.items()
    }


# reading


def _content(data: bytes) -> tuple[Header, Arrays]:
    """Return what the bytes of a file hold, its checksum and shapes verified."""
    import h5py

    seal, content = data[:SEAL], data[SEAL:]
    found = re.match(rf"{FORMAT}\nversion (\d+)\n".encode(), seal)
    if not found:
        raise InputError(f"this is not a {FORMAT}")
    if int(found[1]) != VERSION:
        raise InputError(f"this is of version {int(found[1])}, and version {VERSION} is the one that is read")
    if seal != _seal(content):
        raise InputError("the checksum does not match: the file is truncated or was changed; copy it or train it again")
    try:
        with h5py.File(BytesIO(data), "r") as file:
            return _read(file)
    except (OSError, KeyError, RuntimeError) as error:
        raise InputError(f"the file cannot be read as HDF5 ({error})") from error


def _read(file: Any) -> tuple[Header, Arrays]:
    """Return attributes as plain values, and arrays as they are stored, of the types and shapes of the layout."""
    import h5py

    header = {name: v.tolist() if isinstance(v, np.ndarray | np.generic) else v for name, v in file.attrs.items()}
    header = {"regions": "[]"} | header  # one material, in files of before there could be others
    for name, kind in ATTRIBUTES.items():
        if not isinstance(header.get(name), kind):
            raise InputError(f"attribute {name} is {header.get(name)!r}, expected one of type {kind.__name__}")
    coordinates = integer_in_range("modes", header["modes"], 1) + integer_in_range("lifted", header["lifted"], 0)
    sizes: dict[str | int, int] = {
        "space": 2 if header["sheet"] else 3,
        "groups": len(header["groups"]),
        "coordinates": coordinates,
        "columns": coordinates + 3 * len(header["fixed"]) + integer_in_range("witnesses", header["witnesses"], 0),
    }
    arrays = {}
    layout = LAYOUT if header["regions"] == "[]" else LAYOUT | PLACED
    for name, (dtype, shape) in (layout | WITHIN if "inside" in file else layout).items():
        data = file.get(name)
        if not isinstance(data, h5py.Dataset):
            raise InputError(f"dataset {name} is missing")
        if data.external or data.is_virtual:
            raise InputError(f"dataset {name} lies in another file")
        expected = tuple(sizes.get(size, size) for size in shape)
        fits = len(expected) == data.ndim and all(
            found == size or isinstance(size, str) for found, size in zip(data.shape, expected, strict=True)
        )
        if not fits or data.dtype != dtype:
            wanted = f"({', '.join(map(str, expected))}) of {dtype}"
            raise InputError(f"dataset {name} has shape {data.shape} of {data.dtype.str}, expected {wanted}")
        sizes.update(zip(shape, data.shape, strict=True))
        arrays[name] = data[()]
    return header, arrays


def _parts(header: Header, arrays: Arrays) -> ReducedParts:
    """Make the parts of a model, refusing values that no model has."""
    _check_values(arrays)
    own: dict[str, Any] = {n: a.astype(int if a.dtype.kind == "i" else float) for n, a in arrays.items()}
    ends = np.cumsum(own["cloud/group_sizes"])
    groups = np.split(own["cloud/group_nodes"], ends[:-1]) if len(ends) else []
    cloud = Cloud(
        own["cloud/points"], own["cloud/volumes"], own["cloud/face_nodes"], own["cloud/face_normals"],
        own["cloud/face_areas"], dict(zip(header["groups"], groups, strict=True)), own["cloud/triangles"],
        number_in_range("spacing", header["spacing"], 0.0, open_low=True, unit="m"),
    )  # fmt: skip
    for name in (*header["fixed"], *header["driven"]):
        cloud.group(name)
    residual = number_in_range("residual", header["residual"], 0.0)
    material = material_of(
        header["material"],
        _mapping("parameters", header["parameters"]),
        header["expression"],
        _mapping("prony", header["prony"]),
    )
    regions = regions_of(_json("regions", header["regions"]), own.get("regions", np.zeros(0, dtype=int)), material)
    return ReducedParts(
        cloud=cloud,
        material=material,
        regions=regions,
        fixed=tuple(header["fixed"]),
        driven=tuple(header["driven"]),
        volumes=own["volumes"],
        stiffness=own["stiffness"],
        viscosity=number_in_range("viscosity", header["viscosity"], 0.0, unit="s"),
        fastest=number_in_range("fastest", header["fastest"], 0.0, unit="m/s"),
        columns=own["columns"],
        modes=header["modes"],
        lifted=header["lifted"],
        cubature=Cubature(own["cubature/nodes"], own["cubature/weights"], own["cubature/pressure"], residual),
        gradients=own["gradients"],
        constant=own["constant"],
        trained=own["trained"],
        reach=number_in_range("reach", header["reach"], 0.0, open_low=True, unit="m"),
        witnesses=header["witnesses"],
        leeway=number_in_range("leeway", header["leeway"], 0.0, open_low=True, unit="m"),
        report=_mapping("report", header["report"]),
        kinematics=Kinematics(
            header["sheet"], number_in_range("prestretch", header["prestretch"], 1.0), header["relaxed"]
        ),
        slack=number_in_range("slack", header["slack"], 0.0, unit="rad/s"),
        fibres=fibres_of(_mapping("fibres", header["fibres"]), own["fibres/directions"]),
        dents=stored_dents(own, number_in_range("dents_grip", header["dents_grip"], 0.0, open_low=True)),
    )


def _rule(header: Header) -> Header:
    """Return how the model is stepped, and whether in single precision."""
    step = number_in_range("step", header["step"], 0.0, unit="s")
    return {"step": step or None, "single": header["single"]}


def _check_values(arrays: Arrays) -> None:
    count = len(arrays["cloud/points"])
    for name, array in arrays.items():
        if not np.isfinite(array).all():
            raise InputError(f"dataset {name} holds numbers that are not finite")
        if name in NODES and not np.all((array >= 0) & (array < count)):
            raise InputError(f"dataset {name} names nodes outside 0..{count - 1}")
    if np.any(arrays["cubature/weights"] < 0):
        raise InputError("dataset cubature/weights holds negative weights")
    for name in ("volumes", "stiffness"):
        if not np.all(arrays[name] > 0):
            raise InputError(f"dataset {name} holds {name} that are not positive")
    sizes, members = arrays["cloud/group_sizes"], len(arrays["cloud/group_nodes"])
    if np.any(sizes < 1) or sizes.sum() != members:
        raise InputError(f"dataset cloud/group_sizes does not share out the {members} entries of cloud/group_nodes")


def _json(name: str, text: str) -> Any:
    try:
        return json.loads(text)
    except (ValueError, RecursionError) as error:
        raise InputError(f"attribute {name} is not JSON ({error})") from error


def _mapping(name: str, text: str) -> dict[str, Any]:
    values = _json(name, text)
    if not isinstance(values, dict):
        raise InputError(f"attribute {name} is not a mapping")
    return values
