"""Rigid tools on the surface of a reduced body: their poses, contact states and forces in a run."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from palpate.dynamics.contact.tools import Forceps
from palpate.dynamics.loads.loads import Drive
from palpate.dynamics.run.contact_state import check_apart, check_way, untouched
from palpate.dynamics.run.model import Touch as TouchState
from palpate.dynamics.run.trajectory import Trajectory
from palpate.reduction.contact.compliance import Dents, dents_of
from palpate.reduction.contact.surface import Skin, Tools, Touch, tools_of, touched

__all__ = ["Handling", "dented", "held_nodes", "touch_of"]

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]


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
            self.touch.place.copy(), self.touch.force.copy(), before.held,
        )  # fmt: skip


def dented(
    dents: Dents | None, points: Floats, of: Skin, touch: TouchState | None, drive: Drive
) -> tuple[Floats, float]:
    """Return displacements (n, 3) [m] and energy [J] that tools add to those of a reduced model's modes."""
    if touch is None or dents is None:
        return np.zeros((len(points), 3)), 0.0
    pushes = np.zeros((len(touch.pushes), len(points), 3))
    pushes[:, of.nodes] = touch.pushes
    held = [isinstance(tool.tool, Forceps) for tool in drive.tools]
    return dents_of(dents, points, pushes[:, dents.nodes], held)


def held_nodes(of: Skin, touch: TouchState | None, drive: Drive) -> Ints:
    """Return the nodes that forceps hold."""
    if touch is None:
        return of.nodes[:0]
    forceps = np.array([isinstance(tool.tool, Forceps) for tool in drive.tools], dtype=bool)
    return np.asarray(of.nodes[touch.pushes[forceps].any(axis=(0, 2))])


def touch_of(run: Trajectory, frame: int, nodes: int) -> TouchState | None:
    """Return the mean forces of tools in a frame of a run since the frame before; None where they do nothing."""
    rows = run.touches[run.touches[:, 0] == frame]
    if not len(rows):
        return None
    touch = untouched(0, nodes, float(run.times[frame]))
    touch.forces[rows[:, 1].astype(int)] = rows[:, 2:]
    return touch
