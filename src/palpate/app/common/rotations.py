"""Products of rotations as quaternions (4,), w x y z."""

from __future__ import annotations

import numpy as np

from palpate.core.arrays import Floats


def compose_rotations(first: Floats, second: Floats, invert_first: bool = False) -> Floats:
    """Return the quaternion (4,), w x y z, of the second rotation after the first one or its inverse."""
    a, b, c, d = (-first if invert_first else first).tolist()
    a = -a if invert_first else a
    w, x, y, z = second.tolist()
    return np.array(
        [w * a - x * b - y * c - z * d, w * b + x * a + y * d - z * c,
         w * c - x * d + y * a + z * b, w * d + x * c - y * b + z * a]
    )  # fmt: skip
