"""Properties of liver tissue, for scenes and for a first touch."""

SHEAR_MODULUS = 2.2e3  # [Pa] mean of healthy livers by elastography: Yin et al., Clin. Gastroenterol. Hepatol. 5, 2007
LIVER_DENSITY = 1060.0  # [kg/m^3]
LIVER_POISSON = 0.45
MASS_DAMPING = 8.0  # [1/s] an amplitude decays to 2 % within a second
