"""Choice of a spacing: the finest with which this machine steps a body in real time, and finer ones for thin tissue."""

from __future__ import annotations

from time import perf_counter

import numpy as np

from palpate.app.common.compile_ahead import only_compiled_code
from palpate.app.common.sample_block import sample_block, wave_time
from palpate.meshfree.cloud import Cloud
from palpate.scenes.spacing import NODES_PER_CELL, expected_nodes
from palpate.tissue.materials import Material

MIN_NODES, MAX_NODES = 600, 40_000  # of a full body in real time
STEP_PER_WAVE = 0.42  # stable step over the time of a pressure wave over a spacing: 0.35 to 0.47 on organs
STEP_OVER_FORCE = 1.6  # time of a step over that of its force evaluation
BUSY_SHARE = 0.6  # of the time, which the steps of a body in real time may take
SAMPLE_SECONDS = 0.3  # of the measurement of this machine
GUESSED_SECONDS = 1e-7  # of a force evaluation per node, until it is compiled
MIN_GAIN, MAX_GAIN = 0.9, 1.3  # speed of a body over that which it needs, within which its spacing stays
COARSEST_SHARE = 1.1  # of the least nodes, at which a body is not made coarser
FINER_FACTOR, MAX_FINER_TRIALS = 0.8, 4  # factor of a guessed spacing that is too coarse for the tissue; how often
FINER_NODES = 6.7  # the nodes of half the spacing over those of the whole (validation/spacing_force.py)


def realtime_spacing(volume: float, material: Material) -> float:
    """Return the finest spacing [m] of a body of a volume [m^3] that this machine steps in real time.

    The cost of a step is measured on a small block for some tenths of a second; it is guessed where that would compile
    what a second process compiles meanwhile. The body is filled again if its own steps take another time.
    """
    seconds = _seconds_per_node(material)

    def busy(spacing: float) -> float:
        step = STEP_PER_WAVE * wave_time(material, spacing)
        return float(expected_nodes(volume, spacing) * seconds / step)

    coarse, fine = np.cbrt(NODES_PER_CELL * volume / np.array([MIN_NODES, MAX_NODES]))
    for _ in range(40):
        middle = np.sqrt(coarse * fine)
        coarse, fine = (middle, fine) if busy(middle) <= BUSY_SHARE else (coarse, middle)
    return float(f"{1.005 * coarse:.2g}")


def better_spacing(cloud: Cloud, load: float) -> float | None:
    """Return the spacing [m] of two digits with which the body of a cloud keeps real time, or None if its own does.

    `load` is the computing time of the body at rest over the time that passes.
    """
    spacing, is_coarsest = cloud.spacing, len(cloud) <= COARSEST_SHARE * MIN_NODES
    if MIN_GAIN <= BUSY_SHARE / load <= MAX_GAIN or (load > BUSY_SHARE and is_coarsest):
        return None
    finest, coarsest = spacing * np.cbrt(len(cloud) / np.array([MAX_NODES, MIN_NODES]))
    better = float(np.clip(spacing * (load / BUSY_SHARE) ** 0.25, finest, coarsest))
    rounded = float(f"{1.005 * better:.2g}")
    return rounded if rounded != spacing else None


def _seconds_per_node(material: Material) -> float:
    """Return the time [s] of a step per node, from the faster force evaluations in some tenths of a second."""
    durations = list[float]()
    with only_compiled_code():
        body = sample_block(material)
        u, work = np.zeros((len(body.cloud), 3)), body.workspace()
        body.step_force(u, work)  # loads the code
        end = perf_counter() + SAMPLE_SECONDS
        while perf_counter() < end or not durations:
            began = perf_counter()
            body.step_force(u, work)
            durations.append((perf_counter() - began) / len(body.cloud))
    return STEP_OVER_FORCE * (float(np.quantile(durations, 0.2)) if durations else GUESSED_SECONDS)
