"""One model of every kind, as small as it can be, with the loads that it is run under."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np

import palpate as pt

SPACING = 0.005
SOFT = pt.materials.MooneyRivlin(C1=20e3, C2=0.0, density=1000.0, poisson=0.4)
RELAXING = replace(SOFT, prony=pt.materials.Prony(shares=(0.5,), times=(0.01,), bulk_shares=(0.2,)))
FIBRES = pt.materials.Fibres(k1=20e3, k2=3.0, directions=(1.0, 0.0, 0.0))
EVERY, FRAMES, MODES = 0.01, 6, 4  # long steps, so that stability limits them
DURATION = EVERY * FRAMES
BALL = 0.015
ALPHA = 40.0  # [1/s] mass damping that takes part of the work in the short runs


def wave(time: float) -> float:
    """Return a smooth push that begins at 0."""
    return float(np.sin(150.0 * time) ** 2)


@cache
def block() -> pt.Cloud:
    """Return a block of 5 x 4 x 4 nodes."""
    return pt.box((0.02, 0.015, 0.015), spacing=SPACING)


@cache
def sheet() -> pt.Cloud:
    """Return a square sheet, 40 mm wide, with its centre as the group ``"tool"``."""
    corners = 0.02 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    cloud = pt.sheet(corners, 2 * SPACING)
    middle = np.array([np.argmin(np.linalg.norm(cloud.points, axis=1))])
    return replace(cloud, groups={**cloud.groups, "tool": middle})


def pull(size: float = 0.05) -> pt.SurfaceForce:
    """Return a force on the free end of the block [N]."""
    return pt.SurfaceForce("x+", force=lambda t: size * wave(t) * np.array([1.0, 0.5, 0.2]))


def lift(size: float = 1e-3, group: str = "x+") -> pt.PrescribedMotion:
    """Return a motion of a group [m]."""
    return pt.PrescribedMotion(group, lambda points, t: size * wave(t) * np.array([0.3, 0.0, 1.0]))


def press(depth: float = 1e-3, friction: float = 0.0, side: str = "z") -> pt.tools.Contact:
    """Return a ball that presses a face of the block, by default the upper one."""
    away = np.eye(3)["xyz".index(side)]
    start = np.array([0.012, 0.0075, 0.0075]) + (0.0075 + BALL + 1e-4) * away
    return pt.tools.Contact(pt.tools.Sphere(BALL), lambda t: start - depth * wave(0.4 * t) * away, friction=friction)


def lean(size: float = 0.1) -> pt.SurfaceForce:
    """Return a force across the sheet [N]."""
    return pt.SurfaceForce("face", force=lambda t: size * wave(t) * np.array([0.1, 0.0, 1.0]))


def run(model: Any, loads: Sequence[Any], **options: Any) -> pt.Trajectory:
    """Run a model for a short time."""
    return pt.rollout(model, loads, **{"duration": DURATION, "every": EVERY, "progress": False} | options)


@cache
def solid(form: str, material: pt.materials.Material = SOFT, fibres: Any = None, alpha: float = 0.0) -> pt.Solid:
    """Return a full model of the block, clamped at one end."""
    damping = {"stiffness_damping": 6e-5, "mass_damping": alpha}
    return pt.Solid(block(), material, "x-", form=form, fibres=fibres, **damping)


@cache
def sliding(form: str) -> pt.Solid:
    """Return a full model of the block on three rollers, two of them oblique to its faces."""
    normals = {"x-": (0.8, 0.6, 0.0), "y-": (-0.6, 0.8, 0.0), "z-": None}
    fixed = [pt.Roller(group, normal) for group, normal in normals.items()]
    return pt.Solid(block(), SOFT, fixed, form=form, stiffness_damping=6e-5)


@cache
def sliding_galerkin() -> pt.GalerkinModel:
    """Return the paper's reduction of the block on rollers."""
    full = sliding("strong")
    return pt.galerkin(full, run(full, [pull()]), modes=MODES)


@cache
def sliding_hyper() -> pt.ReducedModel:
    """Return a hyper-reduced block on rollers."""
    full = sliding("energy")
    return pt.hyper_reduce(full, run(full, [pull()]), modes=MODES)


@cache
def sliding_linear() -> pt.lti.LinearModel:
    """Return a linear model of the block on rollers."""
    return pt.lti.reduce_linear(pt.lti.linearise(sliding("energy"), (pull(),), ["x+"]), "modal", MODES)


@cache
def mirrored() -> pt.Solid:
    """Return a full model of the block as a quarter of a larger one, clamped at one end."""
    fixed = ["x-", pt.SymmetryPlane("y-"), pt.SymmetryPlane("z-")]
    return pt.Solid(block(), SOFT, fixed, stiffness_damping=6e-5)


@cache
def mirrored_galerkin() -> pt.GalerkinModel:
    """Return the paper's reduction of the quarter."""
    full = mirrored()
    return pt.galerkin(full, run(full, [pull()]), modes=MODES)


