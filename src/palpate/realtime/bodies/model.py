"""Real-time models for `palpate.Engine`, with a prescribed group or tools in contact, and springs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from itertools import combinations
from typing import Any, NamedTuple, overload

import numpy as np

from palpate.compiled.lanes import LANES
from palpate.core.arrays import Floats
from palpate.core.deprecation import warn_renamed
from palpate.core.describe import Fact, described_tuple
from palpate.core.faults import InputError, brief, number_in_range
from palpate.dynamics.contact.blade import Blade
from palpate.dynamics.contact.geometry import least_radius, rotation
from palpate.dynamics.contact.overlap import tools_overlap
from palpate.dynamics.contact.tools import Contact, Grasp, Sphere
from palpate.dynamics.loads.foundation import Foundation
from palpate.dynamics.loads.prepared import check_kinds, prepare_loads
from palpate.dynamics.material.relaxation import history_copy
from palpate.dynamics.nodal.model import NodalModel
from palpate.dynamics.nodal.tool_stiffness import contact_stiffness as nodal_stiffness
from palpate.dynamics.solid.model import EnergySolid
from palpate.realtime.bodies.change_tool import change_tool
from palpate.realtime.bodies.full_blade import BladeCutter
from palpate.realtime.bodies.full_body import change_full_tool, full_period
from palpate.realtime.bodies.period import period_functions
from palpate.realtime.bodies.period_data import (
    POWER_SHAPE,
    IndicatorData,
    PeriodData,
    PeriodStart,
    ResidualFields,
    Tangent,
    ToolPath,
    probes,
)
from palpate.realtime.bodies.reduced_steps import MAX_SUBSTEPS
from palpate.realtime.contract import MAX_TOOLS
from palpate.reduction.contact.surface import ContactScratch, RigidTools, contact_scratch, rigid_tools
from palpate.reduction.contact.tangent import contact_stiffness, contact_system
from palpate.reduction.contact.tools import ContactTools
from palpate.reduction.hyper.body import points_of
from palpate.reduction.hyper.error_indicator import force_bound, nearness_to_supports
from palpate.reduction.hyper.foundation import Springs, project_springs
from palpate.reduction.hyper.implicit import ImplicitData
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.hyper.newton import newton_scratch
from palpate.reduction.hyper.reactions import tool_map
from palpate.reduction.hyper.sampled_energy import scratch
from palpate.reduction.lti.model import LinearModel
from palpate.reduction.lti.realtime import LinearRealtime, linear_realtime

ABSENT_TOOL_DISTANCE = 10.0  # [m] from the body to an absent tool
MAX_BACKLOG = 4  # periods by which a full body may be late, because its periods take one step or two


@described_tuple
class RealtimeModel(NamedTuple):
    """A reduced model or a full body for the engine.

    Parameters
    ----------
    advance, stiffness : functions
        Compiled; see `period_functions` and `palpate.dynamics.nodal.period.nodal_period`.
    data : PeriodData or NodalPeriodData
    rest : (m,) array
        Coordinates at rest.
    tool : (l, 12) array, or (t, 12, 12) of t tools in contact
        Map from a rigid pose to the tool coordinates, see `palpate.reduction.hyper.reactions.tool_map`.
    force_bound : function, optional
        ``force_bound(trust, size)`` returns the error bound [N] of a tool's force, by the largest error indicator so
        far and the present force [N]. None without held-out runs with tools.
    max_backlog : int
        Number of periods by which the engine may be late and still take them all.
    change_tool : function, optional
        ``change_tool(tool, pose, friction, index=0)`` replaces a tool in contact between two periods; the body keeps
        its state, and other tools go on. `tool` is a Sphere, Capsule, Plane, Punch, Forceps or None, `pose` (7,) its
        position [m] and unit quaternion, to which later displacements and rotations are relative. The engine must be
        paused. A full body also takes a Blade, one at a time; only the first one compiles anything.
    cutter : BladeCutter, optional
        Of a solid, which the engine cuts with a blade.
    relaxes : bool
        The tissue has relaxation times; `palpate.Engine` cannot change its moduli.
    tool_names : tuple of str
        Names of the tools in contact.

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
    max_backlog: int = 0
    change_tool: Callable[..., None] | None = None
    cutter: BladeCutter | None = None
    relaxes: bool = False
    tool_names: tuple[str, ...] = ()

    def _facts(self) -> list[Fact]:
        tools = list(self.tool_names) or "a prescribed group"
        bound = "not known" if self.force_bound is None else "by the error indicator"
        return [
            ("coordinates", len(self.rest), ""),
            ("tools", tools, ""),
            ("can be cut", self.cutter is not None, ""),
            ("cuts", self.cutter.cuts if self.cutter is not None else None, ""),
            ("backlog", f"at most {self.max_backlog} periods", ""),
            ("relaxation", self.relaxes, ""),
            ("bound of the force's error", bound, ""),
        ]

    @property
    def catch_up(self) -> int:
        """Former name of `max_backlog`."""
        warn_renamed("RealtimeModel.catch_up", "RealtimeModel.max_backlog")
        return self.max_backlog


