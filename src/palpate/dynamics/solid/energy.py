"""Solids in the energy form: the nodal forces are the derivative of an energy summed over the nodes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from palpate.compiled.passes import smooth_field
from palpate.core.arrays import Floats, Ints, sum_of_products
from palpate.core.faults import CloudError, InputError, number_in_range
from palpate.dynamics.contact.kinds import BLADE
from palpate.dynamics.contact.tools import Contact
from palpate.dynamics.loads.prepared import Load, PreparedLoads, listed, prepare_loads
from palpate.dynamics.nodal.energy_model import NO_FIELDS, EnergyModel, Fields, precision
from palpate.dynamics.nodal.model import History, NodalWork
from palpate.dynamics.nodal.stability import StabilityReport, resting_frequency, stable_step
from palpate.dynamics.run.model import Evaluation, Model, Outputs, State, StepReport
from palpate.dynamics.solid.base import STENCIL_SIZES, Choices, Solid
from palpate.dynamics.solid.cutting.blade_cut import cut_with_blade, steps_of_blade, with_pairs
from palpate.dynamics.solid.cutting.cut import detached_nodes, pieces_of, uncut_state
from palpate.dynamics.solid.cutting.layout import smoothing_of, stencils_of
from palpate.dynamics.solid.energy_form import NODE_NUMBERS, EnergyBody, body_in_single, work_in_single
from palpate.dynamics.solid.layout import Smoothing, energy_passes
from palpate.meshfree.consistent import consistent_gradient, consistent_stencils
from palpate.meshfree.cut.stencils import CutState
from palpate.meshfree.mirror import Images, mirror_images
from palpate.meshfree.patches import LATTICE_KERNEL, surface_patches
from palpate.meshfree.quadrature import conservative_smoothing, quadratic_residuals
from palpate.meshfree.stencils import Stencils

NEW_SURFACE = 1.5  # distance from removed nodes below which others are at the surface, in spacings
MIN_VOLUME_RATIO = 0.1  # of a node's cell in `moved`
DEFAULT_DAMPING = 0.1  # default stiffness damping, times the highest frequency
CRUSHED_DILATATION = -0.6  # dilatation below which the energy balance of steps is checked
MAX_ENERGY_ERROR = 1e-3  # largest energy error of such steps, relative to the energy
MIN_PRESSURE = 1e-3  # of the largest pressure in runs, below which a state has reduced weight


class EnergySolid(EnergyModel, Solid):
    """A solid in the energy form (`palpate.dynamics.solid.energy_form`).

    `volumes` (n,) [m^3] integrate quadratic fields. `smoothing` is that of the volumetric measure. `is_lattice` is True
    if the nodes were those of a lattice before they were moved (`Cloud.is_lattice`).
    """

    def _build(self, choices: Choices) -> None:
        if choices.half_cell is not None:
            raise InputError(
                f"half_cell must be left out in the energy form, got {choices.half_cell!r}; use form='strong'"
            )
        # the boundary vectors, which have c = 2, are a part of the energy
        self.half_cell = 1.0
        tried = STENCIL_SIZES if choices.neighbours is None else (choices.neighbours,)
        images = choices.images
        self.neighbours, stencils, volumes = consistent_stencils(images.cloud, tried)
        smoother = choices.smoother
        weights = conservative_smoothing(smoother.neighbours, smoother.value[smoother.row], volumes)
        smoothing = Smoothing(*images.folded(smoother.neighbours, *weights))
        volumes = volumes[: images.nodes] / images.copies
        self.is_lattice = self.cloud.is_lattice
        self._set_stability(self._lay_out(images, stencils, smoothing, volumes, choices.stiffness_damping))

    def _lay_out(
        self, images: Images, stencils: Stencils, smoothing: Smoothing, volumes: Floats, damping: float | None
    ) -> StabilityReport:
        """Set the weights of the energy, lay out the compiled passes, and return the report of the stable step."""
        self.smoothing, self.volumes = smoothing, volumes
        compiled, self.stencils = energy_passes(images, self.tissue, stencils, smoothing, volumes, self.is_lattice)
        self.mirror = compiled.body.mirror
        self._compile(*compiled)
        self.stiffness_damping = 0.0
        highest = resting_frequency(self)
        used = number_in_range(
            "stiffness_damping", DEFAULT_DAMPING / highest if damping is None else damping, 0.0, unit="s"
        )
        return StabilityReport("energy form", None, 0.0, used, highest, stable_step(highest, used))

    def moved(self, displacements: Floats) -> EnergySolid:
        """Return the body with stress-free nodes at other places, and the same neighbours, tissue and fibres.

        The displacements (n, 3) [m] from the present stress-free places to the new ones turn no cell inside out.
        Derivatives and volumes are those of this body by the chain rule, F = grad x (grad X)^-1: they change steadily
        with the places, so the shape that a load has deformed can be found by iteration.
        """
        if self._cut is not None or self.planes:
            raise InputError("model must have no cut and no planes of symmetry to be moved; cut it afterwards")
        cloud, gradient = self.cloud, self.deformation_gradient(displacements)
        slopes = np.asarray(np.linalg.inv(gradient), dtype=float)
        ratio = np.linalg.det(gradient)
        if not ratio.min() >= MIN_VOLUME_RATIO:
            flat = int(ratio.argmin())
            raise CloudError(f"the cell of node {flat} would have {ratio[flat]:.2g} times its volume", [flat])
        areas = ratio[cloud.face_nodes, None] * np.einsum(
            "mai,ma,m->mi", slopes[cloud.face_nodes], cloud.face_normals, cloud.face_areas
        )
        sizes = np.linalg.norm(areas, axis=1)
        result: EnergySolid = object.__new__(type(self))
        shared = "tissue", "material", "fibres", "supports", "mass_damping", "planes", "half_cell", "neighbours"
        for name in (*shared, "is_lattice"):
            setattr(result, name, getattr(self, name))
        result.cloud = cloud = replace(
            cloud, points=cloud.points + displacements, volumes=cloud.volumes * ratio,
            face_normals=areas / sizes[:, None], face_areas=sizes,
        )  # fmt: skip
        volumes, stencils = self.volumes * ratio, self.stencils.transformed(slopes)
        edges = cloud.boundary_vectors() * cloud.volumes[:, None]
        first = consistent_gradient(stencils, cloud.points, volumes, edges)
        misses = quadratic_residuals(stencils, cloud.points)
        stencils = replace(stencils, first=first, own_first=-first.sum(axis=1), value=misses)
        before = self.smoothing
        weights = conservative_smoothing(before.neighbours, before.weights, volumes)
        smoothing = Smoothing(before.neighbours, *weights)
        images = mirror_images(cloud, ())
        result._set_stability(result._lay_out(images, stencils, smoothing, volumes, self.stiffness_damping))
        return result

    @cached_property
    def step_body(self) -> EnergyBody:
        return body_in_single(self.body)

    def _step_work(self, passes: Any) -> Any:
        return work_in_single(self.body, passes)

    # a body that is cut computes these on first use

    @cached_property
    def stencils(self) -> Stencils:  # type: ignore[override]
        return stencils_of(self.body, len(self.cloud))

    @cached_property
    def smoothing(self) -> Smoothing:
        return smoothing_of(self.body, len(self.cloud))

    @cached_property
    def stability(self) -> StabilityReport:  # type: ignore[override]
        highest, damping = resting_frequency(self), self.stiffness_damping
        return StabilityReport("energy form", None, 0.0, damping, highest, stable_step(highest, damping))

    @property
    def pieces(self) -> Ints:
        return super().pieces if self._cut is None else pieces_of(self)

    @property
    def loose_nodes(self) -> Ints:
        """Nodes (l,) of pieces that a cut has parted from all supports, without those that are removed."""
        if self._cut is None or not self.supports:
            return np.zeros(0, dtype=np.int64)
        left_out = self._cut.released | self._cut.removed
        return np.flatnonzero(detached_nodes(self) & ~left_out)

    @property
    def shear_volumes(self) -> Floats:
        """`elastic_volumes` times the ratio of nodal shear moduli to that of `material`, shape (n,)."""
        regions = self.tissue.regions
        return self.elastic_volumes if regions is None else self.elastic_volumes * regions.modulus_ratio

    @property
    def bulk_volumes(self) -> Floats:
        """`elastic_volumes` times the ratio of nodal volumetric coefficients to the tissue's `lame`, shape (n,)."""
        regions, lame = self.tissue.regions, self.tissue.lame
        return self.elastic_volumes if regions is None else self.elastic_volumes * regions.values("lame") / lame

    def deformation_gradient(self, displacements: Floats) -> Floats:
        blocks, lanes = self.body.lanes.nodes.shape
        table, field = np.empty((blocks, 1, NODE_NUMBERS, lanes)), self.mirror.vectors(displacements)
        passes = self._allocate()
        self.formulation.differentiate(np.ascontiguousarray(field[None], dtype=float), self.body, passes, table)
        derivatives = table[:, 0, :9].transpose(0, 2, 1).reshape(-1, 3, 3)[self.slot]
        return np.asarray(derivatives + np.eye(3))

    def evaluate(self, displacements: Floats, history: History = (), work: NodalWork | None = None) -> Evaluation:
        work = self.workspace() if work is None else work
        force, passes = self.force(displacements, history, work), work.passes
        law, modulus, bulk = self.tissue.factors.T
        shear, lame = self.tissue.shear_energy(self.deformation_gradient(displacements)), self.tissue.lame
        hourglass = np.sum(passes.flux[: len(force), :, 3] ** 2, axis=1) / (2 * self.body.hourglass * modulus)
        density = np.asarray(law * shear + bulk * lame / 2 * passes.smooth**2 + hourglass)
        if self.material.prony is not None:
            branches = passes.history
            density += modulus * branches.energy.ravel()[self.slot] + bulk * lame * branches.volume_energy
        stress = np.array(passes.flux[: len(force), :, :3])
        return Evaluation(force, stress, lame * passes.pressure, density)

    def smooth(self, values: Floats) -> Floats:
        """Return nodal values (n,) smoothed like the volumetric measure."""
        sums, passes, result = self.body.smoothing, self._allocate(), np.empty(len(self.cloud))
        nodal_values = np.ascontiguousarray(values, dtype=float)
        smooth_field(sums.lanes, sums.weights, sums.own, passes.derivatives, nodal_values, result)
        return result

    def smooth_transposed(self, weights: Floats) -> Floats:
        """Return the transposed smoothing (k, n) of rows: w' . x = w . smooth(x) for all x."""
        sums, passes, result = self.body.smoothing, self._allocate(), np.empty_like(weights)
        for row, into in zip(weights / self.volumes, result, strict=True):
            smooth_field(
                sums.transposed, sums.transposed_weights, sums.own, passes.derivatives, np.ascontiguousarray(row), into
            )
        return result * self.volumes

    @property
    def rest_moduli(self) -> tuple[Floats, Floats]:
        shear = self.tissue.moduli("shear_modulus")
        return shear, self.tissue.moduli("shear_share") - 2 / 3 * shear

    def inner_product(self) -> Callable[[Floats], Floats]:
        matrix, mirror = self.stencils.products(self.volumes), self.mirror
        return lambda fields: np.stack([mirror.fold(matrix @ mirror.vectors(u)) for u in fields])

    def at_points(self, columns: Floats, even: slice = NO_FIELDS) -> Fields:
        n, count = len(self.cloud), len(columns)
        type_ = precision(n, count)
        gradients, residuals = np.empty((n, count, 9), dtype=type_), np.empty((count, 3 * n), dtype=type_)
        for m, by_node in enumerate(self._derivatives(columns, even)):
            gradients[:, m] = by_node[:, :9]
            residuals[m] = by_node[:, 9:].reshape(-1) * np.repeat(np.sqrt(self.shear_volumes), 3)
        constant = np.asarray(residuals @ residuals.T, dtype=float) * self.body.hourglass
        return Fields(columns, gradients, constant, np.arange(n), self.elastic_volumes)

    def shear_stress(self, F: Floats, nodes: NDArray[np.int64]) -> Floats:
        return self.tissue.shear_stress(F, nodes)

    def pressure_moments(self, displacements: Iterable[Floats], count: int) -> Floats:
        roots, work = np.sqrt(self.bulk_volumes), self.workspace()
        smooth = np.array([self.smoothed_measure(u, work) * roots for u in displacements])
        smooth = smooth[np.isfinite(smooth).all(axis=1)]
        if not len(smooth):
            raise InputError("trajectories must keep all volumes positive, got none that does; train on smaller loads")
        sizes = np.linalg.norm(smooth, axis=1)
        if not sizes.any():  # the volume is the same in all snapshots
            return np.zeros((0, len(self.cloud)))
        smooth /= np.sqrt(np.maximum(sizes, MIN_PRESSURE * sizes.max()))[:, None]
        _, values, shapes = np.linalg.svd(smooth, full_matrices=False)
        rank = min(count, int(np.sum(values > 1e-10 * values[0])))
        return np.asarray(np.sqrt(self.tissue.lame) * self.smooth_transposed(shapes[:rank] * roots))

    def smoothed_measure(self, displacements: Floats, work: NodalWork | None = None) -> Floats:
        """Return the smoothed volumetric measure g(J) at every node, shape (n,)."""
        work = self.workspace() if work is None else work
        self.force(displacements, work=work)
        return np.array(work.passes.smooth)

    def _least_dilatation(self, work: NodalWork) -> Floats:
        return np.asarray(work.passes.least)

    def _relaxed_energy(self, work: NodalWork) -> float:
        history = work.passes.history
        shear, volume = history.lost.ravel()[self.slot], self.tissue.lame * history.volume_lost
        return sum_of_products(self.shear_volumes, shear) + sum_of_products(self.bulk_volumes, volume)

    def accept_step(self, before: State, after: State, report: StepReport, work: Any = None) -> bool:
        """Return True to accept the last steps, False if their energy balance has an error.

        Strongly compressed tissue can stiffen so fast that a step, stable at its estimate, becomes
        unstable. The balance is checked after steps with such tissue only.
        """
        if not super().accept_step(before, after, report):
            return False
        if report.least_dilatation > CRUSHED_DILATATION:
            return True
        with np.errstate(all="ignore"):  # an unstable body
            first, last = (self._energy(state, work) for state in (before, after))
        error = last - first - (report.external_work - report.dissipated)
        return bool(abs(error) <= MAX_ENERGY_ERROR * max(first, last))  # False for NaN

    def _energy(self, state: State, work: NodalWork | None) -> float:
        """Return the kinetic and strain energy [J] of a state."""
        kinetic = 0.5 * sum_of_products(self.masses[:, None], state.velocities**2)
        held = state.contact_state.held_energy if state.contact_state is not None else 0.0
        return kinetic + self.strain_energy(state.coordinates, state.history, work) + held

    @cached_property
    def _uncut_state(self) -> CutState:
        return uncut_state(self)

    @property
    def cut_state(self) -> CutState:
        """The body's cut, and the stencils of the uncut body on which further cuts depend."""
        return self._uncut_state if self._cut is None else self._cut

    def outputs(self, state: State, prepared: PreparedLoads, work: NodalWork | None = None) -> Outputs:
        result = super().outputs(state, prepared, work)
        if state.cut_front is None:
            return result
        blade = np.append(state.cut_front.totals, state.cut_front.release_rate)
        return replace(result, blade=blade, cut_triangles=self.cut_surface.triangles)

    def most_steps(self, state: State, prepared: PreparedLoads, step: float) -> int:
        return min(super().most_steps(state, prepared, step), steps_of_blade(prepared, state, step, self.cloud.spacing))

    def after_steps(self, state: State, prepared: PreparedLoads) -> tuple[Model, State, PreparedLoads]:
        return cut_with_blade(self, state, prepared)

    def prepare(self, loads: Load | Sequence[Load]) -> PreparedLoads:
        loads = listed(loads)
        in_contact = any(isinstance(load, Contact) for load in loads)
        patches = self.patches if in_contact else None
        if self.planes and any(isinstance(load, Contact) and load.tool.kind == BLADE for load in loads):
            raise InputError("model of a Blade must have no planes of symmetry, got some; cut the complete body")
        prepared = self._press_supports(
            prepare_loads(
                self.cloud,
                self.supports,
                loads,
                patches=patches,
                removed=self.removed_nodes,
                edges=self.contact_edges if in_contact else None,
            )
        )
        return prepared if self._cut is None else with_pairs(self, prepared)

    def _touched_nodes(self) -> NDArray[np.int64]:
        nodes, removed = super()._touched_nodes(), self.removed_nodes
        if not len(removed):
            return nodes
        near = self.cut_state.uncut.tree.query_ball_point(self.cloud.points[removed], NEW_SURFACE * self.cloud.spacing)
        return np.setdiff1d(np.concatenate([nodes, *near]), removed).astype(np.int64)

    @cached_property
    def contact_edges(self) -> Ints:
        """Nodes (e, 2) of the edges of surface triangles at whose midpoints tools meet patches; a cut ends them."""
        corners = self.cloud.triangles
        pairs = np.unique(np.sort(np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])), axis=0)
        if self._cut is None:
            return pairs.astype(np.int64)
        stencils, node = self.stencils, pairs[:, 0]
        weighted = stencils.first[stencils.row[node]].any(axis=2)
        bonded = (weighted & (stencils.neighbours[node] == pairs[:, 1:])).any(axis=1)
        return pairs[bonded].astype(np.int64)

    @cached_property
    def patches(self) -> sparse.csr_array:
        """Weights (n, n) of the nodal displacements in those of the contact patches."""
        kernel = LATTICE_KERNEL if self.is_lattice else None  # also of one that was moved
        return surface_patches(self.cloud, kernel=kernel, cut=self.cut_surface)
