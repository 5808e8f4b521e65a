"""Filling of closed surfaces with nodes: of a file, of arrays, or of a surface in memory."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from palpate.core.faults import InputError, brief, integer_in_range, number_in_range
from palpate.meshfree.cloud import Cloud
from palpate.meshfree.fill_surface import Region, fill_surface
from palpate.surface.files import read_surface
from palpate.surface.repair import HOLLOWED_BODY, repair_surface
from palpate.surface.surface import Surface, weld


def fill(
    surface: Surface | str | Path | tuple[ArrayLike, ArrayLike],
    spacing: float,
    *,
    part: str | Sequence[str] | None = None,
    units: str | None = None,
    repair: bool = False,
    lattice: str = "bcc",
    refine: Sequence[Region] = (),
    seed: int = 0,
) -> Cloud:
    """Fill a closed surface with nodes.

    Nodes on the surface lie 0.8 spacings apart, with the surface's normals, and are joined by
    triangles. Nodes inside start from a lattice at least 0.65 spacings below the surface and are
    relaxed until evenly spaced. Nodal volumes are those of Voronoi cells, and sum to the volume of
    the body. Components inside others are cavities: they stay empty, with nodes on their walls.

    Parameters
    ----------
    surface : Surface, path, or (vertices, triangles)
        A file (`palpate.io.read_surface`), or arrays (v, 3) [m] and (t, 3), triangles
        counter-clockwise from outside.
    spacing : float [m]
        Target distance between nodes.
    part, units
        For a file, as for `palpate.io.read_surface`.
    repair : bool
        Whether to close small holes and orient triangles: see
        `palpate.surface.repair.repair_surface`.
    lattice : str
        ``"bcc"`` (body-centred cubic), ``"cubic"`` or ``"scattered"`` (Poisson discs).
    refine : sequence of (centre, radius, spacing)
        Finer spacings around points [m]; the spacing increases from there by a third of the
        distance, up to `spacing`. The lattice is then ``"scattered"``.
    seed : int
        Equal seeds give equal clouds.

    Returns
    -------
    Cloud
        Group ``"surface"`` contains the surface nodes, which `triangles` join; of several separate
        bodies, ``"body 0"`` and so on contain the nodes of each. Every surface node has one entry in
        the faces, its area vector. Area vectors sum to zero. The sum of their lengths is the area of
        the surface, reduced by the curvature within each node's part.

    Raises
    ------
    InputError
        A surface that is open, hollow, inside out or self-intersecting; or a parameter out of range.
    CloudError
        The spacing is too coarse: too few nodes lie inside, the cloud does not support moving least
        squares, or separate bodies are so close that their stencils would overlap.

    Warns
    -----
    UserWarning
        The units of a file are assumed, a part is chosen, cavities finer than the spacing are
        filled, or a body is larger than 10 m or smaller than 0.1 mm.

    Examples
    --------
    >>> import palpate as pt
    >>> surface = pt.liver_surface(resolution=0.008, volume=2e-4)
    >>> cloud = pt.fill(surface, spacing=0.012)
    >>> sorted(cloud.groups)
    ['inside', 'surface']
    >>> bool(abs(cloud.volumes.sum() - surface.volume) < 1e-9)
    True
    """
    spacing = number_in_range("spacing", spacing, 0.0, open_low=True, unit="m")
    seed = integer_in_range("seed", seed, 0)
    if lattice not in ("bcc", "cubic", "scattered"):
        raise InputError(f"lattice must be 'bcc', 'cubic' or 'scattered', got {brief(lattice)}")
    body = _body(surface, part, units, repair)
    for warning in (*body.warnings, *(each.what for each in body.repairs if each.name == HOLLOWED_BODY)):
        warnings.warn(warning, stacklevel=2)
    return fill_surface(body, spacing, lattice=lattice, refine=refine, seed=seed)


def _body(
    surface: Surface | str | Path | tuple[ArrayLike, ArrayLike],
    part: str | Sequence[str] | None,
    units: str | None,
    repair: bool,
) -> Surface:
    if isinstance(surface, (str, Path)):
        return read_surface(surface, part=part, units=units, repair=repair)
    if part is not None or units is not None:
        raise InputError("part and units must be omitted for a surface of arrays; arrays are in metres")
    if not isinstance(surface, Surface):
        vertices, triangles = (np.asarray(each) for each in surface)
        surface = Surface(vertices, triangles)
    return repair_surface(surface) if repair else weld(surface)
