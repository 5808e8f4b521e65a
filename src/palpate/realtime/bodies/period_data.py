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
from palpate.reduction.hyper.foundation import Springs
from palpate.reduction.hyper.implicit import ImplicitData
from palpate.reduction.hyper.sampled_energy import ProbeScratches, scratch

# rows of `PeriodData.vectors`
POWER_SHAPE, WORK, FORCE, RATE, VELOCITY_CHANGE, SAVED_COORDINATES, SAVED_VELOCITIES, TOOL_RATES = range(8)
REST_FREQUENCY, FREQUENCY, NEXT_COLUMN, ENERGY = range(4)  # entries of `PeriodData.tracking`
AT_STATE, ALONG_SHAPE, ALONG_COLUMN = range(3)  # rows of `Probes.forces`


class ResidualFields(NamedTuple):
    """Constants and work arrays of the residual norm."""

    # (b, w, 9, LANES) array: derivatives of the w residual fields at the integration points
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
    # distance_scale, residual_scale: float [m]
    distance_scale: float
    residual_scale: float
    flexibility_scale: float  # [J]
    speed_scale: float  # [m/s]
    nearness_scale: float  # see `palpate.reduction.hyper.data.ReducedData`
    nearness: Floats  # (k,) array: of the surface nodes to supports
    trained_tools: int  # largest number of tools in contact at once in the held-out runs
    body_mass: float  # [kg]
    residual_fields: ResidualFields


class Probes(NamedTuple):
    """Forces at the coordinates, and next to them along the shape of the power iteration and one coordinate."""

    rows: Floats  # (2, m)
    forces: Floats  # (3, m)
    scratches: ProbeScratches


def probes(body: ImplicitData) -> Probes:
    """Return zeroed probes of a body; the first scratch is that of its steps."""
    count, points = len(body.mass), body.integration_points
    along_shape, along_column = (scratch(points, body.scratch.history) for _ in range(2))
    return Probes(np.zeros((2, count)), np.zeros((3, count)), ProbeScratches(body.scratch, along_shape, along_column))


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
    body: ImplicitData  # mass, damping, integration points and springs of the coordinates
    constrained_inverse_mass: Floats  # (modes, modes) array: inverse of the modes' block of the mass matrix
    indicator: IndicatorData
    vectors: Floats  # (8, m) array: work arrays; the first is the state of the power iteration
    probes: Probes
    tangent: Floats  # (m, m) array: each period updates one column
    condensed: Floats  # (m, m) array
    # (4,) array: frequency [rad/s] at rest and now; next column of the tangent; energy [J] after the last period
    tracking: Floats
    substep: Floats  # (1,) array [s]: last explicit step
    # path, holds, no_loads: (s + 3, l), (s,), (s, m) arrays: path of the tool during the implicit steps of a period,
    # that it is prescribed, and zero loads
    path: Floats
    holds: NDArray[np.bool_]
    no_loads: Floats
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