@overload
def realtime_model(
    model: ReducedModel,
    *,
    longest: float = ...,
    contact: Contact | Grasp | Sequence[Contact | Grasp] | None = ...,
    foundations: Foundation | Sequence[Foundation] = ...,
) -> RealtimeModel: ...


@overload
def realtime_model(
    model: NodalModel | ReducedModel,
    *,
    contact: Contact | Grasp | Sequence[Contact | Grasp] | None,
    foundations: Foundation | Sequence[Foundation] = ...,
    scaled_modes: int | None = ...,
) -> RealtimeModel: ...


@overload
def realtime_model(model: LinearModel, *, period: float = ...) -> LinearRealtime: ...


def realtime_model(
    model: ReducedModel | LinearModel | NodalModel,
    *,
    longest: float = 0.02,
    contact: Contact | Grasp | Sequence[Contact | Grasp] | None = None,
    foundations: Foundation | Sequence[Foundation] = (),
    period: float = 1e-3,
    scaled_modes: int | None = None,
    tailored_modes: int | None = None,
) -> RealtimeModel | LinearRealtime:
    """Return a model for `palpate.Engine`, with a tool that holds the prescribed group, or tools that touch the body.

    Parameters
    ----------
    model : ReducedModel, LinearModel, or Solid or Membrane in the energy form
        A full body has no error indicator. Its contact stiffness follows from the tool's displacement and force
        (`palpate.dynamics.nodal.tool_stiffness`).
    longest : float [s]
        Longest period that the engine may request.
    contact : Contact or Grasp, or sequence of up to four, optional
        The tools in contact, of different names; one Blade at most. The engine's poses are displacements and rotations
        from a tool's pose at time 0, the rotations about its position. The error indicator then counts the distance
        from the training states, the displacement of the surface compliance, the speed, and the nearness of the tools
        to supports, each over its scale.
    foundations : Foundation or sequence of Foundation
        Springs between the body and the ground. Other loads are not supported in real time.
    period : float [s]
        Of a linear model. The first step with another period computes a matrix exponential.
    scaled_modes : int, optional
        Number of the fastest modes of a full body that get more mass, so that its steps are 1.4 to 2 times as long;
        0 for steps as those of `rollout`. By default 20 to 40 for a solid of at least 500 nodes with stiffness damping.
        Equilibria and all other modes are unchanged (`palpate.dynamics.nodal.mass_scaling`).
    tailored_modes : int, optional
        Former name of `scaled_modes`.

    Raises
    ------
    InputError
        The model was not trained with exactly one prescribed group, or with contact; a load is not a
        `Foundation`. Tools begin in the body or in each other, have one name, or are more than four. A linear
        system does not have exactly one tool, or has other loads.

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
    if tailored_modes is not None:
        warn_renamed("realtime_model(tailored_modes=)", "realtime_model(scaled_modes=)")
        scaled_modes = tailored_modes
    if isinstance(model, LinearModel):
        if contact is not None or foundations:
            raise InputError(
                "contact and foundations must be left out for a linear model; "
                "linearise the body with one PrescribedMotion or Grasp"
            )
        return linear_realtime(model, period)
    tools = _tools_in_contact(contact)
    foundations = (foundations,) if isinstance(foundations, Foundation) else foundations
    if isinstance(model, NodalModel):
        return _full_body(model, tools, foundations, scaled_modes)
    if scaled_modes is not None:
        raise InputError(f"scaled_modes must be left out for a reduced model, got {scaled_modes!r}")
    return _reduced_body(model, longest, tools, foundations)


def _tools_in_contact(contact: Contact | Grasp | Sequence[Contact | Grasp] | None) -> tuple[Contact | Grasp, ...]:
    """Return the tools; raise `InputError` for too many, for two of one name, and for some that begin in each other."""
    sequence = () if contact is None else (contact,) if isinstance(contact, Contact | Grasp) else contact
    if not isinstance(sequence, Sequence):
        raise InputError(f"contact must be a Contact or a Grasp, or a list of these, got {brief(contact)}")
    tools = tuple(sequence)
    check_kinds(tools, (Contact, Grasp), "contact")
    if len(tools) > MAX_TOOLS:
        raise InputError(f"contact must have at most {MAX_TOOLS} tools, got {len(tools)}; leave out some")
    names = [tool.name for tool in tools]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"name of every tool must be unique, got {name!r} twice; give one of them name=")
    blades = [tool.name for tool in tools if isinstance(tool, Contact) and isinstance(tool.tool, Blade)]
    if len(blades) > 1:
        raise InputError(f"contact must have one Blade at most, got {', '.join(map(repr, blades))}; leave out one")
    placed = [(tool, tool.poses(np.zeros(1))[0]) for tool in tools if isinstance(tool, Contact)]
    for (tool, pose), (other, other_pose) in combinations(placed, 2):
        if tools_overlap(tool.tool, pose, other.tool, other_pose):
            raise InputError(f"tools must begin apart, got {tool.name!r} in {other.name!r}; move one of them")
    return tools


def idle_model(
    model: ReducedModel | NodalModel, foundations: Sequence[Foundation] = (), tools: int = 1
) -> RealtimeModel:
    """Return a model for the engine that takes a number of tools by `RealtimeModel.change_tool`, and has none yet.

    A reduced model that was trained without tools has its prescribed group as the tool, and no `change_tool`.
    """
    takes_tools = not isinstance(model, ReducedModel) or (
        not model.data.prescribed and model.data.compliance is not None
    )
    away = np.pad(model.cloud.points.max(axis=0), (0, 3 - model.cloud.points.shape[1])) + ABSENT_TOOL_DISTANCE
    sphere = Sphere(least_radius(model.cloud))
    absent = [Contact(sphere, away + 4 * t * sphere.radius, name=f"tool {t + 1}") for t in range(tools)]
    ready = realtime_model(model, contact=absent if takes_tools else None, foundations=foundations)
    for t in range(tools if ready.change_tool is not None else 0):
        assert ready.change_tool is not None
        ready.change_tool(None, np.array([0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0]), 0.0, t)
    return ready


def _reduced_body(
    model: ReducedModel, longest: float, tools: tuple[Contact | Grasp, ...], foundations: Sequence[Foundation]
) -> RealtimeModel:
    """Return a reduced model for the engine, whose periods are at most `longest` [s]."""
    if not tools and len(model.data.prescribed) != 1:
        raise InputError(
            f"model must have one prescribed group for the engine, got {len(model.data.prescribed)}; "
            "train it with prescribed='GROUP', or give a tool with contact="
        )
    data = _period_data(model, longest, tools, _springs(model, foundations))
    advance, stiffness = period_functions(model.body.law, model.single, model.step is not None, len(tools) > 0)
    bound, relaxes = force_bound(model.data.report), model.material.prony is not None
    if not tools:
        tool = tool_map(model.body, model.data.prescribed[0])
        return RealtimeModel(advance, stiffness, data, np.zeros(model.count), tool, bound, relaxes=relaxes)
    return RealtimeModel(
        advance, contact_stiffness, data, np.zeros(model.count), _pose_coordinates(tools), bound,
        change_tool=partial(change_tool, data), relaxes=relaxes, tool_names=tuple(tool.name for tool in tools),
    )  # fmt: skip


def _pose_coordinates(tools: Sequence[Any]) -> Floats:
    """Return the map from poses of tools in contact to their coordinates, which are displacement and R - I."""
    return np.eye(12) if len(tools) == 1 else np.tile(np.eye(12), (len(tools), 1, 1))


def _period_data(
    model: ReducedModel, longest: float, contact: tuple[Contact | Grasp, ...], all_springs: Springs
) -> PeriodData:
    """Return the constants and work arrays of a period of a reduced model, with springs on the trial and test basis."""
    number_in_range("step", model.step or longest, longest / MAX_SUBSTEPS, unit="s")
    count, modes = model.count, model.data.modes
    steps = int(np.ceil(longest / (model.step or longest)))
    springs, constants = all_springs.of(np.arange(count)), model.body.constants
    tools, contact_work, home = _tools_at_home(model, contact)
    tangent, frequency = model.body.stiffness(np.zeros(count)), model.body.highest_frequency(np.zeros(count))
    if springs.stiffness.size:
        tangent += springs.stiffness
    vectors, surface = np.zeros((8, count)), model.body.surface
    vectors[POWER_SHAPE, :modes] = np.random.default_rng(0).standard_normal(modes)
    points_scratch = scratch(constants.cubature_points)
    body = ImplicitData(constants, model.tolerance, points_scratch, springs, newton_scratch(count))
    return PeriodData(
        modes=modes,
        step=model.step or 0.0,
        body=body,
        indicator=_indicator(model, all_springs),
        vectors=vectors,
        tangent=Tangent(tangent, np.zeros((count, count)), probes(body)),
        tracking=np.array([frequency, frequency, 0.0, 0.0]),
        substep=np.zeros(1),
        path=ToolPath(
            np.zeros((steps + 3, model.data.lifting_count)), np.ones(steps, dtype=np.bool_), np.zeros((steps, count))
        ),
        contact_surface=surface,
        contact_work=contact_work,
        tools=tools,
        home=home,
        system=contact_system(
            surface.columns[:, :, :modes], constants.mass[:modes, :modes], len(contact_work.active.node), len(contact)
        ),
        start=PeriodStart(
            history=history_copy(points_scratch.history),
            force=contact_work.force.copy(),
            place=contact_work.place.copy(),
            frames=tools.frames.copy(),
        ),
    )


def _tools_at_home(
    model: ReducedModel, contact: tuple[Contact | Grasp, ...]
) -> tuple[RigidTools, ContactScratch, Floats]:
    """Return tools in contact at time 0, the work arrays of their contact, and their rotations and positions."""
    surface, home = model.body.surface, np.tile(np.eye(3, 4), (len(contact), 1, 1))
    if not contact:
        return rigid_tools(None, surface), contact_scratch(surface, 0), home
    placed = ContactTools(surface, model.prepare(list(contact)))
    placed.initial_state(lambda: np.zeros((len(model.cloud), 3)), 0.0, model.cloud.spacing)
    for t, pose in enumerate(placed.prepared.schedule(np.zeros(1)).poses[0]):
        rotation(pose, home[t])
    placed.tools.path[:, :, :, 3] = home[:, None, :, 3]
    return placed.tools, placed.scratch, home


def _full_body(
    model: NodalModel,
    tools: tuple[Contact | Grasp, ...],
    foundations: Sequence[Foundation],
    scaled_modes: int | None,
) -> RealtimeModel:
    """Return a full body for the engine."""
    if not tools:
        raise InputError("contact must be a Contact or a Grasp for a full body in the engine, got none; give contact=")
    _check_foundations(foundations)
    advance, data = full_period(model, tools, foundations, scaled_modes)
    cutter = BladeCutter(model, advance, data) if isinstance(model, EnergySolid) and not model.planes else None
    change = partial(change_full_tool, model, data, cutter)
    for t, tool in enumerate(tools):
        if isinstance(tool, Contact) and isinstance(tool.tool, Blade):
            change(tool.tool, tool.poses(np.zeros(1))[0], 0.0, t)
    if cutter is not None:
        advance = cutter.advance
    return RealtimeModel(
        advance, nodal_stiffness, data, np.zeros(3 * len(model.cloud)), _pose_coordinates(tools),
        max_backlog=MAX_BACKLOG, change_tool=change, cutter=cutter, relaxes=model.material.prony is not None,
        tool_names=tuple(tool.name for tool in tools),
    )  # fmt: skip


def _check_foundations(foundations: Sequence[Foundation]) -> None:
    for load in foundations:
        if not isinstance(load, Foundation):
            raise InputError(f"foundations must be Foundation objects, got {load!r}; leave out all other loads")


def _indicator(model: ReducedModel, springs: Springs) -> IndicatorData:
    """Return the data of the error indicator, with springs on the trial and test basis."""
    root = np.linalg.cholesky(model.body.mass / model.masses.sum()).T
    return IndicatorData(
        training_states=np.ascontiguousarray(model.data.training_states @ root.T),
        mass_root=root,
        scales=model.data.scales,
        nearness=nearness_to_supports(model.cloud, model.supports, model.body.surface.nodes),
        body_mass=float(model.masses.sum()),
        residual_fields=_residual_fields(model, springs),
    )


def _residual_fields(model: ReducedModel, springs: Springs) -> ResidualFields:
    """Return constants and work arrays of the residual norm."""
    data, count, nodes = model.data, model.count, model.body.surface.nodes
    which = np.arange(len(data.trial_and_test_basis) - data.residual_fields, len(data.trial_and_test_basis))
    at_surface = data.trial_and_test_basis[which][:, nodes].transpose(1, 2, 0)
    return ResidualFields(
        table=points_of(data, which, model.body.coefficients, model.single).table,
        constant=np.ascontiguousarray(data.sampled.constant[which, :count]),
        mass=np.ascontiguousarray(model.body.all_mass[which, :count]),
        springs=springs.of(which),
        columns=np.ascontiguousarray(at_surface, dtype=np.float32),
        forces=np.zeros(len(which)),
        partial=np.zeros((len(which), LANES)),
    )


def _springs(model: ReducedModel, foundations: Sequence[Foundation]) -> Springs:
    """Return the springs on the trial and test basis; refuse other loads."""
    _check_foundations(foundations)
    sites = prepare_loads(model.cloud, model.supports, foundations).sites
    return project_springs(sites, model.data.trial_and_test_basis, model.body.mass)
