"""Instrumented model: publishes its contact forces, with optional virtual couplings and a variable stiffness.

The record of the engine has the coordinates of a period but not the contact forces on the surface. An instrumented
model publishes both in one slot after every period, so that readers need no lock and receive values of one period.

A virtual coupling is a spring and a damper between the pose p of a haptic device and the position x of its tool:

    m dv/dt = K (p - x) + B (dp/dt - v) + f,

where m is a small mass of the tool and f the force of the body. The spring and the damper are evaluated at the end of a
period and f at its start (symplectic Euler). The coupling is passive if B > K' h / 2 and m > K' h^2 / 4, for a body of
stiffness K' and a period h. Rotations are not coupled: the tool follows them directly.

With a force limit F the spring saturates where K |p - x| > F: it pulls with F towards the device, and the damper
resists the tool's own velocity. The potential is then F |p - x| - F^2 / (2 K), so that the coupling stays passive,
and the tool lags behind the device.

Multiplying all moduli by s at constant density is a change of time scale: M q'' = s f(q) in t is M q'' = f(q) in
sqrt(s) t, with forces and energies multiplied by s. This is exact for every law without relaxation times. Rayleigh
damping scales with it: each vibration decays in the same number of its own periods.

A jump of s changes the strain energy, and repeated jumps in phase with a vibration add energy without bound. The
modulus ratio therefore changes slowly compared with vibrations.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.compiled.jit import kernel_njit, law_digest, law_njit
from palpate.compiled.reference import reference
from palpate.core.arrays import Floats, Ints
from palpate.core.faults import number_in_range
from palpate.realtime.bodies.model import RealtimeModel
from palpate.realtime.calls import call_advance, call_stiffness, model_calls
from palpate.realtime.contract import FORCES, KINETIC, STATUS, STRAIN, tool_maps
from palpate.realtime.period import function_key
from palpate.realtime.seqlock import Slot, publish, snapshot
from palpate.reduction.contact.surface import PAIRS

MAX_CONTACT_NODES = 4096  # contact nodes published in a period
# offsets in `values`, in which forces on devices (t, 3), positions of tools (t, 3), coordinates and contacts follow
CONTACT_COUNT, MODULUS_RATIO, TOOLS = range(3)
CONTACT_SIZE = 5  # values of a contact: node, tool, force (3,)
PRESENT, TARGET = 0, 1  # indices in `modulus_ratio`
MAX_RATIO_RATE = 5.0  # [1/s]: largest rate of the logarithm of the modulus ratio, in model time
STIFFNESS, DAMPING, MASS, FORCE_LIMIT = range(4)  # indices in `VirtualCoupling.parameters`
TOOL_MASS = 0.05  # [kg] of a coupled tool


class VirtualCoupling(NamedTuple):
    """State of the springs and dampers between haptic devices and their t tools."""

    # (t, 4) array: stiffness [N/m], 0 for a rigid coupling; damping [N s/m]; mass [kg]; largest force of the spring [N]
    parameters: Floats
    # position, velocity: (t, 3) arrays [m], [m/s]: displacements and velocities of the tools
    position: Floats
    velocity: Floats
    device: Floats  # (t, 3) array [m]: displacements of the devices at the end of the last period
    force: Floats  # (t, 3) array [N]: forces of the body on the tools


class PublishedContact(NamedTuple):
    """Forces on nodes in contact, where the model inside writes them."""

    node: Ints  # (k,) array
    tool: Ints  # (k,) array: tools that touch them
    push: Floats  # (k, 3) array [N]
    numbers: Ints  # array: the first is the number of nodes in contact


class InstrumentedData(NamedTuple):
    """Data of an instrumented model."""

    inner: Any  # `ModelCalls` of the model inside, or its data if its functions are linked
    contact: PublishedContact  # of the model inside
    slot: Slot  # published values
    values: Floats  # array: values to be published next
    coupling: VirtualCoupling
    target: Floats  # (t l,) array: tool coordinates that the model inside receives
    tangent: Floats  # (t l, l) array: contact stiffness of the model inside
    modulus_ratio: Floats  # (2,) array: present and requested ratio of the moduli to the model's own


class Observation(NamedTuple):
    """Published values of one period."""

    # coordinates, contact_nodes, contact_forces: arrays: arguments of `Surface.displacements`
    # (`palpate.realtime.bodies.display_surface`); the forces are those of the model's own moduli
    coordinates: Floats
    contact_nodes: NDArray[np.int64]
    contact_tools: NDArray[np.int64]  # (e,) array: the tools of those nodes
    contact_forces: Floats
    # (t, 3) array [m]: displacements of the tools, which differ from those of devices with a virtual coupling
    tool_positions: Floats
    device_forces: Floats  # (t, 3) array [N]: forces on the haptic devices
    modulus_ratio: float  # moduli relative to the model's own


class InstrumentedModel(NamedTuple):
    """A real-time model for the engine; see `palpate.realtime.contract.Realtime`."""

    advance: Any
    stiffness: Any
    data: InstrumentedData
    rest: Floats
    tool: Floats
    force_bound: Callable[[float, float], float] | None = None
    max_backlog: int = 0
    cutter: Any = None
    tool_names: tuple[str, ...] = ()

    def observe(self) -> Observation:
        """Return the values that the last period published; may be called from any thread."""
        values, coordinates = snapshot(self.data.slot), self._coordinates
        device_forces, tool_positions = values[TOOLS : coordinates.start].reshape(2, -1, 3)
        contacts = values[coordinates.stop :].reshape(-1, CONTACT_SIZE)[: int(values[CONTACT_COUNT])]
        return Observation(
            coordinates=values[coordinates],
            contact_nodes=contacts[:, 0].astype(np.int64),
            contact_tools=contacts[:, 1].astype(np.int64),
            contact_forces=contacts[:, 2:],
            tool_positions=tool_positions,
            device_forces=device_forces,
            modulus_ratio=float(values[MODULUS_RATIO]),
        )

    @property
    def _coordinates(self) -> slice:
        """Place of the coordinates in the published values."""
        first = TOOLS + 6 * len(self.data.coupling.position)
        return slice(first, first + len(self.rest))

    def set_state(self, coordinates: Floats, positions: Floats) -> None:
        """Restart from coordinates, with the tools at rest at displacements (t, 3) [m]; the engine must not run."""
        data = self.data
        data.values[:] = 0.0
        data.values[MODULUS_RATIO] = data.modulus_ratio[PRESENT]
        data.values[self._coordinates] = coordinates
        for index, position in enumerate(positions):
            self.place_tool(index, position)

    def place_tool(self, index: int, position: Floats) -> None:
        """Set a tool to rest at a displacement (3,) [m] without a force; others go on. The engine must not run."""
        coupling = self.data.coupling
        coupling.velocity[index], coupling.force[index] = 0.0, 0.0
        coupling.position[index], coupling.device[index] = position, position
        device_forces, tool_positions = self.data.values[TOOLS : self._coordinates.start].reshape(2, -1, 3)
        device_forces[index], tool_positions[index] = 0.0, position
        publish(self.data.slot, self.data.values)

    def set_modulus_ratio(self, ratio: float) -> None:
        """Multiply all moduli by a ratio from 0.1 to 10, at constant density; the engine must not run.

        The moduli change gradually, by at most a factor of e in 0.2 s of model time.
        """
        self.data.modulus_ratio[TARGET] = number_in_range("ratio", ratio, 0.1, 10.0)

    def set_coupling(self, stiffness: float | None, force_limit: float = np.inf, index: int = 0) -> None:
        """Couple a tool by a critically damped spring [N/m], or rigidly if None; the engine must not run.

        Beyond `force_limit` [N], the largest force of the spring, the tool lags behind the device. The force limit of
        `palpate.Engine` scales only the reported force.
        """
        parameters = self.data.coupling.parameters[index]
        if stiffness is None:
            parameters[:] = 0.0
            return
        stiffness = number_in_range("stiffness", stiffness, 1.0, 1e4, unit="N/m")
        if force_limit != np.inf:
            force_limit = number_in_range("force_limit", force_limit, 0.0, open_low=True, unit="N")
        parameters[:] = stiffness, 2.0 * np.sqrt(stiffness * TOOL_MASS), TOOL_MASS, force_limit


def make_instrumented(model: RealtimeModel, linked: bool = False) -> InstrumentedModel:
    """Return an instrumented model that shares the data of a real-time model.

    `linked` links the functions of the model, for code that runs elsewhere. By default they are called by their
    addresses, so that all models have the same functions.
    """
    cutter, called = model.cutter, (call_advance, None if model.stiffness is None else call_stiffness)
    advance, stiffness = instrumented_functions(*((model.advance, model.stiffness) if linked else called))

    def passed(inner: Any) -> Any:
        """Return data of the model inside as the functions take them."""
        if linked:
            return inner
        return model_calls(model.advance if cutter is None else cutter.advance, model.stiffness, inner)

    contact = PublishedContact(*(getattr(model.data.contact_work, name) for name in PublishedContact._fields))
    contacts = min(MAX_CONTACT_NODES, len(contact.node))
    tools, count = tool_maps(model.tool).shape[:2]
    values = np.zeros(TOOLS + 6 * tools + len(model.rest) + CONTACT_SIZE * contacts)
    data = InstrumentedData(
        inner=passed(model.data),
        contact=contact,
        slot=Slot.zeros(len(values)),
        values=values,
        coupling=VirtualCoupling(np.zeros((tools, 4)), *np.zeros((4, tools, 3))),
        target=np.zeros(tools * count),
        tangent=np.zeros((tools * count, count)),
        modulus_ratio=np.ones(2),
    )
    if cutter is not None:
        cutter.wrap = lambda inner: data._replace(inner=passed(inner))
    instrumented = InstrumentedModel(
        advance, stiffness, data, model.rest, model.tool, model.force_bound, model.max_backlog, model.cutter,
        model.tool_names,
    )  # fmt: skip
    instrumented.set_state(model.rest, np.zeros((tools, 3)))
    return instrumented


@kernel_njit(inner=True)
def _move_coupled_tool(coupling, target, device_force, period):
    """Advance a coupled tool by a period; write its position to `target`, and the device's force."""
    stiffness, damping = coupling.parameters[STIFFNESS], coupling.parameters[DAMPING]
    mass, limit = coupling.parameters[MASS], coupling.parameters[FORCE_LIMIT]
    effective_mass = mass + period * damping + period * period * stiffness
    # squared lengths of the spring after the period: with its force, and saturated but for the pull
    slow, square, apart = mass + period * damping, 0.0, 0.0
    for i in range(3):
        rate = (target[i] - coupling.device[i]) / period
        force = stiffness * (target[i] - coupling.position[i]) + damping * rate + coupling.force[i]
        after = coupling.position[i] + period * (mass * coupling.velocity[i] + period * force) / effective_mass
        square += (target[i] - after) ** 2
        free = coupling.position[i] + period * (mass * coupling.velocity[i] + period * coupling.force[i]) / slow
        apart += (target[i] - free) ** 2
    if stiffness * np.sqrt(square) > limit and stiffness * np.sqrt(apart) > limit:
        for i in range(3):
            wanted = target[i]
            momentum = mass * coupling.velocity[i] + period * coupling.force[i]
            pull = limit * (wanted - coupling.position[i] - period * momentum / slow) / np.sqrt(apart)
            coupling.velocity[i] = (momentum + period * pull) / slow
            coupling.position[i] += period * coupling.velocity[i]
            device_force[i] = -pull
            coupling.device[i] = wanted
            target[i] = coupling.position[i]
        return
    for i in range(3):
        wanted = target[i]
        rate = (wanted - coupling.device[i]) / period
        force = stiffness * (wanted - coupling.position[i]) + damping * rate + coupling.force[i]
        coupling.velocity[i] = (mass * coupling.velocity[i] + period * force) / effective_mass
        coupling.position[i] += period * coupling.velocity[i]
        spring = stiffness * (wanted - coupling.position[i]) + damping * (rate - coupling.velocity[i])
        device_force[i] = -spring
        coupling.device[i] = wanted
        target[i] = coupling.position[i]


