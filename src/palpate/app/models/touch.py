"""A full body without training: a scene with a spacing for real time on this machine."""

from __future__ import annotations

from time import perf_counter

import numpy as np

from palpate.app.common.arguments import option_names
from palpate.app.common.console import Console, count_nodes
from palpate.dynamics.membrane.model import Membrane
from palpate.dynamics.solid.model import EnergySolid
from palpate.faults import CloudError, InputError
from palpate.meshfree.cloud import box
from palpate.scenes.names import SceneKind
from palpate.scenes.organ_scene import OrganScene
from palpate.scenes.surface_scene import NODES_PER_CELL
from palpate.tissue.materials import Material

TRAINED_NODES = 5000  # of the body of a trained model without a given spacing

FINER_FACTOR, MAX_FINER_TRIALS = 0.8, 4  # factor of a guessed spacing that is too coarse for the tissue; how often
STEP_PER_WAVE = 0.42  # stable step over the time of a pressure wave over a spacing: 0.35 to 0.47 on organs
STEP_OVER_FORCE = 1.6  # time of a step over that of its force evaluation
BUSY_SHARE = 0.6  # of the time, which the steps of a body in real time may take
LEAST_GAIN, MOST_GAIN = 0.9, 1.3  # speed of a body over that which it needs, within which its spacing stays
LEAST_NODES, MOST_NODES = 600, 40_000
COARSEST_SHARE = 1.1  # of the least nodes, at which a body is not made coarser
# of a ball's force against finite elements: median and largest on bodies of 3,000 nodes, pressed by half of its radius
# of 1.5 spacings or deeper (validation/elements.py)
FORCE_ERRORS = 0.077, 0.199
FINER_NODES = 6.7  # the nodes of half the spacing over those of the whole (validation/spacing_force.py)
SAMPLE_SECONDS = 0.3  # of the measurement of this machine


def open_touched(scene: OrganScene, console: Console, spacing: float | None = None) -> OrganScene:
    """Return a scene with its full body; print guesses, repairs and notes.

    Its spacing is the finest in real time on this machine, or `spacing` [m] in its place. A larger spacing of the
    scene stays, and so does any spacing that a user gives for a surface without a scene file.
    """
    given = scene.description.body.spacing
    surface = None
    if scene.description.surface.file:
        with console.status("checking the surface"):
            surface = scene.repaired_surface
    touched = _touched(scene, console, spacing)
    body, cloud = touched.body, touched.cloud
    for line in dict.fromkeys([*scene.notes, *touched.notes]):
        console.say(option_names(line))
    guessed = cloud.spacing != given
    console.say(
        f"body: {count_nodes(len(cloud))} {1e3 * cloud.spacing:.3g} mm apart"
        + (", the finest in real time on this machine" if guessed else "")
        + f", {1e3 * np.ptp(cloud.points, axis=0).max():.3g} mm long{_remedy(scene, '--spacing, --units, --scale')}"
    )
    if surface is not None:
        console.say(_force_line(len(cloud), guessed))
    material = body.material
    console.say(
        f"tissue: {type(material).__name__}, shear modulus {1e-3 * material.shear_modulus:.3g} kPa, Poisson's ratio "
        f"{material.poisson:.3g}{_remedy(scene, '--law, --set')}"
    )
    supports = " and ".join(f"{each.place.title} ({each.kind})" for each in scene.description.support)
    supported = np.unique(
        np.concatenate([cloud.group(each.group) for each in body.supports] or [np.zeros(0, dtype=int)])
    )
    console.say(
        f"support: {supports.replace(' (fixed)', '') or 'the side away from the first view'} ({len(supported)} nodes)"
        + _remedy(scene, "--fixed")
    )
    return touched


def _remedy(scene: OrganScene, options: str) -> str:
    """Return the end of a line: the option or key that changes a choice."""
    return f"; another: {scene.name}" if scene.kind is SceneKind.SCENE_FILE else f"; another: {options}"


def _touched(scene: OrganScene, console: Console, spacing: float | None) -> OrganScene:
    """Return the scene with a body in real time."""
    given = scene.description.body.spacing
    surface = scene.surface
    if surface is None:  # a box or a disc, which is small
        return _prepared(scene, console)
    if given is not None and scene.kind is not SceneKind.SCENE_FILE:
        return fitting_scene(scene, given, True, console)
    finest = spacing
    if finest is None:
        with console.status("measuring this machine"):
            finest = realtime_spacing(abs(surface.volume), scene.material)
    if given is not None and given >= finest:
        return fitting_scene(scene, given, True, console)
    return fitting_scene(scene, finest, False, console)


