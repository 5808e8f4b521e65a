"""Finite elements of validation/elements.py: quadratic (or linear) tetrahedra of palpate's neo-Hookean law.

W = c1 (I1 - 3) - 2 c1 ln J + lame / 2 (J - 1)^2 with lame = 4 c1 nu / (1 - 2 nu). scikit-fem numbers the nodes and
gives shape functions; the sums over elements are compiled by numba; MKL Pardiso solves. SI units.
"""

from __future__ import annotations

import os
from collections.abc import Callable

import numba as nb
import numpy as np
import scipy.sparse as sp
from pypardiso import PyPardisoSolver
from scipy.sparse.linalg import LinearOperator, eigsh
from skfem import Basis, ElementTetP1, ElementTetP2, MeshTet

CHUNK = 20000  # elements whose tangents are stored at once
# places (second and third coordinates) and weights of a rule of degree 4 on a triangle
A, B, PA, PB = 0.445948490915965, 0.091576213509771, 0.223381589678011, 0.109951743655322
TRIANGLE = np.array(
    [[A, A, PA], [A, 1 - 2 * A, PA], [1 - 2 * A, A, PA], [B, B, PB], [B, 1 - 2 * B, PB], [1 - 2 * B, B, PB]]
)


@nb.njit(cache=True)
def _gradient(u, nodes, slopes):
    """Return the deformation gradient, its cofactors and its determinant."""
    F, cof = np.eye(3), np.empty((3, 3))
    for a in range(len(nodes)):
        for c in range(3):
            for d in range(3):
                F[c, d] += u[nodes[a], c] * slopes[a, d]
    for i in range(3):
        i1, i2 = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            j1, j2 = (j + 1) % 3, (j + 2) % 3
            cof[i, j] = F[i1, j1] * F[i2, j2] - F[i1, j2] * F[i2, j1]
    return F, cof, F[0, 0] * cof[0, 0] + F[0, 1] * cof[0, 1] + F[0, 2] * cof[0, 2]


@nb.njit(parallel=True, cache=True)
def _internal(u, nodes, slopes, weights, c1, lame, forces, energies):
    """Write each element's nodal forces, and its energy: infinite where it is turned inside out."""
    for t in nb.prange(len(nodes)):
        forces[t] = 0.0
        energies[t] = 0.0
        for q in range(slopes.shape[1]):
            F, cof, J = _gradient(u, nodes[t], slopes[t, q])
            s = weights[t, q]
            if J <= 0.0:
                energies[t] = np.inf
                J = 1e-3
            f = -2 * c1 / J + lame * (J - 1)
            energies[t] += s * (c1 * (np.sum(F * F) - 3) - 2 * c1 * np.log(J) + 0.5 * lame * (J - 1) ** 2)
            P = s * (2 * c1 * F + f * cof)
            for a in range(nodes.shape[1]):
                for c in range(3):
                    for d in range(3):
                        forces[t, a, c] += P[c, d] * slopes[t, q, a, d]


@nb.njit(cache=True)
def _add_point(K, F, cof, J, slopes, s, c1, lame):
    """Add the tangent at a point of an element: 2 c1 1 + (2 c1/J^2 + lame) cof cof + f d(cof)/dF."""
    f, h = -2 * c1 / J + lame * (J - 1), 2 * c1 / J**2 + lame
    n = len(slopes)
    g = np.zeros((n, 3))
    for a in range(n):
        for c in range(3):
            for d in range(3):
                g[a, c] += cof[c, d] * slopes[a, d]
    for a in range(n):
        p0, p1, p2 = slopes[a]
        for b in range(a, n):
            m0, m1, m2 = slopes[b]
            x0, x1, x2 = p1 * m2 - p2 * m1, p2 * m0 - p0 * m2, p0 * m1 - p1 * m0
            y0 = s * f * (F[0, 0] * x0 + F[0, 1] * x1 + F[0, 2] * x2)
            y1 = s * f * (F[1, 0] * x0 + F[1, 1] * x1 + F[1, 2] * x2)
            y2 = s * f * (F[2, 0] * x0 + F[2, 1] * x1 + F[2, 2] * x2)
            dot = 2 * c1 * s * (p0 * m0 + p1 * m1 + p2 * m2)
            for c in range(3):
                for d in range(3):
                    K[a, b, c, d] += s * h * g[a, c] * g[b, d]
                K[a, b, c, c] += dot
            K[a, b, 0, 1] += y2
            K[a, b, 0, 2] -= y1
            K[a, b, 1, 0] -= y2
            K[a, b, 1, 2] += y0
            K[a, b, 2, 0] += y1
            K[a, b, 2, 1] -= y0


