"""A soft beam pulled along its axis (section 6.1, Figures 2 to 5).

Its numbers stand in ``data/beam.toml``, the scene that a view and a training open. The paper's run has another form of
the equations, and other defaults.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from palpate.core.faults import number_in_range
from palpate.dynamics.loads.surface_force import SurfaceForce
from palpate.dynamics.solid.model import Solid
from palpate.meshfree.cloud import box
from palpate.scenes.load_case import LoadCase
from palpate.scenes.open_scene import open_scene

BEAM_SCENE = open_scene("beam")
BEAM_SIZE = BEAM_SCENE.description.surface.size  # [m]
DURATION, EVERY = BEAM_SCENE.duration, BEAM_SCENE.every  # [s]
MIN_SPACING, MAX_SPACING = 0.0005, BEAM_SIZE[1] / 3  # [m] 670,000 nodes; 4 nodes across
MAX_LOAD = 1000.0  # [N] ten times the paper's


def pull(time: float, load: float = 100.0) -> float:
    """Return the force [N] of equation (33) at a time [s]: up to `load` [N] at half the run, and back to zero."""
    (force,) = BEAM_SCENE.description.load
    return load * float(np.interp(time, force.times, force.factors))


def beam(spacing: float = 0.005, load: float = 100.0, poisson: float = 0.49, form: str = "strong") -> LoadCase:
    """Return the paper's beam: 200 mm by 20 mm by 20 mm, one end fixed, the other pulled along the axis.

    Mooney-Rivlin with C1 = 60 kPa and C2 = 1.2 kPa, density 1120 kg/m^3. The pull is spread over the face ``"x+"``; it
    rises linearly to `load` at 0.5 s and falls back to zero at 1 s (33). A snapshot is kept every 0.01 s.

    The spacing is from 0.5 mm to a third of the thickness. The largest force `load` is in (0, 1000] N; the paper's is
    100 N. Poisson's ratio at rest is in [0, 0.499]; the paper does not state it. The paper's `form`, as that of
    `palpate.Solid`, is ``"strong"``.
    """
    spacing = number_in_range("spacing", spacing, MIN_SPACING, MAX_SPACING, unit="m")
    load = number_in_range("load", load, 0.0, MAX_LOAD, open_low=True, unit="N")
    material = replace(BEAM_SCENE.material, poisson=poisson, bulk=None)
    model = Solid(box(BEAM_SIZE, spacing=spacing), material, form=form, fixed="x-")
    traction = SurfaceForce("x+", force=lambda time: (pull(time, load), 0.0, 0.0))
    parameters = {"spacing": spacing, "load": load, "poisson": float(poisson)}
    return LoadCase(model, (traction,), DURATION, EVERY, f"Beam under traction, {load:g} N", parameters)
