"""The contract of a model: what `rollout` and the real-time engine need of a body, full or reduced."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.arrays import Floats
from palpate.describe import Described, Fact
from palpate.dynamics.loads.prepared import Load, PreparedLoads
from palpate.faults import InputError
from palpate.meshfree.cloud import Cloud
from palpate.meshfree.stencils import Stencils
from palpate.tissue.materials import Material

__all__ = ["ContactState", "Model", "Nodes", "Outputs", "State", "initial_field"]

Nodes = NDArray[np.int64] | slice


class ContactState(NamedTuple):
    """What tools that touch a body do to it."""

    forces: Floats  # (n, 3) on the nodes, now [N]
    impulses: Floats  # (tools, 6) impulse [N s] and its moment about the tool's origin [N m s], since then
    since: float  # then [s]
    given: Floats  # (n, 3) impulses [N s] on the nodes, since then
    places: Floats  # (tools, k, 3) of a reduced model's surface nodes that are touched [m]; empty in a full one
    pushes: Floats  # (tools, k, 3) forces on them [N]
    constraint_impulses: (
        Floats  # (driven nodes, 3) impulses [N s] that hold them, since then; empty where no `Grasp` does
    )

    def anew(self, time: float) -> ContactState:
        """Return this with impulses counted from now, a time [s]."""
        nothing = {name: np.zeros_like(getattr(self, name)) for name in ("impulses", "given", "constraint_impulses")}
        return self._replace(since=time, **nothing)


@dataclass(frozen=True)
class State(Described):
    """Coordinates and velocities of a model at one time.

    Parameters
    ----------
    coordinates, velocities : arrays
        Nodal (n, 3) [m], [m/s] for a full model, of modes and lifting columns (M + l,) for a reduced one.
    time : float [s]
    external_work, dissipated : float [J]
        Work of loads and tools, and work lost to viscosity, relaxation, friction and impact, since the run began.
    history : tuple of arrays
        What relaxing tissue remembers; empty where it does not relax.
    contact_state : ContactState, optional
        What tools do that touch the body; None where there are none.
    """

    coordinates: Floats
    velocities: Floats
    time: float = 0.0
    external_work: float = 0.0
    dissipated: float = 0.0
    history: tuple[Floats, ...] = ()
    contact_state: ContactState | None = None

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
    """What a model tells about a state.

    Parameters
    ----------
    displacements, velocities : (n, 3) arrays [m], [m/s]
    reactions : mapping of group name to (3,) array [N]
        Force of every support and tool on the body; of a tool that touches it, and in the energy form of a `Grasp`,
        the mean since the last frame.
    kinetic, strain, external, dissipated : float [J]
    moments : mapping of tool name to (3,) array [N m]
        Moment about its origin, on the body, of every tool that touches it, the mean since the last frame.
    contact_forces : (c, 4) array
        Nodes that tools have touched or a `Grasp` has held since the last frame, and the mean forces [N] of those
        tools on them.
    bonded : (c,) bool array
        Which of them a `Grasp` has held.
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

    def _facts(self) -> list[Fact]:
        return [
            ("nodes", len(self.displacements), ""),
            ("largest displacement", float(np.linalg.norm(self.displacements, axis=1).max(initial=0.0)), "m"),
            *((f"{name} energy", float(getattr(self, name)), "J") for name in ("kinetic", "strain")),
            *((f"force of {name!r}", force, "N") for name, force in self.reactions.items()),
        ]


