"""The reduced model: an energy sampled at few nodes, in the coordinates of modes and tools.

Everything it needs it holds itself: it is made by `palpate.reduce` from a full model and its runs, and then knows that
model no more. A step costs what its samples and coordinates cost, whatever the body's number of nodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.dynamics.loads.loads import Drive, Load
from palpate.dynamics.material.fibres import firm
from palpate.dynamics.material.relaxation import at_ease, recall, remembered
from palpate.dynamics.nodal.stability import stable_step
from palpate.dynamics.run.model import Model, Nodes, Outputs, State, initial_field
from palpate.dynamics.run.reactions import touching
from palpate.faults import InputError
from palpate.meshfree.stencils import moving_least_squares
from palpate.reduction.contact.tools import Handling, dented, held_nodes
from palpate.reduction.hyper.data import ReducedParts
from palpate.reduction.hyper.error_indicator import expected_error, nearest
from palpate.reduction.hyper.explicit import explicit_step
from palpate.reduction.hyper.foundation import draw_back
from palpate.reduction.hyper.generalised_forces import ColumnLoads, column_loads, load_forces, pose_map
from palpate.reduction.hyper.implicit import implicit_step, newton
from palpate.reduction.hyper.loads import lifted, ready_drive
from palpate.reduction.hyper.material_point import point_law
from palpate.reduction.hyper.sampled_energy import Samples, firm_weights, sampled_energy, scratch

__all__ = ["ReducedModel", "ReducedParts"]

Floats = NDArray[np.float64]

MOVED = 0.1  # of the largest displacement seen: how far the state goes before the explicit step is found anew
CONVERGED = 1e-7  # of the spacing: largest displacement that a Newton iteration may still change
DIFFERENCE = 1e-5  # of the spacing: displacements for tangents by differences
NEIGHBOURS = {2: 14, 3: 42}  # of the stencils of a sheet and of a solid


class ReducedModel(Model):
    """A body in few coordinates whose force comes from few nodes.

    Parameters
    ----------
    parts : ReducedParts
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

    def __init__(self, parts: ReducedParts, *, step: float | None = None, single: bool = True) -> None:
        if step is not None and parts.material.prony is not None:
            raise InputError("tissue that relaxes (prony) is stepped explicitly: leave the step out")
        self.parts, self.step, self.single = parts, step, single
        self.cloud, self.material, self.fixed = parts.cloud, parts.material, parts.fixed
        self.viscosity, self.report = parts.viscosity, parts.report
        self.fewest = 20 if step is None else 1  # the implicit step is the user's choice
        self.count = count = parts.modes + parts.lifted
        several = parts.regions is not None
        self._law, self._coefficients = point_law(parts.material, parts.kinematics, parts.fibres, several)
        flat = parts.columns.reshape(len(parts.columns), -1)
        self._all_mass = (flat * np.repeat(self.masses, 3)) @ flat.T
        self.mass = np.ascontiguousarray(self._all_mass[:count, :count])
        self._held = np.asarray(np.linalg.inv(self.mass[: parts.modes, : parts.modes]), dtype=float)
        self._free = np.linalg.inv(self.mass)
        self.sampled = partial(parts.samples, coefficients=self._coefficients, single=single)
        self._all, self._samples = self.sampled(np.arange(len(flat))), self.sampled(np.arange(count))
        self._firm = self._samples._replace(families=firm(self._samples.families))
        self._scratch, self._newton = scratch(self._samples), newton(count)
        self._all_scratch = scratch(self._all, self._scratch.memory)
        self._force, self._energy = sampled_energy(self._law, single)
        self._explicit = explicit_step(self._law, single)
        self._implicit, self._tangent = implicit_step(self._law, single)
        self.sizes = np.linalg.norm(parts.columns[:count], axis=2).max(axis=1)  # displacement of a unit coordinate
        self._differences = DIFFERENCE * self.cloud.spacing / self.sizes
        self._loaded: ColumnLoads | None = None
        self._skin = parts.surface
        self._handled: Handling | None = None
        self._result, self._everything, self._frequency, self._reach = np.zeros(count), np.zeros(len(flat)), 0.0, 0.0
        self._frequency_at: Floats | None = None

    @property
    def volumes(self) -> Floats:
        return self.parts.volumes

    def force(self, coordinates: Floats) -> Floats:
        """Return the internal forces on the coordinates, -dE/da, shape (m + l,)."""
        self._force(np.ascontiguousarray(coordinates, dtype=float), self._samples, self._scratch, self._result)
        return self._result.copy()

    def forces(self, coordinates: Floats) -> Floats:
        """Return the internal forces on all columns, test fields too, shape (m + l + 3 g + w,)."""
        moved = np.zeros(len(self.parts.columns))
        moved[: self.count] = coordinates
        self._force(moved, self._all, self._all_scratch, self._everything)
        return self._everything.copy()

    def projected(self, fields: Floats) -> Floats:
        """Return the coordinates (t, m + l) that are nearest to displacements or velocities (t, n, 3)."""
        flat = self.parts.columns[: self.count].reshape(self.count, -1) * np.repeat(self.masses, 3)
        return np.asarray((fields.reshape(len(fields), -1) @ flat.T) @ self._free)

    def energy(self, coordinates: Floats) -> float:
        """Return the strain energy [J]."""
        return float(self._energy(np.ascontiguousarray(coordinates, dtype=float), self._samples, self._scratch))

    def stiffness(self, coordinates: Floats) -> Floats:
        """Return the tangent -d(force)/d(coordinates), shape (m + l, m + l)."""
        return self._stiffness(coordinates, self._samples)

    def _stiffness(self, coordinates: Floats, of: Samples) -> Floats:
        matrix = np.zeros((self.count, self.count))
        a, vectors = np.ascontiguousarray(coordinates, dtype=float), np.zeros((3, self.count))
        self._tangent(a, self._differences, of, self._scratch, vectors, self.count, matrix)
        return matrix

    # loads

    def drive(self, loads: Sequence[Load]) -> Drive:
        return ready_drive(self.parts, loads, implicit=self.step is not None)

    def _loads(self, ready: Drive) -> ColumnLoads:
        if self._loaded is None or self._loaded.drive is not ready:
            self._loaded = column_loads(ready, self.parts.columns, self.masses, self.mass)
        return self._loaded

    def _handling(self, ready: Drive) -> Handling:
        if self._handled is None or self._handled.drive is not ready:
            self._handled = Handling(self._skin, ready)
        return self._handled

    @staticmethod
    def _holds(ready: Drive, times: Floats) -> NDArray[np.bool_]:
        """Whether the tools hold the body at some times, shape (t,)."""
        return ready.motions[0][0].holds(times) if ready.motions else np.ones(len(times), dtype=np.bool_)

    # stepping

    def state(
        self, drive: Drive, displacement: Floats | None = None, velocity: Floats | None = None, time: float = 0.0
    ) -> State:
        self._frequency_at, self._reach, self._newton.kept[0] = None, 0.0, 0.0
        flat = self.parts.columns[: self.count].reshape(self.count, -1)
        known = []
        for name, given in (("displacement", displacement), ("velocity", velocity)):
            array = initial_field(name, given, len(self.cloud))
            known.append(flat @ (array * self.masses[:, None]).reshape(-1))
        coordinates, velocities = np.array(known)
        modes = slice(self.parts.modes)
        if self._holds(drive, np.array([time]))[0]:
            held = lifted(self.parts, drive, np.array([time]))[0]
            rates = drive.rates(lambda times: lifted(self.parts, drive, times), time)[0]
            for moment, own in ((coordinates, held), (velocities, rates)):
                moment[modes] = self._held @ (moment[modes] - self.mass[modes, self.parts.modes :] @ own)
                moment[self.parts.modes :] = own
        else:
            coordinates, velocities = self._free @ coordinates, self._free @ velocities
        memory = at_ease(self._scratch.memory, lambda: self.force(coordinates))
        rest = State(coordinates, velocities, time, memory=memory)
        begun = self._handling(drive).begun(lambda: self.displacement(rest, drive), time, self.cloud.spacing)
        return replace(rest, touch=begun)

    def stable_step(self, state: State, drive: Drive) -> float:
        if self.step is not None:
            return self.step
        recall(self._scratch.memory, state.memory)
        moved = state.coordinates * self.sizes
        self._reach = max(self._reach, float(np.abs(moved).max(initial=0.0)))
        if self._frequency_at is None or np.abs(moved - self._frequency_at).max() > MOVED * self._reach:
            held = bool(self._holds(drive, np.array([state.time * (1 + 1e-8) + 1e-12]))[0])
            self._frequency, self._frequency_at = self._highest(state.coordinates, held), moved
        springs = self._loads(drive).own
        highest = float(np.hypot(max(self._frequency, self.parts.slack), np.sqrt(springs.square)))
        if not highest:  # nothing holds any motion
            return np.inf
        return stable_step(highest, self.viscosity + springs.rate / highest / highest)

    def _highest(self, coordinates: Floats, held: bool = True) -> float:
        moving = slice(self.parts.modes if held else None)
        tangent = self._stiffness(coordinates, self._firm)[moving, moving]
        if not np.isfinite(tangent).all():
            return np.inf
        return float(np.sqrt(np.abs(np.linalg.eigvals((self._held if held else self._free) @ tangent)).max()))

    def frequencies(self, coordinates: Floats | None = None) -> Floats:
        """Return the circular frequencies [rad/s] of the modes, the tools held, in ascending order; by default at rest.

        Not a number where the body is unstable.
        """
        modes = slice(self.parts.modes)
        tangent = self.stiffness(np.zeros(self.count) if coordinates is None else coordinates)[modes, modes]
        squares = np.sort(np.linalg.eigvals(self._held @ (0.5 * (tangent + tangent.T))).real)
        return np.sqrt(np.where(squares >= 0, squares, np.nan))

    def advance(self, state: State, drive: Drive, step: float, steps: int, beside: Floats | float = 0.0) -> State:
        """Advance by some steps; explicit ones take forces (m + l,) on the coordinates beside those of the drive."""
        a, v, count, memory = state.coordinates.copy(), state.velocities.copy(), self.count, self._scratch.memory
        recall(memory, state.memory)
        times: Floats = state.time + step * np.arange(-1.0, steps + 2)
        handling, of = self._handling(drive), self._loads(drive)
        if self.step is None:
            loads = np.ascontiguousarray(of.at(times[1:-1])[:, :count] + beside)
            fastest = self.parts.fastest / self.sizes[self.parts.modes :]
            work, lost, tools = self._explicit(
                a, v, lifted(self.parts, drive, times), self._holds(drive, times[1:-1]), step, self.viscosity, fastest,
                loads, self.mass, self._held, self._free, self._samples, self._scratch, of.own, self._newton,
                handling.poses(times[1:-1], state.touch, self.cloud.spacing), self._skin, handling.touch,
                handling.tools,
            )  # fmt: skip
        else:
            middles = times[1:-2] + 0.5 * step
            loads = np.ascontiguousarray(of.at(middles)[:, :count])
            work, lost, tools, taken = self._implicit(
                a, v, lifted(self.parts, drive, times), self._holds(drive, times[2:-1]), step, self.viscosity, loads,
                self.mass, self._differences, self.tolerance, self._samples, self._scratch, of.own, self._newton,
            )  # fmt: skip
            if taken < steps:
                a[:] = np.nan
        if memory.branches.size:
            lost += float(np.sum(firm_weights(self._samples) * memory.lost) + memory.volume_lost.sum())
        external, dissipated = state.external_work + work + tools, state.dissipated + lost
        return State(a, v, float(times[-2]), external, dissipated, remembered(memory), handling.after(state.touch))

    # what a state means

    def displacement(self, state: State, drive: Drive, nodes: Nodes = slice(None)) -> Floats:
        """Return the displacements [m] of some nodes, rebuilt only there."""
        moved = np.tensordot(state.coordinates, self.parts.columns[: self.count, nodes], 1)
        return (
            moved
            if state.touch is None
            else moved + dented(self.parts.dents, self.cloud.points, self._skin, state.touch, drive)[0][nodes]
        )

    def velocity(self, state: State, drive: Drive, nodes: Nodes = slice(None)) -> Floats:
        """Return the velocities [m/s] of some nodes."""
        return np.tensordot(state.velocities, self.parts.columns[: self.count, nodes], 1)

    def _rates(self, state: State, drive: Drive) -> tuple[Floats, Floats]:
        """Accelerations of the coordinates, and what internal forces and loads do on all columns."""
        recall(self._scratch.memory, state.memory)
        forces = self.forces(state.coordinates + self.viscosity * state.velocities)
        forces += self._loads(drive).at(np.array([state.time]))[0]
        draw_back(self._loads(drive).springs, state.coordinates, state.velocities, forces)
        if state.touch is not None:
            forces += np.tensordot(self.parts.columns, state.touch.forces, 2)
        modes = slice(self.parts.modes)
        if self._holds(drive, np.array([state.time]))[0]:
            bend = drive.rates(lambda times: lifted(self.parts, drive, times), state.time)[1]
            own = self._held @ (forces[modes] - self.mass[modes, self.parts.modes :] @ bend)
            return np.concatenate([own, bend]), forces
        return self._free @ forces[: self.count], forces

    def needed(self, state: State, drive: Drive) -> Floats:
        """Return what all columns need beyond internal forces and loads to move as they do, shape (all,)."""
        rates, forces = self._rates(state, drive)
        return np.asarray(self._all_mass[:, : self.count] @ rates - forces)

    def reactions(self, state: State, drive: Drive) -> dict[str, Floats]:
        """Return the force [N] of every support and tool on the body: what its columns need beyond the other forces."""
        needed, first = self.needed(state, drive), self.count
        result = {name: needed[first + 3 * g : first + 3 * g + 3] for g, name in enumerate(self.fixed)}
        holds, tools = self._holds(drive, np.array([state.time]))[0], needed[self.parts.modes : self.count]
        for name in self.parts.driven:
            result[name] = self.tool_map(name)[:, :3].T @ tools if holds else np.zeros(3)
        return result

    def tool_map(self, group: str) -> Floats:
        """Return what a rigid tool's pose does to the lifting columns' coordinates, shape (l, 12).

        Coordinates are the map times the translation (3) and the entries of R - I (9, row by row), R the rotation about
        the mean place of the group's nodes.
        """
        nodes = self.cloud.group(group)
        return pose_map(self.cloud.points[nodes], self.parts.columns[self.parts.modes : self.count, nodes])

    def outputs(self, state: State, drive: Drive) -> Outputs:
        forces, moments, touches, _ = touching(state, drive)
        dents, stored = dented(self.parts.dents, self.cloud.points, self._skin, state.touch, drive)
        return Outputs(
            np.tensordot(state.coordinates, self.parts.columns[: self.count], 1) + dents,
            self.velocity(state, drive),
            self.reactions(state, drive) | forces,
            float(0.5 * state.velocities @ self.mass @ state.velocities),
            self.energy(state.coordinates) + stored,
            state.external_work,
            state.dissipated,
            moments,
            touches,
            np.isin(touches[:, 0], held_nodes(self._skin, state.touch, drive)),
        )

    def trust(self, state: State, drive: Drive) -> float:
        """Return how far a state is from what the model was trained on: above 1 it was not trained on such states.

        The larger of two numbers: the distance to the nearest training state, and the imbalance of forces on test
        fields that the coordinates cannot move (`palpate.reduction.hyper.error_indicator`), both as lengths, over those that make the
        trust number at most 1 on 95 % of the frames of the held-out runs. Without those they are the distance that 95 %
        of the training states keep to other training runs, and the imbalance that projecting them makes.
        """
        return max(self.distance(state) / self.parts.reach, self.imbalance(state, drive) / self.parts.leeway)

    def distance(self, state: State) -> float:
        """Return the root mean square displacement [m] over the body from a state to the nearest training state."""
        return float(nearest(state.coordinates[None], self.parts.trained, self.mass / self.masses.sum())[0])

    def imbalance(self, state: State, drive: Drive) -> float:
        """Return the root mean square displacement [m] that forces which the coordinates cannot balance would make.

        The forces are those on the witnesses (`palpate.reduction.training.residual_fields`), the displacement that at
        rest in their shapes; 0 without witnesses.
        """
        return float(np.linalg.norm(self.needed(state, drive)[len(self.parts.columns) - self.parts.witnesses :]))

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

    def acceleration(self, state: State, drive: Drive) -> Floats:
        return np.tensordot(self._rates(state, drive)[0], self.parts.columns[: self.count], 1)

    def external_force(self, state: State, drive: Drive) -> Floats:
        forces = load_forces(drive, self.masses, self.parts.columns, state)
        return forces if state.touch is None else forces + state.touch.forces

    def nodal_force(self, displacements: Floats) -> Floats:
        raise InputError("a reduced model has no forces at nodes; ask the full model")

    @cached_property
    def stencils(self) -> Any:  # type: ignore[override]
        """Stencils of the cloud, made when first asked for."""
        stretch, space = self.parts.kinematics.prestretch, self.cloud.points.shape[1]
        return moving_least_squares(self.cloud.points / stretch, order=2, neighbours=NEIGHBOURS[space])

    def deformation_gradient(self, displacements: Floats) -> Floats:
        rest = self.parts.kinematics.prestretch * np.eye(3, self.cloud.points.shape[1])
        return np.asarray(self.stencils.gradient(displacements) + rest)

    def stress(self, displacements: Floats) -> Floats:
        if self.parts.kinematics.sheet:
            raise InputError("a reduced membrane does not tell its stress at nodes: ask the full model")
        return self.parts.stress(self.deformation_gradient(displacements))

    def strain_energy(self, displacements: Floats) -> float:
        """Return the strain energy [J] of nodal displacements that the columns can make."""
        return self.energy(self.projected(displacements[None])[0])

    def with_step(self, step: float | None) -> ReducedModel:
        """Return this model stepped by the energy-conserving implicit rule of a step [s], or explicitly (None)."""
        return ReducedModel(self.parts, step=step, single=self.single)
