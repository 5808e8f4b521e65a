"""Bodies of a comparison: model, small and large load, and nonlinear reduced model."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from palpate.arrays import Floats
from palpate.dynamics.loads.prepared import Load
from palpate.dynamics.loads.prescribed_motion import PrescribedMotion
from palpate.dynamics.loads.surface_force import SurfaceForce
from palpate.dynamics.run.model import Model
from palpate.dynamics.run.trajectory import Trajectory
from palpate.dynamics.solid.model import Solid
from palpate.faults import InputError, number_in_range
from palpate.reduction.galerkin.model import galerkin
from palpate.reduction.training.reduce import hyper_reduce
from palpate.scenes.beam import beam, pull
from palpate.scenes.open_scene import open_scene

__all__ = ["BODIES", "ComparedBody", "compared_beam", "compared_liver"]


SMALL_PULL, LARGE_PULL = 0.1, 100.0  # [N] of the beam; the large one is the paper's
SMALL_WAY, LARGE_WAY = 2e-4, 0.02  # [m] of the liver's tool; the large one is the training's deepest press
MIN_TOOL_DISTANCE = 0.02  # [m] least distance of the liver's tool from its fixed back
TOOL_GROUP = "tool"
TOOL_SECONDS = 0.6  # [s] of the liver's tool, out and back
GRIP_SPACINGS = 2.0  # [spacings] radius of the nodes that the tool holds


@dataclass(frozen=True)
class ComparedBody:
    """A body of a comparison.

    Parameters
    ----------
    title : str
    model : Solid
    loads : function
        Of a size, the loads of a run.
    small, large : float
        Sizes.
    unit : str
        Of the sizes.
    outputs : tuple of str
        As of `palpate.lti.linearise`.
    duration, every : float [s]
    nonlinear : function
        Returns the nonlinear reduced model of a run with the large load and a number of modes; and its name.
    nonlinear_name : str
    """

    title: str
    model: Solid
    loads: Callable[[float], tuple[Load, ...]]
    small: float
    large: float
    unit: str
    outputs: tuple[str, ...]
    duration: float
    every: float
    nonlinear: Callable[[Trajectory, int], Model]
    nonlinear_name: str


def compared_beam(spacing: float = 0.005, poisson: float = 0.49) -> ComparedBody:
    """Return the paper's beam, pulled by up to 0.1 N and up to 100 N."""
    scene = beam(spacing=spacing, poisson=poisson)
    model = scene.model
    assert isinstance(model, Solid)

    def loads(size: float) -> tuple[Load, ...]:
        return (SurfaceForce("x+", force=lambda time: (pull(time, size), 0.0, 0.0)),)

    return ComparedBody(
        f"The paper's beam, {1e3 * spacing:g} mm", model, loads, SMALL_PULL, LARGE_PULL, "N", ("x+",),
        scene.duration, scene.every, lambda run, modes: galerkin(model, run, modes=modes), "POD of the nonlinear run",
    )  # fmt: skip


def compared_liver(spacing: float = 0.012, poisson: float = 0.45) -> ComparedBody:
    """Return the generated liver, a place of its front pulled by a tool by up to 0.2 mm and up to 20 mm."""
    spacing = number_in_range("spacing", spacing, 0.006, 0.012, unit="m")
    bare = open_scene("liver", {"spacing": spacing, "poisson": poisson}).body
    assert isinstance(bare, Solid)
    cloud = bare.cloud
    surface = np.unique(cloud.face_nodes)
    back = cloud.points[cloud.group("back"), 1].min()
    reachable = surface[cloud.points[surface, 1] < back - MIN_TOOL_DISTANCE]
    if not len(reachable):
        raise InputError(
            f"spacing must leave nodes at least {MIN_TOOL_DISTANCE} m from the back of the liver, got {spacing!r}; "
            "use a smaller one"
        )
    at = reachable[np.argmin(cloud.points[reachable, 1])]
    near = surface[np.linalg.norm(cloud.points[surface] - cloud.points[at], axis=1) <= GRIP_SPACINGS * spacing]
    model = Solid(
        cloud.with_group(TOOL_GROUP, near),
        bare.material,
        "back",
        form="energy",
        stiffness_damping=bare.stiffness_damping,
    )
    normals = np.zeros_like(cloud.points)
    normals[cloud.face_nodes] = cloud.face_normals
    along = normals[near].mean(axis=0) / np.linalg.norm(normals[near].mean(axis=0))

    def loads(size: float) -> tuple[Load, ...]:
        def pulled(points: Floats, time: float) -> Floats:
            return np.asarray(size * np.sin(np.pi * min(time, TOOL_SECONDS) / TOOL_SECONDS) ** 2 * along)

        return (PrescribedMotion(TOOL_GROUP, pulled),)

    return ComparedBody(
        f"A liver pulled at its front, {1e3 * spacing:g} mm", model, loads, SMALL_WAY, LARGE_WAY, "m", (),
        TOOL_SECONDS, 0.01, lambda run, modes: hyper_reduce(model, run, modes=modes, prescribed=TOOL_GROUP),
        "POD of that run, hyper-reduced",
    )  # fmt: skip


BODIES: dict[str, Callable[..., ComparedBody]] = {"beam": compared_beam, "liver": compared_liver}
