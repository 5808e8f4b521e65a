"""The interface of a model, full or reduced, that `rollout` and the real-time engine require."""

from __future__ import annotations

from abc import ABCMeta, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from inspect import isabstract
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from palpate.core.arrays import Floats, Ints
from palpate.core.deprecation import renamed_attribute
from palpate.core.describe import Described, Fact, described_tuple, listed_names, scaled
from palpate.core.faults import InputError, argument_error, brief, is_of_call
from palpate.core.plotting import plot_body
from palpate.core.vtk import pyvista_grid, write_vtkhdf
from palpate.dynamics.loads.prepared import Load, PreparedLoads
from palpate.dynamics.loads.supports import Support
from palpate.dynamics.material.stress_measures import pressure_of, von_mises
from palpate.dynamics.run.trajectory import Trajectory
from palpate.meshfree.cloud import Cloud
from palpate.tissue.materials import Material

Nodes = NDArray[np.int64] | slice


BODY_ENDINGS = {".vtkhdf": "the surface with its fields, for ParaView"}  # of files
QUANTITY_UNITS = {"displacement": "m", "stress": "Pa", "pressure": "Pa"}  # of drawings and files
MANY_STEPS = 10**9  # more than a call of `Model.advance` takes
NEAR_NODES = 13  # of a deformation gradient by least squares, with the node itself
RESOLVED_STEP = 1e-4  # [s]: resolves motions of tools and loads at ten steps a period of 1 kHz


class ContactState(NamedTuple):
    """The forces and impulses of tools on a body."""

    forces: Floats  # (n, 3) array [N]: present forces on the nodes
    # (t, 6) array [N s], [N m s]: impulse of every tool and its moment about the tool's origin, since `start_time`
    impulses: Floats
    start_time: float  # [s]: time from which impulses are summed
    nodal_impulses: Floats  # (n, 3) array [N s]: impulses on the nodes since `start_time`
    # (t, k, 3) array [m]: positions of a reduced model's surface nodes in contact; empty in a full model
    surface_positions: Floats
    surface_forces: Floats  # (t, k, 3) array [N]: forces on those nodes
    # (p, 3) array [N s]: impulses on the prescribed nodes since `start_time`; empty without a `Grasp`
    constraint_impulses: Floats
    held_energy: float = 0.0  # [J]: energy of the tissue over supports that tools press
    # (t,) array [N]: sums of the sizes of each tool's present forces on held nodes, or one 0 for all
    held_pushes: Floats = np.zeros(1)

    def reset_impulses(self, time: float) -> ContactState:
        """Return the same forces with zero impulses, summed from a time [s] on."""
        names = ("impulses", "nodal_impulses", "constraint_impulses")
        return self._replace(start_time=time, **{name: np.zeros_like(getattr(self, name)) for name in names})


@described_tuple
class Evaluation(NamedTuple):
    """Force, stress, pressure and energy density of nodal displacements.

    Parameters
    ----------
    force : (n, 3) array [N/m^3]
        Internal force density.
    stress : (n, 3, d) array [Pa]
        First Piola-Kirchhoff stress.
    pressure : (n,) array [Pa]
        U'(J), positive for expansion; zero in a sheet, whose volume is constant.
    energy_density : (n,) array [J/m^3]
        Energy per stress-free volume.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> result = bar.evaluate(0.1 * cloud.points)
    >>> result.stress.shape, bool((result.energy_density > 0).all())
    ((112, 3, 3), True)
    """

    force: Floats
    stress: Floats
    pressure: Floats
    energy_density: Floats

    def _facts(self) -> list[Fact]:
        return [
            ("nodes", len(self.force), ""),
            ("largest stress", float(np.abs(self.stress).max(initial=0.0)), "Pa"),
            ("largest pressure", float(np.abs(self.pressure).max(initial=0.0)), "Pa"),
            ("largest energy density", float(np.max(self.energy_density, initial=0.0)), "J/m^3"),
        ]


