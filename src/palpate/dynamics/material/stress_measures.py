"""Scalars of the Cauchy stress, for drawings and files."""

from __future__ import annotations

import numpy as np

from palpate.core.arrays import Floats


def pressure_of(stress: Floats) -> Floats:
    """Return minus a third of the trace of Cauchy stresses (n, 3, 3) [Pa]: positive where tissue is compressed."""
    return np.asarray(-np.trace(stress, axis1=1, axis2=2) / 3)


def von_mises(stress: Floats) -> Floats:
    """Return the von Mises stresses (n,) of Cauchy stresses (n, 3, 3) [Pa]."""
    shear = stress + pressure_of(stress)[:, None, None] * np.eye(3)
    return np.asarray(np.sqrt(1.5 * np.einsum("nij,nij->n", shear, shear)))
