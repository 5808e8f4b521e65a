"""palpate: real-time simulation of hyperelastic soft tissue.

Names are loaded on first use, so that ``import palpate`` is quick.
"""

import os
from importlib import import_module
from typing import Any

# Threads that wait for each other spin only briefly, so that other work on the same cores does not stall them.
os.environ.setdefault("GOMP_SPINCOUNT", "1000")


def _check_cache_folder() -> None:
    """Refuse a folder for compiled code that others may write: what lies there is run.

    Raises
    ------
    ImportError
        ``NUMBA_CACHE_DIR`` names such a folder.
    """
    folder = os.environ.get("NUMBA_CACHE_DIR")
    if folder and os.name == "posix" and os.path.isdir(folder):
        found = os.stat(folder)
        if found.st_mode & 0o022 or found.st_uid not in (0, os.getuid()):
            raise ImportError(
                f"NUMBA_CACHE_DIR = {folder!r} can be written by others, and compiled code would be read from it: make "
                "it yours alone (chmod go-w), or unset the variable"
            )


_check_cache_folder()

_HOME = {
    "Cloud": "meshfree.cloud",
    "box": "meshfree.cloud",
    "in_box": "meshfree.attachment",
    "near_plane": "meshfree.attachment",
    "painted": "meshfree.attachment",
    "read_painted": "app.painted",
    "disc": "meshfree.sheets",
    "sheet": "meshfree.sheets",
    "Surface": "meshfree.surfaces",
    "check_surface": "meshfree.surface_checks",
    "read_surface": "meshfree.surface_files",
    "fill": "meshfree.filling",
    "fetch_liver": "scenes.published",
    "liver_surface": "scenes.organ",
    "Stencils": "meshfree.stencils",
    "moving_least_squares": "meshfree.stencils",
    "Material": "tissue.materials",
    "MooneyRivlin": "tissue.materials",
    "NeoHookean": "tissue.materials",
    "ArrudaBoyce": "tissue.invariant_laws",
    "Fung": "tissue.invariant_laws",
    "Gent": "tissue.invariant_laws",
    "StVenantKirchhoff": "tissue.invariant_laws",
    "Yeoh": "tissue.invariant_laws",
    "LinearElastic": "tissue.small_strain",
    "Exponential": "tissue.stretch_laws",
    "Hyperelastic": "tissue.own_law",
    "Logarithmic": "tissue.stretch_laws",
    "Ogden": "tissue.stretch_laws",
    "FibreLaw": "tissue.fibres",
    "Fibres": "tissue.fibres",
    "Guccione": "tissue.fibres",
    "VolumeOnly": "tissue.fibres",
    "Prony": "tissue.prony",
    "StretchLaw": "tissue.stretch_laws",
    "Measurement": "tissue.measurements",
    "fit": "tissue.fitting",
    "material_stability": "tissue.ellipticity",
    "read_measurements": "tissue.measurement_files",
    "Solid": "dynamics.solid.model",
    "Membrane": "dynamics.membrane.model",
    "Capsule": "dynamics.contact.tools",
    "Contact": "dynamics.contact.tools",
    "Grasp": "dynamics.contact.tools",
    "Plane": "dynamics.contact.tools",
    "Punch": "dynamics.contact.tools",
    "Sphere": "dynamics.contact.tools",
    "Foundation": "dynamics.loads.foundation",
    "Gravity": "dynamics.loads.body_force",
    "PrescribedMotion": "dynamics.loads.prescribed_motion",
    "SurfaceForce": "dynamics.loads.surface_force",
    "State": "dynamics.run.model",
    "Trajectory": "dynamics.run.trajectory",
    "rollout": "dynamics.run.rollout",
    "Basis": "reduction.basis.pod",
    "pod": "reduction.basis.pod",
    "GalerkinModel": "reduction.galerkin.model",
    "galerkin": "reduction.galerkin.model",
    "ReducedModel": "reduction.hyper.model",
    "hyper_reduce": "reduction.training.reduce",
    "select_time_step": "reduction.training.select_step",
    "load": "reduction.storage.models",
    "save": "reduction.storage.models",
    "realtime_model": "reduction.realtime.model",
    "LinearModel": "reduction.lti.model",
    "LinearSystem": "reduction.lti.system",
    "linearise": "reduction.lti.system",
    "to_pymor": "reduction.lti.pymor_bridge",
    "save_matlab": "reduction.lti.export",
    "save_matrix_market": "reduction.lti.export",
    "reduce_linear": "reduction.lti.reductors",
    "modal_derivatives": "reduction.basis.linear_modes",
    "vibration_modes": "reduction.basis.linear_modes",
    "Engine": "realtime.engine",
    "DummyDevice": "realtime.device",
    "Errors": "reduction.training.errors",
    "relative_errors": "reduction.training.errors",
    "CloudError": "faults",
    "DivergenceError": "faults",
    "FileFormatError": "faults",
    "InputError": "faults",
}

__all__ = sorted(_HOME)
__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    if name not in _HOME:
        raise AttributeError(f"module 'palpate' has no attribute {name!r}")
    return getattr(import_module(f"palpate.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