@kernel_njit(inner=True)
def _stop_coupled_tool(coupling, moved, device_force, period):
    """Set a coupled tool that the model has held to where it is; the device feels the spring."""
    held = False
    for i in range(3):
        held = held or coupling.position[i] != moved[i]
    if not held:
        return
    square = 0.0
    for i in range(3):
        before = coupling.position[i] - period * coupling.velocity[i]
        coupling.velocity[i] = (moved[i] - before) / period
        coupling.position[i] = moved[i]
        square += (coupling.device[i] - moved[i]) ** 2
    stiffness, limit = coupling.parameters[STIFFNESS], coupling.parameters[FORCE_LIMIT]
    share = min(1.0, limit / (stiffness * np.sqrt(square))) if square > 0.0 else 1.0
    for i in range(3):
        device_force[i] = -share * stiffness * (coupling.device[i] - moved[i])


@kernel_njit(inline="always")
def _coupling_of(coupling, t):
    """Return the coupling of a tool."""
    return VirtualCoupling(
        coupling.parameters[t], coupling.position[t], coupling.velocity[t], coupling.device[t], coupling.force[t]
    )


@kernel_njit(inner=True)
def _begin_period(coupling, modulus_ratio, target, moved, values, v, period):
    """Write what the model inside is to reach, move coupled tools, and scale the velocities (m,) to the present moduli.

    Returns the present modulus ratio.
    """
    tools = coupling.position.shape[0]
    count = target.shape[0] // tools
    for k in range(target.shape[0]):
        moved[k] = target[k]
    for t in range(tools):
        tool = _coupling_of(coupling, t)
        if tool.parameters[STIFFNESS] > 0.0:
            _move_coupled_tool(tool, moved[count * t : count * t + 3], values[TOOLS + 3 * t :], period)
    before, most = modulus_ratio[PRESENT], np.exp(MAX_RATIO_RATE * period)
    ratio = min(max(modulus_ratio[TARGET], before / most), before * most)
    if ratio != before:
        for m in range(v.shape[0]):
            v[m] *= np.sqrt(before / ratio)
        modulus_ratio[PRESENT] = ratio
    return ratio


