"""Why a run diverged: the load, tool or velocity at fault, where, and what to do about it.

The reason comes first. It follows from the last finite state: how far the tissue is compressed or stretched at the
worst node, which load acts nearest to it, and how large that load is for the tissue.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from palpate.core.arrays import Floats, Ints
from palpate.core.faults import DivergenceError
from palpate.dynamics.contact.geometry import compute_gaps
from palpate.dynamics.contact.kinds import BLADE, BONDED
from palpate.dynamics.loads.body_force import Gravity
from palpate.dynamics.loads.dead_load import DeadLoad
from palpate.dynamics.loads.prepared import PreparedLoads
from palpate.dynamics.loads.pressure import Pressure
from palpate.dynamics.loads.supports import FIXED
from palpate.dynamics.run.model import Model, State

LARGE_STRETCH = 2.0  # of the tissue, or inverse of one in compression, that is a reason
LARGE_LOAD = 1.0  # of a load over the shear modulus and the area of its nodes, that is a reason
FLAT_SHARE = 0.8  # extent of a body along a force over that at rest, that is noted
SMALL_SHARE = 0.1  # of the largest load: a smaller one is not the reason
REST_TIME = 1e-3  # [s] in which a tool that does not move counts as one that rests
HIGH_SPEED = 0.3  # speed of a node over that of waves, that is a reason


class Acting(NamedTuple):
    """A load that acts on a body."""

    name: str
    resultant: Floats  # (3,) array [N]
    force: float  # [N]: sum of its sizes on the nodes
    nodes: Ints  # on which it acts
    load: float  # over the shear modulus and the area of its nodes
    moves: bool  # False for a tool that rests
    remedy: str


class Worst(NamedTuple):
    """The node at which the tissue is deformed most."""

    node: int
    shortest: float  # smallest principal stretch; negative where the tissue is turned inside out
    longest: float  # largest principal stretch


def deformation_size(points: Floats, displacements: Floats, pieces: Ints) -> float:
    """Return the largest displacement [m] but for a rigid motion of each piece.

    `points` are (n, d) [m], `displacements` (n, 3) [m], and `pieces` (n,) the number of every node's piece.
    """
    largest, at_rest = 0.0, np.pad(points, ((0, 0), (0, 3 - points.shape[1])))
    for piece in np.unique(pieces):
        inside = pieces == piece
        before, after = (
            part - part.mean(axis=0) for part in (at_rest[inside], at_rest[inside] + displacements[inside])
        )
        if not np.isfinite(after).all():
            return np.inf
        scale = np.abs(after).max(initial=0.0) or 1.0
        left, _, right = np.linalg.svd(before.T @ (after / scale))  # nearest rotation (Kabsch, Acta Cryst. A 32, 1976)
        left[:, 2] *= np.sign(np.linalg.det(left @ right)) or 1.0
        largest = max(largest, float(np.abs(after - before @ left @ right).max(initial=0.0)))
    return largest


def diverged(
    model: Model, state: State, prepared: PreparedLoads, what: str, step: float, after: State | None = None
) -> DivergenceError:
    """Return the error of a run at a state, with the reason first; it names a node that is not finite in `after`.

    `what` describes what was seen; the step is in seconds.
    """
    reason, remedy = _reason(model, state, prepared)
    where = "" if " node " in reason else f"{_worst_node(model, state, prepared, after)}, "
    if not remedy:
        more_damping = 2 * max(model.stiffness_damping, 1e-5)
        remedy = f"Try more damping (stiffness_damping={more_damping:.2g}), smaller loads, or a finer spacing"
        if not model.conservative:
            remedy += ", or form='energy', which conserves energy"
    if not model.supports and not prepared.motions and not len(prepared.sites.foundation_node):
        remedy += ". The body is free: no support holds it, and loads that do not balance move it; fixed= holds a group"
    return DivergenceError(
        f"{reason}{what} at t = {state.time:.5g} s; {where}step {step:.3g} s, stiffness damping "
        f"{model.stiffness_damping:.3g} s. {remedy}"
    )


def _reason(model: Model, state: State, prepared: PreparedLoads) -> tuple[str, str]:
    """Return the reason for the error, which ends with a semicolon, and what to do about it; both empty if unknown."""
    displacements, velocities = model.displacement(state, prepared), model.velocity(state, prepared)
    if not (np.isfinite(displacements).all() and np.isfinite(velocities).all()):
        return "", ""
    worst, acting = _worst_deformation(model, displacements), _acting_loads(model, state, prepared)
    extreme = max(worst.longest, 1 / worst.shortest if worst.shortest > 0 else np.inf)
    if acting and (extreme > LARGE_STRETCH or max(each.load for each in acting) > LARGE_LOAD):
        cause = max(acting, key=lambda each: each.load)
        if extreme > LARGE_STRETCH:
            cause = _nearest(acting, _positions(model, state, prepared), worst.node)
        verb, effect = _effect(model, worst, extreme)
        if effect:
            effect += _flattened(model, _positions(model, state, prepared), cause.resultant)
        return f"{cause.name} {verb} with {cause.force:.3g} N{effect}; ", cause.remedy
    if not acting and extreme > LARGE_STRETCH and model.conservative:
        verb, effect = _effect(model, worst, extreme)
        return f"the state at the start {verb}{effect}; ", "Start from a smaller displacement or velocity"
    waves = np.sqrt((model.material.bulk_modulus + 4 / 3 * model.material.shear_modulus) / model.material.density)
    moving = velocities - velocities.mean(axis=0)
    speed = float(np.linalg.norm(moving, axis=1).max())
    if speed > HIGH_SPEED * waves:
        return f"nodes move at up to {speed:.3g} m/s, and waves in the tissue at {waves:.3g} m/s; ", (
            "Start from smaller velocities, or check their unit, m/s"
        )
    return "", ""


def _effect(model: Model, worst: Worst, extreme: float) -> tuple[str, str]:
    """Return what a load does to the tissue: a verb with its object, and what becomes of the tissue where."""
    at = f"at node {worst.node} at {np.array2string(model.cloud.points[worst.node], precision=4)} m"
    at += ", of a piece that a cut has parted from all supports" if worst.node in model.loose_nodes else ""
    if worst.shortest <= 0:
        return "crushes the tissue", f": it is turned inside out {at}"
    if extreme <= LARGE_STRETCH:
        return "is too large for the tissue", ""
    if worst.shortest * worst.longest < 1:
        return "crushes the tissue", f": it is compressed to {worst.shortest:.1%} of its length {at}"
    return "stretches the tissue", f": to {worst.longest:.3g} times its length {at}"


def _flattened(model: Model, positions: Floats, force: Floats) -> str:
    """Return how much a force (3,) [N] has flattened the whole body, for a message; empty where it has not."""
    along = force[: model.cloud.points.shape[1]]
    before, after = np.ptp(model.cloud.points @ along), np.ptp(positions @ force)
    return (
        f", and the body to {after / before:.0%} of its extent along the force" if after < FLAT_SHARE * before else ""
    )


def _worst_deformation(model: Model, displacements: Floats) -> Worst:
    """Return the node with the largest or smallest principal stretch, by its logarithm."""
    gradients = model.deformation_gradient(displacements)
    gradients[~np.isfinite(gradients).all(axis=(1, 2))] = 0.0
    stretches = np.linalg.svd(gradients, compute_uv=False)
    longest, shortest = stretches[:, 0], stretches[:, -1]
    if gradients.shape[1] == gradients.shape[2]:
        shortest = np.where(np.linalg.det(gradients) > 0, shortest, -shortest)
    extent = np.where(shortest > 0, np.maximum(longest, 1 / np.maximum(shortest, 1e-300)), np.inf)
    node = int(np.argmin(shortest)) if np.isinf(extent).any() else int(np.argmax(extent))
    return Worst(node, float(shortest[node]), float(longest[node]))


def _nearest(acting: list[Acting], positions: Floats, node: int) -> Acting:
    """Return the load that acts nearest to a node, of those that are not small."""
    largest = max(each.force for each in acting)
    least = {True: largest, False: SMALL_SHARE * largest}  # of a load on all nodes, such as gravity, or on some
    large = [each for each in acting if each.force >= least[len(each.nodes) == len(positions)]]
    moving = [each for each in large if each.moves] or large  # a tool presses on what another one only holds
    return min(moving, key=lambda each: np.linalg.norm(positions[each.nodes] - positions[node], axis=1).min())


def _acting_loads(model: Model, state: State, prepared: PreparedLoads) -> list[Acting]:
    """Return the loads that have a force on the body in a state."""
    schedule, sites = prepared.schedule(np.array([state.time])), prepared.sites
    reactions = {name: np.nan_to_num(force) for name, force in model.outputs(state, prepared).reactions.items()}
    acting = [
        *_tools(model, _positions(model, state, prepared), prepared, state.time, reactions),
        *_motions(model, prepared, reactions),
    ]
    for g, load in enumerate(prepared.dead_loads):
        part = slice(sites.dead_start[g], sites.dead_start[g + 1])
        forces = np.einsum("kai,a->ki", sites.dead_pattern[part], schedule.amplitudes[0, g])
        acting.append(_surface_load(model, load, forces, sites.dead_node[part]))
    pressures = [load for load in prepared.loads if isinstance(load, Pressure)]
    for g, pressure in enumerate(pressures):
        part = slice(sites.pressure_start[g], sites.pressure_start[g + 1])
        forces = schedule.pressure[0, g] * sites.pressure_area[part]
        acting.append(_surface_load(model, pressure, forces, sites.pressure_node[part]))
    if any(isinstance(load, Gravity) for load in prepared.loads):
        size, held = float(np.linalg.norm(schedule.gravity[0])), np.flatnonzero(sites.kind == FIXED)
        weight = float(model.masses.sum()) * size
        remedy = "Check the units of acceleration [m/s^2], density [kg/m^3] and moduli [Pa], or let gravity grow from 0"
        ratio = _load(model, weight, held) if len(held) else 0.0  # a free body falls with its shape
        resultant = float(model.masses.sum()) * schedule.gravity[0]
        acting.append(
            Acting(f"Gravity of {size:.3g} m/s^2", resultant, weight, np.arange(len(model.cloud)), ratio, True, remedy)
        )
    return [each for each in acting if each.force > 0 and len(each.nodes)]


def _load(model: Model, force: float, nodes: Ints) -> float:
    """Return a force [N] on nodes over the shear modulus and their area."""
    return force / (max(len(nodes), 1) * model.cloud.spacing**2 * model.material.shear_modulus)


def _tools(
    model: Model, positions: Floats, prepared: PreparedLoads, time: float, reactions: dict[str, Floats]
) -> list[Acting]:
    """Return the tools at a time [s], on the nodes within a spacing of their surface, or the nearest."""
    acting, gaps, shapes = [], np.zeros(len(positions)), prepared.contacts.tools
    poses = prepared.schedule(np.array([time])).poses[0]
    for t, tool in enumerate(prepared.tools):
        if tool.tool.kind in (BONDED, BLADE):
            nodes = np.arange(len(positions))
        else:
            compute_gaps(shapes.kind[t], shapes.sizes[t], poses[t], positions, gaps)
            nodes = np.flatnonzero(gaps <= max(gaps.min(), model.cloud.spacing))
        resultant = reactions.get(tool.name, np.zeros(3))
        force = float(np.linalg.norm(resultant))
        remedy = (
            f"End the motion of {tool.name!r} before that time, press less deep, or use a law or a Poisson's ratio "
            "that resists more"
        )
        rests = bool(np.allclose(tool.poses(np.array([time - REST_TIME])), poses[t], atol=1e-9))
        acting.append(
            Acting(f"Contact {tool.name!r}", resultant, force, nodes, _load(model, force, nodes), not rests, remedy)
        )
    return acting


def _motions(model: Model, prepared: PreparedLoads, reactions: dict[str, Floats]) -> list[Acting]:
    """Return the prescribed motions and grasps."""
    acting = []
    for motion, where in prepared.motions:
        name = f"{'Grasp' if motion.group in prepared.grasps else 'PrescribedMotion of'} {motion.group!r}"
        resultant, nodes = reactions.get(motion.group, np.zeros(3)), prepared.sites.prescribed[where]
        force = float(np.linalg.norm(resultant))
        remedy = f"End the motion of {motion.group!r} before that time, or move it less far"
        acting.append(Acting(name, resultant, force, nodes, _load(model, force, nodes), True, remedy))
    return acting


def _surface_load(model: Model, load: DeadLoad | Pressure, forces: Floats, nodes: Ints) -> Acting:
    """Return a load of forces (k, 3) [N] on nodes (k,)."""
    force = float(np.linalg.norm(forces, axis=1).sum())
    size = _load(model, force, nodes)
    remedy = (
        f"The load is {size:.2g} times the shear modulus on that area; check the units of both, use a smaller load, "
        "let it grow from 0 within a tenth of a second, or spread it over more nodes"
    )
    return Acting(f"{type(load).__name__} on {load.group!r}", forces.sum(axis=0), force, nodes, size, True, remedy)


def _positions(model: Model, state: State, prepared: PreparedLoads) -> Floats:
    """Return the positions (n, 3) [m] of the nodes."""
    at_rest = np.pad(model.cloud.points, ((0, 0), (0, 3 - model.cloud.points.shape[1])))
    return np.ascontiguousarray(at_rest + model.displacement(state, prepared))


def _worst_node(model: Model, state: State, prepared: PreparedLoads, after: State | None) -> str:
    """Return the first node that is not finite in `after`, or else the fastest one, for a message."""
    for each in (state if after is None else after, state):
        velocity = model.velocity(each, prepared)
        bad = ~np.isfinite(np.column_stack([model.displacement(each, prepared), velocity])).all(axis=1)
        if not bad.all():
            node = int(np.argmax(bad if bad.any() else np.abs(velocity).max(axis=1)))
            which = "first non-finite" if bad.any() else "fastest"
            return f"{which} node {node} at {np.array2string(model.cloud.points[node], precision=4)} m"
    return "all nodes at once"