def initial_field(name: str, given: Any, count: int) -> Floats:
    """Return an initial field (n, 3) as a new array: zero where none is given.

    Raises
    ------
    InputError
        It has another shape, or is not finite; names the first such node.
    """
    if given is None:
        return np.zeros((count, 3))
    try:
        array = np.array(given, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise InputError(f"initial {name} must be an array of numbers of shape {(count, 3)}") from None
    if array.shape != (count, 3):
        raise InputError(f"initial {name} must be finite, of shape {(count, 3)}, not {array.shape}")
    bad = np.flatnonzero(~np.isfinite(array).all(axis=1))
    if bad.size:
        raise InputError(f"initial {name} must be finite, got {array[bad[0]]} at node {bad[0]}: check how it was made")
    return array


class Model(Described, ABC):
    """A body that can be stepped through time.

    Attributes
    ----------
    cloud : Cloud
    material : Material
    fixed : tuple of str
        Groups that are held.
    stencils : Stencils
        For derivatives of nodal fields.
    stiffness_damping : float [s]
        Stiffness-proportional viscosity beta, C = beta K.
    name : str
        ``"full"``, ``"reduced"`` ...
    min_steps_per_frame : int
        Steps between two snapshots of a run at least: a model of few modes is stable long before it is accurate.
    conservative : bool
        Whether the nodal forces are the derivative of an energy of the nodes' displacements: their virtual work is then
        that of the stresses.
    """

    cloud: Cloud
    material: Material
    stencils: Stencils
    fixed: tuple[str, ...]
    stiffness_damping: float
    name: str
    conservative: bool
    min_steps_per_frame: int = 20

    def _facts(self) -> list[Fact]:
        material = self.material
        return [
            *self._own_facts(),
            ("nodes", len(self.cloud), ""),
            ("spacing", float(self.cloud.spacing), "m"),
            ("law", type(material).__name__, ""),
            ("shear modulus", float(material.shear_modulus), "Pa"),
            ("poisson", f"{material.poisson:.4g}", ""),
            ("fixed", self.fixed, ""),
            ("stiffness_damping", float(self.stiffness_damping), "s"),
            ("density", float(material.density), "kg/m^3"),
        ]

    def _picture(self) -> str:
        return self.cloud._picture()

    def _own_facts(self) -> list[Fact]:
        """Return the facts of this kind of model, which stand before those of all."""
        return []

    @abstractmethod
    def state(
        self,
        prepared: PreparedLoads,
        displacement: Floats | None = None,
        velocity: Floats | None = None,
        time: float = 0.0,
    ) -> State:
        """Return the state at a time [s] with given nodal displacements and velocities (equations 7 and 8)."""

    @abstractmethod
    def prepare(self, loads: Sequence[Load]) -> PreparedLoads:
        """Make loads ready for this model."""

    @abstractmethod
    def stable_step(self, state: State, prepared: PreparedLoads) -> float:
        """Estimate the largest stable time step [s] at a state."""

    @abstractmethod
    def advance(self, state: State, prepared: PreparedLoads, step: float, steps: int) -> State:
        """Advance by a number of steps of one length [s]."""

    def accept_step(self, before: State, after: State) -> bool:
        """Return whether the steps just taken from one state to another may be believed, or finer ones should be tried.

        A model whose steps can fail otherwise than by numbers that are not finite says so.
        """
        return bool(np.isfinite(after.coordinates).all())

    @abstractmethod
    def displacement(self, state: State, prepared: PreparedLoads, nodes: Nodes = slice(None)) -> Floats:
        """Return the displacements [m] of some nodes."""

    @abstractmethod
    def velocity(self, state: State, prepared: PreparedLoads, nodes: Nodes = slice(None)) -> Floats:
        """Return the velocities [m/s] of some nodes."""

    @abstractmethod
    def outputs(self, state: State, prepared: PreparedLoads) -> Outputs:
        """Return what there is to tell about a state."""

    @abstractmethod
    def acceleration(self, state: State, prepared: PreparedLoads) -> Floats:
        """Return the nodal accelerations [m/s^2], shape (n, 3): zero where fixed, the motion's where driven."""

    @abstractmethod
    def external_force(self, state: State, prepared: PreparedLoads) -> Floats:
        """Return the nodal forces [N] of tractions and gravity, shape (n, 3)."""

    @abstractmethod
    def nodal_force(self, displacements: Floats) -> Floats:
        """Return the internal force density [N/m^3] at every node for nodal displacements, shape (n, 3)."""

    @abstractmethod
    def deformation_gradient(self, displacements: Floats) -> Floats:
        """Return F = dx/dX at every node for nodal displacements, shape (n, 3, d)."""

    @abstractmethod
    def stress(self, displacements: Floats) -> Floats:
        """Return the first Piola-Kirchhoff stress [Pa] at every node for nodal displacements, shape (n, 3, d)."""

    @abstractmethod
    def strain_energy(self, displacements: Floats) -> float:
        """Return the strain energy [J] of nodal displacements; not a number where the body is turned inside out."""

    @property
    @abstractmethod
    def volumes(self) -> Floats:
        """Nodal volumes [m^3] of the unstressed body, shape (n,)."""

    @property
    def masses(self) -> Floats:
        """Nodal masses [kg], shape (n,)."""
        return self.volumes * self.material.density
