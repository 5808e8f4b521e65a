"""Errors of a reduced run against the full one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np
from numpy.typing import NDArray

from palpate.core.arrays import Floats
from palpate.core.describe import Described, Fact
from palpate.core.faults import InputError
from palpate.dynamics.run.trajectory import Trajectory

MIN_FORCE = 0.1  # of frames in the contact errors, as a fraction of a tool's largest force


@dataclass(frozen=True)
class _Named(Described):
    """A record of figures by name."""

    def _facts(self) -> list[Fact]:
        return [(name.replace("_95", " (95th percentile)"), 100 * value, "%") for name, value in self.as_dict().items()]

    def as_dict(self) -> dict[str, float]:
        """Return the errors by name."""
        return asdict(self)


@dataclass(frozen=True)
class Errors(_Named):
    """Relative errors of a run against a reference.

    Parameters
    ----------
    displacement, velocity : float
        As (34), read as: mean over the snapshots of ``sum_I |u_full - u| / sum_I |u_full|``; snapshots where the
        reference does not move are left out.
    energy : float
        Mean of ``|E - E_full|`` over the peak of E_full, E the kinetic and strain energy.
    reaction : float
        Mean of ``|R - R_full|`` over the peak of ``|R_full|``, for the worst support or tool.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> pull = pt.SurfaceForce("x+", force=lambda t: (20 * t, 0, 0))
    >>> full = pt.rollout(bar, [pull], duration=0.03, every=0.001)
    >>> errors = pt.relative_errors(full, full)
    >>> errors
    Errors(displacement=0 %, velocity=0 %, energy=0 %, reaction=0 %)
    """

    displacement: float
    velocity: float
    energy: float
    reaction: float


def relative_errors(full: Trajectory, other: Trajectory) -> Errors:
    """Return the errors of a run against a reference at the same times.

    Parameters
    ----------
    full : Trajectory
        The reference.
    other : Trajectory

    Returns
    -------
    Errors

    Raises
    ------
    InputError
        The runs have different times or bodies.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> pull = pt.SurfaceForce("x+", force=lambda t: (20 * t, 0, 0))
    >>> full = pt.rollout(bar, [pull], duration=0.03, every=0.001)
    >>> model = pt.galerkin(bar, full, modes=4)
    >>> errors = pt.relative_errors(full, pt.rollout(model, [pull], duration=0.03, every=0.001))
    >>> errors.displacement < 0.05, errors.reaction < 0.05
    (True, True)
    """
    if full.displacements.shape != other.displacements.shape or not np.allclose(full.times, other.times):
        raise InputError("other must match full, got different times or numbers of nodes; use the same `every`")
    energy, reference = (t.kinetic + t.strain for t in (other, full))
    force = 0.0
    for name, expected in full.reactions.items():
        peak = np.linalg.norm(expected, axis=1).max()
        if peak > 0:
            force = max(force, float(np.mean(np.linalg.norm(other.reactions[name] - expected, axis=1)) / peak))
    return Errors(
        displacement=_relative(full.displacements, other.displacements),
        velocity=_relative(full.velocities, other.velocities),
        energy=float(np.mean(np.abs(energy - reference)) / reference.max()) if reference.max() > 0 else 0.0,
        reaction=force,
    )


@dataclass(frozen=True)
class ContactErrors(_Named):
    """Errors of tool forces and of the contact surface, in frames with at least a tenth of the largest force."""

    # force, force_95: difference of the forces on a tool over the current reference force: median and 95th percentile
    force: float
    force_95: float
    # surface_95, farthest_95: distance of the two positions of a surface node over the largest displacement of the
    # surface: 95th percentile over nodes and frames, and over frames for the farthest node
    surface_95: float
    farthest_95: float


def contact_errors(
    full: Trajectory, other: Trajectory, tools: Sequence[str], nodes: NDArray[np.int64]
) -> ContactErrors | None:
    """Return the errors of contact in a run against a reference at the same times; None if the latter has none.

    `tools` are the names of their reactions, `nodes` (k,) those of the contact surface.
    """
    differences, pressed = [np.zeros(0)], np.zeros(len(full.times), dtype=np.bool_)
    for name in tools:
        size = np.linalg.norm(full.reactions[name], axis=1)
        counted = size > MIN_FORCE * size.max()
        difference = np.linalg.norm(other.reactions[name] - full.reactions[name], axis=1)
        differences.append(difference[counted] / size[counted])
        pressed |= counted
    if not pressed.any():
        return None
    force, surface = np.concatenate(differences), full.displacements[:, nodes]
    largest = max(np.linalg.norm(surface, axis=2).max(), np.finfo(float).tiny)  # tools may press held nodes alone
    apart = np.linalg.norm(other.displacements[:, nodes] - surface, axis=2)[pressed] / largest
    return ContactErrors(
        force=float(np.median(force)),
        force_95=float(np.quantile(force, 0.95)),
        surface_95=float(np.quantile(apart, 0.95)),
        farthest_95=float(np.quantile(apart.max(axis=1), 0.95)),
    )


def _relative(expected: Floats, actual: Floats) -> float:
    size = np.linalg.norm(expected, axis=2).sum(axis=1)
    moving = size > 1e-12 * size.max()
    if not moving.any():
        return 0.0
    difference = np.linalg.norm(actual - expected, axis=2).sum(axis=1)
    return float(np.mean(difference[moving] / size[moving]))
