"""The surface's own compliance under tools, made from statics and from runs with tools.

What modes leave of statics at rest (`palpate.reduction.contact.residual_flexibility`) is the shape of dents. The full model's runs say
which forces tools had on which nodes (`Trajectory.touches`): the reduced model without compliance is led through them
by these forces. The work of the forces on what it misses there, frame by frame, tells how the compliance hardens under
a tool's whole force, and a factor that is near 1; so does one factor for nodes that forceps hold, which pulls do not
harden.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial import cKDTree

from palpate.dynamics.contact.tools import surface_nodes
from palpate.dynamics.run.rollout import CRAWL, MOST_STEPS
from palpate.dynamics.solid.model import FullModel
from palpate.faults import InputError
from palpate.meshfree.cloud import Cloud
from palpate.reduction.basis.snapshots import Snapshots
from palpate.reduction.contact.compliance import NO_DENTS, Dents, carried, softness
from palpate.reduction.contact.interior import inside
from palpate.reduction.contact.near_field import close_compliance, made_positive
from palpate.reduction.contact.residual_flexibility import carriers, residual_flexibility
from palpate.reduction.hyper.model import ReducedModel

__all__ = ["fitted_dents", "fitted_hardening"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

FRAMES = 400  # of the runs, at which the compliance is fitted
NEAR = 5.0  # spacings from a touched node to which it is fitted
STEEPEST = 0.8  # exponent of hardening: at 1 a larger force would make no deeper dent
NO_DENT = (
    "what the modes miss under tools is no dent: give reduce smooth modes (enrichment=vibration_modes(...)), which do "
    "not hold the dents of the training runs"
)
LIGHT = 0.05  # of the largest force: frames that say nothing of hardening
SPREAD = 0.1  # of the ratio of works, from frame to frame


def fitted_dents(model: ReducedModel, body: FullModel, snapshots: Snapshots, statics: FullModel) -> tuple[Dents, float]:
    """Fit the compliance of the surface to runs in which tools touch the body.

    Parameters
    ----------
    model : ReducedModel
        Its compliance, if it has any, is not used.
    body : FullModel
        In its energy form.
    snapshots : Snapshots
        Runs of the full model.
    statics : FullModel
        The body, or a coarser model of it, in the energy form, of at most 5,000 nodes.

    Returns
    -------
    dents : Dents
    explained : float
        Share of the squares of what the modes miss near the tools that it explains.

    Raises
    ------
    InputError
        No tool touches the body in any run, or the modes miss nothing that a compliance could give; statics that are
        too large, of a body that nothing holds, or of another body.
    """
    cloud = model.cloud
    ends, wanted = (np.array([c.points.min(axis=0), c.points.max(axis=0)]) for c in (statics.cloud, cloud))
    if np.abs(ends - wanted).max() > statics.cloud.spacing:
        raise InputError("coarse: its points lie elsewhere than the body's; give a coarser model of the same body")
    nodes = _free_surface(cloud, model.fixed)
    frames = _frames(model, snapshots, nodes)
    if not frames:
        raise InputError("no tool touches the body in any of the runs: the surface's compliance cannot be learnt")
    those = _free_surface(statics.cloud, statics.fixed)
    deep, deeper = _free_inside(cloud, model.fixed), _free_inside(statics.cloud, statics.fixed)
    known = residual_flexibility(statics, those, cloud.points, model.parts.columns[: model.count], deeper)
    flexibility, follow = np.split(known, [3 * len(those)])
    places, weights = carriers(statics.cloud, those, cloud, nodes)
    close, between = np.zeros((len(nodes), 0), dtype=np.int64), np.zeros((len(nodes), 0, 3, 3), dtype=np.float32)
    if statics.cloud is not cloud:
        close, between = close_compliance(body, nodes, statics, those, places, weights)
        between = made_positive(flexibility, places, weights, close, between)
    patches, shares = _patches(body, nodes)
    blank = NO_DENTS._replace(
        nodes=nodes, carriers=places, weights=weights, flexibility=flexibility.astype(np.float32),
        close=close, between=between, patches=patches, shares=shares,
        inside=inside(statics.cloud, deeper, those, follow, cloud, deep) if len(deep) and len(deeper) else None,
    )  # fmt: skip
    return _fitted(blank, cloud.points, frames)


def _patches(body: FullModel, nodes: Ints) -> tuple[Ints, Floats]:
    """Return the nodes (k, p) of the pieces of surface that tools meet, among some nodes, and their weights."""
    count = len(nodes)
    table = sparse.csr_array(body.patches[nodes][:, nodes])
    number = np.diff(table.indptr)
    row = np.repeat(np.arange(count), number)
    column = np.arange(len(row)) - table.indptr[row]
    patches, shares = np.zeros((count, int(number.max())), dtype=np.int64), np.zeros((count, int(number.max())))
    patches[row, column], shares[row, column] = table.indices, table.data
    return patches, shares / shares.sum(axis=1, keepdims=True)


def _free_surface(cloud: Cloud, fixed: Sequence[str]) -> NDArray[np.int64]:
    held = np.concatenate([np.zeros(0, dtype=np.int64), *(cloud.group(name) for name in fixed)])
    return np.setdiff1d(surface_nodes(cloud), held)


def _free_inside(cloud: Cloud, fixed: Sequence[str]) -> NDArray[np.int64]:
    away = np.concatenate([surface_nodes(cloud), *(cloud.group(name) for name in fixed)])
    return np.setdiff1d(np.arange(len(cloud)), away)


class _Frame(NamedTuple):
    """What the modes miss of the full model's displacements under tools, at one moment."""

    on: NDArray[np.int64]  # (j,) touched, in the nodes of the surface
    forces: Floats  # (j, 3) [N]
    held: bool  # by forceps
    near: NDArray[np.int64]  # (k,) nodes around them
    missed: Floats  # (k, 3) [m]


