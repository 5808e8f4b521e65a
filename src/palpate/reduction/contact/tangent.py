"""How the force on a tool that touches a reduced body rises with its displacement, compiled: what a slow hand feels.

With the modes' tangent K and mass matrix M, the columns C of touched patches, directions E along which the forces on
them can change, and the surface's compliance h G (`palpate.reduction.contact.gauss_seidel`), forces f and coordinates a follow the
tool by d:

    E^T (h G - dt^2 C M^-1 C^T) E f + E^T C a = E^T d,    C^T E f - K a = 0.

The term with the step dt is the step's own: its forces put the patches onto the tool where the coordinates would be
without them, and then move the coordinates, so that at rest the surface is dt^2 C M^-1 C^T f off the tool.

A patch that sticks, or that forceps hold, moves with the tool: E has all three directions. One that slides keeps its
friction; E has the normal, and where the tool is curved (k) the normal force p turns with the normal, as springs of
stiffness -p k along the surface would. The surface softens (h) with the whole force, a term of rank one. All is solved
at once for the three directions of d, by one factorisation L D L^T: the matrix is quasi-definite, so that it needs no
pivoting (Vanderbei, SIAM J. Optim. 5, 1995). A call does a bounded part of it, and the next goes on.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.arrays import Floats
from palpate.dynamics.compiled.cache import kernel_njit
from palpate.dynamics.contact.geometry import gap
from palpate.dynamics.contact.tools import BONDED
from palpate.reduction.contact.compliance import refresh

__all__ = ["ContactSystem", "contact_stiffness", "contact_system"]


SIDES = 4  # right-hand sides: a displacement along each axis, and softening
PART = 300_000  # multiplications a call, about
PANEL = 4  # unknowns that are eliminated at once
STICKING = 1.0 - 1e-6  # of Coulomb's limit
FLAT = 1e-3  # spring of a curved tool times a patch's compliance below which the tool counts as flat
APART = 1e-4  # of a tool's size: points whose normals tell its curvature


class ContactSystem(NamedTuple):
    """The equations for forces and coordinates, and how far they are solved."""

    table: Floats  # upper triangle of a symmetric matrix row by row, each with its right-hand sides behind it
    direction: Floats  # (r, 3) of the forces
    entry: NDArray[np.int64]  # (r,) which of the touched patches they are of
    point: NDArray[np.int64]  # (r,) these, or the held nodes, in the compliance
    spring: Floats  # (r,) what a curved tool adds to the compliance along a direction [m/N]
    numbers: NDArray[np.int64]  # (3,) forces, unknowns, next pivot
    columns: NDArray[np.float32]  # (k, 3, m) C M^-1/2 of all surface nodes
    swift: Floats  # (m, r) dt M^-1/2 C^T E
    gram: Floats  # (4, 4) right-hand sides times solutions
    pull: Floats  # (4,) the whole force's direction, and h


def contact_system(columns: NDArray[np.float32], mass: Floats, patches: int) -> ContactSystem:
    """Allocate for columns (k, 3, m) of surface nodes, their mass matrix, and patches that are touched at once."""
    rows, modes = 3 * patches, len(mass)
    swift = columns @ np.linalg.inv(np.linalg.cholesky(mass)).T if patches else np.zeros((0, 3, modes))
    return ContactSystem(
        np.zeros((rows + modes) * (rows + modes + SIDES)), np.zeros((rows, 3)), np.zeros(rows, dtype=np.int64),
        np.zeros(rows, dtype=np.int64), np.zeros(rows), np.zeros(3, dtype=np.int64),
        np.ascontiguousarray(swift, dtype=np.float32), np.zeros((modes, rows)), np.zeros((SIDES, SIDES)), np.zeros(4),
    )  # fmt: skip


@kernel_njit()
def contact_stiffness(data, q, out):  # type: ignore[no-untyped-def]
    """Write derivatives of the force [N] on the body by the tool's displacement [m] into out (12, 12).

    A call computes for a bounded time; the derivatives are written, all at once, by the call that ends what another
    began. They are zero where nothing is touched, or more patches than are kept (`palpate.reduction.contact.compliance`), and
    stay as they were where the modes' tangent is not positive definite.
    """
    contact_state, system = data.contact_state, data.system
    numbers, pressed = system.numbers, False
    for e in range(contact_state.numbers[0]):
        for d in range(3):
            pressed = pressed or contact_state.push[e, d] != 0.0
    if not pressed:
        out[:] = 0.0
        numbers[:] = 0
        return
    if numbers[2] == numbers[1] and not _begin(data):
        out[:] = 0.0
        numbers[:] = 0
        return
    size, spent = numbers[1], 0
    table = system.table[: size * (size + SIDES)].reshape(size, size + SIDES)
    while numbers[2] < size and spent < PART:
        left = size - numbers[2]
        if not _eliminate(system, contact_state.active, table, numbers[2], min(PANEL, left)):
            numbers[:] = 0
            return
        numbers[2] += min(PANEL, left)
        spent += PANEL * (left * left // 2 + max(left - data.modes, 0) * data.modes)
    if numbers[2] == size:
        _tell(system.gram, system.pull, out)


@kernel_njit()
def _tell(gram, pull, out):  # type: ignore[no-untyped-def]
    """Write the derivatives, with softening: its right-hand side times the change of the whole force is one more."""
    softened = 1.0
    for i in range(3):
        softened += pull[i] * gram[i, 3]
    for j in range(3):
        grown = 0.0
        for i in range(3):
            grown += pull[i] * gram[i, j]
        for i in range(3):
            out[i, j] = gram[i, j] - gram[i, 3] * grown / softened


@kernel_njit(fastmath={"contract"})
def _eliminate(system, active, table, first, rows):  # type: ignore[no-untyped-def]
    """Eliminate a few unknowns; return False where that cannot be."""
    size, forces, gram = table.shape[0], system.numbers[0], system.gram
    end = size + SIDES
    for k in range(first, min(first + rows, forces)):
        if not _between(system, active, table, k):
            return False
    for k in range(first, first + rows):
        pivot = table[k, k]
        if pivot == 0.0 or (k >= forces and not pivot < 0.0):
            return False
        for i in range(k + 1, first + rows):
            factor = table[k, i] / pivot
            for j in range(i, end):
                table[i, j] -= factor * table[k, j]
        for i in range(SIDES):
            for j in range(SIDES):
                gram[i, j] += table[k, size + i] * table[k, size + j] / pivot
    if rows < PANEL:  # the last ones
        return True
    a, b, c, d = table[first], table[first + 1], table[first + 2], table[first + 3]
    p, q, r, s = a[first], b[first + 1], c[first + 2], d[first + 3]
    for i in range(first + PANEL, size):
        x, y, z, w, row = a[i] / p, b[i] / q, c[i] / r, d[i] / s, table[i]
        for j in range(i, end):
            row[j] -= x * a[j] + y * b[j] + z * c[j] + w * d[j]
    return True


@kernel_njit(fastmath={"contract"})
def _between(system, active, table, k):  # type: ignore[no-untyped-def]
    """Add to a row what forces move its patch by beside the modes; return False where that is not known any more."""
    s, h, direction = active.slot[system.point[k]], system.pull[3], system.direction
    x, y, z = h * direction[k, 0], h * direction[k, 1], h * direction[k, 2]
    for j in range(k, system.numbers[0]):
        r = active.slot[system.point[j]]
        if s < 0 or r < 0:
            return False
        block = active.matrix[s, r]
        for d in range(3):
            table[k, j] += (block[0, d] * x + block[1, d] * y + block[2, d] * z) * direction[j, d]
    for m in range(system.swift.shape[0]):
        own, others = system.swift[m, k], system.swift[m]
        for j in range(k, system.numbers[0]):
            table[k, j] -= own * others[j]
    return True


@kernel_njit()
def _begin(data):  # type: ignore[no-untyped-def]
    """Set the equations up, but for what stands between patches; return False where there is no room for them."""
    contact_state, system, modes, compliance = (
        data.contact_state,
        data.system,
        data.modes,
        data.contact_surface.compliance,
    )
    count, numbers, pull = contact_state.numbers[0], system.numbers, system.pull
    if not refresh(compliance, contact_state.active, contact_state.point, count):
        return False
    pull[:] = 0.0
    for e in range(count):
        for d in range(3):
            pull[d] += contact_state.push[e, d]
    whole = np.sqrt(pull[0] ** 2 + pull[1] ** 2 + pull[2] ** 2)
    for d in range(3):
        pull[d] /= max(whole, 1e-300)
    pull[3] = contact_state.soft[0]
    rows = 0
    for e in range(count):
        rows = _directions(data, e, rows)
    numbers[0], numbers[1], numbers[2] = rows, rows + modes, 0
    size, softening = rows + modes, -compliance.stiffening[0] / (compliance.stiffening[1] + whole)
    if data.tools.kind[0] == BONDED:  # pulls do not harden
        softening = 0.0
    table = system.table[: size * (size + SIDES)].reshape(size, size + SIDES)
    for k in range(size):
        for j in range(k, size + SIDES):
            table[k, j] = 0.0
    system.gram[:] = 0.0
    for k in range(rows):
        e, direction = system.entry[k], system.direction[k]
        table[k, k], system.swift[:, k] = system.spring[k], 0.0
        for d in range(3):
            for m in range(modes if direction[d] != 0.0 else 0):
                table[k, rows + m] += direction[d] * data.contact_surface.columns[contact_state.node[e], d, m]
                system.swift[m, k] += data.follow[3] * direction[d] * system.columns[contact_state.node[e], d, m]
            table[k, size + d] = direction[d]
            table[k, size + 3] += softening * direction[d] * (contact_state.now[e, d] - contact_state.modal[e, d])
    for m in range(modes):
        for k in range(m, modes):
            table[rows + m, rows + k] = -0.5 * (data.tangent[m, k] + data.tangent[k, m])
    return True


@kernel_njit()
def _directions(data, e, rows):  # type: ignore[no-untyped-def]
    """List the directions along which the force on a touched patch can change; return how many rows there are now."""
    contact_state, tools, system = data.contact_state, data.tools, data.system
    t, push, place = contact_state.tool[e], contact_state.push[e], contact_state.now[e]
    kind, sizes, frame = tools.kind[t], tools.sizes[t], tools.frames[t, 1]
    if kind == BONDED:
        return _all_three(contact_state, system, e, rows)
    _, nx, ny, nz = gap(kind, sizes, frame, place[0], place[1], place[2])
    normal = push[0] * nx + push[1] * ny + push[2] * nz
    along = np.sqrt(max(push[0] ** 2 + push[1] ** 2 + push[2] ** 2 - normal * normal, 0.0))
    if normal <= 0.0:
        return rows
    if along < STICKING * tools.friction[t] * normal:
        return _all_three(contact_state, system, e, rows)
    rows = _row(contact_state, system, e, rows, nx, ny, nz, 0.0)
    s = contact_state.active.slot[contact_state.point[e]]
    own = contact_state.active.matrix[s, s]
    own_compliance = contact_state.soft[t] * (own[0, 0] + own[1, 1] + own[2, 2]) / 3.0
    for curvature, x, y, z in _curved(kind, sizes, frame, place, nx, ny, nz):
        if normal * curvature * own_compliance > FLAT:
            rows = _row(contact_state, system, e, rows, x, y, z, -1.0 / (normal * curvature))
    return rows


@kernel_njit()
def _all_three(contact_state, system, e, rows):  # type: ignore[no-untyped-def]
    rows = _row(contact_state, system, e, rows, 1.0, 0.0, 0.0, 0.0)
    rows = _row(contact_state, system, e, rows, 0.0, 1.0, 0.0, 0.0)
    return _row(contact_state, system, e, rows, 0.0, 0.0, 1.0, 0.0)


@kernel_njit()
def _row(contact_state, system, e, rows, x, y, z, spring):  # type: ignore[no-untyped-def]
    system.direction[rows, 0], system.direction[rows, 1], system.direction[rows, 2] = x, y, z
    system.entry[rows], system.point[rows], system.spring[rows] = e, contact_state.point[e], spring
    return rows + 1


@kernel_njit()
def _curved(kind, sizes, frame, place, nx, ny, nz):  # type: ignore[no-untyped-def]
    """Return a tool's two principal curvatures [1/m] at a place, each with its direction."""
    ax, ay, az = (0.0, -nz, ny) if abs(nx) < 0.6 else (nz, 0.0, -nx)  # across the normal and an axis
    size = np.sqrt(ax * ax + ay * ay + az * az)
    ax, ay, az = ax / size, ay / size, az / size
    bx, by, bz = ny * az - nz * ay, nz * ax - nx * az, nx * ay - ny * ax
    apart = max(APART * sizes[0], 1e-12)
    p, q, r = _turned(kind, sizes, frame, place, ax, ay, az, apart)
    aa, ab = p * ax + q * ay + r * az, p * bx + q * by + r * bz
    p, q, r = _turned(kind, sizes, frame, place, bx, by, bz, apart)
    bb = p * bx + q * by + r * bz
    angle = 0.5 * np.arctan2(2.0 * ab, aa - bb)
    c, s = np.cos(angle), np.sin(angle)
    one, other = aa * c * c + 2.0 * ab * c * s + bb * s * s, aa * s * s - 2.0 * ab * c * s + bb * c * c
    return (
        (one, c * ax + s * bx, c * ay + s * by, c * az + s * bz),
        (other, c * bx - s * ax, c * by - s * ay, c * bz - s * az),
    )


@kernel_njit()
def _turned(kind, sizes, frame, place, x, y, z, apart):  # type: ignore[no-untyped-def]
    """Return how a tool's normal changes along a direction (3) [1/m]."""
    x, y, z = apart * x, apart * y, apart * z
    _, p, q, r = gap(kind, sizes, frame, place[0] + x, place[1] + y, place[2] + z)
    _, a, b, c = gap(kind, sizes, frame, place[0] - x, place[1] - y, place[2] - z)
    return (p - a) / (2.0 * apart), (q - b) / (2.0 * apart), (r - c) / (2.0 * apart)
