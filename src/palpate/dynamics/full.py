"""The full model: equations of motion collocated at every node (sections 2.1 and 2.2, equations 1 to 8)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numba
import numpy as np
from numpy.typing import NDArray

from palpate.dynamics.kernels import Body, kernels, workspace
from palpate.dynamics.lanes import lane_table
from palpate.dynamics.loads import FREE, Drive, Load, Schedule, drive
from palpate.dynamics.model import Model, Nodes, State
from palpate.dynamics.reactions import tool_power
from palpate.dynamics.stability import FrequencyTracker, choose_viscosity, stable_step
from palpate.dynamics.stepping import full_step, surface_force
from palpate.faults import InputError, integer_in_range, number_in_range
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
        # the lanes hold the second derivatives now; what stays is for gradients of nodal fields
        nothing = np.zeros((0, 0))
        self.stencils = replace(self.stencils, second=nothing[:, :, None], value=nothing)
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
        self.work = workspace(len(cloud), len(lanes.nodes), longest, numba.config.NUMBA_NUM_THREADS)
        law = type(material)
        self._internal_force = kernels(law.first, law.second, pressure == "direct")
        self._advance = full_step(law.first, law.second, pressure == "direct")
        self._scratch = tuple(np.zeros((len(cloud), 3)) for _ in range(4))
        self.neighbours = neighbours
        self.held = self.drive(()).places.kind != FREE
        self.highest_frequency = FrequencyTracker(self)
        self.stability = choose_viscosity(self, viscosity)
        self.viscosity = self.stability.used

    @property
    def weights(self) -> Floats:
        """Weights [m^3] of the inner product in which tractions do their true virtual work, shape (n,).

        The nodal volumes; at the boundary times 2/c, because the balance of a boundary node multiplies a traction by
        c/h and not by the half cell's 2/h.
        """
        weights = self.cloud.volumes.copy()
        weights[np.unique(self.cloud.face_nodes)] /= self.half_cell
        return weights

    def force(self, displacements: Floats) -> Floats:
        """Return the internal force density [N/m^3] at every node for displacements (n, 3) [m]."""
        result = np.zeros((len(self.cloud), 3))
        self._internal_force(np.ascontiguousarray(displacements, dtype=float), self.body, self.work, result)
        return result

    def deformation_gradient(self, displacements: Floats) -> Floats:
        """Return F = I + du/dX at every node, shape (n, 3, 3)."""
        return self.stencils.gradient(displacements) + np.eye(3)

    def stress(self, displacements: Floats) -> Floats:
        """Return the first Piola-Kirchhoff stress [Pa] at every node, (n, 3, 3), with the model's own pressure."""
        F = self.deformation_gradient(displacements)
        stress = self.material.stress(F)
        if self.pressure == "split":
            self.force(displacements)
            cofactor = np.linalg.det(F)[:, None, None] * np.swapaxes(np.linalg.inv(F), 1, 2)
            stress = stress + (self.work.smooth - self.work.pressure)[:, None, None] * cofactor
        return stress

    def cauchy_stress(self, displacements: Floats) -> Floats:
        """Return the Cauchy stress [Pa] at every node, shape (n, 3, 3)."""
        F = self.deformation_gradient(displacements)
        return self.stress(displacements) @ np.swapaxes(F, 1, 2) / np.linalg.det(F)[:, None, None]

    def drive(self, loads: Sequence[Load]) -> Drive:
        return drive(self.cloud, self.fixed, loads)

    def state(self, drive: Drive, displacement: Floats | None = None, velocity: Floats | None = None) -> State:
        self.highest_frequency.restart()
        fields: list[Floats] = []
        for name, given in (("displacement", displacement), ("velocity", velocity)):
            array = np.zeros((len(self.cloud), 3)) if given is None else np.array(given, dtype=float)
            if array.shape != (len(self.cloud), 3) or not np.isfinite(array).all():
                raise InputError(f"initial {name} must be finite, of shape {(len(self.cloud), 3)}, not {array.shape}")
            array[self.held] = 0.0
            fields.append(array)
        fields[0][drive.places.driven] = drive.schedule(np.zeros(1)).motion[0]
        return State(fields[0], fields[1])

    def stable_step(self, state: State, drive: Drive) -> float:
        frequency = self.highest_frequency(state.coordinates, drive.places.kind != FREE)
        return stable_step(frequency, self.viscosity)

    def advance(self, state: State, drive: Drive, step: float, steps: int) -> State:
        number_in_range("step", step, 0.0, open_low=True, unit="s")
        times: Floats = state.time + step * np.arange(steps + 1, dtype=float)
        u, v = state.coordinates.copy(), state.velocities.copy()
        force, previous, surface, at = self._scratch
        schedule = drive.schedule(times)
        surface[:] = 0.0  # of another run's loads
        before = tool_power(self, state, drive)
        work, lost = self._advance(
            u, v, step, self.viscosity, self.body, self.work, drive.places, schedule, self.cloud.volumes,
            self.material.density, self.slot, self.half_cell, force, previous,
            surface, at,
        )  # fmt: skip
        new = State(u, v, float(times[-1]), state.external_work + work, state.dissipated + lost)
        # trapezium rule for the power of the tools
        tools = 0.5 * step * steps * (before + tool_power(self, new, drive))
        return replace(new, external_work=new.external_work + tools)

    def tractions(self, drive: Drive, schedule: Schedule) -> Floats:
        """Return tractions per nodal volume [N/m^3] at a schedule's first time, on the body as last evaluated."""
        surface = np.zeros((len(self.cloud), 3))
        surface_force(drive.places, schedule, 0, self.cloud.volumes, self.slot, self.work.cofactor, surface)
        return surface

    def acceleration(self, state: State, drive: Drive) -> Floats:
        schedule = drive.schedule(np.array([state.time]))
        force = self.force(state.coordinates + self.viscosity * state.velocities)
        force += self.half_cell * self.tractions(drive, schedule)
        acceleration = force / self.material.density + schedule.gravity[0]
        acceleration[drive.places.kind != FREE] = 0.0
        acceleration[drive.places.driven] = drive.rates(lambda t: drive.schedule(t).motion, state.time)[1]
        return acceleration

    def external_force(self, state: State, drive: Drive) -> Floats:
        schedule = drive.schedule(np.array([state.time]))
        self.force(state.coordinates)  # the body that a pressure follows
        surface = self.tractions(drive, schedule)
        return surface * self.cloud.volumes[:, None] + self.masses[:, None] * schedule.gravity[0]

    def displacement(self, state: State, drive: Drive, nodes: Nodes = slice(None)) -> Floats:
        return state.coordinates[nodes]

    def velocity(self, state: State, drive: Drive, nodes: Nodes = slice(None)) -> Floats:
        return state.velocities[nodes]