def fitting_scene(scene: OrganScene, spacing: float, required: bool, console: Console) -> OrganScene:
    """Return a scene with the body of a spacing [m], or of a finer one for thin tissue.

    Parameters
    ----------
    scene : OrganScene
        Of a surface.
    spacing : float [m]
    required : bool
        Whether a finer spacing is not allowed.
    """
    surface = scene.surface
    assert surface is not None
    volume = abs(surface.volume)
    for trial in range(MAX_FINER_TRIALS + 1):
        _check_count(volume, spacing)
        if spacing > surface.size:
            raise InputError(f"spacing must be at most the size of the surface, got {spacing:g} m; use a smaller one")
        try:
            return _prepared(scene.with_body(spacing=spacing), console)
        except CloudError:  # too thin for the spacing
            finer = float(f"{FINER_FACTOR * spacing:.2g}")
            if required or trial == MAX_FINER_TRIALS or _count(volume, finer) > MOST_NODES:
                raise
            spacing = finer
    raise AssertionError("the last trial returns or raises")


def _prepared(scene: OrganScene, console: Console) -> OrganScene:
    with console.status("filling the surface with nodes"):
        _ = scene.cloud
    with console.status("preparing the body (the first time on a machine compiles it)"):
        body = scene.body
    if not isinstance(body, EnergySolid | Membrane):
        raise InputError("form of [body] must be 'energy' for a body in real time, got 'strong'; change it")
    return scene


def _force_line(nodes: int, realtime: bool) -> str:
    """Return the error of the force against finite elements, and the nodes and the time at half the spacing."""
    median, largest = FORCE_ERRORS
    times = 2 * FINER_NODES  # twice the steps
    cost = f"some {1 / (BUSY_SHARE * times):.1g} of real time" if realtime else f"{times:.0f} times the time"
    return (
        f"force: that of finite elements to {median:.0%} in the median and {largest:.0%} at most, measured with balls "
        "of 1.5 spacings in radius on bodies of 3,000 nodes; half the spacing here: about "
        f"{FINER_NODES * nodes:,.0f} nodes, {cost}"
    )


def is_guessed(scene: OrganScene, touched: OrganScene) -> bool:
    """Return True if the spacing of a touched body is that of this machine, not one that a user gave."""
    return scene.surface is not None and touched.body.cloud.spacing != scene.description.body.spacing


def better_spacing(touched: OrganScene, load: float) -> float | None:
    """Return the spacing [m] of two digits with which a body keeps real time, or None if its own does.

    Parameters
    ----------
    load : float
        Computing time of the body at rest over the time that passes.
    """
    cloud = touched.body.cloud
    spacing, is_coarsest = cloud.spacing, len(cloud) <= COARSEST_SHARE * LEAST_NODES
    if LEAST_GAIN <= BUSY_SHARE / load <= MOST_GAIN or (load > BUSY_SHARE and is_coarsest):
        return None
    finest, coarsest = spacing * np.cbrt(len(cloud) / np.array([MOST_NODES, LEAST_NODES]))
    better = float(np.clip(spacing * (load / BUSY_SHARE) ** 0.25, finest, coarsest))
    rounded = float(f"{1.005 * better:.2g}")
    return rounded if rounded != spacing else None


def spacing_for(nodes: int, volume: float) -> float:
    """Return the spacing [m], of two digits, of a body of a volume [m^3] with about so many nodes."""
    return float(f"{np.cbrt(NODES_PER_CELL * volume / nodes):.2g}")


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
    """Return the time [s] of a step per node, from the faster force evaluations in some tenths of a second."""
    body = EnergySolid(box((0.1, 0.1, 0.1), 0.0083, jitter=0.2), material, "z-")
    u, work, durations = np.zeros((len(body.cloud), 3)), body.workspace(), list[float]()
    body.step_force(u, work)  # compiles
    end = perf_counter() + SAMPLE_SECONDS
    while perf_counter() < end or not durations:
        began = perf_counter()
        body.step_force(u, work)
        durations.append(perf_counter() - began)
    return STEP_OVER_FORCE * float(np.quantile(durations, 0.2)) / len(body.cloud)


def _count(volume: float, spacing: float) -> float:
    """Return the expected number of nodes."""
    return float(NODES_PER_CELL * volume / spacing**3)


def _check_count(volume: float, spacing: float) -> None:
    count = _count(volume, spacing)
    if count > MOST_NODES:
        coarser = np.cbrt(NODES_PER_CELL * volume / MOST_NODES)
        raise InputError(
            f"spacing must give at most {MOST_NODES} nodes for a full body, got {1e3 * spacing:.3g} mm (about "
            f"{count:.0f} nodes); use {1e3 * coarser:.2g} mm or more, or train a reduced model"
        )
