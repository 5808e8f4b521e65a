"""Solids behind one name: `Solid` is the base of the strong and of the energy form, and makes one of them."""

from __future__ import annotations

from palpate.dynamics.solid.base import Solid
from palpate.dynamics.solid.energy import EnergySolid
from palpate.dynamics.solid.strong import StrongSolid

__all__ = ["EnergySolid", "Solid", "StrongSolid"]
