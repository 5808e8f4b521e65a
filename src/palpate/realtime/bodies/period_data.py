"""Records of the compiled period of a reduced model: constants and work arrays."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.compiled.jit import kernel_njit
from palpate.core.arrays import Floats
from palpate.dynamics.material.relaxation import HistoryCopy
from palpate.reduction.contact.surface import ContactScratch, ContactSurface, RigidTools
from palpate.reduction.contact.tangent import ContactSystem
from palpate.reduction.hyper.data import Scales
from palpate.reduction.hyper.foundation import Springs
from palpate.reduction.hyper.implicit import ImplicitData
from palpate.reduction.hyper.sampled_energy import ProbeScratches, scratch

# rows of `PeriodData.vectors`
POWER_SHAPE, WORK, FORCE, RATE, VELOCITY_CHANGE, SAVED_COORDINATES, SAVED_VELOCITIES, TOOL_RATES = range(8)
REST_FREQUENCY, FREQUENCY, NEXT_COLUMN, ENERGY = range(4)  # entries of `PeriodData.tracking`
AT_STATE, ALONG_SHAPE, ALONG_COLUMN = range(3)  # rows of `Probes.forces`


class ResidualFields(NamedTuple):
    """Constants and work arrays of the residual norm."""

    # (b, w, 9, LANES) array: derivatives of the w residual fields at the cubature points
    table: NDArray[np.float32] | Floats
    # constant, mass: (w, m) arrays: stiffness of the hourglass residual, and mass matrix, of residual fields and
    # coordinates
    constant: Floats
    mass: Floats
    springs: Springs  # of foundations, on the residual fields
    columns: NDArray[np.float32]  # (k, 3, w) array: the residual fields at the nodes of the contact surface
    forces: Floats  # (w,) array [N times the unit of the fields]: internal forces and those of springs
    partial: Floats  # (w, LANES) array: scratch


class IndicatorData(NamedTuple):
    """Data of the error indicator."""

    # training_states, mass_root: (t, m), (m, m) arrays: training states times the root; transposed root of the mass
    # matrix divided by the body's mass
    training_states: Floats
    mass_root: Floats
    scales: Scales
    nearness: Floats  # (k,) array: of the surface nodes to supports
    body_mass: float  # [kg]
    residual_fields: ResidualFields


class Probes(NamedTuple):
    """Forces at the coordinates, and next to them along the shape of the power iteration and one coordinate."""

    rows: Floats  # (2, m)
    forces: Floats  # (3, m)
    scratches: ProbeScratches


def probes(body: ImplicitData) -> Probes:
    """Return zeroed probes of a body; the first scratch is that of its steps."""
    count, points = len(body.constants.mass), body.constants.cubature_points
    along_shape, along_column = (scratch(points, body.scratch.history) for _ in range(2))
    return Probes(np.zeros((2, count)), np.zeros((3, count)), ProbeScratches(body.scratch, along_shape, along_column))


class Tangent(NamedTuple):
    """The tangent of the forces, and the forces by which each period updates it."""

    matrix: Floats  # (m, m) array: each period updates one column
    condensed: Floats  # (m, m) array: scratch
    probes: Probes


class ToolPath(NamedTuple):
    """Arguments of the steps of a period: the tool of a prescribed group moves evenly, and there are no loads."""

    lifting: Floats  # (s + 3, l) array: coordinates of the tool
    holds: NDArray[np.bool_]  # (s,) array: True, the coordinates are prescribed
    no_loads: Floats  # (s, m) array: zeros


class PeriodStart(NamedTuple):
    """Copies of the history variables, of contact forces and positions, and of the frames of tools."""

    history: HistoryCopy
    force: Floats
    place: Floats
    frames: Floats


class PeriodData(NamedTuple):
    """Constants and work arrays of the compiled period."""

    modes: int
    step: float  # [s]: of the implicit rule, 0 for explicit steps
    body: ImplicitData  # constants and springs of the coordinates
    indicator: IndicatorData
    vectors: Floats  # (8, m) array: work arrays; the first is the state of the power iteration
    tangent: Tangent
    # (4,) array: frequency [rad/s] at rest and now; next column of the tangent; energy [J] after the last period
    tracking: Floats
    substep: Floats  # (1,) array [s]: last explicit step
    path: ToolPath
    # contact_surface, contact_work, tools: of tools in contact (`palpate.reduction.contact.gauss_seidel`); empty for a
    # prescribed group
    contact_surface: ContactSurface
    contact_work: ContactScratch
    tools: RigidTools
    home: Floats  # (t, 3, 4) array [-], [m]: rotations and positions of those tools at zero displacement
    system: ContactSystem  # of the contact stiffness (`palpate.reduction.contact.tangent`)
    start: PeriodStart  # from which a period is repeated


@kernel_njit(inner=True)
def has_residual_fields(data):
    """Return whether there are residual fields; the loops over their derivatives run at least once."""
    return data.indicator.residual_fields.forces.shape[0] > 0
