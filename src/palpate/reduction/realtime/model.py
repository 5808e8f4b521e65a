"""A reduced model made ready for `palpate.Engine`: held by one tool or touched by one, and tied by springs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple, overload

import numpy as np

from palpate.arrays import Floats
from palpate.dynamics.contact.tools import Contact, Grasp
from palpate.dynamics.loads.foundation import Foundation
from palpate.dynamics.loads.prepared import check_kinds, prepare_loads
from palpate.faults import InputError, number_in_range
from palpate.reduction.contact.surface import contact_scratch, rigid_tools
from palpate.reduction.contact.tangent import contact_stiffness, contact_system
from palpate.reduction.contact.tools import ContactTools
from palpate.reduction.hyper.foundation import Springs, springs_of
from palpate.reduction.hyper.implicit import newton
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.hyper.sampled_energy import scratch
from palpate.reduction.lti.model import LinearModel
from palpate.reduction.lti.realtime import LinearRealtime, linear_realtime
from palpate.reduction.realtime.period import MOST_SUBSTEPS, PeriodData, period_functions

__all__ = ["RealtimeModel", "realtime_model"]


class RealtimeModel(NamedTuple):
    """A model as the engine takes it.

    Parameters
    ----------
    advance, stiffness : functions
        Compiled; see `period_functions`.
    data : PeriodData
    rest : (m,) array
        Coordinates at rest.
    tool : (l, 12) array
        Tool coordinates of a rigid pose, see `ReducedModel.tool_map`.
    """

    advance: Any
    stiffness: Any
    data: PeriodData
    rest: Floats
    tool: Floats


@overload
def realtime_model(
    model: ReducedModel,
    *,
    longest: float = ...,
    contact: Contact | Grasp | None = ...,
    foundations: Sequence[Foundation] = ...,
) -> RealtimeModel: ...


@overload
def realtime_model(model: LinearModel, *, period: float = ...) -> LinearRealtime: ...


def realtime_model(
    model: ReducedModel | LinearModel,
    *,
    longest: float = 0.02,
    contact: Contact | Grasp | None = None,
    foundations: Sequence[Foundation] = (),
    period: float = 1e-3,
) -> RealtimeModel | LinearRealtime:
    """Return a model as `palpate.Engine` takes it, with one tool that holds the driven group, or touches the body.

    Parameters
    ----------
    model : ReducedModel or LinearModel
    longest : float [s]
        Longest period that will be asked for.
    contact : Contact or Grasp, optional
        The tool that touches the body, from its place at time 0. Trust then is the distance from training alone.
    foundations : sequence of Foundation
        Springs that tie the body. There are no other loads in real time.
    period : float [s]
        Of a linear model: another period costs a matrix exponential when it is first met.

    Raises
    ------
    InputError
        The model was not trained with exactly one driven group, or with tools that touch it; another load. A linear
        system was not made with exactly one tool, or has other loads.
    """
    if isinstance(model, LinearModel):
        if contact is not None or foundations:
            raise InputError(
                "contact and foundations must be left out for a linear model; "
                "linearise the body with one PrescribedMotion or Grasp"
            )
        return linear_realtime(model, period)
    parts, count = model.data, model.count
    check_kinds([] if contact is None else [contact], (Contact, Grasp), "contact")
    handling = None if contact is None else ContactTools(model._contact_surface, model.prepare([contact]))
    if contact is None and len(parts.prescribed) != 1:
        raise InputError(
            f"the engine moves one tool, and this model knows {len(parts.prescribed)}: train it with prescribed='GROUP', "
            "or give it a tool to touch it with"
        )
    home, tools, contact_state = (
        np.zeros(3),
        rigid_tools(None, model._contact_surface),
        contact_scratch(model._contact_surface, 0),
    )
    if handling is not None:
        handling.begun(lambda: np.zeros((len(model.cloud), 3)), 0.0, model.cloud.spacing)
        home, tools, contact_state = (
            handling.prepared.schedule(np.zeros(1)).poses[0, 0, :3],
            handling.tools,
            handling.contact_state,
        )
    root = np.linalg.cholesky(model.mass / model.masses.sum()).T
    which = np.r_[:count, len(parts.basis_vectors) - parts.residual_fields : len(parts.basis_vectors)]
    watched = model.sampled(which)
    number_in_range("step", model.step or longest, longest / MOST_SUBSTEPS, unit="s")
    frequency, steps = model._highest(np.zeros(count)), int(np.ceil(longest / (model.step or longest)))
    own, vectors = scratch(model._integration_points), np.zeros((8, count))
    vectors[0, : parts.modes] = np.random.default_rng(0).standard_normal(parts.modes)
    springs = _springs(model, foundations).of(which)
    tangent = model.stiffness(np.zeros(count))
    if springs.stiffness.size:
        tangent += springs.stiffness[:count]
    modes = slice(parts.modes)
    system = contact_system(
        model._contact_surface.columns[:, :, modes], model.mass[modes, modes], len(contact_state.active.node)
    )
    data = PeriodData(
        parts.modes, model.stiffness_damping, model.step or 0.0, model.tolerance, model.mass, model._constrained_inverse_mass,
        model._differences, model._integration_points, own, newton(count),
        np.ascontiguousarray(parts.trained @ root.T), root, parts.distance_scale, np.inf if contact else parts.residual_scale,
        watched, scratch(watched, own.history),
        model._all_mass[np.ix_(which[count:], which[:count])], np.zeros((2, len(which))), vectors,
        tangent, np.zeros((count, count)), np.array([frequency, frequency, 0.0, 0.0]),
        np.zeros((steps + 3, parts.lifted)), np.ones(steps, dtype=np.bool_), np.zeros((steps, count)),
        model._contact_surface, contact_state, tools, home, system, springs,
    )  # fmt: skip
    advance, stiffness = period_functions(model._law, model.single)
    if contact is None:
        return RealtimeModel(advance, stiffness, data, np.zeros(count), model.tool_map(parts.prescribed[0]))
    return RealtimeModel(advance, contact_stiffness, data, np.zeros(count), np.eye(12))


def _springs(model: ReducedModel, foundations: Sequence[Foundation]) -> Springs:
    """Project springs on all columns, and refuse other loads."""
    for load in foundations:
        if not isinstance(load, Foundation):
            raise InputError(
                f"foundations: {load!r} is no Foundation: in real time a body knows springs and one tool, no other load"
            )
    return springs_of(prepare_loads(model.cloud, model.fixed, foundations).sites, model.data.basis_vectors, model.mass)