@dataclass(frozen=True)
class StepReport(Described):
    """Energies and impulses of a call of `Model.advance`.

    Parameters
    ----------
    external_work : float [J]
        Work of loads and tools.
    dissipated : float [J]
        Energy dissipated by damping, relaxation, friction and impact.
    least_dilatation : float
        Least J - 1 at the nodes in the energy form of a solid; 0 where it is not computed.
    tool_impulses : (t, 6) array [N s], [N m s]
        Impulse of every tool in contact and its moment about the tool's origin.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> loads = bar.prepare([pt.Gravity()])
    >>> state = bar.state(loads)
    >>> step, state = bar.stable_step(state, loads)
    >>> state, report = bar.advance(state, loads, step, 2)
    >>> report.external_work > 0
    True
    """

    external_work: float
    dissipated: float
    least_dilatation: float = 0.0
    tool_impulses: Floats = field(default_factory=lambda: np.zeros((0, 6)))

    def _facts(self) -> list[Fact]:
        return [
            ("external work", float(self.external_work), "J"),
            ("dissipated", float(self.dissipated), "J"),
            ("least dilatation", float(self.least_dilatation), ""),
            ("tools", len(self.tool_impulses), ""),
        ]


@dataclass(frozen=True)
class State(Described):
    """All that the next step of a model depends on, at one time.

    Parameters
    ----------
    coordinates, velocities : arrays
        Nodal (n, 3) [m], [m/s] of a full model; of modes and lifting functions (M + l,) of a reduced one.
    time : float [s]
    external_work, dissipated : float [J]
        Work of loads and tools, and energy dissipated by damping, relaxation, friction and impact,
        since the start of the run.
    history : tuple of arrays
        History variables of viscoelastic tissue; empty without relaxation.
    contact_state : ContactState, optional
        Forces and impulses of the tools; None without tools.
    estimate : tuple of arrays
        Last estimate of the highest frequency or of the tangent, from which the next one starts;
        empty at the start of a run.
    cut_front : CutFront, optional
        Of a blade in the body.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> state = bar.state(bar.prepare([]))
    >>> state.coordinates.shape, state.time
    ((112, 3), 0.0)
    """

    coordinates: Floats
    velocities: Floats
    time: float = 0.0
    external_work: float = 0.0
    dissipated: float = 0.0
    history: tuple[Floats, ...] = ()
    contact_state: ContactState | None = None
    estimate: tuple[Floats, ...] = ()
    cut_front: Any = None

    incision = renamed_attribute("State", "incision", "cut_front")

    def _facts(self) -> list[Fact]:
        return [
            ("coordinates", self.coordinates.size, ""),
            ("time", float(self.time), "s"),
            ("largest coordinate", float(np.abs(self.coordinates).max(initial=0.0)), ""),
            ("largest velocity", float(np.abs(self.velocities).max(initial=0.0)), ""),
            ("external work", float(self.external_work), "J"),
            ("dissipated", float(self.dissipated), "J"),
            ("touched by tools", self.contact_state is not None, ""),
        ]


