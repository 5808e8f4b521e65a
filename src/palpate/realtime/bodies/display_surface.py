"""Display surface of a reduced body: positions of its vertices, and scalars of the strained tissue.

Positions are those of the modes plus the surface compliance. Where a tool pushes, they are those of the
patches that it meets (`palpate.meshfree.patches`), because a single node moves farther than the tool.
Stresses are those of the modes alone, from their gradients at the surface nodes. The indentation under
a small tool, which belongs to the surface compliance, adds nothing to them. Tissue that relaxes has its
instantaneous stiffness.
"""

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np
import scipy.sparse as sparse
from numpy.typing import NDArray

from palpate.core.arrays import Floats, Ints, Singles
from palpate.core.faults import InputError
from palpate.dynamics.material.stress_measures import pressure_of, von_mises
from palpate.dynamics.nodal.model import NodalModel
from palpate.meshfree.cloud import Cloud
from palpate.meshfree.cut.opening import NO_MEASURES, CutMeasures
from palpate.reduction.contact.compliance import secant_factor, static_displacements
from palpate.reduction.hyper.model import ReducedModel

SCALAR_NAMES = ("displacement", "stress", "pressure")


class CutLine(NamedTuple):
    """Pieces of the line along which a cut opens a surface."""

    corners: NDArray[np.uint32]  # (l, 3) array: the corners of the triangles on which they are
    ends: Singles  # (l, 4) array: shares of the second and third corner at the one end, and at the other


NO_CUT_LINE = CutLine(np.zeros((0, 3), dtype=np.uint32), np.zeros((0, 4), dtype=np.float32))


class DisplaySurface(Protocol):
    """The interface of a surface that is drawn, of a reduced model or of a full body."""

    model: Any
    nodes: Ints  # (n,), the body's nodes that are its vertices
    triangles: NDArray[np.uint32]  # (t, 3) of vertices, counter-clockwise from outside
    rest: Singles  # (n, 3) [m]
    fixed: NDArray[np.bool_]  # (n,), vertices of supports
    local_indentation: bool  # whether stresses include the indentation under a tool
    cut_line: CutLine  # where a cut opens the surface
    cut_measures: CutMeasures  # length, area and depth of the cut

    @property
    def scalars(self) -> tuple[str, ...]:
        """Names of the scalars."""

    def displacements(
        self, coordinates: Floats, nodes: Ints, forces: Floats, bonded: NDArray[np.bool_], tools: Ints
    ) -> Singles:
        """Return the displacements (n, 3) [m] of the vertices; see `Surface.displacements`."""

    def scalar(self, name: str, coordinates: Floats, displacements: Singles) -> Singles:
        """Return a number (n,) for every vertex."""


def fixed_nodes(model: ReducedModel | NodalModel) -> NDArray[np.bool_]:
    """Return the nodes (n,) of a body's supports, those that slide included."""
    mask = np.zeros(len(model.cloud), dtype=bool)
    for group in model.fixed:
        mask[model.cloud.group(group)] = True
    return mask


def places_at_rest(cloud: Cloud) -> Floats:
    """Return the places (n, 3) [m] of nodes at rest; those of a sheet are at z = 0."""
    return np.pad(cloud.points, ((0, 0), (0, 3 - cloud.points.shape[1])))


class SurfaceScalars:
    """Scalars at the vertices of a surface, of which a subclass returns the stress."""

    sheet = False  # whether the body is a membrane

    @property
    def scalars(self) -> tuple[str, ...]:
        """Names of the scalars; of a membrane only the displacement."""
        return SCALAR_NAMES[:1] if self.sheet else SCALAR_NAMES

    def cauchy(self, coordinates: Floats) -> Floats:
        """Return the Cauchy stress (n, 3, 3) [Pa] at the vertices, of a solid."""
        raise NotImplementedError

    def scalar(self, name: str, coordinates: Floats, displacements: Singles) -> Singles:
        """Return a number for every vertex, for coordinates (m,) and displacements (n, 3) [m].

        ``"displacement"`` is its length [m]; ``"stress"`` von Mises' of the Cauchy stress [Pa]; ``"pressure"`` minus a
        third of that stress's trace [Pa].
        """
        if name not in self.scalars:
            raise InputError(
                f"scalar must be one of {', '.join(map(repr, self.scalars))}, got {name!r}; use one of them"
            )
        if name == "displacement":
            return np.asarray(np.linalg.norm(displacements, axis=1), dtype=np.float32)
        measure = pressure_of if name == "pressure" else von_mises
        return np.asarray(measure(self.cauchy(coordinates)), dtype=np.float32)


