"""Training of a reduced model from runs of a full one, with its errors on held-out runs."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from time import perf_counter
from typing import Any

import numpy as np

from palpate.core.arrays import Floats
from palpate.core.faults import DivergenceError, InputError, TrustWarning, integer_in_range, number_in_range
from palpate.dynamics.contact.tools import Contact, Grasp
from palpate.dynamics.loads.prepared import Load
from palpate.dynamics.membrane.model import Membrane
from palpate.dynamics.nodal.energy_model import EnergyModel, Fields
from palpate.dynamics.nodal.model import NodalModel
from palpate.dynamics.run.trajectory import StoredTrajectory, Trajectory
from palpate.dynamics.solid.model import EnergySolid, Solid, energy_solid
from palpate.reduction.basis.incremental_pod import block_size
from palpate.reduction.basis.lifting import RemoveToolMotion, lifting_vectors, support_fields
from palpate.reduction.basis.linear_modes import interpolated_modes
from palpate.reduction.basis.snapshots import Run, Snapshots
from palpate.reduction.basis.strain_pod import join, main_modes
from palpate.reduction.contact.coarse_body import statics_body
from palpate.reduction.hyper.data import UNLIMITED_SCALE
from palpate.reduction.hyper.error_indicator import (
    distances_to_nearest,
    nearness_to_supports,
    rms_speeds,
    support_nearness,
)
from palpate.reduction.hyper.model import ReducedData, ReducedModel
from palpate.reduction.training.advice import advice
from palpate.reduction.training.calibrate_contact import Trial, calibrate_contact
from palpate.reduction.training.calibrate_indicator import Frames, calibrate_scales, error_curves, repeat_run
from palpate.reduction.training.ecsw import choose_integration_points, pressure_moments
from palpate.reduction.training.errors import ContactErrors, Errors, contact_errors, relative_errors
from palpate.reduction.training.fit_compliance import fit_compliance
from palpate.reduction.training.parallel_runs import in_threads
from palpate.reduction.training.residual_fields import (
    RESIDUAL_FIELDS,
    orthogonal_complement,
    scale_residual_fields,
    typical_residual,
)
from palpate.reduction.training.round_compliance import round_compliance

__all__ = ["Trial", "hyper_reduce"]


TRIED_MODES = (8, 12, 16, 24, 32, 48, 64, 96)  # numbers of modes for a given tolerance
# largest relative error of sampled forces: where tools touch a body anywhere, and elsewhere
CONTACT_CUBATURE_ERROR, CUBATURE_ERROR = 1e-2, 1e-3
TRAINING_STATES = 240  # for the fit of the cubature
MIN_DISPLACEMENT = 1e-10  # of the largest one in training over the spacing; strains below are lost by rounding
MODES_PER_PRESSURE = 4  # more pressure modes would cause volumetric locking
ERROR_QUANTILE = 0.95  # of errors, and of runs with a trust number of at most 1
FRAME_SPEED_MARGIN = 1.5  # of a scale from differences of frames, which miss the peaks between
FREQUENCY_STATES = 16  # training states for the highest frequency of a membrane


def hyper_reduce(
    full: Solid | Membrane,
    trajectories: Run | Sequence[Run],
    *,
    modes: int | None = None,
    tolerance: float | None = None,
    prescribed: str | Sequence[str] = (),
    held_out: Sequence[Trial] = (),
    enrichment: Floats | None = None,
    cubature: float | None = None,
    pressures: int | None = None,
    basis: str | None = None,
    coarse: Solid | None = None,
    repeated: Sequence[Trial] = (),
    seed: int = 0,
) -> ReducedModel:
    """Train a reduced model on runs of a full one: modes, integration points, errors and trust number.

    Parameters
    ----------
    full : Solid or Membrane
        In its energy form, the reduced energy is a subset of its terms. A solid in the strong form is replaced by the
        energy form of the same body. The difference of the two remains, and decreases with the spacing.
    trajectories : Trajectory or path, or several
        The training runs. Files are read a block at a time, so together they may be larger than the
        memory.
    modes : int, optional
        Number of modes M, additional to `enrichment`.
    tolerance : float, optional
        Alternative to `modes`: the least number of modes (of 8, 12, 16, 24 ... 96) with which the mean
        errors of velocity, reaction force and displacement over the held-out runs are at most this.
    prescribed : str or sequence of str
        Groups that rigid tools hold and move (`PrescribedMotion`). Each has lifting vectors for its
        translations and rotations, so its pose is arbitrary, and its force is an output.
    held_out : sequence of (loads, trajectory or path)
        Runs outside the training data. The reduced model repeats them and reports its errors, and the
        table of errors by trust number (`ReducedModel.expected_error`).
    enrichment : (e, n, 3) array, optional
        Additional displacement fields, or with ``modes=0`` the only ones: `palpate.vibration_modes`,
        `palpate.modal_derivatives`. Fields must vanish at supports and tools.
    cubature : float, optional
        Largest relative error of the sampled forces in training: by default 0.01 where tools touch the body
        anywhere, whose held-out errors are equal with a tenth of it, and 0.001 elsewhere.
    pressures : int, optional
        Number of pressure modes. The default, a quarter of the modes, has the least error on held-out
        motions. For one training motion and few modes, as many as modes are better.
    basis : str, optional
        ``"pod"``: modes are those of the runs. ``"vibrations"``: they are vibration modes of `coarse` and their
        derivatives, for tools that may touch the body anywhere; modes of runs would be indentations at the places
        of those runs. By default ``"vibrations"`` where tools touch the body in the runs, unless `enrichment` is
        given.
    coarse : Solid, optional
        A coarser model of the same body, of at most 5,000 nodes, for its vibrations, and for its statics, which
        give the surface compliance under tools in contact. By default the body itself, or of a larger one its
        surface filled again with about 3,000 nodes (`palpate.reduction.contact.coarse_body`).
    repeated : sequence of (loads, trajectory or path)
        Some of the training runs with contact, and their loads. The surface compliance is scaled to the
        mean tool forces of these runs.
    seed : int
        Of random combinations where the training data are many.

    Returns
    -------
    ReducedModel
        With `report`: sizes, errors, seconds.

    Raises
    ------
    InputError
        No trajectory, or one of another body; neither or both of `modes` and `tolerance`; more modes than
        the snapshots span; a tolerance without held-out runs, or one that no size keeps; tools in contact
        with a body of more than 5,000 nodes without `coarse` whose surface cannot be filled again.

    Warns
    -----
    TrustWarning
        The basis is ``"pod"`` without enrichment although tools touch the body in the runs; or the mean errors on
        the held-out runs are above 30 %, in force or surface under tools, else in displacement or reaction. The
        report has that warning, with what to change, under ``"advice"``.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> pull = pt.SurfaceForce("x+", force=lambda t: (20 * t, 0, 0))
    >>> full = pt.rollout(bar, [pull], duration=0.03, every=0.001)
    >>> model = pt.hyper_reduce(bar, full, modes=4)
    >>> fast = pt.rollout(model, [pull], duration=0.03, every=0.001)
    >>> pt.relative_errors(full, fast).displacement < 0.05
    True
    >>> model.report["nodes"] < len(cloud.points)
    True
    """
    if (modes is None) == (tolerance is None):
        raise InputError("modes or tolerance must be given, but not both; leave one of them out")
    if not isinstance(full, NodalModel):
        raise InputError(f"full must be a Solid or a Membrane, got {type(full).__name__}; make one of them first")
    snapshots = Snapshots(trajectories)
    _check(full, snapshots.points)
    for _, run in held_out:
        _check(full, [run.points if isinstance(run, Trajectory) else StoredTrajectory(run).points])
    if cubature is not None:
        cubature = number_in_range("cubature", cubature, 0.0, 1.0)
    coarse = None if coarse is None else energy_solid(coarse, "coarse")
    body = full.energy_form()
    if body.kinematics.sheet and (body.fibres is not None or body.material.prony is not None):
        raise InputError(
            "full must have no fibres and no relaxation if it is a membrane, got them; leave out fibres= and prony="
        )
    if body.tissue.lame < 0:
        raise InputError(
            f"poisson of the material must make its volumetric coefficient positive for a reduced model, got "
            f"{full.material.poisson:.3g} with {body.tissue.lame:.3g} Pa; use a larger Poisson's ratio"
        )
    tools = (prescribed,) if isinstance(prescribed, str) else tuple(prescribed)
    touched = snapshots.has_contact and not tools and not body.kinematics.sheet
    vibrations = _has_vibrations(basis, body, touched, enrichment)
    if (touched or vibrations) and coarse is None:
        coarse = statics_body(body)
    if cubature is None:
        cubature = CONTACT_CUBATURE_ERROR if touched else CUBATURE_ERROR
    options = _Options(tools, held_out, enrichment, cubature, pressures, seed, coarse, repeated, vibrations, touched)
    if modes is not None:
        count = integer_in_range("modes", modes, 0 if enrichment is not None else 1)
        return _warned(_train(full, body, snapshots, count, options))
    if not held_out:
        raise InputError(
            "held_out must be given with a tolerance, got none; give held_out=, or modes= instead of tolerance="
        )
    largest, reached = number_in_range("tolerance", tolerance or 0.0, 0.0, 1.0, open_low=True), []
    for size in TRIED_MODES:
        try:
            model = _train(full, body, snapshots, size, options)
        except InputError as error:  # more modes than the snapshots hold
            reached.append(str(error))
            break
        mean_errors = model.report["held_out"]["mean"]
        worst = max(mean_errors[name] for name in ("displacement", "velocity", "reaction"))
        reached.append(f"{size}: {worst:.2%}")
        if worst <= largest:
            return _warned(model)
    raise InputError(
        f"tolerance must be attainable on the held-out runs, got {largest:.2%} with errors by modes "
        f"({', '.join(reached)}); increase it, or train on more runs"
    )


def _warned(model: ReducedModel) -> ReducedModel:
    """Return a model; warn if its errors on held-out runs are too large to use it."""
    if "advice" in model.report:
        warnings.warn(model.report["advice"], TrustWarning, stacklevel=3)
    return model


@dataclass(frozen=True)
class _Options:
    """Options of `hyper_reduce` for any number of modes."""

    tools: tuple[str, ...]
    held_out: Sequence[Trial]
    enrichment: Floats | None
    cubature: float
    pressures: int | None
    seed: int
    coarse: EnergySolid | None
    repeated: Sequence[Trial]
    vibrations: bool  # whether the modes are vibration modes and their derivatives
    touched: bool  # whether tools touch a solid anywhere


def _has_vibrations(
    basis: str | None,
    body: EnergyModel,
    contact: bool,
    enrichment: Floats | None,
) -> bool:
    """Return whether the modes are vibration modes; raise `InputError` or warn where the basis does not serve."""
    if basis not in (None, "pod", "vibrations"):
        raise InputError(f"basis must be 'pod' or 'vibrations', got {basis!r}; use one of them")
    if basis == "vibrations" and (body.kinematics.sheet or enrichment is not None):
        raise InputError("basis must be 'pod' for a membrane or with enrichment, got 'vibrations'; leave basis= out")
    if basis is None:
        return contact and enrichment is None
    if contact and basis == "pod" and enrichment is None:
        warnings.warn(
            "modes of runs with tools represent indentations at the places of those runs only, so that the force of a "
            "tool elsewhere can err several times; use basis='vibrations'",
            TrustWarning,
            stacklevel=3,
        )
    return basis == "vibrations"


def _check(full: NodalModel, points: Sequence[Floats]) -> None:
    for run_points in points:
        if run_points.shape != full.cloud.points.shape or not np.allclose(run_points, full.cloud.points):
            raise InputError(
                "trajectories must belong to the model's cloud, got one of another cloud; run the same model"
            )


def _train(full: NodalModel, body: EnergyModel, snapshots: Snapshots, size: int, options: _Options) -> ReducedModel:
    """Train a model with a given number of modes."""
    start = perf_counter()
    if options.vibrations:
        shapes = interpolated_modes(options.coarse or body, body, size)
        size, options = 0, replace(options, enrichment=shapes)
    columns = _basis_vectors(body, snapshots, size, options)
    states, projection_error = _states(body, columns, snapshots)
    model = ReducedModel(_data(full, body, snapshots, columns, states, options))
    if body.kinematics.sheet:
        trained = model.data.training_states
        taut = max(
            model.body.highest_frequency(state) for state in trained[:: max(1, len(trained) // FREQUENCY_STATES)]
        )
        model = ReducedModel(replace(model.data, taut_frequency=taut))
    rule = model.data.cubature
    report: dict[str, Any] = {
        "modes": columns.modes,
        "lifting_columns": columns.count - columns.modes,
        "nodes_full": len(body.cloud),
        "nodes": len(rule.nodes),
        "pressure_modes": len(rule.pressure),
        "residual_fields": columns.residual_fields,
        "cubature": options.cubature,
        "cubature_residual": rule.residual,
        "projection_error": projection_error,
        "modes_error": columns.lost,
        "highest_frequency": model.body.highest_frequency(np.zeros(columns.count)),
        "training_runs": len(snapshots.lengths),
        "snapshots": len(snapshots),
        "seed": options.seed,
        "training_seconds": perf_counter() - start,
    }
    if options.touched:
        solid = energy_solid(body)
        compliance, report["compliance_explained"], energy = fit_compliance(
            model, solid, snapshots, options.coarse or solid
        )
        model = ReducedModel(replace(model.data, compliance=compliance, flexibility_scale=max(energy, 1e-300)))
        if options.repeated:
            model, calibration = calibrate_contact(model, options.repeated)
            report |= calibration
        assert model.data.compliance is not None
        model = ReducedModel(replace(model.data, compliance=round_compliance(model.data.compliance)))
    model = model.with_report(report)
    if not options.held_out:
        return model
    model = _test(model, options.held_out)
    text = advice(model.report)
    return model if text is None else model.with_report({"advice": text})


@dataclass(frozen=True)
class _BasisVectors:
    """Basis vectors: modes, lifting vectors, support fields and residual fields.

    Modes and lifting vectors belong to the coordinates.
    """

    fields: Fields
    modes: int
    count: int
    residual_fields: int
    mass: Floats  # of the coordinates
    lost: float  # relative error of the modes by truncation between blocks


def _basis_vectors(body: EnergyModel, snapshots: Snapshots, size: int, options: _Options) -> _BasisVectors:
    lifting, supports = lifting_vectors(body, options.tools), support_fields(body, options.tools)
    rest = RemoveToolMotion(body, lifting, options.tools)
    main, lost = main_modes(body, snapshots, size, RESIDUAL_FIELDS, rest)
    rest.check()
    shapes = join(body, main[:size] if size else None, options.enrichment)
    residual_fields = orthogonal_complement(body, shapes, main[size:])
    # rounded to single precision as in the file, so that a saved and loaded model is identical
    columns = np.concatenate([shapes, lifting, supports, residual_fields]).astype(np.float32).astype(float)
    count = len(shapes) + len(lifting)
    flat = columns[:count].reshape(count, -1)
    mass = (flat * np.repeat(body.masses, 3)) @ flat.T
    fields = body.at_points(columns, slice(count, count + len(supports)))
    return _BasisVectors(fields, len(shapes), count, len(residual_fields), mass, lost)


def _states(body: EnergyModel, columns: _BasisVectors, snapshots: Snapshots) -> tuple[Floats, float]:
    """Return the coordinates (t, m + l) of all snapshots, and their relative projection error."""
    flat = columns.fields.columns[: columns.count].reshape(columns.count, -1)
    weighted, states, projection_error, total = flat * np.repeat(body.masses, 3), [], 0.0, 0.0
    largest, least = 0.0, MIN_DISPLACEMENT * body.cloud.spacing
    for block in snapshots.blocks(block_size(snapshots.nodes)):
        rows = block.reshape(len(block), -1)
        largest = max(largest, float(np.abs(rows).max()))
        coordinates = np.linalg.solve(columns.mass, weighted @ rows.T).T
        states.append(coordinates)
        total += float(np.linalg.norm(rows)) ** 2
        rows -= coordinates @ flat
        projection_error += float(np.linalg.norm(rows)) ** 2
    if largest < least:
        raise InputError(
            f"trajectories must move the body by at least {least:.3g} m, got {largest:.3g} m; train on larger loads"
        )
    return np.concatenate(states), float(np.sqrt(projection_error / total))


def _data(
    full: NodalModel, body: EnergyModel, snapshots: Snapshots, columns: _BasisVectors, states: Floats,
    options: _Options,
) -> ReducedData:  # fmt: skip
    """Choose the integration points, and return the data of the reduced model."""
    fields, modes, count, mass = columns.fields, columns.modes, columns.count, columns.mass
    chosen = states[snapshots.evenly_spaced(TRAINING_STATES)]
    moments = pressure_moments(body, snapshots, options.pressures or max(1, modes // MODES_PER_PRESSURE))
    without_residual = fields.of(slice(len(fields.columns) - columns.residual_fields))
    places, rule = choose_integration_points(
        body, without_residual, modes, chosen, mass, options.cubature, moments, options.seed
    )
    fields, gradients = scale_residual_fields(
        body, fields, (modes, columns.residual_fields), chosen, rule, places, moments
    )
    data = ReducedData(
        cloud=body.cloud,
        tissue=body.tissue,
        supports=body.supports,
        prescribed=options.tools,
        volumes=body.volumes,
        stiffness_damping=full.stiffness_damping,
        mass_damping=full.mass_damping,
        wave_speed=full.wave_speed,
        basis_vectors=fields.columns,
        modes=modes,
        lifting_count=count - modes,
        cubature=rule,
        gradients=gradients,
        constant=fields.constant,
        training_states=chosen,
        distance_scale=_distance_scale(chosen, mass / body.masses.sum(), snapshots),
        speed_scale=_speed_scale(states, mass / body.masses.sum(), snapshots, options),
        nearness_scale=_nearness_scale(body, snapshots),
        residual_fields=columns.residual_fields,
        kinematics=body.kinematics,
    )
    if not columns.residual_fields:
        return data
    some = snapshots.each(snapshots.evenly_spaced(TRAINING_STATES))
    return replace(data, residual_scale=typical_residual(ReducedModel(data), body, some))


def _test(model: ReducedModel, held_out: Sequence[Trial]) -> ReducedModel:
    """Run the held-out motions; return the model with their errors in its report and calibrated scales."""
    with warnings.catch_warnings(action="ignore", category=TrustWarning):  # its scales are not calibrated yet
        tested = in_threads(partial(_test_run, model), held_out)
    entries, frames = [entry for entry, _, _ in tested], [each for _, each, _ in tested if each is not None]
    touched = [entry for entry in entries if entry["failed"] or "force" in entry]
    missed, total = np.sum([squares for _, _, squares in tested], axis=0)
    report: dict[str, Any] = {"runs": entries, **_over_runs(entries, list(Errors.__annotations__))}
    report["projection_error"] = float(np.sqrt(missed / total)) if total else 0.0
    if any(not entry["failed"] for entry in touched):
        report["contact"] = _over_runs(touched, list(ContactErrors.__annotations__))
    if not frames:
        return model.with_report({"held_out": report})
    scales = calibrate_scales([run.measures for run in frames], ERROR_QUANTILE)
    report["expected_error"] = error_curves(frames, scales, 0.5 * model.data.mass_damping)
    return ReducedModel(replace(model.data, **scales._asdict())).with_report({"held_out": report})


def _test_run(model: ReducedModel, trial: Trial) -> tuple[dict[str, Any], Frames | None, tuple[float, float]]:
    """Repeat a held-out run; return its errors and frames, or why it failed, and what its modes miss of it.

    The last two numbers are squares: of the displacements that the modes do not represent, and of all.
    """
    loads, kept = trial
    run = kept if isinstance(kept, Trajectory) else Trajectory.load(kept)
    rest = run.displacements - np.tensordot(
        model.body.project(run.displacements), model.data.basis_vectors[: model.count], 1
    )
    squares = float(np.linalg.norm(rest)) ** 2, float(np.linalg.norm(run.displacements)) ** 2
    try:
        reduced, frames = repeat_run(model, loads, run)
        errors = relative_errors(run, reduced).as_dict() | _contact_errors(model, loads, run, reduced)
        return {"failed": False} | errors, frames, squares
    except DivergenceError as error:
        return {"failed": True, "reason": str(error)}, None, squares


def _contact_errors(
    model: ReducedModel, loads: Sequence[Load], run: Trajectory, reduced: Trajectory
) -> dict[str, float]:
    """Return the errors of contact by name; none without contact."""
    tools = [load.name for load in loads if isinstance(load, Contact | Grasp)]
    errors = (
        contact_errors(run, reduced, tools, model.data.compliance.nodes) if model.data.compliance is not None else None
    )
    return errors.as_dict() if errors is not None else {}


def _over_runs(entries: Sequence[dict[str, Any]], names: Sequence[str]) -> dict[str, dict[str, float]]:
    """Return mean and 95th percentile of the errors of runs; infinite if one of them failed."""
    failed = any(entry["failed"] for entry in entries)
    values = {name: np.inf if failed else np.array([entry[name] for entry in entries]) for name in names}
    return {
        "mean": {name: float(np.mean(errors)) for name, errors in values.items()},
        "percentile_95": {name: float(np.quantile(errors, ERROR_QUANTILE)) for name, errors in values.items()},
    }


def _speed_scale(states: Floats, mass: Floats, snapshots: Snapshots, options: _Options) -> float:
    """Return the largest speed [m/s] that most runs do not exceed; unlimited without times.

    It is that of the tools in contact, or of the body, as in `palpate.ReducedModel.speed`.
    """
    fastest, parts = [], np.split(states, np.cumsum(snapshots.lengths)[:-1])
    root = np.asarray(np.linalg.cholesky(mass), dtype=float)
    of_tools = snapshots.has_contact and not options.tools
    for run, coordinates in zip(snapshots.runs, parts, strict=True):
        if not (len(run.times) == len(coordinates) > 1 and np.all(np.diff(run.times) > 0)):
            continue
        if of_tools:
            fastest.append(_speed_in_contact(run))
            continue
        velocities = np.diff(coordinates, axis=0) / np.diff(run.times)[:, None]
        fastest.append(float(rms_speeds(root, velocities).max()))
    return FRAME_SPEED_MARGIN * _of_most_runs(fastest)


def _speed_in_contact(run: Any) -> float:
    """Return the largest mean speed [m/s] between frames of the nodes that tools touch, weighted by their forces."""
    rows, times = np.asarray(run.contact_forces), np.asarray(run.times)
    frames, fastest = rows[:, 0].astype(int), 0.0
    for frame in np.unique(frames[frames > 0]):
        nodes, forces = rows[frames == frame, 1].astype(int), np.linalg.norm(rows[frames == frame, 2:], axis=1)
        moved = np.asarray(run.displacements[int(frame)])[nodes] - np.asarray(run.displacements[int(frame) - 1])[nodes]
        if forces.any():
            speeds = np.linalg.norm(moved, axis=1) / (times[frame] - times[frame - 1])
            fastest = max(fastest, float(np.average(speeds, weights=forces)))
    return fastest


def _nearness_scale(body: EnergyModel, snapshots: Snapshots) -> float:
    """Return the largest nearness of tools to supports that most runs do not exceed; unlimited without contact."""
    nearness, nearest = nearness_to_supports(body.cloud, body.supports, np.arange(len(body.cloud))), []
    for run in snapshots.runs:
        rows = np.asarray(run.contact_forces)
        if len(rows):
            frames, near = rows[:, 0], nearness[rows[:, 1].astype(int)]
            in_frames = (frames == frame for frame in np.unique(frames))
            nearest.append(max(support_nearness(near[kept], rows[None, kept, 2:]) for kept in in_frames))
    return _of_most_runs(nearest)


def _of_most_runs(values: Sequence[float]) -> float:
    """Return the value that most runs do not exceed; unlimited without values, or where they are zero."""
    scale = float(np.quantile(values, ERROR_QUANTILE, method="higher")) if len(values) else 0.0
    return scale if scale > 0.0 else UNLIMITED_SCALE


def _distance_scale(chosen: Floats, mass: Floats, snapshots: Snapshots) -> float:
    """Return the distance that most training states keep to other runs, or to the next frame with one run."""
    runs = len(snapshots.lengths)
    owner = np.repeat(np.arange(runs), snapshots.lengths)[snapshots.evenly_spaced(TRAINING_STATES)]
    distances = []
    for run in range(runs):
        of_run = owner == run
        if of_run.any() and (~of_run).any():
            distances.append(distances_to_nearest(chosen[of_run], chosen[~of_run], mass))
    if not distances:
        distances = [np.asarray(np.linalg.norm(np.diff(chosen, axis=0) @ np.linalg.cholesky(mass), axis=1))]
    return max(float(np.quantile(np.concatenate(distances), ERROR_QUANTILE)), 1e-300)
