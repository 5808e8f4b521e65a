"""The paper's reduced model: the equations of motion at every node, projected on modes (section 5, (28) to (32))."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from palpate.arrays import Floats
from palpate.describe import Fact
from palpate.dynamics.contact.tools import Grasp
from palpate.dynamics.loads.body_force import Gravity
from palpate.dynamics.loads.dead_load import DeadLoad
from palpate.dynamics.loads.prepared import PRESCRIBED, Load, PreparedLoads, check_kinds
from palpate.dynamics.loads.prescribed_motion import PrescribedMotion
from palpate.dynamics.nodal.model import NodalModel
from palpate.dynamics.nodal.stability import stable_step
from palpate.dynamics.run.model import Model, Nodes, Outputs, State
from palpate.dynamics.run.reactions import evaluate, tool_power
from palpate.dynamics.run.trajectory import Trajectory
from palpate.faults import InputError
from palpate.reduction.basis.pod import Basis, pod
from palpate.reduction.galerkin.step import reduced_step

__all__ = ["GalerkinModel", "galerkin"]


KINDS = (DeadLoad, Gravity, PrescribedMotion, Grasp)  # of loads, whose forces the step has
MOVED = 0.1  # of the largest displacement seen: how far the state goes before the tangent is taken anew
SMALLEST = 1e-3  # of the largest snapshot: the size below which one counts less in a relative basis
UNTRAINED = 1e-3  # share of a prescribed motion that the lifting columns may miss


class GalerkinModel(Model):
    """A full model whose displacements are modes times few coordinates, U = Q A (30), and lifted tool motions.

    The equations are those of the full model at every node, multiplied by Q^T in the inner product of the basis (32).

    Parameters
    ----------
    full : NodalModel
    basis : Basis
        Modes that vanish at fixed and driven nodes.
    lifting : (l, n, 3) array, optional
        Columns for prescribed motions: displacement fields whose coordinates are known from the motion of the tool.
    implicit : bool
        Whether modes too fast for the step are slowed down instead of limiting it: accelerations are multiplied by
        (1 + g K)^-1, g = dt^2/2 + beta dt, K the present reduced tangent. A mode of frequency w then has
        w'^2 = w^2 / (1 + g w^2), and (dt^2 + 2 beta dt) w'^2 < 2, half of what the central-difference step allows;
        slow modes keep their frequency up to g w^2 / 2. Otherwise the step is the explicit one of the reduced spectrum.
    """

    name = "projected"

    def __init__(self, full: NodalModel, basis: Basis, lifting: Floats | None = None, *, implicit: bool = True) -> None:
        if basis.modes.shape[1:] != (len(full.cloud), 3):
            raise InputError(f"the basis has {basis.modes.shape[1]} nodes, the body {len(full.cloud)}")
        self.full, self.basis = full, basis
        self.cloud, self.material, self.fixed = full.cloud, full.material, full.fixed
        self.conservative = full.conservative
        self.stiffness_damping, self.stencils = full.stiffness_damping, full.stencils
        n, count = len(full.cloud), len(basis)
        self.lifting = np.zeros((0, n, 3)) if lifting is None else np.asarray(lifting, dtype=float)
        self.columns = np.ascontiguousarray(np.concatenate([basis.modes, self.lifting]))
        # test functions: mass @ acceleration = test . force / density; the modes' own part of the mass is 1
        self.test = np.ascontiguousarray((self.columns * basis.weights[:, None]).reshape(len(self.columns), -1))
        self.mass = self.test @ self.columns.reshape(len(self.columns), -1).T
        self.mass[:count, :count] = np.eye(count)
        self._gravity_test = self.test.reshape(len(self.columns), n, 3).sum(axis=1)
        self._gravity_work = np.einsum("n,mnc->mc", full.masses, self.columns)
        blocks, lanes = full.body.lanes.nodes.shape
        self._table = np.zeros((blocks, len(self.columns), full.formulation.numbers, lanes))
        full.formulation.differentiate(self.columns, full.body, full.work, self._table)
        self._projected_force, self._advance = reduced_step(full.formulation)
        self._force, self._surface = np.zeros((n, 3)), np.zeros((n, 3))
        self._partial = np.zeros((blocks, len(self.columns)))
        self._columns, self._result, self._previous, self._rates, self._power = np.zeros((5, len(self.columns)))
        self._sizes = np.linalg.norm(self.columns, axis=2).max(axis=1)  # largest displacement of a unit coordinate
        self._tangent_at: Floats | None = None
        self._tangent, self._reach = np.zeros_like(self.mass), 0.0
        self.implicit = implicit

    def _own_facts(self) -> list[Fact]:
        return [
            ("modes", len(self.basis), ""),
            ("lifting columns", len(self.lifting) or None, ""),
            ("energy not held", 100 * self.basis.lost_energy, "%"),
            ("slows fast modes", self.implicit, ""),
        ]

    def force(self, coordinates: Floats) -> Floats:
        """Return the columns' Q^T f / rho for coordinates of modes and lifting columns, both of shape (M + l,)."""
        self._projected_force(
            np.ascontiguousarray(coordinates), self._table, self.test, self.full.body, self.full.work, self.volumes,
            self._partial, self._force, self._result,
        )  # fmt: skip
        return self._result / self.material.density

    def prepare(self, loads: Sequence[Load]) -> PreparedLoads:
        check_kinds(loads, KINDS, "loads of a projected model")
        prepared = self.full.prepare(loads)
        if len(prepared.sites.prescribed) and not len(self.lifting):
            raise InputError(
                "this reduced model was trained without a prescribed motion; train it with one on "
                + ", ".join(repr(m.group) for m, _ in prepared.motions)
            )
        if len(self.lifting) and not len(prepared.sites.prescribed):
            raise InputError("this reduced model was trained with a prescribed motion: give it one, or train without")
        if len({m.until for m, _ in prepared.motions}) > 1:
            raise InputError("a reduced model needs all tools to let go at one time; give them the same `until`")
        modes = np.abs(self.basis.modes)
        for motion, where in prepared.motions:
            if modes[:, prepared.sites.prescribed[where]].max() > UNTRAINED * modes.max():
                raise InputError(
                    f"this reduced model was not trained with group {motion.group!r} driven; train with it"
                )
        return prepared

    @staticmethod
    def _holds(prepared: PreparedLoads, times: Floats) -> NDArray[np.bool_]:
        """Whether the tools hold the body at some times, shape (t,)."""
        return prepared.motions[0][0].is_active(times) if prepared.motions else np.ones(len(times), dtype=np.bool_)

    def _lifted(self, prepared: PreparedLoads, times: Floats) -> Floats:
        """Coordinates (t, l) of the lifting columns at some times."""
        if not len(self.lifting):
            return np.zeros((len(times), 0))
        nodes = np.flatnonzero(prepared.sites.kind == PRESCRIBED)
        order = np.argsort(prepared.sites.prescribed)
        motion = prepared.schedule(times).motion[:, order].reshape(len(times), -1)
        span = self.lifting[:, nodes].reshape(len(self.lifting), -1)
        coordinates, *_ = np.linalg.lstsq(span.T, motion.T, rcond=None)
        missed = np.abs(coordinates.T @ span - motion).max()
        if missed > UNTRAINED * max(np.abs(motion).max(), 1e-3 * self.cloud.spacing):
            raise InputError(
                f"the prescribed motion is not one this reduced model was trained on: {missed:.3g} m of it is missed "
                f"at t = {times[0]:.4g} s; train with such a motion"
            )
        return np.asarray(coordinates.T)

    def state(
        self,
        prepared: PreparedLoads,
        displacement: Floats | None = None,
        velocity: Floats | None = None,
        time: float = 0.0,
    ) -> State:
        self._tangent_at, self._reach = None, 0.0
        nodal = self.full.state(prepared, displacement, velocity, time)
        fields = np.stack([nodal.coordinates, nodal.velocities])
        if self._holds(prepared, np.array([time]))[0]:
            lifted = self._lifted(prepared, np.array([time]))[0]
            rates = prepared.rates(lambda times: self._lifted(prepared, times), time)[0]
            known = np.stack([lifted, rates])
            coordinates = np.hstack([self.basis.project(fields - np.tensordot(known, self.lifting, 1)), known])
        else:
            weighted = (fields * self.basis.weights[:, None]).reshape(2, -1)
            coordinates = np.linalg.solve(self.mass, (weighted @ self.columns.reshape(len(self.mass), -1).T).T).T
        return State(coordinates[0], coordinates[1], time)

    def stable_step(self, state: State, prepared: PreparedLoads) -> float:
        held = bool(self._holds(prepared, np.array([state.time * (1 + 1e-8) + 1e-12]))[0])  # from now on
        if self.implicit and held:
            return np.inf
        if self.implicit:  # nodes that a tool has let go move faster than any tangent can follow
            return stable_step(self.full.stability.highest_frequency, self.stiffness_damping)
        self._follow(state)
        moving = slice(len(self.basis) if held else None)
        tangent = np.linalg.solve(self.mass[moving, moving], self._tangent[moving, moving])
        return stable_step(float(np.sqrt(np.abs(np.linalg.eigvals(tangent)).max())), self.stiffness_damping)

    def _follow(self, state: State) -> None:
        """Take the tangent anew when the state has moved far enough from where it was taken."""
        moved = state.coordinates * self._sizes  # coordinates of modes and of columns are not of one size
        self._reach = max(self._reach, float(np.abs(moved).max()))
        if self._tangent_at is None or np.abs(moved - self._tangent_at).max() > MOVED * self._reach:
            self._tangent, self._tangent_at = self.stiffness(state.coordinates), moved

    def _responses(self, state: State, step: float) -> tuple[Floats, Floats]:
        """The matrices (mass + (dt^2 / 2 + beta dt) K)^-1 on the forces: of the modes alone, and of all columns."""
        matrix, held = self.mass, slice(len(self.basis))
        if self.implicit:
            self._follow(state)
            matrix = self.mass + step * (0.5 * step + self.stiffness_damping) * self._tangent
        return np.linalg.inv(matrix[held, held]), np.linalg.inv(matrix)

    def stiffness(self, columns: Floats) -> Floats:
        """Return the tangent -d(force)/d(coordinates) [1/s^2], (M + l, M + l), by differences."""
        tangent, base = np.empty_like(self.mass), self.force(columns).copy()
        for m in range(len(self.columns)):
            # a displacement of about a millionth of the spacing
            delta = 1e-6 * self.cloud.spacing / self._sizes[m]
            moved = columns.copy()
            moved[m] += delta
            tangent[:, m] = (base - self.force(moved)) / delta
        return tangent

    def spectrum(self, columns: Floats) -> NDArray[np.complex128]:
        """Return the eigenvalues w^2 [1/s^2] of the modes' tangent, the tools held."""
        count = len(self.basis)
        return np.linalg.eigvals(self.stiffness(columns)[:count, :count]).astype(complex)

    def advance(self, state: State, prepared: PreparedLoads, step: float, steps: int) -> State:
        full = self.full
        times: Floats = state.time + step * np.arange(-1.0, steps + 2)
        a, v = state.coordinates.copy(), state.velocities.copy()
        self._surface[:] = 0.0  # of another run's loads
        before = 0.0 if self.conservative else tool_power(self, state, prepared)
        work, lost, tools = self._advance(
            a, v, self._lifted(prepared, times), self._holds(prepared, times[1:-1]), step, self.stiffness_damping,
            full.wave_speed / self._sizes[len(self.basis) :], self._table,
            self.columns, self.test, self.mass, full.body, full.work, prepared.sites, prepared.schedule(times[1:-1]),
            self._gravity_test, self._gravity_work, *self._responses(state, step), self.volumes,
            self.material.density, full.half_cell, full.slot, self._force, self._partial,
            self._surface, self._columns, self._result, self._previous, self._rates, self._power,
        )  # fmt: skip
        new = State(a, v, float(times[-2]), state.external_work + work, state.dissipated + lost)
        if not self.conservative:  # trapezium rule for the power of the tools
            tools = 0.5 * step * steps * (before + tool_power(self, new, prepared))
        return replace(new, external_work=new.external_work + tools)

    def displacement(self, state: State, prepared: PreparedLoads, nodes: Nodes = slice(None)) -> Floats:
        """Return the displacements [m] of some nodes, lifted only there."""
        return np.tensordot(state.coordinates, self.columns[:, nodes], 1)

    def velocity(self, state: State, prepared: PreparedLoads, nodes: Nodes = slice(None)) -> Floats:
        """Return the velocities [m/s] of some nodes."""
        return np.tensordot(state.velocities, self.columns[:, nodes], 1)

    def outputs(self, state: State, prepared: PreparedLoads) -> Outputs:
        return evaluate(self, state, prepared)

    def acceleration(self, state: State, prepared: PreparedLoads) -> Floats:
        schedule, count = prepared.schedule(np.array([state.time])), len(self.basis)
        rates = self.force(state.coordinates + self.stiffness_damping * state.velocities).copy()
        tractions = self.full.tractions(prepared, schedule).reshape(-1)
        rates += self.full.half_cell * (self.test @ tractions) / self.material.density
        rates += self._gravity_test @ schedule.gravity[0]
        if self._holds(prepared, np.array([state.time]))[0]:
            curvature = prepared.rates(lambda times: self._lifted(prepared, times), state.time)[1]
            rates = np.concatenate([rates[:count] - self.mass[:count, count:] @ curvature, curvature])
        else:
            rates = np.linalg.solve(self.mass, rates)
        return np.tensordot(rates, self.columns, 1)

    def external_force(self, state: State, prepared: PreparedLoads) -> Floats:
        return self.full.external_force(
            State(self.displacement(state, prepared), state.velocities, state.time), prepared
        )

    def nodal_force(self, displacements: Floats) -> Floats:
        return self.full.nodal_force(displacements)

    def deformation_gradient(self, displacements: Floats) -> Floats:
        return self.full.deformation_gradient(displacements)

    def stress(self, displacements: Floats) -> Floats:
        return self.full.stress(displacements)

    def strain_energy(self, displacements: Floats) -> float:
        return self.full.strain_energy(displacements)

    @property
    def volumes(self) -> Floats:
        return self.full.volumes


