"""Training of a reduced model from runs of a full one, with its errors on held-out runs."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from time import perf_counter
from typing import Any

import numpy as np

from palpate.core.arrays import Floats
from palpate.core.faults import InputError, TrustWarning, check_call, integer_in_range, number_in_range, user_level
from palpate.dynamics.loads.prepared import listed
from palpate.dynamics.membrane.model import Membrane
from palpate.dynamics.nodal.energy_model import EnergyModel, Fields
from palpate.dynamics.nodal.model import NodalModel
from palpate.dynamics.run.trajectory import StoredTrajectory, Trajectory
from palpate.dynamics.solid.model import EnergySolid, Solid, energy_solid
from palpate.reduction.basis.incremental_pod import block_size
from palpate.reduction.basis.lifting import RemoveToolMotion, lifting_and_test_fields
from palpate.reduction.basis.linear_modes import interpolated_modes
from palpate.reduction.basis.snapshots import Run, Snapshots
from palpate.reduction.basis.strain_pod import join, main_modes
from palpate.reduction.contact.coarse_body import statics_body
from palpate.reduction.hyper.data import SampledBasis, TrainedRange, TrialAndTestBasis
from palpate.reduction.hyper.model import ReducedData, ReducedModel
from palpate.reduction.training.advice import advice
from palpate.reduction.training.calibrate_contact import GivenTrial, Trial, calibrate_contact
from palpate.reduction.training.ecsw import choose_cubature_points
from palpate.reduction.training.fit_compliance import fit_compliance
from palpate.reduction.training.held_out import errors_on_held_out
from palpate.reduction.training.residual_fields import (
    RESIDUAL_FIELDS,
    orthogonal_complement,
    scale_residual_fields,
    typical_residual,
)
from palpate.reduction.training.round_compliance import round_compliance
from palpate.reduction.training.scales import scales_of_training

__all__ = ["Trial", "hyper_reduce"]

Coarsen = Callable[[EnergyModel], Solid | None]  # returns a coarser model of a body, or None if it serves

TRIED_MODES = (8, 12, 16, 24, 32, 48, 64, 96)  # numbers of modes for a given tolerance
# largest relative error of sampled forces: where tools touch a body anywhere, and elsewhere
CONTACT_CUBATURE_ERROR, CUBATURE_ERROR = 1e-2, 1e-3
PRESSURE_STATES = 240  # training states for the pressure modes
TRAINING_STATES = 240  # for the fit of the cubature
MIN_DISPLACEMENT = 1e-10  # of the largest one in training over the spacing; strains below are lost by rounding
MODES_PER_PRESSURE = 4  # more pressure modes would cause volumetric locking
FREQUENCY_STATES = 16  # training states for the highest frequency of a membrane


@check_call
def hyper_reduce(
    full: Solid | Membrane,
    trajectories: Run | Sequence[Run],
    *,
    modes: int | None = None,
    tolerance: float | None = None,
    prescribed: str | Sequence[str] = (),
    held_out: Sequence[GivenTrial] = (),
    enrichment: Floats | None = None,
    cubature: float | None = None,
    pressures: int | None = None,
    basis: str | None = None,
    coarse: Solid | Coarsen | None = None,
    repeated: Sequence[GivenTrial] = (),
    seed: int = 0,
) -> ReducedModel:
    """Train a reduced model on runs of a full one: modes, cubature points, errors and error indicator.

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
        Groups that rigid tools hold and move (`PrescribedMotion`). Each has lifting functions for its
        translations and rotations, so its pose is arbitrary, and its force is an output.
    held_out : sequence of (loads, trajectory or path)
        Runs outside the training data. The reduced model repeats them and reports its errors, and the
        table of errors by error indicator (`ReducedModel.expected_error`).
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
    coarse : Solid or function, optional
        A coarser model of the same body, of at most 5,000 nodes, for its vibrations, and for its statics, which
        give the surface compliance under tools in contact. A function returns one for the body in its energy form, or
        None if the body serves. By default the body itself, or of a larger one its surface filled again with about
        3,000 nodes (`palpate.reduction.contact.coarse_body`).
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
    _check_runs(full, snapshots, held_out)
    body = _energy_form(full)
    tools = (prescribed,) if isinstance(prescribed, str) else tuple(prescribed)
    touched = snapshots.has_contact and not tools and not body.kinematics.sheet
    vibrations = _has_vibrations(basis, body, touched, enrichment)
    options = _Options(
        tools=tools,
        held_out=[(listed(loads), run) for loads, run in held_out],
        repeated=[(listed(loads), run) for loads, run in repeated],
        enrichment=enrichment,
        cubature=_cubature_error(cubature, touched),
        pressures=pressures,
        seed=seed,
        coarse=_coarser(body, coarse, touched or vibrations),
        vibrations=vibrations,
        touched=touched,
    )
    if modes is not None:
        count = integer_in_range("modes", modes, 0 if enrichment is not None else 1)
        return _warn_if_inaccurate(_train(body, snapshots, count, options))
    return _warn_if_inaccurate(_train_to_tolerance(body, snapshots, tolerance or 0.0, options))


