"""Calibration of the error indicator on held-out runs: its scales, and the errors expected at a trust number.

Frames of one run err together. So all quantiles count runs, not frames. The error bound is a conformal
prediction of runs (Vovk, Gammerman and Shafer, Algorithmic Learning in a Random World, Springer 2005;
Barber et al., Ann. Stat. 49, 2021, for its leave-one-out form): the mean of the present and the typical
size, times a power of the largest trust number so far, times a factor. The exponent is fitted between
runs. The factor of a run is the largest ratio of its errors to the product by the exponent of the other
runs. The k-th smallest factor of n runs bounds that of one more run with a probability of about
k / (n + 1). That is a mean over campaigns. The share of runs that keep the bound of one campaign has the
beta distribution B(k, n + 1 - k) (Vovk, Asian Conference on Machine Learning 2012), whose tenth
percentile the campaign at hand exceeds with a confidence of 90 %.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.special import betaincinv

from palpate.arrays import Floats
from palpate.dynamics.loads.prepared import Load, PreparedLoads
from palpate.dynamics.run.model import State
from palpate.dynamics.run.trajectory import Trajectory
from palpate.reduction.contact.compliance import contact_displacements
from palpate.reduction.contact.tools import contact_at_frame
from palpate.reduction.hyper.data import UNLIMITED_SCALE
from palpate.reduction.hyper.error_indicator import (
    approach_speeds,
    force_sizes,
    mean_size,
    residual_norm,
    rms_sizes,
    rms_speeds,
    tools_of,
    touch_speed,
    training_distance,
)
from palpate.reduction.hyper.load_share import MAX_LOAD_SCALE, MIN_LOAD_SCALE
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.hyper.reactions import constraint_forces

BOUND_PROBABILITY = 0.95  # probability that a run keeps the bound
CONFIDENCE_LEVEL = 0.9  # that at least a share of the runs keeps the bound of a campaign
REPEAT_MARGIN = 1.001  # a margin, by which the trust number of a held-out run stays below 1 when it is repeated
# Least trust number that counts. The first errors of a force, at touch, do not depend on the trust number.
LEAST_TRUST = {"displacement": 0.05, "force": 0.4}
MIN_ERROR = 1e-12  # smallest error in a logarithm, relative
MAX_EXPONENT = 2.0  # of the trust number
EXPONENT_RIDGE = 0.3  # added to the sum of squares of logarithms: few runs show little of the exponent


class Measures(NamedTuple):
    """The measures of the error indicator in the frames of a run."""

    # distances, residual_norms: (f,) arrays [m]: see `palpate.reduction.hyper.error_indicator`
    distances: Floats
    residual_norms: Floats
    load_shares: Floats  # (f,) array: see `palpate.reduction.hyper.load_share`
    flexibility_energies: Floats  # (f,) array [J]: energy of the surface compliance
    speeds: Floats  # (f,) array [m/s]: of tools that move into the body, or of the body
    nearness: Floats  # (f,) array: of tools to supports


class Frames(NamedTuple):
    """Frames of a held-out run of a reduced model."""

    measures: Measures
    # mapping of quantity to (f,) array: of ``"displacement"``, the root mean square over the body [m], and with tools
    # of ``"force"``, the largest over the tools [N]
    errors: dict[str, Floats]
    sizes: dict[str, Floats]  # mapping of quantity to (f,) array: displacement [m] or tool force [N] of the reduced run


class Scales(NamedTuple):
    """Scales of the measures, at which the trust number is 1; see `palpate.ReducedModel`."""

    distance_scale: float
    residual_scale: float
    load_scale: float
    flexibility_scale: float
    speed_scale: float
    nearness_scale: float


def held_out_frames(model: ReducedModel, loads: Sequence[Load], run: Trajectory, full: Trajectory) -> Frames:
    """Return measures and errors of all frames of a reduced model's run."""
    prepared, weights = model.prepare(loads), model.masses / model.masses.sum()
    contact_forces = [contact_at_frame(run, k, len(model.cloud)) for k in range(len(run.times))]
    moved, energies = zip(*(_contact_displacements(model, run, k) for k in range(len(run.times))), strict=True)
    coordinates, velocities = model.body.project(run.displacements - moved), model.body.project(run.velocities)
    states: list[State] = []
    work = model.workspace()
    for a, v, time in zip(coordinates, velocities, run.times.tolist(), strict=True):
        last = states[-1] if states else None
        history = (
            model.body.history_after(a, last.history, time - last.time, work)
            if last
            else model.body.equilibrium_history(a, work)
        )
        states.append(State(a, v, time, history=history, contact_state=contact_forces[len(states)]))
    measures = Measures(
        np.array([training_distance(model.body, state) for state in states]),
        np.array([residual_norm(model.data, constraint_forces(model.body, state, prepared)) for state in states]),
        np.array([model.load_share(state, prepared) for state in states]),
        np.array(energies),
        _speeds(model, prepared, run, velocities),
        np.array([model.support_nearness(state) for state in states]),
    )
    missed = np.einsum("tnc,n->t", (run.displacements - full.displacements) ** 2, weights)
    errors, sizes = {"displacement": np.sqrt(missed)}, {"displacement": rms_sizes(model.data, run)}
    tools = [name for name in tools_of(model.data, run) if name in full.reactions]
    if tools:
        missed = [np.linalg.norm(run.reactions[name] - full.reactions[name], axis=1) for name in tools]
        errors["force"], sizes["force"] = np.max(missed, axis=0), force_sizes(model.data, run)
    return Frames(measures, errors, sizes)


