"""Reads what other programs write: surfaces, painted meshes, measured curves.

Models and trajectories are read by `palpate.load` and `palpate.Trajectory.load`.
"""

from palpate.scenes.painted import read_painted
from palpate.scenes.published import fetch_liver
from palpate.surface.checks import SurfaceReport, check_surface
from palpate.surface.files import read_surface
from palpate.surface.surface import SurfaceProblem
from palpate.tissue.measurement_files import read_measurements

__all__ = [
    "SurfaceProblem",
    "SurfaceReport",
    "check_surface",
    "fetch_liver",
    "read_measurements",
    "read_painted",
    "read_surface",
]
