"""palpate: real-time simulation of hyperelastic soft tissue.

This module holds clouds, models, loads, runs, reductions and the engine. Every other public name has one place:

- `palpate.materials`: laws, fibres, relaxation, and the fit of a law to measured curves
- `palpate.tools`: rigid tools, `Contact` and `Grasp`
- `palpate.io`: surfaces, painted meshes and measurements from files
- `palpate.lti`: linearised bodies and their linear reductions
- `palpate.typing`: types of arguments and results, for annotations

Names are loaded on first use, so that ``import palpate`` is quick. The stub ``__init__.pyi`` lists the same names for
editors and type checkers.
"""

import os
from importlib import import_module
from typing import Any

from palpate.core.working_folder import check_cache_folder, guard_numba

# Threads that wait for each other spin only briefly, so that other work on the same cores does not stall them.
os.environ.setdefault("GOMP_SPINCOUNT", "2500")


check_cache_folder()
guard_numba()

_HOME = {
    "Cloud": "meshfree.cloud",
    "box": "meshfree.cloud",
    "cell_fractions": "meshfree.cell_fractions",
    "in_box": "meshfree.attachment",
    "near_plane": "meshfree.attachment",
    "painted": "meshfree.attachment",
    "disc": "meshfree.sheets",
    "sheet": "meshfree.sheets",
    "Surface": "surface.surface",
    "fill": "meshfree.filling",
    "liver_surface": "scenes.organ",
    "Stencils": "meshfree.stencils",
    "moving_least_squares": "meshfree.stencils",
    "Solid": "dynamics.solid.model",
    "Membrane": "dynamics.membrane.model",
    "cut": "dynamics.solid.cutting.cut",
    "equilibrium": "dynamics.nodal.equilibrium",
    "unloaded": "dynamics.solid.unloading",
    "Foundation": "dynamics.loads.foundation",
    "Gravity": "dynamics.loads.body_force",
    "PrescribedMotion": "dynamics.loads.prescribed_motion",
    "Pressure": "dynamics.loads.pressure",
    "Rail": "dynamics.loads.supports",
    "Roller": "dynamics.loads.supports",
    "SurfaceForce": "dynamics.loads.surface_force",
    "SymmetryPlane": "dynamics.loads.supports",
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
    "show": "app.view.show",
    "realtime_model": "realtime.bodies.model",
    "modal_derivatives": "reduction.basis.linear_modes",
    "vibration_modes": "reduction.basis.linear_modes",
    "Engine": "realtime.engine",
    "DummyDevice": "realtime.device",
    "Errors": "reduction.training.errors",
    "relative_errors": "reduction.training.errors",
    "CloudError": "core.faults",
    "DivergenceError": "core.faults",
    "FileFormatError": "core.faults",
    "InputError": "core.faults",
    "TrustWarning": "core.faults",
    "Statistics": "realtime.statistics",
    "TrainingScene": "scenes.load_case",
    "open_scene": "scenes.open_scene",
}
_MODULES = ("io", "lti", "materials", "tools", "typing")

__all__ = sorted([*_HOME, *_MODULES])
__version__ = "0.1.0"


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return import_module(f"palpate.{name}")
    if name in _HOME:
        return getattr(import_module(f"palpate.{_HOME[name]}"), name)
    for module in _MODULES if not name.startswith("_") else ():
        if name in import_module(f"palpate.{module}").__all__:
            raise AttributeError(f"module 'palpate' has no attribute {name!r}; it is palpate.{module}.{name}")
    raise AttributeError(f"module 'palpate' has no attribute {name!r}")


def __dir__() -> list[str]:
    return [*__all__, "__version__"]
