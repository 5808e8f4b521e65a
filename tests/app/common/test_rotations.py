"""Products of rotations are those of SciPy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from palpate.app.common.rotations import compose_rotations


@pytest.mark.parametrize("invert_first", [False, True])
def test_the_second_rotation_follows_the_first_one_or_its_inverse(invert_first):
    first, second = Rotation.random(20, random_state=0), Rotation.random(20, random_state=1)
    expected = second * (first.inv() if invert_first else first)
    for k in range(20):
        found = compose_rotations(*(each[k].as_quat(scalar_first=True) for each in (first, second)), invert_first)
        np.testing.assert_allclose(Rotation.from_quat(found, scalar_first=True).as_matrix(), expected[k].as_matrix())