@dataclass(frozen=True)
class Outputs(Described):
    """Displacements, reactions and energies of a state.

    Parameters
    ----------
    displacements, velocities : (n, 3) arrays [m], [m/s]
    reactions : mapping of group name to (3,) array [N]
        Force of every support and tool on the body. For a tool in contact, and in the energy form
        for a `Grasp`, it is the mean since the last frame.
    kinetic, strain, external, dissipated : float [J]
    moments : mapping of tool name to (3,) array [N m]
        Mean moment on the body of every tool in contact since the last frame, about the tool's
        origin.
    contact_forces : (c, 4) array
        Nodes in contact with a tool or bonded to a `Grasp` since the last frame, and the mean
        forces [N] on them.
    bonded : (c,) bool array
        True for the nodes bonded to a `Grasp`.
    trust : float, optional
        Error indicator of a reduced model.
    blade : (5,) array
        Cut area [m^2], released energy, and energies dissipated at a blade's edge and by friction on its sides [J]
        since the start, and energy release rate [J/m^2]; empty without a blade.
    cut_triangles : (c, 3, 3) array [m]
        Triangles along which the body is cut.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> loads = bar.prepare([])
    >>> outputs = bar.outputs(bar.state(loads), loads)
    >>> outputs.strain, sorted(outputs.reactions)
    (0.0, ['x-'])
    """

    displacements: Floats
    velocities: Floats
    reactions: dict[str, Floats]
    kinetic: float
    strain: float
    external: float
    dissipated: float
    moments: dict[str, Floats] = field(default_factory=dict)
    contact_forces: Floats = field(default_factory=lambda: np.zeros((0, 4)))
    bonded: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, dtype=np.bool_))
    trust: float | None = None
    blade: Floats = field(default_factory=lambda: np.zeros(0))
    cut_triangles: Floats = field(default_factory=lambda: np.zeros((0, 3, 3)))

    def _facts(self) -> list[Fact]:
        return [
            ("nodes", len(self.displacements), ""),
            ("largest displacement", float(np.linalg.norm(self.displacements, axis=1).max(initial=0.0)), "m"),
            *((f"{name} energy", float(getattr(self, name)), "J") for name in ("kinetic", "strain")),
            *((f"force of {name!r}", force, "N") for name, force in self.reactions.items()),
        ]


def initial_field(name: str, value: Any, count: int) -> Floats:
    """Return a copy of an initial field (n, 3), or zeros for None."""
    return nodal_field(f"initial {name}", value, count)


def nodal_field(name: str, value: Any, count: int) -> Floats:
    """Return a copy of a field (n, 3), or zeros for None."""
    if value is None:
        return np.zeros((count, 3))
    try:
        array = np.array(value, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"{name} must be an array of numbers of shape {(count, 3)}, got {brief(value)}") from None
    if array.shape != (count, 3):
        raise InputError(f"{name} must have shape {(count, 3)}, got {array.shape}")
    bad = np.flatnonzero(~np.isfinite(array).all(axis=1))
    if bad.size:
        raise InputError(f"{name} must be finite, got {array[bad[0]]} at node {bad[0]}; correct that node")
    return array


class _Constant(ABCMeta):
    """Metaclass of objects whose attributes cannot be set after their construction."""

    def __call__(cls, *args: Any, **options: Any) -> Any:
        try:
            made = super().__call__(*args, **options)
        except TypeError as error:
            if is_of_call(error) and not isabstract(cls):
                raise argument_error(cls.__name__, cls.__init__, options, error) from None  # type: ignore[misc]  # of the class itself
            raise
        vars(made)["_constructed"] = True
        return made

    def __dir__(cls) -> list[str]:
        return listed_names(cls, super().__dir__())


