"""A full body for the engine, with tools in contact, and the change of a tool."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from palpate.core.arrays import Floats, Ints
from palpate.core.faults import InputError, integer_in_range
from palpate.dynamics.contact.blade import Blade
from palpate.dynamics.contact.geometry import Contacts, curvatures, least_radius, rotation
from palpate.dynamics.contact.grip import COUNT, empty_grip, grasped_nodes, nodes_in_grip, set_grip
from palpate.dynamics.contact.impulses import contact_kind
from palpate.dynamics.contact.kinds import CAPSULE, PLANE
from palpate.dynamics.contact.penetration import MAX_SURFACE_DEPTH
from palpate.dynamics.contact.tools import Contact, Forceps, Grasp, Sphere, Tool
from palpate.dynamics.loads.foundation import Foundation
from palpate.dynamics.loads.prepared import LoadSites
from palpate.dynamics.loads.supports import FIXED, FREE
from palpate.dynamics.material.relaxation import history_copy
from palpate.dynamics.nodal.central_difference import Damping
from palpate.dynamics.nodal.mass_scaling import MAX_MODES, PROBE, default_modes, scaled_mass
from palpate.dynamics.nodal.model import NodalModel, NodalWork, nodal_data
from palpate.dynamics.nodal.period import nodal_period
from palpate.dynamics.nodal.period_data import (
    BASE_FREQUENCY,
    BLOCK_NODES,
    FREQUENCY,
    GAINED,
    HELD,
    KICK_SQUARE,
    LOST,
    NO_BLADE,
    REPEATED,
    STEP,
    ContactReport,
    MovingTools,
    NodalPeriodData,
    PeriodCopy,
    PowerIteration,
    Secant,
    SteppedBody,
    WayLimits,
)
from palpate.dynamics.nodal.tool_path import END, HOME, LAST_CUT, START
from palpate.dynamics.solid.base import Solid
from palpate.realtime.bodies.change_tool import refuse_held_nodes
from palpate.realtime.bodies.full_blade import BladeCutter

MAX_WAY, MAX_TOOL_WAY = 0.4, 0.25  # of a node and of the tool in a step, in spacings
AWAY_DISTANCE = 1e3  # [m] beyond the body, where a tool stays while forceps hold it


def full_period(
    model: NodalModel,
    tools: Sequence[Contact | Grasp],
    foundations: Sequence[Foundation],
    scaled_modes: int | None,
) -> tuple[object, NodalPeriodData]:
    """Return the compiled period of a full body and its data.

    See `palpate.realtime.bodies.model.realtime_model` for the number of modes.
    """
    if not model.conservative:
        raise InputError("model must have the energy form for the engine, got the strong form; leave form= out")
    away = Sphere(2 * model.cloud.spacing), np.full(3, model.cloud.points.max() + AWAY_DISTANCE)
    touching = [
        Contact(*away, name=tool.name) if isinstance(tool, Grasp) or isinstance(tool.tool, Blade) else tool
        for tool in tools
    ]
    prepared, work = model.prepare([*touching, *foundations]), model.workspace()
    model.state(prepared)  # refuses a tool inside the body
    sites, contacts = prepared.with_scratch()
    body = _stepped_body(model, work, sites, prepared.constraint_mask(0.0), scaled_modes)
    data = NodalPeriodData(
        body=body,
        tools=_moving_tools(model, contacts, prepared.schedule(np.zeros(1)).poses[0]),
        limits=_way_limits(model.cloud.spacing),
        iteration=_power_iteration(model),
        start=PeriodCopy(np.zeros((3, len(model.cloud), 3)), np.zeros(2), history_copy(work.passes.history)),
        scratch=work.step,
        sums=np.zeros((-(-len(model.cloud) // BLOCK_NODES), KICK_SQUARE + 1)),
        stepping=_stepping_at_rest(model.stability.step, body.resting_frequency),
        energies=np.zeros(6),
        counts=np.zeros(3),
        contact_work=_contact_report(contacts, len(tools)),
    )
    for t, tool in enumerate(tools):
        if isinstance(tool, Grasp):
            forceps = Forceps(tool.radius, tool.point, tool.until)
            change_full_tool(model, data, None, forceps, tool.poses(np.zeros(1))[0], 0.0, t)
    return nodal_period(model.formulation, contact_kind(contacts)), data


def _stepped_body(
    model: NodalModel, work: NodalWork, sites: LoadSites, fixed: NDArray[np.bool_], scaled_modes: int | None
) -> SteppedBody:
    """Return the constants of a body with its scaled mass, on foundations at its sites."""
    n = len(model.cloud)
    if scaled_modes is None:
        damped = isinstance(model, Solid) and model.stiffness_damping > 0.0  # else no motion of fast modes decays
        scaled_modes = default_modes(n) if damped else 0
    scaled_modes = integer_in_range("scaled_modes", scaled_modes, 0, MAX_MODES)
    mass_scaling, frequency = scaled_mass(model, fixed, scaled_modes)
    if len(sites.foundation_node):
        response = 1.0 / (model.volumes[sites.foundation_node] * model.material.density)
        springs = np.sqrt(np.bincount(sites.foundation_node, sites.foundation_spring * response, minlength=n).max())
        frequency = float(np.hypot(frequency, springs))
        mass_scaling = mass_scaling._replace(plain_frequency=float(np.hypot(mass_scaling.plain_frequency, springs)))
    return SteppedBody(
        passes=(model.step_body, work.step_passes),
        tension_compression_passes=(model.tension_compression_step_body, work.step_passes),
        nodes=nodal_data(model),
        damping=Damping(model.mass_damping, model.stiffness_damping, model.wave_speed),
        sites=sites,
        mass_scaling=mass_scaling,
        resting_frequency=frequency,
        triangles=np.ascontiguousarray(model.cloud.triangles, dtype=np.int64),
    )


def _moving_tools(model: NodalModel, contacts: Contacts, poses: Floats) -> MovingTools:
    """Return tools at rest at poses (t, 7), without a blade and forceps."""
    count, n = len(poses), len(model.cloud)
    path = np.zeros((count, 6, 3, 4))
    for t, pose in enumerate(poses):
        rotation(pose, path[t, HOME])
    path[:, START], path[:, END], contacts.work.frames[:, 1] = path[:, HOME], path[:, HOME], path[:, HOME]
    return MovingTools(
        contacts=contacts,
        grip=empty_grip(count, n),
        blade=NO_BLADE,
        path=path,
        late=np.zeros(count, dtype=np.int64),
        clear_way=np.zeros(count),
        listed=np.zeros((n, 3)),
        near_margin=np.full(1, -1.0),
        force=np.zeros(12 * count),
        secant=_secant(model, count),
    )


def _way_limits(spacing: float) -> WayLimits:
    """Return the largest ways of a body's nodes and tools by its spacing [m]."""
    tool = MAX_TOOL_WAY * spacing
    return WayLimits(MAX_WAY * spacing, tool, tool, cut=np.inf, surface_depth=MAX_SURFACE_DEPTH * spacing)


