"""Solids: equations of motion collocated at every node (sections 2.1 and 2.2, equations 1 to 8)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from palpate.arrays import Floats
from palpate.describe import Fact
from palpate.dynamics.compiled.passes import smooth_field
from palpate.dynamics.contact.tools import Contact
from palpate.dynamics.loads.prepared import Load, PreparedLoads, listed, prepare_loads
from palpate.dynamics.material.fibres import prepare_fibres
from palpate.dynamics.material.material_fields import regions_of
from palpate.dynamics.material.relaxation import equilibrium_history, restore_history, saved_history
from palpate.dynamics.nodal.model import NodalModel
from palpate.dynamics.nodal.stability import StabilityReport, choose_stiffness_damping, resting_frequency, stable_step
from palpate.dynamics.run.model import State
from palpate.dynamics.solid.layout import EnergyTissue, energy_passes, nodal_stiffness, strong_passes
from palpate.faults import InputError, integer_in_range, number_in_range
from palpate.meshfree.cloud import Cloud
from palpate.meshfree.consistent import consistent_stencils
from palpate.meshfree.patches import surface_patches
from palpate.meshfree.stencils import Stencils, moving_least_squares
from palpate.tissue.fibres import FibreLaw
from palpate.tissue.materials import Material

__all__ = ["Solid"]


ENERGY_DAMPING = 0.1  # default stiffness damping of the energy form, times its highest frequency
RECOVERY_NEIGHBOURS = 57  # points of the fit of the recovered pressure
NEIGHBOURS = (42, 50, 63)  # default points in a stencil; the energy form tries them in turn
CRUSHED_DILATATION = -0.6  # dilatation below which the energy balance of steps is checked
MAX_ENERGY_ERROR = 1e-3  # largest energy error of such steps, relative to the energy


class Solid(NodalModel):
    """A hyperelastic solid with equations of motion collocated at the nodes.

    Parameters
    ----------
    cloud : Cloud
        In space (d = 3).
    material : Material, or mapping of str to Material, or sequence of n Materials
        One material for the body. The energy form supports materials of one law with different
        parameters by group (``""`` for all other nodes) or by node. A node's share of the volume has
        the node's material, so interfaces are midway between nodes.
    fixed : str or sequence of str
        Clamped groups (equation 5); none for a free body.
    stiffness_damping : float, optional [s]
        Rayleigh stiffness damping beta of C = beta K in (29). By default it follows from the spectrum
        of the linearised body (`palpate.dynamics.nodal.stability`).
    form : str
        ``"strong"``: the equations of motion are collocated at the nodes, as in the paper.
        ``"energy"``: the nodal forces are the derivative of an energy summed over nodes
        (`palpate.dynamics.solid.energy_form`). It conserves energy, requires no damping, and is more
        accurate in bending. Hyper-reduction samples the same sum.
    stiffness : mapping of str to float, or (n,) array, optional
        Stiffness factors of groups or of all nodes, in the energy form, such as a tumour in a liver.
    pressure : str
        Pressure of the strong form. ``"split"``: the pressure is smoothed and differentiated
        separately, which neither locks nor loses stability up to a Poisson's ratio of 0.499.
        ``"direct"``: all terms are differentiated directly, for comparison.
    half_cell : float
        The c in the balance of a boundary node, rho a = Div P + c/h (f_s - P N). The half cell itself
        has c = 2. The default c = 3 cancels the leading error of one-sided quadratic fits (for u = z^3
        it is (6 - 2 c) h) and is more accurate in bending.
    neighbours : int, optional
        Target number of points in a stencil. By default 42; the energy form tries 50 and 63 where 42
        are too few, as in a thin tip.
    smoothing : int
        Target number of points of the linear fit that smooths the pressure.
    fibres : FibreLaw, optional
        Fibre reinforcement in the energy form (`palpate.materials.Fibres`, `palpate.materials.Guccione`).

    Raises
    ------
    InputError
        A group is unknown or a parameter is out of range.
    CloudError
        The cloud does not admit the stencils.
    """

    name = "full"

    def __init__(
        self,
        cloud: Cloud,
        material: Material | Mapping[str, Material] | Sequence[Material],
        fixed: str | Sequence[str] = (),
        *,
        form: str = "strong",
        stiffness_damping: float | None = None,
        stiffness: Mapping[str, float] | Floats | None = None,
        pressure: str = "split",
        half_cell: float = 3.0,
        neighbours: int | None = None,
        smoothing: int = 27,
        fibres: FibreLaw | None = None,
    ) -> None:
        if cloud.points.shape[1] != 3:
            raise InputError("cloud of Solid must be in space (d = 3), got a plane cloud; use Membrane")
        material, self.regions = regions_of(material, cloud)
        if material.incompressible or (self.regions and any(each.incompressible for each in self.regions.materials)):
            raise InputError("material of Solid must be compressible, got poisson = 0.5; use at most 0.499")
        if pressure not in ("split", "direct"):
            raise InputError(f"pressure must be 'split' or 'direct', got {pressure!r}")
        self.cloud = cloud
        self.material = material
        self.fixed = (fixed,) if isinstance(fixed, str) else tuple(fixed)
        if form not in ("strong", "energy"):
            raise InputError(f"form must be 'strong' or 'energy', got {form!r}")
        if material.prony is not None and (form != "energy" or material.variables == "small strain"):
            raise InputError("prony of the material must be None; relaxation requires form='energy' and finite strain")
        self._stiffness = nodal_stiffness(cloud, stiffness)
        if len(self._stiffness) and form != "energy":
            raise InputError("stiffness must be None in the strong form; use form='energy'")
        if self.regions is not None and form != "energy":
            raise InputError("material must be one material in the strong form; use form='energy'")
        self.fibres = prepare_fibres(fibres, material, form, cloud.points)
        self.form, self.pressure, self.conservative = form, pressure, form == "energy"
        # the cloud's boundary vectors have c = 2, which the energy form includes by itself
        self.half_cell = 1.0 if self.conservative else number_in_range("half_cell", half_cell, 1.0, 4.0) / 2
        integer_in_range("smoothing", smoothing, 5)
        self._volumes = cloud.volumes
        self.smoothing: tuple[NDArray[np.int32], Floats] | None = None  # neighbours and weights of the energy form
        smoother = moving_least_squares(cloud.points, order=1, neighbours=smoothing, interpolating=False)
        if self.conservative:
            choices = NEIGHBOURS if neighbours is None else (neighbours,)
            self.neighbours, self.stencils, self._volumes, self._lattice = consistent_stencils(cloud, choices)
            tissue = EnergyTissue(material, self.regions, self._stiffness_factors(), self.lame, self.fibres)
            compiled, weights = energy_passes(cloud, tissue, self.stencils, smoother, self._volumes)
            self.smoothing = smoother.neighbours, weights
            self._compile(*compiled)
            self.stiffness_damping = 0.0
            highest = resting_frequency(self)
            used = number_in_range(
                "stiffness_damping",
                ENERGY_DAMPING / highest if stiffness_damping is None else stiffness_damping,
                0.0,
                unit="s",
            )
            step = stable_step(highest, used)
            self._set_stability(StabilityReport("energy form", None, 0.0, used, highest, step))
        else:
            self.neighbours = NEIGHBOURS[0] if neighbours is None else neighbours
            self.stencils = moving_least_squares(cloud.points, order=2, neighbours=self.neighbours)
            direct = pressure == "direct"
            self._compile(*strong_passes(cloud, material, self.stencils, smoother, self.half_cell, direct))
            # the second derivatives are in the lanes; gradients of nodal fields require the others only
            empty = np.zeros((0, 0))
            self.stencils = replace(self.stencils, second=empty[:, :, None], value=empty)
            self._set_stability(choose_stiffness_damping(self, stiffness_damping, self.neighbours))

    def _own_facts(self) -> list[Fact]:
        report = self.stability
        return [("form", self.form, ""), ("verdict", report.verdict, ""), ("stable step", report.step, "s")]

    @property
    def weights(self) -> Floats:
        """Weights [m^3] of the inner product of virtual work, shape (n,).

        In the energy form they are the `volumes`. In the strong form they are the cloud's volumes, times
        2/c at the boundary, where a traction is multiplied by c/h instead of the half cell's 2/h.
        """
        if self.conservative:
            return self.volumes
        weights = self.cloud.volumes.copy()
        weights[np.unique(self.cloud.face_nodes)] /= self.half_cell
        return weights

    @property
    def volumes(self) -> Floats:
        """Nodal volumes [m^3], shape (n,); in the energy form they integrate quadratic fields."""
        return self._volumes

    @property
    def elastic_volumes(self) -> Floats:
        """Nodal volumes [m^3] times the stiffness factors, the weights of energies, shape (n,)."""
        return self.volumes * self._stiffness if len(self._stiffness) else self.volumes

    @property
    def shear_volumes(self) -> Floats:
        """`elastic_volumes` times the ratio of nodal shear moduli to that of `material`, shape (n,)."""
        return self.elastic_volumes if self.regions is None else self.elastic_volumes * self.regions.modulus_ratio

    @property
    def bulk_volumes(self) -> Floats:
        """`elastic_volumes` times the ratio of nodal volumetric coefficients to `lame`, shape (n,)."""
        regions = self.regions
        return self.elastic_volumes if regions is None else self.elastic_volumes * regions.values("lame") / self.lame

    @property
    def lame(self) -> float:
        """Unit of the nodal volumetric coefficients [Pa]: the material's, or the largest."""
        return self.material.lame if self.regions is None else self.regions.lame

    def moduli(self, name: str) -> Floats:
        """Return a modulus of the material at every node, such as ``"shear_modulus"``, shape (n,)."""
        if self.regions is None:
            return np.full(len(self.cloud), float(getattr(self.material, name)))
        return self.regions.values(name)

    def _stiffness_factors(self) -> Floats:
        """Return factors (n, 3) of the law, of the hourglass residual and of the volume; empty if all are 1."""
        if self.regions is None and not len(self._stiffness):
            return np.zeros((0, 3))
        every = (self.elastic_volumes, self.shear_volumes, self.bulk_volumes)
        return np.ascontiguousarray(np.stack(every, axis=1) / self.volumes[:, None])

    def deformation_gradient(self, displacements: Floats) -> Floats:
        return self.stencils.gradient(displacements) + np.eye(3)

    def stress(self, displacements: Floats) -> Floats:
        F = self.deformation_gradient(displacements)
        if self.conservative:
            self.force(displacements)
            return np.array(self.work.flux[:, :9].reshape(-1, 3, 3).transpose(0, 2, 1))
        stress = self.material.stress(F)
        if self.pressure == "split":
            self.force(displacements)
            change = self.work.smooth - self.work.pressure
            stress = stress + change[:, None, None] * self.material.cofactor(F)
        return stress

    def recovered_pressure(self, displacements: Floats) -> Floats:
        """Return the pressure U'(J) [Pa] for display, shape (n,): a linear fit over about 57 nodes.

        It is positive for expansion. In nearly incompressible tissue the pressure in `stress` alternates
        between nodes, without effect on forces. Figures are in docs/incompressibility.md.
        """
        self.force(displacements)
        if self.conservative:
            pressure = self.lame * self.work.pressure
        else:
            pressure = self.work.smooth if self.pressure == "split" else self.work.pressure
        return self._recovery.fit(pressure)

    @cached_property
    def _recovery(self) -> Stencils:
        return moving_least_squares(self.cloud.points, order=1, neighbours=RECOVERY_NEIGHBOURS, interpolating=False)

    def shear_stress(self, F: Floats, nodes: Any = slice(None)) -> Floats:
        """Return the stress [Pa] without the bulk pressure for deformation gradients (k, 3, 3) at nodes."""
        stress = self.material.shear_stress(F) if self.regions is None else self.regions.at(nodes).shear_stress(F)
        return stress if self.fibres is None else stress + self.fibres.of(nodes).stress(F)

    def strain_energy(self, displacements: Floats) -> float:
        if self.conservative:
            return float(self.volumes @ self._energy_density(displacements))
        return float(np.sum(self.volumes * self.material.strain_energy(self.deformation_gradient(displacements))))

    def _energy_density(self, displacements: Floats) -> Floats:
        """Return the nodal energy density [J/m^3] of the energy form, shape (n,)."""
        self.force(displacements)
        F = self.deformation_gradient(displacements)
        shear = (self.regions or self.material).shear_energy(F)
        if self.fibres is not None:
            shear += self.fibres.energy(F)
        every = (self.elastic_volumes, self.shear_volumes, self.bulk_volumes)
        law, modulus, bulk = (volumes / self.volumes for volumes in every)
        hourglass = np.sum(self.work.flux[:, 9:] ** 2, axis=1) / (2 * self.body.hourglass * modulus)
        density = np.asarray(law * shear + bulk * self.lame / 2 * self.work.smooth**2 + hourglass)
        if self.material.prony is not None:
            history = self.work.history
            density += modulus * history.energy.ravel()[self.slot] + bulk * self.lame * history.volume_energy
        return density

    def _equilibrium_history(self, displacements: Floats) -> tuple[Floats, ...]:
        return equilibrium_history(self.work.history, lambda: self.force(displacements)) if self.conservative else ()

    def _restore_history(self, state: State | None) -> None:
        if self.conservative:
            restore_history(self.work.history, () if state is None else state.history)

    def _saved_history(self) -> tuple[float, tuple[Floats, ...]]:
        if self.material.prony is None:
            return 0.0, ()
        history = self.work.history
        shear, volume = history.lost.ravel()[self.slot], self.lame * history.volume_lost
        return float(self.shear_volumes @ shear + self.bulk_volumes @ volume), saved_history(history)

    def smooth(self, values: Floats) -> Floats:
        """Return nodal values (n,) smoothed like the volumetric measure of the energy form."""
        body, work, result = self.body, self.work, np.empty(len(self.cloud))
        own = np.ascontiguousarray(values, dtype=float)
        smooth_field(body.smoothing, body.value, body.smoothing_own, work.fields, work.derivatives, own, result)
        return result

    def smooth_transposed(self, weights: Floats) -> Floats:
        """Return the transposed smoothing (k, n) of rows: w' . x = w . smooth(x) for all x."""
        body, work, result = self.body, self.work, np.empty_like(weights)
        for row, into in zip(weights / self.volumes, result, strict=True):
            smooth_field(
                body.transposed_smoothing, body.transposed_value, body.smoothing_own, work.fields, work.derivatives,
                np.ascontiguousarray(row), into,
            )  # fmt: skip
        return result * self.volumes

    def cauchy_stress(self, displacements: Floats) -> Floats:
        """Return the Cauchy stress [Pa] at every node, shape (n, 3, 3)."""
        F = self.deformation_gradient(displacements)
        return self.stress(displacements) @ np.swapaxes(F, 1, 2) / np.linalg.det(F)[:, None, None]

    def advance(self, state: State, prepared: PreparedLoads, step: float, steps: int) -> State:
        if self.conservative:
            self.work.least[0] = 0.0
        return super().advance(state, prepared, step, steps)

    def accept_step(self, before: State, after: State) -> bool:
        """Return True to accept the last steps, False if their energy balance has an error.

        Strongly compressed tissue can stiffen so fast that a step, stable at its estimate, becomes
        unstable. The balance is checked in the energy form, after steps with such tissue only.
        """
        if not super().accept_step(before, after):
            return False
        if not self.conservative or self.work.least[0] > CRUSHED_DILATATION:
            return True
        with np.errstate(all="ignore"):  # an unstable body
            first, last = (self._energy(state) for state in (before, after))
        given = after.external_work - before.external_work - (after.dissipated - before.dissipated)
        return bool(abs(last - first - given) <= MAX_ENERGY_ERROR * max(first, last))  # False for NaN

    def _energy(self, state: State) -> float:
        """Return the kinetic and strain energy [J] of a state."""
        self._restore_history(state)
        return float(0.5 * self.masses @ np.sum(state.velocities**2, axis=1)) + self.strain_energy(state.coordinates)

    def prepare(self, loads: Sequence[Load]) -> PreparedLoads:
        loads = listed(loads)
        in_contact = self.conservative and any(isinstance(load, Contact) for load in loads)
        return prepare_loads(self.cloud, self.fixed, loads, patches=self.patches if in_contact else None)

    @cached_property
    def patches(self) -> sparse.csr_array:
        """Weights (n, n) of the nodal displacements in those of the contact patches of the energy form."""
        return surface_patches(self.cloud, lattice=self._lattice)