class Surface(SurfaceScalars):
    """The display surface of a reduced model; see `DisplaySurface`."""

    cut_line, cut_measures = NO_CUT_LINE, NO_MEASURES

    def __init__(self, model: ReducedModel) -> None:
        cloud, data = model.cloud, model.data
        if not len(cloud.triangles):
            raise InputError("cloud must have triangles to be shown, got none; train a body with a surface")
        self.model = model
        self.local_indentation = data.compliance is None  # whether stresses include that under a tool
        self.nodes, triangles = np.unique(cloud.triangles, return_inverse=True)
        self.triangles = np.ascontiguousarray(triangles.reshape(-1, 3), dtype=np.uint32)
        self.rest = places_at_rest(cloud)[self.nodes].astype(np.float32)
        self.sheet = data.kinematics.sheet
        self.fixed = fixed_nodes(model)[self.nodes]
        columns = model.body.vectors[:, self.nodes].reshape(model.count, -1)
        self._columns = np.ascontiguousarray(columns.T, dtype=np.float32)
        self._gradients: Singles | None = None
        self._contact_displacements = data.compliance
        if data.compliance is None:
            return
        contact_surface, compliance = model.body.surface, data.compliance
        place = np.full(len(cloud), -1)
        place[compliance.nodes] = np.arange(len(compliance.nodes))
        self._compliance_rows = place[
            contact_surface.nodes
        ]  # row in the compliance of each node of the contact surface
        place[:] = -1
        place[self.nodes] = np.arange(len(self.nodes))
        self._vertex = place[compliance.nodes]
        self._visible = self._vertex >= 0
        rows = np.repeat(np.arange(len(compliance.nodes)), compliance.patches.shape[1])
        shares = compliance.shares.ravel().astype(np.float32), (rows, compliance.patches.ravel())
        single = compliance.patches.shape[1] == 1 and np.array_equal(
            compliance.patches[:, 0], np.arange(len(compliance.nodes))
        )
        self._patches = (
            None if single or not self._visible.all() else sparse.csr_array(shares, shape=(len(compliance.nodes),) * 2)
        )

    def displacements(
        self, coordinates: Floats, nodes: Ints, forces: Floats, bonded: NDArray[np.bool_], tools: Ints
    ) -> Singles:
        """Return the displacements (n, 3) [m] of the vertices for coordinates (m,) and contact forces.

        `nodes` (e,) are numbers of the nodes in contact, in the model's contact surface. The forces (e, 3) [N] of
        `tools` (e,) act on the patches of surface there, or on the nodes themselves where they are bonded. `bonded`
        (e,) nodes are held by a tool, and are drawn themselves. Other vertices have the displacements of
        `patch_displacements`, unless all nodes are held.
        """
        displacements = (self._columns @ coordinates.astype(np.float32)).reshape(-1, 3)
        if not len(nodes) or self._contact_displacements is None:
            return self.patch_displacements(displacements)
        for tool in np.unique(tools):
            of_tool = tools == tool
            moved = self._contact_displacement(nodes[of_tool], forces[of_tool], bool(bonded[of_tool].all()))
            displacements[self._vertex[self._visible]] += moved[self._visible]
        if bonded.all():
            return displacements
        result = self.patch_displacements(displacements)
        held = self._vertex[self._compliance_rows[nodes[bonded]]]
        result[held] = displacements[held]
        return result

    def patch_displacements(self, displacements: Singles) -> Singles:
        """Return the displacements (n, 3) [m] of the patches that tools meet, for those of the vertices."""
        if self._contact_displacements is None or self._patches is None:
            return displacements
        result = displacements.copy()
        result[self._vertex] = self._patches @ displacements[self._vertex]
        return result

    def tables(self, contact_nodes: Ints) -> tuple[Singles, Singles, Ints]:
        """Return displacements of vertices and of patches by unit coordinates, and rows of contact nodes.

        `contact_nodes` (k,) are the body's nodes of the contact surface. The displacements are (n, 3, m); the rows (n,)
        are the number of each vertex in `contact_nodes`, or -1.
        """
        count = self._columns.shape[1]
        columns = self._columns.reshape(-1, 3, count)
        patches = np.stack([self.patch_displacements(np.ascontiguousarray(columns[:, :, m])) for m in range(count)], 2)
        places = np.full(len(self.model.cloud), -1)
        places[contact_nodes] = np.arange(len(contact_nodes))
        return columns, np.ascontiguousarray(patches, dtype=np.float32), places[self.nodes]

    def _contact_displacement(self, nodes: Ints, forces: Floats, bonded: bool) -> Floats:
        """Return the displacements (k, 3) [m] of the surface compliance under forces."""
        compliance = self._contact_displacements
        assert compliance is not None
        touched, pushes = self._compliance_rows[nodes], np.zeros((len(compliance.nodes), 3))
        if bonded:
            np.add.at(pushes, touched, forces)
        else:
            np.add.at(pushes, compliance.patches[touched], compliance.shares[touched][:, :, None] * forces[:, None])
        on = np.flatnonzero(pushes.any(axis=1))
        if not len(on):
            return np.zeros_like(pushes)
        soft = (
            compliance.bonded_scale
            if bonded
            else secant_factor(compliance.stiffening, float(np.linalg.norm(forces.sum(axis=0))))
        )
        return np.asarray(soft * static_displacements(compliance, pushes[on], on, np.arange(len(pushes))))

    # scalars

    def cauchy(self, coordinates: Floats) -> Floats:
        if self._gradients is None:
            self._gradients = self._gradients_at_vertices()
        F = (self._gradients @ coordinates.astype(np.float32)).reshape(-1, 3, 3) + np.eye(3)
        stress = self.model.data.tissue.stress(F, self.nodes)
        return np.asarray(stress @ np.swapaxes(F, 1, 2) / np.linalg.det(F)[:, None, None])

    def _gradients_at_vertices(self) -> Singles:
        """Return the derivatives (9 n, m) of the basis vectors at the vertices, from the model's stencils."""
        result = np.empty((9 * len(self.nodes), self.model.count), dtype=np.float32)
        for m in range(self.model.count):
            result[:, m] = self.model.body.gradient(self.model.data.trial_and_test_basis[m])[self.nodes].reshape(-1)
        return result
