"""The full model: equations of motion collocated at every node (sections 2.1 and 2.2, equations 1 to 8)."""

from __future__ import annotations

from collections.abc import Sequence

import numba
import numpy as np
from numpy.typing import NDArray

from palpate.dynamics.kernels import Body, kernels, workspace
from palpate.dynamics.lanes import LANES, lane_table
from palpate.dynamics.loads import FREE, Drive, Load, drive
from palpate.dynamics.model import Model, Outputs, State
from palpate.dynamics.stability import FrequencyTracker, choose_viscosity, stable_step
from palpate.dynamics.stepping import external_force, full_step
from palpate.errors import InputError, integer_in_range, number_in_range
from palpate.meshfree.cloud import Cloud
from palpate.meshfree.stencils import moving_least_squares
from palpate.tissue.materials import Material

__all__ = ["FullModel"]

Floats = NDArray[np.float64]


class FullModel(Model):
    """A hyperelastic body, its equations of motion collocated at the nodes.

    Parameters
    ----------
    cloud : Cloud
        In space (d = 3).
    material : Material
    fixed : str or sequence of str
        Groups that are held (equation 5); none leaves the body free.
    viscosity : float, optional [s]
        Stiffness-proportional viscosity beta of C = beta K in (29). By default it is chosen from the spectrum of the
        linearised body: see `palpate.dynamics.stability`.
    pressure : str
        ``"split"``: the pressure is smoothed and differentiated by itself, which neither locks nor loses stability up
        to a Poisson's ratio of 0.499. ``"direct"``: everything is differentiated directly, for comparison.
    half_cell : float
        The c in the balance of a boundary node, rho a = Div P + c/h (f_s - P N). The half cell itself has c = 2; c = 3
        cancels the leading error of one-sided quadratic fits (for u = z^3 it is (6 - 2 c) h) and bends truer.
    neighbours : int
        Wished number of points in a stencil.
    smoothing : int
        Wished number of points over which the pressure is smoothed by a linear fit.

    Raises
    ------
    InputError
        An unknown group or a parameter out of range.
    CloudError
        The cloud cannot carry the stencils.
    """

    name = "full"

    def __init__(
        self,
        cloud: Cloud,
        material: Material,
        fixed: str | Sequence[str] = (),
        *,
        viscosity: float | None = None,
        pressure: str = "split",
        half_cell: float = 3.0,
        neighbours: int = 42,
        smoothing: int = 27,
    ) -> None:
        if cloud.points.shape[1] != 3:
            raise InputError("FullModel needs a cloud in space; this one is plane")
        if pressure not in ("split", "direct"):
            raise InputError(f"pressure = {pressure!r}: allowed are 'split' and 'direct'")
        self.cloud = cloud
        self.material = material
        self.fixed = (fixed,) if isinstance(fixed, str) else tuple(fixed)
        self.pressure = pressure
        # the cloud's boundary vectors are those of the half cell, c = 2
        self.half_cell = number_in_range("half_cell", half_cell, 1.0, 4.0) / 2
        integer_in_range("smoothing", smoothing, 5)
        self.stencils = moving_least_squares(cloud.points, order=2, neighbours=neighbours)
        smoother = moving_least_squares(cloud.points, order=1, neighbours=smoothing, interpolating=False)
        lanes, (first, second) = lane_table(self.stencils, ("first", "second"))
        smooth_lanes, (value,) = lane_table(smoother, ("value",))
        self.body = Body(
            lanes, first, second, smooth_lanes, value,
            np.ascontiguousarray(smoother.own[smoother.row]),
            np.ascontiguousarray(self.half_cell * cloud.boundary_vectors()[lanes.nodes].transpose(0, 2, 1)),
            material.coefficients,
            material.lame,
        )  # fmt: skip
        longest = int(max(np.diff(lanes.start).max(), np.diff(smooth_lanes.start).max()))
        self.slot = np.zeros(len(cloud), dtype=np.int64)
        self.slot[lanes.nodes.ravel()] = np.arange(lanes.nodes.size)
        self._work = workspace(len(cloud), len(lanes.nodes), longest, numba.config.NUMBA_NUM_THREADS)
        law = type(material)
        self._internal_force = kernels(law.first, law.second, pressure == "direct")
        self._advance = full_step(law.first, law.second, pressure == "direct")
        self._scratch = tuple(np.zeros((len(cloud), 3)) for _ in range(3))
        self.neighbours = neighbours
        self.held = self.drive(()).places.kind != FREE
        self.highest_frequency = FrequencyTracker(self)
        self.stability = choose_viscosity(self, viscosity)
        self.viscosity = self.stability.used

    def force(self, displacements: Floats) -> Floats:
        """Return the internal force density [N/m^3] at every node for displacements (n, 3) [m]."""
        result = np.zeros((len(self.cloud), 3))
        self._internal_force(np.ascontiguousarray(displacements, dtype=float), self.body, self._work, result)
        return result

    def deformation_gradient(self, displacements: Floats) -> Floats:
        """Return F = I + du/dX at every node, shape (n, 3, 3)."""
        return self.stencils.gradient(displacements) + np.eye(3)

    def stress(self, displacements: Floats) -> Floats:
        """Return the Cauchy stress [Pa] at every node, shape (n, 3, 3), with the smoothed pressure of the model."""
        F = self.deformation_gradient(displacements)
        J = np.linalg.det(F)[:, None, None]
        stress = self.material.stress(F) @ np.swapaxes(F, 1, 2) / J
        if self.pressure == "split":
            self.force(displacements)
            stress = stress + (self._work.smooth - self._work.pressure)[:, None, None] * np.eye(3)
        return stress

    def drive(self, loads: Sequence[Load]) -> Drive:
        return drive(self.cloud, self.fixed, loads)

    def state(self, drive: Drive, displacement: Floats | None = None, velocity: Floats | None = None) -> State:
        fields = []
        for name, given in (("displacement", displacement), ("velocity", velocity)):
            array = np.zeros((len(self.cloud), 3)) if given is None else np.array(given, dtype=float)
            if array.shape != (len(self.cloud), 3) or not np.isfinite(array).all():
                raise InputError(f"initial {name} must be finite, of shape {(len(self.cloud), 3)}, not {array.shape}")
            array[self.held] = 0.0
            fields.append(array)
        fields[0][drive.places.driven] = drive.schedule(np.zeros(1)).motion[0]
        return State(*fields)

    def stable_step(self, state: State, drive: Drive) -> float:
        frequency = self.highest_frequency(state.coordinates, drive.places.kind != FREE)
        return stable_step(frequency, self.viscosity)

    def advance(self, state: State, drive: Drive, step: float, steps: int) -> State:
        number_in_range("step", step, 0.0, open_low=True, unit="s")
        times = state.time + step * np.arange(steps + 1)
        u, v = state.coordinates.copy(), state.velocities.copy()
        force, external, at = self._scratch
        loss = self._viscous_power(state, drive)
        work = self._advance(
            u, v, step, self.viscosity, self.body, self._work, drive.places, drive.schedule(times), self.cloud.volumes,
            self.material.density, self.slot, force, external, at,
        )  # fmt: skip
        new = State(u, v, float(times[-1]), state.external_work + work, state.dissipated)
        # trapezium in the viscous power: it is a small, smooth share of the balance
        loss = 0.5 * (loss + self._viscous_power(new, drive)) * step * steps
        return State(u, v, new.time, new.external_work, state.dissipated + loss)

    def _viscous_power(self, state: State, drive: Drive) -> float:
        """Power [W] lost to viscosity: the nodal velocities on what beta v adds to the internal force."""
        u, v = state.coordinates, state.velocities
        if self.viscosity == 0.0:
            return 0.0
        lost = self.force(u) - self.force(u + self.viscosity * v)
        return float(np.sum(self.cloud.volumes[:, None] * v * lost))

    def outputs(self, state: State, drive: Drive) -> Outputs:
        u, v = state.coordinates, state.velocities
        total = self.force(u + self.viscosity * v)
        external = np.zeros_like(total)
        external_force(
            drive.places, drive.schedule(np.array([state.time])), 0, self.cloud.volumes, self.material.density,
            self.slot, self._work.cofactor, external,
        )  # fmt: skip
        residual = -(total + external) * self.cloud.volumes[:, None]
        volumes = self.cloud.volumes
        return Outputs(
            u, v,
            {name: residual[nodes].sum(axis=0) for name, nodes in drive.supports.items()},
            float(0.5 * np.sum(self.masses[:, None] * v**2)),
            float(np.sum(volumes * self.material.strain_energy(self.deformation_gradient(u)))),
            state.external_work,
            state.dissipated,
        )  # fmt: skip
