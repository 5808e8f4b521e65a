"""Surface compliance under tools, fitted to statics and to runs with contact.

The residual flexibility at rest (`palpate.reduction.contact.residual_flexibility`) gives the shape of
the indentation. The full model's runs store the forces of tools on nodes
(`Trajectory.contact_forces`). The reduced model without compliance follows each run under these
forces. The work of the forces on its displacement error, frame by frame, gives a factor near 1, and
the stiffening of the compliance with a tool's total force. It also gives one factor for nodes that
forceps hold, because pulls do not stiffen the tissue.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial import cKDTree

from palpate.core.arrays import Floats, Ints
from palpate.core.faults import InputError
from palpate.dynamics.contact.tools import surface_nodes
from palpate.dynamics.run.rollout import MAX_STEP_RATIO, MAX_STEPS_PER_FRAME
from palpate.dynamics.solid.model import EnergySolid
from palpate.reduction.basis.snapshots import Snapshots
from palpate.reduction.contact.compliance import NO_COMPLIANCE, SurfaceCompliance, secant_factor, static_displacements
from palpate.reduction.contact.interior import interior_flexibility
from palpate.reduction.contact.near_field import add_own_compliance, near_field_compliance
from palpate.reduction.contact.residual_flexibility import carriers, residual_flexibility
from palpate.reduction.hyper.model import ReducedModel

MAX_FRAMES = 400  # of the runs, in the fit
FIT_RADIUS = 5.0  # about a node in contact, in spacings
MAX_EXPONENT = 0.8  # of the stiffening; at 1 a larger force would not increase the displacement
NO_RESIDUAL = (
    "modes must be smooth and must not represent the indentation of the training runs, got modes without such a "
    "residual; give hyper_reduce enrichment=vibration_modes(...)"
)
MIN_FORCE = 0.05  # of frames in the fit of the stiffening, as a fraction of the largest force
RATIO_SPREAD = 0.1  # of the ratio of works, between frames


def fit_compliance(
    model: ReducedModel, body: EnergySolid, snapshots: Snapshots, statics: EnergySolid
) -> tuple[SurfaceCompliance, float, float]:
    """Fit the surface compliance to runs of the full model with contact; that of the model is not used.

    `statics` is the body, or a coarser model of it, in the energy form, of at most 5,000 nodes. Also returns the share
    that it explains of the squared displacement error of the modes near the tools, and its largest energy [J] in the
    frames.
    """
    cloud = model.cloud
    ends, corners = (np.array([c.points.min(axis=0), c.points.max(axis=0)]) for c in (statics.cloud, cloud))
    if np.abs(ends - corners).max() > statics.cloud.spacing:
        raise InputError(
            "coarse must have the bounds of the body, got other points; give a coarser model of the same body"
        )
    unscaled = rest_compliance(body, statics, model.data.trial_and_test_basis[: model.count])
    frames = _frames(model, snapshots, unscaled.nodes)
    if not frames:
        raise InputError(
            "trajectories must include contact to fit the surface compliance, got none; add a run with a Contact"
        )
    return _fit_factors(unscaled, cloud.points, frames)


def rest_compliance(body: EnergySolid, statics: EnergySolid, columns: Floats) -> SurfaceCompliance:
    """Return the surface compliance of a body at rest in addition to basis vectors (m, n, 3), without stiffening.

    `statics` is the body, or a coarser model of it.
    """
    cloud = body.cloud
    nodes, interior_nodes = _free_nodes(body)
    coarse_nodes, coarse_interior = _free_nodes(statics)
    patches, shares = _patches(body, nodes)
    rows = residual_flexibility(statics, coarse_nodes, cloud.points, columns, coarse_interior)
    flexibility, interior_rows = np.split(rows, [3 * len(coarse_nodes)])
    places, weights = carriers(statics.cloud, coarse_nodes, cloud, nodes)
    nearby, near_field = np.zeros((len(nodes), 0), dtype=np.int64), np.zeros((len(nodes), 0, 3, 3), dtype=np.float32)
    if statics.cloud is not cloud:
        nearby, near_field = near_field_compliance(body, nodes, statics, coarse_nodes, places, weights)
        near_field = add_own_compliance(flexibility, places, weights, nearby, near_field)
    interior = None
    if len(interior_nodes) and len(coarse_interior):
        interior = interior_flexibility(
            statics.cloud, coarse_interior, coarse_nodes, interior_rows, cloud, interior_nodes
        )
    return NO_COMPLIANCE._replace(
        nodes=nodes, carriers=places, weights=weights, flexibility=flexibility.astype(np.float32),
        nearby=nearby, near_field=near_field, patches=patches, shares=shares,
        interior=interior,
    )  # fmt: skip


def _patches(body: EnergySolid, nodes: Ints) -> tuple[Ints, Floats]:
    """Return the nodes (k, p) of the patches of surface about some nodes, among these, and their weights."""
    count = len(nodes)
    table = sparse.csr_array(body.patches[nodes][:, nodes])
    number = np.diff(table.indptr)
    row = np.repeat(np.arange(count), number)
    column = np.arange(len(row)) - table.indptr[row]
    patches, shares = np.zeros((count, int(number.max())), dtype=np.int64), np.zeros((count, int(number.max())))
    patches[row, column], shares[row, column] = table.indices, table.data
    return patches, shares / shares.sum(axis=1, keepdims=True)


def _free_nodes(body: EnergySolid) -> tuple[Ints, Ints]:
    """Return the nodes on the surface and those inside that supports do not fix."""
    bonded = np.concatenate([np.zeros(0, dtype=np.int64), *(body.cloud.group(name) for name in body.fixed)])
    surface = surface_nodes(body.cloud)
    return np.setdiff1d(surface, bonded), np.setdiff1d(np.arange(len(body.cloud)), np.concatenate([surface, bonded]))


class _Frame(NamedTuple):
    """Displacement error of the modes under tools in one frame."""

    on: NDArray[np.int64]  # (j,) nodes in contact, of the nodes of the surface
    forces: Floats  # (j, 3) [N]
    bonded: bool  # to forceps
    near: NDArray[np.int64]  # (k,) nodes around them
    missed: Floats  # (k, 3) [m]


def _frames(model: ReducedModel, snapshots: Snapshots, nodes: NDArray[np.int64]) -> list[_Frame]:
    cloud, place = model.cloud, np.full(len(model.cloud), -1)
    place[nodes] = np.arange(len(nodes))
    total = sum(len(np.unique(run.contact_forces[:, 0])) for run in snapshots.runs)
    every, frames = max(1, total // MAX_FRAMES), []
    for run in snapshots.runs:
        moments = np.unique(run.contact_forces[:, 0].astype(int))[::every]
        moments = moments[moments + 1 < len(run.times)]
        if not len(moments):
            continue
        coordinates = _follow_run(model, run)
        for frame in moments:
            forces, bonded = _forces_at(run, frame, place, len(nodes))
            on = np.flatnonzero(forces.any(axis=1))
            if not len(on) or bonded[on].any() != bonded[on].all():
                continue
            around = cKDTree(cloud.points[nodes[on]]).query(cloud.points[nodes])[0] < FIT_RADIUS * cloud.spacing
            missed = run.displacements[frame] - np.tensordot(
                coordinates[frame], model.data.trial_and_test_basis[: model.count], 1
            )
            frames.append(_Frame(on, forces[on], bool(bonded[on].all()), np.flatnonzero(around), missed[nodes[around]]))
    return frames


def _forces_at(run: Any, frame: int, place: Ints, count: int) -> tuple[Floats, NDArray[np.bool_]]:
    """Return the forces (k, 3) [N] on the surface at a frame, and (k,) whether forceps hold each node.

    The forces are means of those in the intervals before and after the frame.
    """
    forces, bonded = np.zeros((count, 3)), np.zeros(count, dtype=np.bool_)
    for interval in (frame, frame + 1):
        rows = run.contact_forces[:, 0] == interval
        on = place[run.contact_forces[rows, 1].astype(int)]
        np.add.at(forces, on[on >= 0], 0.5 * run.contact_forces[rows, 2:][on >= 0])
        bonded[on[on >= 0]] |= run.bonded[rows][on >= 0]
    return forces, bonded


def _fit_factors(
    compliance: SurfaceCompliance, points: Floats, frames: Sequence[_Frame]
) -> tuple[SurfaceCompliance, float, float]:
    """Fit factor and stiffening; return the compliance, its share of squared displacements, and largest energy."""
    fields = [static_displacements(compliance, frame.forces, frame.on, frame.near) for frame in frames]
    places = [np.searchsorted(frame.near, frame.on) for frame in frames]
    size = np.array([np.linalg.norm(frame.forces.sum(axis=0)) for frame in frames])
    depth = np.array([np.sum(f.forces * f.missed[h]) for f, h in zip(frames, places, strict=True)])
    linear = np.array([np.sum(f.forces * field[h]) for f, field, h in zip(frames, fields, places, strict=True)])
    bonded, factor, stiffening = np.array([frame.bonded for frame in frames]), 1.0, np.array([0.0, 1.0])
    if not bonded.all():
        factor, stiffening = fit_stiffening(size[~bonded], depth[~bonded], linear[~bonded])
    bonded_scale = float(depth[bonded].sum() / linear[bonded].sum()) if bonded.any() else factor
    if not bonded_scale > 0:
        raise InputError(NO_RESIDUAL)
    left = total = 0.0
    factors = np.where(bonded, bonded_scale, factor * secant_factor(stiffening, size))
    for frame, field, secant in zip(frames, fields, factors, strict=True):
        at = points[compliance.nodes[frame.near]]
        missed, residual = _without_affine(at, np.array([frame.missed, frame.missed - secant * field]))
        total, left = total + float(np.sum(missed**2)), left + float(np.sum(residual**2))
    scaled = compliance._replace(stiffening=stiffening, bonded_scale=bonded_scale / factor).scaled(factor)
    return scaled, 1.0 - left / total, 0.5 * float(np.max(factors * linear))


def fit_stiffening(size: Floats, depth: Floats, linear: Floats, spread: float = RATIO_SPREAD) -> tuple[float, Floats]:
    """Fit factor (1 + |f| / F)^-gamma to the ratio of the forces' work in runs to that of the linear compliance.

    `size` (t,) [N] are the total forces, `depth` and `linear` (t,) [J] the work in the runs, and with the linear
    compliance. A frame has reduced weight if the ratio deviates by more than `spread`. Returns the factor, and gamma
    and F [N].
    """
    largest = float(size.max())
    use = (size > MIN_FORCE * largest) & (depth > 0) & (linear > 0)
    if not use.any():
        raise InputError(NO_RESIDUAL)
    log_ratio, weight = np.log(depth[use] / linear[use]), np.sqrt(size[use] / largest)

    def missed(at: Floats) -> Floats:
        return np.asarray(weight * (at[0] - at[1] * np.log1p(size[use] / (largest * np.exp(at[2]))) - log_ratio))

    start = np.array([float(np.median(log_ratio)), 0.1, 0.0])
    bounds = ([-np.inf, 0.0, np.log(0.1)], [np.inf, MAX_EXPONENT, np.log(10.0)])
    at = least_squares(missed, start, bounds=bounds, loss="soft_l1", f_scale=spread).x
    return float(np.exp(at[0])), np.array([at[1], largest * np.exp(at[2])])


def _without_affine(points: Floats, fields: Floats) -> Floats:
    """Return fields (f, k, 3) at points (k, 3) without their affine parts.

    The rest is the indentation, without the error of the modes on a larger scale.
    """
    around = points - points.mean(axis=0)
    basis = np.linalg.qr(np.column_stack([np.ones(len(points)), around / np.abs(around).max()]))[0]
    return np.asarray(fields - basis @ (basis.T @ fields))


def _follow_run(model: ReducedModel, run: Any) -> Floats:
    """Return the coordinates (f, m) of the model under the contact forces of a run."""
    prepared, columns, work = model.prepare(()), model.data.trial_and_test_basis[: model.count], model.workspace()
    rest_step, _ = model.stable_step(model.state(prepared), prepared, work)
    state = model.state(prepared, run.displacements[0], time=float(run.times[0]))
    coordinates, start = [state.coordinates], np.searchsorted(run.contact_forces[:, 0], np.arange(len(run.times) + 1))
    for frame in range(1, len(run.times)):
        contact_forces = run.contact_forces[start[frame] : start[frame + 1]]
        forces = np.einsum("mkc,kc->m", columns[:, contact_forces[:, 1].astype(int)], contact_forces[:, 2:])
        interval = float(run.times[frame] - state.time)
        stable, state = model.stable_step(state, prepared, work)
        required = interval / max(min(stable, model.longest_step(interval)), 1e-300)
        if (
            not 0
            < required
            <= min(MAX_STEP_RATIO * max(interval / rest_step, model.min_steps_per_frame), MAX_STEPS_PER_FRAME)
        ):
            raise InputError(
                f"trajectories must be runs that the model can follow, got one with {required:.3g} steps to the "
                f"snapshot after t = {state.time:.4g} s; leave that run out, or repeat it"
            )
        steps = int(np.ceil(required * (1 - 1e-9)))
        state, _ = model.advance(state, prepared, interval / steps, steps, work, forces)
        coordinates.append(state.coordinates)
    return np.array(coordinates)
