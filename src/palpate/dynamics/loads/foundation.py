"""Elastic foundations: springs and dashpots on part of a body's surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palpate.core.arrays import Floats
from palpate.core.describe import Described
from palpate.core.faults import InputError, first_few
from palpate.core.parameters import parameter
from palpate.meshfree.cloud import Cloud


@dataclass(frozen=True)
class Foundation(Described):
    """An elastic foundation, such as a ligament or the tissue around an organ.

    The force on a node with its share A of the surface is -A (stiffness u + damping du/dt). The energy
    stored in the springs counts as work of the load.

    Parameters
    ----------
    group : str
        Nodes on the surface of a solid, or of a membrane. Their areas are those of the face that the
        group forms, or else those of all adjacent faces.
    stiffness : float [N/m^3]
    damping : float [N s/m^3]

    Raises
    ------
    InputError
        A stiffness or damping is negative.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> pull = pt.SurfaceForce("x+", force=(0.2, 0, 0))
    >>> ligament = pt.Foundation("x+", stiffness=2e5, damping=100)
    >>> rest = pt.equilibrium(bar, [pull, ligament])
    >>> bool(0 < -rest.reactions["x-"][0] < 0.2)
    True
    """

    group: str
    stiffness: float = parameter("N/m^3", help="stiffness of springs per area", low=0.0)
    damping: float = parameter("N s/m^3", 0.0, "damping of springs per area", low=0.0)


def foundation_areas(cloud: Cloud, load: Foundation) -> Floats:
    """Return the areas [m^2] of a foundation's nodes, shape (g,); raise `InputError` off the surface."""
    nodes = cloud.group(load.group)
    if cloud.points.shape[1] == 2:
        return np.asarray(cloud.volumes[nodes])
    try:
        return np.linalg.norm(cloud.area_vectors(load.group), axis=1)
    except InputError:
        areas = np.bincount(cloud.face_nodes, cloud.face_areas, minlength=len(cloud))[nodes]
    if not np.all(areas > 0):
        raise InputError(
            f"group of Foundation must be on the surface, got {load.group!r} with inner nodes "
            f"{first_few(nodes[areas == 0])}; use a group of surface nodes"
        )
    return np.asarray(areas)
