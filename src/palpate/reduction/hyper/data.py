"""Data of a reduced model: its body, basis vectors, cubature points, range of training, and contact surface."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

from palpate.core.arrays import Floats
from palpate.core.deprecation import renamed_attribute
from palpate.core.describe import Described
from palpate.dynamics.loads.supports import Support
from palpate.dynamics.material.kinematics import Kinematics
from palpate.dynamics.material.tissue import TissueField
from palpate.meshfree.cloud import Cloud
from palpate.reduction.contact.compliance import NO_COMPLIANCE, SurfaceCompliance
from palpate.reduction.contact.surface import ContactSurface, contact_surface
from palpate.reduction.hyper.cubature import Cubature

UNLIMITED_SCALE = 1e300  # scale of a measure without training states


@dataclass(frozen=True)
class TrialAndTestBasis(Described):
    """Basis vectors of a reduced model: displacement fields of its coordinates, and test fields.

    The fields are m modes, l lifting functions of the tools, and test fields: 3 for each of g supports, and w residual
    fields (`palpate.reduction.training.residual_fields`). The coordinates are those of modes and lifting functions.
    """

    vectors: Floats  # (m + l + 3 g + w, n, 3) array
    modes: int  # number m
    lifting_count: int  # number l
    residual_fields: int = 0  # number w

    @property
    def count(self) -> int:
        """Number m + l of coordinates."""
        return self.modes + self.lifting_count


@dataclass(frozen=True)
class SampledBasis(Described):
    """Basis vectors at the cubature points of a reduced model.

    The derivatives of the residual fields are multiplied by fitted factors.
    """

    cubature: Cubature
    gradients: Floats  # (s, m + l + 3 g + w, 9) array: derivatives of the basis vectors, row by row
    constant: Floats  # (m + l + 3 g + w, m + l + 3 g + w) array: constant stiffness of the hourglass residual


class Scales(NamedTuple):
    """Scales of the measures of the error indicator, at which the error indicator is 1."""

    distance_scale: float  # [m]: distance from the training states
    residual_scale: float = 1.0  # [m]: residual norm
    load_scale: float = 0.3  # share of the loads' static response outside the coordinates
    flexibility_scale: float = 1.0  # [J]: energy of the surface compliance
    # [m/s]: touch speed of tools; without a contact surface, root mean square speed over the body
    speed_scale: float = UNLIMITED_SCALE
    nearness_scale: float = UNLIMITED_SCALE  # nearness of tools to supports, as the spacing over their distance
    trained_tools: int = 1  # largest number of tools in contact at once in the held-out runs


@dataclass(frozen=True)
class TrainedRange(Described):
    """Training states of a reduced model, and the scales and the frequency that follow from training."""

    states: Floats  # (t, m + l) array: coordinates
    scales: Scales
    # [rad/s]: highest frequency of a membrane in these states, because a slack region may become taut within a few
    # steps. 0 for solids.
    taut_frequency: float = 0.0


@dataclass(frozen=True)
class ReducedData(Described):
    """Data of a reduced model, and the content of its file."""

    cloud: Cloud
    tissue: TissueField  # the weights of the cubature points include its stiffness factors
    supports: tuple[Support, ...]
    prescribed: tuple[str, ...]  # groups that rigid tools move
    volumes: Floats  # (n,) array [m^3]: nodal volumes of the mass
    stiffness_damping: float  # [s]: Rayleigh's beta
    # [m/s]: approximate speed of the fastest waves. It limits the velocity of a jumping tool in the damping
    # forces.
    wave_speed: float
    basis: TrialAndTestBasis
    sampled: SampledBasis
    trained: TrainedRange
    report: Mapping[str, Any] = field(default_factory=dict)  # figures measured in training
    kinematics: Kinematics = field(default_factory=Kinematics)  # kind of body, solid or membrane
    compliance: SurfaceCompliance | None = None  # compliance of the contact surface, fitted to runs with contact
    mass_damping: float = 0.0  # [1/s]: Rayleigh's alpha

    @property
    def trial_and_test_basis(self) -> Floats:
        """Basis vectors (m + l + 3 g + w, n, 3)."""
        return self.basis.vectors

    @property
    def modes(self) -> int:
        """Number m of modes."""
        return self.basis.modes

    @property
    def lifting_count(self) -> int:
        """Number l of lifting functions."""
        return self.basis.lifting_count

    @property
    def residual_fields(self) -> int:
        """Number w of residual fields, the last basis vectors."""
        return self.basis.residual_fields

    @property
    def cubature(self) -> Cubature:
        """Nodes, weights and moments of the cubature points."""
        return self.sampled.cubature

    @property
    def training_states(self) -> Floats:
        """Coordinates (t, m + l) of the training states."""
        return self.trained.states

    @property
    def scales(self) -> Scales:
        """Scales of the error indicator."""
        return self.trained.scales

    basis_vectors = renamed_attribute("ReducedData", "basis_vectors", "trial_and_test_basis")

    @property
    def surface(self) -> ContactSurface:
        """Contact surface; empty for a model without contact."""
        return contact_surface(self.compliance or NO_COMPLIANCE, self.cloud, self.basis.vectors[: self.basis.count])

    def with_scales(self, **changes: Any) -> ReducedData:
        """Return these data with some scales of the error indicator replaced."""
        return replace(self, trained=replace(self.trained, scales=self.scales._replace(**changes)))

    def __getattr__(self, name: str) -> Any:
        record = _RECORD_OF.get(name)
        if record is None:
            raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
        message = f"ReducedData.{name} is deprecated and will be removed in the next version; use {record}.{name}"
        warnings.warn(message, DeprecationWarning, stacklevel=2)
        return getattr(getattr(self, record), name)


# former attributes of `ReducedData`, and the record that has each
_RECORD_OF = {
    "gradients": "sampled",
    "constant": "sampled",
    "taut_frequency": "trained",
    **dict.fromkeys(Scales._fields, "scales"),
}
