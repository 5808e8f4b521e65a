"""The common base of models with nodal unknowns: solids and membranes."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.compiled.lanes import Lanes
from palpate.compiled.passes import Formulation, internal_force
from palpate.compiled.rows import Rows
from palpate.core.arrays import Floats, sum_of_products
from palpate.core.faults import number_in_range
from palpate.dynamics.contact.impulses import contact_kind
from palpate.dynamics.contact.tools import surface_nodes
from palpate.dynamics.loads.prepared import LoadHistory, PreparedLoads, with_held_nodes
from palpate.dynamics.loads.supports import FIXED, SupportedNodes, free_directions, supported_nodes
from palpate.dynamics.material.fibres import tension_compression_fibres
from palpate.dynamics.material.kinematics import Kinematics
from palpate.dynamics.material.relaxation import equilibrium_history as evaluate_equilibrium
from palpate.dynamics.material.relaxation import restore_history, saved_history
from palpate.dynamics.material.tissue import TissueField
from palpate.dynamics.nodal.central_difference import (
    Damping,
    NodalData,
    StepScratch,
    foundation_force,
    full_step,
    step_scratch,
    surface_force,
)
from palpate.dynamics.nodal.stability import StabilityReport, highest_frequency, stable_step
from palpate.dynamics.run.contact_state import (
    check_initial_penetration,
    check_penetration,
    check_tool_step,
    initial_contact_state,
    next_contact_state,
    steps_between_checks,
)
from palpate.dynamics.run.model import Evaluation, Model, Nodes, Outputs, State, StepReport, initial_field
from palpate.dynamics.run.reactions import NodalFields, nodal_outputs
from palpate.meshfree.mirror import NO_MIRROR, Mirror, MirrorPlane
from palpate.meshfree.stencils import Stencils
from palpate.tissue.fibres import FibreLaw

History = tuple[Floats, ...]

MIN_STEP_SHARE = 0.1  # of the undamped stable step, below which stiffness damping causes a warning


class NodalWork(NamedTuple):
    """Scratch arrays of a nodal model, for one thread at a time."""

    passes: Any  # scratch arrays of the compiled passes, with the history variables of relaxing tissue
    step: StepScratch
    step_passes: Any  # as `passes`, for `NodalModel.step_body`; the history variables are the same


class NodalModel(Model):
    """A model with nodal displacements as unknowns.

    Attributes
    ----------
    stencils : Stencils
        Stencils for derivatives of nodal fields.
    half_cell : float
        Half the c of the half-cell balance at the boundary.
    fixed_mask : (n,) bool array
        True for the nodes that cannot move in any direction.
    stability : StabilityReport
    wave_speed : float [m/s]
        Estimate of the fastest wave speed, and limit of prescribed velocities in the damping forces.
    fibres : FibreLaw or None
        Fibres with a direction at every node.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> isinstance(bar, pt.typing.NodalModel), bar.volumes.shape == (len(cloud.points),)
    (True, True)
    >>> rest = 0 * cloud.points
    >>> float(abs(bar.nodal_force(rest)).max())
    0.0
    """

    _public: ClassVar[tuple[str, ...]] = (
        "acceleration", "equilibrium_history", "evaluate", "external_force", "fibres", "fixed_mask", "force",
        "half_cell", "highest_frequency", "history_after", "nodal_force", "stability", "stencils", "strain_energy",
        "stress", "wave_speed", "weights",
    )  # fmt: skip
    stencils: Stencils
    mirror: Mirror = NO_MIRROR  # images at planes of symmetry that the stencils contain
    planes: tuple[MirrorPlane, ...] = ()  # of symmetry
    body: Any  # constants of the compiled passes; for steps, `step_body` in the precision of the steps
    formulation: Formulation
    half_cell: float
    fixed_mask: NDArray[np.bool_]
    supported: SupportedNodes
    stability: StabilityReport
    wave_speed: float
    tissue: TissueField
    kinematics: Kinematics
    fibres: FibreLaw | None = None
    # families of stencils in `body`, from nodal forces to the displacements on which they depend
    coupled_by: ClassVar[tuple[str, ...]] = ("transposed", "smoothing.transposed", "smoothing.lanes", "lanes")

    def _compile(self, formulation: Formulation, body: Any, allocate: Callable[[], Any], lanes: Lanes | Rows) -> None:
        """Set the compiled passes and their constants; requires the cloud, the volumes and the supports."""
        self.formulation, self.body, self._allocate = formulation, body, allocate
        self.tension_compression_body = (
            body if self.fibres is None else body._replace(families=tension_compression_fibres(body.families))
        )
        self._internal_force = internal_force(formulation)
        self.slot = np.zeros(len(self.cloud), dtype=np.int64)
        self.slot[lanes.nodes.ravel()] = np.arange(lanes.nodes.size)
        self.wave_speed = np.inf
        self.prepare(())  # refuses a body without free nodes
        self.supported = supported_nodes(self.cloud, self.supports)
        self.fixed_mask = self.supported.kind == FIXED
        self._history_at_rest: History = ()

    def _set_stability(self, report: StabilityReport) -> None:
        """Set the damping and the wave speed of a stability report; warn of one that shortens steps much."""
        self.stability, self.stiffness_damping = report, report.used
        undamped = stable_step(report.highest_frequency, 0.0)
        if report.step < MIN_STEP_SHARE * undamped:
            warnings.warn(
                f"stiffness_damping of {report.used:.3g} s makes the stable step {undamped / report.step:.0f} times "
                f"shorter, {report.step:.2g} s in place of {undamped:.2g} s; mass_damping=, in 1/s, damps slow "
                "vibrations at no cost",
                RuntimeWarning,
                stacklevel=5,
            )
        self.wave_speed = 0.5 * self.cloud.spacing * report.highest_frequency

    @property
    def weights(self) -> Floats:
        """Weights [m^3] of the inner product of virtual work, shape (n,)."""
        return self.volumes

    # evaluation

    def workspace(self) -> NodalWork:
        passes = self._allocate()
        return NodalWork(passes, step_scratch(len(self.cloud)), self._step_work(passes))

    @property
    def step_body(self) -> Any:
        return self.body

    @property
    def tension_compression_step_body(self) -> Any:
        """As `step_body`, with fibres that carry compression, too."""
        body = self.step_body
        return body if self.fibres is None else body._replace(families=tension_compression_fibres(body.families))

    def _step_work(self, passes: Any) -> Any:
        """Return the scratch arrays of the passes in the precision of the steps."""
        return passes

    def evaluate(self, displacements: Floats, history: History = (), work: NodalWork | None = None) -> Evaluation:
        """Return force, stress, pressure and energy density of displacements (n, 3) [m].

        Parameters
        ----------
        displacements : (n, 3) array [m]
        history : tuple of arrays
            History variables of relaxing tissue, as in a `State`; by default those at rest. The tissue
            responds to the change since then as to an instantaneous one.
        work : NodalWork, optional
        """
        raise NotImplementedError

    def deformation_gradient(self, displacements: Floats) -> Floats:
        """Return F = dx/dX of nodal displacements at every node, shape (n, 3, d)."""
        raise NotImplementedError

    def force(self, displacements: Floats, history: History = (), work: NodalWork | None = None) -> Floats:
        """Return the internal force density (n, 3) [N/m^3] of displacements, without the rest of `evaluate`."""
        work = self.workspace() if work is None else work
        self._restore(history, work)
        return self._force(displacements, self.body, work)

    def _force(self, displacements: Floats, body: Any, work: NodalWork) -> Floats:
        """Return the internal force density for the history variables in a workspace."""
        result = np.zeros((len(self.cloud), 3))
        self._internal_force(np.ascontiguousarray(displacements, dtype=float), body, work.passes, result)
        return result

    def step_force(self, displacements: Floats, work: NodalWork | None = None) -> Floats:
        """Return the internal force density (n, 3) [N/m^3] in the precision of the steps, for tissue at rest."""
        work, result = self.workspace() if work is None else work, np.zeros((len(self.cloud), 3))
        self._restore((), work)
        force_of = internal_force(self.formulation.of_steps)
        force_of(np.ascontiguousarray(displacements, dtype=float), self.step_body, work.step_passes, result)
        return result

    def _restore(self, history: History, work: NodalWork) -> None:
        """Write history variables, or those at rest for none, to a workspace."""
        if self.material.prony is not None:
            restore_history(work.passes.history, history or self._history_at_rest)

    def nodal_force(self, displacements: Floats, history: History = (), work: NodalWork | None = None) -> Floats:
        """Return the internal force density [N/m^3] of nodal displacements, shape (n, 3)."""
        return self.force(displacements, history, work)

    def stress(self, displacements: Floats, history: History = (), work: NodalWork | None = None) -> Floats:
        """Return the nodal first Piola-Kirchhoff stress [Pa] of displacements, shape (n, 3, d)."""
        return self.evaluate(displacements, history, work).stress

    def strain_energy(self, displacements: Floats, history: History = (), work: NodalWork | None = None) -> float:
        """Return the strain energy [J] of nodal displacements; NaN for an inverted body."""
        return sum_of_products(self.volumes, self.evaluate(displacements, history, work).energy_density)

    def highest_frequency(
        self,
        displacements: Floats,
        constrained: NDArray[np.bool_],
        history: History = (),
        start: Floats | None = None,
        work: NodalWork | None = None,
    ) -> tuple[float, Floats | None]:
        """Return the highest frequency [rad/s] of the body at displacements, with tension-compression fibres.

        Parameters
        ----------
        displacements : (n, 3) array [m]
        constrained : (n,) bool array
            Nodes that do not move.
        history : tuple of arrays
        start : (n, 3) array, optional
            Vector of an earlier estimate, from which the power iteration starts.
        work : NodalWork, optional

        Returns
        -------
        frequency, vector
            The vector for the next estimate; None for a body without stiffness.
        """
        scratch = self.workspace() if work is None else work
        self._restore(history, scratch)
        return highest_frequency(
            lambda u: self._force(u, self.tension_compression_body, scratch),
            displacements,
            self.constrain(constrained),
            self._noise,
            start,
            amplitude=1e-6 * self.cloud.spacing,
            density=self.material.density,
        )

    def constrain(self, constrained: NDArray[np.bool_]) -> Callable[[Floats], Floats]:
        """Return a function that removes parts of fields (..., n, 3) in place: at nodes (n,) and across supports."""

        def project(field: Floats) -> Floats:
            field = self.supported.project(field)
            field[..., constrained, :] = 0.0
            return field

        return project

    @cached_property
    def free_directions(self) -> Any:
        """Orthonormal basis (3 n, f), sparse, of the displacements that the supports allow; rows 3 i + c of node i."""
        return free_directions(self.supported)[0]

    @cached_property
    def _noise(self) -> Floats:
        return np.random.default_rng(0).standard_normal((len(self.cloud), 3))

    # steps

    def state(
        self,
        prepared: PreparedLoads,
        displacement: Floats | None = None,
        velocity: Floats | None = None,
        time: float = 0.0,
    ) -> State:
        fields: list[Floats] = []
        for name, field in (("displacement", displacement), ("velocity", velocity)):
            array = initial_field(name, field, len(self.cloud))
            fields.append(self.supported.project(array))
        schedule = prepared.schedule(np.array([time]))
        constrained = schedule.constrained[0]
        fields[0][prepared.sites.prescribed[constrained]] = schedule.motion[0, constrained]
        check_initial_penetration(prepared, schedule, fields[0], self.cloud.spacing)
        bonded = self._bonded_nodes(prepared)
        contact_state = None
        if prepared.tools or bonded:
            contact_state = initial_contact_state(len(prepared.tools), len(self.cloud), time, prescribed=bonded)
        return State(
            fields[0], fields[1], time, history=self.equilibrium_history(fields[0]), contact_state=contact_state
        )

    def equilibrium_history(self, displacements: Floats) -> History:
        """Return the history variables at equilibrium; empty without relaxation."""
        if self.material.prony is None:
            return ()
        work = self.workspace()
        return evaluate_equilibrium(work.passes.history, lambda: self._force(displacements, self.body, work))

    def history_after(
        self, displacements: Floats, history: History, interval: float, work: NodalWork | None = None
    ) -> tuple[History, float]:
        """Return the history variables after a linear change over an interval [s] to displacements (n, 3) [m].

        Returns
        -------
        history, dissipated
            The energy [J] that relaxation has dissipated.
        """
        if self.material.prony is None:
            return (), 0.0
        work = self.workspace() if work is None else work
        self._restore(history, work)
        variables = work.passes.history
        variables.interval[0] = interval
        self._force(displacements, self.body, work)
        variables.interval[0] = 0.0
        return saved_history(variables), self._relaxed_energy(work)

    def stable_step(self, state: State, prepared: PreparedLoads, work: NodalWork | None = None) -> tuple[float, State]:
        constrained = prepared.constraint_mask(state.time)
        start = state.estimate[0] if state.estimate else None
        frequency, vector = self.highest_frequency(state.coordinates, constrained, state.history, start, work)
        return self._step(frequency, prepared), replace(state, estimate=() if vector is None else (vector,))

    def _press_supports(self, prepared: PreparedLoads) -> PreparedLoads:
        """Return prepared loads whose tools also press on fixed nodes."""
        return with_held_nodes(prepared, self.masses, self.wave_speed / self.cloud.spacing)

    def _step(self, frequency: float, prepared: PreparedLoads) -> float:
        """Return the stable step [s] for a highest frequency [rad/s], with foundations."""
        sites = prepared.sites
        if not len(sites.foundation_node):
            return stable_step(frequency, self.stiffness_damping)
        response = self.half_cell / (self.volumes[sites.foundation_node] * self.material.density)
        count = len(self.cloud)
        squares = np.bincount(sites.foundation_node, sites.foundation_spring * response, minlength=count).max()
        rates = np.bincount(sites.foundation_node, sites.foundation_dashpot * response, minlength=count).max()
        highest = float(np.sqrt(frequency**2 + squares))
        return stable_step(highest, self.stiffness_damping + rates / highest**2)

    def advance(
        self, state: State, prepared: PreparedLoads, step: float, steps: int, work: NodalWork | None = None
    ) -> tuple[State, StepReport]:
        number_in_range("step", step, 0.0, open_low=True, unit="s")
        work = self.workspace() if work is None else work
        times: Floats = state.time + step * np.arange(steps + 1, dtype=float)
        u, v = state.coordinates.copy(), state.velocities.copy()
        schedule = prepared.schedule(times)
        check_tool_step(prepared, schedule, self.cloud.spacing)
        sites, contacts = prepared.with_scratch()
        self._restore(state.history, work)
        work.step.surface[:] = 0.0  # of another run's loads
        least = self._least_dilatation(work)
        least[:] = 0.0
        done, lost, tools = full_step(self.formulation.of_steps, contact_kind(contacts))(
            u,
            v,
            step,
            Damping(self.mass_damping, self.stiffness_damping, self.wave_speed),
            (self.step_body, work.step_passes),
            (sites, contacts, schedule),
            nodal_data(self),
            work.step,
        )
        if prepared.tools:
            surface = self._touched_nodes(), self.cloud.triangles
            check_penetration(prepared, contacts, schedule, u, surface, self.cloud.spacing, step)
        history: History = ()
        if self.material.prony is not None:
            lost += self._relaxed_energy(work)
            history = saved_history(work.passes.history)
        contact_state = state.contact_state
        if contact_state is not None:
            contact_state = next_contact_state(
                prepared, (sites, contacts), contact_state, 0.5 * step, schedule.constrained[-1]
            )
        new = replace(
            state, coordinates=u, velocities=v, time=float(times[-1]), external_work=state.external_work + done,
            dissipated=state.dissipated + lost, history=history, contact_state=contact_state,
        )  # fmt: skip
        if new.cut_front is not None:
            edge, friction = contacts.sites.works
            new = replace(new, cut_front=new.cut_front.with_works(float(edge), float(friction)))
        at_ends = (state, new), lambda at: self._fields(at, prepared, work)
        tools = self.tool_work(tools, step * steps, prepared, *at_ends)
        report = StepReport(done + tools, lost, float(least.min(initial=0.0)), contacts.work.tool_impulses)
        return replace(new, external_work=new.external_work + tools), report

    def most_steps(self, state: State, prepared: PreparedLoads, step: float) -> int:
        """As `steps_between_checks`."""
        return steps_between_checks(prepared, state.time, step, self.cloud.spacing)

    def _touched_nodes(self) -> NDArray[np.int64]:
        """Return the nodes of the surface that tools can touch."""
        return surface_nodes(self.cloud)

    def _least_dilatation(self, work: NodalWork) -> Floats:
        """Return the array (1,) in which the passes store the least dilatation; empty where they do not."""
        return np.zeros(0)

    def _relaxed_energy(self, work: NodalWork) -> float:
        """Return the energy [J] dissipated by relaxation since the history variables were restored."""
        raise NotImplementedError

    # results of a state

    def tractions(
        self, prepared: PreparedLoads, schedule: LoadHistory, cofactor: Floats, state: State | None = None
    ) -> Floats:
        """Return the surface loads per nodal volume [N/m^3] at the first time of a load history.

        Pressures act on the area vectors of the cofactors (b, 9, LANES) of the passes. With a state, the
        forces of foundations and of tools in contact are included.
        """
        surface = np.zeros((len(self.cloud), 3))
        surface_force(prepared.sites, schedule, 0, self.volumes, self.slot, cofactor, surface)
        if state is not None:
            if len(prepared.sites.foundation_node):
                foundation_force(prepared.sites, state.coordinates, state.velocities, self.volumes, surface)
            if state.contact_state is not None:
                surface += state.contact_state.forces / self.volumes[:, None]
        return surface

    def outputs(self, state: State, prepared: PreparedLoads, work: NodalWork | None = None) -> Outputs:
        strain_energy = self.strain_energy(state.coordinates, state.history, work)
        strain_energy += state.contact_state.held_energy if state.contact_state is not None else 0.0
        return nodal_outputs(self, self._fields(state, prepared, work), state, prepared, strain_energy)

    def _fields(self, state: State, prepared: PreparedLoads, work: NodalWork | None = None) -> NodalFields:
        acceleration = self.acceleration(state, prepared, work)
        external = self.external_force(state, prepared, work)
        return self.nodal_fields(state.coordinates, state.velocities, acceleration, external, state.history, work)

    def nodal_fields(
        self,
        displacement: Floats,
        velocity: Floats,
        acceleration: Floats,
        external_force: Floats,
        history: History = (),
        work: NodalWork | None = None,
    ) -> NodalFields:
        """Return the fields of a motion, all (n, 3), from which its reactions follow."""
        unbalanced = self.masses[:, None] * (acceleration + self.mass_damping * velocity)
        damped = displacement + self.stiffness_damping * velocity
        unbalanced -= external_force
        return self.with_internal_forces(
            NodalFields(displacement, velocity, unbalanced, None),
            lambda: self.volumes[:, None] * self.nodal_force(damped, history, work),
            lambda: self.stress(damped, history, work),
        )

    def with_internal_forces(
        self, fields: NodalFields, internal: Callable[[], Floats], stress: Callable[[], Floats]
    ) -> NodalFields:
        """Return fields of inertia and loads with the internal forces (n, 3) [N], or the stress [Pa], of a motion."""
        return fields._replace(unbalanced=fields.unbalanced - self.without_images(internal()))

    def tool_work(
        self, summed: float, duration: float, prepared: PreparedLoads, states: tuple[State, State],
        fields_of: Callable[[State], NodalFields],
    ) -> float:  # fmt: skip
        """Return the work [J] of tools that move nodes in steps of some duration [s], by its sum over these steps.

        The states are those before and after the steps.
        """
        return summed

    def _bonded_nodes(self, prepared: PreparedLoads) -> int:
        """Return the number of prescribed nodes whose impulses are outputs, because a `Grasp` is among the loads."""
        return len(prepared.sites.prescribed) if prepared.grasps else 0

    def without_images(self, forces: Floats) -> Floats:
        """Return internal forces (n, 3) [N] without those that the images exert through planes of symmetry.

        The sum of the forces along a plane's normal is the resultant of the images. It is subtracted at
        the nodes of the plane, whose support exerts it.
        """
        result = forces.copy() if self.planes else forces
        for plane in self.planes:
            result[plane.nodes] -= forces.sum(axis=0) @ plane.normal / len(plane.nodes) * plane.normal
        return result

    def acceleration(self, state: State, prepared: PreparedLoads, work: NodalWork | None = None) -> Floats:
        """Return the nodal accelerations [m/s^2], shape (n, 3); zero at fixed nodes."""
        schedule, work = prepared.schedule(np.array([state.time])), self.workspace() if work is None else work
        force = self.force(state.coordinates + self.stiffness_damping * state.velocities, state.history, work)
        force += self.half_cell * self.tractions(prepared, schedule, work.passes.cofactor, state)
        acceleration = force / self.material.density + schedule.gravity[0] - self.mass_damping * state.velocities
        self.supported.project(acceleration)
        constrained, prescribed = schedule.constrained[0], prepared.sites.prescribed
        if constrained.any():
            rates = prepared.rates(lambda t: prepared.schedule(t).motion, state.time)[1]
            acceleration[prescribed[constrained]] = rates[constrained]
        return acceleration

    def external_force(self, state: State, prepared: PreparedLoads, work: NodalWork | None = None) -> Floats:
        """Return the nodal forces [N] of surface loads and gravity, shape (n, 3)."""
        schedule, work = prepared.schedule(np.array([state.time])), self.workspace() if work is None else work
        if prepared.sites.pressure_node.size:
            self.force(state.coordinates, state.history, work)  # deforms the face of the pressure
        surface = self.tractions(prepared, schedule, work.passes.cofactor, state)
        return surface * self.volumes[:, None] + self.masses[:, None] * schedule.gravity[0]

    def displacement(self, state: State, prepared: PreparedLoads, nodes: Nodes = slice(None)) -> Floats:
        return state.coordinates[nodes]

    def velocity(self, state: State, prepared: PreparedLoads, nodes: Nodes = slice(None)) -> Floats:
        return state.velocities[nodes]


def nodal_data(model: NodalModel) -> NodalData:
    """Return the constants of the nodes of a model for its compiled step."""
    return NodalData(
        volumes=model.volumes,
        mass=model.weights * model.material.density,
        density=model.material.density,
        slot=model.slot,
        half_cell=model.half_cell,
    )
