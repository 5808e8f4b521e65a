"""Records of the compiled period of a full body: its constants, its tools, and the state that a period changes."""

from __future__ import annotations

from typing import Any, NamedTuple

from palpate.core.arrays import Floats, Ints
from palpate.dynamics.contact.geometry import Contacts
from palpate.dynamics.contact.grip import Grip
from palpate.dynamics.loads.prepared import LoadSites
from palpate.dynamics.material.relaxation import HistoryCopy
from palpate.dynamics.nodal.central_difference import Damping, NodalData, StepScratch
from palpate.dynamics.nodal.mass_scaling import MassScaling

# entries of `NodalPeriodData.stepping`, `energies` and `counts`
BEHIND, NEXT_BEHIND, STEP, FREQUENCY, BASE_FREQUENCY, ESTIMATE, UNTIL_ESTIMATE = range(7)
GIVEN, WORK, LOST, KINETIC_ENERGY, RECENT_ENERGY, GAINED = range(6)
REPEATED, HELD, RESTED = range(3)
# columns of `NodalPeriodData.sums`
WORK_SUM, LOST_SUM, KINETIC_SUM, DRIFT_SQUARE, KICK_SQUARE = range(5)
BLOCK_NODES = 256  # nodes of a sum
NO_BLADE = -1


class ContactReport(NamedTuple):
    """Forces on the patches in contact, as means over the last period."""

    node: Ints  # (k,) array: nodes of the patches; one can be there several times
    tool: Ints  # (k,) array: tools that touch them
    push: Floats  # (k, 3) array [N]
    numbers: Ints  # (3,) array: the first is the number of patches in contact


class SteppedBody(NamedTuple):
    """Constants of a body of n nodes, which a cut replaces."""

    passes: Any  # tuple: body and work arrays of the steps
    tension_compression_passes: Any  # tuple: the same with fibres that carry compression, for the frequency
    nodes: NodalData
    damping: Damping
    sites: LoadSites  # of supports and foundations
    mass_scaling: MassScaling
    resting_frequency: float  # [rad/s]: highest frequency at rest, with the scaled mass and foundations
    triangles: Ints  # (s, 3) array: of the surface


class Secant(NamedTuple):
    """Contact stiffness of the t tools, see `palpate.dynamics.nodal.tool_stiffness`."""

    stiffness: Floats  # (3 t, 3 t) array [N/m]: derivatives of the forces on all tools by all their positions
    # positions, forces, unrest: (3 t,), (3 t,), (1,) arrays: of the tools, and kinetic energy [J], at the last update
    positions: Floats
    forces: Floats
    unrest: Floats
    # radius, bound: (t,) arrays: of the present contact [m], and its largest stiffness [N/m]
    radius: Floats
    bound: Floats
    # way, excess, fade: (3 t,), (3 t,), (t,) arrays: scratch
    way: Floats
    excess: Floats
    fade: Floats
    supports: Ints  # nodes that supports hold
    # plane_modulus, uniaxial_modulus: E / (1 - nu^2) and that of uniaxial strain [Pa]
    plane_modulus: float
    uniaxial_modulus: float
    spacing: float  # [m]


class MovingTools(NamedTuple):
    """The t tools: contact, forceps, ways in a period, and their last forces."""

    contacts: Contacts
    grip: Grip  # nodes that forceps hold
    blade: int  # number of the tool that is a blade, or NO_BLADE
    path: Floats  # (t, 6, 3, 4) array: frames, see `palpate.dynamics.nodal.tool_path`
    late: Ints  # (t,) array: 1 for tools that do not reach their target in the present period
    # (t,) array [m]: distance that nodes and a tool may move before the surface can be so deep in it that it is slowed
    clear_way: Floats
    listed: Floats  # (n, 3) array [m]: displacements for which the candidates near the tools were listed last
    near_margin: Floats  # (1,) array [m]: of the list of candidates near the tools; negative without a list
    force: Floats  # (12 t,) array: forces on the tools' coordinates in the last period with a step
    secant: Secant


class WayLimits(NamedTuple):
    """Largest ways [m] in a step of a node, a tool and a blade; of the blade from its last cut; depth of the surface.

    A tool is held where the surface is deeper in it.
    """

    node: float
    tool: float
    blade: float
    cut: float
    surface_depth: float


class PowerIteration(NamedTuple):
    """State of the power iteration for the highest frequency."""

    vector: Floats  # (n, 3) array: last image
    noise: Floats  # (n, 3) array
    amplitude: float  # [m]: displacement of the difference quotient


class PeriodCopy(NamedTuple):
    """State at the start of a period, from which it is repeated."""

    fields: Floats  # (3, n, 3) array: displacements, velocities and the last internal forces
    works: Floats  # (2,) array [J]: work and dissipation
    history: HistoryCopy


class NodalPeriodData(NamedTuple):
    """Constants and state of the compiled period of a full body.

    - `stepping` (7,): times [s] by which the body is behind, and will be; step [s]; highest frequency [rad/s], that at
      rest on which it is based, and its last estimate; periods until the next one
    - `energies` (6,) [J]: of a state that was given; work and dissipation since rest; kinetic energy, and the largest
      of late (`UNREST_TIME`); gains that shorter steps did not cure
    - `counts` (3,): periods that were repeated with shorter steps, and in which a tool was held; 1 if the last period
      left the body at rest
    - `sums` (b, 5), of every block of nodes: work and dissipation of a kick, kinetic energy [J], and the largest
      squared velocities [m^2/s^2] of a drift and of a kick
    """

    body: SteppedBody
    tools: MovingTools
    limits: WayLimits
    iteration: PowerIteration
    start: PeriodCopy
    scratch: StepScratch
    sums: Floats
    stepping: Floats
    energies: Floats
    counts: Floats
    contact_work: ContactReport
