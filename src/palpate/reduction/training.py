"""Training: from runs of a full model to a reduced one, with its errors on motions it has not seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from palpate.dynamics.full import FullModel
from palpate.dynamics.loads import Load
from palpate.dynamics.reactions import partition
from palpate.dynamics.rollout import rollout
from palpate.dynamics.trajectory import Trajectory
from palpate.faults import DivergenceError, InputError, integer_in_range, number_in_range
from palpate.reduction.cubature import Cubature, non_negative, sketch, slopes_fit
from palpate.reduction.errors import errors
from palpate.reduction.linear import tool_responses
from palpate.reduction.reduced import ReducedModel, ReducedParts

__all__ = ["Trial", "reduce"]

Floats = NDArray[np.float64]
Trial = tuple[Sequence[Load], Trajectory]

SIZES = (8, 12, 16, 24, 32, 48, 64, 96)  # tried when a tolerance is given
SOLVED = 6000  # nodes up to which equations of the whole body are solved
STATES = 240  # training states that the cubature is fitted at
ROWS, ENTRIES = 12_000, 150_000_000  # of the least-squares problem for the weights; more rows are sketched
SLOPES = 60  # training states at which the moments' slopes are fitted
BLOCK = 4096  # nodes at a time
PRESSURES = 4  # modes to one pressure mode: more would stiffen what the modes cannot keep at constant volume
LIGHT = 1e-12  # of the highest squared frequency: what keeps a body without supports regular
HELD_SHARE = 0.95
MOST_SNAPSHOTS = 800  # that modes are found from
SMALLEST = 1e-3  # of the largest snapshot: the size below which one counts less
SINGLE = 1e-10  # of the largest eigenvalue of products in single precision: what is below is noise


@dataclass(frozen=True)
class _Fields:
    """The columns, and what they do at the nodes of the energy form.

    Parameters
    ----------
    columns : (m, n, 3) array
    gradients : (n, m, 9) array
        Their derivatives; of single precision where there are many.
    constant : (m, m) array
        Stiffness of what the stencils miss of them.
    """

    columns: Floats
    gradients: Floats
    constant: Floats


def reduce(
    full: FullModel,
    trajectories: Trajectory | Sequence[Trajectory],
    *,
    modes: int | None = None,
    tolerance: float | None = None,
    driven: str | Sequence[str] = (),
    held_out: Sequence[Trial] = (),
    enrichment: Floats | None = None,
    cubature: float = 1e-3,
    pressures: int | None = None,
    seed: int = 0,
) -> ReducedModel:
    """Train a reduced model on runs of a full one: modes, sampled nodes and weights, errors and trust.

    Parameters
    ----------
    full : FullModel
        In its energy form the reduced model is a part of the same energy. A strong form is reduced by way of the energy
        form of the same body, and keeps the difference of the two, which shrinks with the spacing.
    trajectories : Trajectory or several
        The training runs.
    modes : int, optional
        Number of modes M.
    tolerance : float, optional
        Instead: the fewest modes (of 8, 12, 16, 24 ... 96) with which the mean errors of velocity, reaction force and
        displacement over the held-out runs are at most this.
    driven : str or sequence of str
        Groups that rigid tools hold and move (`PrescribedMotion`): each gets lifting columns for its translations and
        rotations, so that its pose may be any, and its force is known.
    held_out : sequence of (loads, trajectory)
        Runs that are not trained on: the reduced model repeats them and reports its errors.
    enrichment : (e, n, 3) array, optional
        Displacement fields that join the modes, or with ``modes=0`` stand for them: `palpate.vibration_modes`,
        `palpate.modal_derivatives`. Fields must vanish at supports and tools.
    cubature : float
        What the sampled forces may miss of the whole ones in training, relative.
    pressures : int, optional
        Number of pressure modes; by default a quarter of the modes.
    seed : int
        Of random combinations where the training data are many.

    Returns
    -------
    ReducedModel
        With `report`: sizes, errors, seconds.

    Raises
    ------
    InputError
        No trajectory, or one of another body; not one choice of size; more modes than the snapshots hold; a tolerance
        without held-out runs, or one that no size keeps.
    """
    if (modes is None) == (tolerance is None):
        raise InputError("give either modes or tolerance")
    runs = [trajectories] if isinstance(trajectories, Trajectory) else list(trajectories)
    _check(full, runs)
    for _, run in held_out:
        _check(full, [run])
    tools = (driven,) if isinstance(driven, str) else tuple(driven)
    share = number_in_range("cubature", cubature, 0.0, 1.0)
    body = full if full.conservative else _energy_form(full)
    if modes is not None:
        count = integer_in_range("modes", modes, 0 if enrichment is not None else 1)
        return _trained(full, body, runs, count, tools, held_out, enrichment, share, pressures, seed)
    if not held_out:
        raise InputError("a tolerance is on the errors of held-out runs: give held_out=, or give modes")
    wanted, reached = number_in_range("tolerance", tolerance or 0.0, 0.0, 1.0, open_low=True), []
    for size in SIZES:
        try:
            model = _trained(full, body, runs, size, tools, held_out, enrichment, share, pressures, seed)
        except InputError as error:  # more modes than the snapshots hold
            reached.append(str(error))
            break
        found = model.report["held_out"]["mean"]
        worst = max(found[name] for name in ("displacement", "velocity", "reaction"))
        reached.append(f"{size}: {worst:.2%}")
        if worst <= wanted:
            return model
    raise InputError(
        f"no number of modes keeps a tolerance of {wanted:.2%} on the held-out runs ({', '.join(reached)})"
    )


def strain_modes(body: FullModel, snapshots: Floats, modes: int) -> Floats:
    """Return modes (M, n, 3) that hold most of the gradients of some snapshots (t, n, 3), orthonormal in the volumes.

    The proper orthogonal decomposition of du/dX instead of u: what it leaves out is small in energy, not only in
    displacement, so that the reduced body is softer and truer. A snapshot counts by the root of its size, so that small
    motions are not lost beside large ones.

    Raises
    ------
    InputError
        More modes than independent snapshots, or snapshots that are all zero or not finite.
    """
    if not np.isfinite(snapshots).all():
        raise InputError("snapshots are not finite")
    chosen = snapshots[np.unique(np.linspace(0, len(snapshots) - 1, MOST_SNAPSHOTS).astype(int))]
    roots = np.repeat(np.sqrt(body.volumes), 9)
    rows = np.array([body.stencils.gradient(u).reshape(-1) * roots for u in chosen], dtype=np.float32)
    gram = np.asarray(rows @ rows.T, dtype=float)
    sizes = np.sqrt(np.diag(gram))
    if sizes.max() == 0:
        raise InputError("all snapshots are zero: there is nothing to find modes in")
    scale = 1 / np.sqrt(np.maximum(sizes, SMALLEST * sizes.max()))
    values, vectors = np.linalg.eigh(gram * scale[:, None] * scale)
    rank = int(np.sum(values > SINGLE * values[-1]))
    if modes > rank:
        raise InputError(f"modes = {modes}: the {len(chosen)} snapshots hold only {rank} independent shapes")
    shapes = (vectors[:, ::-1][:, :modes].T * scale) @ chosen.reshape(len(chosen), -1)
    return _orthonormal(body, shapes.reshape(modes, -1, 3))


def _orthonormal(body: FullModel, fields: Floats) -> Floats:
    """Fields (m, n, 3) with the same span, orthonormal in the volumes."""
    weights = np.repeat(np.sqrt(body.volumes), 3)
    orthonormal, _ = np.linalg.qr((fields.reshape(len(fields), -1) * weights).T)
    return np.asarray((orthonormal / weights[:, None]).T.reshape(fields.shape))


def _joined(body: FullModel, modes: Floats | None, enrichment: Floats | None) -> Floats:
    """Modes and enrichment, orthonormal together."""
    if enrichment is None:
        return np.zeros((0, len(body.cloud), 3)) if modes is None else modes
    if enrichment.ndim != 3 or enrichment.shape[1:] != (len(body.cloud), 3) or not np.isfinite(enrichment).all():
        raise InputError(f"enrichment has shape {enrichment.shape}; this body needs (e, {len(body.cloud)}, 3), finite")
    if np.abs(enrichment[:, body.held]).max(initial=0.0) > 0:
        raise InputError("enrichment moves nodes of the supports")
    sizes = np.linalg.norm(enrichment, axis=2).max(axis=1)[:, None, None]
    return _orthonormal(body, enrichment / sizes if modes is None else np.concatenate([modes, enrichment / sizes]))


def _check(full: FullModel, runs: Sequence[Trajectory]) -> None:
    if not runs:
        raise InputError("reduce needs at least one trajectory to learn from")
    if not isinstance(full, FullModel):
        raise InputError("reduce knows solids; project the equations of a membrane with palpate.project")
    for run in runs:
        if run.points.shape != full.cloud.points.shape or not np.allclose(run.points, full.cloud.points):
            raise InputError("a trajectory belongs to another cloud than the model")


def _energy_form(full: FullModel) -> FullModel:
    return FullModel(
        full.cloud, full.material, full.fixed, form="energy", viscosity=full.viscosity, neighbours=full.neighbours
    )


def _trained(
    full: FullModel,
    body: FullModel,
    runs: Sequence[Trajectory],
    modes: int,
    tools: tuple[str, ...],
    held_out: Sequence[Trial],
    enrichment: Floats | None,
    share: float,
    pressures: int | None,
    seed: int,
) -> ReducedModel:
    """Train a model of a given size."""
    start = perf_counter()
    snapshots = np.concatenate([run.displacements for run in runs])
    lifting, supports = _lifting(body, tools), _support_fields(body, tools)
    rest = _without_tools(body, snapshots, lifting, tools)
    shapes = _joined(body, strain_modes(body, rest, modes) if modes else None, enrichment)
    modes = len(shapes)
    # as single precision keeps them in the file, so that the model that is loaded is the model that was trained
    columns = np.concatenate([shapes, lifting, supports]).astype(np.float32).astype(float)
    fields = _fields(body, columns)
    count = modes + len(lifting)
    flat = fields.columns[:count].reshape(count, -1)
    weights = np.repeat(body.masses, 3)
    mass = (flat * weights) @ flat.T
    states = np.linalg.solve(mass, (flat * weights) @ snapshots.reshape(len(snapshots), -1).T).T
    chosen = states[np.linspace(0, len(states) - 1, min(STATES, len(states))).astype(int)]
    moments = _pressure_modes(body, snapshots, pressures or max(1, modes // PRESSURES))
    rule = _cubature(body, fields, count, chosen, mass, share, moments, seed)
    parts = ReducedParts(
        body.cloud, body.material, body.fixed, tools, body.volumes, full.viscosity, full.fastest, fields.columns, modes,
        len(lifting), rule, np.asarray(fields.gradients[rule.nodes], dtype=float), fields.constant, chosen,
        _reach(chosen, mass / body.masses.sum(), [len(run.times) for run in runs], len(states)),
    )  # fmt: skip
    model = ReducedModel(parts)
    projected = np.tensordot(states, fields.columns[:count], 1)
    missed = np.linalg.norm(projected - snapshots) / np.linalg.norm(snapshots)
    report: dict[str, Any] = {
        "modes": modes,
        "lifting_columns": len(lifting),
        "nodes_full": len(body.cloud),
        "nodes": len(rule.nodes),
        "pressure_modes": len(rule.pressure),
        "cubature_residual": rule.residual,
        "projection_error": float(missed),
        "highest_frequency": model._highest(np.zeros(count)),
        "training_runs": len(runs),
        "snapshots": len(snapshots),
        "seed": seed,
        "training_seconds": perf_counter() - start,
    }
    parts.report.update(report)
    if held_out:
        return _tried(model, held_out)
    return model


def _tried(model: ReducedModel, held_out: Sequence[Trial]) -> ReducedModel:
    """Repeat the held-out runs; return the model with their errors in its report, and its reach set by them."""
    found, distances = [], []
    for loads, run in held_out:
        every = float(run.times[1] - run.times[0])
        entry: dict[str, Any] = {"failed": False}
        try:
            own = rollout(model, loads, duration=float(run.times[-1]), every=every, progress=False)
            entry |= errors(run, own).as_dict()
        except DivergenceError as error:
            entry = {"failed": True, "reason": str(error)}
        found.append(entry)
        apart = _distances(model, run.displacements)
        distances.append(apart)
    good = [entry for entry in found if not entry["failed"]]
    names = ("displacement", "velocity", "energy", "reaction")
    mean = {name: float(np.mean([e[name] for e in good])) if len(good) == len(found) else np.inf for name in names}
    worst = {
        name: float(np.quantile([e[name] for e in good], HELD_SHARE)) if len(good) == len(found) else np.inf
        for name in names
    }
    model.parts.report["held_out"] = {"runs": found, "mean": mean, "percentile_95": worst}
    reach = float(np.quantile(np.concatenate(distances), HELD_SHARE))
    return ReducedModel(replace(model.parts, reach=reach))


def _distances(model: ReducedModel, displacements: Floats) -> Floats:
    """Distances [m] of displacements (t, n, 3) from the training states."""
    flat = model.parts.columns[: model.count].reshape(model.count, -1) * np.repeat(model.masses, 3)
    states = np.linalg.solve(model.mass, flat @ displacements.reshape(len(displacements), -1).T).T
    return _nearest(np.asarray(states, dtype=float), model.parts.trained, model.mass / model.masses.sum())


def _nearest(states: Floats, others: Floats, mass: Floats) -> Floats:
    """Root mean square distance [m] over the body of every state from the nearest of some others.

    `mass` is the mass matrix over the body's mass.
    """
    root = np.linalg.cholesky(mass)
    one, two = states @ root, others @ root
    square = np.sum(one**2, axis=1)[:, None] + np.sum(two**2, axis=1) - 2 * one @ two.T
    return np.sqrt(np.maximum(square.min(axis=1), 0.0))


def _reach(chosen: Floats, mass: Floats, lengths: Sequence[int], total: int) -> float:
    """Distance that most training states keep to those of other runs; with one run, to their neighbours in time."""
    owner = np.repeat(np.arange(len(lengths)), lengths)[np.linspace(0, total - 1, len(chosen)).astype(int)]
    apart = []
    for run in range(len(lengths)):
        own = owner == run
        if own.any() and (~own).any():
            apart.append(_nearest(chosen[own], chosen[~own], mass))
    if not apart:
        apart = [np.asarray(np.linalg.norm(np.diff(chosen, axis=0) @ np.linalg.cholesky(mass), axis=1))]
    return max(float(np.quantile(np.concatenate(apart), HELD_SHARE)), 1e-300)


def _lifting(body: FullModel, tools: Sequence[str]) -> Floats:
    """Columns (l, n, 3) that move and turn each tool's nodes rigidly, the body following as it would at rest.

    In a large body they fade evenly towards supports and other tools instead: the modes learn the rest.
    """
    if not tools:
        return np.zeros((0, len(body.cloud), 3))
    points = body.cloud.points
    held = {name: body.cloud.group(name) for name in (*tools, *body.fixed)}
    shapes, columns = partition(points, held), []
    for g, name in enumerate(tools):
        nodes, own = held[name], []
        arms = points - points[nodes].mean(axis=0)
        for factor in (np.ones(len(points)), *arms.T):
            field = shapes[g] * factor
            if np.abs(field[nodes]).max() > 1e-9 * body.cloud.spacing:
                own.append(field / np.abs(field[nodes]).max())
        columns += [field[:, None] * np.eye(3)[c] for field in own for c in range(3)]
    return tool_responses(body, np.array(columns), tools) if len(points) <= SOLVED else np.array(columns)


def _support_fields(body: FullModel, tools: Sequence[str]) -> Floats:
    """Test fields (3 g, n, 3) for the forces of the supports: 1 there in each direction, 0 at others and at tools."""
    held = {name: body.cloud.group(name) for name in (*body.fixed, *tools)}
    if not body.fixed:
        return np.zeros((0, len(body.cloud), 3))
    shapes = partition(body.cloud.points, held)[: len(body.fixed)]
    return np.concatenate([shape[:, None] * np.eye(3)[:, None, :] for shape in shapes])


def _without_tools(body: FullModel, snapshots: Floats, lifting: Floats, tools: Sequence[str]) -> Floats:
    """Return what the lifting columns leave of snapshots (t, n, 3); nothing at the tools' nodes."""
    if not tools:
        return snapshots
    nodes = np.unique(np.concatenate([body.cloud.group(name) for name in tools]))
    span = lifting[:, nodes].reshape(len(lifting), -1)
    motion = snapshots[:, nodes].reshape(len(snapshots), -1)
    coordinates = np.linalg.lstsq(span.T, motion.T, rcond=None)[0].T
    missed = np.abs(coordinates @ span - motion).max()
    if missed > 1e-3 * max(float(np.abs(motion).max()), 1e-3 * body.cloud.spacing):
        raise InputError(f"a tool of the training runs does not move rigidly: {missed:.3g} m of its motion is missed")
    rest = snapshots - np.tensordot(coordinates, lifting, 1)
    rest[:, nodes] = 0.0  # rounding
    return np.asarray(rest)


