"""A hyperelastic membrane: three displacements of every node of a plane sheet, without bending stiffness."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, ClassVar

import numba
import numpy as np
from numpy.typing import NDArray

from palpate.compiled.lanes import lane_table, transpose
from palpate.compiled.rows import Rows, row_table
from palpate.core.arrays import Floats, sum_of_products
from palpate.core.describe import Fact
from palpate.core.faults import InputError, number_in_range
from palpate.dynamics.loads.dead_load import DeadLoad
from palpate.dynamics.loads.prepared import Load, PreparedLoads, prepare_loads
from palpate.dynamics.loads.pressure import Pressure
from palpate.dynamics.loads.supports import Support, supports_of, symmetry_planes
from palpate.dynamics.material.fibres import lay_out_fibres, prepare_fibres
from palpate.dynamics.material.kinematics import Kinematics
from palpate.dynamics.material.relaxation import relaxation
from palpate.dynamics.material.tissue import TissueField
from palpate.dynamics.membrane.additional_stress import NO_ADDITIONAL_STRESS, AdditionalStress, additional_stress
from palpate.dynamics.membrane.passes import (
    NODE_POINTS,
    POINT_COSINES,
    POINT_RADIUS,
    POINT_SINES,
    SheetBody,
    sheet,
    sheet_work,
)
from palpate.dynamics.nodal.energy_model import NO_FIELDS, EnergyModel, Fields, precision
from palpate.dynamics.nodal.model import History, NodalWork
from palpate.dynamics.nodal.stability import StabilityReport, resting_frequency, stable_step
from palpate.dynamics.run.model import QUANTITY_UNITS, Evaluation
from palpate.meshfree.cloud import Cloud
from palpate.meshfree.consistent import consistent_gradient
from palpate.meshfree.stencils import Stencils, moving_least_squares
from palpate.tissue.fibres import FibreLaw
from palpate.tissue.materials import Material

MAX_FIBRE_TILT = 1e-6  # largest component of a fibre direction out of the plane
TAUT_STRAIN = 1e-3  # extension of the taut sheet for its highest frequency
DEFAULT_DAMPING = 0.1  # stiffness damping times the highest frequency


class Membrane(EnergyModel):
    """An incompressible membrane in plane stress.

    Nodal forces are the derivative of an energy summed over nodes, stable in every state of tension.

    Parameters
    ----------
    cloud : Cloud
        The mounted sheet in the plane z = 0 (d = 2). Displacements have three components.
    material : Material
        Incompressible, ``poisson=0.5``.
    thickness : float [m]
        Thickness of the stress-free sheet.
    fixed : str, Support, or sequence of these
        Clamped groups, and supports such as `Roller`; none for a free sheet.
    prestretch : float
        Stretch of the mounted sheet in both directions, at least 1.
    relaxed : bool
        True replaces compression by wrinkles (tension-field theory).
    stiffness_damping : float, optional [s]
        Rayleigh stiffness damping beta of C = beta K in (29). By default 0.1 over the highest
        frequency: waves as short as the spacing lose a tenth of their amplitude in a third of a period.
    mass_damping : float [1/s]
        As for `palpate.Solid`.
    neighbours : int
        Target number of points in a stencil; more soften the sheet.
    fibres : FibreLaw, optional
        Fibre reinforcement in the plane of the sheet, with ``relaxed=False``. The relaxed energy of a
        sheet with fibres is not implemented.

    Raises
    ------
    InputError
        The cloud is in space, the material compressible or linear elastic, a group unknown, or a
        parameter out of range.
    CloudError
        The cloud does not admit the stencils.

    Examples
    --------
    >>> import palpate as pt
    >>> rubber = pt.materials.NeoHookean(C1=0.17e6, density=1200, poisson=0.5)
    >>> sheet = pt.Membrane(pt.disc(0.1, spacing=0.02), rubber, thickness=1e-5, fixed="rim", prestretch=1.1)
    >>> sheet.name, sheet.stability.method
    ('full', 'taut sheet')
    """

    coupled_by: ClassVar[tuple[str, ...]] = ("transposed", "lanes")  # a sheet has no smoothing

    name = "full"
    _public = (
        "neighbours", "prestretch", "principal_stress", "principal_stretches", "relaxed", "tension", "thickness",
        "wrinkled_area",
    )  # fmt: skip

    def __init__(
        self,
        cloud: Cloud,
        material: Material,
        thickness: float,
        fixed: str | Support | Sequence[str | Support] = (),
        *,
        prestretch: float = 1.0,
        relaxed: bool = True,
        stiffness_damping: float | None = None,
        mass_damping: float = 0.0,
        neighbours: int = 14,
        fibres: FibreLaw | None = None,
    ) -> None:
        checked_fibres = _validated_fibres(cloud, material, relaxed, fibres)
        self.cloud, self.tissue = cloud, TissueField(material, None, np.zeros(0), checked_fibres, len(cloud))
        self.material, self.fibres = material, checked_fibres
        self.thickness = number_in_range("thickness", thickness, 0.0, open_low=True, unit="m")
        self.prestretch = number_in_range("prestretch", prestretch, 1.0, 10.0)
        self.supports = supports_of(fixed)
        if planes := symmetry_planes(cloud, self.supports):
            raise InputError(f"fixed of Membrane must hold no SymmetryPlane, got {planes[0].name!r}; use Roller")
        self.relaxed = bool(relaxed)
        self.kinematics = Kinematics(True, self.prestretch, self.relaxed)
        # the energy includes the mounted boundary vectors, which have c = 2
        self.half_cell = 1.0
        self.mass_damping = number_in_range("mass_damping", mass_damping, 0.0, unit="1/s")
        self.stiffness_damping = 0.0
        self.neighbours = neighbours
        self.stencils = moving_least_squares(cloud.points / self.prestretch, order=2, neighbours=neighbours)
        self._areas = cloud.volumes / self.prestretch**2
        self.volumes = self._areas * self.thickness
        body, longest = self._body()
        self._compile(
            sheet(type(material), self.relaxed, self._additional_stress()),
            body,
            partial(
                sheet_work,
                len(cloud),
                len(body.lanes.nodes),
                longest,
                numba.config.NUMBA_NUM_THREADS,
                len(body.relaxation.times),
            ),
            body.lanes,
        )
        self._history_at_rest = self.equilibrium_history(np.zeros((len(cloud), 3)))
        self._taut = resting_frequency(self, TAUT_STRAIN * self._in_space(cloud.points))
        chosen = DEFAULT_DAMPING / self._taut if stiffness_damping is None else stiffness_damping
        used = number_in_range("stiffness_damping", chosen, 0.0, unit="s")
        step = stable_step(self._taut, used)
        self._set_stability(StabilityReport("taut sheet", None, 0.0, used, self._taut, step))

    def _own_facts(self) -> list[Fact]:
        return [
            ("thickness", self.thickness, "m"),
            ("prestretch", self.prestretch, ""),
            ("wrinkles", self.relaxed, ""),
            ("stable step", self.stability.step, "s"),
        ]

    def _additional_stress(self) -> AdditionalStress:
        """Return the compiled additional stress of fibres and relaxation."""
        return additional_stress(self.fibres, self.material.prony is not None, self.relaxed)

    def _body(self) -> tuple[SheetBody, int]:
        """Lay out the stencils; return them with the largest number of neighbours in a pass."""
        cloud, stencils = self.cloud, self.stencils
        row, first, second, transposed = _weights(cloud, stencils, self._areas, self.prestretch)
        lanes, (first_weights, second_weights) = lane_table(stencils.neighbours, row, first, second)
        body = SheetBody(
            lanes=lanes,
            first=first_weights,
            second=second_weights,
            transposed=transposed,
            radius=POINT_RADIUS * np.sqrt(self._areas),
            coefficients=self.material.coefficients,
            prestretch=self.prestretch,
            relaxation=relaxation(self.material),
            families=lay_out_fibres(self.fibres, lanes.nodes),
        )
        return body, int(np.max(lanes.stop - lanes.start))

    @staticmethod
    def _in_space(points: Floats) -> Floats:
        """Append a zero third component to plane vectors, shape (n, 3)."""
        return np.column_stack([points, np.zeros(len(points))])

    def deformation_gradient(self, displacements: Floats) -> Floats:
        """Return F = dx/dX of the stress-free sheet at every node, (n, 3, 2), for displacements (n, 3) [m].

        It is that of the fit at the node. Forces and energy use six points around the node.
        """
        return self.stencils.gradient(displacements) + self.prestretch * np.eye(3, 2)

    def evaluate(self, displacements: Floats, history: History = (), work: NodalWork | None = None) -> Evaluation:
        """As `NodalModel.evaluate`; with fibres or relaxation the stress is the mean over the six points."""
        work = self.workspace() if work is None else work
        force, passes = self.force(displacements, history, work), work.passes
        if self._additional_stress() == NO_ADDITIONAL_STRESS:
            stress = self.stress_at(self.deformation_gradient(displacements))
        else:
            stress = np.array(passes.flux[:, :, :2])
        return Evaluation(force, stress, np.zeros(len(force)), passes.energy.copy())

    def _relaxed_energy(self, work: NodalWork) -> float:
        lost = work.passes.history.lost
        by_node = lost.reshape(-1, NODE_POINTS, lost.shape[1]).mean(axis=1).ravel()[self.slot]
        return sum_of_products(self.volumes, by_node)

    def stress_at(self, F: Floats) -> Floats:
        """Return the law's first Piola-Kirchhoff stress [Pa], (..., 3, 2), for gradients (..., 3, 2)."""
        stretches, directions = _principal(F)
        tensions = self._nominal(stretches)
        scaled = np.divide(tensions, stretches, out=np.zeros_like(tensions), where=stretches > 0)
        return np.asarray(F @ np.einsum("...la,...a,...ma->...lm", directions, scaled, directions))

    @property
    def rest_moduli(self) -> tuple[Floats, Floats]:
        """Those of the taut sheet."""
        shear = self.tissue.moduli("shear_modulus")
        return shear, np.zeros_like(shear)

    def inner_product(self) -> Callable[[Floats], Floats]:
        """Return A of the inner product of displacements: a slack sheet has no energy at rest."""
        return lambda fields: fields * self.volumes[:, None]

    def at_points(self, columns: Floats, even: slice = NO_FIELDS) -> Fields:
        """As `EnergyModel.at_points`; the third entry of every row of du/dX is 0."""
        n, count, points = len(self.cloud), len(columns), len(POINT_COSINES)
        gradients = np.zeros((points, n, count, 3, 3), dtype=precision(points * n, count))
        for m, by_node in enumerate(self._derivatives(columns, even)):
            first, second = by_node[:, :6].reshape(n, 3, 2), by_node[:, 6:].reshape(n, 3, 3)
            for q in range(points):
                x, y = (self.body.radius[:, None] * turn for turn in (POINT_COSINES[q], POINT_SINES[q]))
                gradients[q, :, m, :, 0] = first[:, :, 0] + second[:, :, 0] * x + second[:, :, 2] * y
                gradients[q, :, m, :, 1] = first[:, :, 1] + second[:, :, 2] * x + second[:, :, 1] * y
        nodes = np.tile(np.arange(n), points)
        flat = gradients.reshape(points * n, count, 9)
        return Fields(columns, flat, np.zeros((count, count)), nodes, self.volumes[nodes] / points)

    def shear_stress(self, F: Floats, nodes: NDArray[np.int64]) -> Floats:
        stress = np.zeros_like(F)
        stress[:, :, :2] = self.stress_at(F[:, :, :2] + (self.prestretch - 1) * np.eye(3, 2))
        return stress

    @property
    def quantities(self) -> tuple[str, ...]:
        return tuple(QUANTITY_UNITS)

    def cauchy_stress(self, displacements: Floats) -> Floats:
        """As `Model.cauchy_stress`: of a sheet that keeps its volume."""
        return np.asarray(self.stress(displacements) @ np.swapaxes(self.deformation_gradient(displacements), 1, 2))

    def principal_stretches(self, displacements: Floats) -> Floats:
        """Return the principal stretches at every node, the larger first, (n, 2), for displacements (n, 3) [m]."""
        return _principal(self.deformation_gradient(displacements))[0]

    def principal_stress(self, displacements: Floats) -> Floats:
        """Return the Cauchy stresses [Pa] along the principal stretches, (n, 2), for displacements (n, 3) [m]."""
        F = self.deformation_gradient(displacements)
        stretches, directions = _principal(F)
        if self._additional_stress() == NO_ADDITIONAL_STRESS:
            return np.asarray(self._nominal(stretches) * stretches)
        return np.asarray(np.sum((F @ directions) * (self.stress(displacements) @ directions), axis=1))

    def tension(self, displacements: Floats) -> NDArray[np.int8]:
        """Return 0 at slack, 1 at wrinkled and 2 at taut nodes, shape (n,), for displacements (n, 3) [m]."""
        stretches = self.principal_stretches(displacements)
        taut = stretches[:, 1] >= np.maximum(stretches[:, 0], 1.0) ** -0.5
        return np.where(taut, 2, np.where(stretches[:, 0] > 1.0, 1, 0)).astype(np.int8)

    def wrinkled_area(self, displacements: Floats) -> float:
        """Return the wrinkled area [m^2] of the mounted sheet for displacements (n, 3) [m]."""
        return float(self.cloud.volumes[self.tension(displacements) == 1].sum())

    def _nominal(self, stretches: Floats) -> Floats:
        """Return the principal nominal stresses [Pa], (..., 2), of principal stretches."""
        l1, l2 = stretches[..., 0], stretches[..., 1]
        if self.relaxed:
            l1 = np.maximum(l1, 1.0)
            l2 = np.maximum(l2, l1**-0.5)
        if self.material.variables == "stretches":
            l3 = 1 / (l1 * l2)
            w1, w2, w3 = self.material.first(l1, l2, l3, self.material.coefficients)
            return np.stack([w1 - w3 * l3 / l1, w2 - w3 * l3 / l2], axis=-1)
        t, D = l1**2 + l2**2, (l1 * l2) ** 2
        I1, I2 = t + 1 / D, D + t / D
        W1, W2, _ = self.material.first(I1, I2, np.ones_like(I1), self.material.coefficients)
        nominal = [2 * (W1 * (a - 1 / (a * D)) + W2 * (a * b**2 + (a - t / a) / D)) for a, b in ((l1, l2), (l2, l1))]
        return np.stack(nominal, axis=-1)

    def prepare(self, loads: Load | Sequence[Load]) -> PreparedLoads:
        areas = partial(load_areas, self.cloud, self.prestretch)
        return self._press_supports(prepare_loads(self.cloud, self.supports, loads, areas))

    def _step(self, frequency: float, prepared: PreparedLoads) -> float:
        # a slack region can become taut before the next estimate
        return super()._step(max(frequency, self._taut), prepared)