@nb.njit(parallel=True, cache=True)
def _tangents(u, nodes, slopes, weights, c1, lame, K):
    """Write the tangents (nodes, nodes, 3, 3) of elements."""
    for t in nb.prange(len(nodes)):
        K[t] = 0.0
        for q in range(slopes.shape[1]):
            F, cof, J = _gradient(u, nodes[t], slopes[t, q])
            _add_point(K[t], F, cof, J, slopes[t, q], weights[t, q], c1, lame)
        for a in range(nodes.shape[1]):
            for b in range(a + 1, nodes.shape[1]):
                for c in range(3):
                    for d in range(3):
                        K[t, b, a, d, c] = K[t, a, b, c, d]


@nb.njit(cache=True)
def _scatter(K, place, data):
    """Add elements' blocks (a, b, ...) to the entries of a sparse matrix."""
    for t in range(len(K)):
        for a in range(K.shape[1]):
            for b in range(K.shape[1]):
                data[place[t, a, b]] += K[t, a, b]


class Factor:
    """Factors of a symmetric matrix; call it to solve."""

    def __init__(self, matrix: sp.csr_matrix, definite: bool = True) -> None:
        self.solver = PyPardisoSolver(mtype=2 if definite else -2)
        os.environ.setdefault("PYPARDISO_MKL_RT", self.solver.libmkl._name)  # or every solver looks for it again
        self.matrix = sp.triu(matrix, format="csr")
        self.matrix.sort_indices()
        self.solver.factorize(self.matrix)

    def __call__(self, right: np.ndarray) -> np.ndarray:
        return self.solver.solve(self.matrix, np.asfortranarray(right))

    def free(self) -> None:
        """Give the memory back."""
        self.solver.free_memory(everything=True)


