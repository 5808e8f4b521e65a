"""Options of a full body to touch at once, its surface and its tissue: what is checked before work begins."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.app.common.arguments import suggestion
from palpate.arrays import Floats
from palpate.faults import InputError, number_in_range
from palpate.meshfree.formats.names import FORMATS, format_of
from palpate.meshfree.surface_checks import SurfaceReport, check_surface, shape_problems
from palpate.meshfree.surface_files import read_surface
from palpate.meshfree.surfaces import Surface
from palpate.tissue.catalogue import LAWS
from palpate.tissue.liver import DENSITY, POISSON, SHEAR_MODULUS
from palpate.tissue.materials import Material

__all__ = [
    "PAINTED", "TouchOptions", "check_closed", "check_fixed", "held_by", "is_surface_file", "read_touched_surface",
    "surface_title", "touched_material",
]  # fmt: skip

PAINTED = "painted "  # begins the text of a painted support

CAMERA_SIDE = (0.277, -0.833, 0.479)  # direction from the body to the camera of the page at its start
SUPPORT_SHARE = 0.12  # of the extent along a direction, which the default support holds
SIDES = {"x-": (0, 1), "x+": (0, -1), "y-": (1, 1), "y+": (1, -1), "z-": (2, 1), "z+": (2, -1)}


@dataclass(frozen=True)
class TouchOptions:
    """Options of a body from a surface.

    Parameters
    ----------
    units : str, optional
        Unit of the file.
    scale : float
        Factor of all lengths.
    part : sequence of str
        Names or patterns of parts of the file.
    spacing : float, optional [m]
        By default the finest that this machine steps in real time.
    law : str, optional
        Name of a law; by default neo-Hookean with the shear modulus of liver.
    parameters : mapping
        Of the law, with ``density`` and ``poisson``.
    fixed : sequence of str
        ``x-``, ``back``, ``lowest 15%``, ``near X,Y,Z,R`` [mm], or ``painted FILE`` in the unit of the
        surface, with ``:FIELD`` where the file has several; by default ``back``, of each body.
    """

    units: str | None = None
    scale: float = 1.0
    part: Sequence[str] = ()
    spacing: float | None = None
    law: str | None = None
    parameters: Mapping[str, float] | None = None
    fixed: Sequence[str] = ()


def is_surface_file(what: str) -> bool:
    """Return True for the name of a surface file by its suffix."""
    return format_of(Path(what))[0] in FORMATS


def surface_title(path: PurePath) -> str:
    """Return the name of a file without the suffixes of its format and of gzip, in words."""
    name = PurePath(path.stem).stem if format_of(path)[1] else path.stem
    words = name.replace("_", " ")
    return words[:1].upper() + words[1:]


def read_touched_surface(path: str | Path, options: TouchOptions) -> Surface:
    """Return the surface of a file; repaired where it is not closed as it is.

    Raises
    ------
    InputError, FileFormatError, FileNotFoundError
        The file cannot be read, or holds no closed surface; or an option is out of range.
    """
    chosen: Any = {"part": options.part or None, "units": options.units, "scale": options.scale}
    with contextlib.suppress(InputError):  # parts that are closed after a repair alone
        surface = read_surface(path, **chosen)
        if not any(problem.kind == "error" for problem in shape_problems(surface)):
            return surface
    surface = read_surface(path, **chosen, repair=True)
    check_closed(surface)
    return surface


def check_closed(surface: Surface) -> SurfaceReport:
    """Return the report of a surface; raise InputError if it cannot be filled."""
    report = check_surface(surface)
    if report.errors:
        raise InputError(
            f"{surface.name} must hold a closed surface, got one that is not: {report.errors[0].what}; run palpate "
            "check for pictures"
        )
    return report


def touched_material(options: TouchOptions) -> Material:
    """Return the material of the options.

    Raises
    ------
    InputError
        No such law or parameter, or a value out of range.
    """
    known = {law.name: law for law in LAWS}
    given = dict(options.parameters or {})
    name = options.law or "NeoHookean"
    if name not in known:
        raise InputError(f"law must be one of {', '.join(known)}, got {name!r:.60}{suggestion(name, list(known))}")
    parameters: dict[str, Any] = {"density": DENSITY, "poisson": POISSON} | known[name].example
    if options.law is None:
        parameters["C1"] = SHEAR_MODULUS / 2
    allowed = [parameter.name for parameter in known[name].parameters] + ["density", "poisson"]
    for key in given:
        if key not in allowed:
            raise InputError(f"set must name one of {', '.join(allowed)} for {name}, got {key!r:.60}")
    return known[name].kind(**(parameters | given))


def check_fixed(points: Floats, fixed: Sequence[str]) -> None:
    """Raise `InputError` for texts that name no support; the files of painted ones are read later."""
    for text in fixed:
        if not text.strip().startswith(PAINTED):
            held_by(points, text.strip())


def held_by(points: Floats, text: str) -> NDArray[np.bool_]:
    """Return the nodes (n,) that the text of a support holds, unless it is a painted one; see `TouchOptions.fixed`."""
    if text in SIDES:
        axis, sign = SIDES[text]
        return _far_share(sign * points[:, axis], SUPPORT_SHARE)
    if text == "back":
        return _far_share(points @ np.array(CAMERA_SIDE), SUPPORT_SHARE)
    lowest = re.fullmatch(r"lowest ([\d.]+) ?%", text)
    if lowest:
        share = number_in_range("fixed", float(lowest[1]), 0.0, 100.0, open_low=True, unit="%")
        return _far_share(points[:, 2], share / 100)
    near = re.fullmatch(r"near ([-\d.e]+),([-\d.e]+),([-\d.e]+),([\d.e]+)", text.replace(", ", ","))
    if near:
        x, y, z, radius = (1e-3 * float(each) for each in near.groups())
        return np.asarray(np.linalg.norm(points - [x, y, z], axis=1) <= radius)
    raise InputError(
        f"fixed must be {', '.join(SIDES)}, back, 'lowest 15%', 'near X,Y,Z,R' in mm or 'painted FILE', got "
        f"{text!r:.60}; use one of them"
    )


def _far_share(heights: Floats, share: float) -> NDArray[np.bool_]:
    """Return True for the nodes in the lowest share of the extent."""
    return np.asarray(heights <= heights.min() + share * np.ptp(heights))
