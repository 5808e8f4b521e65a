"""Real-time models for `palpate.Engine`, with one tool, prescribed or in contact, and springs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple, overload

import numpy as np

from palpate.arrays import Floats
from palpate.dynamics.compiled.lanes import LANES
from palpate.dynamics.contact.blade import Blade
from palpate.dynamics.contact.geometry import rotation
from palpate.dynamics.contact.tools import Contact, Grasp, Sphere, Tool
from palpate.dynamics.loads.foundation import Foundation
from palpate.dynamics.loads.prepared import check_kinds, prepare_loads
from palpate.dynamics.material.relaxation import history_copy
from palpate.dynamics.nodal.model import NodalModel
from palpate.dynamics.nodal.tool_path import contact_stiffness as nodal_stiffness
from palpate.dynamics.solid.model import EnergySolid
from palpate.faults import InputError, number_in_range
from palpate.realtime.bodies.change_tool import change_tool
from palpate.realtime.bodies.full_blade import BladeCutter
from palpate.realtime.bodies.full_body import change_full_tool, full_period
from palpate.realtime.bodies.period import (
    MAX_SUBSTEPS,
    POWER_SHAPE,
    IndicatorData,
    PeriodData,
    PeriodStart,
    ResidualFields,
    period_functions,
    probes,
)
from palpate.reduction.contact.surface import contact_scratch, rigid_tools
from palpate.reduction.contact.tangent import contact_stiffness, contact_system
from palpate.reduction.contact.tools import ContactTools
from palpate.reduction.hyper.error_indicator import force_bound, nearness_to_supports
from palpate.reduction.hyper.foundation import Springs, project_springs
from palpate.reduction.hyper.implicit import ImplicitData, newton_scratch
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.hyper.reactions import tool_map
from palpate.reduction.hyper.sampled_energy import scratch
from palpate.reduction.lti.model import LinearModel
from palpate.reduction.lti.realtime import LinearRealtime, linear_realtime

ABSENT_TOOL_DISTANCE = 10.0  # [m] from the body to an absent tool
CATCH_UP = 4  # periods by which a full body may be late, because its periods take one step or two


class RealtimeModel(NamedTuple):
    """A reduced model or a full body for the engine.

    Parameters
    ----------
    advance, stiffness : functions
        Compiled; see `period_functions` and `palpate.dynamics.nodal.period.nodal_period`.
    data : PeriodData or NodalPeriodData
    rest : (m,) array
        Coordinates at rest.
    tool : (l, 12) array
        Map from a rigid pose to the tool coordinates, see `palpate.reduction.hyper.reactions.tool_map`.
    force_bound : function, optional
        ``force_bound(trust, size)`` returns the error bound [N] of the tool's force, by the largest trust number so
        far and the present force [N]. None without held-out runs with tools.
    catch_up : int
        Number of periods by which the engine may be late and still take them all.
    change_tool : function, optional
        ``change_tool(tool, pose, friction)`` replaces the tool in contact between two periods; the body keeps its state
        and nothing is compiled. `tool` is a Sphere, Capsule, Plane, Punch, Forceps or None, `pose` (7,) its position
        [m] and unit quaternion, to which later displacements and rotations are relative. The engine must be paused.
        A full body also takes a Blade.
    cutter : BladeCutter, optional
        Of a solid, which the engine cuts with a blade.
    relaxes : bool
        The tissue has relaxation times; `palpate.Engine` cannot change its moduli.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.03, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1060, poisson=0.45)
    >>> block = pt.Solid(cloud, tissue, fixed="z-")
    >>> ball = pt.tools.Contact(pt.tools.Sphere(radius=0.01), (0.015, 0.015, 0.026))
    >>> model = pt.realtime_model(block, contact=ball)
    >>> isinstance(model, pt.typing.RealtimeModel), model.rest.ndim
    (True, 1)
    """

    advance: Any
    stiffness: Any
    data: Any
    rest: Floats
    tool: Floats
    force_bound: Callable[[float, float], float] | None = None
    catch_up: int = 0
    change_tool: Callable[[Tool | None, Floats, float], None] | None = None
    cutter: BladeCutter | None = None
    relaxes: bool = False


@overload
def realtime_model(
    model: ReducedModel,
    *,
    longest: float = ...,
    contact: Contact | Grasp | None = ...,
    foundations: Sequence[Foundation] = ...,
) -> RealtimeModel: ...


@overload
def realtime_model(
    model: NodalModel | ReducedModel,
    *,
    contact: Contact | Grasp | None,
    foundations: Sequence[Foundation] = ...,
    tailored_modes: int | None = ...,
) -> RealtimeModel: ...


@overload
def realtime_model(model: LinearModel, *, period: float = ...) -> LinearRealtime: ...


def realtime_model(
    model: ReducedModel | LinearModel | NodalModel,
    *,
    longest: float = 0.02,
    contact: Contact | Grasp | None = None,
    foundations: Sequence[Foundation] = (),
    period: float = 1e-3,
    tailored_modes: int | None = None,
) -> RealtimeModel | LinearRealtime:
    """Return a model for `palpate.Engine`, with one tool that holds the prescribed group or touches the body.

    Parameters
    ----------
    model : ReducedModel, LinearModel, or Solid or Membrane in the energy form
        A full body has no trust number. Its contact stiffness follows from the tool's displacement and force.
    longest : float [s]
        Longest period that the engine may request.
    contact : Contact or Grasp, optional
        The tool in contact. The engine's poses are displacements and rotations from its pose at time 0,
        the rotations about its position. The trust number then counts the distance from the
        training states, the displacement of the surface compliance, the speed, and the nearness of the tool to
        supports, each over its scale.
    foundations : sequence of Foundation
        Springs between the body and the ground. Other loads are not supported in real time.
    period : float [s]
        Of a linear model. The first step with another period computes a matrix exponential.
    tailored_modes : int, optional
        Number of the fastest modes of a full body that get more mass, so that its steps are 1.4 to 2 times as long;
        0 for steps as those of `rollout`. By default 20 to 40 for a solid of at least 500 nodes with stiffness damping.
        Equilibria and all other modes are unchanged (`palpate.dynamics.nodal.mass_tailoring`).

    Raises
    ------
    InputError
        The model was not trained with exactly one prescribed group, or with contact; a load is not a
        `Foundation`. A linear system does not have exactly one tool, or has other loads.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.03, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=2e3, C2=0, density=1060, poisson=0.45)
    >>> block = pt.Solid(cloud, tissue, fixed="z-")
    >>> ball = pt.tools.Contact(pt.tools.Sphere(radius=0.01), (0.015, 0.015, 0.026))
    >>> model = pt.realtime_model(block, contact=ball)
    >>> with pt.Engine(model) as engine:
    ...     reading = engine.read()
    >>> reading.force.tolist()
    [0.0, 0.0, 0.0]
    """
    if isinstance(model, LinearModel):
        if contact is not None or foundations:
            raise InputError(
                "contact and foundations must be left out for a linear model; "
                "linearise the body with one PrescribedMotion or Grasp"
            )
        return linear_realtime(model, period)
    if isinstance(model, NodalModel):
        return _full_body(model, contact, foundations, tailored_modes)
    if tailored_modes is not None:
        raise InputError(f"tailored_modes must be left out for a reduced model, got {tailored_modes!r}")
    return _reduced_body(model, longest, contact, foundations)


def idle_model(model: ReducedModel | NodalModel, foundations: Sequence[Foundation] = ()) -> RealtimeModel:
    """Return a model for the engine that takes tools by `RealtimeModel.change_tool`, and has none yet.

    A reduced model that was trained without tools has its prescribed group as the tool, and no `change_tool`.
    """
    takes_tools = not isinstance(model, ReducedModel) or (
        not model.data.prescribed and model.data.compliance is not None
    )
    away = model.cloud.points.max(axis=0) + ABSENT_TOOL_DISTANCE
    contact = Contact(Sphere(model.cloud.spacing), away) if takes_tools else None
    ready = realtime_model(model, contact=contact, foundations=foundations)
    if ready.change_tool is not None:
        ready.change_tool(None, np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), 0.0)
    return ready


def _reduced_body(
    model: ReducedModel, longest: float, contact: Contact | Grasp | None, foundations: Sequence[Foundation]
) -> RealtimeModel:
    """Return a reduced model for the engine, whose periods are at most `longest` [s]."""
    check_kinds([] if contact is None else [contact], (Contact, Grasp), "contact")
    if contact is None and len(model.data.prescribed) != 1:
        raise InputError(
            f"model must have one prescribed group for the engine, got {len(model.data.prescribed)}; "
            "train it with prescribed='GROUP', or give a tool with contact="
        )
    data = _period_data(model, longest, contact, _springs(model, foundations))
    advance, stiffness = period_functions(model.body.law, model.single)
    bound, relaxes = force_bound(model.data.report), model.material.prony is not None
    if contact is None:
        tool = tool_map(model.body, model.data.prescribed[0])
        return RealtimeModel(advance, stiffness, data, np.zeros(model.count), tool, bound, relaxes=relaxes)
    return RealtimeModel(
        advance, contact_stiffness, data, np.zeros(model.count), np.eye(12), bound,
        change_tool=partial(change_tool, data), relaxes=relaxes,
    )  # fmt: skip


def _period_data(
    model: ReducedModel, longest: float, contact: Contact | Grasp | None, all_springs: Springs
) -> PeriodData:
    """Return the constants and work arrays of a period of a reduced model, with springs on all basis vectors."""
    reduced, count = model.data, model.count
    surface, home = model.body.surface, np.eye(3, 4)
    tools, contact_work = rigid_tools(None, surface), contact_scratch(surface, 0)
    if contact is not None:
        contact_tools = ContactTools(surface, model.prepare([contact]))
        contact_tools.initial_state(lambda: np.zeros((len(model.cloud), 3)), 0.0, model.cloud.spacing)
        tools, contact_work = contact_tools.tools, contact_tools.scratch
        rotation(contact_tools.prepared.schedule(np.zeros(1)).poses[0, 0], home)
        tools.path[:, :, 3] = home[:, 3]
    number_in_range("step", model.step or longest, longest / MAX_SUBSTEPS, unit="s")
    steps = int(np.ceil(longest / (model.step or longest)))
    springs = all_springs.of(np.arange(count))
    tangent = model.body.stiffness(np.zeros(count))
    if springs.stiffness.size:
        tangent += springs.stiffness
    modes, frequency, vectors = (
        slice(reduced.modes),
        model.body.highest_frequency(np.zeros(count)),
        np.zeros((8, count)),
    )
    vectors[POWER_SHAPE, : reduced.modes] = np.random.default_rng(0).standard_normal(reduced.modes)
    points_scratch = scratch(model.body.points)
    body = ImplicitData(
        stiffness_damping=model.stiffness_damping,
        mass_damping=model.mass_damping,
        mass=model.body.mass,
        differences=model.body.differences,
        tolerance=model.tolerance,
        integration_points=model.body.points,
        scratch=points_scratch,
        springs=springs,
        newton=newton_scratch(count),
    )
    return PeriodData(
        modes=reduced.modes,
        step=model.step or 0.0,
        body=body,
        constrained_inverse_mass=model.body.constrained_inverse_mass,
        indicator=_indicator(model, all_springs),
        vectors=vectors,
        probes=probes(body),
        tangent=tangent,
        condensed=np.zeros((count, count)),
        tracking=np.array([frequency, frequency, 0.0, 0.0]),
        substep=np.zeros(1),
        path=np.zeros((steps + 3, reduced.lifting_count)),
        holds=np.ones(steps, dtype=np.bool_),
        no_loads=np.zeros((steps, count)),
        contact_surface=surface,
        contact_work=contact_work,
        tools=tools,
        home=home,
        system=contact_system(
            surface.columns[:, :, modes], model.body.mass[modes, modes], len(contact_work.active.node)
        ),
        start=PeriodStart(
            history=history_copy(points_scratch.history),
            force=contact_work.force.copy(),
            place=contact_work.place.copy(),
            frames=tools.frames.copy(),
        ),
    )


def _full_body(
    model: NodalModel, contact: Contact | Grasp | None, foundations: Sequence[Foundation], tailored_modes: int | None
) -> RealtimeModel:
    """Return a full body for the engine."""
    if contact is None:
        raise InputError("contact must be a Contact or a Grasp for a full body in the engine, got none; give contact=")
    check_kinds([contact], (Contact, Grasp), "contact")
    _check_foundations(foundations)
    advance, data = full_period(model, contact, foundations, tailored_modes)
    cutter = BladeCutter(model, data) if isinstance(model, EnergySolid) and not model.planes else None
    change = partial(change_full_tool, model, data, cutter)
    if isinstance(contact, Contact) and isinstance(contact.tool, Blade):
        change(contact.tool, contact.poses(np.zeros(1))[0], 0.0)
    return RealtimeModel(
        advance, nodal_stiffness, data, np.zeros(3 * len(model.cloud)), np.eye(12),
        catch_up=CATCH_UP, change_tool=change, cutter=cutter, relaxes=model.material.prony is not None,
    )  # fmt: skip


def _check_foundations(foundations: Sequence[Foundation]) -> None:
    for load in foundations:
        if not isinstance(load, Foundation):
            raise InputError(f"foundations must be Foundation objects, got {load!r}; leave out all other loads")


def _indicator(model: ReducedModel, springs: Springs) -> IndicatorData:
    """Return the data of the error indicator, with springs on all basis vectors."""
    root = np.linalg.cholesky(model.body.mass / model.masses.sum()).T
    return IndicatorData(
        training_states=np.ascontiguousarray(model.data.training_states @ root.T),
        mass_root=root,
        distance_scale=model.data.distance_scale,
        residual_scale=model.data.residual_scale,
        flexibility_scale=model.data.flexibility_scale,
        speed_scale=model.data.speed_scale,
        nearness_scale=model.data.nearness_scale,
        nearness=nearness_to_supports(model.cloud, model.supports, model.body.surface.nodes),
        body_mass=float(model.masses.sum()),
        residual_fields=_residual_fields(model, springs),
    )


def _residual_fields(model: ReducedModel, springs: Springs) -> ResidualFields:
    """Return constants and work arrays of the residual norm."""
    data, count, nodes = model.data, model.count, model.body.surface.nodes
    which = np.arange(len(data.basis_vectors) - data.residual_fields, len(data.basis_vectors))
    at_surface = data.basis_vectors[which][:, nodes].transpose(1, 2, 0)
    return ResidualFields(
        table=data.integration_points(which, model.body.coefficients, model.single).table,
        constant=np.ascontiguousarray(data.constant[which, :count]),
        mass=np.ascontiguousarray(model.body.all_mass[which, :count]),
        springs=springs.of(which),
        columns=np.ascontiguousarray(at_surface, dtype=np.float32),
        forces=np.zeros(len(which)),
        partial=np.zeros((len(which), LANES)),
    )


def _springs(model: ReducedModel, foundations: Sequence[Foundation]) -> Springs:
    """Return the springs on all basis vectors; refuse other loads."""
    _check_foundations(foundations)
    sites = prepare_loads(model.cloud, model.supports, foundations).sites
    return project_springs(sites, model.data.basis_vectors, model.body.mass)
