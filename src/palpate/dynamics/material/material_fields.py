"""Laws whose parameters differ from node to node: their place in a body, and in the compiled kernels.

Where they do not, a law's parameters are one tuple, and a kernel is compiled for that. Where they do, they stand in an
array (b, p + 1, LANES), lane by lane, of which a kernel takes the p numbers of its lane as a tuple; the last row is the
shear modulus at rest over the first material's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from typing import Any

import numpy as np
from numba.extending import register_jitable
from numpy.typing import NDArray

from palpate.faults import InputError
from palpate.meshfree.cloud import Cloud
from palpate.tissue.materials import Material
from palpate.tissue.regions import Regions

__all__ = ["EVERYWHERE", "parameters_at", "regions_of", "spread"]

EVERYWHERE = 0  # parameters that differ: none


def regions_of(
    material: Material | Mapping[str, Material] | Sequence[Material], cloud: Cloud
) -> tuple[Material, Regions | None]:
    """Return the material that a body's moduli count in, and its regions if there are several.

    Raises
    ------
    InputError
        An unknown group, nodes without a material, or materials that do not go together.
    """
    if isinstance(material, Material):
        return material, None
    count = len(cloud)
    if isinstance(material, Mapping):
        which = np.full(count, -1)
        for k, group in enumerate(material):
            which[cloud.group(group) if group else np.arange(count)] = k
        if np.any(which < 0):
            raise InputError(f"{np.sum(which < 0)} nodes have no material: say with '' what lies everywhere else")
        given = list(material.values())
    else:
        given, which = list(material), np.arange(count)
        if len(given) != count:
            raise InputError(f"material is a list of {len(given)}: give one for each of the {count} nodes")
    for each in given:
        if not isinstance(each, Material):
            raise InputError(f"material holds {each!r}: give palpate's materials, by group or by node")
    kinds = {each: i for i, each in enumerate(dict.fromkeys(given[k] for k in np.unique(which)))}  # equal ones are one
    regions = Regions(tuple(kinds), np.array([kinds.get(each, 0) for each in given])[which])
    return regions.materials[0], regions if len(kinds) > 1 else None


def spread(regions: Regions, nodes: NDArray[np.integer[Any]]) -> NDArray[np.float64]:
    """Lay the parameters of nodes (b, LANES) out, (b, p + 1, LANES)."""
    every = np.column_stack([regions.coefficients, regions.modulus_ratio])
    return np.ascontiguousarray(every[nodes].transpose(0, 2, 1))


@register_jitable
def _everywhere(coefficients, b, v):  # type: ignore[no-untyped-def]
    return coefficients


@cache
def parameters_at(count: int) -> Any:
    """Return the function ``at(coefficients, b, v)``: the law's parameters in a lane, `count` if they differ."""
    if count == EVERYWHERE:
        return _everywhere
    if count == 1:

        @register_jitable
        def first(coefficients, b, v):  # type: ignore[no-untyped-def]
            return (coefficients[b, 0, v],)

        return first
    fewer, last = parameters_at(count - 1), count - 1

    @register_jitable
    def at(coefficients, b, v):  # type: ignore[no-untyped-def]
        return fewer(coefficients, b, v) + (coefficients[b, last, v],)  # noqa: RUF005 - as the compiler takes it

    return at
