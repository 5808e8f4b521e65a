"""A full body to touch at once, inside a surface: tissue, support and spacing that fit."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from palpate.app.common.arguments import option_names
from palpate.app.common.console import Console, count_nodes
from palpate.app.models.touch_options import (
    PAINTED,
    TouchOptions,
    check_closed,
    held_by,
    touched_material,
)
from palpate.app.painted import read_painted
from palpate.dynamics.solid.model import EnergySolid
from palpate.faults import CloudError, InputError, number_in_range
from palpate.meshfree.attachment import painted
from palpate.meshfree.cloud import Cloud, box
from palpate.meshfree.filling import BODY, fill
from palpate.meshfree.surface_repair import repair_surface
from palpate.meshfree.surfaces import Surface
from palpate.tissue.liver import MASS_DAMPING
from palpate.tissue.materials import Material

__all__ = ["open_surface", "realtime_spacing", "support_mask"]

SUPPORT = "support"  # name of the group
MOST_HELD = 0.6  # of the nodes of a body
FINER, MAX_FINER = 0.8, 4  # factor of a guessed spacing that is too coarse for the tissue; how often
NODES_PER_CELL = 1.45  # nodes over volume / spacing^3 in a filled organ
STEP_PER_WAVE = 0.37  # stable step over the time of a pressure wave over a spacing
STEP_OVER_FORCE = 1.6  # time of a step over that of its force evaluation
BUSY_SHARE = 0.6  # of the time, which the steps of a body in real time may take
LEAST_NODES, MOST_NODES = 600, 40_000
# of the force against nodes half as far apart: median and largest of eight presses of livers of 3,000 nodes
# (validation/spacing_force.py); the nodes of half the spacing over those of the whole
FORCE_ERRORS, FINER_NODES = (0.072, 0.13), 6.7
SAMPLE_SECONDS = 0.6  # of the measurement of this machine


def open_surface(surface: Surface, options: TouchOptions, console: Console) -> EnergySolid:
    """Return the full body inside a surface (of `read_touched_surface`); print what was guessed, repaired and noted.

    Raises
    ------
    InputError
        The surface cannot be filled, or an option is out of range.
    """
    material = touched_material(options)
    with console.status("checking the surface"):
        surface = repair_surface(surface)
        report = check_closed(surface)
    model, filled = _body(surface, material, options, console)
    cloud, held_nodes = model.cloud, len(model.cloud.group(SUPPORT))
    for line in (*surface.warnings, *filled):
        console.say(f"surface: {option_names(line)}")
    for problem in report.problems:
        console.say(f"surface, {problem.kind}: {option_names(problem.what)}")
    console.say(
        f"body: {count_nodes(len(cloud))} {1e3 * cloud.spacing:.3g} mm apart"
        + (", the finest in real time on this machine" if options.spacing is None else "")
        + f", {1e3 * np.ptp(cloud.points, axis=0).max():.3g} mm long; another: --spacing, --units, --scale"
    )
    console.say(_force_line(len(cloud), options.spacing is None))
    console.say(
        f"tissue: {type(material).__name__}, shear modulus {1e-3 * material.shear_modulus:.3g} kPa, Poisson's ratio "
        f"{material.poisson:.3g}; another: --law, --set"
    )
    held = " and ".join(options.fixed) or "the side away from the first view"
    console.say(f"support: {held} ({held_nodes} nodes); another: --fixed")
    return model


def _force_line(nodes: int, realtime: bool) -> str:
    """Return what the spacing costs in the error of the force, and what half of it costs in nodes and time."""
    median, largest = FORCE_ERRORS
    times = 2 * FINER_NODES  # twice the steps
    cost = f"some {1 / (BUSY_SHARE * times):.1g} of real time" if realtime else f"{times:.0f} times the time"
    return (
        f"force: that of half the spacing to {median:.0%} in the median and {largest:.0%} at most, measured on livers "
        f"of 3,000 nodes; half the spacing here: about {FINER_NODES * nodes:,.0f} nodes, {cost}"
    )


def _body(
    surface: Surface, material: Material, options: TouchOptions, console: Console
) -> tuple[EnergySolid, list[str]]:
    """Return the body inside a surface, and what the filling warned of.

    A spacing that is not given is that of real time, or a finer one where the tissue is too thin for it.
    """
    spacing = options.spacing
    if spacing is None:
        with console.status("measuring this machine"):
            spacing = realtime_spacing(abs(surface.volume), material)
    spacing = number_in_range("spacing", spacing, 1e-5, surface.size, unit="m")
    for trial in range(MAX_FINER + 1):
        _check_count(surface, spacing)
        try:
            with console.status("filling the surface with nodes"), warnings.catch_warnings(record=True) as caught:
                warnings.simplefilter("always")
                cloud = fill(surface, spacing)
            cloud = cloud.with_group(SUPPORT, _support(cloud, options.fixed, surface.unit))
            with console.status("preparing the body (the first time on a machine compiles it)"):
                model = EnergySolid(cloud, material, SUPPORT, mass_damping=MASS_DAMPING)
        except CloudError:  # too thin for the spacing
            finer = float(f"{FINER * spacing:.2g}")
            if options.spacing is not None or trial == MAX_FINER or _count(surface, finer) > MOST_NODES:
                raise
            spacing = finer
        else:
            return model, sorted({str(each.message) for each in caught} - set(surface.warnings))
    raise AssertionError("the last trial returns or raises")


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


def _count(surface: Surface, spacing: float) -> float:
    """Return the expected number of nodes."""
    return float(NODES_PER_CELL * abs(surface.volume) / spacing**3)


def _check_count(surface: Surface, spacing: float) -> None:
    count = _count(surface, spacing)
    if count > MOST_NODES:
        coarser = np.cbrt(NODES_PER_CELL * abs(surface.volume) / MOST_NODES)
        raise InputError(
            f"spacing must give at most {MOST_NODES} nodes for a full body, got {1e3 * spacing:.3g} mm (about "
            f"{count:.0f} nodes); use {1e3 * coarser:.2g} mm or more, or train a reduced model"
        )


def _support(cloud: Cloud, fixed: Sequence[str], unit: float) -> NDArray[np.bool_]:
    """Return the nodes (n,) that texts of supports hold, checked for each of several bodies.

    The default support holds a side of each body.
    """
    names = [name for name in cloud.groups if name.startswith(f"{BODY} ")]
    bodies = [cloud.group(name) for name in names] or [np.arange(len(cloud))]
    mask = np.zeros(len(cloud), dtype=bool)
    if fixed:
        mask = support_mask(cloud, fixed, unit)
    for nodes, name in zip(bodies, names or ["it"], strict=True):
        if not fixed:
            mask[nodes] = held_by(cloud.points[nodes], "back")
        where = f" of {name} of {len(bodies)}" if names else ""
        if mask[nodes].sum() < 3:
            raise InputError(
                f"fixed must hold at least 3 nodes{where}, got {int(mask[nodes].sum())}; hold a larger part"
            )
        if mask[nodes].mean() > MOST_HELD:
            raise InputError(
                f"fixed must leave tissue free, got {mask[nodes].mean():.0%} of the nodes{where} held; hold a smaller "
                "part"
            )
    return mask


def support_mask(cloud: Cloud, fixed: Sequence[str], unit: float = 1.0) -> NDArray[np.bool_]:
    """Return the nodes (n,) that texts of supports hold; see `TouchOptions.fixed`.

    Parameters
    ----------
    cloud : Cloud
    fixed : sequence of str
    unit : float [m]
        Length of a unit of painted files.
    """
    mask = np.zeros(len(cloud), dtype=bool)
    for text in fixed:
        text = text.strip()
        is_painted = text.startswith(PAINTED)
        mask |= _painted_support(cloud, text, unit) if is_painted else held_by(cloud.points, text)
    return mask


def _painted_support(cloud: Cloud, text: str, unit: float) -> NDArray[np.bool_]:
    """Return the surface nodes nearest to painted vertices of ``painted FILE``, or ``painted FILE:FIELD``."""
    text = text.removeprefix(PAINTED).strip()
    file, colon, name = text.rpartition(":")
    if not colon or Path(text).exists():
        file, name = text, ""
    places, values = read_painted(file, name or None)
    mask = np.zeros(len(cloud), dtype=bool)
    try:
        mask[painted(cloud, unit * places, values)] = True
    except InputError as error:
        raise InputError(f"fixed must hold painted nodes, got {file!r:.60}: {error}") from error
    return mask
