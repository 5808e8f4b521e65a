"""Calibration of the error indicator on held-out runs: its scales, and the errors expected at a trust number.

Frames of one run err together. So all quantiles count runs, not frames. The error bound is a conformal
prediction of runs (Vovk, Gammerman and Shafer, Algorithmic Learning in a Random World, Springer 2005;
Barber et al., Ann. Stat. 49, 2021, for its leave-one-out form): a power law of the trust number, fitted
to the errors of the frames, times a factor. The factor of a run is the largest ratio of its errors to
the power law of the other runs. The k-th smallest factor of n runs bounds that of one more run with a
probability of about k / (n + 1).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from palpate.arrays import Floats
from palpate.dynamics.loads.prepared import Load
from palpate.dynamics.run.model import State
from palpate.dynamics.run.trajectory import Trajectory
from palpate.reduction.contact.compliance import contact_displacements
from palpate.reduction.contact.tools import contact_at_frame
from palpate.reduction.hyper.error_indicator import force_sizes, residual_norm, rms_sizes, tools_of, training_distance
from palpate.reduction.hyper.load_share import MAX_LOAD_SCALE, MIN_LOAD_SCALE
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.hyper.reactions import constraint_forces

__all__ = ["Frames", "Measures", "Scales", "calibrate_scales", "error_curves", "held_out_frames", "trust_numbers"]


BOUND_PROBABILITY = 0.95  # probability that a run keeps the bound
REPEAT_MARGIN = 1.001  # a margin, by which the trust number of a held-out run stays below 1 when it is repeated
MIN_RELATIVE_SIZE = 0.2  # size in relative errors, over the median of the runs' largest sizes
SMALL_SHARE = 0.1  # of the frames, whose trust numbers and errors are too small to count
MIN_TRUST = 1e-3  # least trust number that counts, over the largest
MIN_ERROR = 1e-12  # smallest error in a logarithm, relative
MAX_EXPONENT = 2.0  # of the power law


class Measures(NamedTuple):
    """The measures of the error indicator in the frames of a run.

    Parameters
    ----------
    distances, residual_norms : (f,) arrays [m]
        See `palpate.reduction.hyper.error_indicator`.
    load_shares : (f,) array
        See `palpate.reduction.hyper.load_share`.
    flexibility_energies : (f,) array [J]
        Energy of the surface compliance.
    """

    distances: Floats
    residual_norms: Floats
    load_shares: Floats
    flexibility_energies: Floats


class Frames(NamedTuple):
    """Frames of a held-out run of a reduced model.

    Parameters
    ----------
    measures : Measures
    errors : mapping of quantity to (f,) array
        Of ``"displacement"``, the root mean square over the body [m], and with tools of ``"force"``, the largest
        over the tools [N].
    sizes : mapping of quantity to (f,) array
        Largest displacement or tool force of the reduced run so far.
    """

    measures: Measures
    errors: dict[str, Floats]
    sizes: dict[str, Floats]


class Scales(NamedTuple):
    """Scales of the measures, at which the trust number is 1; see `palpate.ReducedModel`."""

    distance_scale: float
    residual_scale: float
    load_scale: float
    flexibility_scale: float


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
    )
    missed = np.einsum("tnc,n->t", (run.displacements - full.displacements) ** 2, weights)
    errors, sizes = {"displacement": np.sqrt(missed)}, {"displacement": rms_sizes(model.data, run)}
    tools = [name for name in tools_of(model.data, run) if name in full.reactions]
    if tools:
        missed = [np.linalg.norm(run.reactions[name] - full.reactions[name], axis=1) for name in tools]
        errors["force"], sizes["force"] = np.max(missed, axis=0), force_sizes(model.data, run)
    return Frames(measures, errors, {quantity: np.maximum.accumulate(values) for quantity, values in sizes.items()})


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
    quantiles = [_run_quantile([values.max(initial=0.0) for values in each], share) for each in zip(*runs, strict=True)]
    scales = Scales(*(max(value, 1e-300) for value in quantiles))
    scales = scales._replace(load_scale=max(scales.load_scale, MIN_LOAD_SCALE))
    wider = max(_run_quantile([float(trust_numbers(run, scales).max()) for run in runs], share), 1.0)
    wider *= REPEAT_MARGIN
    return Scales(
        wider * scales.distance_scale,
        wider * scales.residual_scale,
        min(wider * scales.load_scale, MAX_LOAD_SCALE),
        wider**2 * scales.flexibility_scale,
    )


def _run_quantile(values: Sequence[float], share: float) -> float:
    """Return the value that at least a share of all values do not exceed."""
    return float(np.quantile(values, share, method="higher"))


def trust_numbers(run: Measures, scales: Scales) -> Floats:
    """Return the trust numbers (f,) of the frames of a run."""
    ratios = [values / scale for values, scale in zip(run, scales, strict=True)]
    return np.asarray(np.max([*ratios[:3], np.sqrt(ratios[3])], axis=0))


def error_curves(runs: Sequence[Frames], scales: Scales) -> dict[str, Any]:
    """Return the curves of expected errors by trust number.

    Returns
    -------
    mapping
        ``"level"``: the probability that a further run keeps the bounds. ``"displacement"``, and with tools
        ``"force"``: a mapping of numbers. At a trust number T, the median and the bound of the errors, relative to the
        size, are ``"median"`` and ``"bound"`` times T^``"exponent"``, with T at least ``"least_trust"``. Above
        ``"largest_trust"`` the error is unknown. While a run is smaller than ``"least_size"`` [m] or [N], errors are
        relative to that.
    """
    worst = [np.maximum.accumulate(trust_numbers(run.measures, scales)) for run in runs]
    k = min(int(np.ceil(BOUND_PROBABILITY * (len(runs) + 1))), len(runs))
    result: dict[str, Any] = {"level": min(BOUND_PROBABILITY, k / (len(runs) + 1))}
    for quantity in runs[0].errors:
        least = max(MIN_RELATIVE_SIZE * float(np.median([run.sizes[quantity][-1] for run in runs])), 1e-300)
        relative = [run.errors[quantity] / np.maximum(run.sizes[quantity], least) for run in runs]
        curve = _power_law(worst, relative)
        ratios = np.concatenate([errors / curve.at(trust) for errors, trust in zip(relative, worst, strict=True)])
        result[quantity] = {
            "least_size": least,
            "least_trust": curve.least_trust,
            "largest_trust": REPEAT_MARGIN**2 * curve.largest_trust,  # at least 1
            "exponent": curve.exponent,
            "median": curve.factor * float(np.median(ratios)),
            "bound": curve.factor * float(np.sort(_largest_ratios(worst, relative))[k - 1]),
        }
    return result


def _largest_ratios(worst: Sequence[Floats], errors: Sequence[Floats]) -> list[float]:
    """Return the largest ratio of the errors of each run to the curve of the other runs, or of itself if alone."""
    result = []
    for r in range(len(worst)):
        others = [k for k in range(len(worst)) if k != r] or [r]
        curve = _power_law([worst[k] for k in others], [errors[k] for k in others])
        result.append(float(np.max(errors[r] / curve.at(worst[r]))))  # 0 above all that the others met
    return result


class _PowerLaw(NamedTuple):
    """A typical error factor * T^exponent at trust numbers T, at least `least_trust`; infinite above the largest."""

    factor: float
    exponent: float
    least_trust: float
    largest_trust: float

    def at(self, trust: Floats) -> Floats:
        """Return the typical errors at trust numbers (f,)."""
        typical = self.factor * np.maximum(trust, self.least_trust) ** self.exponent
        return np.where(trust <= self.largest_trust, typical, np.inf)


def _power_law(worst: Sequence[Floats], errors: Sequence[Floats]) -> _PowerLaw:
    """Return a power law fitted to the errors of all frames, by least squares of logarithms.

    Parameters
    ----------
    worst, errors : sequences of (f,) arrays
        Largest trust number so far and relative error of every run, frame by frame.
    """
    trust, missed = np.concatenate(list(worst)), np.concatenate(list(errors))
    largest = float(trust.max())
    least = max(float(np.quantile(trust, SMALL_SHARE)), MIN_TRUST * largest, 1e-300)
    counted = missed > 0
    if not counted.any():  # exact, such as bodies at rest
        return _PowerLaw(MIN_ERROR, 0.0, least, largest)
    x = np.log(np.maximum(trust[counted], least))
    y = np.log(np.maximum(missed[counted], max(float(np.quantile(missed[counted], SMALL_SHARE)), MIN_ERROR)))
    spread = float(np.sum((x - x.mean()) ** 2))
    slope = float(np.sum((x - x.mean()) * (y - y.mean()))) / spread if spread > 0 else 0.0
    exponent = float(np.clip(slope, 0.0, MAX_EXPONENT))
    return _PowerLaw(float(np.exp(np.mean(y - exponent * x))), exponent, least, largest)