def _warn_if_inaccurate(model: ReducedModel) -> ReducedModel:
    """Return a model; warn if its errors on held-out runs are too large to use it."""
    if "advice" in model.report:
        warnings.warn(model.report["advice"], TrustWarning, stacklevel=user_level())
    return model


@dataclass(frozen=True)
class _Options:
    """Options of `hyper_reduce` for any number of modes."""

    tools: tuple[str, ...]
    held_out: Sequence[Trial]
    repeated: Sequence[Trial]
    enrichment: Floats | None
    cubature: float
    pressures: int | None
    seed: int
    coarse: EnergySolid | None  # model for vibrations and statics; the body if None
    vibrations: bool  # whether the modes are vibration modes and their derivatives
    touched: bool  # whether tools touch a solid anywhere


def _check_runs(full: Solid | Membrane, snapshots: Snapshots, held_out: Sequence[GivenTrial]) -> None:
    """Refuse runs of another cloud."""
    tried = [(run if isinstance(run, Trajectory) else StoredTrajectory(run)).points for _, run in held_out]
    for points in (*snapshots.points, *tried):
        if points.shape != full.cloud.points.shape or not np.allclose(points, full.cloud.points):
            raise InputError(
                "trajectories must belong to the model's cloud, got one of another cloud; run the same model"
            )


def _energy_form(full: Solid | Membrane) -> EnergyModel:
    """Return the energy form of a body; refuse a body that has no reduced model."""
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
    return body


def _cubature_error(given: float | None, touched: bool) -> float:
    """Return the largest relative error of the sampled forces."""
    if given is None:
        return CONTACT_CUBATURE_ERROR if touched else CUBATURE_ERROR
    return number_in_range("cubature", given, 0.0, 1.0)


def _coarser(body: EnergyModel, coarse: Solid | Coarsen | None, needed: bool) -> EnergySolid | None:
    """Return the coarser model of a body, by the caller's function or by `statics_body`; None if the body serves."""
    if coarse is not None and not callable(coarse):
        return energy_solid(coarse, "coarse")
    if not needed:
        return None
    made = statics_body(body) if coarse is None else coarse(body)
    return None if made is None else energy_solid(made, "coarse")


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
            stacklevel=user_level(),
        )
    return basis == "vibrations"


def _train_to_tolerance(body: EnergyModel, snapshots: Snapshots, tolerance: float, options: _Options) -> ReducedModel:
    """Train the smallest model of `TRIED_MODES` whose errors on the held-out runs are at most a tolerance."""
    if not options.held_out:
        raise InputError(
            "held_out must be given with a tolerance, got none; give held_out=, or modes= instead of tolerance="
        )
    largest, reached = number_in_range("tolerance", tolerance, 0.0, 1.0, open_low=True), []
    for size in TRIED_MODES:
        try:
            model = _train(body, snapshots, size, options)
        except InputError as error:  # more modes than the snapshots hold
            reached.append(str(error))
            break
        mean_errors = model.report["held_out"]["mean"]
        worst = max(mean_errors[name] for name in ("displacement", "velocity", "reaction"))
        reached.append(f"{size}: {worst:.2%}")
        if worst <= largest:
            return model
    raise InputError(
        f"tolerance must be attainable on the held-out runs, got {largest:.2%} with errors by modes "
        f"({', '.join(reached)}); increase it, or train on more runs"
    )