def _speeds(model: ReducedModel, prepared: PreparedLoads, run: Trajectory, velocities: Floats) -> Floats:
    """Return the speeds (f,) [m/s] of `palpate.ReducedModel.speed` in all frames of a run."""
    if model.data.compliance is None:
        return rms_speeds(model.body.trained[1], velocities)
    if not prepared.tools:
        return np.zeros(len(run.times))
    forces = np.stack([run.reactions[tool.name] for tool in prepared.tools], axis=1)
    return np.asarray(approach_speeds(prepared, run.times, forces).max(axis=1))


def _contact_displacements(model: ReducedModel, run: Trajectory, frame: int) -> tuple[Floats, float]:
    """Return displacements (n, 3) [m] and energy [J] of the surface compliance by the stored forces of a frame."""
    compliance, of_frame = model.data.compliance, run.contact_forces[:, 0] == frame
    if compliance is None or not of_frame.any():
        return np.zeros((len(model.cloud), 3)), 0.0
    rows, bonded = run.contact_forces[of_frame], run.bonded[of_frame]
    pushes = np.zeros((2, len(model.cloud), 3))
    pushes[bonded.astype(int), rows[:, 1].astype(int)] = rows[:, 2:]
    return contact_displacements(compliance, model.cloud.points, pushes[:, compliance.nodes], [False, True])


def calibrate_scales(runs: Sequence[Measures], share: float) -> Scales:
    """Return the scales of the measures.

    With these scales the trust number is at most 1 in all frames of a given share of the runs, unless the
    scale of the load shares would be above `MAX_LOAD_SCALE`.
    """
    energy = max(_run_quantile([run.flexibility_energies.max(initial=0.0) for run in runs], share), 1e-300)
    measures = [run._replace(speeds=touch_speed(run.speeds, run.flexibility_energies, energy)) for run in runs]
    quantiles = [
        _run_quantile([values.max(initial=0.0) for values in each], share) for each in zip(*measures, strict=True)
    ]
    scales = Scales(*(max(value, 1e-300) for value in quantiles))
    if not any(run.nearness.any() for run in runs):  # without tools or supports
        scales = scales._replace(nearness_scale=UNLIMITED_SCALE)
    scales = scales._replace(load_scale=max(scales.load_scale, MIN_LOAD_SCALE))
    wider = max(_run_quantile([float(trust_numbers(run, scales).max()) for run in runs], share), 1.0)
    wider *= REPEAT_MARGIN
    return Scales(
        wider * scales.distance_scale,
        wider * scales.residual_scale,
        min(wider * scales.load_scale, MAX_LOAD_SCALE),
        wider**2 * scales.flexibility_scale,
        wider * scales.speed_scale,
        min(wider * scales.nearness_scale, UNLIMITED_SCALE),
    )