@cache
def mirrored_hyper() -> pt.ReducedModel:
    """Return a hyper-reduced quarter."""
    full = mirrored()
    return pt.hyper_reduce(full, run(full, [pull()]), modes=MODES)


@cache
def mirrored_linear() -> pt.lti.LinearModel:
    """Return a linear model of the quarter."""
    return pt.lti.reduce_linear(pt.lti.linearise(mirrored(), (pull(),), ["x+", "y-"]), "modal", MODES)


@cache
def sliding_sheet() -> pt.Membrane:
    """Return a quarter of a stretched sheet: rollers along two edges, the others clamped."""
    law = pt.materials.NeoHookean(C1=10e3, density=1000.0, poisson=0.5)
    corners = 0.02 * np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    cloud = pt.sheet(corners, SPACING)
    x, y = cloud.points.T
    groups = {
        "left": np.flatnonzero(x < 1e-6), "lower": np.flatnonzero(y < 1e-6),
        "outer": np.flatnonzero((x > 0.02 - 1e-6) | (y > 0.02 - 1e-6)),
    }  # fmt: skip
    cloud = replace(cloud, groups={**cloud.groups, **groups})
    fixed = ["outer", pt.Roller("left", (1, 0, 0)), pt.Roller("lower", (0, 1, 0))]
    return pt.Membrane(cloud, law, 1e-3, fixed, prestretch=1.1, stiffness_damping=1e-5)


@cache
def membrane() -> pt.Membrane:
    """Return a stretched sheet, clamped at its rim."""
    law = pt.materials.NeoHookean(C1=10e3, density=1000.0, poisson=0.5)
    return pt.Membrane(sheet(), law, 1e-3, "rim", prestretch=1.1, stiffness_damping=1e-5)


@cache
def fibrous() -> pt.Solid:
    """Return the block with fibres along it."""
    return solid("energy", fibres=FIBRES)


@cache
def galerkin() -> pt.GalerkinModel:
    """Return the paper's reduction of the strong form."""
    full = solid("strong")
    return pt.galerkin(full, run(full, [pull()]), modes=MODES)


@cache
def galerkin_with_tool(alpha: float = 0.0) -> pt.GalerkinModel:
    """Return the same of the energy form, with a face that a tool moves."""
    full = solid("energy", alpha=alpha)
    return pt.galerkin(full, run(full, [lift()]), modes=MODES, prescribed="x+")


@cache
def hyper(material: pt.materials.Material = SOFT, fibres: Any = None) -> pt.ReducedModel:
    """Return a hyper-reduced block."""
    full = solid("energy", material, fibres)
    return pt.hyper_reduce(full, run(full, [pull()]), modes=MODES)


@cache
def hyper_with_tool(alpha: float = 0.0) -> pt.ReducedModel:
    """Return a hyper-reduced block with a face that a tool moves."""
    full = solid("energy", alpha=alpha)
    return pt.hyper_reduce(full, run(full, [lift()]), modes=MODES, prescribed="x+")


@cache
def hyper_touched(alpha: float = 0.0) -> pt.ReducedModel:
    """Return a hyper-reduced block that was trained with a ball."""
    full = solid("energy", alpha=alpha)
    return pt.hyper_reduce(full, run(full, [press()]), modes=0, enrichment=pt.vibration_modes(full, 8)[0])


@cache
def hyper_sheet() -> pt.ReducedModel:
    """Return a hyper-reduced membrane."""
    full = membrane()
    return pt.hyper_reduce(full, run(full, [lean()]), modes=MODES)


@cache
def system(*loads: Any, alpha: float = 0.0) -> pt.lti.LinearSystem:
    """Return the block linearised at rest, with a force as its input by default."""
    return pt.lti.linearise(solid("energy", alpha=alpha), loads or (pull(),), ["x+"])


@cache
def linear() -> pt.lti.LinearModel:
    """Return a linear model of the block's slowest modes."""
    return pt.lti.reduce_linear(system(), "modal", MODES)


@cache
def linear_with_tool() -> pt.lti.LinearModel:
    """Return a linear model with a face that a tool moves."""
    return pt.lti.reduce_linear(system(lift(1e-5)), "modal", MODES)


@cache
def linear_mass_damped() -> pt.lti.LinearModel:
    """Return a linear model that balances the inertia of a tool's motion."""
    return pt.lti.reduce_linear(system(lift(1e-5), alpha=ALPHA), "moments", 3 * MODES)


@dataclass(frozen=True)
class Kind:
    """A kind of model: how one is made, and loads that move it."""

    make: Callable[[], Any]
    loads: Callable[[], list[Any]]
    balance: float  # of the largest external work: what the energy balance may miss
    momentum: float = 0.02  # of the impulse of all forces: what the balance of momentum may miss
    lost: float = 1e-4  # of the dissipated energy: what errors of the steps may give back
    still: float = 1e-9  # of what the loads do: what may move without any, by rounding


