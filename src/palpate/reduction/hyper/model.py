"""The reduced model: an energy sampled at few nodes, in the coordinates of modes and tools.

Everything it needs it holds itself: it is made by `palpate.hyper_reduce` from a full model and its runs, and then knows that
model no more. A step costs what its samples and coordinates cost, whatever the body's number of nodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.arrays import Floats
from palpate.describe import Fact
from palpate.dynamics.loads.prepared import Load, PreparedLoads
from palpate.dynamics.material.fibres import always_taut
from palpate.dynamics.material.relaxation import equilibrium_history, restore_history, saved_history
from palpate.dynamics.nodal.stability import stable_step
from palpate.dynamics.run.model import Model, Nodes, Outputs, State, initial_field
from palpate.dynamics.run.reactions import contact_outputs
from palpate.faults import InputError
from palpate.meshfree.stencils import moving_least_squares
from palpate.reduction.contact.tools import ContactTools, bonded_nodes, tool_displacements
from palpate.reduction.hyper.data import ReducedData
from palpate.reduction.hyper.error_indicator import expected_error, nearest
from palpate.reduction.hyper.explicit import explicit_step
from palpate.reduction.hyper.foundation import draw_back
from palpate.reduction.hyper.generalised_forces import GeneralisedForces, generalised_forces, load_forces, pose_map
from palpate.reduction.hyper.implicit import implicit_step, newton
from palpate.reduction.hyper.loads import lifting_coordinates, prepare_reduced_loads
from palpate.reduction.hyper.material_point import material_point
from palpate.reduction.hyper.sampled_energy import IntegrationPoints, sampled_energy, scratch, shear_weights

__all__ = ["ReducedData", "ReducedModel"]


MOVED = 0.1  # of the largest displacement seen: how far the state goes before the explicit step is found anew
CONVERGED = 1e-7  # of the spacing: largest displacement that a Newton iteration may still change
DIFFERENCE = 1e-5  # of the spacing: displacements for tangents by differences
NEIGHBOURS = {2: 14, 3: 42}  # of the stencils of a sheet and of a solid


class ReducedModel(Model):
    """A body in few coordinates whose force comes from few nodes.

    Parameters
    ----------
    parts : ReducedData
    step : float, optional [s]
        Of the energy-conserving implicit rule. By default steps are explicit, as long as the reduced body allows.
    single : bool
        Whether the derivatives at the samples are kept in single precision.

    Attributes
    ----------
    count : int
        Number of coordinates: modes and lifting columns.
    report : dict
        What was measured in training.
    """

    name = "reduced"
    conservative = True
    tolerance = CONVERGED / DIFFERENCE  # of Newton's iterations

    def __init__(self, data: ReducedData, *, step: float | None = None, single: bool = True) -> None:
        if step is not None and data.material.prony is not None:
            raise InputError("tissue that relaxes (prony) is stepped explicitly: leave the step out")
        self.data, self.step, self.single = data, step, single
        self.cloud, self.material, self.fixed = data.cloud, data.material, data.fixed
        self.stiffness_damping, self.report = data.stiffness_damping, data.report
        self.min_steps_per_frame = 20 if step is None else 1  # the implicit step is the user's choice
        self.count = count = data.modes + data.lifted
        several = data.regions is not None
        self._law, self._coefficients = material_point(data.material, data.kinematics, data.fibres, several)
        flat = data.basis_vectors.reshape(len(data.basis_vectors), -1)
        self._all_mass = (flat * np.repeat(self.masses, 3)) @ flat.T
        self.mass = np.ascontiguousarray(self._all_mass[:count, :count])
        self._constrained_inverse_mass = np.asarray(np.linalg.inv(self.mass[: data.modes, : data.modes]), dtype=float)
        self._free = np.linalg.inv(self.mass)
        self.sampled = partial(data.integration_points, coefficients=self._coefficients, single=single)
        self._all, self._integration_points = self.sampled(np.arange(len(flat))), self.sampled(np.arange(count))
        self._firm = self._integration_points._replace(families=always_taut(self._integration_points.families))
        self._scratch, self._newton = scratch(self._integration_points), newton(count)
        self._all_scratch = scratch(self._all, self._scratch.history)
        self._force, self._energy = sampled_energy(self._law, single)
        self._explicit = explicit_step(self._law, single)
        self._implicit, self._tangent = implicit_step(self._law, single)
        self.sizes = np.linalg.norm(data.basis_vectors[:count], axis=2).max(axis=1)  # displacement of a unit coordinate
        self._differences = DIFFERENCE * self.cloud.spacing / self.sizes
        self._loaded: GeneralisedForces | None = None
        self._contact_surface = data.surface
        self._handled: ContactTools | None = None
        self._result, self._everything, self._frequency, self._reach = np.zeros(count), np.zeros(len(flat)), 0.0, 0.0
        self._frequency_at: Floats | None = None

    def _own_facts(self) -> list[Fact]:
        data, found = self.data, self.report.get("held_out", {}).get("mean", {}).get("displacement")
        return [
            ("modes", data.modes, ""),
            ("lifting columns", data.lifted or None, ""),
            ("sampled nodes", len(data.cubature.nodes), ""),
            (
                "held-out displacement error",
                "not measured" if found is None else 100 * found,
                "" if found is None else "%",
            ),
            ("driven", data.prescribed or None, ""),
            ("step", "explicit" if self.step is None else self.step, "" if self.step is None else "s"),
        ]

    @property
    def volumes(self) -> Floats:
        return self.data.volumes

    def force(self, coordinates: Floats) -> Floats:
        """Return the internal forces on the coordinates, -dE/da, shape (m + l,)."""
        self._force(
            np.ascontiguousarray(coordinates, dtype=float), self._integration_points, self._scratch, self._result
        )
        return self._result.copy()

    def forces(self, coordinates: Floats) -> Floats:
        """Return the internal forces on all columns, test fields too, shape (m + l + 3 g + w,)."""
        moved = np.zeros(len(self.data.basis_vectors))
        moved[: self.count] = coordinates
        self._force(moved, self._all, self._all_scratch, self._everything)
        return self._everything.copy()

    def project(self, fields: Floats) -> Floats:
        """Return the coordinates (t, m + l) that are nearest to displacements or velocities (t, n, 3)."""
        flat = self.data.basis_vectors[: self.count].reshape(self.count, -1) * np.repeat(self.masses, 3)
        return np.asarray((fields.reshape(len(fields), -1) @ flat.T) @ self._free)

    def energy(self, coordinates: Floats) -> float:
        """Return the strain energy [J]."""
        return float(
            self._energy(np.ascontiguousarray(coordinates, dtype=float), self._integration_points, self._scratch)
        )

    def stiffness(self, coordinates: Floats) -> Floats:
        """Return the tangent -d(force)/d(coordinates), shape (m + l, m + l)."""
        return self._stiffness(coordinates, self._integration_points)

    def _stiffness(self, coordinates: Floats, of: IntegrationPoints) -> Floats:
        matrix = np.zeros((self.count, self.count))
        a, vectors = np.ascontiguousarray(coordinates, dtype=float), np.zeros((3, self.count))
        self._tangent(a, self._differences, of, self._scratch, vectors, self.count, matrix)
        return matrix

    # loads

    def prepare(self, loads: Sequence[Load]) -> PreparedLoads:
        return prepare_reduced_loads(self.data, loads, implicit=self.step is not None)

    def _loads(self, ready: PreparedLoads) -> GeneralisedForces:
        if self._loaded is None or self._loaded.prepared is not ready:
            self._loaded = generalised_forces(ready, self.data.basis_vectors, self.masses, self.mass)
        return self._loaded

    def _handling(self, ready: PreparedLoads) -> ContactTools:
        if self._handled is None or self._handled.prepared is not ready:
            self._handled = ContactTools(self._contact_surface, ready)
        return self._handled

    @staticmethod
    def _holds(ready: PreparedLoads, times: Floats) -> NDArray[np.bool_]:
        """Whether the tools hold the body at some times, shape (t,)."""
        return ready.motions[0][0].is_active(times) if ready.motions else np.ones(len(times), dtype=np.bool_)

    # stepping

    def state(
        self,
        prepared: PreparedLoads,
        displacement: Floats | None = None,
        velocity: Floats | None = None,
        time: float = 0.0,
    ) -> State:
        self._frequency_at, self._reach, self._newton.kept[0] = None, 0.0, 0.0
        flat = self.data.basis_vectors[: self.count].reshape(self.count, -1)
        known = []
        for name, given in (("displacement", displacement), ("velocity", velocity)):
            array = initial_field(name, given, len(self.cloud))
            known.append(flat @ (array * self.masses[:, None]).reshape(-1))
        coordinates, velocities = np.array(known)
        modes = slice(self.data.modes)
        if self._holds(prepared, np.array([time]))[0]:
            constrained_inverse_mass = lifting_coordinates(self.data, prepared, np.array([time]))[0]
            rates = prepared.rates(lambda times: lifting_coordinates(self.data, prepared, times), time)[0]
            for moment, own in ((coordinates, constrained_inverse_mass), (velocities, rates)):
                moment[modes] = self._constrained_inverse_mass @ (
                    moment[modes] - self.mass[modes, self.data.modes :] @ own
                )
                moment[self.data.modes :] = own
        else:
            coordinates, velocities = self._free @ coordinates, self._free @ velocities
        history = equilibrium_history(self._scratch.history, lambda: self.force(coordinates))
        rest = State(coordinates, velocities, time, history=history)
        begun = self._handling(prepared).begun(lambda: self.displacement(rest, prepared), time, self.cloud.spacing)
        return replace(rest, contact_state=begun)

    def stable_step(self, state: State, prepared: PreparedLoads) -> float:
        if self.step is not None:
            return self.step
        restore_history(self._scratch.history, state.history)
        moved = state.coordinates * self.sizes
        self._reach = max(self._reach, float(np.abs(moved).max(initial=0.0)))
        if self._frequency_at is None or np.abs(moved - self._frequency_at).max() > MOVED * self._reach:
            constrained_inverse_mass = bool(self._holds(prepared, np.array([state.time * (1 + 1e-8) + 1e-12]))[0])
            self._frequency, self._frequency_at = self._highest(state.coordinates, constrained_inverse_mass), moved
        springs = self._loads(prepared).own
        highest = float(np.hypot(max(self._frequency, self.data.taut_frequency), np.sqrt(springs.square)))
        if not highest:  # nothing holds any motion
            return np.inf
        return stable_step(highest, self.stiffness_damping + springs.rate / highest / highest)

    def _highest(self, coordinates: Floats, constrained_inverse_mass: bool = True) -> float:
        moving = slice(self.data.modes if constrained_inverse_mass else None)
        tangent = self._stiffness(coordinates, self._firm)[moving, moving]
        if not np.isfinite(tangent).all():
            return np.inf
        return float(
            np.sqrt(
                np.abs(
                    np.linalg.eigvals(
                        (self._constrained_inverse_mass if constrained_inverse_mass else self._free) @ tangent
                    )
                ).max()
            )
        )

    def frequencies(self, coordinates: Floats | None = None) -> Floats:
        """Return the circular frequencies [rad/s] of the modes, the tools held, in ascending order; by default at rest.

        Not a number where the body is unstable.
        """
        modes = slice(self.data.modes)
        tangent = self.stiffness(np.zeros(self.count) if coordinates is None else coordinates)[modes, modes]
        squares = np.sort(np.linalg.eigvals(self._constrained_inverse_mass @ (0.5 * (tangent + tangent.T))).real)
        return np.sqrt(np.where(squares >= 0, squares, np.nan))

    def advance(
        self, state: State, prepared: PreparedLoads, step: float, steps: int, beside: Floats | float = 0.0
    ) -> State:
        """Advance by some steps; explicit ones take forces (m + l,) on the coordinates beside those of the drive."""
        a, v, count, history = state.coordinates.copy(), state.velocities.copy(), self.count, self._scratch.history
        restore_history(history, state.history)
        times: Floats = state.time + step * np.arange(-1.0, steps + 2)
        handling, of = self._handling(prepared), self._loads(prepared)
        if self.step is None:
            loads = np.ascontiguousarray(of.at(times[1:-1])[:, :count] + beside)
            wave_speed = self.data.wave_speed / self.sizes[self.data.modes :]
            work, lost, tools = self._explicit(
                a, v, lifting_coordinates(self.data, prepared, times), self._holds(prepared, times[1:-1]), step, self.stiffness_damping, wave_speed,
                loads, self.mass, self._constrained_inverse_mass, self._free, self._integration_points, self._scratch, of.own, self._newton,
                handling.poses(times[1:-1], state.contact_state, self.cloud.spacing), self._contact_surface, handling.contact_state,
                handling.tools,
            )  # fmt: skip
        else:
            middles = times[1:-2] + 0.5 * step
            loads = np.ascontiguousarray(of.at(middles)[:, :count])
            work, lost, tools, taken = self._implicit(
                a, v, lifting_coordinates(self.data, prepared, times), self._holds(prepared, times[2:-1]), step, self.stiffness_damping, loads,
                self.mass, self._differences, self.tolerance, self._integration_points, self._scratch, of.own, self._newton,
            )  # fmt: skip
            if taken < steps:
                a[:] = np.nan
        if history.branches.size:
            lost += float(np.sum(shear_weights(self._integration_points) * history.lost) + history.volume_lost.sum())
        external, dissipated = state.external_work + work + tools, state.dissipated + lost
        return State(
            a, v, float(times[-2]), external, dissipated, saved_history(history), handling.after(state.contact_state)
        )

    # what a state means

    def displacement(self, state: State, prepared: PreparedLoads, nodes: Nodes = slice(None)) -> Floats:
        """Return the displacements [m] of some nodes, rebuilt only there."""
        moved = np.tensordot(state.coordinates, self.data.basis_vectors[: self.count, nodes], 1)
        return (
            moved
            if state.contact_state is None
            else moved
            + tool_displacements(
                self.data.compliance, self.cloud.points, self._contact_surface, state.contact_state, prepared
            )[0][nodes]
        )

    def velocity(self, state: State, prepared: PreparedLoads, nodes: Nodes = slice(None)) -> Floats:
        """Return the velocities [m/s] of some nodes."""
        return np.tensordot(state.velocities, self.data.basis_vectors[: self.count, nodes], 1)

    def _rates(self, state: State, prepared: PreparedLoads) -> tuple[Floats, Floats]:
        """Accelerations of the coordinates, and what internal forces and loads do on all columns."""
        restore_history(self._scratch.history, state.history)
        forces = self.forces(state.coordinates + self.stiffness_damping * state.velocities)
        forces += self._loads(prepared).at(np.array([state.time]))[0]
        draw_back(self._loads(prepared).springs, state.coordinates, state.velocities, forces)
        if state.contact_state is not None:
            forces += np.tensordot(self.data.basis_vectors, state.contact_state.forces, 2)
        modes = slice(self.data.modes)
        if self._holds(prepared, np.array([state.time]))[0]:
            bend = prepared.rates(lambda times: lifting_coordinates(self.data, prepared, times), state.time)[1]
            own = self._constrained_inverse_mass @ (forces[modes] - self.mass[modes, self.data.modes :] @ bend)
            return np.concatenate([own, bend]), forces
        return self._free @ forces[: self.count], forces

    def needed(self, state: State, prepared: PreparedLoads) -> Floats:
        """Return what all columns need beyond internal forces and loads to move as they do, shape (all,)."""
        rates, forces = self._rates(state, prepared)
        return np.asarray(self._all_mass[:, : self.count] @ rates - forces)

    def reactions(self, state: State, prepared: PreparedLoads) -> dict[str, Floats]:
        """Return the force [N] of every support and tool on the body: what its columns need beyond the other forces."""
        needed, first = self.needed(state, prepared), self.count
        result = {name: needed[first + 3 * g : first + 3 * g + 3] for g, name in enumerate(self.fixed)}
        holds, tools = self._holds(prepared, np.array([state.time]))[0], needed[self.data.modes : self.count]
        for name in self.data.prescribed:
            result[name] = self.tool_map(name)[:, :3].T @ tools if holds else np.zeros(3)
        return result

    def tool_map(self, group: str) -> Floats:
        """Return what a rigid tool's pose does to the lifting columns' coordinates, shape (l, 12).

        Coordinates are the map times the translation (3) and the entries of R - I (9, row by row), R the rotation about
        the mean place of the group's nodes.
        """
        nodes = self.cloud.group(group)
        return pose_map(self.cloud.points[nodes], self.data.basis_vectors[self.data.modes : self.count, nodes])

    def outputs(self, state: State, prepared: PreparedLoads) -> Outputs:
        forces, moments, contact_forces, _ = contact_outputs(state, prepared)
        compliance, stored = tool_displacements(
            self.data.compliance, self.cloud.points, self._contact_surface, state.contact_state, prepared
        )
        return Outputs(
            np.tensordot(state.coordinates, self.data.basis_vectors[: self.count], 1) + compliance,
            self.velocity(state, prepared),
            self.reactions(state, prepared) | forces,
            float(0.5 * state.velocities @ self.mass @ state.velocities),
            self.energy(state.coordinates) + stored,
            state.external_work,
            state.dissipated,
            moments,
            contact_forces,
            np.isin(contact_forces[:, 0], bonded_nodes(self._contact_surface, state.contact_state, prepared)),
        )

    def trust(self, state: State, prepared: PreparedLoads) -> float:
        """Return how far a state is from what the model was trained on: above 1 it was not trained on such states.

        The larger of two numbers: the distance to the nearest training state, and the imbalance of forces on test
        fields that the coordinates cannot move (`palpate.reduction.hyper.error_indicator`), both as lengths, over those that make the
        trust number at most 1 on 95 % of the frames of the held-out runs. Without those they are the distance that 95 %
        of the training states keep to other training runs, and the imbalance that projecting them makes.
        """
        return max(
            self.distance(state) / self.data.distance_scale,
            self.residual_norm(state, prepared) / self.data.residual_scale,
        )

    def distance(self, state: State) -> float:
        """Return the root mean square displacement [m] over the body from a state to the nearest training state."""
        return float(nearest(state.coordinates[None], self.data.trained, self.mass / self.masses.sum())[0])

    def residual_norm(self, state: State, prepared: PreparedLoads) -> float:
        """Return the root mean square displacement [m] that forces which the coordinates cannot balance would make.

        The forces are those on the witnesses (`palpate.reduction.training.residual_fields`), the displacement that at
        rest in their shapes; 0 without witnesses.
        """
        return float(
            np.linalg.norm(self.needed(state, prepared)[len(self.data.basis_vectors) - self.data.residual_fields :])
        )

    def expected_error(self, trust: float) -> tuple[float, float]:
        """Return what displacement error came with a trust number in the held-out runs: median and 95th percentile.

        Parameters
        ----------
        trust : float
            The largest trust number of a motion so far: an error once made goes on ringing in the body.

        Returns
        -------
        median, percentile : float
            Root mean square over the body, over the largest such displacement of the run. Infinite for a trust number
            above all that was met.

        Raises
        ------
        InputError
            The model was trained without held-out runs.
        """
        return expected_error(self.report, trust)

    def acceleration(self, state: State, prepared: PreparedLoads) -> Floats:
        return np.tensordot(self._rates(state, prepared)[0], self.data.basis_vectors[: self.count], 1)

    def external_force(self, state: State, prepared: PreparedLoads) -> Floats:
        forces = load_forces(prepared, self.masses, self.data.basis_vectors, state)
        return forces if state.contact_state is None else forces + state.contact_state.forces

    def nodal_force(self, displacements: Floats) -> Floats:
        raise InputError("a reduced model has no forces at nodes; ask the full model")

    @cached_property
    def stencils(self) -> Any:  # type: ignore[override]
        """Stencils of the cloud, made when first asked for."""
        stretch, space = self.data.kinematics.prestretch, self.cloud.points.shape[1]
        return moving_least_squares(self.cloud.points / stretch, order=2, neighbours=NEIGHBOURS[space])

    def deformation_gradient(self, displacements: Floats) -> Floats:
        rest = self.data.kinematics.prestretch * np.eye(3, self.cloud.points.shape[1])
        return np.asarray(self.stencils.gradient(displacements) + rest)

    def stress(self, displacements: Floats) -> Floats:
        if self.data.kinematics.sheet:
            raise InputError("a reduced membrane does not tell its stress at nodes: ask the full model")
        return self.data.stress(self.deformation_gradient(displacements))

    def strain_energy(self, displacements: Floats) -> float:
        """Return the strain energy [J] of nodal displacements that the columns can make."""
        return self.energy(self.project(displacements[None])[0])

    def with_step(self, step: float | None) -> ReducedModel:
        """Return this model stepped by the energy-conserving implicit rule of a step [s], or explicitly (None)."""
        return ReducedModel(self.data, step=step, single=self.single)