@kernel_njit(inner=True)
def _scale_report(report, ratio):
    """Multiply energies and forces of a report by the modulus ratio."""
    report[KINETIC] *= ratio
    report[STRAIN] *= ratio
    for k in range(FORCES, report.shape[0]):
        report[k] *= ratio


@kernel_njit(inner=True)
def _end_period(coupling, report, target, moved, values, period):
    """Write positions of tools and forces on devices; a tool that the model has held stops where it is."""
    tools = coupling.position.shape[0]
    count = target.shape[0] // tools
    for t in range(tools):
        tool, first = _coupling_of(coupling, t), count * t
        device_force, position = values[TOOLS + 3 * t :], values[TOOLS + 3 * (tools + t) :]
        coupled = tool.parameters[STIFFNESS] > 0.0
        if coupled:
            _stop_coupled_tool(tool, moved[first : first + 3], device_force, period)
        else:
            for k in range(count):
                target[first + k] = moved[first + k]
        for i in range(min(3, count)):
            tool.force[i] = -report[FORCES + first + i]
            position[i] = moved[first + i]  # where the tool is, which may be held
            if not coupled:
                device_force[i] = tool.force[i]


@kernel_njit(inner=True)
def _publish_period(contact, slot, values, tools, q, ratio):
    """Publish coordinates (m,) and contact forces with what is written of the t tools."""
    at = TOOLS + 6 * tools
    for m in range(q.shape[0]):
        values[at + m] = q[m]
    at += q.shape[0]
    pairs = min(contact.numbers[PAIRS], (values.shape[0] - at) // CONTACT_SIZE)
    values[CONTACT_COUNT], values[MODULUS_RATIO] = pairs, ratio
    for e in range(pairs):
        values[at], values[at + 1] = contact.node[e], contact.tool[e]
        for i in range(3):
            values[at + 2 + i] = contact.push[e, i]  # for the model's own moduli
        at += CONTACT_SIZE
    publish(slot, values[:at])


@kernel_njit(inner=True)
def _scale_stiffness(tangent, ratio, out):
    """Write a stiffness times the modulus ratio."""
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            out[i, j] = ratio * tangent[i, j]


@cache
def instrumented_functions(inner_advance: Any, inner_stiffness: Any) -> tuple[Any, Any]:
    """Compile the functions of an instrumented model around those of the model inside.

    Only the calls of the functions inside depend on these. Couplings, moduli and publishing are compiled once.
    """
    digest = law_digest(__name__, function_key(inner_advance), inner_stiffness and function_key(inner_stiffness))

    @law_njit(digest)
    def advance(handle, q, v, target, period, report):
        """Advance the model inside, with the springs of the devices and the present moduli; publish the result."""
        data = reference(handle)
        coupling, moved, values = data.coupling, data.target, data.values
        ratio = _begin_period(coupling, data.modulus_ratio, target, moved, values, v, period)
        inner_advance(data.inner, q, v, moved, period * np.sqrt(ratio), report)
        if report[STATUS] != 0.0:
            return
        _scale_report(report, ratio)
        _end_period(coupling, report, target, moved, values, period)
        _publish_period(data.contact, data.slot, values, coupling.position.shape[0], q, ratio)

    if inner_stiffness is None:
        return advance, None

    @law_njit(digest)
    def stiffness(handle, q, out):
        """Write the contact stiffness of the model inside, with the present moduli."""
        data = reference(handle)
        inner_stiffness(data.inner, q, data.tangent)
        _scale_stiffness(data.tangent, data.modulus_ratio[PRESENT], out)

    return advance, stiffness
