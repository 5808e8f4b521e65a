"""Lifting vectors of tools, test fields of supports, and the removal of tool motions from snapshots."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from palpate.core.arrays import Floats, Ints
from palpate.core.faults import InputError
from palpate.dynamics.loads.supports import constrained_directions
from palpate.dynamics.nodal.energy_model import EnergyModel
from palpate.dynamics.run.partition import partitions, spread
from palpate.reduction.basis.linear_modes import tool_responses

MAX_NODES = 6000  # of a body whose equations are solved
RIGID_TOLERANCE = 1e-3  # largest error of a tool's motion in the lifting vectors, relative


def lifting_vectors(body: EnergyModel, tools: Sequence[str]) -> Floats:
    """Return fields (l, n, 3) for rigid motions of each tool's nodes, with the static response of the body.

    In a large body they decay evenly towards supports and other tools instead, and the modes represent the
    rest. A membrane is slack at rest: its lifting vectors move the tool's nodes only.
    """
    if not tools:
        return np.zeros((0, len(body.cloud), 3))
    points = body.cloud.points
    groups = {name: body.cloud.group(name) for name in (*tools, *body.fixed)}
    columns: list[Floats] = []
    slack = body.kinematics.sheet
    parts = partitions(points, groups, constrained_directions(body.cloud, body.supports))
    for g, name in enumerate(tools):
        nodes, factors = groups[name], []
        arms = points - points[nodes].mean(axis=0)
        for factor in (np.ones(len(points)), *arms.T):
            if np.abs(factor[nodes]).max() > 1e-9 * body.cloud.spacing:
                factors.append(factor[:, None] / np.abs(factor[nodes]).max())
        if slack:
            shapes = [np.isin(np.arange(len(points)), nodes)[:, None] * axis for axis in np.eye(3)]
        else:
            shapes = [spread(parts, g, axis) for axis in np.eye(3)]
        columns += [factor * shape for factor in factors for shape in shapes]
    if slack or len(points) > MAX_NODES:
        return _on_supports(body, np.array(columns), np.unique(np.concatenate([groups[name] for name in tools])))
    return tool_responses(body, np.array(columns), tools)


def support_fields(body: EnergyModel, tools: Sequence[str]) -> Floats:
    """Return test fields (3 g, n, 3) for support forces: 1 at one support, 0 at others and at tools.

    Those of a support that leaves its group free in some directions are along the constrained ones.
    """
    groups = {name: body.cloud.group(name) for name in (*body.fixed, *tools)}
    if not body.fixed:
        return np.zeros((0, len(body.cloud), 3))
    parts = partitions(body.cloud.points, groups, constrained_directions(body.cloud, body.supports))
    return np.array([spread(parts, g, axis) for g in range(len(body.fixed)) for axis in np.eye(3)])


def _on_supports(body: EnergyModel, fields: Floats, tools: Ints) -> Floats:
    """Return fields (l, n, 3) that stay on the supports, except at the nodes of tools."""
    moved = fields[:, tools].copy()
    body.supported.project(fields)
    fields[:, tools] = moved
    return fields


class RemoveToolMotion:
    """A function that subtracts the lifting vectors' part from snapshots (t, n, 3).

    Parameters
    ----------
    lifting : (l, n, 3) array
    """

    def __init__(self, body: EnergyModel, lifting: Floats, tools: Sequence[str]) -> None:
        self._lifting, self._least = lifting, RIGID_TOLERANCE * body.cloud.spacing
        self._nodes = np.unique(np.concatenate([body.cloud.group(name) for name in tools])) if tools else None
        self._error = self._largest = 0.0

    def __call__(self, snapshots: Floats) -> Floats:
        if self._nodes is None:
            return snapshots
        span = self._lifting[:, self._nodes].reshape(len(self._lifting), -1)
        motion = snapshots[:, self._nodes].reshape(len(snapshots), -1)
        coordinates = np.linalg.lstsq(span.T, motion.T, rcond=None)[0].T
        self._error = max(self._error, float(np.abs(coordinates @ span - motion).max()))
        self._largest = max(self._largest, float(np.abs(motion).max()))
        rest = snapshots - np.tensordot(coordinates, self._lifting, 1)
        rest[:, self._nodes] = 0.0  # remove rounding errors
        return np.asarray(rest)

    def check(self) -> None:
        """Raise `InputError` if a tool did not move rigidly in a snapshot processed so far."""
        if self._error > RIGID_TOLERANCE * max(self._largest, self._least):
            raise InputError(
                f"prescribed must name groups that move rigidly, got an error of {self._error:.3g} m; "
                "translate and rotate them as a rigid tool in the training runs"
            )
