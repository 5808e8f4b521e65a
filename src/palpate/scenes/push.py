"""Training scene of a taut membrane whose centre a tool moves at random."""

from __future__ import annotations

import numpy as np

from palpate.arrays import Floats
from palpate.dynamics.loads.prepared import Load
from palpate.dynamics.loads.prescribed_motion import PrescribedMotion
from palpate.dynamics.membrane.model import Membrane
from palpate.faults import number_in_range
from palpate.meshfree.sheets import disc
from palpate.scenes.membrane import MIN_SPACING, RADIUS, THICKNESS
from palpate.scenes.scene import MAX_FRAMES, TrainingScene
from palpate.tissue.materials import NeoHookean

__all__ = ["GROUP", "pushed_membrane"]


GROUP = "tool"  # nodes that the tool moves
MAX_SPACING, TOOL_RADIUS, PRESTRETCH = (
    0.01,
    0.02,
    1.05,
)  # [m], [m] radius of the tool's group, prestretch of the sheet
MAX_TANGENTIAL, MAX_DEPTH = 0.004, 0.02  # [m] largest displacements of one swing, in the sheet's plane and across it
SWINGS = 3  # in a motion


def pushed_membrane(
    spacing: float = MAX_SPACING, prestretch: float = PRESTRETCH, lasting: float = 0.4, every: float = 0.005
) -> TrainingScene:
    """Return the paper's membrane, taut, with a tool that pushes its centre along random smooth paths, out and back.

    Parameters
    ----------
    spacing : float [m]
        Distance between nodes, from 1 mm to 10 mm.
    prestretch : float
        From 1.01 to 1.5: a slack sheet wrinkles, and few modes do not represent wrinkles.
    lasting : float [s]
        Duration of a path, at most 10.
    every : float [s]
        Time between snapshots, of which a path has at most 10,000.

    Raises
    ------
    InputError
        A parameter out of range; the message names it.
    """
    spacing = number_in_range("spacing", spacing, MIN_SPACING, MAX_SPACING, unit="m")
    prestretch = number_in_range("prestretch", prestretch, 1.01, 1.5)
    lasting = number_in_range("lasting", lasting, 0.0, 10.0, open_low=True, unit="s")
    every = number_in_range("every", every, lasting / MAX_FRAMES, lasting, unit="s")
    cloud = disc(RADIUS, spacing).within(GROUP, (0.0, 0.0), TOOL_RADIUS)
    material = NeoHookean(C1=0.17e6, density=1200.0, poisson=0.5)
    model = Membrane(cloud, material, THICKNESS, "rim", prestretch=prestretch)

    def path(seed: int) -> tuple[tuple[Load, ...], float]:
        sizes = np.random.default_rng(seed).uniform(-1.0, 1.0, size=(SWINGS, 3)) * (
            MAX_TANGENTIAL,
            MAX_TANGENTIAL,
            MAX_DEPTH,
        )

        def moved(points: Floats, time: float) -> Floats:
            shares = np.sin(np.pi * np.arange(1, SWINGS + 1) * time / lasting) ** 2
            return np.asarray(shares @ sizes)

        return (PrescribedMotion(GROUP, moved),), lasting

    parameters = {"spacing": spacing, "prestretch": prestretch, "lasting": lasting, "every": every}
    return TrainingScene(model, path, every, "Membrane pushed at its middle", parameters, (GROUP,))
