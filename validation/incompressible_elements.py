"""Finite-element reference of validation/incompressible.py: FElupe's three fields, displacement, pressure and volume.

27-node hexahedra with discontinuous pressures (Simo, Taylor, Pister, Comput. Methods Appl. Mech. Eng. 51, 1985); the
law is the full model's own, W_s of F and U of the third field. SI units.
"""

from __future__ import annotations

import felupe as fem
import numpy as np

import palpate as pt
from palpate.tissue.volumetric import volumetric_form


def graded(s: np.ndarray) -> np.ndarray:
    """Numbers from 0 to 1, closer to each other at both ends."""
    return s - 0.1 * np.sin(2 * np.pi * s)


def hexahedra(size: tuple[float, float, float], cells: tuple[int, int, int]) -> fem.Mesh:
    """A graded mesh of linear hexahedra."""
    mesh = fem.Cube(n=tuple(c + 1 for c in cells))
    mesh.points[:] = graded(mesh.points) * size
    return mesh


def quadratic(mesh: fem.Mesh) -> fem.Mesh:
    return mesh.add_midpoints_edges().add_midpoints_faces().add_midpoints_volumes()


class ThreeFields:
    """A body of a neo-Hookean law on a mesh of 27-node hexahedra."""

    def __init__(self, mesh: fem.Mesh, law: pt.materials.NeoHookean) -> None:
        pressure, lame = volumetric_form(law.volumetric).pressure, law.lame
        self.field = fem.FieldsMixed(fem.RegionTriQuadraticHexahedron(mesh), n=3)
        umat = fem.NearlyIncompressible(
            fem.NeoHookeCompressible(mu=law.shear_modulus, lmbda=0.0),
            bulk=lame,
            dUdJ=lambda J, bulk: bulk * pressure(J - 1)[0],
            d2UdJdJ=lambda J, bulk: bulk * pressure(J - 1)[1] * np.ones_like(J),
        )
        self.solid, self.points, self.mesh = fem.SolidBody(umat, self.field), mesh.points, mesh

    def solve(self, held: np.ndarray, values: np.ndarray, forces: np.ndarray | None = None) -> None:
        """Find the equilibrium with some displacements, (n, 3) bool and [m], under nodal forces (n, 3) [N]."""
        total = sum(f.values.size for f in self.field.fields)
        prescribed = np.flatnonzero(held.ravel())
        free = np.setdiff1d(np.arange(total), prescribed)
        items = [self.solid]
        if forces is not None:
            loaded = np.flatnonzero(forces.any(axis=1))
            items.append(fem.PointLoad(self.field, loaded, values=forces[loaded]))
        fem.newtonraphson(items=items, dof0=prescribed, dof1=free, ext0=values.ravel()[prescribed], verbose=0)

    def displacements(self) -> np.ndarray:
        return np.array(self.field[0].values)

    def reactions(self) -> np.ndarray:
        """Internal forces [N] at the nodes, (n, 3)."""
        count = self.points.size
        return self.solid.assemble.vector(self.field).toarray().ravel()[:count].reshape(-1, 3)

    def pressures(self) -> tuple[np.ndarray, np.ndarray]:
        """Middles of the elements (c, 3) [m] and their mean pressures U'(J) [Pa]."""
        middles = self.points[self.mesh.cells[:, :8]].mean(axis=1)
        return middles, np.asarray(self.field[1].values).reshape(len(middles), -1).mean(axis=1)


def moved_end(law: pt.materials.NeoHookean, size, cells, motion, steps: int) -> tuple[ThreeFields, np.ndarray]:
    """A block with a clamped end, its other end moved; `motion(points, share)` is its displacement [m]."""
    body = ThreeFields(quadratic(hexahedra(size, cells)), law)
    end, held = np.isclose(body.points[:, 0], size[0]), np.zeros(body.points.shape, dtype=bool)
    held[end | np.isclose(body.points[:, 0], 0)] = True
    for share in np.linspace(0, 1, steps + 1)[1:]:
        values = np.zeros_like(body.points)
        values[end] = motion(body.points[end], share)
        body.solve(held, values)
    return body, end


def cook(
    law: pt.materials.NeoHookean, size, cells, taper, traction: float, steps: int
) -> tuple[ThreeFields, np.ndarray]:
    """Cook's slab in plane strain under a shear traction [Pa] on its right end."""
    flat = hexahedra(size, cells)
    flat.points[:] = taper(flat.points)
    body = ThreeFields(quadratic(flat), law)
    X = body.points
    end, held = np.isclose(X[:, 0], size[0]), np.zeros(X.shape, dtype=bool)
    held[np.isclose(X[:, 0], 0)] = True
    held[np.isclose(X[:, 2], 0) | np.isclose(X[:, 2], size[2]), 2] = True
    region = fem.RegionTriQuadraticHexahedronBoundary(body.mesh, mask=end)
    one = np.ones((1, *region.dV.shape))
    field = fem.FieldContainer([fem.Field(region, dim=1)])
    weights = fem.IntegralForm([one], v=field, dV=region.dV, grad_v=[False]).assemble().toarray().ravel()
    forces = np.zeros_like(X)
    forces[:, 1] = traction * weights
    for share in np.linspace(0, 1, steps + 1)[1:]:
        body.solve(held, np.zeros_like(X), share * forces)
    return body, end
