"""A full body in a file, such as a recording: cloud, tissue, supports and damping, from which it is made again."""

from __future__ import annotations

from palpate.core.faults import integer_in_range, number_in_range
from palpate.core.sealed import ArrayFile
from palpate.dynamics.membrane.model import Membrane
from palpate.dynamics.nodal.model import NodalModel
from palpate.dynamics.solid.energy import EnergySolid
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.storage.body import (
    BODY_ATTRIBUTES,
    Arrays,
    Header,
    body_arrays,
    body_declared,
    body_header,
    body_of,
    check_body,
    check_header,
    read_arrays,
)
from palpate.reduction.storage.model_file import contents, model_of

MAX_NEIGHBOURS = 200  # of a node; the largest default is 63
SOLID_ATTRIBUTES: dict[str, type] = BODY_ATTRIBUTES | {"neighbours": int}
SHEET_ATTRIBUTES = SOLID_ATTRIBUTES | {"thickness": float, "prestretch": float, "relaxed": bool}


def body_contents(model: ReducedModel | NodalModel) -> tuple[Header, Arrays]:
    """Return the header and the arrays of a reduced model or a full body."""
    if isinstance(model, ReducedModel):
        return contents(model)
    assert isinstance(model, EnergySolid | Membrane)
    supports, damping = tuple(model.supports), (model.stiffness_damping, model.mass_damping)
    header = body_header(model.cloud, model.tissue, supports, *damping) | {"neighbours": int(model.neighbours)}
    if isinstance(model, Membrane):
        header |= {"thickness": model.thickness, "prestretch": model.prestretch, "relaxed": model.relaxed}
    arrays = body_arrays(model.cloud, model.tissue)
    _check(header, arrays)
    return header, arrays


def _check(header: Header, arrays: Arrays) -> None:
    """Refuse the header or the arrays of a full body that are not as declared."""
    is_sheet = "thickness" in header
    check_header(header, SHEET_ATTRIBUTES if is_sheet else SOLID_ATTRIBUTES)
    check_body(arrays, body_declared(header), {"space": 2 if is_sheet else 3, "groups": len(header["groups"])})
    integer_in_range("neighbours", header["neighbours"], 1, MAX_NEIGHBOURS)


def body_in(header: Header, file: ArrayFile, prefix: str) -> ReducedModel | NodalModel:
    """Return the reduced model or the full body of a header and of the arrays whose names begin with a prefix."""
    if "neighbours" not in header:
        return model_of(header, file, prefix)
    check_header(header, SHEET_ATTRIBUTES if "thickness" in header else SOLID_ATTRIBUTES)
    arrays = read_arrays(file, prefix, body_declared(header))
    _check(header, arrays)
    cloud, tissue, supports = body_of(
        header, {name: a.astype(int if a.dtype.kind == "i" else float) for name, a in arrays.items()}
    )
    stiffness_damping = number_in_range("stiffness_damping", header["stiffness_damping"], 0.0, unit="s")
    mass_damping = number_in_range("mass_damping", header.get("mass_damping", 0.0), 0.0, unit="1/s")
    neighbours = min(header["neighbours"], len(cloud))
    if "thickness" in header:
        return Membrane(
            cloud, tissue.material, header["thickness"], supports, prestretch=header["prestretch"],
            relaxed=header["relaxed"], stiffness_damping=stiffness_damping, mass_damping=mass_damping,
            neighbours=neighbours, fibres=tissue.fibres,
        )  # fmt: skip
    regions = tissue.regions
    materials = tissue.material if regions is None else [regions.materials[k] for k in regions.which]
    stiffness = tissue.stiffness if len(tissue.stiffness) else None
    return EnergySolid(
        cloud, materials, supports, stiffness_damping=stiffness_damping, mass_damping=mass_damping,
        stiffness=stiffness, neighbours=neighbours, fibres=tissue.fibres,
    )  # fmt: skip