def _train(body: EnergyModel, snapshots: Snapshots, size: int, options: _Options) -> ReducedModel:
    """Train a model with a given number of modes."""
    start = perf_counter()
    if options.vibrations:
        assert isinstance(body, EnergySolid)  # a sheet is slack at rest
        shapes = interpolated_modes(options.coarse or body, body, size)
        size, options = 0, replace(options, enrichment=shapes)
    columns = _trial_and_test_basis(body, snapshots, size, options)
    states, projection_error = _states(body, columns, snapshots)
    model = ReducedModel(_data(body, snapshots, columns, states, options))
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
        assert isinstance(body, EnergySolid)
        compliance, report["compliance_explained"], energy = fit_compliance(
            model, body, snapshots, options.coarse or body
        )
        data = model.data.with_scales(flexibility_scale=max(energy, 1e-300))
        model = ReducedModel(replace(data, compliance=compliance))
        if options.repeated:
            model, calibration = calibrate_contact(model, options.repeated)
            report |= calibration
        assert model.data.compliance is not None
        model = model.with_data(compliance=round_compliance(model.data.compliance))
    model = model.with_report(report)
    if not options.held_out:
        return model
    model = errors_on_held_out(model, options.held_out)
    text = advice(model.report)
    return model if text is None else model.with_report({"advice": text})


@dataclass(frozen=True)
class _BasisFields:
    """Basis vectors at all points: modes, lifting functions, support fields and residual fields.

    Modes and lifting functions belong to the coordinates.
    """

    fields: Fields
    modes: int
    count: int
    residual_fields: int
    mass: Floats  # of the coordinates
    lost: float  # relative error of the modes by truncation between blocks


def _trial_and_test_basis(body: EnergyModel, snapshots: Snapshots, size: int, options: _Options) -> _BasisFields:
    lifting, supports = lifting_and_test_fields(body, options.tools)
    rest = RemoveToolMotion(body, lifting, options.tools)
    main, lost = main_modes(body, snapshots, size, RESIDUAL_FIELDS, rest)
    shapes = join(body, main[:size] if size else None, options.enrichment)
    rest.check()
    residual_fields = orthogonal_complement(body, shapes, main[size:])
    # rounded to single precision as in the file, so that a saved and loaded model is identical
    columns = np.vstack([shapes, lifting, supports, residual_fields]).astype(np.float32).astype(float)
    count = len(shapes) + len(lifting)
    flat = columns[:count].reshape(count, -1)
    mass = (flat * np.repeat(body.masses, 3)) @ flat.T
    fields = body.at_points(columns, slice(count, count + len(supports)))
    return _BasisFields(fields, len(shapes), count, len(residual_fields), mass, lost)


def _states(body: EnergyModel, columns: _BasisFields, snapshots: Snapshots) -> tuple[Floats, float]:
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
    body: EnergyModel, snapshots: Snapshots, columns: _BasisFields, states: Floats, options: _Options
) -> ReducedData:
    """Choose the cubature points, and return the data of the reduced model."""
    fields, modes, mass = columns.fields, columns.modes, columns.mass
    chosen = states[snapshots.evenly_spaced(TRAINING_STATES)]
    of_tools = snapshots.has_contact and not options.tools
    scales = scales_of_training(body, snapshots, states, chosen, mass / body.masses.sum(), of_tools)
    at = np.arange(0, len(snapshots), max(1, len(snapshots) // PRESSURE_STATES))
    moments = body.pressure_moments(snapshots.each(at), options.pressures or max(1, modes // MODES_PER_PRESSURE))
    without_residual = fields.of(slice(len(fields.columns) - columns.residual_fields))
    places, rule = choose_cubature_points(
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
        stiffness_damping=body.stiffness_damping,
        mass_damping=body.mass_damping,
        wave_speed=body.wave_speed,
        basis=TrialAndTestBasis(fields.columns, modes, columns.count - modes, columns.residual_fields),
        sampled=SampledBasis(rule, gradients, fields.constant),
        trained=TrainedRange(chosen, scales),
        kinematics=body.kinematics,
    )
    if columns.residual_fields:
        some = snapshots.each(snapshots.evenly_spaced(TRAINING_STATES))
        data = data.with_scales(residual_scale=typical_residual(ReducedModel(data), body, some))
    if not body.kinematics.sheet:
        return data
    return replace(data, trained=replace(data.trained, taut_frequency=_taut_frequency(ReducedModel(data))))


def _taut_frequency(model: ReducedModel) -> float:
    """Return the highest frequency [rad/s] of a membrane in its training states."""
    states = model.data.training_states
    return max(map(model.body.highest_frequency, states[:: max(1, len(states) // FREQUENCY_STATES)]))
