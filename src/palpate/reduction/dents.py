"""The surface's own compliance under tools: what the modes leave of a dent, learnt from runs with tools.

The full model's runs say which forces tools had on which nodes (`Trajectory.touches`). The reduced model without
compliance is led through the same runs by these forces; what it then misses of the displacements near the tools is
fitted by

    sum over touched nodes of g(|X_i - X_j|) f_j,    g(r) = sum of c_e exp(-r / l_e), and c_0 at r = 0,

with c_e >= 0 (non-negative least squares), so that any set of nodes has a positive definite compliance.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls
from scipy.spatial.distance import cdist

from palpate.dynamics.contact_state import check_apart, check_way, untouched
from palpate.dynamics.loads import Drive
from palpate.dynamics.model import Touch as TouchState
from palpate.dynamics.tools import surface_nodes
from palpate.dynamics.trajectory import Trajectory
from palpate.faults import InputError
from palpate.reduction.snapshots import Snapshots
from palpate.reduction.touch import Dents, Skin, Tools, Touch, skin, tools_of, touched

if TYPE_CHECKING:
    from palpate.reduction.parts import ReducedParts
    from palpate.reduction.reduced import ReducedModel

__all__ = ["Handling", "dents_of", "fitted_dents", "skin_of", "touch_of"]

Floats = NDArray[np.float64]

LENGTHS = (0.5, 1.0, 2.0, 4.0, 8.0, 16.0)  # of the exponentials, in spacings
TABLE = 1024  # distances at which the kernel is kept
FRAMES = 400  # of the runs, at which the compliance is fitted
NEAR = 5.0  # spacings from a touched node to which it is fitted


def skin_of(parts: ReducedParts) -> Skin:
    """Lay out the surface that tools touch; empty for a model that knows none."""
    dents, count = parts.dents, parts.modes + parts.lifted
    if dents is None:
        nothing = np.zeros((0, 3))
        return skin(np.zeros(0, dtype=np.int64), nothing, np.zeros((count, 0, 3)), np.zeros(2), 1.0, 1.0)
    points = parts.cloud.points[dents.nodes]
    distances = np.linspace(0.0, float(np.linalg.norm(np.ptp(points, axis=0))), TABLE)
    table = np.exp(-distances[:, None] / dents.lengths) @ dents.compliances
    columns = parts.columns[:count, dents.nodes]
    return skin(dents.nodes, points, columns, table, float(distances[1]), float(table[0] + dents.own))


class Handling:
    """The tools of a drive on a reduced model's surface.

    Parameters
    ----------
    of : Skin
    drive : Drive
    """

    def __init__(self, of: Skin, drive: Drive) -> None:
        self.skin, self.drive = of, drive
        self.tools: Tools = tools_of(drive.contacts, of)
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


def dents_of(dents: Dents, points: Floats, forces: Floats) -> Floats:
    """Return the displacements (n, 3) [m] beside the modes that nodal forces (n, 3) [N] make, on the surface."""
    result = np.zeros_like(forces)
    on = dents.nodes[forces[dents.nodes].any(axis=1)]
    if len(on):
        result[dents.nodes] = dents.kernel(cdist(points[dents.nodes], points[on])) @ forces[on]
    return result


def touch_of(run: Trajectory, frame: int, nodes: int) -> TouchState | None:
    """Return the mean forces of tools in a frame of a run since the frame before; None where they do nothing."""
    rows = run.touches[run.touches[:, 0] == frame]
    if not len(rows):
        return None
    touch = untouched(0, nodes, float(run.times[frame]))
    touch.forces[rows[:, 1].astype(int)] = rows[:, 2:]
    return touch


def fitted_dents(model: ReducedModel, snapshots: Snapshots) -> tuple[Dents, float]:
    """Fit the compliance of the surface to runs in which tools touch the body.

    Parameters
    ----------
    model : ReducedModel
        Its compliance, if it has any, is not used.
    snapshots : Snapshots
        Runs of the full model.

    Returns
    -------
    dents : Dents
    explained : float
        Share of the squares of what the modes miss near the tools that it explains.

    Raises
    ------
    InputError
        No tool touches the body in any run, or the modes miss nothing that a compliance could give.
    """
    cloud = model.cloud
    held = np.concatenate([np.zeros(0, dtype=np.int64), *(cloud.group(name) for name in model.fixed)])
    nodes = np.setdiff1d(surface_nodes(cloud), held)
    lengths = cloud.spacing * np.array(LENGTHS)
    rows, wanted = [], []
    total = sum(len(np.unique(run.touches[:, 0])) for run in snapshots.runs)
    every = max(1, total // FRAMES)
    for run in snapshots.runs:
        frames = np.unique(run.touches[:, 0].astype(int))[::every]
        if not len(frames):
            continue
        led = _led(model, run)
        for frame in frames:
            touches = run.touches[run.touches[:, 0] == frame]
            on, forces = touches[:, 1].astype(int), touches[:, 2:]
            distances = cdist(cloud.points[nodes], cloud.points[on])
            near = distances.min(axis=1) < NEAR * cloud.spacing
            missed = run.displacements[frame] - np.tensordot(led[frame], model.parts.columns[: model.count], 1)
            fields = [np.exp(-distances[near] / length) @ forces for length in lengths]
            fields.append((distances[near] == 0).astype(float) @ forces)
            fields.append(missed[nodes[near]])
            own = _without_affine(cloud.points[nodes[near]], np.stack(fields))
            rows.append(own[:-1].reshape(len(fields) - 1, -1).T)
            wanted.append(own[-1].ravel())
    if not rows:
        raise InputError("no tool touches the body in any of the runs: the surface's compliance cannot be learnt")
    matrix, target = np.concatenate(rows), np.concatenate(wanted)
    found, residual = nnls(matrix, target)
    if not found.any():
        raise InputError(
            "what the modes miss under tools is no dent: give reduce smooth modes (enrichment=vibration_modes(...)), "
            "which do not hold the dents of the training runs"
        )
    dents = Dents(nodes, lengths[found[:-1] > 0], found[:-1][found[:-1] > 0], float(found[-1]))
    return dents, 1.0 - (residual / float(np.linalg.norm(target))) ** 2


def _without_affine(points: Floats, fields: Floats) -> Floats:
    """Return what affine fields leave of fields (f, k, 3) at points (k, 3): the dents, not where the modes are off."""
    around = points - points.mean(axis=0)
    basis = np.linalg.qr(np.column_stack([np.ones(len(points)), around / np.abs(around).max()]))[0]
    return np.asarray(fields - np.einsum("kb,jb,fjc->fkc", basis, basis, fields))


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
