"""Constants of a reduced model's coordinates, which the compiled steps of runs and of the engine read."""

from __future__ import annotations

from typing import NamedTuple

from palpate.core.arrays import Floats
from palpate.reduction.hyper.sampled_energy import CubaturePoints


class ReducedConstants(NamedTuple):
    """Constants of the m modes and l lifting functions of a reduced model."""

    stiffness_damping: float  # [s]: Rayleigh's beta
    mass_damping: float  # [1/s]: Rayleigh's alpha
    mass: Floats  # (m + l, m + l) array [kg]
    inverse_mass: Floats  # (m + l, m + l) array [1/kg]
    constrained_inverse_mass: Floats  # (m, m) array [1/kg]: inverse of the modes' block, with the tools fixed
    differences: Floats  # (m + l,) array: changes of the coordinates for difference quotients
    cubature_points: CubaturePoints  # with the derivatives of the coordinates' vectors
