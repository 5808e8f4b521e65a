"""Data of a reduced model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from palpate.core.arrays import Floats
from palpate.core.describe import Described
from palpate.dynamics.loads.supports import Support
from palpate.dynamics.material.kinematics import Kinematics
from palpate.dynamics.material.relaxation import relaxation
from palpate.dynamics.material.tissue import TissueField
from palpate.meshfree.cloud import Cloud
from palpate.reduction.contact.compliance import NO_COMPLIANCE, SurfaceCompliance
from palpate.reduction.contact.surface import ContactSurface, contact_surface
from palpate.reduction.hyper.cubature import Cubature
from palpate.reduction.hyper.sampled_energy import IntegrationPoints, integration_points

UNLIMITED_SCALE = 1e300  # scale of a measure without training states


@dataclass(frozen=True)
class ReducedData(Described):
    """Data of a reduced model, and the content of its file."""

    cloud: Cloud
    tissue: TissueField  # the weights of the integration points include its stiffness factors
    supports: tuple[Support, ...]
    prescribed: tuple[str, ...]  # groups that rigid tools move
    volumes: Floats  # (n,) array [m^3]: nodal volumes of the mass
    stiffness_damping: float  # [s]: Rayleigh's beta
    # [m/s]: approximate speed of the fastest waves. It limits the velocity of a jumping tool in the damping
    # forces.
    wave_speed: float
    # (m + l + 3 g + w, n, 3) array: displacement fields: m modes, l lifting vectors of the tools, and test fields.
    # These are 3 for each of g supports, and w residual fields (`palpate.reduction.training.residual_fields`).
    basis_vectors: Floats
    modes: int  # number m of modes
    lifting_count: int  # number l of lifting vectors
    cubature: Cubature
    # (s, m + l + 3 g + w, 9) array: derivatives of the basis vectors at the integration points, row by row. Those of
    # the residual fields are multiplied by fitted factors.
    gradients: Floats
    constant: Floats  # (m + l + 3 g + w, m + l + 3 g + w) array: constant stiffness of the hourglass residual
    training_states: Floats  # (t, m + l) array: coordinates of the training states
    distance_scale: float  # [m]: distance from the training states at which the trust number is 1
    residual_fields: int = 0  # number w of residual fields, the last basis vectors
    residual_scale: float = 1.0  # [m]: residual norm at which the trust number is 1
    # share of the loads' static response outside the coordinates at which the trust number is 1
    load_scale: float = 0.3
    flexibility_scale: float = 1.0  # [J]: energy of the surface compliance at which the trust number is 1
    # [m/s]: touch speed of tools at which the trust number is 1; without a contact surface, root mean square
    # speed over the body
    speed_scale: float = UNLIMITED_SCALE
    # nearness of tools to supports, as the spacing over their distance, at which the trust number is 1
    nearness_scale: float = UNLIMITED_SCALE
    trained_tools: int = 1  # largest number of tools in contact at once in the held-out runs
    report: Mapping[str, Any] = field(default_factory=dict)  # figures measured in training
    kinematics: Kinematics = field(default_factory=Kinematics)  # kind of body, solid or membrane
    # [rad/s]: highest frequency of a membrane in its training states, because a slack region may become taut
    # within a few steps. 0 for solids.
    taut_frequency: float = 0.0
    compliance: SurfaceCompliance | None = None  # compliance of the contact surface, fitted to runs with contact
    mass_damping: float = 0.0  # [1/s]: Rayleigh's alpha

    @property
    def surface(self) -> ContactSurface:
        """Contact surface; empty for a model without contact."""
        return contact_surface(
            self.compliance or NO_COMPLIANCE, self.cloud, self.basis_vectors[: self.modes + self.lifting_count]
        )

    def integration_points(
        self, which: NDArray[np.int64], coefficients: tuple[float, ...], single: bool
    ) -> IntegrationPoints:
        """Return the integration points for a subset of the basis vectors."""
        rule, tissue = self.cubature, self.tissue
        law = coefficients if tissue.regions is None else tissue.regions.at(rule.nodes)
        return integration_points(
            np.ascontiguousarray(self.gradients[:, which]), rule.weights, rule.pressure,
            self.constant[np.ix_(which, which)], law, np.float32 if single else np.float64,
            relaxation(tissue.material), tissue.fibres and tissue.fibres.of(rule.nodes),
        )  # fmt: skip
