"""The full model: equations of motion collocated at every node (sections 2.1 and 2.2, equations 1 to 8)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numba
import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from palpate.arrays import Floats
from palpate.describe import Fact
from palpate.dynamics.compiled.lanes import lane_table, transpose
from palpate.dynamics.compiled.passes import smooth_field
from palpate.dynamics.contact.tools import Contact
from palpate.dynamics.loads.prepared import Load, PreparedLoads, listed, prepare_loads
from palpate.dynamics.material.fibres import fibre_points, lay_out_fibres, prepare_fibres
from palpate.dynamics.material.material_fields import EVERYWHERE, regions_of, spread
from palpate.dynamics.material.relaxation import equilibrium_history, relaxation, restore_history, saved_history
from palpate.dynamics.nodal.model import NodalModel
from palpate.dynamics.nodal.stability import StabilityReport, choose_stiffness_damping, resting_frequency, stable_step
from palpate.dynamics.run.model import State
from palpate.dynamics.solid.energy_form import EnergyBody, energy_work, solid_energy
from palpate.dynamics.solid.strong_form import Body, solid, workspace
from palpate.faults import InputError, integer_in_range, number_in_range
from palpate.meshfree.cloud import Cloud
from palpate.meshfree.consistent import consistent_stencils
from palpate.meshfree.patches import surface_patches
from palpate.meshfree.quadrature import conservative_smoothing
from palpate.meshfree.stencils import Stencils, moving_least_squares
from palpate.tissue.fibres import FibreLaw
from palpate.tissue.materials import Material

__all__ = ["Solid"]


DAMPING = 0.1  # viscosity of the energy form times its highest frequency
HOURGLASS = 1.0  # modulus of what a fit misses, in shear moduli over the spacing squared
RECOVERY = 57  # points over which a pressure that is shown is fitted
NEIGHBOURS = (42, 50, 63)  # in a stencil by default, and where these do not do
CRUSHED, MADE = -0.6, 1e-3  # dilatation below which steps are examined; energy that these may make, of what there is


class Solid(NodalModel):
    """A hyperelastic body, its equations of motion collocated at the nodes.

    Parameters
    ----------
    cloud : Cloud
        In space (d = 3).
    material : Material, or mapping of str to Material, or sequence of n Materials
        One for the body, or, in the energy form, materials of one law with other parameters by group (``""`` is
        everywhere else) or by node. A node's share of the volume is of its own material: interfaces lie midway between
        nodes.
    fixed : str or sequence of str
        Groups that are held (equation 5); none leaves the body free.
    stiffness_damping : float, optional [s]
        Rayleigh stiffness damping beta of C = beta K in (29). By default it is chosen from the spectrum of the
        linearised body: see `palpate.dynamics.nodal.stability`.
    form : str
        ``"strong"``: the equations of motion are collocated at the nodes, as the paper does. ``"energy"``: the nodal
        forces are the derivative of an energy summed over nodes (`palpate.dynamics.solid.energy_form`). It conserves
        energy, needs no damping, and bends more accurately; hyper-reduction samples the same sum.
    stiffness : mapping of str to float, or (n,) array, optional
        Of the energy form: how many times stiffer than the law the tissue of some groups, or of every node, is (a
        tumour in a liver).
    pressure : str
        Of the strong form. ``"split"``: the pressure is smoothed and differentiated by itself, which neither locks nor
        loses stability up to a Poisson's ratio of 0.499. ``"direct"``: everything is differentiated directly, for
        comparison.
    half_cell : float
        The c in the balance of a boundary node, rho a = Div P + c/h (f_s - P N). The half cell itself has c = 2; c = 3
        cancels the leading error of one-sided quadratic fits (for u = z^3 it is (6 - 2 c) h) and bends truer.
    neighbours : int, optional
        Wished number of points in a stencil. By default 42; in the energy form 50 or 63 where fewer do not do, as in a
        thin tip.
    smoothing : int
        Wished number of points over which the pressure is smoothed by a linear fit.
    fibres : FibreLaw, optional
        What reinforces the material (`palpate.materials.Fibres`, `palpate.materials.Guccione`); of the energy form.

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
            raise InputError("Solid needs a cloud in space; this one is plane")
        material, self.regions = regions_of(material, cloud)
        if material.incompressible or (self.regions and any(each.incompressible for each in self.regions.materials)):
            raise InputError("Solid needs a compressible material: poisson at most 0.499, not 0.5")
        if pressure not in ("split", "direct"):
            raise InputError(f"pressure = {pressure!r}: allowed are 'split' and 'direct'")
        self.cloud = cloud
        self.material = material
        self.fixed = (fixed,) if isinstance(fixed, str) else tuple(fixed)
        if form not in ("strong", "energy"):
            raise InputError(f"form = {form!r}: allowed are 'strong' and 'energy'")
        if material.prony is not None and (form != "energy" or material.variables == "small strain"):
            raise InputError("tissue that relaxes (prony=) needs form='energy' and a law of finite strain")
        self._stiffness = _nodal_stiffness(cloud, stiffness)
        if len(self._stiffness) and form != "energy":
            raise InputError("a stiffness of its own at some nodes needs form='energy'")
        if self.regions is not None and form != "energy":
            raise InputError("other materials in other places need form='energy'")
        self.fibres = prepare_fibres(fibres, material, form, cloud.points)
        self.form, self.pressure, self.conservative = form, pressure, form == "energy"
        # the cloud's boundary vectors are those of the half cell, c = 2, which the energy form has by itself
        self.half_cell = 1.0 if self.conservative else number_in_range("half_cell", half_cell, 1.0, 4.0) / 2
        integer_in_range("smoothing", smoothing, 5)
        self._volumes = cloud.volumes
        self.smoothing: tuple[NDArray[np.int32], Floats] | None = None  # neighbours and weights, of the energy form
        smoother = moving_least_squares(cloud.points, order=1, neighbours=smoothing, interpolating=False)
        if self.conservative:
            choices = NEIGHBOURS if neighbours is None else (neighbours,)
            self.neighbours, self.stencils, self._volumes, self._lattice = consistent_stencils(cloud, choices)
            self._prepare_energy(smoother)
            self.stiffness_damping = 0.0
            highest = resting_frequency(self)
            used = number_in_range(
                "stiffness_damping",
                DAMPING / highest if stiffness_damping is None else stiffness_damping,
                0.0,
                unit="s",
            )
            step = stable_step(highest, used)
            self._examined(StabilityReport("the energy's slope", None, 0.0, used, highest, step))
        else:
            self.neighbours = NEIGHBOURS[0] if neighbours is None else neighbours
            self.stencils = moving_least_squares(cloud.points, order=2, neighbours=self.neighbours)
            self._prepare_strong(smoother)
            self._examined(choose_stiffness_damping(self, stiffness_damping, self.neighbours))

    def _own_facts(self) -> list[Fact]:
        report = self.stability
        return [("form", self.form, ""), ("verdict", report.verdict, ""), ("stable step", report.step, "s")]

    def _prepare_strong(self, smoother: Stencils) -> None:
        """Lay out the passes of the strong form."""
        cloud, material = self.cloud, self.material
        lanes, (first, second) = lane_table(
            self.stencils.neighbours, self.stencils.row, self.stencils.first, self.stencils.second
        )
        # the lanes hold the second derivatives now; what stays is for gradients of nodal fields
        nothing = np.zeros((0, 0))
        self.stencils = replace(self.stencils, second=nothing[:, :, None], value=nothing)
        smooth_lanes, (value,) = lane_table(smoother.neighbours, smoother.row, smoother.value)
        body = Body(
            lanes, first, second, smooth_lanes, value,
            np.ascontiguousarray(smoother.own[smoother.row]),
            np.ascontiguousarray(self.half_cell * cloud.boundary_vectors()[lanes.nodes].transpose(0, 2, 1)),
            material.coefficients,
            material.lame,
        )  # fmt: skip
        longest = int(max(np.diff(lanes.start).max(), np.diff(smooth_lanes.start).max()))
        work = workspace(len(cloud), len(lanes.nodes), longest, numba.config.NUMBA_NUM_THREADS)
        formulation = solid(material.law, self.pressure == "direct", material.volumetric)
        self._compile(formulation, body, work, lanes)

    def _prepare_energy(self, smoother: Stencils) -> None:
        """Lay out the passes of the energy form."""
        cloud, material = self.cloud, self.material
        row, first, misses = self.stencils.row, self.stencils.first, self.stencils.value
        lanes, (first_weights, hourglass_weights) = lane_table(self.stencils.neighbours, row, first, misses)
        both = np.concatenate([first, misses[:, :, None]], axis=2)[row]
        near, weights = transpose(self.stencils.neighbours, both, self._volumes)
        everyone = np.arange(len(cloud))
        carriers, (back,) = lane_table(near, everyone, weights)
        smoothing, own = conservative_smoothing(smoother, self._volumes)
        self.smoothing = smoother.neighbours, smoothing
        smooth_lanes, (value,) = lane_table(smoother.neighbours, everyone, smoothing)
        near, weights = transpose(smoother.neighbours, smoothing[:, :, None], self._volumes)
        back_lanes, (back_value,) = lane_table(near, everyone, weights)
        body = EnergyBody(
            lanes, first_weights, hourglass_weights, carriers, back, -both.sum(axis=1),
            smooth_lanes, value, own, back_lanes, back_value,
            material.coefficients if self.regions is None else spread(self.regions, lanes.nodes),
            self.lame, HOURGLASS * material.shear_modulus / cloud.spacing**2,
            relaxation(material), self._stiffnesses(), lay_out_fibres(self.fibres, lanes.nodes),
        )  # fmt: skip
        families = (lanes, smooth_lanes, back_lanes)
        longest = int(max(*(np.diff(family.start).max() for family in families), 4 * np.diff(carriers.start).max()))
        branches = len(body.relaxation.times)
        threads, form = numba.config.NUMBA_NUM_THREADS, material.volumetric
        work = energy_work(len(cloud), len(lanes.nodes), longest, threads, branches, form)
        varied = EVERYWHERE if self.regions is None else len(material.coefficients)
        self._compile(solid_energy(material.law, form, fibre_points(self.fibres), varied), body, work, lanes)

    @property
    def weights(self) -> Floats:
        """Weights [m^3] of the inner product, shape (n,), in which tractions do their true virtual work.

        The nodal volumes; at the boundary times 2/c, because the balance of a boundary node multiplies a traction by
        c/h and not by the half cell's 2/h. In the energy form the `volumes`.
        """
        if self.conservative:
            return self.volumes
        weights = self.cloud.volumes.copy()
        weights[np.unique(self.cloud.face_nodes)] /= self.half_cell
        return weights

    @property
    def volumes(self) -> Floats:
        """Nodal volumes [m^3], shape (n,): the cloud's; in the energy form those that integrate quadratic fields."""
        return self._volumes

    @property
    def elastic_volumes(self) -> Floats:
        """Nodal volumes [m^3] times the nodes' own stiffness, by which energies count, shape (n,)."""
        return self.volumes * self._stiffness if len(self._stiffness) else self.volumes

    @property
    def shear_volumes(self) -> Floats:
        """The same times the nodes' shear modulus over that of `material`, shape (n,)."""
        return self.elastic_volumes if self.regions is None else self.elastic_volumes * self.regions.modulus_ratio

    @property
    def bulk_volumes(self) -> Floats:
        """The same times the nodes' volumetric coefficient over `lame`, shape (n,)."""
        regions = self.regions
        return self.elastic_volumes if regions is None else self.elastic_volumes * regions.values("lame") / self.lame

    @property
    def lame(self) -> float:
        """What the nodes' volumetric coefficients count in [Pa]: the material's, or the largest."""
        return self.material.lame if self.regions is None else self.regions.lame

    def moduli(self, name: str) -> Floats:
        """Return a modulus of the material at every node, such as ``"shear_modulus"``, shape (n,)."""
        if self.regions is None:
            return np.full(len(self.cloud), float(getattr(self.material, name)))
        return self.regions.values(name)

    def _stiffnesses(self) -> Floats:
        """Stiffness (n, 3) of the law, of what stencils miss and of the volume; empty where all are 1 everywhere."""
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
        """Return the pressure U'(J) [Pa] as it is to be shown or read, shape (n,): a linear fit over about 57 nodes.

        In nearly incompressible tissue the pressure in `stress` alternates from node to node; forces do not feel that.
        Positive where the volume has grown. Figures are in docs/incompressibility.md.
        """
        self.force(displacements)
        if self.conservative:
            acting = self.lame * self.work.pressure
        else:
            acting = self.work.smooth if self.pressure == "split" else self.work.pressure
        return self._recovery.fit(acting)

    @cached_property
    def _recovery(self) -> Stencils:
        return moving_least_squares(self.cloud.points, order=1, neighbours=RECOVERY, interpolating=False)

    def shear_stress(self, F: Floats, nodes: Any = slice(None)) -> Floats:
        """Return the stress [Pa] without the pressure of the bulk term for deformation gradients (k, 3, 3) at nodes."""
        stress = self.material.shear_stress(F) if self.regions is None else self.regions.at(nodes).shear_stress(F)
        return stress if self.fibres is None else stress + self.fibres.of(nodes).stress(F)

    def strain_energy(self, displacements: Floats) -> float:
        if self.conservative:
            return float(self.volumes @ self._energy_density(displacements))
        return float(np.sum(self.volumes * self.material.strain_energy(self.deformation_gradient(displacements))))

    def _energy_density(self, displacements: Floats) -> Floats:
        """Energy [J/m^3] of the energy form at every node, shape (n,)."""
        self.force(displacements)
        F = self.deformation_gradient(displacements)
        shear = (self.regions or self.material).shear_energy(F)
        if self.fibres is not None:
            shear += self.fibres.energy(F)
        every = (self.elastic_volumes, self.shear_volumes, self.bulk_volumes)
        law, firm, bulk = (volumes / self.volumes for volumes in every)
        misses = np.sum(self.work.flux[:, 9:] ** 2, axis=1) / (2 * self.body.hourglass * firm)
        density = np.asarray(law * shear + bulk * self.lame / 2 * self.work.smooth**2 + misses)
        if self.material.prony is not None:
            history = self.work.history
            density += firm * history.energy.ravel()[self.slot] + bulk * self.lame * history.volume_energy
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
        """Return nodal values (n,) as the energy form smooths J - 1, or what its form has for it, to theta."""
        body, work, result = self.body, self.work, np.empty(len(self.cloud))
        own = np.ascontiguousarray(values, dtype=float)
        smooth_field(body.smoothing, body.value, body.smoothing_own, work.fields, work.derivatives, own, result)
        return result

    def smooth_transposed(self, weights: Floats) -> Floats:
        """Return w' with w'. x = w . smoothed(x) for all x, for each row w of `weights` (k, n)."""
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
        """Return whether the steps just taken made no energy.

        Tissue that is nearly crushed flat is so stiff that steps which were stable before no longer follow it. That
        is examined only in the energy form, and where there was such tissue in these steps.
        """
        if not super().accept_step(before, after):
            return False
        if not self.conservative or self.work.least[0] > CRUSHED:
            return True
        with np.errstate(all="ignore"):  # a body that flies apart
            first, last = (self._energy(state) for state in (before, after))
        given = after.external_work - before.external_work - (after.dissipated - before.dissipated)
        return bool(abs(last - first - given) <= MADE * max(first, last))  # false where one is not a number

    def _energy(self, state: State) -> float:
        """Kinetic and strain energy [J] of a state."""
        self._restore_history(state)
        return float(0.5 * self.masses @ np.sum(state.velocities**2, axis=1)) + self.strain_energy(state.coordinates)

    def prepare(self, loads: Sequence[Load]) -> PreparedLoads:
        loads = listed(loads)
        touched = self.conservative and any(isinstance(load, Contact) for load in loads)
        return prepare_loads(self.cloud, self.fixed, loads, patches=self.patches if touched else None)

    @cached_property
    def patches(self) -> sparse.csr_array:
        """Weights (n, n) of the nodes in the displacements of the patches that tools touch in the energy form."""
        return surface_patches(self.cloud, lattice=self._lattice)


def _nodal_stiffness(cloud: Cloud, given: Mapping[str, float] | Floats | None) -> Floats:
    """Stiffness (n,) of the nodes beside the law's; empty where it is the law's everywhere."""
    if given is None:
        return np.zeros(0)
    if isinstance(given, Mapping):
        stiffness = np.ones(len(cloud))
        for group, value in given.items():
            stiffness[cloud.group(group)] = number_in_range(f"stiffness[{group!r}]", value, 0.0, open_low=True)
        return stiffness
    stiffness = np.array(given, dtype=float)
    if stiffness.shape != (len(cloud),) or not np.all(np.isfinite(stiffness) & (stiffness > 0)):
        raise InputError(f"stiffness must be {len(cloud)} positive numbers, one a node, not of shape {stiffness.shape}")
    return stiffness