def _run_quantile(values: Sequence[float], share: float) -> float:
    """Return the value that at least a share of all values do not exceed."""
    return float(np.quantile(values, share, method="higher"))


def trust_numbers(run: Measures, scales: Scales) -> Floats:
    """Return the trust numbers (f,) of the frames of a run."""
    ratios = [values / scale for values, scale in zip(run, scales, strict=True)]
    touching = touch_speed(run.speeds, run.flexibility_energies, scales.flexibility_scale) / scales.speed_scale
    return np.asarray(np.max([*ratios[:3], np.sqrt(ratios[3]), touching, ratios[5]], axis=0))


def error_curves(runs: Sequence[Frames], scales: Scales) -> dict[str, Any]:
    """Return the curves of expected errors by trust number.

    Returns
    -------
    mapping
        ``"level"``: the probability that a further run keeps the bounds; ``"least_level"``: the share of runs that keep
        them with the confidence `CONFIDENCE_LEVEL`. ``"displacement"``, and with tools ``"force"``: a mapping.
        At a trust number T, the median and the bound of the errors, relative to the mean of the present and the
        typical size, are ``"median"`` and ``"bound"`` times T^``"exponent"``, with T at least ``"least_trust"``. Above
        ``"largest_trust"`` the error is unknown. ``"typical_size"`` [m] or [N] is the median of the runs' largest.
    """
    worst = [np.maximum.accumulate(trust_numbers(run.measures, scales)) for run in runs]
    n = len(runs)
    k = min(int(np.ceil(BOUND_PROBABILITY * (n + 1))), n)
    result: dict[str, Any] = {
        "level": min(BOUND_PROBABILITY, k / (n + 1)),
        "least_level": float(betaincinv(k, n + 1 - k, 1 - CONFIDENCE_LEVEL)),
    }
    for quantity, least in LEAST_TRUST.items():
        if quantity not in runs[0].errors:
            continue
        typical = max(float(np.median([run.sizes[quantity].max() for run in runs])), 1e-300)
        relative = [run.errors[quantity] / mean_size(run.sizes[quantity], typical) for run in runs]
        trust = [np.maximum(numbers, least) for numbers in worst]
        peaks = np.array([run.errors[quantity].max() / mean_size(run.sizes[quantity].max(), typical) for run in runs])
        largest = np.array([numbers[-1] for numbers in trust])
        exponent = _exponent(largest, peaks)
        others = [np.arange(n) != r if n > 1 else np.ones(1, dtype=bool) for r in range(n)]
        factors = [
            float(np.max(errors / numbers ** _exponent(largest[kept], peaks[kept])))
            for errors, numbers, kept in zip(relative, trust, others, strict=True)
        ]
        ratios = np.concatenate([errors / numbers**exponent for errors, numbers in zip(relative, trust, strict=True)])
        result[quantity] = {
            "typical_size": typical,
            "least_trust": least,
            "largest_trust": REPEAT_MARGIN**2 * float(max(numbers[-1] for numbers in worst)),  # at least 1
            "exponent": exponent,
            "median": float(np.median(ratios)),
            "bound": max(float(np.sort(factors)[k - 1]), MIN_ERROR),
        }
    return result


def _exponent(trust: Floats, errors: Floats) -> float:
    """Return the exponent of a power law of the largest trust numbers (n,) fitted to the largest errors (n,) of runs.

    It is that of least squares of logarithms, with a ridge.
    """
    x, y = np.log(trust), np.log(np.maximum(errors, MIN_ERROR))
    x, y = x - x.mean(), y - y.mean()
    return float(np.clip((x @ y) / (x @ x + EXPONENT_RIDGE), 0.0, MAX_EXPONENT))
