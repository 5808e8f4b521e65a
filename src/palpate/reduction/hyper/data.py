"""What a reduced model is made of."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.arrays import Floats
from palpate.describe import Described
from palpate.dynamics.material.relaxation import relaxation
from palpate.meshfree.cloud import Cloud
from palpate.reduction.contact.compliance import NO_COMPLIANCE, SurfaceCompliance
from palpate.reduction.contact.surface import ContactSurface, contact_surface
from palpate.reduction.hyper.cubature import Cubature
from palpate.reduction.hyper.material_point import Kinematics
from palpate.reduction.hyper.sampled_energy import IntegrationPoints, integration_points
from palpate.tissue.fibres import FibreLaw
from palpate.tissue.materials import Material
from palpate.tissue.regions import Regions

__all__ = ["ReducedData"]


@dataclass(frozen=True)
class ReducedData(Described):
    """What a reduced model is made of, and what its file holds.

    Parameters
    ----------
    cloud : Cloud
    material : Material
    fixed : tuple of str
    driven : tuple of str
        Groups that tools hold.
    volumes : (n,) array [m^3]
        Nodal volumes of the mass.
    stiffness : (n,) array
        Of the nodes beside the law's; the weights of the samples hold it already.
    viscosity : float [s]
    fastest : float [m/s]
        About the speed of the fastest waves: a tool that jumps counts as no faster in the viscous forces.
    columns : (m + l + 3 g + w, n, 3) array
        Displacement fields: modes, lifting columns of the tools, and test fields: those of the g supports and of the w
        witnesses (`palpate.reduction.training.residual_fields`).
    modes : int
        How many of them are modes.
    lifted : int
        How many of them are lifting columns.
    cubature : Cubature
    gradients : (s, m + l + 3 g + w, 9) array
        Derivatives of the columns at the sampled nodes, row by row; those of the witnesses each times a factor.
    constant : (m + l + 3 g + w, m + l + 3 g + w) array
        Constant stiffness of what the stencils miss.
    trained : (t, m + l) array
        Coordinates of the training states.
    reach : float [m]
        Distance from the training states that counts as 1 in the trust number.
    witnesses : int
        How many of the columns are witnesses: the last ones.
    leeway : float [m]
        Imbalance at the witnesses that counts as 1 in the trust number.
    report : mapping
        What was measured in training.
    kinematics : Kinematics
        Whether the body is a solid or a membrane, and which.
    slack : float [rad/s]
        Highest frequency of a membrane in its training states: what is slack now may be as taut in a moment. 0 for
        solids.
    fibres : FibreLaw, optional
        With a direction for every node.
    dents : Dents, optional
        Compliance of the surface under tools, learnt from runs in which they touch the body.
    regions : Regions, optional
        Materials of the nodes where they are not all `material`.
    """

    cloud: Cloud
    material: Material
    fixed: tuple[str, ...]
    prescribed: tuple[str, ...]
    volumes: Floats
    stiffness: Floats
    stiffness_damping: float
    wave_speed: float
    basis_vectors: Floats
    modes: int
    lifted: int
    cubature: Cubature
    gradients: Floats
    constant: Floats
    trained: Floats
    distance_scale: float
    residual_fields: int = 0
    residual_scale: float = 1.0
    report: dict[str, Any] = field(default_factory=dict)
    kinematics: Kinematics = field(default_factory=Kinematics)
    taut_frequency: float = 0.0
    fibres: FibreLaw | None = None
    compliance: SurfaceCompliance | None = None
    regions: Regions | None = None

    @property
    def surface(self) -> ContactSurface:
        """The surface that tools touch; empty for a model without contact."""
        return contact_surface(
            self.compliance or NO_COMPLIANCE, self.cloud.points, self.basis_vectors[: self.modes + self.lifted]
        )

    def integration_points(
        self, which: NDArray[np.int64], coefficients: tuple[float, ...], single: bool
    ) -> IntegrationPoints:
        """Lay the samples of some columns out."""
        rule = self.cubature
        law = coefficients if self.regions is None else self.regions.at(rule.nodes)
        return integration_points(
            np.ascontiguousarray(self.gradients[:, which]), rule.weights, rule.pressure,
            self.constant[np.ix_(which, which)], law, np.float32 if single else np.float64,
            relaxation(self.material), self.fibres and self.fibres.of(rule.nodes),
        )  # fmt: skip

    def stress(self, F: Floats) -> Floats:
        """Return the first Piola-Kirchhoff stress [Pa] for deformation gradients (n, 3, 3) at the nodes."""
        stress = (self.regions or self.material).stress(F) + (0.0 if self.fibres is None else self.fibres.stress(F))
        return np.asarray(self.stiffness[:, None, None] * stress)
