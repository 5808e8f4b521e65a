"""Training: from runs of a full model to a reduced one, with its errors on motions it has not seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.dynamics.full import FullModel
from palpate.dynamics.loads import Load
from palpate.dynamics.membrane import Membrane
from palpate.dynamics.reactions import partition
from palpate.dynamics.rollout import rollout
from palpate.dynamics.trajectory import Trajectory
from palpate.faults import DivergenceError, InputError, integer_in_range, number_in_range
from palpate.reduction.bases import joined, main_modes
from palpate.reduction.dents import fitted_dents
from palpate.reduction.errors import errors
from palpate.reduction.linear import tool_responses
from palpate.reduction.points import Kinematics
from palpate.reduction.reduced import ReducedModel, ReducedParts
from palpate.reduction.sampling import choose_samples, differentiated, pressure_moments
from palpate.reduction.trust import calibrated, nearest, tried_frames
from palpate.reduction.witnesses import WITNESSES, apart, usual_imbalance, witnessed

__all__ = ["Trial", "reduce"]

Floats = NDArray[np.float64]
Trial = tuple[Sequence[Load], Trajectory]

SIZES = (8, 12, 16, 24, 32, 48, 64, 96)  # tried when a tolerance is given
SOLVED = 6000  # nodes up to which equations of the whole body are solved
STATES = 240  # training states that the cubature is fitted at
PRESSURES = 4  # modes to one pressure mode: more would stiffen what the modes cannot keep at constant volume
HELD_SHARE = 0.95
TAUT = 16  # training states whose highest frequency a membrane is stepped by


def reduce(
    full: FullModel | Membrane,
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
    full : FullModel or Membrane
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
        Runs that are not trained on: the reduced model repeats them and reports its errors, and what the trust number
        says of them (`ReducedModel.expected_error`).
    enrichment : (e, n, 3) array, optional
        Displacement fields that join the modes, or with ``modes=0`` stand for them: `palpate.vibration_modes`,
        `palpate.modal_derivatives`. Fields must vanish at supports and tools.
    cubature : float
        What the sampled forces may miss of the whole ones in training, relative.
    pressures : int, optional
        Number of pressure modes; by default a quarter of the modes, which errs least on motions not trained on. For
        one trained motion and few modes, as many as modes are better.
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


def _check(full: FullModel | Membrane, runs: Sequence[Trajectory]) -> None:
    if not runs:
        raise InputError("reduce needs at least one trajectory to learn from")
    if not isinstance(full, FullModel | Membrane):
        raise InputError(f"reduce needs a FullModel or a Membrane, not a {type(full).__name__}")
    if isinstance(full, Membrane) and (full.fibres is not None or full.material.prony is not None):
        raise InputError("a sampled membrane has no fibres and does not relax: reduce one without fibres= and prony=")
    for run in runs:
        if run.points.shape != full.cloud.points.shape or not np.allclose(run.points, full.cloud.points):
            raise InputError("a trajectory belongs to another cloud than the model")


def _energy_form(full: FullModel | Membrane) -> FullModel | Membrane:
    if isinstance(full, Membrane):
        return Membrane(
            full.cloud, full.material, full.thickness, full.fixed,
            prestretch=full.prestretch, relaxed=full.relaxed, viscosity=full.viscosity,
        )  # fmt: skip
    return FullModel(
        full.cloud, full.material, full.fixed, form="energy", viscosity=full.viscosity, neighbours=full.neighbours
    )


def _trained(
    full: FullModel | Membrane,
    body: FullModel | Membrane,
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
    found = main_modes(body, rest, modes, spare=0 if isinstance(body, Membrane) else WITNESSES)
    shapes = joined(body, found[:modes] if modes else None, enrichment)
    watched, modes = apart(body, shapes, found[modes:]), len(shapes)
    # as single precision keeps them in the file, so that the model that is loaded is the model that was trained
    columns = np.concatenate([shapes, lifting, supports, watched]).astype(np.float32).astype(float)
    fields = differentiated(body, columns)
    count = modes + len(lifting)
    flat = fields.columns[:count].reshape(count, -1)
    weights = np.repeat(body.masses, 3)
    mass = (flat * weights) @ flat.T
    states = np.linalg.solve(mass, (flat * weights) @ snapshots.reshape(len(snapshots), -1).T).T
    chosen = states[np.linspace(0, len(states) - 1, min(STATES, len(states))).astype(int)]
    moments = pressure_moments(body, snapshots, pressures or max(1, modes // PRESSURES))
    bare = fields.of(slice(len(columns) - len(watched)))
    places, rule = choose_samples(body, bare, modes, chosen, mass, share, moments, seed)
    fields, gradients = witnessed(body, fields, (modes, count, len(watched)), chosen, rule, places, moments)
    parts = ReducedParts(
        body.cloud, body.material, body.fixed, tools, body.volumes, _stiffness(body), full.viscosity, full.fastest,
        fields.columns, modes,
        len(lifting), rule, gradients, fields.constant, chosen,
        _reach(chosen, mass / body.masses.sum(), [len(run.times) for run in runs], len(states)),
        len(watched), kinematics=_kinematics(body), fibres=body.fibres,
        regions=body.regions if isinstance(body, FullModel) else None,
    )  # fmt: skip
    if len(watched):
        some = snapshots[np.linspace(0, len(states) - 1, len(chosen)).astype(int)]
        parts = replace(parts, leeway=usual_imbalance(ReducedModel(parts), body, some))
    model = ReducedModel(parts)
    if isinstance(body, Membrane):
        taut = max(model._highest(state) for state in chosen[:: max(1, len(chosen) // TAUT)])
        parts = replace(parts, slack=taut)
        model = ReducedModel(parts)
    projected = np.tensordot(states, fields.columns[:count], 1)
    missed = np.linalg.norm(projected - snapshots) / np.linalg.norm(snapshots)
    report: dict[str, Any] = {
        "modes": modes,
        "lifting_columns": len(lifting),
        "nodes_full": len(body.cloud),
        "nodes": len(rule.nodes),
        "pressure_modes": len(rule.pressure),
        "witnesses": len(watched),
        "cubature_residual": rule.residual,
        "projection_error": float(missed),
        "highest_frequency": model._highest(np.zeros(count)),
        "training_runs": len(runs),
        "snapshots": len(snapshots),
        "seed": seed,
        "training_seconds": perf_counter() - start,
    }
    if any(len(run.touches) for run in runs):
        dents, explained = fitted_dents(model, runs)
        parts = replace(parts, dents=dents)
        report["dents_explained"] = explained
        model = ReducedModel(parts)
    parts.report.update(report)
    if held_out:
        return _tried(model, held_out)
    return model


def _stiffness(body: FullModel | Membrane) -> Floats:
    return np.ones(len(body.cloud)) if isinstance(body, Membrane) else body.elastic_volumes / body.volumes


def _kinematics(body: FullModel | Membrane) -> Kinematics:
    if isinstance(body, Membrane):
        return Kinematics(True, body.prestretch, body.relaxed)
    return Kinematics()


def _tried(model: ReducedModel, held_out: Sequence[Trial]) -> ReducedModel:
    """Repeat the held-out runs; return the model with their errors in its report, and its trust calibrated."""
    found, frames = [], []
    for loads, run in held_out:
        every = float(run.times[1] - run.times[0])
        entry: dict[str, Any] = {"failed": False}
        try:
            own = rollout(model, loads, duration=float(run.times[-1]), every=every, progress=False)
            entry |= errors(run, own).as_dict()
            frames.append(tried_frames(model, loads, own, run))
        except DivergenceError as error:
            entry = {"failed": True, "reason": str(error)}
        found.append(entry)
    good = [entry for entry in found if not entry["failed"]]
    names = ("displacement", "velocity", "energy", "reaction")
    mean = {name: float(np.mean([e[name] for e in good])) if len(good) == len(found) else np.inf for name in names}
    worst = {
        name: float(np.quantile([e[name] for e in good], HELD_SHARE)) if len(good) == len(found) else np.inf
        for name in names
    }
    model.parts.report["held_out"] = {"runs": found, "mean": mean, "percentile_95": worst}
    if not frames:
        return model
    reach, leeway, table = calibrated(frames, HELD_SHARE)
    model.parts.report["held_out"]["trust"] = table
    return ReducedModel(replace(model.parts, reach=reach, leeway=leeway))


def _reach(chosen: Floats, mass: Floats, lengths: Sequence[int], total: int) -> float:
    """Distance that most training states keep to those of other runs; with one run, to their neighbours in time."""
    owner = np.repeat(np.arange(len(lengths)), lengths)[np.linspace(0, total - 1, len(chosen)).astype(int)]
    apart = []
    for run in range(len(lengths)):
        own = owner == run
        if own.any() and (~own).any():
            apart.append(nearest(chosen[own], chosen[~own], mass))
    if not apart:
        apart = [np.asarray(np.linalg.norm(np.diff(chosen, axis=0) @ np.linalg.cholesky(mass), axis=1))]
    return max(float(np.quantile(np.concatenate(apart), HELD_SHARE)), 1e-300)


def _lifting(body: FullModel | Membrane, tools: Sequence[str]) -> Floats:
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


def _support_fields(body: FullModel | Membrane, tools: Sequence[str]) -> Floats:
    """Test fields (3 g, n, 3) for the forces of the supports: 1 there in each direction, 0 at others and at tools."""
    held = {name: body.cloud.group(name) for name in (*body.fixed, *tools)}
    if not body.fixed:
        return np.zeros((0, len(body.cloud), 3))
    shapes = partition(body.cloud.points, held)[: len(body.fixed)]
    return np.concatenate([shape[:, None] * np.eye(3)[:, None, :] for shape in shapes])


def _without_tools(body: FullModel | Membrane, snapshots: Floats, lifting: Floats, tools: Sequence[str]) -> Floats:
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
