"""The error indicator: seven measures of a state, and the errors expected at an error indicator.

Each measure over its scale is a number, and the largest of them is the error indicator of
`palpate.hyper_reduce`:

- the distance to the nearest training state,
- the residual norm of the forces on test fields (`palpate.reduction.training.residual_fields`),
- the share of the loads' static response outside the coordinates (`palpate.reduction.hyper.load_share`),
- the displacement of the surface compliance under tools, by the square root of its energy,
- the touch speed of tools, or the speed of a body without them: what is faster than training excites modes that are
  not there,
- the nearness of tools to supports, where the body is stiffer than its smooth modes,
- the number of tools in contact at once, where it is larger than in all held-out runs.

Touch speed and nearness are those of the tool for which they are largest, so that no tool hides another.

Errors expected at an error indicator come from the held-out runs (`palpate.reduction.training.calibrate_indicator`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numba.extending import register_jitable
from scipy.spatial import cKDTree

from palpate.core.arrays import Floats, Ints
from palpate.core.describe import Fact, described_tuple
from palpate.core.faults import InputError, number_in_range
from palpate.dynamics.loads.prepared import PreparedLoads
from palpate.dynamics.loads.supports import FIXED, Support, supported_nodes
from palpate.dynamics.run.model import State
from palpate.dynamics.run.trajectory import Trajectory
from palpate.meshfree.cloud import Cloud
from palpate.reduction.contact.surface import HELD_NEARNESS
from palpate.reduction.hyper.body import ReducedBody
from palpate.reduction.hyper.data import ReducedData, Scales

MIN_DISTANCE = 0.25  # from a fixed node that counts, in spacings
TOUCH_SHARE = 0.2  # of a typical force, which counts in addition to the force of a tool
SPEED_INTERVAL = 1e-4  # [s] over which the speed of a tool is measured
# Error indicator with one tool more in contact than in all held-out runs, plus 1 for each further tool. Errors are
# unknown from there on.
TRUST_OF_MORE_TOOLS = 2.0
LARGEST_KNOWN_TRUST = 1.999  # largest error indicator with an expected error


class Measures(NamedTuple):
    """The measures of the error indicator in a state, or in the frames of a run (each with a first axis of frames)."""

    # distances, residual_norms: () arrays [m]
    distances: Floats
    residual_norms: Floats
    load_shares: Floats  # see `palpate.reduction.hyper.load_share`
    # (t,) array [J]: energy of the surface compliance under each tool; negative where another one pushes it back
    tool_energies: Floats
    # (t,) array [m/s]: of each tool that moves into the body. Without a contact surface that of the body (1,), and as
    # many energies of 0.
    speeds: Floats
    nearness: Floats  # of tools to supports
    tools: Floats  # number of tools in contact


def error_indicators(measures: Measures, scales: Scales) -> Floats:
    """Return the error indicator of a state, or those (f,) of the frames of a run."""
    return np.asarray(np.max(list(measure_ratios(measures, scales).values()), axis=0))


def measure_ratios(measures: Measures, scales: Scales) -> dict[str, Floats]:
    """Return each measure over its scale, of a state or of the frames (f,) of a run, by its name."""
    energies = measures.tool_energies
    touching = touch_speed(measures.speeds, energies, scales.flexibility_scale).max(axis=-1, initial=0.0)
    return {
        "distance": measures.distances / scales.distance_scale,
        "residual": measures.residual_norms / scales.residual_scale,
        "load share": measures.load_shares / scales.load_scale,
        "compliance": np.sqrt(np.maximum(energies.sum(axis=-1), 0.0) / scales.flexibility_scale),
        "speed": touching / scales.speed_scale,
        "nearness": measures.nearness / scales.nearness_scale,
        "tools": np.asarray(trust_of_tools(measures.tools, scales.trained_tools)),
    }


@register_jitable
def trust_of_tools(tools, trained_tools):
    """Return the part of the error indicator by the number of tools in contact, and that of the held-out runs."""
    return (TRUST_OF_MORE_TOOLS - 1.0 + tools - trained_tools) * (tools > trained_tools)


@described_tuple
class ExpectedError(NamedTuple):
    """The error expected at an error indicator, relative to the mean of the present and the typical size.

    The size is the displacement or the tool force. The typical one is the median of the largest sizes of the
    held-out runs.

    Parameters
    ----------
    median : float
        Of the frames of the held-out runs. Infinite, as `bound`, where the error is unknown: at an error indicator of 2
        or more.
    bound : float
        Bound that the errors of a run do not exceed in any frame, with the probability `level`.
    level : float
        0.95, or n / (n + 1) for less than 19 held-out runs n. It is the share of runs, of the kind of the
        held-out runs, that keep the bound in all their frames, in the mean over campaigns. Where these are runs
        with one tool and with two, each kind keeps the level by itself if it has 19 runs.
    least_level : float
        Share of such runs that keep the bound of this campaign, with a confidence of 90 %.
    typical_size : float [m] or [N]

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> pull = pt.SurfaceForce("x+", force=lambda t: (20 * t, 0, 0))
    >>> full = pt.rollout(bar, [pull], duration=0.03, every=0.001)
    >>> half = pt.SurfaceForce("x+", force=lambda t: (10 * t, 0, 0))
    >>> other = pt.rollout(bar, [half], duration=0.03, every=0.001)
    >>> model = pt.hyper_reduce(bar, full, modes=4, held_out=[([half], other)])
    >>> error = model.expected_error(0.0)
    >>> error.median <= error.bound, error.level
    (True, 0.5)
    """

    median: float
    bound: float
    level: float
    least_level: float
    typical_size: float

    def _facts(self) -> list[Fact]:
        shares = [(name.replace("_", " "), 100 * float(getattr(self, name)), "%") for name in self._fields[:-1]]
        return [*shares, ("typical size", float(self.typical_size), "")]


def training_distance(body: ReducedBody, state: State) -> float:
    """Return the root mean square displacement [m] over the body from a state to the nearest training state."""
    states, root = body.trained
    return float(np.sqrt(np.min(np.sum((states - state.coordinates @ root) ** 2, axis=1))))


def rms_speeds(root: Floats, velocities: Floats) -> Floats:
    """Return the root mean square speeds (f,) [m/s] over the body of velocities (f, m) of the coordinates.

    `root` (m, m) is the root of the mass matrix divided by the mass of the body.
    """
    return np.asarray(np.linalg.norm(velocities @ root, axis=1))


def approach_speeds(prepared: PreparedLoads, times: Floats, forces: Floats) -> Floats:
    """Return the speeds (f, t) [m/s] of tools along their forces on the body (f, t, 3), before some times (f,) [s].

    It is 0 of a tool that has no force, or that moves back from the body.
    """
    first = np.maximum(times - SPEED_INTERVAL, 0.0)
    before, after = (prepared.schedule(each).poses[:, :, :3] for each in (first, first + SPEED_INTERVAL))
    velocities = np.nan_to_num((after - before) / SPEED_INTERVAL)
    size = np.maximum(np.linalg.norm(forces, axis=2), np.finfo(float).tiny)
    return np.asarray(np.maximum(np.sum(velocities * forces, axis=2) / size, 0.0))


@register_jitable
def touch_speed(speed, energy, scale):
    """Return the touch speed [m/s] of a tool of a speed [m/s], by the energy of the surface compliance and its scale.

    The tissue under a tool has inertia, which the static compliance lacks: a force in proportion to the square of the
    speed. It counts relative to the force of the tool, which is in proportion to the root of the energy, and to a small
    share of a typical force. So the touch speed is that of a tool without force that errs as much.
    """
    return speed / np.sqrt(1.0 + np.sqrt(np.maximum(energy, 0.0) / scale) / TOUCH_SHARE)


def nearness_to_supports(cloud: Cloud, supports: Sequence[Support], nodes: Ints) -> Floats:
    """Return the spacing over the distance to the nearest fixed node (k,) of some nodes; 0 without supports.

    That of a fixed node is `HELD_NEARNESS`.
    """
    fixed = cloud.points[supported_nodes(cloud, supports).kind == FIXED]
    if not len(fixed) or not len(nodes):
        return np.zeros(len(nodes))
    distances = np.asarray(cKDTree(fixed).query(cloud.points[nodes])[0])
    near = cloud.spacing / np.maximum(distances, MIN_DISTANCE * cloud.spacing)
    return np.where(distances == 0.0, HELD_NEARNESS, near)


def support_nearness(nearness: Floats, forces: Floats, held: Floats | float = 0.0) -> float:
    """Return the nearness to supports of the nearest tool; 0 without tools in contact.

    That of a tool is the mean of the nearness (k,) of nodes under its forces, of (t, k, 3), weighted by magnitudes.
    `held` (t,) [N] are the sums of magnitudes of its forces on fixed nodes.
    """
    sizes = np.linalg.norm(forces, axis=2)
    total = np.maximum(sizes.sum(axis=1) + held, np.finfo(float).tiny)
    return float(np.max((sizes @ nearness + HELD_NEARNESS * np.asarray(held)) / total, initial=0.0))


def residual_norm(data: ReducedData, forces: Floats) -> float:
    """Return the root mean square displacement [m] that the unbalanced forces would cause at rest.

    The unbalanced forces act on the residual fields (`palpate.reduction.training.residual_fields`), and the
    displacement is in their shapes. The norm is 0 without residual fields. The forces (m + l + 3 g + w,) are those of
    `palpate.reduction.hyper.reactions.constraint_forces`.
    """
    return float(np.linalg.norm(forces[len(data.trial_and_test_basis) - data.residual_fields :]))


def expected_error(report: Mapping[str, Any], trust: float, of: str = "displacement") -> ExpectedError:
    """Return the error that a report states for an error indicator; see `palpate.ReducedModel.expected_error`."""
    number = number_in_range("trust", trust, 0.0)
    if of not in ("displacement", "force"):
        raise InputError(f"of must be 'displacement' or 'force', got {of!r:.60}; choose one of them")
    curves = _curves(report)
    if curves is None:
        raise InputError(
            "held_out must be given in training to expect errors, got none; train with hyper_reduce(..., held_out=...)"
        )
    if of not in curves:
        raise InputError(
            "of must be 'displacement' for a model whose held-out runs have no tool, got 'force'; "
            "train it with tools, or with prescribed="
        )
    median, bound = (float(curve_errors(curves[of], name, np.array([number]))[0]) for name in ("median", "bound"))
    return ExpectedError(median, bound, curves["level"], curves["least_level"], curves[of]["typical_size"])


def error_bounds(data: ReducedData, run: Trajectory) -> tuple[Floats, Floats]:
    """Return the error bounds of a run's displacement (f,) [m] and tool forces (f,) [N], frame by frame.

    The displacement's is the root mean square over the body. The forces' is that of the strongest tool, which is
    the largest of all tools'. They are infinite where the error is unknown, and empty without held-out runs.
    """
    curves = _curves(data.report)
    result = []
    for quantity, sizes in (("displacement", rms_sizes(data, run)), ("force", force_sizes(data, run))):
        if curves is None or quantity not in curves or not len(sizes) or len(run.trust) < len(run.times):
            result.append(np.zeros(0))
            continue
        worst = remembered_trust(run.trust, run.times, curves.get("forgetting", 0.0))
        relative = curve_errors(curves[quantity], "bound", worst)
        result.append(relative * mean_size(sizes, curves[quantity]["typical_size"]))
    return result[0], result[1]


def remembered_trust(trust: Floats, times: Floats, forgetting: float) -> Floats:
    """Return the largest error indicators (f,) so far at times (f,) [s], which decay at a rate [1/s].

    An error once made goes on as a vibration of the body, which dies by its damping: with a mass damping c, every
    vibration decays at least as exp(-c t / 2).
    """
    with np.errstate(divide="ignore"):
        return np.asarray(np.exp(np.maximum.accumulate(np.log(trust) + forgetting * times) - forgetting * times))


def forgetting_rate(report: Mapping[str, Any]) -> float:
    """Return the rate [1/s] at which the largest error indicator decays; 0 for a model that never forgets it."""
    return float((_curves(report) or {}).get("forgetting", 0.0))


@dataclass(frozen=True)
class ForceBound:
    """The error bound [N] of tool forces, by the largest error indicator so far and the force [N]."""

    curve: Floats  # (5,): as `bound_curve`
    forgetting: float  # [1/s]: rate at which the largest error indicator decays

    def __call__(self, trust: float, size: float) -> float:
        return float(curve_bound(self.curve, trust, size))


def force_bound(report: Mapping[str, Any]) -> ForceBound | None:
    """Return the error bound of tool forces; None without held-out runs with tools."""
    curve = bound_curve(report)
    return ForceBound(curve, forgetting_rate(report)) if curve.any() else None


def bound_curve(report: Mapping[str, Any]) -> Floats:
    """Return the numbers of `curve_bound` for tool forces (5,); zeros without held-out runs with tools."""
    curve = (_curves(report) or {}).get("force")
    if curve is None:
        return np.zeros(5)
    return np.array([float(curve[k]) for k in ("bound", "least_trust", "exponent", "largest_trust", "typical_size")])


@register_jitable
def mean_size(size, typical_size):
    """Return the mean of the present and the typical size, to which errors are relative."""
    return 0.5 * (size + typical_size)


@register_jitable
def curve_bound(curve, trust, size):
    """Return the error bound [N] by the largest error indicator so far and the force [N]; infinite where not known."""
    error, least_trust, exponent, largest_trust, typical_size = curve[0], curve[1], curve[2], curve[3], curve[4]
    if not (error > 0.0 and trust <= largest_trust):
        return np.inf
    return error * max(trust, least_trust) ** exponent * mean_size(size, typical_size)


def _curves(report: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return the curves of `palpate.reduction.training.calibrate_indicator`; None without held-out runs."""
    curves: dict[str, Any] | None = report.get("held_out", {}).get("expected_error")
    if curves is None:
        return None
    return {  # older models have curves beyond the error indicator of more tools
        name: value | {"largest_trust": min(value["largest_trust"], LARGEST_KNOWN_TRUST)}
        if isinstance(value, dict)
        else value
        for name, value in curves.items()
    }


def curve_errors(curve: Mapping[str, float], name: str, trust: Floats) -> Floats:
    """Return the relative errors of a curve at error indicators (f,): ``"median"`` or ``"bound"``."""
    errors = curve[name] * np.maximum(trust, curve["least_trust"]) ** curve["exponent"]
    return np.where(trust <= curve["largest_trust"], errors, np.inf)


def rms_sizes(data: ReducedData, run: Trajectory) -> Floats:
    """Return the root mean square displacement (f,) [m] of a run over the body."""
    return np.sqrt(np.einsum("tnc,tnc,n->t", run.displacements, run.displacements, data.volumes / data.volumes.sum()))


def force_sizes(data: ReducedData, run: Trajectory) -> Floats:
    """Return the force (f,) [N] of the strongest tool of a run; empty without tools."""
    forces = [np.linalg.norm(run.reactions[name], axis=1) for name in tools_of(data, run)]
    return np.max(forces, axis=0) if forces else np.zeros(0)


def tools_of(data: ReducedData, run: Trajectory) -> list[str]:
    """Return the names of the tools among the reactions of a run."""
    supports = {support.group for support in data.supports}
    return [name for name in run.reactions if name not in supports]
