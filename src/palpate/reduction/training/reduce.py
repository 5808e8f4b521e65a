"""Training: from runs of a full model to a reduced one, with its errors on motions it has not seen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np

from palpate.arrays import Floats
from palpate.dynamics.contact.tools import Contact, Grasp
from palpate.dynamics.loads.prepared import Load
from palpate.dynamics.membrane.model import Membrane
from palpate.dynamics.run.rollout import rollout
from palpate.dynamics.run.trajectory import StoredTrajectory, Trajectory
from palpate.dynamics.solid.model import Solid
from palpate.faults import DivergenceError, InputError, integer_in_range, number_in_range
from palpate.reduction.basis.incremental_pod import block_size
from palpate.reduction.basis.lifting import WithoutTools, lifting_columns, support_fields
from palpate.reduction.basis.snapshots import Run, Snapshots
from palpate.reduction.basis.strain_pod import join, main_modes
from palpate.reduction.hyper.error_indicator import nearest
from palpate.reduction.hyper.material_point import Kinematics
from palpate.reduction.hyper.model import ReducedData, ReducedModel
from palpate.reduction.training.calibrate_contact import Trial, calibrate_contact
from palpate.reduction.training.calibrate_indicator import calibrate_indicator, indicator_frames
from palpate.reduction.training.ecsw import Fields, choose_samples, differentiate, pressure_moments
from palpate.reduction.training.errors import ContactErrors, Errors, contact_errors, relative_errors
from palpate.reduction.training.fit_compliance import fit_compliance
from palpate.reduction.training.residual_fields import RESIDUAL_FIELDS, apart, scale_residual_fields, typical_residual

__all__ = ["Trial", "hyper_reduce"]


SIZES = (8, 12, 16, 24, 32, 48, 64, 96)  # tried when a tolerance is given
STATES = 240  # training states that the cubature is fitted at
PRESSURES = 4  # modes to one pressure mode: more would stiffen what the modes cannot keep at constant volume
HELD_SHARE = 0.95
TAUT = 16  # training states whose highest frequency a membrane is stepped by


def hyper_reduce(
    full: Solid | Membrane,
    trajectories: Run | Sequence[Run],
    *,
    modes: int | None = None,
    tolerance: float | None = None,
    prescribed: str | Sequence[str] = (),
    held_out: Sequence[Trial] = (),
    enrichment: Floats | None = None,
    cubature: float = 1e-3,
    pressures: int | None = None,
    coarse: Solid | None = None,
    repeated: Sequence[Trial] = (),
    seed: int = 0,
) -> ReducedModel:
    """Train a reduced model on runs of a full one: modes, sampled nodes and weights, errors and trust.

    Parameters
    ----------
    full : Solid or Membrane
        In its energy form the reduced model is a part of the same energy. A strong form is reduced by way of the energy
        form of the same body, and keeps the difference of the two, which shrinks with the spacing.
    trajectories : Trajectory or path, or several
        The training runs. Those given by the path of their file are read a block at a time, so that together they may
        be larger than the memory.
    modes : int, optional
        Number of modes M.
    tolerance : float, optional
        Instead: the fewest modes (of 8, 12, 16, 24 ... 96) with which the mean errors of velocity, reaction force and
        displacement over the held-out runs are at most this.
    driven : str or sequence of str
        Groups that rigid tools hold and move (`PrescribedMotion`): each gets lifting columns for its translations and
        rotations, so that its pose may be any, and its force is known.
    held_out : sequence of (loads, trajectory or path)
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
    coarse : Solid, optional
        A coarser model of the same body, of at most 5,000 nodes, whose statics tell how its surface gives way under
        tools that touch it in the runs; by default the body itself, if it has no more nodes than that.
    repeated : sequence of (loads, trajectory or path)
        Some of the training runs in which tools touch or hold the body, with their loads: the compliance of its surface
        is scaled until tools' forces are theirs in the mean.
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
    if not isinstance(full, Solid | Membrane):
        raise InputError(f"reduce needs a Solid or a Membrane, not a {type(full).__name__}")
    if isinstance(full, Membrane) and (full.fibres is not None or full.material.prony is not None):
        raise InputError("a sampled membrane has no fibres and does not relax: reduce one without fibres= and prony=")
    snapshots = Snapshots(trajectories)
    _check(full, snapshots.points)
    for _, run in held_out:
        _check(full, [run.points if isinstance(run, Trajectory) else StoredTrajectory(run).points])
    share = number_in_range("cubature", cubature, 0.0, 1.0)
    body = full if full.conservative else _energy_form(full)
    tools = (prescribed,) if isinstance(prescribed, str) else tuple(prescribed)
    wish = _Wish(tools, held_out, enrichment, share, pressures, seed, coarse, repeated)
    if modes is not None:
        count = integer_in_range("modes", modes, 0 if enrichment is not None else 1)
        return _trained(full, body, snapshots, count, wish)
    if not held_out:
        raise InputError("a tolerance is on the errors of held-out runs: give held_out=, or give modes")
    wanted, reached = number_in_range("tolerance", tolerance or 0.0, 0.0, 1.0, open_low=True), []
    for size in SIZES:
        try:
            model = _trained(full, body, snapshots, size, wish)
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


