"""Laws of tissue, their relaxation and fibres, and the fit of a law to measured curves.

Every law is here and nowhere else: `NeoHookean`, `MooneyRivlin`, ... ; `Hyperelastic` takes an energy as text.
"""

from palpate.tissue.ellipticity import MaterialStability, material_stability
from palpate.tissue.fibres import FibreLaw, Fibres, Guccione, VolumeOnly
from palpate.tissue.fitting import CurveFit, Fit, FitStart, fit
from palpate.tissue.invariant_laws import ArrudaBoyce, Fung, Gent, StVenantKirchhoff, Yeoh
from palpate.tissue.materials import Material, MooneyRivlin, NeoHookean
from palpate.tissue.measurements import Measurement
from palpate.tissue.prony import Prony
from palpate.tissue.small_strain import LinearElastic
from palpate.tissue.stretch_laws import Exponential, Logarithmic, Ogden, StretchLaw
from palpate.tissue.symbolic_law import Hyperelastic

__all__ = [
    "ArrudaBoyce",
    "CurveFit",
    "Exponential",
    "FibreLaw",
    "Fibres",
    "Fit",
    "FitStart",
    "Fung",
    "Gent",
    "Guccione",
    "Hyperelastic",
    "LinearElastic",
    "Logarithmic",
    "Material",
    "MaterialStability",
    "Measurement",
    "MooneyRivlin",
    "NeoHookean",
    "Ogden",
    "Prony",
    "StVenantKirchhoff",
    "StretchLaw",
    "VolumeOnly",
    "Yeoh",
    "fit",
    "material_stability",
]
