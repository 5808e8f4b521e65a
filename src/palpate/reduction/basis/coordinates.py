"""The base of reduced models whose displacements are sums of fields."""

from __future__ import annotations

import numpy as np

from palpate.core.arrays import Floats
from palpate.dynamics.loads.prepared import PreparedLoads
from palpate.dynamics.run.model import Model, Nodes, State


class CoordinateModel(Model):
    """A model with displacements u = sum over m of a_m Phi_m.

    Attributes
    ----------
    columns : (m, n, 3) array
        The fields Phi_m of the coordinates.
    """

    columns: Floats

    def displacement(self, state: State, prepared: PreparedLoads, nodes: Nodes = slice(None)) -> Floats:
        return np.tensordot(state.coordinates, self.columns[:, nodes], 1)

    def velocity(self, state: State, prepared: PreparedLoads, nodes: Nodes = slice(None)) -> Floats:
        return np.tensordot(state.velocities, self.columns[:, nodes], 1)