def _fields(body: FullModel, columns: Floats) -> _Fields:
    """Differentiate columns (m, n, 3) at all nodes."""
    blocks, lanes = body.body.lanes.nodes.shape
    n, count = len(body.cloud), len(columns)
    type_ = np.float64 if n * count < 2_000_000 else np.float32
    gradients, misses = np.empty((n, count, 9), dtype=type_), np.empty((count, 3 * n), dtype=type_)
    table = np.zeros((blocks, 1, 12, lanes))
    for m in range(count):
        body.formulation.differentiate(np.ascontiguousarray(columns[m : m + 1]), body.body, body.work, table)
        by_node = table[:, 0].transpose(0, 2, 1).reshape(-1, 12)[body.slot]
        gradients[:, m] = by_node[:, :9]
        misses[m] = by_node[:, 9:].reshape(-1) * np.repeat(np.sqrt(body.volumes), 3)
    constant = np.asarray(misses @ misses.T, dtype=float) * body.body.hourglass
    return _Fields(columns, gradients, constant)


def _cubature(
    body: FullModel, fields: _Fields, count: int, states: Floats, mass: Floats, share: float, moments: Floats, seed: int
) -> Cubature:
    """Choose nodes, weights, and the coefficients of the moments."""
    own = fields.gradients[:, :count]
    root = _compliance(body, own, fields.constant[:count, :count], moments, mass)
    if share == 0.0:  # every node, with its volume
        return Cubature(np.arange(len(body.cloud)), body.volumes, moments, 0.0)
    generator = np.random.default_rng(seed)
    total = min(ROWS, ENTRIES // len(body.cloud))
    rows, columns, target = max(1, min(count, total // len(states))), [], []
    for state in states:
        weighted = sketch(rows, count, generator) @ root @ _shear_work(body, own, state)
        size = np.linalg.norm(weighted.sum(axis=1))
        if size > 0:
            columns.append(weighted / np.sqrt(size))
            target.append(columns[-1].sum(axis=1))
    multiples, residual = non_negative(np.concatenate(columns), np.concatenate(target), share)
    nodes = np.flatnonzero(multiples > 0)
    pressure = _pressure(own, states, moments, nodes, root)
    return Cubature(nodes, multiples[nodes] * body.volumes[nodes], pressure, residual)


def _deformation(gradients: Floats, state: Floats) -> tuple[Floats, Floats, Floats]:
    """F, cof(F) and J at nodes with the derivatives (n, m, 9) of the columns."""
    F = np.eye(3) + np.einsum("nmk,m->nk", gradients, state.astype(gradients.dtype)).astype(float).reshape(-1, 3, 3)
    cofactor = np.stack([np.cross(F[:, 1], F[:, 2]), np.cross(F[:, 2], F[:, 0]), np.cross(F[:, 0], F[:, 1])], axis=1)
    return F, cofactor, np.sum(F[:, 0] * cofactor[:, 0], axis=1)


def _shear_work(body: FullModel, gradients: Floats, state: Floats) -> Floats:
    """Work of every node's shear stress, times its volume, on the columns, shape (m, n)."""
    F, cofactor, J = _deformation(gradients, state)
    stress = body.material.stress(F) - (body.material.lame * (J - 1))[:, None, None] * cofactor
    weighted = (stress * body.volumes[:, None, None]).reshape(-1, 9).astype(gradients.dtype)
    return np.asarray(np.matmul(gradients, weighted[:, :, None])[:, :, 0].T, dtype=float)


def _pressure_modes(body: FullModel, snapshots: Floats, pressures: int) -> Floats:
    """Coefficients (k, n) of J - 1 at all nodes in the moments: those of the main shapes of the runs' pressures."""
    roots, chosen = np.sqrt(body.volumes), snapshots[:: max(1, len(snapshots) // STATES)]
    smooth = np.empty((len(chosen), len(roots)))
    for u, row in zip(chosen, smooth, strict=True):
        body.force(u)
        row[:] = body.work.smooth * roots
    sizes = np.linalg.norm(smooth, axis=1)
    smooth /= np.sqrt(np.maximum(sizes, SMALLEST * sizes.max()))[:, None]
    _, values, shapes = np.linalg.svd(smooth, full_matrices=False)
    kept = min(pressures, int(np.sum(values > 1e-10 * values[0])))
    return np.asarray(np.sqrt(body.material.lame) * body.smoothed_back(shapes[:kept] * roots))


def _compliance(body: FullModel, gradients: Floats, constant: Floats, moments: Floats, mass: Floats) -> Floats:
    """Return R with R^T R the compliance of the body at rest in the coordinates."""
    shear, count = body.material.shear_modulus, len(mass)
    second = body.material.shear_bulk_modulus - 2 / 3 * shear
    stiffness = constant.copy()
    for start in range(0, len(gradients), BLOCK):
        own = gradients[start : start + BLOCK].astype(float).reshape(-1, count, 3, 3)
        roots = np.sqrt(body.volumes[start : start + BLOCK])
        strain = (own + np.swapaxes(own, 2, 3)).reshape(-1, count, 9) * roots[:, None, None]
        rows = strain.transpose(0, 2, 1).reshape(-1, count)
        traces = np.trace(own, axis1=2, axis2=3)
        slopes = traces * roots[:, None]
        stiffness += 0.5 * shear * rows.T @ rows + second * slopes.T @ slopes
    divergence = gradients[:, :, 0] + gradients[:, :, 4] + gradients[:, :, 8]
    slopes = moments @ divergence
    stiffness += slopes.T @ slopes
    values, vectors = scipy.linalg.eigh(0.5 * (stiffness + stiffness.T), mass)
    return np.asarray((vectors / np.sqrt(np.maximum(values, LIGHT * np.abs(values).max()))).T)


def _pressure(gradients: Floats, states: Floats, moments: Floats, nodes: NDArray[np.int64], root: Floats) -> Floats:
    """Fit the coefficients (k, s) of the sampled dilatations to the moments and their slopes."""
    sampled, whole, stiff = [], [], np.linalg.inv(root).T
    for state in (np.zeros(states.shape[1]), *states[:: max(1, len(states) // SLOPES)]):
        _, cofactor, J = _deformation(gradients, state)
        slope = np.matmul(gradients, cofactor.reshape(-1, 9, 1).astype(gradients.dtype))[:, :, 0] @ root.T
        value = (J - 1)[:, None] / max(float(np.linalg.norm(stiff @ state)), 1e-300)
        both = np.hstack([slope, value if state.any() else 0 * value])
        sampled.append(both[nodes])
        whole.append(moments @ both)
    return slopes_fit(np.hstack(sampled), np.hstack(whole))