def galerkin(
    full: NodalModel,
    trajectories: Trajectory | Sequence[Trajectory],
    *,
    modes: int | None = None,
    tolerance: float | None = None,
    prescribed: str | Sequence[str] = (),
    lifting: str = "fitted",
    relative: bool = False,
) -> GalerkinModel:
    """Train a model that projects a full one's equations at every node on modes, as the paper does.

    Parameters
    ----------
    full : NodalModel
    trajectories : Trajectory or several
        The snapshots.
    modes, tolerance
        Size of the basis, as for `pod`.
    driven : str or sequence of str
        Groups whose motion was prescribed in the trajectories and will be again. Their motion is lifted: every
        independent motion they made gets a column; the modes vanish there.
    lifting : str
        ``"fitted"``: the columns are fitted to the snapshots, so that the whole body follows a tool at once.
        ``"local"``: they move the driven nodes alone, and all else is left to the modes: for a tool that starts a
        wave, or jumps.
    relative : bool
        Whether every snapshot counts by its shape alone, whatever its size (down to a thousandth of the largest), as
        in the error (34).

    Returns
    -------
    GalerkinModel

    Raises
    ------
    InputError
        No trajectory, or one of another body; more modes than snapshots; an unknown group or one that never moved; an
        unknown lifting, or one without driven groups.
    """
    prescribed = (prescribed,) if isinstance(prescribed, str) else tuple(prescribed)
    runs = [trajectories] if isinstance(trajectories, Trajectory) else list(trajectories)
    if not runs:
        raise InputError("project needs at least one trajectory to learn from")
    if full.material.prony is not None:
        raise InputError(
            "a projected model does not remember what relaxing tissue (prony) needs: use palpate.hyper_reduce"
        )
    for run in runs:
        if run.points.shape != full.cloud.points.shape or not np.allclose(run.points, full.cloud.points):
            raise InputError("a trajectory belongs to another cloud than the model")
    snapshots = np.concatenate([run.displacements for run in runs])
    if lifting not in ("fitted", "local"):
        raise InputError(f"lifting = {lifting!r}: allowed are 'fitted' and 'local'")
    if lifting == "local" and not prescribed:
        raise InputError("lifting = 'local' needs the driven groups: give prescribed=")
    sizes = np.sqrt(np.sum(snapshots**2, axis=2) @ full.weights)
    columns = None
    if prescribed:
        columns, snapshots = _lifting_columns(full, snapshots, prescribed, lifting == "local")
    if relative and sizes.max() > 0:
        snapshots = snapshots / np.maximum(sizes, SMALLEST * sizes.max())[:, None, None]
    return GalerkinModel(full, pod(snapshots, full.weights, modes=modes, tolerance=tolerance), columns)


def _lifting_columns(
    full: NodalModel, snapshots: Floats, prescribed: Sequence[str], local: bool
) -> tuple[Floats, Floats]:
    """Columns (l, n, 3) that carry the driven nodes' motions, and what they leave of the snapshots."""
    nodes = np.unique(np.concatenate([full.cloud.group(name) for name in prescribed]))
    motion = snapshots[:, nodes].reshape(len(snapshots), -1)
    u, values, _ = np.linalg.svd(motion, full_matrices=False)
    if values[0] == 0:
        raise InputError(f"the driven groups {', '.join(map(repr, prescribed))} never move in the trajectories")
    coordinates = u[:, values > 1e-6 * values[0]]  # orthonormal histories: regression is a product
    lifting = np.tensordot(coordinates.T, snapshots, 1)
    if local:
        alone = np.zeros_like(lifting)
        alone[:, nodes] = lifting[:, nodes]
        lifting = alone
    rest = snapshots - np.tensordot(coordinates, lifting, 1)
    rest[:, nodes] = 0.0  # rounding
    return lifting, rest
