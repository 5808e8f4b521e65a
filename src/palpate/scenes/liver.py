"""Training scene of a liver: presses of a ball and pulls of forceps on its free surface."""

from __future__ import annotations

from palpate.dynamics.solid.model import Solid
from palpate.faults import number_in_range
from palpate.meshfree.attachment import near_plane
from palpate.meshfree.filling import fill
from palpate.scenes.organ import liver_surface
from palpate.scenes.scene import TrainingScene
from palpate.scenes.tool_paths import ToolPaths
from palpate.tissue.liver import DENSITY, MASS_DAMPING, SHEAR_MODULUS
from palpate.tissue.materials import NeoHookean

__all__ = ["pressed_liver"]

BED = 0.07  # [m] depth of the fixed back: the bare area, where a liver is attached to the diaphragm
COARSE = 0.008  # [m] spacing of the coarse liver, for the vibration modes and statics of finer ones
MAX_SLIDE = 0.02  # [m]
EVERY = 0.01  # [s]
CUBATURE = 1e-2  # a tenth of it samples two to three times as many nodes, with equal errors on held-out presses


def pressed_liver(
    spacing: float = 0.0045,
    poisson: float = 0.45,
    radius: float = 0.015,
    depth: float = 0.02,
    friction: float = 0.2,
    mass_damping: float = MASS_DAMPING,
) -> TrainingScene:
    """Return the generated liver (`palpate.liver_surface`) with random presses of a ball and pulls of forceps.

    Neo-Hookean with the mean shear modulus of healthy livers, 2.2 kPa; the back is fixed. In a
    press the ball moves along the normal at a random place (`palpate.scenes.tool_paths`), indents the
    surface by 0.3 to 1 times `depth`, slides up to 20 mm, and retracts. Every fourth seed, 3, 7 and
    so on, is a grasp. Forceps hold the surface nodes around a random place, and pull them by 0.3 to 1
    times `depth` at up to 45 degrees to the normal. Half of them turn by up to 20 degrees. They
    return and release.

    Parameters
    ----------
    spacing : float [m]
        Distance between nodes, 2 to 12 mm; 4.5 mm are about 20,000 nodes.
    poisson : float
        Poisson's ratio at rest, in [0, 0.49].
    radius : float [m]
        Radius of the ball, at least 2.5 spacings, so that nodes resolve the surface under it. The
        radius of forceps is 0.6 times it, or 2 spacings if that is more.
    depth : float [m]
        Depth of the deepest press and length of the longest pull, up to 40 mm.
    friction : float
        Coulomb's coefficient.
    mass_damping : float [1/s]
        Rayleigh's alpha, 0 to 100. With 8 1/s a vibration of 26 rad/s, the slowest, has a damping ratio of 0.15,
        and one of 10 Hz 0.06. The ratio of the Zener law of healthy livers in Asbach et al., Magn. Reson. Med. 60,
        2008 (1.16 kPa, 1.97 kPa, 7.3 Pa s, measured at 25 to 62.5 Hz) is 0.08 and 0.17 there.

    Raises
    ------
    InputError
        A parameter out of range; the message names it.
    """
    spacing = number_in_range("spacing", spacing, 0.002, 0.012, unit="m")
    poisson = number_in_range("poisson", poisson, 0.0, 0.49)
    radius = number_in_range("radius", radius, 2.5 * spacing, 0.1, unit="m")
    depth = number_in_range("depth", depth, 0.0, 0.04, open_low=True, unit="m")
    friction = number_in_range("friction", friction, 0.0, 2.0)
    mass_damping = number_in_range("mass_damping", mass_damping, 0.0, 100.0, unit="1/s")
    model = _model(spacing, poisson, mass_damping)
    paths = ToolPaths(model, radius, depth, friction, MAX_SLIDE)
    parameters = {
        "spacing": spacing, "poisson": poisson, "radius": radius, "depth": depth, "friction": friction,
        "mass_damping": mass_damping,
    }  # fmt: skip
    return TrainingScene(
        model, paths, EVERY, "Liver pressed by a ball and pulled by forceps everywhere", parameters,
        coarse=lambda: model if spacing >= COARSE else _model(COARSE, poisson, mass_damping), cubature=CUBATURE,
    )  # fmt: skip


def _model(spacing: float, poisson: float, mass_damping: float) -> Solid:
    cloud = fill(liver_surface(), spacing)
    back = cloud.points[:, 1].max()
    cloud = cloud.with_group("back", near_plane(cloud, (0.0, back - BED, 0.0), (0.0, -1.0, 0.0)))
    material = NeoHookean(C1=SHEAR_MODULUS / 2, density=DENSITY, poisson=poisson)
    return Solid(cloud, material, "back", form="energy", mass_damping=mass_damping)