def _weights(
    cloud: Cloud, stencils: Stencils, areas: Floats, prestretch: float
) -> tuple[NDArray[np.integer[Any]], Floats, Floats, Rows]:
    """Return the rows of the nodes, the weights of first and second derivatives by row, and the transposed stencils.

    First derivatives are consistent.
    """
    edges = cloud.boundary_vectors() * cloud.volumes[:, None] / prestretch
    first = consistent_gradient(stencils, cloud.points / prestretch, areas, edges)
    row, second = np.arange(len(cloud), dtype=np.int32), stencils.second[stencils.row]
    both = np.concatenate([first, second], axis=2)
    near, weights = transpose(stencils.neighbours, both, areas)
    return row, first, second, row_table(near, row, weights, -both.sum(axis=1))


def _validated_fibres(cloud: Cloud, material: Material, relaxed: bool, fibres: FibreLaw | None) -> FibreLaw | None:
    """Check the arguments of a membrane; return its fibres with a direction at every node."""
    if cloud.points.shape[1] != 2:
        raise InputError("cloud of Membrane must be a plane cloud, got one in space; use disc or sheet")
    if not isinstance(material, Material):
        raise InputError(f"material of Membrane must be one material, got {material!r:.200}")
    if not material.incompressible:
        raise InputError(f"material of Membrane must be incompressible, got {material.poisson:g}; use poisson=0.5")
    if material.variables == "small strain":
        raise InputError("material of Membrane must be a law of large strains, got LinearElastic; use NeoHookean")
    if material.prony is not None and material.prony.bulk_shares:
        raise InputError("bulk_shares of a membrane's Prony series must be empty; its volume is constant")
    nodal_fibres = prepare_fibres(fibres, material, Membrane.form, cloud.points)
    if nodal_fibres is not None and relaxed:
        raise InputError("relaxed must be False for a sheet with fibres; use relaxed=False")
    if nodal_fibres is not None and np.abs(nodal_fibres.directions[..., 2]).max() > MAX_FIBRE_TILT:
        raise InputError("directions of fibres must be in the plane of the sheet; set their third component to 0")
    return nodal_fibres


def load_areas(cloud: Cloud, prestretch: float, load: DeadLoad | Pressure) -> Floats:
    """Return the area vectors (k, 3) of a load: of the face for a pressure, of an edge or the face for a force."""
    face = cloud.volumes[cloud.group(load.group), None] / prestretch**2 * [0.0, 0.0, 1.0]
    if isinstance(load, Pressure):
        return face
    try:
        return cloud.area_vectors(load.group)
    except InputError:
        return face


def _principal(F: Floats) -> tuple[Floats, Floats]:
    """Return the principal stretches (..., 2), the larger first, and their directions (..., 2, 2) as columns."""
    squares, directions = np.linalg.eigh(np.swapaxes(F, -1, -2) @ F)
    return np.sqrt(np.maximum(squares[..., ::-1], 0.0)), directions[..., ::-1]
