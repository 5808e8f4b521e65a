"""The paper's reduced model: equations of motion at every node, projected on modes (section 5, (28) to (32))."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from palpate.core.arrays import Floats
from palpate.core.describe import Fact
from palpate.core.faults import InputError
from palpate.dynamics.contact.tools import Grasp
from palpate.dynamics.loads.body_force import Gravity
from palpate.dynamics.loads.dead_load import DeadLoad
from palpate.dynamics.loads.prepared import Load, PreparedLoads, check_kinds, listed
from palpate.dynamics.loads.prescribed_motion import PrescribedMotion
from palpate.dynamics.loads.pressure import Pressure
from palpate.dynamics.loads.supports import PRESCRIBED
from palpate.dynamics.nodal.model import NodalModel
from palpate.dynamics.nodal.stability import stable_step
from palpate.dynamics.run.model import Outputs, State, StepReport
from palpate.dynamics.run.reactions import NodalFields, nodal_outputs
from palpate.dynamics.run.trajectory import Trajectory
from palpate.reduction.basis.coordinates import CoordinateModel
from palpate.reduction.basis.pod import Basis, pod
from palpate.reduction.galerkin.step import BasisData, BodyData, GalerkinWork, reduced_step

PERMITTED_LOADS = (DeadLoad, Pressure, Gravity, PrescribedMotion, Grasp)  # of loads, whose forces the step has
REFRESH_DISPLACEMENT = 0.1  # displacement after which the tangent is updated, as a fraction of the largest so far
MIN_SIZE = 1e-3  # of the largest snapshot, below which one has reduced weight in a relative basis
LIFTING_TOLERANCE = 1e-3  # largest error of a prescribed motion in the lifting functions, relative


class GalerkinModel(CoordinateModel):
    """A full model in coordinates of modes, U = Q A (30), and of lifting functions for tool motions.

    The equations are those of the full model at every node, multiplied by Q^T in the inner product of the
    basis (32).

    Parameters
    ----------
    full : NodalModel
    basis : Basis
        Modes that vanish at fixed and prescribed nodes.
    lifting : (l, n, 3) array, optional
        Lifting functions for prescribed motions: displacement fields whose coordinates follow from the
        motion of the tool.
    implicit : bool
        Whether modes too fast for the step are slowed down instead of limiting it. Accelerations are then
        multiplied by (1 + g K)^-1 with g = dt^2/2 + beta dt and the current reduced tangent K. A mode of
        frequency w has w'^2 = w^2 / (1 + g w^2), and (dt^2 + 2 beta dt) w'^2 < 2, half of the limit of
        central differences. Mass damping acts on these modes as on others. Slow modes keep their frequency up
        to g w^2 / 2. Otherwise the step is the
        explicit one of the reduced spectrum.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> pull = pt.SurfaceForce("x+", force=lambda t: (20 * t, 0, 0))
    >>> full = pt.rollout(bar, [pull], duration=0.03, every=0.001)
    >>> model = pt.galerkin(bar, full, modes=4)
    >>> len(model.basis)
    4
    >>> pt.rollout(model, [pull], duration=0.03, every=0.01).model
    'projected'
    """

    name = "projected"
    _public = ("basis", "full", "lifting", "spectrum")

    def __init__(self, full: NodalModel, basis: Basis, lifting: Floats | None = None, *, implicit: bool = True) -> None:
        if basis.modes.shape[1:] != (len(full.cloud), 3):
            raise InputError(
                f"basis must have the {len(full.cloud)} nodes of full, got {basis.modes.shape[1]}; use its snapshots"
            )
        self.full, self.basis = full, basis
        self.cloud, self.material, self.supports = full.cloud, full.material, full.supports
        self.conservative, self.volumes = full.conservative, full.volumes
        self.stiffness_damping, self.mass_damping = full.stiffness_damping, full.mass_damping
        n, count = len(full.cloud), len(basis)
        self.lifting = np.zeros((0, n, 3)) if lifting is None else np.asarray(lifting, dtype=float)
        self.columns = np.ascontiguousarray(np.concatenate([basis.modes, self.lifting]))
        # test functions: mass @ acceleration = test . force / density; the modes' block of the mass is 1
        self.test = np.ascontiguousarray((self.columns * basis.weights[:, None]).reshape(len(self.columns), -1))
        self.mass = self.test @ self.columns.reshape(len(self.columns), -1).T
        self.mass[:count, :count] = np.eye(count)
        blocks, lanes = full.body.lanes.nodes.shape
        self._sizes = np.linalg.norm(self.columns, axis=2).max(axis=1)  # largest displacement of a unit coordinate
        self._body = BodyData(
            body=full.body,
            volumes=self.volumes,
            slot=full.slot,
            half_cell=full.half_cell,
            density=self.material.density,
            stiffness_damping=self.stiffness_damping,
            mass_damping=self.mass_damping,
        )
        self._basis = BasisData(
            table=np.zeros((blocks, len(self.columns), full.formulation.numbers, lanes)),
            vectors=self.columns,
            test=self.test,
            mass=self.mass,
            kinetic=np.einsum("inc,n,jnc->ij", self.columns, full.masses, self.columns, optimize=True),
            gravity_test=self.test.reshape(len(self.columns), n, 3).sum(axis=1),
            gravity_work=np.einsum("n,mnc->mc", full.masses, self.columns),
            wave_speed=full.wave_speed / self._sizes[len(basis) :],
        )
        full.formulation.differentiate(
            full.mirror.vectors(self.columns), full.body, full.workspace().passes, self._basis.table
        )
        self._projected_force, self._advance = reduced_step(full.formulation)
        self.implicit = implicit

    def _own_facts(self) -> list[Fact]:
        return [
            ("modes", len(self.basis), ""),
            ("lifting functions", len(self.lifting) or None, ""),
            ("energy not held", 100 * self.basis.lost_energy, "%"),
            ("slows fast modes", self.implicit, ""),
        ]

    def workspace(self) -> GalerkinWork:
        n, count, blocks = len(self.cloud), len(self.columns), len(self._basis.table)
        return GalerkinWork(
            self.full.workspace(),
            np.zeros((n, 3)),
            np.zeros((n, 3)),
            np.zeros((blocks, count)),
            *np.zeros((6, count)),
        )

    def force(self, coordinates: Floats, work: GalerkinWork | None = None) -> Floats:
        """Return Q^T f / rho for coordinates of modes and lifting functions, both of shape (M + l,)."""
        work = self.workspace() if work is None else work
        self._projected_force(np.ascontiguousarray(coordinates), self._body, self._basis, work)
        return work.result / self.material.density

    @property
    def quantities(self) -> tuple[str, ...]:
        return self.full.quantities

    def cauchy_stress(self, displacements: Floats) -> Floats:
        return self.full.cauchy_stress(displacements)

    def prepare(self, loads: Load | Sequence[Load]) -> PreparedLoads:
        loads = listed(loads)
        check_kinds(loads, PERMITTED_LOADS, "loads of a projected model")
        prepared = self.full.prepare(loads)
        if len(prepared.sites.prescribed) and not len(self.lifting):
            raise InputError(
                "loads must hold no PrescribedMotion unless it was part of the training, got one; train with one on "
                + ", ".join(repr(m.group) for m, _ in prepared.motions)
            )
        if len(self.lifting) and not len(prepared.sites.prescribed):
            raise InputError(
                "loads must include a motion of the prescribed groups as in training, got none; add a PrescribedMotion"
            )
        if len({m.until for m, _ in prepared.motions}) > 1:
            raise InputError("until must be the same for all tools, got several times; give all motions one `until`")
        modes = np.abs(self.basis.modes)
        for motion, where in prepared.motions:
            if modes[:, prepared.sites.prescribed[where]].max() > LIFTING_TOLERANCE * modes.max():
                raise InputError(
                    f"loads must prescribe groups of the training only, got group {motion.group!r}; train with it"
                )
        return prepared

    def _lifting_coordinates(self, prepared: PreparedLoads, times: Floats) -> Floats:
        """Return the coordinates (t, l) of the lifting functions at some times."""
        if not len(self.lifting):
            return np.zeros((len(times), 0))
        nodes = np.flatnonzero(prepared.sites.kind == PRESCRIBED)
        order = np.argsort(prepared.sites.prescribed)
        motion = prepared.schedule(times).motion[:, order].reshape(len(times), -1)
        span = self.lifting[:, nodes].reshape(len(self.lifting), -1)
        coordinates, *_ = np.linalg.lstsq(span.T, motion.T, rcond=None)
        error = np.abs(coordinates.T @ span - motion).max()
        if error > LIFTING_TOLERANCE * max(np.abs(motion).max(), 1e-3 * self.cloud.spacing):
            raise InputError(
                f"displacement of a prescribed group must be as in training, got an error of {error:.3g} m "
                f"at t = {times[0]:.4g} s; train with such a motion"
            )
        return np.ascontiguousarray(coordinates.T)  # another order would compile the step a second time

    def state(
        self,
        prepared: PreparedLoads,
        displacement: Floats | None = None,
        velocity: Floats | None = None,
        time: float = 0.0,
    ) -> State:
        nodal = self.full.state(prepared, displacement, velocity, time)
        fields = np.stack([nodal.coordinates, nodal.velocities])
        if prepared.is_prescribed(np.array([time]))[0]:
            lifting = self._lifting_coordinates(prepared, np.array([time]))[0]
            rates = prepared.rates(lambda times: self._lifting_coordinates(prepared, times), time)[0]
            tool_motion = np.stack([lifting, rates])
            coordinates = np.hstack(
                [self.basis.project(fields - np.tensordot(tool_motion, self.lifting, 1)), tool_motion]
            )
        else:
            weighted = (fields * self.basis.weights[:, None]).reshape(2, -1)
            coordinates = np.linalg.solve(self.mass, (weighted @ self.columns.reshape(len(self.mass), -1).T).T).T
        return State(coordinates[0], coordinates[1], time)

    def stable_step(
        self, state: State, prepared: PreparedLoads, work: GalerkinWork | None = None
    ) -> tuple[float, State]:
        prescribed = bool(prepared.is_prescribed(np.array([state.time * (1 + 1e-8) + 1e-12]))[0])  # after this time
        if self.implicit and prescribed:
            return np.inf, state
        if self.implicit:  # released nodes move too fast for updates of the tangent
            return stable_step(self.full.stability.highest_frequency, self.stiffness_damping), state
        state = self._with_tangent(state, work)
        moving = slice(len(self.basis) if prescribed else None)
        tangent = np.linalg.solve(self.mass[moving, moving], state.estimate[0][moving, moving])
        highest = float(np.sqrt(np.abs(np.linalg.eigvals(tangent)).max()))
        return stable_step(highest, self.stiffness_damping), state

    def _with_tangent(self, state: State, work: GalerkinWork | None) -> State:
        """Return the state with its tangent, updated if it has moved far enough since the last update.

        The estimate of the state is the tangent, the displacements at which it was computed, and the
        largest displacement of the run, in the sizes of the coordinates.
        """
        moved = state.coordinates * self._sizes  # modes and lifting coordinates have different units
        largest = float(np.abs(moved).max())
        if state.estimate:
            tangent, at, before = state.estimate
            largest = max(largest, float(before))
            if np.abs(moved - at).max() <= REFRESH_DISPLACEMENT * largest:
                return replace(state, estimate=(tangent, at, np.array(largest)))
        return replace(state, estimate=(self.stiffness(state.coordinates, work), moved, np.array(largest)))

    def _responses(self, state: State, step: float) -> tuple[Floats, Floats]:
        """Return (mass + (dt^2 / 2 + beta dt) K)^-1 of the modes alone, and of all coordinates."""
        matrix, modes = self.mass, slice(len(self.basis))
        if self.implicit:
            matrix = self.mass + step * (0.5 * step + self.stiffness_damping) * state.estimate[0]
        constrained, full = (np.asarray(np.linalg.inv(each), dtype=float) for each in (matrix[modes, modes], matrix))
        return constrained, full

    def stiffness(self, columns: Floats, work: GalerkinWork | None = None) -> Floats:
        """Return the tangent -d(force)/d(coordinates) [1/s^2], (M + l, M + l), by differences."""
        work = self.workspace() if work is None else work
        tangent, base = np.empty_like(self.mass), self.force(columns, work)
        for m in range(len(self.columns)):
            # a displacement of about a millionth of the spacing
            delta = 1e-6 * self.cloud.spacing / self._sizes[m]
            moved = columns.copy()
            moved[m] += delta
            tangent[:, m] = (base - self.force(moved, work)) / delta
        return tangent

    def spectrum(self, columns: Floats) -> NDArray[np.complex128]:
        """Return the eigenvalues w^2 [1/s^2] of the modes' tangent with the tools fixed."""
        count = len(self.basis)
        return np.linalg.eigvals(self.stiffness(columns)[:count, :count]).astype(complex)

    def advance(
        self, state: State, prepared: PreparedLoads, step: float, steps: int, work: GalerkinWork | None = None
    ) -> tuple[State, StepReport]:
        work = self.workspace() if work is None else work
        times: Floats = state.time + step * np.arange(-1.0, steps + 2)
        a, v = state.coordinates.copy(), state.velocities.copy()
        work.surface[:] = 0.0  # of another run's loads
        lifting, holds = self._lifting_coordinates(prepared, times), prepared.is_prescribed(times[1:-1])
        if self.implicit:
            state = self._with_tangent(state, work)
        loads, responses = (prepared.sites, prepared.schedule(times[1:-1])), self._responses(state, step)
        done, lost, tools = self._advance(a, v, lifting, holds, step, loads, responses, self._body, self._basis, work)
        new = replace(
            state, coordinates=a, velocities=v, time=float(times[-2]), external_work=state.external_work + done,
            dissipated=state.dissipated + lost,
        )  # fmt: skip
        at_ends = (state, new), lambda at: self._fields(at, prepared, work)
        tools = self.full.tool_work(tools, step * steps, prepared, *at_ends)
        return replace(new, external_work=new.external_work + tools), StepReport(done + tools, lost)

    def outputs(self, state: State, prepared: PreparedLoads, work: GalerkinWork | None = None) -> Outputs:
        work = self.workspace() if work is None else work
        fields = self._fields(state, prepared, work)
        strain_energy = self.full.strain_energy(fields.displacement, work=work.full)
        return nodal_outputs(self.full, fields, state, prepared, strain_energy)

    def _fields(self, state: State, prepared: PreparedLoads, work: GalerkinWork) -> NodalFields:
        """Return the nodal fields of a state, from which its reactions follow."""
        schedule, count = prepared.schedule(np.array([state.time])), len(self.basis)
        rates = self.force(state.coordinates + self.stiffness_damping * state.velocities, work)
        tractions = self.full.tractions(prepared, schedule, work.full.passes.cofactor).reshape(-1)
        rates += self.full.half_cell * (self.test @ tractions) / self.material.density
        rates += self._basis.gravity_test @ schedule.gravity[0]
        if prepared.is_prescribed(np.array([state.time]))[0]:
            curvature = prepared.rates(lambda times: self._lifting_coordinates(prepared, times), state.time)[1]
            damped = curvature + self.mass_damping * state.velocities[count:]
            free = rates[:count] - self.mass[:count, count:] @ damped - self.mass_damping * state.velocities[:count]
            rates = np.concatenate([free, curvature])
        else:
            rates = np.linalg.solve(self.mass, rates) - self.mass_damping * state.velocities
        u, v = self.displacement(state, prepared), self.velocity(state, prepared)
        external = self.full.external_force(State(u, v, state.time), prepared, work.full)
        return self.full.nodal_fields(u, v, np.tensordot(rates, self.columns, 1), external, work=work.full)


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
    """Train a model that projects a full one's equations at every node on modes, as in the paper.

    Parameters
    ----------
    full : NodalModel
    trajectories : Trajectory or several
        The snapshots.
    modes, tolerance
        Size of the basis, as for `pod`.
    prescribed : str or sequence of str
        Groups whose motion is prescribed, in the trajectories and in later runs. Every independent motion
        of theirs has a lifting function; the modes vanish there.
    lifting : str
        ``"fitted"``: lifting functions are fitted to the snapshots, so that the whole body responds to a
        tool at once. ``"local"``: they move the prescribed nodes alone, and the modes represent the rest,
        for a tool that starts a wave, or jumps.
    relative : bool
        Whether all snapshots have the same weight, down to a thousandth of the largest, as in the error
        (34).

    Returns
    -------
    GalerkinModel

    Raises
    ------
    InputError
        No trajectory, or one of another body; more modes than snapshots; an unknown group or one that
        never moves; an unknown lifting, or a local one without prescribed groups.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> pull = pt.SurfaceForce("x+", force=lambda t: (20 * t, 0, 0))
    >>> full = pt.rollout(bar, [pull], duration=0.03, every=0.001)
    >>> model = pt.galerkin(bar, full, modes=4)
    >>> reduced = pt.rollout(model, [pull], duration=0.03, every=0.001)
    >>> pt.relative_errors(full, reduced).displacement < 0.05
    True
    """
    prescribed = (prescribed,) if isinstance(prescribed, str) else tuple(prescribed)
    runs = [trajectories] if isinstance(trajectories, Trajectory) else list(trajectories)
    if not runs:
        raise InputError("trajectories must hold at least one, got none; run the full model first")
    if full.material.prony is not None:
        raise InputError(
            "material must not relax (prony) in a Galerkin model, got a Prony series; use palpate.hyper_reduce"
        )
    for run in runs:
        if run.points.shape != full.cloud.points.shape or not np.allclose(run.points, full.cloud.points):
            raise InputError("trajectories must be of the model's cloud, got one of another cloud; run the same model")
    snapshots = np.concatenate([run.displacements for run in runs])
    if lifting not in ("fitted", "local"):
        raise InputError(f"lifting must be 'fitted' or 'local', got {lifting!r}; use one of them")
    if lifting == "local" and not prescribed:
        raise InputError("prescribed must name groups for lifting='local', got none; give prescribed=")
    sizes = np.sqrt(np.sum(snapshots**2, axis=2) @ full.weights)
    columns = None
    if prescribed:
        columns, snapshots = _lifting_functions(full, snapshots, prescribed, lifting == "local")
    if relative and sizes.max() > 0:
        snapshots = snapshots / np.maximum(sizes, MIN_SIZE * sizes.max())[:, None, None]
    return GalerkinModel(full, pod(snapshots, full.weights, modes=modes, tolerance=tolerance), columns)


def _lifting_functions(
    full: NodalModel, snapshots: Floats, prescribed: Sequence[str], local: bool
) -> tuple[Floats, Floats]:
    """Return lifting functions (l, n, 3) for the motions of prescribed groups, and the snapshots without their part."""
    nodes = np.unique(np.concatenate([full.cloud.group(name) for name in prescribed]))
    motion = snapshots[:, nodes].reshape(len(snapshots), -1)
    u, values, _ = np.linalg.svd(motion, full_matrices=False)
    if values[0] == 0:
        raise InputError(
            f"prescribed must name groups that move, got {', '.join(map(repr, prescribed))}; train with their motion"
        )
    coordinates = u[:, values > 1e-6 * values[0]]  # orthonormal histories: regression is a product
    lifting = np.tensordot(coordinates.T, snapshots, 1)
    if local:
        alone = np.zeros_like(lifting)
        alone[:, nodes] = lifting[:, nodes]
        lifting = alone
    rest = snapshots - np.tensordot(coordinates, lifting, 1)
    rest[:, nodes] = 0.0  # rounding
    return lifting, rest
