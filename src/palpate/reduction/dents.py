"""The surface's own compliance under tools, made from statics and from runs with tools.

What modes leave of statics at rest (`palpate.reduction.flexibility`) is the shape of dents. The full model's runs say
which forces tools had on which nodes (`Trajectory.touches`): the reduced model without compliance is led through them
by these forces, and what it misses of the displacements near the tools is fitted by

    c times statics + sum over touched nodes of g(|X_i - X_j|) f_j,    g(r) = sum of c_e exp(-r / l_e), c_0 more at 0,

with c, c_e >= 0 (non-negative least squares), so that any set of nodes has a positive definite compliance. How it all
hardens under a tool's whole force is then fitted to the work of forces on what the modes miss, frame by frame.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray
from scipy.optimize import least_squares, nnls
from scipy.spatial import cKDTree
from scipy.spatial.distance import cdist

from palpate.dynamics.contact_state import check_apart, check_way, untouched
from palpate.dynamics.full import FullModel
from palpate.dynamics.loads import Drive
from palpate.dynamics.model import Touch as TouchState
from palpate.dynamics.tools import Forceps, surface_nodes
from palpate.dynamics.trajectory import Trajectory
from palpate.faults import InputError
from palpate.meshfree.cloud import Cloud
from palpate.reduction.compliance import NO_DENTS, Dents, carried, dents_of, softness
from palpate.reduction.flexibility import carriers, residual_flexibility
from palpate.reduction.inside import inside
from palpate.reduction.skin import Skin, Tools, Touch, skin, tools_of, touched
from palpate.reduction.snapshots import Snapshots

if TYPE_CHECKING:
    from palpate.reduction.parts import ReducedParts
    from palpate.reduction.reduced import ReducedModel

__all__ = ["Handling", "dented", "fitted_dents", "skin_of", "touch_of"]

Floats = NDArray[np.float64]

LENGTHS = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0)  # of the exponentials, in spacings
FRAMES = 400  # of the runs, at which the compliance is fitted
NEAR = 5.0  # spacings from a touched node to which it is fitted
STEEPEST = 0.45  # exponent of hardening: above a half a larger force would make a smaller dent
LIGHT = 0.05  # of the largest force: frames that say nothing of hardening
PASSES = 3  # over shape and hardening


def skin_of(parts: ReducedParts) -> Skin:
    """Lay out the surface that tools touch; empty for a model that knows none."""
    dents = parts.dents or NO_DENTS
    return skin(dents, parts.cloud.points, parts.columns[: parts.modes + parts.lifted])


class Handling:
    """The tools of a drive on a reduced model's surface.

    Parameters
    ----------
    of : Skin
    drive : Drive
    """

    def __init__(self, of: Skin, drive: Drive) -> None:
        self.skin, self.drive = of, drive
        self.tools: Tools = tools_of(drive, of)
        self.touch: Touch = touched(of, len(drive.tools))

    def begun(self, displacements: Callable[[], Floats], time: float, spacing: float) -> TouchState | None:
        """Return what tools do at the start of a run: nothing; refuse those inside the body."""
        if not self.drive.tools:
            return None
        schedule = self.drive.schedule(np.array([time]))
        moved = displacements()
        check_apart(self.drive, schedule, moved, spacing)
        return untouched(len(self.drive.tools), len(moved), time, len(self.skin.nodes))

    def poses(self, times: Floats, before: TouchState | None, spacing: float) -> Floats:
        """Return the tools' poses (s, t, 7) at the times of some steps, ready to go on from what they did before."""
        if before is None:
            return np.zeros((0, 0, 7))
        schedule = self.drive.schedule(times)
        check_way(self.drive, schedule, spacing)
        self.touch.force[:], self.touch.place[:], self.touch.busy[:] = before.pushes, before.places, True
        self.tools.impulses[:], self.tools.given[:] = 0.0, 0.0
        for t, tool in enumerate(self.drive.tools):
            if isinstance(tool.tool, Forceps):
                schedule.poses[times > tool.tool.until * (1 + 1e-9), t] = np.nan
        return schedule.poses

    def after(self, before: TouchState | None) -> TouchState | None:
        """Return what the tools have done after some steps."""
        if before is None:
            return None
        forces, given, nodes = np.zeros_like(before.forces), before.given.copy(), self.skin.nodes
        forces[nodes] = self.touch.force.sum(axis=0)
        given[nodes] += self.tools.given
        return TouchState(
            forces, before.impulses + self.tools.impulses, before.since, given,
            self.touch.place.copy(), self.touch.force.copy(),
        )  # fmt: skip