class Elements:
    """Elements of the law, and the matrix they add up to.

    Parameters
    ----------
    nodes : array (m, n)
        Of each element.
    slopes : array (m, q, n, 3) [1/m]
        Of the shape functions at the points of integration.
    weights : array (m, q) [m^3]
        Of these points, times the stiffness relative to the law's.
    c1, lame : float [Pa]
    count : int
        Of nodes.
    """

    def __init__(self, nodes, slopes, weights, c1, lame, count) -> None:
        self.nodes, self.slopes, self.weights = nodes, slopes, weights
        self.c1, self.lame, self.count = c1, lame, count
        n = nodes.shape[1]
        i, j = np.repeat(nodes, n, axis=1).ravel().astype(np.int64), np.tile(nodes, (1, n)).ravel()
        keys, place = np.unique(i * count + j, return_inverse=True)
        self.place = place.reshape(len(nodes), n, n)
        self.indices = (keys % count).astype(np.int32)
        self.indptr = np.searchsorted(keys // count, np.arange(count + 1)).astype(np.int32)

    def force(self, u: np.ndarray) -> tuple[np.ndarray, float]:
        """Return the elastic nodal forces (nodes, 3) [N] and the energy [J] at displacements u."""
        forces, energies = np.empty((*self.nodes.shape, 3)), np.empty(len(self.nodes))
        _internal(u, self.nodes, self.slopes, self.weights, self.c1, self.lame, forces, energies)
        flat = self.nodes.ravel()
        total = [np.bincount(flat, forces[:, :, c].ravel(), self.count) for c in range(3)]
        return np.stack(total, axis=1), float(energies.sum())

    def tangent(self, u: np.ndarray | None = None) -> sp.csr_matrix:
        """Return the stiffness (3 nodes, 3 nodes) at displacements u, by default at rest."""
        u = np.zeros((self.count, 3)) if u is None else u
        data, n = np.zeros((len(self.indices), 3, 3)), self.nodes.shape[1]
        for start in range(0, len(self.nodes), CHUNK):
            part = slice(start, start + CHUNK)
            K = np.empty((len(self.nodes[part]), n, n, 3, 3))
            _tangents(u, self.nodes[part], self.slopes[part], self.weights[part], self.c1, self.lame, K)
            _scatter(K, self.place[part], data)
        return sp.bsr_matrix((data, self.indices, self.indptr)).tocsr()

    def part(self, mask: np.ndarray) -> tuple[Elements, np.ndarray]:
        """Return some of the elements, with nodes of their own, and which nodes these are."""
        used, nodes = np.unique(self.nodes[mask], return_inverse=True)
        nodes = np.ascontiguousarray(nodes.reshape(-1, self.nodes.shape[1]))
        return Elements(nodes, self.slopes[mask], self.weights[mask], self.c1, self.lame, len(used)), used


class Body(Elements):
    """A body of tetrahedra.

    Parameters
    ----------
    points, tetrahedra : arrays (n, 3) [m], (m, 4)
    c1, poisson, density : float
    factor : function of points, optional
        Stiffness relative to the law's, evaluated at the middles of tetrahedra.
    order : int
        2: ten nodes to a tetrahedron; 1: four.

    Attributes
    ----------
    X : array (nodes, 3) [m]
    faces : array (faces, 6 or 3)
        Nodes of the surface's triangles: corners, then the middles of edges 01, 12, 02.
    integral : array (nodes,) [m^3]
        Of the shape functions.
    """

    def __init__(self, points, tetrahedra, c1, poisson, density, factor=None, order=2) -> None:
        mesh = MeshTet(np.ascontiguousarray(points.T), np.ascontiguousarray(tetrahedra.T))
        element = ElementTetP2() if order == 2 else ElementTetP1()
        basis = Basis(mesh, element, intorder=2 if order == 2 else 1)
        self.X = np.ascontiguousarray(basis.doflocs.T)
        slopes = [np.broadcast_to(b[0].grad, (3, *basis.dx.shape)) for b in basis.basis]
        slopes = np.ascontiguousarray(np.stack(slopes).transpose(2, 3, 0, 1))
        nodes, lame = np.ascontiguousarray(basis.element_dofs.T), 4 * c1 * poisson / (1 - 2 * poisson)
        self.volumes = np.ascontiguousarray(basis.dx)
        super().__init__(nodes, slopes, self.volumes, c1, lame, len(self.X))
        self.density, self.mesh, self.volume = density, mesh, float(self.volumes.sum())
        self.middles = points[tetrahedra].mean(axis=1)
        self.set_factor(factor)
        self._set_mass(Basis(mesh, element, intorder=2 * order))
        self.faces = self._boundary(order)
        self.surface = np.unique(self.faces)

    def set_factor(self, factor: Callable | None) -> None:
        """Set the stiffness relative to the law's."""
        self.weights = self.volumes * (1.0 if factor is None else factor(self.middles)[:, None])

    def _set_mass(self, basis: Basis) -> None:
        shapes = np.stack([np.broadcast_to(b[0].value, basis.dx.shape) for b in basis.basis])
        blocks = self.density * np.einsum("atq,btq,tq->tab", shapes, shapes, basis.dx, optimize=True)
        data = np.bincount(self.place.ravel(), blocks.ravel(), len(self.indices))
        self.mass = sp.csr_matrix((data, self.indices, self.indptr), (len(self.X),) * 2)
        share = np.einsum("atq,tq->ta", shapes, basis.dx)
        self.integral = np.bincount(self.nodes.ravel(), share.ravel(), len(self.X))

    def _boundary(self, order: int) -> np.ndarray:
        mesh = self.mesh
        corners = mesh.facets[:, mesh.boundary_facets()].T
        if order == 1:
            return corners
        ends = np.sort(mesh.edges.T.astype(np.int64), axis=1)
        keys = ends[:, 0] * mesh.nvertices + ends[:, 1]
        rank = np.argsort(keys)
        columns = [corners]
        for pair in ([0, 1], [1, 2], [0, 2]):
            low, high = np.sort(corners[:, pair].astype(np.int64), axis=1).T
            columns.append(mesh.nvertices + rank[np.searchsorted(keys[rank], low * mesh.nvertices + high)][:, None])
        faces = np.hstack(columns)
        if not np.allclose(self.X[faces[:, 3]], self.X[faces[:, :2]].mean(axis=1)):
            raise RuntimeError("scikit-fem numbers the middles of edges otherwise than assumed")
        return faces


def frequencies(body: Body, free: np.ndarray, count: int, solve: Factor, K: sp.csr_matrix):
    """Return the lowest angular frequencies [rad/s] and their modes (free, count)."""
    mass = sp.kron(body.mass, sp.identity(3)).tocsr()[free][:, free]
    inverse = LinearOperator(K.shape, solve, dtype=float)
    values, modes = eigsh(K, count, mass, sigma=0.0, OPinv=inverse, tol=1e-9)
    return np.sqrt(values), modes


def shape_values(corners_only: bool) -> np.ndarray:
    """Return the shape functions of a triangle at the places of `TRIANGLE`."""
    b, c = TRIANGLE[:, 0], TRIANGLE[:, 1]
    a = 1 - b - c
    if corners_only:
        return np.stack([a, b, c], axis=1)
    return np.stack([a * (2 * a - 1), b * (2 * b - 1), c * (2 * c - 1), 4 * a * b, 4 * b * c, 4 * a * c], axis=1)


def surface_rule(body: Body, faces: np.ndarray) -> tuple[sp.csr_matrix, np.ndarray]:
    """Return the interpolation from nodes to points of faces (six each), and the points' areas [m^2]."""
    X, values = body.X, shape_values(faces.shape[1] == 3)
    vectors = np.cross(X[faces[:, 1]] - X[faces[:, 0]], X[faces[:, 2]] - X[faces[:, 0]])
    areas = 0.5 * np.linalg.norm(vectors, axis=1)
    points, n = values.shape
    rows = np.repeat(np.arange(len(faces) * points), n)
    columns = np.repeat(faces[:, None, :], points, axis=1).ravel()
    shape = (len(faces) * points, len(X))
    rule = sp.csr_matrix((np.tile(values, (len(faces), 1)).ravel(), (rows, columns)), shape)
    return rule, np.outer(areas, TRIANGLE[:, 2]).ravel()
