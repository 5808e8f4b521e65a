"""The body of a reduced model: masses, forces and energy in the coordinates of modes and tools.

It holds constants only. All threads may share it; each requires a workspace of its own.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from functools import cached_property
from operator import attrgetter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.core.arrays import Floats
from palpate.core.describe import Described, Fact
from palpate.dynamics.loads.supports import symmetry_planes
from palpate.dynamics.material.fibres import tension_compression_fibres
from palpate.dynamics.material.relaxation import equilibrium_history, history_after, relaxation, restore_history
from palpate.meshfree.mirror import Mirror, mirror_images
from palpate.meshfree.stencils import Stencils, moving_least_squares
from palpate.reduction.contact.surface import ContactSurface
from palpate.reduction.contact.tools import ContactTools
from palpate.reduction.hyper.constants import ReducedConstants
from palpate.reduction.hyper.data import ReducedData
from palpate.reduction.hyper.material_point import MaterialPoint, material_point
from palpate.reduction.hyper.newton import NewtonScratch, newton_scratch, tangent_function
from palpate.reduction.hyper.sampled_energy import (
    CubaturePoints,
    SampledEnergy,
    Scratch,
    cubature_points,
    sampled_energy,
    scratch,
)

History = tuple[Floats, ...]

DIFFERENCE_STEP = 1e-5  # displacements for difference quotients of the tangent, in spacings
STENCIL_NEIGHBOURS = {2: 14, 3: 42}  # by dimension of the cloud: a sheet, a solid


@dataclass
class ReducedWork:
    """Scratch arrays of a reduced model, for one thread at a time."""

    # coordinates, all: of the forces on the coordinates, and on the trial and test basis; they share the history
    # variables
    coordinates: Scratch
    all: Scratch
    newton: NewtonScratch
    # force, all_forces: arrays [N]
    force: Floats
    all_forces: Floats
    tools: ContactTools | None = None  # rigid tools of the loads that were used last


@dataclass(frozen=True, eq=False)
class ReducedBody(Described):
    """Constants of a reduced model, and the forces and energy that follow from its coordinates.

    Parameters
    ----------
    data : ReducedData
    law : MaterialPoint
    coefficients : tuple of float
        Parameters of the law.
    single : bool
        Whether the derivatives at the cubature points have single precision.
    masses : (n,) array [kg]
        Nodal masses.
    all_mass : (m + l + 3 g + w, m + l + 3 g + w) array [kg]
        Mass matrix of the trial and test basis.
    constants : ReducedConstants
        Of the coordinates; compiled steps read them.
    sizes : (m + l,) array [m]
        Largest displacement of a unit coordinate.
    all_points : CubaturePoints
        With the derivatives of the trial and test basis.
    tension_compression_points : CubaturePoints
        Those of the coordinates, with fibres that carry compression, too.
    surface : ContactSurface
        Empty for a model without contact.
    sampled : SampledEnergy
        Compiled force and energy, see `palpate.reduction.hyper.sampled_energy`.
    tangent : function
        Compiled, see `palpate.reduction.hyper.newton`.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> pull = pt.SurfaceForce("x+", force=lambda t: (20 * t, 0, 0))
    >>> full = pt.rollout(bar, [pull], duration=0.03, every=0.001)
    >>> model = pt.hyper_reduce(bar, full, modes=4)
    >>> body = model.body
    >>> body.mass.shape, bool(body.energy([0.0] * body.count) < 1e-12)
    ((4, 4), True)
    """

    _public = ("count", "energy", "force", "frequencies", "gradient", "mass", "stiffness", "vectors", "workspace")
    data: ReducedData
    law: MaterialPoint
    coefficients: tuple[float, ...]
    single: bool
    masses: Floats
    all_mass: Floats
    constants: ReducedConstants
    sizes: Floats
    all_points: CubaturePoints
    tension_compression_points: CubaturePoints
    surface: ContactSurface
    sampled: SampledEnergy
    tangent: Any

    def _facts(self) -> list[Fact]:
        return [
            ("modes", self.data.modes, ""),
            ("coordinates", self.count, ""),
            ("nodes", len(self.masses), ""),
            ("cubature points", len(self.data.cubature.nodes), ""),
            ("single precision", self.single, ""),
        ]

    @property
    def count(self) -> int:
        """Number m + l of coordinates: modes and lifting functions."""
        return self.data.basis.count

    @property
    def mass(self) -> Floats:
        """Mass matrix [kg] of the coordinates, shape (m + l, m + l)."""
        return self.constants.mass

    @property
    def inverse_mass(self) -> Floats:
        """Inverse [1/kg] of the mass matrix, shape (m + l, m + l)."""
        return self.constants.inverse_mass

    @property
    def constrained_inverse_mass(self) -> Floats:
        """Inverse [1/kg] of the modes' mass matrix, with the tools fixed, shape (m, m)."""
        return self.constants.constrained_inverse_mass

    @property
    def points(self) -> CubaturePoints:
        """Cubature points with the derivatives of the coordinates' vectors."""
        return self.constants.cubature_points

    @property
    def vectors(self) -> Floats:
        """Displacement fields of the coordinates, shape (m + l, n, 3)."""
        return self.data.basis.vectors[: self.count]

    def __getattr__(self, name: str) -> Any:
        former = {"differences": "constants.differences", "sampled_force": "sampled.force"}
        former |= {"sampled_energy": "sampled.energy", "taut_points": "tension_compression_points"}
        if name not in former:
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        message = f"ReducedBody.{name} is deprecated and will be removed in the next version; use {former[name]}"
        warnings.warn(message, DeprecationWarning, stacklevel=2)
        return attrgetter(former[name])(self)

    def gradient(self, displacements: Floats) -> Floats:
        """Return the derivatives (n, 3, d) of displacements (n, 3) at the nodes, by a fit of its own."""
        mirror, stencils = self._stencils
        return stencils.gradient(mirror.vectors(displacements))

    @cached_property
    def _stencils(self) -> tuple[Mirror, Stencils]:
        cloud, stretch = self.data.cloud, self.data.kinematics.prestretch
        images = mirror_images(cloud, symmetry_planes(cloud, self.data.supports))
        count = STENCIL_NEIGHBOURS[cloud.points.shape[1]]
        full = images.cloud
        return images.own(moving_least_squares(full.points / stretch, order=2, neighbours=count, hidden=full.hidden))

    @cached_property
    def trained(self) -> tuple[Floats, Floats]:
        """The training states times a root (m + l, m + l) of the mass matrix over the body's mass, and the root."""
        root = np.linalg.cholesky(self.mass / self.masses.sum())
        return self.data.training_states @ root, root

    def workspace(self) -> ReducedWork:
        """Allocate the scratch arrays of evaluations and steps, for one thread at a time."""
        sampled, forces = scratch(self.points), (np.zeros(self.count), np.zeros(len(self.data.trial_and_test_basis)))
        return ReducedWork(sampled, scratch(self.all_points, sampled.history), newton_scratch(self.count), *forces)

    def force(self, coordinates: Floats, history: History = (), work: ReducedWork | None = None) -> Floats:
        """Return the internal forces on the coordinates, -dE/da, shape (m + l,).

        Relaxing tissue responds to the change since its history variables, by default those at rest, as to
        an instantaneous one.
        """
        work = self.workspace() if work is None else work
        restore_history(work.coordinates.history, history)
        return self._instant_force(coordinates, work)

    def _instant_force(self, coordinates: Floats, work: ReducedWork) -> Floats:
        """Return the forces on the coordinates for the history variables in a workspace."""
        a = np.ascontiguousarray(coordinates, dtype=float)
        self.sampled.force(a, self.points, work.coordinates, work.force)
        return work.force.copy()

    def all_forces(self, coordinates: Floats, history: History = (), work: ReducedWork | None = None) -> Floats:
        """Return the internal forces on the trial and test basis, shape (m + l + 3 g + w,)."""
        work = self.workspace() if work is None else work
        restore_history(work.all.history, history)
        padded = np.zeros(len(self.data.trial_and_test_basis))
        padded[: self.count] = coordinates
        self.sampled.force(padded, self.all_points, work.all, work.all_forces)
        return work.all_forces.copy()

    def energy(self, coordinates: Floats, history: History = (), work: ReducedWork | None = None) -> float:
        """Return the strain energy [J] of coordinates (m + l,)."""
        work = self.workspace() if work is None else work
        restore_history(work.coordinates.history, history)
        a = np.ascontiguousarray(coordinates, dtype=float)
        return float(self.sampled.energy(a, self.points, work.coordinates))

    def stiffness(
        self,
        coordinates: Floats,
        history: History = (),
        work: ReducedWork | None = None,
        points: CubaturePoints | None = None,
    ) -> Floats:
        """Return the tangent -d(force)/d(coordinates), shape (m + l, m + l), by default of `points`."""
        work = self.workspace() if work is None else work
        restore_history(work.coordinates.history, history)
        matrix = np.zeros((self.count, self.count))
        a, vectors = np.ascontiguousarray(coordinates, dtype=float), np.zeros((3, self.count))
        chosen_points = self.points if points is None else points
        self.tangent(a, self.constants.differences, chosen_points, work.coordinates, vectors, self.count, matrix)
        return matrix

    def highest_frequency(
        self,
        coordinates: Floats,
        prescribed: bool = True,
        history: History = (),
        work: ReducedWork | None = None,
    ) -> float:
        """Return the highest frequency [rad/s], with the lifting coordinates prescribed or free."""
        moving = slice(self.data.modes if prescribed else None)
        tangent = self.stiffness(coordinates, history, work, self.tension_compression_points)[moving, moving]
        if not np.isfinite(tangent).all():
            return np.inf
        inverse_mass = self.constrained_inverse_mass if prescribed else self.inverse_mass
        return float(np.sqrt(np.abs(np.linalg.eigvals(inverse_mass @ tangent)).max()))

    def frequencies(self, coordinates: Floats | None = None) -> Floats:
        """Return the circular frequencies [rad/s] of the modes with the tools fixed, in ascending order.

        They are those at rest by default, and NaN where the body is unstable.
        """
        modes = slice(self.data.modes)
        tangent = self.stiffness(np.zeros(self.count) if coordinates is None else coordinates)[modes, modes]
        squares = np.sort(np.linalg.eigvals(self.constrained_inverse_mass @ (0.5 * (tangent + tangent.T))).real)
        return np.sqrt(np.where(squares >= 0, squares, np.nan))

    def project(self, fields: Floats) -> Floats:
        """Return the coordinates (t, m + l) of the best approximations of fields (t, n, 3), in the mass norm."""
        flat = self.vectors.reshape(self.count, -1) * np.repeat(self.masses, 3)
        return np.asarray((fields.reshape(len(fields), -1) @ flat.T) @ self.inverse_mass)

    def history_after(
        self, coordinates: Floats, history: History, interval: float, work: ReducedWork | None = None
    ) -> History:
        """Return the history variables after a linear change over an interval [s] to coordinates (m + l,)."""
        work = self.workspace() if work is None else work
        variables = work.coordinates.history
        return history_after(variables, history, interval, lambda: self._instant_force(coordinates, work))

    def equilibrium_history(self, coordinates: Floats, work: ReducedWork | None = None) -> History:
        """Return the history variables at equilibrium; empty without relaxation."""
        work = self.workspace() if work is None else work
        return equilibrium_history(work.coordinates.history, lambda: self._instant_force(coordinates, work))


