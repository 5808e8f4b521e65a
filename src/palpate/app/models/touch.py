"""A full body to touch at once, from the file of a surface: tissue, support and spacing that fit."""

from __future__ import annotations

import warnings
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from palpate.app.common.console import Console, count_nodes
from palpate.app.models.touch_options import TouchOptions, check_closed, support_mask, touched_material
from palpate.dynamics.solid.model import EnergySolid
from palpate.faults import InputError, number_in_range
from palpate.meshfree.cloud import box
from palpate.meshfree.filling import fill
from palpate.meshfree.surface_repair import repair_surface
from palpate.meshfree.surfaces import Surface
from palpate.tissue.liver import MASS_DAMPING
from palpate.tissue.materials import Material

__all__ = ["open_surface"]

SUPPORT = "support"  # name of the group
NODES_PER_CELL = 1.45  # nodes over volume / spacing^3 in a filled organ
STEP_PER_WAVE = 0.37  # stable step over the time of a pressure wave over a spacing
STEP_OVER_FORCE = 1.6  # time of a step over that of its force evaluation
BUSY_SHARE = 0.6  # of the time, which the steps of a body in real time may take
LEAST_NODES, MOST_NODES = 600, 40_000
SAMPLE_SECONDS = 0.6  # of the measurement of this machine


def open_surface(surface: Surface, options: TouchOptions, console: Console) -> EnergySolid:
    """Return the full body inside a surface (of `read_touched_surface`); print what was guessed.

    Raises
    ------
    InputError
        The surface cannot be filled, or an option is out of range.
    """
    material = touched_material(options)
    with console.status("checking the surface"):
        surface = repair_surface(surface)
        check_closed(surface)
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
    return model


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


def _check_support(mask: NDArray[np.bool_]) -> None:
    if mask.sum() < 3:
        raise InputError(f"fixed must hold at least 3 nodes, got {int(mask.sum())}; hold a larger part")
    if mask.mean() > 0.6:
        raise InputError(f"fixed must leave tissue free, got {mask.mean():.0%} of the nodes held; hold a smaller part")
