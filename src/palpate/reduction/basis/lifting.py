"""Lifting functions of tools, test fields of supports, and the removal of tool motions from snapshots."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from palpate.core.arrays import Floats, Ints
from palpate.core.faults import InputError
from palpate.dynamics.loads.supports import constrained_directions
from palpate.dynamics.nodal.energy_model import EnergyModel
from palpate.dynamics.run.partition import partitions, spread
from palpate.dynamics.solid.energy import EnergySolid
from palpate.reduction.basis.linear_modes import tool_responses

MAX_NODES = 6000  # of a body whose equations are solved
RIGID_TOLERANCE = 1e-3  # largest error of a tool's motion in the lifting functions, relative


def lifting_and_test_fields(body: EnergyModel, tools: Sequence[str]) -> tuple[Floats, Floats]:
    """Return the lifting functions (l, n, 3) of tools, and the test fields (3 g, n, 3) for the forces of g supports.

    A lifting function is a rigid motion of a tool's nodes, with the static response of the body. In a large body it
    decays evenly towards supports and other tools instead, and the modes represent the rest. A membrane is slack at
    rest: its lifting functions move the tool's nodes only.

    A test field is 1 at one support, and 0 at others and at tools. Those of a support that leaves its group free in
    some directions are along the constrained ones.
    """
    directions, supports = constrained_directions(body.cloud, body.supports), tuple(body.fixed)
    motions = _even_fields(body, tools, supports, directions)
    tests = _even_fields(body, supports, tools, directions)
    return _lifting_functions(body, motions, tools), tests.reshape(-1, len(body.cloud), 3)


def _even_fields(
    body: EnergyModel, names: Sequence[str], others: Sequence[str], directions: Mapping[str, Floats]
) -> Floats:
    """Return fields (g, 3, n, 3): one of g groups moves along an axis; the field decays evenly towards all others."""
    if not names:
        return np.zeros((0, 3, len(body.cloud), 3))
    parts = partitions(body.cloud.points, {name: body.cloud.group(name) for name in (*names, *others)}, directions)
    return np.array([[spread(parts, g, axis) for axis in np.eye(3)] for g in range(len(names))])


def _lifting_functions(body: EnergyModel, motions: Floats, tools: Sequence[str]) -> Floats:
    """Return the lifting functions (l, n, 3) of tools that move evenly by fields (g, 3, n, 3)."""
    points, columns = body.cloud.points, [np.zeros((0, len(body.cloud), 3))]
    if not tools:
        return columns[0]
    slack = body.kinematics.sheet
    for motion, name in zip(motions, tools, strict=True):
        nodes = body.cloud.group(name)
        arms = points - points[nodes].mean(axis=0)
        shapes = np.isin(np.arange(len(points)), nodes)[:, None] * np.eye(3)[:, None] if slack else motion
        for factor in (np.ones(len(points)), *arms.T):
            largest = np.abs(factor[nodes]).max()
            if largest > 1e-9 * body.cloud.spacing:
                columns.append(factor[:, None] / largest * shapes)
    fields = np.concatenate(columns)
    if slack or len(points) > MAX_NODES:
        return _on_supports(body, fields, np.unique(np.concatenate([body.cloud.group(name) for name in tools])))
    assert isinstance(body, EnergySolid)  # all other bodies are slack
    return tool_responses(body, fields, tools)


def _on_supports(body: EnergyModel, fields: Floats, tools: Ints) -> Floats:
    """Return fields (l, n, 3) that stay on the supports, except at the nodes of tools."""
    moved = fields[:, tools].copy()
    body.supported.project(fields)
    fields[:, tools] = moved
    return fields


class RemoveToolMotion:
    """A function that subtracts the part of lifting functions (l, n, 3) from snapshots (t, n, 3)."""

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
