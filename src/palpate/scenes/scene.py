"""What a scene returns."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from palpate.dynamics.loads import Load
from palpate.dynamics.nodal import NodalModel

__all__ = ["Scene"]


@dataclass(frozen=True)
class Scene:
    """A body with its loads, ready for `palpate.rollout`.

    Parameters
    ----------
    model : NodalModel
    loads : tuple of loads
    duration, every : float [s]
        Length of the run, and time between snapshots.
    title : str
    parameters : mapping of str to float
        What the scene was made with, in SI units.
    """

    model: NodalModel
    loads: tuple[Load, ...]
    duration: float
    every: float
    title: str
    parameters: Mapping[str, float]