def _power_iteration(model: NodalModel) -> PowerIteration:
    """Return the start of the power iteration for the highest frequency."""
    noise = model.supported.project(np.random.default_rng(0).standard_normal((len(model.cloud), 3)))
    return PowerIteration(noise.copy(), noise, amplitude=PROBE * model.cloud.spacing)


def _contact_report(contacts: Contacts, tools: int) -> ContactReport:
    """Return a report without forces."""
    # two for each edge midpoint, and one for each node that forceps hold
    entries = 2 * tools * len(contacts.patches.points)
    node, tool = np.zeros((2, entries), dtype=np.int64)
    return ContactReport(node, tool, np.zeros((entries, 3)), np.zeros(3, dtype=np.int64))


def _secant(model: NodalModel, tools: int) -> Secant:
    """Return the contact stiffness of tools that do not touch, and the moduli of its bound, those of the stiffest part.

    The fastest waves show what fibres add to the law.
    """
    factor = model.tissue.stiffness if len(model.tissue.stiffness) else 1.0
    shear = float(np.max(factor * model.tissue.moduli("shear_modulus")))
    bulk = float(np.max(factor * model.tissue.moduli("bulk_modulus")))
    plane, uniaxial = 4.0 * shear, 4.0 * shear  # of an incompressible sheet
    if bulk < np.inf:
        plane, uniaxial = 4.0 * shear * (3.0 * bulk + shear) / (3.0 * bulk + 4.0 * shear), bulk + 4.0 / 3.0 * shear
    if model.fibres is not None:
        stiffest = max(1.0, model.material.density * model.wave_speed**2 / uniaxial)
        plane, uniaxial = stiffest * plane, stiffest * uniaxial
    return Secant(
        stiffness=np.zeros((3 * tools, 3 * tools)),
        positions=np.zeros(3 * tools),
        forces=np.zeros(3 * tools),
        unrest=np.zeros(1),
        radius=np.zeros(tools),
        bound=np.zeros(tools),
        way=np.zeros(3 * tools),
        excess=np.zeros(3 * tools),
        fade=np.zeros(tools),
        supports=np.flatnonzero(model.supported.kind != FREE),
        plane_modulus=plane,
        uniaxial_modulus=uniaxial,
        spacing=model.cloud.spacing,
    )


def _stepping_at_rest(step: float, frequency: float) -> Floats:
    """Return `NodalPeriodData.stepping` for a step [s] and the highest frequency [rad/s] at rest."""
    stepping = np.zeros(7)
    stepping[STEP], stepping[FREQUENCY], stepping[BASE_FREQUENCY] = step, frequency, frequency
    return stepping


