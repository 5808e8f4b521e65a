"""Measures of a method: time, memory, stability, errors at both loads, and frequency response."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.app.common.console import Console, percent
from palpate.app.compare.bodies import ComparedBody
from palpate.arrays import Floats
from palpate.dynamics.run.model import Model
from palpate.dynamics.run.rollout import rollout
from palpate.dynamics.run.trajectory import Trajectory
from palpate.faults import DivergenceError, InputError, TrustWarning
from palpate.reduction.lti.model import LinearModel, propagate
from palpate.reduction.lti.reductors import TITLE_BY_METHOD, Reduction
from palpate.reduction.lti.simulate import input_sizes
from palpate.reduction.lti.system import LinearSystem, linearise
from palpate.reduction.training.errors import relative_errors

__all__ = ["Comparison", "compare_methods", "prepare_comparison"]


LOAD_NAMES = ("small", "large")
CONDENSED_FREQUENCIES, FULL_FREQUENCIES, RESONANT_FREQUENCIES = (
    240,
    10,
    24,
)  # frequencies: of the condensed body, of the whole one, and resonances among them
TIMING_ROUNDS, TIMED_STEPS = 7, 2000  # of the timing of a step
MIN_INPUT_WEIGHT = 1e-2  # least weight of an input, over that of the input that the run drives most
STEP_SECONDS = 1e-3  # [s] of the step that is timed


@dataclass
class Comparison:
    """Models of a comparison, and their results.

    Parameters
    ----------
    body : ComparedBody
    system : LinearSystem
    reduction : Reduction
    runs : dict of str to Trajectory
        Of the full, nonlinear body with the small and the large load.
    frequencies : (t,) array [rad/s]
    response : (t, q, p) array
        Of the body that is balanced.
    few : (w,) array [rad/s]
    whole : (w, q, p) array
        Of the whole linear body at a few frequencies.
    entries : list of dict
        One for every method and number of modes.
    nonlinear : list of dict
        One for every number of modes of the nonlinear reduced model.
    models : dict
        Linear models by method and number of modes.
    """

    body: ComparedBody
    system: LinearSystem
    reduction: Reduction
    runs: dict[str, Trajectory] = field(default_factory=dict)
    frequencies: Floats = field(default_factory=lambda: np.zeros(0))
    response: NDArray[np.complex128] = field(default_factory=lambda: np.zeros((0, 0, 0), dtype=complex))
    few: Floats = field(default_factory=lambda: np.zeros(0))
    whole: NDArray[np.complex128] = field(default_factory=lambda: np.zeros((0, 0, 0), dtype=complex))
    entries: list[dict[str, Any]] = field(default_factory=list)
    nonlinear: list[dict[str, Any]] = field(default_factory=list)
    models: dict[tuple[str, int], LinearModel] = field(default_factory=dict)


def prepare_comparison(body: ComparedBody, condense: int | None, console: Console) -> Comparison:
    """Run the full body with both loads, linearise it, and find its frequency response."""
    start = perf_counter()
    system = linearise(body.model, body.loads(body.small), body.outputs)
    console.say(f"linearised {system.order} unknowns: {perf_counter() - start:.1f} s")
    training = (body.loads(body.small), body.duration, body.every)
    sizes = input_sizes(system, body.loads(body.small), body.duration)
    emphasis = np.maximum(sizes / sizes.max(), MIN_INPUT_WEIGHT)
    made = Comparison(body, system, Reduction(system, condense=condense, training=training, emphasis=emphasis))
    for name, size in zip(LOAD_NAMES, (body.small, body.large), strict=True):
        run = rollout(body.model, body.loads(size), duration=body.duration, every=body.every)
        made.runs[name] = run
        console.say(f"full body, {size:g} {body.unit}: {run.wall_seconds:.1f} s, {int(run.steps[-1])} steps")
    with console.status("frequency response of the linear body"):
        _respond(made)
    return made


def _respond(made: Comparison) -> None:
    source = made.reduction.source
    poles = source.poles()
    moving = np.sort(np.abs(poles[poles.imag > 0]))
    low, high = 0.2 * moving[0], moving[-1]
    spread = np.geomspace(low, high, CONDENSED_FREQUENCIES)
    made.frequencies = np.unique(np.concatenate([spread, moving[:RESONANT_FREQUENCIES]]))
    made.response = source.transfer(1j * made.frequencies)
    made.few = np.unique(np.concatenate([moving[:2], np.geomspace(low, high, FULL_FREQUENCIES)]))
    made.whole = made.system.frequency_response(made.few)


def compare_methods(made: Comparison, methods: list[str], sizes: list[int], console: Console) -> None:
    """Make and measure linear models by all methods and sizes, and nonlinear ones of the same sizes."""
    for method in methods:
        for size in sizes:
            entry: dict[str, Any] = {"method": method, "name": TITLE_BY_METHOD[method], "modes": size, "failed": False}
            try:
                model = made.reduction.model(method, size)
            except (InputError, np.linalg.LinAlgError, ValueError) as error:
                entry |= {"failed": True, "reason": " ".join(str(error).split())}
                console.say(f"{method}, {size} modes: failed: {entry['reason']}")
            else:
                entry |= _model_entry(made, model)
                made.models[method, size] = model
                shown = ", ".join(f"{name} load {_error_text(entry['errors'][name])}" for name in LOAD_NAMES)
                console.say(f"{method}, {size} modes: {shown}")
            made.entries.append(entry)
    for size in sizes:
        made.nonlinear.append(_nonlinear(made, size, console))


def _error_text(errors: dict[str, Any] | None) -> str:
    return "failed" if errors is None else f"displacement error {percent(errors['displacement'])}"


def _model_entry(made: Comparison, model: LinearModel) -> dict[str, Any]:
    """Measure a linear model."""
    s = 1j * made.frequencies
    outputs, inputs = made.reduction.scales
    apart = outputs[:, None] * (made.response - model.reduced.transfer(s)) * inputs
    scaled_response = outputs[:, None] * made.response * inputs
    wrong, size = (np.linalg.norm(matrix, 2, axis=(1, 2)) for matrix in (apart, scaled_response))
    poles = model.poles
    return {
        "states": model.reduced.states,
        "coordinates": model.count,
        "offline_seconds": model.report["seconds"],
        "shared_seconds": model.report["shared_seconds"],
        "step_seconds": _step_seconds(model),
        "step_bytes": int(sum(array.nbytes for array in model._propagator(STEP_SECONDS))),
        "field_bytes": int(model.columns.nbytes),
        "stable": model.stable,
        "growth": float(poles.real.max()),
        "response_error": float(wrong.max() / size.max()),
        "absolute_error": float(wrong.max()),
        "hankel_bound": made.reduction.bound(model.reduced.states),
        "errors": {name: _run_errors(made, model, name) for name in LOAD_NAMES},
    }


def _run_errors(made: Comparison, model: Model, load: str) -> dict[str, float] | None:
    """Errors against the full nonlinear body; None for a run that diverged."""
    body, full = made.body, made.runs[load]
    size = body.small if load == "small" else body.large
    try:
        with warnings.catch_warnings(action="ignore", category=TrustWarning):  # errors are measured
            run = rollout(model, body.loads(size), duration=body.duration, every=body.every, progress=False)
    except DivergenceError:
        return None
    errors = relative_errors(full, run)
    return errors.as_dict() | {"wall_seconds": run.wall_seconds}


def _step_seconds(model: LinearModel) -> float:
    """Time [s] of one compiled step of a millisecond, the median of some rounds."""
    forces = model.system.forces
    f, kicks = np.zeros((TIMED_STEPS + 1, forces)), np.zeros((TIMED_STEPS + 1, model.lifting_count))
    x, parts = np.zeros(len(model.A)), model._propagator(STEP_SECONDS)
    history, times = np.zeros((TIMED_STEPS + 1, len(x))), []
    for _ in range(TIMING_ROUNDS + 1):
        start = perf_counter()
        propagate(x, *parts, f, kicks, history)
        times.append((perf_counter() - start) / TIMED_STEPS)
    return float(np.median(times[1:]))


def _nonlinear(made: Comparison, size: int, console: Console) -> dict[str, Any]:
    """Train and run the nonlinear reduced model of a size."""
    body, entry = made.body, dict[str, Any](modes=size, failed=False)
    start = perf_counter()
    try:
        model = body.nonlinear(made.runs["large"], size)
    except InputError as error:
        return entry | {"failed": True, "reason": " ".join(str(error).split())}
    entry["offline_seconds"] = perf_counter() - start
    entry["errors"] = {name: _run_errors(made, model, name) for name in LOAD_NAMES}
    console.say(f"{body.nonlinear_name}, {size} modes: large load {_error_text(entry['errors']['large'])}")
    return entry
