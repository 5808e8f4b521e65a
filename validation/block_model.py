"""Finite-element model of a clamped block with square section, for FElupe.

All quantities are in SI units.
"""

import felupe as fem
import numpy as np
from mooney_rivlin import SHEAR_1, SHEAR_2, MooneyRivlin, first_lame

WIDTH = 0.02  # m


class Block:
    """A part of the block with y >= 0, and z >= 0 if ``quarter``, as a FElupe model.

    Parameters
    ----------
    length : float
        Length along x [m].
    poisson : float
        Poisson ratio at small strain.
    cells : int
        Elements over the half width; 6 times as many over 0.2 m of length.
    quarter : bool
        Model a quarter of the block instead of a half.
    reduced : bool
        Integrate the volumetric term with the reduced rule.
    """

    def __init__(self, length, poisson, cells, quarter, reduced):
        half = WIDTH / 2
        s = np.linspace(0, 1, cells + 1)
        y = half * (1 - (1 - s) ** 1.3)
        z = y if quarter else np.concatenate([-y[:0:-1], y])
        along = round(6 * cells * (length / 0.2) ** 0.5)
        x = length * np.linspace(0, 1, along + 1) ** 1.6
        self.mirrored = [1, 2] if quarter else [1]
        self.mesh = fem.mesh.convert(fem.Grid(x, y, z), 2, True, calc_midfaces=True, calc_midvolumes=True)
        region = fem.RegionTriQuadraticHexahedron(self.mesh)
        rule = fem.GaussLegendre(order=1 if reduced else 2, dim=3)
        other = fem.Region(self.mesh, region.element, rule)
        distortional = MooneyRivlin(SHEAR_1, SHEAR_2)
        volumetric = MooneyRivlin(lam=first_lame(poisson))
        self.bodies = [
            fem.SolidBody(material, fem.FieldContainer([fem.Field(where, dim=3)]))
            for material, where in ((distortional, region), (volumetric, other))
        ]
        X = self.mesh.points
        nodes = np.round(X, 9)
        self.order = np.lexsort(nodes.T[::-1])  # by x, then y, then z
        self.axes = [np.unique(nodes[:, i]) for i in range(3)]
        self.end_weights = self._end_weights()
        self.centre = np.argmin(np.linalg.norm(X - [length, 0, 0], axis=1))

    def _end_weights(self):
        """Return the integral of each shape function over the end face [m^2]."""
        face = self.mesh.points[:, 0] == self.mesh.points[:, 0].max()
        region = fem.RegionTriQuadraticHexahedronBoundary(self.mesh, mask=face)
        field = fem.FieldContainer([fem.Field(region, dim=1)])
        one = np.ones((1, *region.dV.shape))
        form = fem.IntegralForm([one], v=field, dV=region.dV, grad_v=[False])
        return form.assemble().toarray().ravel()

    def free(self, on_y, on_z=()):
        """Return the free degrees of freedom.

        Parameters
        ----------
        on_y, on_z : sequence of int
            Displacement components fixed on the planes y = 0 and z = 0.
        """
        X = abs(self.mesh.points) < 1e-9
        held = np.repeat(X[:, [0]], 3, axis=1)
        for axis, components in ((1, on_y), (2, on_z)):
            for component in components:
                held[:, component] |= X[:, axis]
        return np.flatnonzero(~held.ravel())

    def residual(self, u):
        """Return the internal forces [N] at the displacement u [m], shape (n, 3)."""
        forces = 0
        for body in self.bodies:
            body.field[0].values[:] = u
            forces = forces + body.assemble.vector(body.field).toarray().ravel()
        return forces

    def energy(self, u):
        """Return the strain energy [J] at the displacement u [m]; nan if inverted."""
        total = 0.0
        for body in self.bodies:
            body.field[0].values[:] = u
            density = body.umat.energy(body.field.extract()[0])
            total += np.sum(density * body.field.region.dV)
        return total

    def stiffness(self):
        """Return the tangent stiffness [N/m] at the state of the last residual."""
        return sum(body.assemble.matrix() for body in self.bodies).tocsc()

    def tip(self, u):
        """Return the mean and the centre displacement [m] of the end face."""
        mean = self.end_weights @ u / self.end_weights.sum()
        mean[self.mirrored] = 0.0  # cancelled by the other part of the block
        return mean, u[self.centre]

    def refined(self, finer, u):
        """Return the displacement u [m] interpolated to the nodes of a finer mesh."""
        grid = u[self.order].reshape(*map(len, self.axes), 3)
        for axis in range(3):
            matrix = quadratic_interpolation(self.axes[axis], finer.axes[axis])
            grid = np.moveaxis(np.tensordot(matrix, grid, (1, axis)), 0, axis)
        fine = np.empty((finer.mesh.npoints, 3))
        fine[finer.order] = grid.reshape(-1, 3)
        return fine


def quadratic_interpolation(nodes, points):
    """Return the matrix from values at nodes to values at points, both 1D [m].

    Every second node is the middle of a quadratic line element.
    """
    ends = nodes[::2]
    cell = np.clip(np.searchsorted(ends, points, "right") - 1, 0, len(ends) - 2)
    s = (points - ends[cell]) / np.diff(ends)[cell]
    rows = np.arange(len(points))
    matrix = np.zeros((len(points), len(nodes)))
    matrix[rows, 2 * cell] = (1 - s) * (1 - 2 * s)
    matrix[rows, 2 * cell + 1] = 4 * s * (1 - s)
    matrix[rows, 2 * cell + 2] = s * (2 * s - 1)
    return matrix
