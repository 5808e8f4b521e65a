"""Rigid tools, and the loads by which they act on a body: `Contact` and `Grasp`."""

from palpate.dynamics.contact.tools import Capsule, Contact, Grasp, Plane, Punch, Sphere, surface_nodes

__all__ = [
    "Capsule",
    "Contact",
    "Grasp",
    "Plane",
    "Punch",
    "Sphere",
    "surface_nodes",
]