@dataclass(frozen=True)
class _Wish:
    """What is asked of `hyper_reduce` for any size."""

    tools: tuple[str, ...]
    held_out: Sequence[Trial]
    enrichment: Floats | None
    cubature: float
    pressures: int | None
    seed: int
    coarse: Solid | None
    repeated: Sequence[Trial]


def _check(full: Solid | Membrane, points: Sequence[Floats]) -> None:
    for own in points:
        if own.shape != full.cloud.points.shape or not np.allclose(own, full.cloud.points):
            raise InputError("a trajectory belongs to another cloud than the model")


def _energy_form(full: Solid | Membrane) -> Solid | Membrane:
    if isinstance(full, Membrane):
        return Membrane(
            full.cloud, full.material, full.thickness, full.fixed,
            prestretch=full.prestretch, relaxed=full.relaxed, stiffness_damping=full.stiffness_damping,
        )  # fmt: skip
    return Solid(
        full.cloud,
        full.material,
        full.fixed,
        form="energy",
        stiffness_damping=full.stiffness_damping,
        neighbours=full.neighbours,
    )


def _trained(
    full: Solid | Membrane, body: Solid | Membrane, snapshots: Snapshots, size: int, wish: _Wish
) -> ReducedModel:
    """Train a model of a given size."""
    start = perf_counter()
    columns = _columns(body, snapshots, size, wish)
    states, missed = _states(body, columns, snapshots)
    model = ReducedModel(_data(full, body, snapshots, columns, states, wish))
    if isinstance(body, Membrane):
        trained = model.data.trained
        taut = max(model._highest(state) for state in trained[:: max(1, len(trained) // TAUT)])
        model = ReducedModel(replace(model.data, taut_frequency=taut))
    rule = model.data.cubature
    report: dict[str, Any] = {
        "modes": columns.modes,
        "lifting_columns": columns.count - columns.modes,
        "nodes_full": len(body.cloud),
        "nodes": len(rule.nodes),
        "pressure_modes": len(rule.pressure),
        "residual_fields": columns.residual_fields,
        "cubature": wish.cubature,
        "cubature_residual": rule.residual,
        "projection_error": missed,
        "modes_error": columns.lost,
        "highest_frequency": model._highest(np.zeros(columns.count)),
        "training_runs": len(snapshots.lengths),
        "snapshots": len(snapshots),
        "seed": wish.seed,
        "training_seconds": perf_counter() - start,
    }
    if snapshots.touched and not wish.tools and isinstance(body, Solid):
        compliance, report["compliance_explained"] = fit_compliance(model, body, snapshots, wish.coarse or body)
        model = ReducedModel(replace(model.data, compliance=compliance))
        if wish.repeated:
            model, found = calibrate_contact(model, wish.repeated)
            report |= found
    model.data.report.update(report)
    return _tried(model, wish.held_out) if wish.held_out else model


@dataclass(frozen=True)
class _Columns:
    """The columns: modes, then lifting columns, together the coordinates; then the supports' fields and witnesses."""

    fields: Fields
    modes: int
    count: int
    residual_fields: int
    mass: Floats  # of the coordinates
    lost: float  # when the modes were found


def _columns(body: Solid | Membrane, snapshots: Snapshots, size: int, wish: _Wish) -> _Columns:
    lifting, supports = lifting_columns(body, wish.tools), support_fields(body, wish.tools)
    rest = WithoutTools(body, lifting, wish.tools)
    found, lost = main_modes(body, snapshots, size, 0 if isinstance(body, Membrane) else RESIDUAL_FIELDS, rest)
    rest.check()
    shapes = join(body, found[:size] if size else None, wish.enrichment)
    watched = apart(body, shapes, found[size:])
    # as single precision keeps them in the file, so that the model that is loaded is the model that was trained
    columns = np.concatenate([shapes, lifting, supports, watched]).astype(np.float32).astype(float)
    count = len(shapes) + len(lifting)
    flat = columns[:count].reshape(count, -1)
    mass = (flat * np.repeat(body.masses, 3)) @ flat.T
    return _Columns(differentiate(body, columns), len(shapes), count, len(watched), mass, lost)


def _states(body: Solid | Membrane, columns: _Columns, snapshots: Snapshots) -> tuple[Floats, float]:
    """Coordinates (t, m + l) of all snapshots, and the share of them that the columns miss."""
    flat = columns.fields.columns[: columns.count].reshape(columns.count, -1)
    weighted, states, missed, whole = flat * np.repeat(body.masses, 3), [], 0.0, 0.0
    for block in snapshots.blocks(block_size(snapshots.nodes)):
        rows = block.reshape(len(block), -1)
        own = np.linalg.solve(columns.mass, weighted @ rows.T).T
        states.append(own)
        whole += float(np.linalg.norm(rows)) ** 2
        rows -= own @ flat
        missed += float(np.linalg.norm(rows)) ** 2
    return np.concatenate(states), float(np.sqrt(missed / whole))


def _data(
    full: Solid | Membrane, body: Solid | Membrane, snapshots: Snapshots, columns: _Columns, states: Floats,
    wish: _Wish,
) -> ReducedData:  # fmt: skip
    """Choose the samples, and put all together."""
    fields, modes, count, mass = columns.fields, columns.modes, columns.count, columns.mass
    chosen = states[snapshots.spread(STATES)]
    moments = pressure_moments(body, snapshots, wish.pressures or max(1, modes // PRESSURES))
    bare = fields.of(slice(len(fields.columns) - columns.residual_fields))
    places, rule = choose_samples(body, bare, modes, chosen, mass, wish.cubature, moments, wish.seed)
    fields, gradients = scale_residual_fields(
        body, fields, (modes, count, columns.residual_fields), chosen, rule, places, moments
    )
    data = ReducedData(
        body.cloud, body.material, body.fixed, wish.tools, body.volumes, _stiffness(body), full.stiffness_damping, full.wave_speed,
        fields.columns, modes, count - modes, rule, gradients, fields.constant, chosen,
        _distance_scale(chosen, mass / body.masses.sum(), snapshots),
        columns.residual_fields, kinematics=_kinematics(body), fibres=body.fibres,
        regions=body.regions if isinstance(body, Solid) else None,
    )  # fmt: skip
    if not columns.residual_fields:
        return data
    some = snapshots.each(snapshots.spread(STATES))
    return replace(data, residual_scale=typical_residual(ReducedModel(data), body, some))


def _stiffness(body: Solid | Membrane) -> Floats:
    return np.ones(len(body.cloud)) if isinstance(body, Membrane) else body.elastic_volumes / body.volumes


def _kinematics(body: Solid | Membrane) -> Kinematics:
    if isinstance(body, Membrane):
        return Kinematics(True, body.prestretch, body.relaxed)
    return Kinematics()


def _tried(model: ReducedModel, held_out: Sequence[Trial]) -> ReducedModel:
    """Repeat the held-out runs; return the model with their errors in its report, and its trust calibrated."""
    found, frames = [], []
    for loads, kept in held_out:
        run = kept if isinstance(kept, Trajectory) else Trajectory.load(kept)
        every = float(run.times[1] - run.times[0])
        entry: dict[str, Any] = {"failed": False}
        try:
            own = rollout(model, loads, duration=float(run.times[-1]), every=every, progress=False)
            entry |= relative_errors(run, own).as_dict() | _touched(model, loads, run, own)
            frames.append(indicator_frames(model, loads, own, run))
        except DivergenceError as error:
            entry = {"failed": True, "reason": str(error)}
        found.append(entry)
    touched = [entry for entry in found if entry["failed"] or "force" in entry]
    model.data.report["held_out"] = {"runs": found, **_over_runs(found, list(Errors.__annotations__))}
    if any(not entry["failed"] for entry in touched):
        model.data.report["held_out"]["contact"] = _over_runs(touched, list(ContactErrors.__annotations__))
    if not frames:
        return model
    distance_scale, residual_scale, table = calibrate_indicator(frames, HELD_SHARE)
    model.data.report["held_out"]["trust"] = table
    return ReducedModel(replace(model.data, distance_scale=distance_scale, residual_scale=residual_scale))


def _touched(model: ReducedModel, loads: Sequence[Load], run: Trajectory, own: Trajectory) -> dict[str, float]:
    """Return the errors by name of what tools do; none where no tool touches the body."""
    tools = [load.name for load in loads if isinstance(load, Contact | Grasp)]
    found = contact_errors(run, own, tools, model.data.compliance.nodes) if model.data.compliance is not None else None
    return found.as_dict() if found is not None else {}


def _over_runs(found: Sequence[dict[str, Any]], names: Sequence[str]) -> dict[str, dict[str, float]]:
    """Return mean and 95th percentile of the errors of runs; infinite where one of them failed."""
    failed = any(entry["failed"] for entry in found)
    values = {name: np.inf if failed else np.array([entry[name] for entry in found]) for name in names}
    return {
        "mean": {name: float(np.mean(own)) for name, own in values.items()},
        "percentile_95": {name: float(np.quantile(own, HELD_SHARE)) for name, own in values.items()},
    }


def _distance_scale(chosen: Floats, mass: Floats, snapshots: Snapshots) -> float:
    """Distance that most training states keep to those of other runs; with one run, to their neighbours in time."""
    runs = len(snapshots.lengths)
    owner = np.repeat(np.arange(runs), snapshots.lengths)[snapshots.spread(STATES)]
    apart = []
    for run in range(runs):
        own = owner == run
        if own.any() and (~own).any():
            apart.append(nearest(chosen[own], chosen[~own], mass))
    if not apart:
        apart = [np.asarray(np.linalg.norm(np.diff(chosen, axis=0) @ np.linalg.cholesky(mass), axis=1))]
    return max(float(np.quantile(np.concatenate(apart), HELD_SHARE)), 1e-300)
