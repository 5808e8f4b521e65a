"""Display surface of a full body: positions of its vertices, and scalars of the strained tissue.

Vertices of a solid are drawn at the patches that tools meet (`palpate.meshfree.patches`), because a single node
moves farther than the tool; those of a sheet are nodes. Stresses are those of the nodes; tissue that relaxes has its
instantaneous stiffness.
"""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from palpate.core.arrays import Floats, Ints, Singles
from palpate.core.faults import InputError
from palpate.dynamics.nodal.model import NodalModel
from palpate.dynamics.solid.model import EnergySolid
from palpate.meshfree.cut.opening import NO_MEASURES
from palpate.realtime.bodies.display_surface import (
    NO_CUT_LINE,
    DisplaySurface,
    Surface,
    SurfaceScalars,
    fixed_nodes,
    places_at_rest,
)
from palpate.reduction.hyper.model import ReducedModel


def display_surface(model: ReducedModel | NodalModel) -> DisplaySurface:
    """Return the display surface of a reduced model or of a full body."""
    return Surface(model) if isinstance(model, ReducedModel) else FullSurface(model)


class FullSurface(SurfaceScalars):
    """The display surface of a full body; see `palpate.realtime.bodies.display_surface.Surface`."""

    local_indentation = True  # stresses include the indentation under a tool
    cut_line, cut_measures = NO_CUT_LINE, NO_MEASURES

    def __init__(self, model: NodalModel) -> None:
        self.model = model
        surface = model.cloud.triangles
        if isinstance(model, EnergySolid):
            surface = surface[~np.isin(surface, model.removed_nodes).any(axis=1)]
        self.nodes, triangles = np.unique(surface, return_inverse=True)
        if not len(self.nodes):
            raise InputError("cloud must have triangles to be drawn, got none; use fill, or a box")
        self.triangles = np.ascontiguousarray(triangles.reshape(-1, 3), dtype=np.uint32)
        self.rest = places_at_rest(model.cloud)[self.nodes].astype(np.float32)
        self.sheet = model.kinematics.sheet
        self.fixed = fixed_nodes(model)[self.nodes]
        patches = model.patches if isinstance(model, EnergySolid) else sparse.eye_array(len(model.cloud), format="csr")
        self._patches = patches[self.nodes].astype(np.float32)

    def displacements(
        self, coordinates: Floats, nodes: Ints, forces: Floats, bonded: NDArray[np.bool_], tools: Ints
    ) -> Singles:
        """Return the displacements (n, 3) [m] of the vertices for nodal displacements (3 n,).

        Forceps hold nodes, so these are drawn themselves (`bonded`, as of `Surface.displacements`).
        """
        moved = coordinates.reshape(-1, 3).astype(np.float32)
        if len(bonded) and bonded.all():
            return np.ascontiguousarray(moved[self.nodes])
        result: Singles = np.ascontiguousarray(self._patches @ moved)
        held = np.flatnonzero(np.isin(self.nodes, nodes[bonded]))
        result[held] = moved[self.nodes[held]]
        return result

    @cached_property
    def _workspace(self) -> Any:
        return self.model.workspace()

    def cauchy(self, coordinates: Floats) -> Floats:
        u = coordinates.reshape(-1, 3)
        F = self.model.deformation_gradient(u)[self.nodes]
        stress = self.model.evaluate(u, work=self._workspace).stress[self.nodes]
        return np.asarray(stress @ np.swapaxes(F, 1, 2) / np.linalg.det(F)[:, None, None])