def dented(parts: ReducedParts, of: Skin, touch: TouchState | None, drive: Drive) -> tuple[Floats, float]:
    """Return displacements (n, 3) [m] and energy [J] that tools add to those of a reduced model's modes."""
    if touch is None or parts.dents is None:
        return np.zeros((len(parts.cloud), 3)), 0.0
    pushes = np.zeros((len(touch.pushes), len(parts.cloud), 3))
    pushes[:, of.nodes] = touch.pushes
    held = [isinstance(tool.tool, Forceps) for tool in drive.tools]
    return dents_of(parts.dents, parts.cloud.points, pushes[:, parts.dents.nodes], held)


def touch_of(run: Trajectory, frame: int, nodes: int) -> TouchState | None:
    """Return the mean forces of tools in a frame of a run since the frame before; None where they do nothing."""
    rows = run.touches[run.touches[:, 0] == frame]
    if not len(rows):
        return None
    touch = untouched(0, nodes, float(run.times[frame]))
    touch.forces[rows[:, 1].astype(int)] = rows[:, 2:]
    return touch


def fitted_dents(model: ReducedModel, snapshots: Snapshots, statics: FullModel) -> tuple[Dents, float]:
    """Fit the compliance of the surface to runs in which tools touch the body.

    Parameters
    ----------
    model : ReducedModel
        Its compliance, if it has any, is not used.
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
    lengths = cloud.spacing * np.array(LENGTHS)
    those = _free_surface(statics.cloud, statics.fixed)
    deep, deeper = _free_inside(cloud, model.fixed), _free_inside(statics.cloud, statics.fixed)
    known = residual_flexibility(statics, those, cloud.points, model.parts.columns[: model.count], deeper)
    flexibility, follow = np.split(known, [3 * len(those)])
    places, weights = carriers(statics.cloud, those, cloud, nodes)
    blank = NO_DENTS._replace(
        nodes=nodes, lengths=lengths, compliances=np.zeros(len(lengths)), carriers=places, weights=weights,
        flexibility=flexibility.astype(np.float32),
        inside=inside(statics.cloud, deeper, those, follow, cloud, deep) if len(deep) and len(deeper) else None,
    )  # fmt: skip
    frames = _frames(model, snapshots, nodes)
    if not frames:
        raise InputError("no tool touches the body in any of the runs: the surface's compliance cannot be learnt")
    dents, explained = _fitted(blank, cloud.points, frames)
    return _on_patches(dents, statics), explained


def _on_patches(dents: Dents, statics: FullModel) -> Dents:
    """Return the compliance with the patches of surface that tools meet.

    A coarser model's nodes stand for patches already.
    """
    count = len(dents.nodes)
    if dents.carriers.shape[1] != 1:
        return dents._replace(patches=np.arange(count)[:, None], shares=np.ones((count, 1)))
    table = sparse.csr_array(statics.patches[dents.nodes][:, dents.nodes])
    most = int(np.diff(table.indptr).max())
    row = np.repeat(np.arange(count), np.diff(table.indptr))
    column = np.arange(len(row)) - table.indptr[row]
    patches, shares = np.zeros((count, most), dtype=np.int64), np.zeros((count, most))
    patches[row, column], shares[row, column] = table.indices, table.data
    return dents._replace(patches=patches, shares=shares / shares.sum(axis=1, keepdims=True))


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
    near: NDArray[np.int64]  # (k,) nodes around them
    missed: Floats  # (k, 3) [m]


def _frames(model: ReducedModel, snapshots: Snapshots, nodes: NDArray[np.int64]) -> list[_Frame]:
    cloud, place = model.cloud, np.full(len(model.cloud), -1)
    place[nodes] = np.arange(len(nodes))
    total = sum(len(np.unique(run.touches[:, 0])) for run in snapshots.runs)
    every, found = max(1, total // FRAMES), []
    for run in snapshots.runs:
        moments = np.unique(run.touches[:, 0].astype(int))[::every]
        if not len(moments):
            continue
        led = _led(model, run)
        for frame in moments:
            touches = run.touches[run.touches[:, 0] == frame]
            on = place[touches[:, 1].astype(int)]
            touches, on = touches[on >= 0], on[on >= 0]
            if not len(on):
                continue
            around = cKDTree(cloud.points[nodes[on]]).query(cloud.points[nodes])[0] < NEAR * cloud.spacing
            missed = run.displacements[frame] - np.tensordot(led[frame], model.parts.columns[: model.count], 1)
            found.append(_Frame(on, touches[:, 2:], np.flatnonzero(around), missed[nodes[around]]))
    return found


def _fitted(blank: Dents, points: Floats, frames: Sequence[_Frame]) -> tuple[Dents, float]:
    """Fit shape and hardening in turn; return the compliance, and the share that its shape explains."""
    on_surface = points[blank.nodes]
    fields = [_fields(blank, on_surface, frame) for frame in frames]
    parts = [
        _without_affine(on_surface[f.near], np.stack([*own, f.missed])) for own, f in zip(fields, frames, strict=True)
    ]
    target = np.concatenate([part[-1].ravel() for part in parts])
    size = np.array([np.linalg.norm(frame.forces.sum(axis=0)) for frame in frames])
    here = [np.searchsorted(frame.near, frame.on) for frame in frames]
    depth = np.array([np.sum(f.forces * f.missed[h]) for f, h in zip(frames, here, strict=True)])
    hardening, factor = np.array([0.0, 1.0]), 1.0
    for _ in range(PASSES):
        soft = softness(hardening, size)
        matrix = np.concatenate(
            [s * part[:-1].reshape(len(part) - 1, -1).T for s, part in zip(soft, parts, strict=True)]
        )
        found, residual = nnls(matrix, target)
        if not found.any():
            raise InputError(
                "what the modes miss under tools is no dent: give reduce smooth modes "
                "(enrichment=vibration_modes(...)), which do not hold the dents of the training runs"
            )
        linear = np.array(
            [np.sum(f.forces * np.tensordot(found, own, 1)[h]) for f, own, h in zip(frames, fields, here, strict=True)]
        )
        factor, hardening = _hardening(size, depth, linear)
    explained = 1.0 - (residual / float(np.linalg.norm(target))) ** 2
    statics, falls, own = found[0], found[1:-1], found[-1]
    known = blank.inside if statics > 0 else None  # else the surface tells nothing of R
    dents = blank._replace(
        lengths=blank.lengths[falls > 0], compliances=falls[falls > 0], own=float(own), hardening=hardening,
        flexibility=(statics * blank.flexibility).astype(np.float32),
        inside=known and known._replace(factor=float(statics)),
    )  # fmt: skip
    return dents.scaled(factor), explained


def _fields(dents: Dents, points: Floats, frame: _Frame) -> Floats:
    """Return the displacements (e, k, 3) near the tools by each part of a compliance alone, of weight 1."""
    distances = cdist(points[frame.near], points[frame.on])
    fields = [np.exp(-distances / length) @ frame.forces for length in dents.lengths]
    own = (distances == 0).astype(float) @ frame.forces
    return np.array([carried(dents, frame.forces, frame.on, frame.near), *fields, own])


def _hardening(size: Floats, depth: Floats, linear: Floats) -> tuple[float, Floats]:
    """Fit factor (1 + |f| / F)^-gamma to the ratio of works of forces on depths, of runs and of the linear compliance.

    Parameters
    ----------
    size : (t,) array [N]
        Whole forces.
    depth, linear : (t,) arrays [J]
        Works.

    Returns
    -------
    factor : float
    hardening : (2,) array
        gamma, F [N].
    """
    largest = float(size.max())
    use = (size > LIGHT * largest) & (depth > 0) & (linear > 0)
    if not use.any():
        return 1.0, np.array([0.0, 1.0])
    wanted, weight = np.log(depth[use] / linear[use]), np.sqrt(size[use] / largest)

    def missed(at: Floats) -> Floats:
        return np.asarray(weight * (at[0] - at[1] * np.log1p(size[use] / (largest * np.exp(at[2]))) - wanted))

    start = np.array([float(np.median(wanted)), 0.1, 0.0])
    bounds = ([-np.inf, 0.0, np.log(0.1)], [np.inf, STEEPEST, np.log(10.0)])
    at = least_squares(missed, start, bounds=bounds, loss="soft_l1", f_scale=0.1).x
    return float(np.exp(at[0])), np.array([at[1], largest * np.exp(at[2])])


def _without_affine(points: Floats, fields: Floats) -> Floats:
    """Return what affine fields leave of fields (f, k, 3) at points (k, 3): the dents, not where the modes are off."""
    around = points - points.mean(axis=0)
    basis = np.linalg.qr(np.column_stack([np.ones(len(points)), around / np.abs(around).max()]))[0]
    return np.asarray(fields - basis @ (basis.T @ fields))


def _led(model: ReducedModel, run: Any) -> Floats:
    """Return the coordinates (f, m) of the model led through a run by the forces on its nodes."""
    drive, columns = model.drive(()), model.parts.columns[: model.count]
    state = model.state(drive, run.displacements[0], time=float(run.times[0]))
    found, start = [state.coordinates], np.searchsorted(run.touches[:, 0], np.arange(len(run.times) + 1))
    for frame in range(1, len(run.times)):
        touches = run.touches[start[frame] : start[frame + 1]]
        forces = np.einsum("mkc,kc->m", columns[:, touches[:, 1].astype(int)], touches[:, 2:])
        interval = float(run.times[frame] - state.time)
        steps = int(np.ceil(interval / min(model.stable_step(state, drive), interval / model.fewest) * (1 - 1e-9)))
        state = model.advance(state, drive, interval / steps, steps, forces)
        found.append(state.coordinates)
    return np.array(found)
