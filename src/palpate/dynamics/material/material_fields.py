"""Parameters of a law that differ from node to node, in a body and in the compiled kernels.

The parameters of a uniform body are one tuple, and a kernel is compiled for that. Parameters that
differ are an array (b, p + 1, LANES), from which a kernel takes the p numbers of its lane as a tuple.
The last row is the ratio of the shear modulus at rest to that of the first material.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from palpate.compiled.jit import law_digest, rename_for
from palpate.core.faults import InputError
from palpate.meshfree.cloud import Cloud
from palpate.tissue.materials import Material
from palpate.tissue.regions import Regions

NO_FIELDS = 0  # number of parameters that differ in a uniform body


def regions_of(
    material: Material | Mapping[str, Material] | Sequence[Material], cloud: Cloud
) -> tuple[Material, Regions | None]:
    """Return the reference material of a body, and its regions if it has several materials."""
    if isinstance(material, Material):
        return material, None
    count = len(cloud)
    if isinstance(material, Mapping):
        which = np.full(count, -1)
        for k, group in enumerate(material):
            which[cloud.group(group) if group else np.arange(count)] = k
        if np.any(which < 0):
            raise InputError(
                f"material must cover all nodes, got {np.sum(which < 0)} without one; use the key '' for all others"
            )
        materials = list(material.values())
    else:
        materials, which = list(material), np.arange(count)
        if len(materials) != count:
            raise InputError(f"material must have one entry for each of the {count} nodes, got {len(materials)}")
    for each in materials:
        if not isinstance(each, Material):
            raise InputError(f"material must be palpate's materials, got {each!r:.200}; give them by group or by node")
    kinds = {each: i for i, each in enumerate(dict.fromkeys(materials[k] for k in np.unique(which)))}
    regions = Regions(tuple(kinds), np.array([kinds.get(each, 0) for each in materials])[which])
    return regions.materials[0], regions if len(kinds) > 1 else None


def spread(regions: Regions, nodes: NDArray[np.integer[Any]]) -> NDArray[np.float64]:
    """Lay out the parameters of nodes (b, LANES) as (b, p + 1, LANES)."""
    every = np.column_stack([regions.coefficients, regions.modulus_ratio])
    return np.ascontiguousarray(every[nodes].transpose(0, 2, 1))


@register_jitable
def _everywhere(coefficients, b, v):
    return coefficients


@cache
def parameters_at(count: int) -> Any:
    """Return ``at(coefficients, b, v)``, which returns the law's parameters in a lane."""
    if count == NO_FIELDS:
        return _everywhere
    digest = law_digest(__name__, "parameters at", count)
    if count == 1:

        def first(coefficients, b, v):
            return (coefficients[b, 0, v],)

        return register_jitable(rename_for(digest, first))
    fewer, last = parameters_at(count - 1), count - 1

    def at(coefficients, b, v):
        return fewer(coefficients, b, v) + (coefficients[b, last, v],)  # noqa: RUF005 - required by the compiler

    return register_jitable(rename_for(digest, at))
