"""Tissues of a scene: laws of the same stiffness at rest."""

from __future__ import annotations

import pytest

from palpate.scenes.description import Tissue
from palpate.scenes.tissue import material_of, of_law, offered_laws, parameters_text
from palpate.tissue.catalogue import LAWS

STIFF = Tissue(law="MooneyRivlin", parameters={"C1": 60e3, "C2": 1.2e3}, density=1120.0, poisson=0.45)


@pytest.mark.parametrize("tissue", [STIFF, Tissue()], ids=["stiff", "liver"])
@pytest.mark.parametrize("law", [law.name for law in LAWS])
def test_a_tissue_of_another_law_has_the_same_moduli_at_rest(tissue, law):
    before, after = material_of(tissue), material_of(of_law(tissue, law))
    assert type(after).__name__ == law
    assert after.shear_modulus == pytest.approx(before.shear_modulus, rel=1e-12)
    assert after.bulk_modulus == pytest.approx(before.bulk_modulus, rel=1e-12)
    assert after.poisson == before.poisson
    assert after.density == before.density


def test_the_law_of_a_tissue_is_offered_first_and_a_text_has_no_other():
    assert offered_laws(STIFF)[0] == "MooneyRivlin"
    assert set(offered_laws(STIFF)) == {law.name for law in LAWS}
    assert offered_laws(Tissue(energy="C1*(I1 - 3 - 2*log(J))", parameters={"C1": 1e3})) == ()
    assert "LinearElastic" not in offered_laws(Tissue(split="isochoric"))


def test_parameters_are_written_with_units():
    assert parameters_text(STIFF) == "C1 = 60 kPa; C2 = 1.2 kPa"
    assert parameters_text(Tissue(law="Ogden")) == "C = 0.8, 0.12 kPa; alpha = 4, -7.5"
