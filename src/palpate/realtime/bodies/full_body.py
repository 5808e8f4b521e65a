"""A full body for the engine, with one tool in contact, and the change of that tool."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from palpate.arrays import Floats
from palpate.dynamics.contact.blade import Blade
from palpate.dynamics.contact.geometry import curvatures, rotation
from palpate.dynamics.contact.grip import empty_grip, grasped_nodes, set_grip
from palpate.dynamics.contact.kinds import CAPSULE, PLANE
from palpate.dynamics.contact.penetration import MAX_SURFACE_DEPTH
from palpate.dynamics.contact.tools import Contact, Forceps, Grasp, Sphere, Tool
from palpate.dynamics.loads.foundation import Foundation
from palpate.dynamics.loads.supports import FREE
from palpate.dynamics.material.relaxation import history_copy
from palpate.dynamics.nodal.central_difference import Damping
from palpate.dynamics.nodal.mass_tailoring import MAX_MODES, PROBE, default_modes, tailored_mass
from palpate.dynamics.nodal.model import NodalModel, nodal_data
from palpate.dynamics.nodal.period import (
    BASE_FREQUENCY,
    BLOCK_NODES,
    FREQUENCY,
    GAINED,
    HELD,
    LOST,
    NEAR_MARGIN,
    REPEATED,
    STEP,
    ContactReport,
    NodalPeriodData,
    nodal_period,
)
from palpate.dynamics.nodal.tool_path import END, HOME, LAST_CUT, START
from palpate.dynamics.solid.base import Solid
from palpate.faults import InputError, integer_in_range
from palpate.realtime.bodies.full_blade import BladeCutter

MAX_WAY, MAX_TOOL_WAY = 0.4, 0.25  # of a node and of the tool in a step, in spacings
AWAY_DISTANCE = 1e3  # [m] beyond the body, where a tool stays while forceps hold it


def full_period(
    model: NodalModel, contact: Contact | Grasp, foundations: Sequence[Foundation], tailored_modes: int | None
) -> tuple[object, NodalPeriodData]:
    """Return the compiled period of a full body and its data.

    See `palpate.realtime.bodies.model.realtime_model` for the number of modes.
    """
    if not model.conservative:
        raise InputError("model must have the energy form for the engine, got the strong form; leave form= out")
    tool = contact
    if isinstance(contact, Grasp) or isinstance(contact.tool, Blade):
        tool = Contact(Sphere(2 * model.cloud.spacing), np.full(3, model.cloud.points.max() + AWAY_DISTANCE))
    prepared, work = model.prepare([tool, *foundations]), model.workspace()
    model.state(prepared)  # refuses a tool inside the body
    sites, contacts = prepared.with_scratch()
    n = len(model.cloud)
    if tailored_modes is None:
        damped = isinstance(model, Solid) and model.stiffness_damping > 0.0  # else no motion of fast modes decays
        tailored_modes = default_modes(n) if damped else 0
    tailored_modes = integer_in_range("tailored_modes", tailored_modes, 0, MAX_MODES)
    tailoring, frequency = tailored_mass(model, prepared.constraint_mask(0.0), tailored_modes)
    if len(sites.foundation_node):
        response = 1.0 / (model.volumes[sites.foundation_node] * model.material.density)
        springs = np.sqrt(np.bincount(sites.foundation_node, sites.foundation_spring * response, minlength=n).max())
        frequency = float(np.hypot(frequency, springs))
        tailoring = tailoring._replace(plain_frequency=float(np.hypot(tailoring.plain_frequency, springs)))
    path = np.zeros((6, 3, 4))
    rotation(prepared.schedule(np.zeros(1)).poses[0, 0], path[HOME])
    path[START], path[END], contacts.frames[0, 1] = path[HOME], path[HOME], path[HOME]
    entries = 2 * len(contacts.points)  # two for each middle of an edge, and one for each node that forceps hold
    noise = model.supported.project(np.random.default_rng(0).standard_normal((n, 3)))
    data = NodalPeriodData(
        passes=(model.step_body, work.step_passes),
        taut_passes=(model.taut_step_body, work.step_passes),
        nodes=nodal_data(model),
        damping=Damping(model.mass_damping, model.stiffness_damping, model.wave_speed),
        sites=sites,
        contacts=contacts,
        grip=empty_grip(n),
        scratch=work.step,
        clock=_clock_at_rest(model.stability.step, frequency),
        sums=np.zeros((-(-n // BLOCK_NODES), 5)),
        secant=np.zeros((5, 3)),
        tool_force=np.zeros(12),
        path=path,
        tailoring=tailoring,
        resting_frequency=frequency,
        vector=noise.copy(),
        noise=noise,
        amplitude=PROBE * model.cloud.spacing,
        reach=MAX_WAY * model.cloud.spacing,
        tool_reach=MAX_TOOL_WAY * model.cloud.spacing,
        cut_reach=np.inf,
        triangles=np.ascontiguousarray(model.cloud.triangles, dtype=np.int64),
        surface_depth=MAX_SURFACE_DEPTH * model.cloud.spacing,
        listed=np.zeros((n, 3)),
        saved=np.zeros((3, n, 3)),
        saved_work=np.zeros(2),
        saved_history=history_copy(work.passes.history),
        contact_work=ContactReport(
            np.zeros(entries, dtype=np.int64), np.zeros((entries, 3)), np.zeros(3, dtype=np.int64)
        ),
    )  # fmt: skip
    if isinstance(contact, Grasp):
        forceps = Forceps(contact.radius, contact.point, contact.until)
        change_full_tool(model, data, None, forceps, contact.poses(np.zeros(1))[0], 0.0)
    return nodal_period(model.formulation), data


def _clock_at_rest(step: float, frequency: float) -> Floats:
    """Return `NodalPeriodData.clock` for a step [s] and the highest frequency [rad/s] at rest."""
    clock = np.zeros(BASE_FREQUENCY + 1)
    clock[STEP], clock[FREQUENCY], clock[BASE_FREQUENCY] = step, frequency, frequency
    clock[NEAR_MARGIN] = -1.0
    return clock


def step_statistics(data: NodalPeriodData) -> dict[str, float]:
    """Return how a full body was stepped since rest.

    Returns
    -------
    dict
        ``"step_share"``: present step over that at rest; ``"tailored_modes"``: number of modes with more mass;
        ``"step_gain"``: step at rest over that without them;
        ``"repeated"``: number of periods that were repeated with shorter steps; ``"held"``: number of periods in which
        the tool was held or late; ``"energy_gained"``: gain of energy that shorter steps did not cure [J].
    """
    clock = data.clock
    return {
        "step_share": float(data.resting_frequency / clock[FREQUENCY]),
        "tailored_modes": int(np.count_nonzero(data.tailoring.used)),
        "step_gain": float(data.tailoring.plain_frequency / data.resting_frequency),
        "repeated": int(clock[REPEATED]),
        "held": int(clock[HELD]),
        "energy_gained": float(clock[GAINED]),
    }


def change_full_tool(
    model: NodalModel,
    data: NodalPeriodData,
    cutter: BladeCutter | None,
    tool: Tool | None,
    pose: Floats,
    friction: float,
) -> None:
    """Replace the tool of a full body, as `palpate.realtime.bodies.change_tool.change_tool`."""
    contacts, spacing, nodes = data.contacts, model.cloud.spacing, np.zeros(0, dtype=np.int64)
    blade = None
    if isinstance(tool, Blade):
        if cutter is None:
            raise InputError(
                "tool must be another than a Blade, got a Blade for a sheet or a body with planes of symmetry"
            )
        blade, tool = tool, None
    if isinstance(tool, Forceps):
        if tool.until < np.inf:
            raise InputError(f"until of forceps must be infinite in the engine, got {tool.until:g} s; change the tool")
        nodes, tool = grasped_nodes(model.cloud, tool, data.sites.kind == FREE), None
    if tool is not None and tool.kind != PLANE and tool.sizes[0] < spacing:
        raise InputError(
            f"radius of the tool must be at least the spacing of the body, {1e3 * spacing:.3g} mm, got "
            f"{1e3 * tool.sizes[0]:.3g} mm; use a larger tool or a finer body"
        )
    set_grip(data.grip, nodes)
    contacts.kind[0] = CAPSULE if tool is None else tool.kind
    contacts.sizes[0] = (-np.inf, 0.0, 0.0) if tool is None else tool.sizes  # every point is outside
    contacts.curvature[0] = curvatures(contacts.kind, contacts.sizes)[0]
    contacts.tool_radius[0] = 0.0 if tool is None else np.inf
    if tool is not None and tool.kind == CAPSULE:
        contacts.tool_radius[0] = tool.sizes[0] + tool.sizes[1]
    contacts.friction[0] = friction
    contacts.patch_impulses[:], contacts.step_impulses[:], contacts.active_count[0] = 0.0, 0.0, 0
    data.secant[:], data.tool_force[:] = 0.0, 0.0
    data.clock[LOST] += contacts.held.energy[0]  # of the tissue over supports, which springs back
    contacts.held.energy[0], contacts.held.forces[:] = 0.0, 0.0
    data.contact_work.numbers[:], data.clock[NEAR_MARGIN] = 0, -1.0
    rotation(pose, data.path[HOME])
    if cutter is not None:
        cutter.set_blade(blade, pose)
    for frame in (START, END, LAST_CUT):
        data.path[frame] = data.path[HOME]
    contacts.frames[0, 1] = data.path[HOME]