def reduced_body(data: ReducedData, single: bool = True) -> ReducedBody:
    """Return the body of a reduced model from its data."""
    count, modes, vectors = data.basis.count, data.basis.modes, data.basis.vectors
    law, coefficients = material_point(
        data.tissue.material, data.kinematics, data.tissue.fibres, data.tissue.regions is not None
    )
    flat, masses = vectors.reshape(len(vectors), -1), data.volumes * data.tissue.material.density
    all_mass = (flat * np.repeat(masses, 3)) @ flat.T
    mass = np.ascontiguousarray(all_mass[:count, :count])
    sizes = np.linalg.norm(vectors[:count], axis=2).max(axis=1)
    compiled = sampled_energy(law, single)
    all_points, points = (points_of(data, np.arange(size), coefficients, single) for size in (len(flat), count))
    constants = ReducedConstants(
        stiffness_damping=data.stiffness_damping,
        mass_damping=data.mass_damping,
        mass=mass,
        inverse_mass=np.asarray(np.linalg.inv(mass), dtype=float),
        constrained_inverse_mass=np.asarray(np.linalg.inv(mass[:modes, :modes]), dtype=float),
        differences=DIFFERENCE_STEP * data.cloud.spacing / sizes,
        cubature_points=points,
    )
    return ReducedBody(
        data=data,
        law=law,
        coefficients=coefficients,
        single=single,
        masses=masses,
        all_mass=all_mass,
        constants=constants,
        sizes=sizes,
        all_points=all_points,
        tension_compression_points=points._replace(families=tension_compression_fibres(points.families)),
        surface=data.surface,
        sampled=compiled,
        tangent=tangent_function(law, single),
    )


def points_of(
    data: ReducedData, which: NDArray[np.int64], coefficients: tuple[float, ...], single: bool
) -> CubaturePoints:
    """Return the cubature points of a reduced model for a subset of its basis vectors."""
    rule, tissue, sampled = data.cubature, data.tissue, data.sampled
    law = coefficients if tissue.regions is None else tissue.regions.at(rule.nodes)
    return cubature_points(
        np.ascontiguousarray(sampled.gradients[:, which]), rule.weights, rule.pressure,
        sampled.constant[np.ix_(which, which)], law, np.float32 if single else np.float64,
        relaxation(tissue.material), tissue.fibres and tissue.fibres.of(rule.nodes),
    )  # fmt: skip
