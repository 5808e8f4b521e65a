"""Kinematics of solids and membranes: how derivatives of the displacement deform a point."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from palpate.core.arrays import Floats


@dataclass(frozen=True)
class Kinematics:
    """Kinematics of a body: the relation of F to the derivatives of the displacement."""

    sheet: bool = False  # whether the body is a membrane
    prestretch: float = 1.0  # of a mounted membrane
    relaxed: bool = False  # whether a membrane wrinkles instead of carrying compression

    def rest_strain(self, gradients: Floats) -> Floats:
        """Return twice the strain (..., 3, 3) that has stiffness at rest; tension resists every slope of a sheet."""
        return 2 * gradients if self.sheet else gradients + np.swapaxes(gradients, -1, -2)