KINDS = {
    "solid, strong": Kind(lambda: solid("strong"), lambda: [pull()], 0.06),
    "solid, energy": Kind(lambda: solid("energy"), lambda: [pull()], 0.01),
    "solid, relaxing": Kind(lambda: solid("energy", RELAXING), lambda: [pull()], 0.01),
    "solid, fibres": Kind(fibrous, lambda: [pull()], 0.01),
    "solid, touched": Kind(lambda: solid("energy"), lambda: [press(friction=0.3)], 0.01),
    "solid, tool": Kind(lambda: solid("energy"), lambda: [lift()], 0.03),
    "solid, rollers": Kind(lambda: sliding("energy"), lambda: [pull()], 0.01),
    "solid, strong, rollers": Kind(lambda: sliding("strong"), lambda: [pull()], 0.15),
    "solid, touched, rollers": Kind(lambda: sliding("energy"), lambda: [press(friction=0.3)], 0.01),
    "membrane, rollers": Kind(sliding_sheet, lambda: [lean()], 0.01, still=1e-6),
    "Galerkin, rollers": Kind(sliding_galerkin, lambda: [pull()], 0.08),
    "hyper-reduced, rollers": Kind(sliding_hyper, lambda: [pull()], 0.01),
    "linear, rollers": Kind(sliding_linear, lambda: [pull()], 0.005),
    "solid, mirrored": Kind(mirrored, lambda: [pull()], 0.01),
    "Galerkin, mirrored": Kind(mirrored_galerkin, lambda: [pull()], 0.01),
    "hyper-reduced, mirrored": Kind(mirrored_hyper, lambda: [pull()], 0.01),
    "linear, mirrored": Kind(mirrored_linear, lambda: [pull()], 0.005),
    "membrane": Kind(membrane, lambda: [lean()], 0.01, still=1e-6),
    "Galerkin": Kind(galerkin, lambda: [pull()], 0.08),
    "Galerkin, tool": Kind(galerkin_with_tool, lambda: [lift()], 0.1),
    "hyper-reduced": Kind(hyper, lambda: [pull()], 0.01),
    "hyper-reduced, implicit": Kind(lambda: hyper().with_step(EVERY / 8), lambda: [pull()], 0.0001),
    "hyper-reduced, tool": Kind(hyper_with_tool, lambda: [lift()], 0.1),
    "hyper-reduced, relaxing": Kind(lambda: hyper(RELAXING), lambda: [pull()], 0.01),
    "hyper-reduced, fibres": Kind(lambda: hyper(SOFT, FIBRES), lambda: [pull()], 0.01),
    "hyper-reduced, touched": Kind(hyper_touched, lambda: [press()], 0.05),
    "hyper-reduced membrane": Kind(
        hyper_sheet, lambda: [lean()], 0.01, still=3e-3
    ),  # few points balance a stretch nearly
    "linear": Kind(linear, lambda: [pull()], 0.005),
    "linear, tool": Kind(linear_with_tool, lambda: [lift(1e-5)], 0.05),
    "solid, mass damping": Kind(lambda: solid("energy", alpha=ALPHA), lambda: [lift()], 0.03),
    "Galerkin, mass damping": Kind(lambda: galerkin_with_tool(ALPHA), lambda: [lift()], 0.1),
    # the supports' forces of a cubature of some 30 nodes and 4 modes err by 0.3 to 3.3 % on variants of the block
    "hyper-reduced, mass damping": Kind(lambda: hyper_with_tool(ALPHA), lambda: [lift()], 0.1, momentum=0.08),
    "hyper-reduced, implicit, mass damping": Kind(
        lambda: hyper_with_tool(ALPHA).with_step(EVERY / 8), lambda: [lift()], 0.01, momentum=0.08
    ),
    "hyper-reduced, touched, mass damping": Kind(lambda: hyper_touched(ALPHA), lambda: [press()], 0.06),
    "linear, mass damping": Kind(linear_mass_damped, lambda: [lift(1e-5)], 0.01),  # trapezoids of the power
}
QUICK = [  # kinds of the quick set; the others compile kernels of their own
    "solid, strong", "solid, energy", "solid, touched", "Galerkin", "hyper-reduced", "hyper-reduced, touched",
]  # fmt: skip
EACH_KIND = [  # with these, those of a change: each kind of model, tissue, load, support and damping, not each pair
    *QUICK, "membrane", "linear", "solid, relaxing", "solid, fibres", "solid, tool", "solid, rollers",
    "solid, mirrored", "Galerkin, tool", "hyper-reduced, implicit", "hyper-reduced, tool", "hyper-reduced, relaxing",
    "hyper-reduced, fibres", "hyper-reduced, mirrored", "hyper-reduced, mass damping", "hyper-reduced membrane",
    "linear, tool",
]  # fmt: skip
