"""Calibration of the error indicator on held-out runs: its scales, and the errors expected at an error indicator.

Frames of one run err together. So all quantiles count runs, not frames. The error bound is a conformal
prediction of runs (Vovk, Gammerman and Shafer, Algorithmic Learning in a Random World, Springer 2005;
Barber et al., Ann. Stat. 49, 2021, for its leave-one-out form): the mean of the present and the typical
size, times a power of the largest error indicator so far, times a factor. The exponent is fitted between
runs. The factor of a run is the largest ratio of its errors to the product by the exponent of the other
runs. The k-th smallest factor of n runs bounds that of one more run with a probability of about
k / (n + 1). That is a mean over campaigns. The share of runs that keep the bound of one campaign has the
beta distribution B(k, n + 1 - k) (Vovk, Asian Conference on Machine Learning 2012), whose tenth
percentile the campaign at hand exceeds with a confidence of 90 %.

Runs in which one tool touches the body, those in which two do so at once, and all runs have a factor each, and the
bound has the largest one (Mondrian conformal prediction). The level is that of all runs. From 19 runs of a kind on,
that kind keeps it by itself.

Nothing of this depends on whether a value of the indicator was met before: a further run of the kind of the held-out
runs keeps the bound at any value. `LARGEST_KNOWN_TRUST` is the limit for runs of another kind.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.special import betaincinv

from palpate.core.arrays import Floats
from palpate.dynamics.loads.prepared import Load, PreparedLoads
from palpate.dynamics.run.model import State
from palpate.dynamics.run.rollout import rollout
from palpate.dynamics.run.trajectory import Trajectory
from palpate.reduction.hyper.data import UNLIMITED_SCALE, Scales
from palpate.reduction.hyper.error_indicator import (
    LARGEST_KNOWN_TRUST,
    Measures,
    error_indicators,
    mean_size,
    remembered_trust,
    rms_sizes,
    tools_of,
    touch_speed,
)
from palpate.reduction.hyper.load_share import MAX_LOAD_SCALE, MIN_LOAD_SCALE
from palpate.reduction.hyper.model import ReducedModel

BOUND_PROBABILITY = 0.95  # probability that a run keeps the bound
CONFIDENCE_LEVEL = 0.9  # that at least a share of the runs keeps the bound of a campaign
REPEAT_MARGIN = 1.001  # a margin, by which the error indicator of a held-out run stays below 1 when it is repeated
# Least error indicator that counts. The first errors of a force, at touch, do not depend on the error indicator.
MIN_TRUST = {"displacement": 0.05, "force": 0.4}
MIN_ERROR = 1e-12  # smallest error in a logarithm, relative
MAX_EXPONENT = 2.0  # of the error indicator
EXPONENT_RIDGE = 0.3  # added to the sum of squares of logarithms: few runs show little of the exponent


class Frames(NamedTuple):
    """Frames of a held-out run of a reduced model."""

    measures: Measures
    times: Floats  # (f,) [s]
    # mapping of quantity to array: of ``"displacement"``, (f,), the root mean square over the body [m], and with tools
    # of ``"force"``, (f, t), of each tool [N]
    errors: dict[str, Floats]
    sizes: dict[str, Floats]  # mapping of quantity to array: displacement [m] or tool forces [N] of the reduced run


class _Watched(ReducedModel):
    """A reduced model that calls a function with the measures of every frame of a run."""

    def __init__(self, model: ReducedModel, watch: Callable[[Measures], None]) -> None:
        super().__init__(model.data, step=model.step, single=model.single)
        self._watch = watch

    def _measures(self, state: State, prepared: PreparedLoads, constraints: Floats, tool_energies: Floats) -> Measures:
        measures = super()._measures(state, prepared, constraints, tool_energies)
        self._watch(measures)
        return measures


def repeat_run(model: ReducedModel, loads: Sequence[Load], full: Trajectory) -> tuple[Trajectory, Frames]:
    """Repeat a held-out run of the full model; return the reduced run, and measures and errors of its frames."""
    rows: list[Measures] = []
    duration, every = float(full.times[-1]), float(full.times[1] - full.times[0])
    run = rollout(_Watched(model, rows.append), loads, duration=duration, every=every, progress=False)
    weights = model.masses / model.masses.sum()
    missed = np.einsum("tnc,n->t", (run.displacements - full.displacements) ** 2, weights)
    errors, sizes = {"displacement": np.sqrt(missed)}, {"displacement": rms_sizes(model.data, run)}
    tools = [name for name in tools_of(model.data, run) if name in full.reactions]
    if tools:
        forces, expected = (np.stack([each.reactions[name] for name in tools], axis=1) for each in (run, full))
        errors["force"], sizes["force"] = np.linalg.norm(forces - expected, axis=2), np.linalg.norm(forces, axis=2)
    return run, Frames(Measures(*map(np.array, zip(*rows, strict=True))), run.times, errors, sizes)


def calibrate_scales(runs: Sequence[Measures], share: float) -> Scales:
    """Return the scales of the measures.

    With these scales the error indicator is at most 1 in all frames of a given share of the runs, unless the
    scale of the load shares would be above `MAX_LOAD_SCALE`.
    """
    most_tools = max([1, *(int(run.tools.max(initial=0)) for run in runs)])
    energy = max(_run_quantile([run.tool_energies.sum(axis=1).max(initial=0.0) for run in runs], share), 1e-300)
    measures = [
        (
            run.distances, run.residual_norms, run.load_shares, run.tool_energies.sum(axis=1),
            touch_speed(run.speeds, run.tool_energies, energy), run.nearness,
        )
        for run in runs
    ]  # fmt: skip
    quantiles = [
        _run_quantile([values.max(initial=0.0) for values in each], share) for each in zip(*measures, strict=True)
    ]
    distance, residual, load, flexibility, speed, nearness = (max(value, 1e-300) for value in quantiles)
    scales = Scales(distance, residual, load, flexibility, speed, nearness, most_tools)
    if not any(run.nearness.any() for run in runs):  # without tools or supports
        scales = scales._replace(nearness_scale=UNLIMITED_SCALE)
    scales = scales._replace(load_scale=max(scales.load_scale, MIN_LOAD_SCALE))
    wider = max(_run_quantile([float(error_indicators(run, scales).max()) for run in runs], share), 1.0)
    wider *= REPEAT_MARGIN
    return Scales(
        wider * scales.distance_scale,
        wider * scales.residual_scale,
        min(wider * scales.load_scale, MAX_LOAD_SCALE),
        wider**2 * scales.flexibility_scale,
        wider * scales.speed_scale,
        min(wider * scales.nearness_scale, UNLIMITED_SCALE),
        most_tools,
    )


def _run_quantile(values: Sequence[float], share: float) -> float:
    """Return the value that at least a share of all values do not exceed."""
    return float(np.quantile(values, share, method="higher"))


def error_curves(runs: Sequence[Frames], scales: Scales, forgetting: float = 0.0) -> dict[str, Any]:
    """Return the curves of expected errors by the largest error indicator so far, which decays at a rate [1/s].

    ``"forgetting"`` is the rate [1/s]. ``"level"`` is the probability that a further run keeps the bounds,
    ``"least_level"`` the share of runs that keep them with the confidence `CONFIDENCE_LEVEL`. Both are the least of
    runs with one tool and with several.

    ``"displacement"``, and with tools ``"force"``, are mappings. At the error indicator T, the median and the bound of
    the errors, relative to the mean of the present and the typical size, are ``"median"`` and ``"bound"`` times
    T^``"exponent"``, with T at least ``"least_trust"``. Above ``"largest_trust"`` the error is unknown.
    ``"typical_size"`` [m] or [N] is the median of the runs' largest.
    """
    worst = [remembered_trust(error_indicators(run.measures, scales), run.times, forgetting) for run in runs]
    n, tools = len(runs), [max(int(run.measures.tools.max(initial=0)), 1) for run in runs]
    groups = [np.arange(n), *(np.flatnonzero(np.equal(tools, number)) for number in sorted(set(tools)))]
    ranks = [min(int(np.ceil(BOUND_PROBABILITY * (len(group) + 1))), len(group)) for group in groups]
    result: dict[str, Any] = {
        "forgetting": forgetting,
        "level": min(BOUND_PROBABILITY, n / (n + 1)),
        "least_level": float(betaincinv(ranks[0], n + 1 - ranks[0], 1 - CONFIDENCE_LEVEL)),
    }
    for quantity, least in MIN_TRUST.items():
        if quantity not in runs[0].errors:
            continue
        typical = max(float(np.median([run.sizes[quantity].max() for run in runs])), 1e-300)
        relative = [
            (run.errors[quantity] / mean_size(run.sizes[quantity], typical)).reshape(len(numbers), -1).max(axis=1)
            for run, numbers in zip(runs, worst, strict=True)
        ]
        trust = [np.maximum(numbers, least) for numbers in worst]
        peaks = np.array([run.errors[quantity].max() / mean_size(run.sizes[quantity].max(), typical) for run in runs])
        largest = np.array([numbers.max() for numbers in trust])
        exponent = _exponent(largest, peaks)
        others = [np.arange(n) != r if n > 1 else np.ones(1, dtype=bool) for r in range(n)]
        factors = np.array(
            [
                np.max(errors / numbers ** _exponent(largest[rest], peaks[rest]))
                for errors, numbers, rest in zip(relative, trust, others, strict=True)
            ]
        )
        ratios = np.concatenate([errors / numbers**exponent for errors, numbers in zip(relative, trust, strict=True)])
        result[quantity] = {
            "typical_size": typical,
            "least_trust": least,
            "largest_trust": LARGEST_KNOWN_TRUST,
            "exponent": exponent,
            "median": float(np.median(ratios)),
            "bound": max(
                MIN_ERROR, *(float(np.sort(factors[each])[k - 1]) for k, each in zip(ranks, groups, strict=True))
            ),
        }
    return result


def _exponent(trust: Floats, errors: Floats) -> float:
    """Return the exponent of a power law of the largest error indicators (n,), fitted to largest errors (n,) of runs.

    It is that of least squares of logarithms, with a ridge.
    """
    x, y = np.log(trust), np.log(np.maximum(errors, MIN_ERROR))
    x, y = x - x.mean(), y - y.mean()
    return float(np.clip((x @ y) / (x @ x + EXPONENT_RIDGE), 0.0, MAX_EXPONENT))
