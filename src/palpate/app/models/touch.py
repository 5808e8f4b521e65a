"""A full body to touch at once, from the file of a surface: tissue, support and spacing that fit."""

from __future__ import annotations

import re
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.app.common.arguments import suggestion
from palpate.app.common.console import Console, count_nodes
from palpate.arrays import Floats
from palpate.dynamics.solid.model import EnergySolid
from palpate.faults import InputError, number_in_range
from palpate.meshfree.cloud import box
from palpate.meshfree.filling import fill
from palpate.meshfree.surface_checks import check_surface
from palpate.meshfree.surface_files import READERS, read_surface
from palpate.meshfree.surfaces import Surface
from palpate.scenes.liver import DENSITY, MASS_DAMPING, SHEAR_MODULUS
from palpate.tissue.catalogue import LAWS
from palpate.tissue.materials import Material

__all__ = ["TouchOptions", "is_surface_file", "open_surface"]

POISSON = 0.45
CAMERA_SIDE = (0.277, -0.833, 0.479)  # direction from the body to the camera of the page at its start
SUPPORT_SHARE = 0.12  # of the extent along a direction, which the default support holds
SUPPORT = "support"  # name of the group
NODES_PER_CELL = 1.45  # nodes over volume / spacing^3 in a filled organ
STEP_PER_WAVE = 0.37  # stable step over the time of a pressure wave over a spacing
STEP_OVER_FORCE = 1.6  # time of a step over that of its force evaluation
BUSY_SHARE = 0.6  # of the time, which the steps of a body in real time may take
LEAST_NODES, MOST_NODES = 600, 40_000
SAMPLE_SECONDS = 0.6  # of the measurement of this machine
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
    part : str, optional
        Part of the file.
    spacing : float, optional [m]
        By default the finest that this machine steps in real time.
    law : str, optional
        Name of a law; by default neo-Hookean with the shear modulus of liver.
    parameters : mapping
        Of the law, with ``density`` and ``poisson``.
    fixed : sequence of str
        ``x-``, ``back``, ``lowest 15%`` or ``near X,Y,Z,R`` [mm]; by default ``back``.
    """

    units: str | None = None
    scale: float = 1.0
    part: str | None = None
    spacing: float | None = None
    law: str | None = None
    parameters: Mapping[str, float] | None = None
    fixed: Sequence[str] = ()


def is_surface_file(what: str) -> bool:
    """Return True for the name of a surface file by its suffix."""
    return Path(what).suffix[1:].lower() in READERS


def open_surface(path: str | Path, options: TouchOptions, console: Console) -> tuple[EnergySolid, str]:
    """Return the full body inside a surface and its title; print what was guessed.

    Raises
    ------
    InputError, FileFormatError, FileNotFoundError
        The file cannot be read or filled, or an option is out of range.
    """
    surface = _read(path, options)
    material = _material(options)
    spacing = options.spacing
    guessed = spacing is None
    if spacing is None:
        with console.status("measuring this machine"):
            spacing = realtime_spacing(abs(surface.volume), material)
    spacing = number_in_range("spacing", spacing, 1e-5, surface.size, unit="m")
    _check_count(surface, spacing)
    with console.status("filling the surface with nodes"), warnings.catch_warnings(action="ignore"):
        cloud = fill(surface, spacing)  # whose warnings are those of the surface, printed below
    mask = support_mask(cloud.points, options.fixed)
    _check_support(mask)
    cloud = cloud.with_group(SUPPORT, mask)
    with console.status("preparing the body (the first time on a machine compiles it)"):
        model = EnergySolid(cloud, material, SUPPORT, mass_damping=MASS_DAMPING)
    held = " and ".join(options.fixed) or "the side away from the first view"
    for line in surface.warnings:
        console.say(f"surface: {line.replace('give units=', '--units')}")
    console.say(
        f"body: {count_nodes(len(cloud))} {1e3 * spacing:.3g} mm apart"
        + (", the finest in real time on this machine" if guessed else "")
        + f", {1e3 * np.ptp(cloud.points, axis=0).max():.3g} mm long; another: --spacing, --units, --scale"
    )
    console.say(
        f"tissue: {type(material).__name__}, shear modulus {1e-3 * material.shear_modulus:.3g} kPa, Poisson's ratio "
        f"{material.poisson:.3g}; another: --law, --set"
    )
    console.say(f"support: {held} ({int(mask.sum())} nodes); another: --fixed")
    return model, Path(path).stem.replace("_", " ").capitalize()


def _read(path: str | Path, options: TouchOptions) -> Surface:
    scale = number_in_range("scale", options.scale, 1e-6, 1e6, open_low=True)
    surface = read_surface(path, part=options.part, units=options.units, repair=True)
    surface = Surface(scale * surface.vertices, surface.triangles, surface.name, surface.warnings)
    errors = check_surface(surface).errors
    if errors:
        raise InputError(
            f"{path} must hold a closed surface, got one that is not: {errors[0].what}; run palpate check for pictures"
        )
    return surface


def _material(options: TouchOptions) -> Material:
    """Return the material of the options."""
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


def realtime_spacing(volume: float, material: Material) -> float:
    """Return the finest spacing [m] of a body of a volume [m^3] that this machine steps in real time.

    The cost of a step is measured on a small block for some tenths of a second.
    """
    seconds = _seconds_per_node(material)
    wave_speed = np.sqrt((material.lame + 2 * material.shear_modulus) / material.density)

    def busy(spacing: float) -> float:
        nodes, step = NODES_PER_CELL * volume / spacing**3, STEP_PER_WAVE * spacing / wave_speed
        return float(nodes * seconds / step)

    coarse, fine = np.cbrt(NODES_PER_CELL * volume / np.array([LEAST_NODES, MOST_NODES]))
    for _ in range(40):
        middle = np.sqrt(coarse * fine)
        coarse, fine = (middle, fine) if busy(middle) <= BUSY_SHARE else (coarse, middle)
    return float(f"{1.005 * coarse:.2g}")


def _seconds_per_node(material: Material) -> float:
    """Return the time [s] of a step per node, from the median of force evaluations in some tenths of a second."""
    body = EnergySolid(box((0.1, 0.1, 0.1), 0.0083, jitter=0.2), material, "z-")
    u, work, durations = np.zeros((len(body.cloud), 3)), body.workspace(), list[float]()
    body.force(u, work=work)  # compiles
    end = perf_counter() + SAMPLE_SECONDS
    while perf_counter() < end or not durations:
        began = perf_counter()
        body.force(u, work=work)
        durations.append(perf_counter() - began)
    return STEP_OVER_FORCE * float(np.median(durations)) / len(body.cloud)


def _check_count(surface: Surface, spacing: float) -> None:
    count = NODES_PER_CELL * abs(surface.volume) / spacing**3
    if count > MOST_NODES:
        coarser = np.cbrt(NODES_PER_CELL * abs(surface.volume) / MOST_NODES)
        raise InputError(
            f"spacing must give at most {MOST_NODES} nodes for a full body, got {1e3 * spacing:.3g} mm (about "
            f"{count:.0f} nodes); use {1e3 * coarser:.2g} mm or more, or train a reduced model"
        )


def support_mask(points: Floats, fixed: Sequence[str]) -> NDArray[np.bool_]:
    """Return the nodes (n,) that texts of supports hold; see `TouchOptions.fixed`."""
    mask = np.zeros(len(points), dtype=bool)
    for text in fixed or ("back",):
        mask |= _one_support(points, text.strip())
    return mask


def _one_support(points: Floats, text: str) -> NDArray[np.bool_]:
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
        f"fixed must be {', '.join(SIDES)}, back, 'lowest 15%' or 'near X,Y,Z,R' in mm, got {text!r:.60}; "
        "use one of them"
    )


def _far_share(heights: Floats, share: float) -> NDArray[np.bool_]:
    """Return True for the nodes in the lowest share of the extent."""
    return np.asarray(heights <= heights.min() + share * np.ptp(heights))


def _check_support(mask: NDArray[np.bool_]) -> None:
    if mask.sum() < 3:
        raise InputError(f"fixed must hold at least 3 nodes, got {int(mask.sum())}; hold a larger part")
    if mask.mean() > 0.6:
        raise InputError(f"fixed must leave tissue free, got {mask.mean():.0%} of the nodes held; hold a smaller part")
