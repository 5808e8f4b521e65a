"""Rigid tools, and the loads by which they act on a body: `Contact` and `Grasp`."""

from palpate.dynamics.contact.blade import Blade
from palpate.dynamics.contact.tools import Capsule, Contact, Forceps, Grasp, Plane, Punch, Sphere, surface_nodes

__all__ = [
    "Blade",
    "Capsule",
    "Contact",
    "Forceps",
    "Grasp",
    "Plane",
    "Punch",
    "Sphere",
    "surface_nodes",
]
