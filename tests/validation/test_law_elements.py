"""Laws of every kind in a coarse block, against finite elements of the printed energy."""

from __future__ import annotations

import law_elements
import numpy as np
import pytest
from printed_laws import printed

pytestmark = pytest.mark.slow

BODIES = law_elements.bodies()


@pytest.mark.parametrize("name", list(BODIES))
def test_the_laws_have_the_stress_of_the_printed_energies(name):
    law, fibres = (each and each() for each in BODIES[name])
    F = np.eye(3) + 0.15 * np.random.default_rng(0).uniform(-1, 1, (20, 3, 3))
    stress = law.stress(F)
    if fibres is not None:
        stress = stress + fibres.at(np.zeros((20, 3))).stress(F)
    expected = printed(law, fibres).stress(F)
    np.testing.assert_allclose(stress, expected, atol=1e-12 * np.abs(expected).max())


@pytest.mark.each_kind(name=["MooneyRivlin"])
@pytest.mark.parametrize(("name", "case"), [("MooneyRivlin", "shear"), ("Ogden", "tension"), ("Fibres", "compression")])
def test_a_coarse_block_needs_the_force_of_the_elements(name, case):
    """Four cells across; docs/claims/laws.md has all laws and cases over the spacing."""
    pytest.importorskip("felupe")
    law, fibres = (each and each() for each in BODIES[name])
    expected = law_elements.element_force(printed(law, fibres), case, (4, 2, 2))
    force, _ = law_elements.model_force(law_elements.body(name, "energy", 0.005), case, None)
    assert force == pytest.approx(expected, rel=0.07)