def _frames(model: ReducedModel, snapshots: Snapshots, nodes: NDArray[np.int64]) -> list[_Frame]:
    cloud, place = model.cloud, np.full(len(model.cloud), -1)
    place[nodes] = np.arange(len(nodes))
    total = sum(len(np.unique(run.touches[:, 0])) for run in snapshots.runs)
    every, found = max(1, total // FRAMES), []
    for run in snapshots.runs:
        moments = np.unique(run.touches[:, 0].astype(int))[::every]
        moments = moments[moments + 1 < len(run.times)]
        if not len(moments):
            continue
        led = _led(model, run)
        for frame in moments:
            forces, held = _forces_at(run, frame, place, len(nodes))
            on = np.flatnonzero(forces.any(axis=1))
            if not len(on) or held[on].any() != held[on].all():
                continue
            around = cKDTree(cloud.points[nodes[on]]).query(cloud.points[nodes])[0] < NEAR * cloud.spacing
            missed = run.displacements[frame] - np.tensordot(led[frame], model.parts.columns[: model.count], 1)
            found.append(_Frame(on, forces[on], bool(held[on].all()), np.flatnonzero(around), missed[nodes[around]]))
    return found


def _forces_at(run: Any, frame: int, place: Ints, count: int) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the forces (k, 3) [N] on the surface at a frame, half of those since the one before and of those after.

    And (k,) which nodes forceps hold.
    """
    forces, held = np.zeros((count, 3)), np.zeros(count, dtype=np.bool_)
    for interval in (frame, frame + 1):
        rows = run.touches[:, 0] == interval
        on = place[run.touches[rows, 1].astype(int)]
        np.add.at(forces, on[on >= 0], 0.5 * run.touches[rows, 2:][on >= 0])
        held[on[on >= 0]] |= run.held[rows][on >= 0]
    return forces, held


def _fitted(dents: Dents, points: Floats, frames: Sequence[_Frame]) -> tuple[Dents, float]:
    """Fit factor and hardening; return the compliance, and the share of the dents' squares that it explains."""
    fields = [carried(dents, frame.forces, frame.on, frame.near) for frame in frames]
    here = [np.searchsorted(frame.near, frame.on) for frame in frames]
    size = np.array([np.linalg.norm(frame.forces.sum(axis=0)) for frame in frames])
    depth = np.array([np.sum(f.forces * f.missed[h]) for f, h in zip(frames, here, strict=True)])
    linear = np.array([np.sum(f.forces * own[h]) for f, own, h in zip(frames, fields, here, strict=True)])
    held, factor, hardening = np.array([frame.held for frame in frames]), 1.0, np.array([0.0, 1.0])
    if not held.all():
        factor, hardening = fitted_hardening(size[~held], depth[~held], linear[~held])
    grip = float(depth[held].sum() / linear[held].sum()) if held.any() else factor
    if not grip > 0:
        raise InputError(NO_DENT)
    left = whole = 0.0
    for frame, own, soft in zip(frames, fields, np.where(held, grip, factor * softness(hardening, size)), strict=True):
        at = points[dents.nodes[frame.near]]
        missed, left_over = _without_affine(at, np.array([frame.missed, frame.missed - soft * own]))
        whole, left = whole + float(np.sum(missed**2)), left + float(np.sum(left_over**2))
    return dents._replace(hardening=hardening, grip=grip / factor).scaled(factor), 1.0 - left / whole


def fitted_hardening(size: Floats, depth: Floats, linear: Floats, spread: float = SPREAD) -> tuple[float, Floats]:
    """Fit factor (1 + |f| / F)^-gamma to the ratio of works of forces on depths, of runs and of the linear compliance.

    Parameters
    ----------
    size : (t,) array [N]
        Whole forces.
    depth, linear : (t,) arrays [J]
        Works.
    spread : float
        Ratios that are off by more count by their sign rather than their size.

    Returns
    -------
    factor : float
    hardening : (2,) array
        gamma, F [N].
    """
    largest = float(size.max())
    use = (size > LIGHT * largest) & (depth > 0) & (linear > 0)
    if not use.any():
        raise InputError(NO_DENT)
    wanted, weight = np.log(depth[use] / linear[use]), np.sqrt(size[use] / largest)

    def missed(at: Floats) -> Floats:
        return np.asarray(weight * (at[0] - at[1] * np.log1p(size[use] / (largest * np.exp(at[2]))) - wanted))

    start = np.array([float(np.median(wanted)), 0.1, 0.0])
    bounds = ([-np.inf, 0.0, np.log(0.1)], [np.inf, STEEPEST, np.log(10.0)])
    at = least_squares(missed, start, bounds=bounds, loss="soft_l1", f_scale=spread).x
    return float(np.exp(at[0])), np.array([at[1], largest * np.exp(at[2])])


def _without_affine(points: Floats, fields: Floats) -> Floats:
    """Return what affine fields leave of fields (f, k, 3) at points (k, 3): the dents, not where the modes are off."""
    around = points - points.mean(axis=0)
    basis = np.linalg.qr(np.column_stack([np.ones(len(points)), around / np.abs(around).max()]))[0]
    return np.asarray(fields - basis @ (basis.T @ fields))


def _led(model: ReducedModel, run: Any) -> Floats:
    """Return the coordinates (f, m) of the model led through a run by the forces on its nodes.

    Raises
    ------
    InputError
        The run's times do not increase, or the model would crawl through it as no run does.
    """
    drive, columns = model.drive(()), model.parts.columns[: model.count]
    calm = model.stable_step(model.state(drive), drive)
    state = model.state(drive, run.displacements[0], time=float(run.times[0]))
    found, start = [state.coordinates], np.searchsorted(run.touches[:, 0], np.arange(len(run.times) + 1))
    for frame in range(1, len(run.times)):
        touches = run.touches[start[frame] : start[frame + 1]]
        forces = np.einsum("mkc,kc->m", columns[:, touches[:, 1].astype(int)], touches[:, 2:])
        interval = float(run.times[frame] - state.time)
        wished = interval / max(min(model.stable_step(state, drive), interval / model.fewest), 1e-300)
        if not 0 < wished <= min(CRAWL * max(interval / calm, model.fewest), MOST_STEPS):
            raise InputError(
                f"the model cannot follow a training run at t = {state.time:.4g} s, which needs {wished:.3g} steps to "
                "the next snapshot: leave that run out, or make it again"
            )
        steps = int(np.ceil(wished * (1 - 1e-9)))
        state = model.advance(state, drive, interval / steps, steps, forces)
        found.append(state.coordinates)
    return np.array(found)