class Model(Described, metaclass=_Constant):
    """A body that can be stepped through time.

    Attributes
    ----------
    cloud : Cloud
    material : Material
    supports : tuple of Support
    stiffness_damping : float [s]
        Rayleigh stiffness damping beta of C = alpha M + beta K.
    mass_damping : float [1/s]
        Rayleigh mass damping alpha.
    volumes : (n,) array [m^3]
        Nodal volumes of the stress-free body.
    name : str
        ``"full"``, ``"reduced"`` ...
    min_steps_per_frame : int
        Least number of steps between two snapshots of a run that are far apart (`longest_step`).
    conservative : bool
        True if the nodal forces are the derivative of an energy of the nodal displacements. Their
        virtual work is then that of the stresses.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> isinstance(bar, pt.typing.Model), bar.conservative
    (True, True)
    """

    _public: ClassVar[tuple[str, ...]] = (
        "accept_step", "advance", "cauchy_stress", "cloud", "conservative", "deformation_gradient", "displacement",
        "error_bounds", "fixed", "longest_step", "loose_nodes", "mass_damping", "masses", "material",
        "min_steps_per_frame", "name", "outputs", "pieces", "plot", "prepare", "save", "show", "stable_step", "state",
        "stiffness_damping", "supports", "to_pyvista", "velocity", "volumes", "workspace",
    )  # fmt: skip
    cloud: Cloud
    material: Material
    supports: tuple[Support, ...]
    stiffness_damping: float
    volumes: Floats
    name: str
    conservative: bool
    min_steps_per_frame: int = 20
    mass_damping: float = 0.0

    def __setattr__(self, name: str, value: Any) -> None:
        if "_constructed" in vars(self):
            raise AttributeError(
                f"{name} of {type(self).__name__} is constant, since threads share models; construct another model"
            )
        super().__setattr__(name, value)

    def __delattr__(self, name: str) -> None:
        raise AttributeError(f"{name} of {type(self).__name__} is constant; construct another model")

    def _facts(self) -> list[Fact]:
        material = self.material
        return [
            *self._own_facts(),
            ("nodes", len(self.cloud), ""),
            ("spacing", float(self.cloud.spacing), "m"),
            ("law", type(material).__name__, ""),
            ("shear modulus", float(material.shear_modulus), "Pa"),
            ("poisson", f"{material.poisson:.4g}", ""),
            ("fixed", [support.label for support in self.supports], ""),
            ("stiffness_damping", float(self.stiffness_damping), "s"),
            ("mass_damping", float(self.mass_damping) or None, "1/s"),
            ("density", float(material.density), "kg/m^3"),
        ]

    def _picture(self) -> str:
        return self.cloud._picture()

    def _own_facts(self) -> list[Fact]:
        """Return the facts of this kind of model, which stand before those of all."""
        return []

    @abstractmethod
    def prepare(self, loads: Load | Sequence[Load]) -> PreparedLoads:
        """Prepare loads for this model.

        Parameters
        ----------
        loads : load or sequence of loads

        Raises
        ------
        InputError
            A load is of a kind that the model does not support, or its group is unknown.
        """

    @abstractmethod
    def state(
        self,
        prepared: PreparedLoads,
        displacement: Floats | None = None,
        velocity: Floats | None = None,
        time: float = 0.0,
    ) -> State:
        """Return the state at a time [s] with given nodal displacements and velocities (equations 7 and 8).

        Parameters
        ----------
        prepared : PreparedLoads
            Result of `prepare`.
        displacement, velocity : (n, 3) arrays, optional [m], [m/s]
            At rest by default.
        time : float [s]
        """

    @abstractmethod
    def stable_step(self, state: State, prepared: PreparedLoads, work: Any = None) -> tuple[float, State]:
        """Estimate the largest stable time step [s] at a state; return it and the state with that estimate.

        Parameters
        ----------
        state : State
        prepared : PreparedLoads
        work : object, optional
            Result of `workspace`.
        """

    @abstractmethod
    def advance(
        self, state: State, prepared: PreparedLoads, step: float, steps: int, work: Any = None
    ) -> tuple[State, StepReport]:
        """Advance by a number of steps of one length [s].

        Parameters
        ----------
        state : State
        prepared : PreparedLoads
        step : float [s]
        steps : int
        work : object, optional
            Result of `workspace`.

        Returns
        -------
        State, StepReport
            The new state; work, dissipation and impulses of the steps.
        """

    @abstractmethod
    def outputs(self, state: State, prepared: PreparedLoads, work: Any = None) -> Outputs:
        """Return displacements, reactions and energies of a state."""

    def longest_step(self, every: float) -> float:
        """Return the longest step [s] of a run with snapshots at intervals of `every` [s].

        The stable step of a model with few modes can be too long to be accurate. Between two snapshots
        are at least `min_steps_per_frame` steps, but steps need not be shorter than `RESOLVED_STEP`.
        """
        return max(every / self.min_steps_per_frame, min(every, RESOLVED_STEP))

    def workspace(self) -> Any:
        """Allocate the scratch arrays of evaluations and steps, for one thread at a time.

        Methods that take them as `work` allocate their own for None. Results do not depend on their contents.
        """
        return None

    def accept_step(self, before: State, after: State, report: StepReport, work: Any = None) -> bool:
        """Return True to accept the last steps, False to retry with a smaller step.

        The default accepts every finite state.
        """
        return bool(np.isfinite(after.coordinates).all())

    def inverted_share(self, state: State) -> float:
        """Return the share of the cells between nodes that are turned inside out; zero for models without cells."""
        return 0.0

    @property
    def pieces(self) -> Ints:
        """Number of every node's piece, shape (n,); several where a cut has parted the body."""
        return np.zeros(len(self.cloud), dtype=np.int64)

    @property
    def loose_nodes(self) -> Ints:
        """Nodes (l,) of pieces that a cut has parted from all supports."""
        return np.zeros(0, dtype=np.int64)

    def deformation_gradient(self, displacements: Floats) -> Floats:
        """Return F = dx/dX (n, 3, d) of nodal displacements (n, 3) [m], by least squares over the nearest nodes."""
        points = self.cloud.points
        _, near = cKDTree(points).query(points, k=min(NEAR_NODES, len(points)))
        at_rest = points[near] - points[:, None]
        moved = displacements[near] - displacements[:, None]
        moved[..., : points.shape[1]] += at_rest
        return np.swapaxes(np.linalg.pinv(at_rest) @ moved, 1, 2)

    def after_steps(self, state: State, prepared: PreparedLoads) -> tuple[Model, State, PreparedLoads]:
        """Return the model, the state and the loads after some steps; other ones where a blade has cut the body."""
        return self, state, prepared

    def most_steps(self, state: State, prepared: PreparedLoads, step: float) -> int:
        """Return the most steps [s] until the next call of `after_steps`; without a blade it makes no difference."""
        return MANY_STEPS

    @property
    def quantities(self) -> tuple[str, ...]:
        """Names of the fields that the model draws and writes; only the displacement where it has no nodal stress."""
        return ("displacement",)

    def cauchy_stress(self, displacements: Floats) -> Floats:
        """Return the Cauchy stress [Pa] at every node, shape (n, 3, 3), for displacements (n, 3) [m]."""
        raise InputError(
            f"cauchy_stress must be defined by the class of a model, got {type(self).__name__} without it; "
            "define it and quantities, or use a Solid or a Membrane"
        )

    def plot(self, what: str = "displacement", axes: Any = None, *, displacements: Floats | None = None) -> Any:
        """Draw the deformed body: its surface, or its nodes where it has no surface.

        Parameters
        ----------
        what : str
            The colours: ``"displacement"`` [m], von Mises' ``"stress"`` [Pa], or ``"pressure"`` [Pa], minus a third of
            the trace of the Cauchy stress.
        axes : matplotlib.axes.Axes, optional
            In three dimensions; new ones by default.
        displacements : (n, 3) array, optional [m]
            Such as ``run.displacements[-1]``; at rest by default.

        Returns
        -------
        matplotlib.axes.Axes

        Raises
        ------
        InputError
            Another quantity, or matplotlib is not installed.

        Examples
        --------
        >>> import palpate as pt
        >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
        >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
        >>> bar = pt.Solid(cloud, tissue, fixed="x-")
        >>> bar.plot("stress", displacements=0.1 * cloud.points).get_zlabel()
        'z [m]'
        """
        if displacements is None and what == "displacement":
            return self.cloud.plot(axes)
        u = nodal_field("displacements", displacements, len(self.cloud))
        if what not in self.quantities:
            raise InputError(
                f"what must be {' or '.join(map(repr, self.quantities))}, got {brief(what)}; choose one of them"
            )
        field = self.point_fields(u)[what]
        values = np.linalg.norm(field, axis=1) if what == "displacement" else field
        size, unit = scaled(float(np.abs(values).max()), QUANTITY_UNITS[what])
        label = f"{'von Mises stress' if what == 'stress' else what} [{unit}]"
        u[:, : self.cloud.points.shape[1]] += self.cloud.points
        return plot_body(u, self.cloud.triangles, axes, values / size, label)

    def point_fields(self, displacements: Floats) -> dict[str, Floats]:
        """Return the displacement (n, 3) [m], the von Mises stress and the pressure (n,) [Pa] of displacements."""
        if "stress" not in self.quantities:
            return {"displacement": displacements}
        stress = self.cauchy_stress(displacements)
        return {"displacement": displacements, "stress": von_mises(stress), "pressure": pressure_of(stress)}

    def to_pyvista(self, displacements: Floats | None = None) -> Any:
        """Return the body as a mesh of pyvista.

        Parameters
        ----------
        displacements : (n, 3) array, optional [m]
            Such as ``run.displacements[-1]``; at rest by default.

        Returns
        -------
        pyvista.UnstructuredGrid
            Nodes in their reference positions, the triangles of the surface, and a vertex for every other node. Point
            data: ``displacement`` [m], von Mises ``stress`` and ``pressure`` [Pa]. ``warp_by_vector("displacement")``
            deforms it.

        Raises
        ------
        InputError
            The displacements have another shape, or pyvista is not installed.

        Examples
        --------
        >>> import palpate as pt
        >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
        >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
        >>> bar = pt.Solid(cloud, tissue, fixed="x-")
        >>> mesh = bar.to_pyvista(0.1 * cloud.points)
        >>> mesh.n_points, sorted(mesh.point_data)
        (112, ['displacement', 'pressure', 'stress'])
        """
        u = nodal_field("displacements", displacements, len(self.cloud))
        return pyvista_grid(self.cloud.points, self.cloud.triangles, self.point_fields(u))

    def write_surface(self, path: Path, displacements: Floats | None = None) -> None:
        """Write displacements (n, 3) [m], by default zero, and their stress and pressure to a VTKHDF file."""
        u = nodal_field("displacements", displacements, len(self.cloud))
        fields = {name: values[None] for name, values in self.point_fields(u).items()}
        write_vtkhdf(path, self.cloud.points, self.cloud.triangles, np.zeros(1), fields)

    def save(self, path: str | Path) -> None:
        """Write the body or reduced model to a file; see `palpate.save`."""
        from palpate import save  # the public function, which imports all kinds of models

        save(self, path)

    def show(self, **options: Any) -> Any:
        """Open the live page of the body; see `palpate.show`."""
        from palpate import show  # the public function, which imports the server

        return show(self, **options)

    def error_bounds(self, run: Trajectory) -> tuple[Floats, Floats]:
        """Return the error bounds of a run's displacement [m] and of its tool forces [N]; empty by default."""
        return np.zeros(0), np.zeros(0)

    def displacement(self, state: State, prepared: PreparedLoads, nodes: Nodes = slice(None)) -> Floats:
        """Return the displacements [m] of some nodes."""
        return self.outputs(state, prepared).displacements[nodes]

    def velocity(self, state: State, prepared: PreparedLoads, nodes: Nodes = slice(None)) -> Floats:
        """Return the velocities [m/s] of some nodes."""
        return self.outputs(state, prepared).velocities[nodes]

    @property
    def fixed(self) -> tuple[str, ...]:
        """Groups of the supports."""
        return tuple(support.group for support in self.supports)

    @property
    def masses(self) -> Floats:
        """Nodal masses [kg], shape (n,)."""
        return self.volumes * self.material.density
