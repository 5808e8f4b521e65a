"""Solids behind one name: `Solid` is the base of the strong and of the energy form, and makes one of them."""

from __future__ import annotations

from palpate.core.faults import InputError, brief
from palpate.dynamics.solid.base import Solid
from palpate.dynamics.solid.energy import EnergySolid
from palpate.dynamics.solid.strong import StrongSolid

__all__ = ["EnergySolid", "Solid", "StrongSolid", "energy_solid"]


def energy_solid(body: object, name: str = "body") -> EnergySolid:
    """Return a body that is a solid in the energy form; raise `InputError` for another."""
    if not isinstance(body, EnergySolid):
        raise InputError(f"{name} must be a Solid in the energy form, got {brief(body)}; use form='energy'")
    return body
