"""The full model: equations of motion collocated at every node (sections 2.1 and 2.2, equations 1 to 8)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numba
import numpy as np
from numpy.typing import NDArray

from palpate.dynamics.lanes import lane_table
from palpate.dynamics.loads import Drive, Load, drive
from palpate.dynamics.nodal import NodalModel
from palpate.dynamics.solid import Body, solid, workspace
from palpate.dynamics.stability import choose_viscosity
from palpate.faults import InputError, integer_in_range, number_in_range
from palpate.meshfree.cloud import Cloud
from palpate.meshfree.stencils import moving_least_squares
from palpate.tissue.materials import Material

__all__ = ["FullModel"]

Floats = NDArray[np.float64]


class FullModel(NodalModel):
    """A hyperelastic body, its equations of motion collocated at the nodes.

    Parameters
    ----------
    cloud : Cloud
        In space (d = 3).
    material : Material
    fixed : str or sequence of str
        Groups that are held (equation 5); none leaves the body free.
    viscosity : float, optional [s]
        Stiffness-proportional viscosity beta of C = beta K in (29). By default it is chosen from the spectrum of the
        linearised body: see `palpate.dynamics.stability`.
    pressure : str
        ``"split"``: the pressure is smoothed and differentiated by itself, which neither locks nor loses stability up
        to a Poisson's ratio of 0.499. ``"direct"``: everything is differentiated directly, for comparison.
    half_cell : float
        The c in the balance of a boundary node, rho a = Div P + c/h (f_s - P N). The half cell itself has c = 2; c = 3
        cancels the leading error of one-sided quadratic fits (for u = z^3 it is (6 - 2 c) h) and bends truer.
    neighbours : int
        Wished number of points in a stencil.
    smoothing : int
        Wished number of points over which the pressure is smoothed by a linear fit.

    Raises
    ------
    InputError
        An unknown group or a parameter out of range.
    CloudError
        The cloud cannot carry the stencils.
    """

    name = "full"
    conservative = False

    def __init__(
        self,
        cloud: Cloud,
        material: Material,
        fixed: str | Sequence[str] = (),
        *,
        viscosity: float | None = None,
        pressure: str = "split",
        half_cell: float = 3.0,
        neighbours: int = 42,
        smoothing: int = 27,
    ) -> None:
        if cloud.points.shape[1] != 3:
            raise InputError("FullModel needs a cloud in space; this one is plane")
        if material.incompressible:
            raise InputError("FullModel needs a compressible material: poisson at most 0.499, not 0.5")
        if pressure not in ("split", "direct"):
            raise InputError(f"pressure = {pressure!r}: allowed are 'split' and 'direct'")
        self.cloud = cloud
        self.material = material
        self.fixed = (fixed,) if isinstance(fixed, str) else tuple(fixed)
        self.pressure = pressure
        # the cloud's boundary vectors are those of the half cell, c = 2
        self.half_cell = number_in_range("half_cell", half_cell, 1.0, 4.0) / 2
        integer_in_range("smoothing", smoothing, 5)
        self.stencils = moving_least_squares(cloud.points, order=2, neighbours=neighbours)
        smoother = moving_least_squares(cloud.points, order=1, neighbours=smoothing, interpolating=False)
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
        law = type(material)
        self.neighbours = neighbours
        self._compile(solid(law.first, law.second, pressure == "direct"), body, work, lanes)
        self._examined(choose_viscosity(self, viscosity))

    @property
    def weights(self) -> Floats:
        """Weights [m^3] of the inner product, shape (n,), in which tractions do their true virtual work.

        The nodal volumes; at the boundary times 2/c, because the balance of a boundary node multiplies a traction by
        c/h and not by the half cell's 2/h.
        """
        weights = self.cloud.volumes.copy()
        weights[np.unique(self.cloud.face_nodes)] /= self.half_cell
        return weights

    @property
    def volumes(self) -> Floats:
        return self.cloud.volumes

    def deformation_gradient(self, displacements: Floats) -> Floats:
        return self.stencils.gradient(displacements) + np.eye(3)

    def stress(self, displacements: Floats) -> Floats:
        F = self.deformation_gradient(displacements)
        stress = self.material.stress(F)
        if self.pressure == "split":
            self.force(displacements)
            cofactor = np.linalg.det(F)[:, None, None] * np.swapaxes(np.linalg.inv(F), 1, 2)
            stress = stress + (self.work.smooth - self.work.pressure)[:, None, None] * cofactor
        return stress

    def strain_energy(self, displacements: Floats) -> float:
        return float(np.sum(self.volumes * self.material.strain_energy(self.deformation_gradient(displacements))))

    def cauchy_stress(self, displacements: Floats) -> Floats:
        """Return the Cauchy stress [Pa] at every node, shape (n, 3, 3)."""
        F = self.deformation_gradient(displacements)
        return self.stress(displacements) @ np.swapaxes(F, 1, 2) / np.linalg.det(F)[:, None, None]

    def drive(self, loads: Sequence[Load]) -> Drive:
        return drive(self.cloud, self.fixed, loads)
