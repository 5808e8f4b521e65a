"""Finite-element reference of validation/contact.py: a rigid tool pressed into an axisymmetric block, by FElupe.

Biquadratic elements, graded towards the contact; the tool pushes the nodes of the top by a stiff penalty without
friction. Nothing but the energy of the law is shared with palpate, in FElupe's own form of it. SI units.
"""

from __future__ import annotations

import felupe as fem
import numpy as np
from mooney_rivlin import MooneyRivlin
from scipy.sparse import coo_array
from scipy.sparse.linalg import spsolve

PENALTY = 1e3  # of the contact, in shear moduli over the fine elements' size


class Block:
    """A cylinder of soft tissue, clamped below, as FElupe model.

    Parameters
    ----------
    radius, depth : float [m]
    law : palpate.materials.MooneyRivlin
    fine : float [m]
        Size of the elements below the tool, out to `reach`; they grow from there.
    reach : float [m]
    """

    def __init__(self, radius: float, depth: float, law, fine: float, reach: float) -> None:
        across = _graded(reach, radius, fine)
        down = depth - _graded(reach, depth, fine)[::-1]  # x is the axis, fine near the top
        mesh = fem.Grid(down, across).add_midpoints_edges().add_midpoints_faces()
        self.points = mesh.points
        region = fem.RegionBiQuadraticQuad(mesh)
        self.field = fem.FieldContainer([fem.FieldAxisymmetric(region, dim=2)])
        self.solid = fem.SolidBody(MooneyRivlin(law.C1, law.C2, law.lame), self.field)
        X = mesh.points
        self.top = np.flatnonzero(np.isclose(X[:, 0], depth))
        self.depth, self.stiffness = depth, PENALTY * law.shear_modulus / fine
        self.area = self._areas()
        held = np.zeros(X.shape, bool)
        held[np.isclose(X[:, 0], 0)] = True
        held[np.isclose(X[:, 1], 0), 1] = True
        self.free = np.flatnonzero(~held.ravel())
        self.u = np.zeros(X.shape)

    def _areas(self):
        """Areas [m^2] of the top that its nodes stand for, by Simpson's rule along the radius."""
        order = np.argsort(self.points[self.top, 1])
        r, area = self.points[self.top[order], 1], np.zeros(len(order))
        for k in range(0, len(r) - 2, 2):
            width = r[k + 2] - r[k]
            area[k : k + 3] += 2 * np.pi * width / 6 * np.array([1, 4, 1]) * r[k : k + 3]
        area[0] = 0.01 * area[1]  # the axis has no area of its own, but must not enter the tool
        result = np.empty(len(order))
        result[order] = area
        return result

    def press(self, gap) -> float:
        """Find the equilibrium with a tool given by ``gap(x, r)``: gaps, normals, slopes; return its force [N]."""
        for softer in (1e-3, 1e-2, 1e-1, 1.0):  # a stiff penalty alone would throw Newton's method off
            force = self._solve(gap, softer * self.stiffness)
        return force

    def _solve(self, gap, stiffness: float) -> float:
        top, forces = self.top, []
        dofs = 2 * top[:, None] + np.arange(2)
        rows, columns = np.repeat(dofs, 2, axis=1), np.tile(dofs, (1, 2))
        for iteration in range(100):
            self.field[0].values[:] = self.u
            residual = self.solid.assemble.vector(self.field).toarray().ravel()
            matrix = self.solid.assemble.matrix(self.field).tocsr()
            place = self.points[top] + self.u[top]
            g, normal, curvature = gap(place[:, 0], place[:, 1])
            k = stiffness * self.area * (g < 0)
            force = -k[:, None] * g[:, None] * normal  # on the body
            residual[dofs] -= force
            # -d(force)/du = k (n n + g dn/du)
            block = k[:, None, None] * (normal[:, :, None] * normal[:, None, :] + g[:, None, None] * curvature)
            contact = coo_array((block.ravel(), (rows.ravel(), columns.ravel())), shape=matrix.shape)
            matrix = (matrix + contact.tocsr())[self.free][:, self.free]
            forces.append(-float(force[:, 0].sum()))
            change = np.zeros(self.u.size)
            change[self.free] = -spsolve(matrix, residual[self.free])
            self.u = self.u + (1.0 if iteration < 15 else 0.3) * change.reshape(self.u.shape)
            # a node at the rim may come and go for ever; its force is nothing
            if iteration > 3 and np.ptp(forces[-3:]) < 1e-6 * abs(forces[-1]):
                return forces[-1]
        raise RuntimeError("Newton's method did not converge")


def _graded(reach, end, fine):
    """Places from 0 to `end`, `fine` apart out to `reach` and then ever farther."""
    places, step = list(np.linspace(0, reach, round(reach / fine) + 1)), fine
    while places[-1] < end:
        step *= 1.2
        places.append(places[-1] + step)
    places = np.array(places)
    places[places > reach] = reach + (places[places > reach] - reach) * (end - reach) / (places[-1] - reach)
    return places


def sphere(centre: float, radius: float):
    """Gap to a sphere about (centre, 0), for `Block.press`."""

    def gap(x, r):
        arm = np.stack([x - centre, r], axis=1)
        length = np.linalg.norm(arm, axis=1)
        normal = arm / length[:, None]
        across = np.eye(2) - normal[:, :, None] * normal[:, None, :]
        return length - radius, normal, across / length[:, None, None]

    return gap


def punch(height: float, radius: float, rounding: float):
    """Gap to a cylinder with a rounded edge whose flat end is at `height`."""

    def gap(x, r):
        a, b = r - (radius - rounding), height + rounding - x  # b > 0 below the rounding's centre
        normal, g = np.tile([-1.0, 0.0], (len(x), 1)), b - rounding
        curvature = np.zeros((len(x), 2, 2))
        edge = (a > 0) & (b > 0)
        arm = np.stack([-b, a], axis=1)[edge]
        length = np.linalg.norm(arm, axis=1)
        n = arm / length[:, None]
        g = np.where(edge, 0.0, g)
        g[edge] = length - rounding
        normal[edge] = n
        curvature[edge] = (np.eye(2) - n[:, :, None] * n[:, None, :]) / length[:, None, None]
        g[(a > 0) & (b <= 0)] = 1.0  # outside of the cylinder
        return g, normal, curvature

    return gap
