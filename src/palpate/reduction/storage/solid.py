"""A full body in a file, such as a recording: cloud, tissue, supports and damping, from which it is made again."""

from __future__ import annotations

from palpate.core.faults import integer_in_range, number_in_range
from palpate.core.sealed import ArrayFile
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


def body_contents(model: ReducedModel | EnergySolid) -> tuple[Header, Arrays]:
    """Return the header and the arrays of a reduced model or a full body."""
    if isinstance(model, ReducedModel):
        return contents(model)
    supports, damping = tuple(model.supports), (model.stiffness_damping, model.mass_damping)
    header = body_header(model.cloud, model.tissue, supports, *damping) | {"neighbours": int(model.neighbours)}
    arrays = body_arrays(model.cloud, model.tissue)
    check_header(header, SOLID_ATTRIBUTES)
    check_body(arrays, body_declared(header), {"space": 3})
    integer_in_range("neighbours", header["neighbours"], 1, MAX_NEIGHBOURS)
    return header, arrays


def body_in(header: Header, file: ArrayFile, prefix: str) -> ReducedModel | EnergySolid:
    """Return the reduced model or the full body of a header and of the arrays whose names begin with a prefix."""
    if "neighbours" not in header:
        return model_of(header, file, prefix)
    check_header(header, SOLID_ATTRIBUTES)
    declared = body_declared(header)
    arrays = read_arrays(file, prefix, declared)
    check_body(arrays, declared, {"space": 3, "groups": len(header["groups"])})
    cloud, tissue, supports = body_of(
        header, {name: a.astype(int if a.dtype.kind == "i" else float) for name, a in arrays.items()}
    )
    regions = tissue.regions
    return EnergySolid(
        cloud,
        tissue.material if regions is None else [regions.materials[k] for k in regions.which],
        supports,
        stiffness_damping=number_in_range("stiffness_damping", header["stiffness_damping"], 0.0, unit="s"),
        mass_damping=number_in_range("mass_damping", header.get("mass_damping", 0.0), 0.0, unit="1/s"),
        stiffness=tissue.stiffness if len(tissue.stiffness) else None,
        neighbours=integer_in_range("neighbours", header["neighbours"], 1, min(MAX_NEIGHBOURS, len(cloud))),
        fibres=tissue.fibres,
    )
