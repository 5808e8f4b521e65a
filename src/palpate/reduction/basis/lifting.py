"""What tools and supports add to a basis: columns that move with them, and what these leave of a snapshot."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from palpate.arrays import Floats
from palpate.dynamics.membrane.model import Membrane
from palpate.dynamics.run.reactions import partition
from palpate.dynamics.solid.model import Solid
from palpate.faults import InputError
from palpate.reduction.basis.linear_modes import tool_responses

__all__ = ["WithoutTools", "lifting_columns", "support_fields"]


SOLVED = 6000  # nodes up to which equations of the whole body are solved
RIGID = 1e-3  # of a tool's motion, that lifting columns may miss of it


def lifting_columns(body: Solid | Membrane, tools: Sequence[str]) -> Floats:
    """Columns (l, n, 3) that move and turn each tool's nodes rigidly, the body following as it would at rest.

    In a large body they fade evenly towards supports and other tools instead: the modes learn the rest. A membrane is
    slack at rest: there they move nothing but the tool's nodes.
    """
    if not tools:
        return np.zeros((0, len(body.cloud), 3))
    points = body.cloud.points
    held = {name: body.cloud.group(name) for name in (*tools, *body.fixed)}
    sheet, columns = isinstance(body, Membrane), []
    shapes = partition(points, held) if not sheet else [np.isin(np.arange(len(points)), held[n]) for n in tools]
    for g, name in enumerate(tools):
        nodes, own = held[name], []
        arms = points - points[nodes].mean(axis=0)
        for factor in (np.ones(len(points)), *arms.T):
            field = shapes[g] * factor
            if np.abs(field[nodes]).max() > 1e-9 * body.cloud.spacing:
                own.append(field / np.abs(field[nodes]).max())
        columns += [field[:, None] * np.eye(3)[c] for field in own for c in range(3)]
    if isinstance(body, Membrane) or len(points) > SOLVED:
        return np.array(columns)
    return tool_responses(body, np.array(columns), tools)


def support_fields(body: Solid | Membrane, tools: Sequence[str]) -> Floats:
    """Test fields (3 g, n, 3) for the forces of the supports: 1 there in each direction, 0 at others and at tools."""
    held = {name: body.cloud.group(name) for name in (*body.fixed, *tools)}
    if not body.fixed:
        return np.zeros((0, len(body.cloud), 3))
    shapes = partition(body.cloud.points, held)[: len(body.fixed)]
    return np.concatenate([shape[:, None] * np.eye(3)[:, None, :] for shape in shapes])


class WithoutTools:
    """Takes the tools' motion from snapshots: a function of (t, n, 3) returns what the lifting columns leave of them.

    Parameters
    ----------
    body : Solid or Membrane
    lifting : (l, n, 3) array
    tools : sequence of str
    """

    def __init__(self, body: Solid | Membrane, lifting: Floats, tools: Sequence[str]) -> None:
        self._lifting, self._least = lifting, RIGID * body.cloud.spacing
        self._nodes = np.unique(np.concatenate([body.cloud.group(name) for name in tools])) if tools else None
        self._missed = self._largest = 0.0

    def __call__(self, snapshots: Floats) -> Floats:
        if self._nodes is None:
            return snapshots
        span = self._lifting[:, self._nodes].reshape(len(self._lifting), -1)
        motion = snapshots[:, self._nodes].reshape(len(snapshots), -1)
        coordinates = np.linalg.lstsq(span.T, motion.T, rcond=None)[0].T
        self._missed = max(self._missed, float(np.abs(coordinates @ span - motion).max()))
        self._largest = max(self._largest, float(np.abs(motion).max()))
        rest = snapshots - np.tensordot(coordinates, self._lifting, 1)
        rest[:, self._nodes] = 0.0  # rounding
        return np.asarray(rest)

    def check(self) -> None:
        """Raise `InputError` if a tool of the snapshots seen until now did not move rigidly."""
        if self._missed > RIGID * max(self._largest, self._least):
            raise InputError(
                f"a tool of the training runs does not move rigidly: {self._missed:.3g} m of its motion is missed"
            )
