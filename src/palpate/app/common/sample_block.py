"""A block of a tissue, on which a command measures how fast this machine is."""

from __future__ import annotations

import numpy as np

from palpate.dynamics.solid.model import EnergySolid
from palpate.meshfree.cloud import box
from palpate.tissue.materials import Material

BLOCK_SIZE, BLOCK_SPACING = 0.1, 0.0083  # [m]


def sample_block(material: Material) -> EnergySolid:
    """Return the block, fixed at the bottom."""
    return EnergySolid(box((BLOCK_SIZE,) * 3, BLOCK_SPACING, jitter=0.2), material, "z-")


def wave_time(material: Material, spacing: float) -> float:
    """Return the time [s] of a pressure wave over a spacing [m]."""
    return float(spacing / np.sqrt((material.lame + 2 * material.shear_modulus) / material.density))
