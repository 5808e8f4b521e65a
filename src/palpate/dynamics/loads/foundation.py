"""Elastic foundations: springs that tie part of a body's surface to where it is at rest."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palpate.arrays import Floats
from palpate.describe import Described, Fact
from palpate.faults import InputError, first_few, number_in_range
from palpate.meshfree.cloud import Cloud

__all__ = ["Foundation", "foundation_areas"]


@dataclass(frozen=True)
class Foundation(Described):
    """Springs and dashpots that tie the nodes of a group to their places: a ligament, or what lies around an organ.

    A node with its share A of the surface is drawn back by A (stiffness u + damping du/dt). What the springs store
    counts as work of the load, and is given back.

    Parameters
    ----------
    group : str
        Nodes on the surface of a solid, or of a membrane. Their areas are those of the face that they make up, or where
        they make up none, of all their faces.
    stiffness : float [N/m^3]
    damping : float [N s/m^3]

    Raises
    ------
    InputError
        A stiffness or damping that is negative.
    """

    group: str
    stiffness: float
    damping: float = 0.0

    def __post_init__(self) -> None:
        number_in_range(f"stiffness of Foundation on {self.group!r}", self.stiffness, 0.0, unit="N/m^3")
        number_in_range(f"damping of Foundation on {self.group!r}", self.damping, 0.0, unit="N s/m^3")

    def _facts(self) -> list[Fact]:
        return [
            ("group", self.group, ""),
            ("stiffness", float(self.stiffness), "N/m^3"),
            ("damping", float(self.damping), "N s/m^3"),
        ]


def foundation_areas(cloud: Cloud, load: Foundation) -> Floats:
    """Return areas [m^2] of a foundation's nodes: of the face that they make up, or else of all their faces."""
    nodes = cloud.group(load.group)
    if cloud.points.shape[1] == 2:
        return np.asarray(cloud.volumes[nodes])
    try:
        return np.linalg.norm(cloud.area_vectors(load.group), axis=1)
    except InputError:
        areas = np.bincount(cloud.face_nodes, cloud.face_areas, minlength=len(cloud))[nodes]
    if not np.all(areas > 0):
        raise InputError(
            f"Foundation on group {load.group!r}: nodes {first_few(nodes[areas == 0])} are not on the surface"
        )
    return np.asarray(areas)
