"""Rigid tools, and the loads by which they act on a body: `Contact` and `Grasp`."""

from palpate.dynamics.contact import shapes
from palpate.dynamics.contact.shapes import *  # noqa: F403 - the public shapes are listed there
from palpate.dynamics.contact.tools import Contact, Grasp, surface_nodes

__all__ = ["Contact", "Grasp", "surface_nodes"]
__all__ += shapes.__all__