def step_statistics(data: NodalPeriodData) -> dict[str, float]:
    """Return how a full body was stepped since rest.

    - ``"step_share"``: present step over that at rest
    - ``"tailored_modes"``: number of modes with more mass
    - ``"step_gain"``: step at rest over that without them
    - ``"repeated"``: number of periods that were repeated with shorter steps
    - ``"held"``: number of periods in which the tool was held or late
    - ``"energy_gained"``: gain of energy that shorter steps did not cure [J]
    """
    return {
        "step_share": float(data.body.resting_frequency / data.stepping[FREQUENCY]),
        "tailored_modes": int(np.count_nonzero(data.body.mass_scaling.used)),
        "step_gain": float(data.body.mass_scaling.plain_frequency / data.body.resting_frequency),
        "repeated": int(data.counts[REPEATED]),
        "held": int(data.counts[HELD]),
        "energy_gained": float(data.energies[GAINED]),
    }


def change_full_tool(
    model: NodalModel,
    data: NodalPeriodData,
    cutter: BladeCutter | None,
    tool: Tool | None,
    pose: Floats,
    friction: float,
    index: int = 0,
) -> None:
    """Replace a tool of a full body, as `palpate.realtime.bodies.change_tool.change_tool`."""
    tools, blade, nodes = data.tools, None, np.zeros(0, dtype=np.int64)
    if isinstance(tool, Blade):
        _check_blade(cutter, index)
        blade, tool = tool, None
    elif isinstance(tool, Forceps):
        nodes, tool = _free_nodes(model, data, tool, index), None
    elif tool is not None and tool.kind != PLANE and tool.sizes[0] < (least := least_radius(model.cloud)):
        spacings = "the spacing" if least == model.cloud.spacing else "two spacings"
        raise InputError(
            f"radius of the tool must be at least {spacings} of the body, {1e3 * least:.3g} mm, got "
            f"{1e3 * tool.sizes[0]:.3g} mm; use a larger tool or a finer body"
        )
    _grasp(data, nodes, index)
    _put_shape(tools.contacts, tool, friction, index)
    tools.secant.stiffness[:], tools.secant.forces[:] = 0.0, 0.0
    tools.force[12 * index : 12 * (index + 1)] = 0.0
    data.energies[LOST] += tools.contacts.held.energy[index]  # of the tissue over supports, which springs back
    tools.contacts.held.energy[index] = 0.0
    data.contact_work.numbers[:], tools.near_margin[0] = 0, -1.0
    rotation(pose, tools.path[index, HOME])
    if cutter is not None:
        cutter.set_blade(blade, pose, index)
    for frame in (START, END, LAST_CUT):
        tools.path[index, frame] = tools.path[index, HOME]
    tools.contacts.work.frames[index, 1] = tools.path[index, HOME]


def _check_blade(cutter: BladeCutter | None, index: int) -> None:
    if cutter is None:
        raise InputError("tool must be another than a Blade, got a Blade for a sheet or a body with planes of symmetry")
    if cutter.blade not in (NO_BLADE, index):
        raise InputError(f"tools must have one Blade at most, got tool {cutter.blade} as another; put it away first")


def _free_nodes(model: NodalModel, data: NodalPeriodData, forceps: Forceps, index: int) -> Ints:
    """Return the nodes that forceps hold; refuse those that other forceps hold."""
    if forceps.until < np.inf:
        raise InputError(f"until of forceps must be infinite in the engine, got {forceps.until:g} s; change the tool")
    nodes, grip = grasped_nodes(model.cloud, forceps, data.body.sites.kind == FREE), data.tools.grip
    others = [grip.node[t, :count] for t, (count, _) in enumerate(grip.numbers) if t != index]
    refuse_held_nodes(np.isin(nodes, np.concatenate([nodes[:0], *others])))
    return nodes


def _grasp(data: NodalPeriodData, nodes: Ints, index: int) -> None:
    """Let a tool hold nodes in place of those that it holds; pushes of other tools on these have no effect."""
    contacts, grip = data.tools.contacts, data.tools.grip
    contacts.work.step_impulses[grip.node[index, : grip.numbers[index, COUNT]]] = 0.0
    set_grip(grip, index, nodes)
    patches, gripped = contacts.patches, nodes_in_grip(grip)
    held = np.isin(patches.ends, gripped).any(axis=1)  # bears what other tools push on it
    supported = (data.body.sites.kind[patches.ends] == FIXED).any(axis=1)
    patches.prescribed_until[:] = np.where(held | supported, np.inf, -np.inf)


def _put_shape(contacts: Contacts, tool: Tool | None, friction: float, index: int) -> None:
    """Write the shape of a tool, or of none, to the arrays of the contacts."""
    shapes = contacts.tools
    shapes.kind[index] = CAPSULE if tool is None else tool.kind
    shapes.sizes[index] = (-np.inf, 0.0, 0.0) if tool is None else tool.sizes  # every point is outside
    shapes.curvature[index] = curvatures(shapes.kind, shapes.sizes)[index]
    shapes.radius[index] = 0.0 if tool is None else np.inf
    if tool is not None and tool.kind == CAPSULE:
        shapes.radius[index] = tool.sizes[0] + tool.sizes[1]
    shapes.friction[index] = friction
    contacts.work.patch_impulses[contacts.candidates.start[index] : contacts.candidates.start[index + 1]] = 0.0
