"""Contact stiffness: derivative of the static force on each tool by its displacement, compiled.

With the modes' tangent K and mass matrix M, the basis vectors C of the patches in contact, directions E
along which the forces on them can change, and the surface compliance h G
(`palpate.reduction.contact.gauss_seidel`), forces f and coordinates a respond to a displacement d of
a tool, while other tools rest, by

    E^T (h G - dt^2 C M^-1 C^T) E f + E^T C a = E^T d,    C^T E f - K a = 0.

The term with the step dt belongs to the step. Its forces put the patches onto the tool at the
coordinates before their update, and then move the coordinates. So at rest the surface is
dt^2 C M^-1 C^T f off the tool.

A patch that sticks, or that forceps hold, moves with the tool: E has all three directions. A patch that
slides keeps its friction, and E has the normal only. Where the tool has a curvature k, the normal force
p turns with the normal, which acts like springs of stiffness -p k along the surface. The dependence of
h on the total force of a tool is a term of rank one. One factorisation L D L^T solves for all three
directions of d of all tools. The matrix is quasi-definite, so that pivoting is not necessary (Vanderbei,
SIAM J. Optim. 5, 1995). A call does a bounded part of the work, and the next one continues.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from palpate.compiled.jit import kernel_njit
from palpate.core.arrays import Floats
from palpate.dynamics.contact.geometry import gap
from palpate.dynamics.contact.kinds import BONDED
from palpate.reduction.contact.compliance import refresh
from palpate.reduction.contact.surface import PAIRS

RIGHT_SIDES = 4  # of a tool: a displacement along each axis, and the change of the secant factor
CALL_WORK = 300_000  # multiplications per call, approximately
PANEL_UNKNOWNS = 4  # unknowns per elimination
STICK_LIMIT = 1.0 - 1e-6  # fraction of Coulomb's limit below which a patch sticks
MIN_CURVATURE = 1e-3  # stiffness p k times a patch's compliance below which the tool counts as flat
CURVATURE_STEP = 1e-4  # distance for difference quotients of the normal, in tool sizes
FORCES, UNKNOWNS, NEXT_PIVOT = range(3)  # entries of `ContactSystem.numbers`
PULL_SIZE = 3  # entry of a row of `ContactSystem.pull` after the direction


class ContactSystem(NamedTuple):
    """Linear system for forces and coordinates, with the progress of its solution."""

    table: Floats  # (u, u + 4 t) upper triangle of a symmetric matrix of the first unknowns, then right-hand sides
    direction: Floats  # (r, 3) of the forces
    entry: NDArray[np.int64]  # (r,) contact pair of each force
    point: NDArray[np.int64]  # (r,) its row in the compliance
    factor: Floats  # (r,) secant factor of the compliance under its tool
    spring: Floats  # (r,) compliance of a curved tool along a direction [m/N]
    numbers: NDArray[np.int64]  # (3,) see FORCES, UNKNOWNS and NEXT_PIVOT
    columns: NDArray[np.float32]  # (k, 3, m) C M^-1/2 of all surface nodes
    swift: Floats  # (m, r) dt M^-1/2 C^T E
    gram: Floats  # (4 t, 4 t) right-hand sides times solutions
    pull: Floats  # (t, 4) direction of the total force of each tool, and its size [N]
    secants: Floats  # (t, t + 1) scratch: equations for the changes of the total forces


def contact_system(columns: NDArray[np.float32], mass: Floats, patches: int, tools: int) -> ContactSystem:
    """Allocate for basis vectors (k, 3, m) of surface nodes, their mass matrix, and numbers of patches and tools."""
    rows, modes, sides = 3 * patches, len(mass), RIGHT_SIDES * tools
    swift = columns @ np.linalg.inv(np.linalg.cholesky(mass)).T if patches else np.zeros((0, 3, modes))
    return ContactSystem(
        table=np.zeros((rows + modes, rows + modes + sides)),
        direction=np.zeros((rows, 3)),
        entry=np.zeros(rows, dtype=np.int64),
        point=np.zeros(rows, dtype=np.int64),
        factor=np.zeros(rows),
        spring=np.zeros(rows),
        numbers=np.zeros(3, dtype=np.int64),
        columns=np.ascontiguousarray(swift, dtype=np.float32),
        swift=np.zeros((modes, rows)),
        gram=np.zeros((sides, sides)),
        pull=np.zeros((tools, 4)),
        secants=np.zeros((tools, tools + 1)),
    )


@kernel_njit()
def contact_stiffness(data, q, out):
    """Write derivatives of each tool's force [N] on the body by its displacement [m] into its part of out (12 t, 12).

    The work of a call is bounded. The call that completes a solution writes all derivatives at once. They
    are zero without contact, or with more patches than are stored
    (`palpate.reduction.contact.compliance`). They are unchanged where the modes' tangent is not positive
    definite.
    """
    contact, system = data.contact_work, data.system
    numbers, pressed = system.numbers, False
    for e in range(contact.numbers[PAIRS]):
        for d in range(3):
            pressed = pressed or contact.push[e, d] != 0.0
    if not pressed:
        out[:] = 0.0
        numbers[:] = 0
        return
    if numbers[NEXT_PIVOT] == numbers[UNKNOWNS] and not _assemble(data):
        out[:] = 0.0
        numbers[:] = 0
        return
    size, work = numbers[UNKNOWNS], 0
    while numbers[NEXT_PIVOT] < size and work < CALL_WORK:
        remaining = size - numbers[NEXT_PIVOT]
        if not _eliminate(system, contact.active, numbers[NEXT_PIVOT], min(PANEL_UNKNOWNS, remaining)):
            numbers[:] = 0
            return
        numbers[NEXT_PIVOT] += min(PANEL_UNKNOWNS, remaining)
        work += PANEL_UNKNOWNS * (remaining * remaining // 2 + max(remaining - data.modes, 0) * data.modes)
    if numbers[NEXT_PIVOT] == size:
        for t in range(system.pull.shape[0]):
            _write_derivatives(system, t, out)


@kernel_njit(inner=True)
def _write_derivatives(system, t, out):
    """Write the derivatives by the displacement of tool t.

    Its own force f changes by g d - sum over tools u of s_u a_u, with the change a_u of the total force of tool u along
    its direction and the response s_u to a change of its secant factor. The a_u are those of the same equation.
    """
    gram, pull, first = system.gram, system.pull, RIGHT_SIDES * t
    for j in range(3):
        _solve_total_changes(system, first + j)
        for i in range(3):
            value = gram[first + i, first + j]
            for u in range(pull.shape[0]):
                value -= gram[first + i, RIGHT_SIDES * u + 3] * system.secants[u, pull.shape[0]]
            out[12 * t + i, j] = value


@kernel_njit(inner=True)
def _solve_total_changes(system, column):
    """Write the changes of the total forces of the tools by a displacement into the last column of `secants`."""
    gram, pull, table = system.gram, system.pull, system.secants
    tools = pull.shape[0]
    for u in range(tools):
        for w in range(tools + 1):
            side = column if w == tools else RIGHT_SIDES * w + 3
            table[u, w] = 1.0 if u == w else 0.0
            for i in range(3):
                table[u, w] += pull[u, i] * gram[RIGHT_SIDES * u + i, side]
    for u in range(tools):
        for w in range(u + 1, tools):
            factor = table[w, u] / table[u, u]
            for k in range(u, tools + 1):
                table[w, k] -= factor * table[u, k]
    for back in range(tools):
        u = tools - 1 - back
        for w in range(u + 1, tools):
            table[u, tools] -= table[u, w] * table[w, tools]
        table[u, tools] /= table[u, u]


@kernel_njit(inner=True, fastmath={"contract"})
def _eliminate(system, active, first, rows):
    """Eliminate a few unknowns; return False if a pivot is not valid."""
    table, gram = system.table, system.gram
    size, forces = system.numbers[UNKNOWNS], system.numbers[FORCES]
    sides = gram.shape[0]
    end = size + sides
    for k in range(first, min(first + rows, forces)):
        if not _add_compliance(system, active, table, k):
            return False
    for k in range(first, first + rows):
        pivot = table[k, k]
        if pivot == 0.0 or (k >= forces and not pivot < 0.0):
            return False
        for i in range(k + 1, first + rows):
            factor = table[k, i] / pivot
            for j in range(i, end):
                table[i, j] -= factor * table[k, j]
        for i in range(sides):
            for j in range(sides):
                gram[i, j] += table[k, size + i] * table[k, size + j] / pivot
    if rows < PANEL_UNKNOWNS:  # the remaining unknowns
        return True
    a, b, c, d = table[first], table[first + 1], table[first + 2], table[first + 3]
    p, q, r, s = a[first], b[first + 1], c[first + 2], d[first + 3]
    for i in range(first + PANEL_UNKNOWNS, size):
        x, y, z, w, row = a[i] / p, b[i] / q, c[i] / r, d[i] / s, table[i]
        for j in range(i, end):
            row[j] -= x * a[j] + y * b[j] + z * c[j] + w * d[j]
    return True


@kernel_njit(inner=True, fastmath={"contract"})
def _add_compliance(system, active, table, k):
    """Add the surface compliance to a row; return False if it is not stored any more."""
    s, direction, factor = active.slot[system.point[k]], system.direction, system.factor
    x, y, z = direction[k, 0], direction[k, 1], direction[k, 2]
    for j in range(k, system.numbers[FORCES]):
        r = active.slot[system.point[j]]
        if s < 0 or r < 0:
            return False
        block, h = active.matrix[s, r], 0.5 * (factor[k] + factor[j])  # between two tools the mean
        for d in range(3):
            table[k, j] += h * (block[0, d] * x + block[1, d] * y + block[2, d] * z) * direction[j, d]
    for m in range(system.swift.shape[0]):
        pivot, others = system.swift[m, k], system.swift[m]
        for j in range(k, system.numbers[FORCES]):
            table[k, j] -= pivot * others[j]
    return True


@kernel_njit(inner=True)
def _assemble(data):
    """Set up the equations except the surface compliance; return False if there is no room for them."""
    contact, system, modes = data.contact_work, data.system, data.modes
    compliance = data.contact_surface.compliance
    count, numbers, pull = contact.numbers[PAIRS], system.numbers, system.pull
    if not refresh(compliance, contact.active, contact.point, count):
        return False
    pull[:] = 0.0
    for e in range(count):
        for d in range(3):
            pull[contact.tool[e], d] += contact.push[e, d]
    for t in range(pull.shape[0]):
        pull[t, PULL_SIZE] = np.sqrt(pull[t, 0] ** 2 + pull[t, 1] ** 2 + pull[t, 2] ** 2)
        for d in range(3):
            pull[t, d] /= max(pull[t, PULL_SIZE], 1e-300)
    rows = np.int64(0)  # a literal 0 is another type
    for e in range(count):
        rows = _add_directions(data, e, rows)
    numbers[FORCES], numbers[UNKNOWNS], numbers[NEXT_PIVOT] = rows, rows + modes, 0
    size, table = rows + modes, system.table
    for k in range(size):
        for j in range(k, size + system.gram.shape[0]):
            table[k, j] = 0.0
    system.gram[:] = 0.0
    for k in range(rows):
        e, direction, t = system.entry[k], system.direction[k], contact.tool[system.entry[k]]
        softening = 0.0  # pulls do not stiffen the tissue
        if data.tools.kind[t] != BONDED:
            softening = -compliance.stiffening[0] / (compliance.stiffening[1] + pull[t, PULL_SIZE])
        table[k, k], system.swift[:, k], system.factor[k] = system.spring[k], 0.0, contact.active.factor[t]
        side = size + RIGHT_SIDES * t
        for d in range(3):
            for m in range(modes if direction[d] != 0.0 else 0):
                table[k, rows + m] += direction[d] * data.contact_surface.columns[contact.node[e], d, m]
                system.swift[m, k] += data.substep[0] * direction[d] * system.columns[contact.node[e], d, m]
            table[k, side + d] = direction[d]
            table[k, side + 3] += softening * direction[d] * (contact.now[e, d] - contact.modal[e, d])
    for m in range(modes):
        for k in range(m, modes):
            table[rows + m, rows + k] = -0.5 * (data.tangent.matrix[m, k] + data.tangent.matrix[k, m])
    return True


@kernel_njit(inner=True)
def _add_directions(data, e, rows):
    """Append the directions along which the force of a contact pair can change; return the number of rows."""
    contact, tools, system = data.contact_work, data.tools, data.system
    t, push, place = contact.tool[e], contact.push[e], contact.now[e]
    kind, sizes, frame = tools.kind[t], tools.sizes[t], tools.frames[t, 1]
    if kind == BONDED:
        return _add_axes(contact, system, e, rows)
    _, nx, ny, nz = gap(kind, sizes, frame, place[0], place[1], place[2])
    normal = push[0] * nx + push[1] * ny + push[2] * nz
    along = np.sqrt(max(push[0] ** 2 + push[1] ** 2 + push[2] ** 2 - normal * normal, 0.0))
    if normal <= 0.0:
        return rows
    if along < STICK_LIMIT * tools.friction[t] * normal:
        return _add_axes(contact, system, e, rows)
    rows = _add_row(contact, system, e, rows, nx, ny, nz, 0.0)
    s = contact.active.slot[contact.point[e]]
    block = contact.active.matrix[s, s]
    own_compliance = contact.active.factor[t] * (block[0, 0] + block[1, 1] + block[2, 2]) / 3.0
    for curvature, x, y, z in _curvatures(kind, sizes, frame, place, nx, ny, nz):
        if normal * curvature * own_compliance > MIN_CURVATURE:
            rows = _add_row(contact, system, e, rows, x, y, z, -1.0 / (normal * curvature))
    return rows


@kernel_njit(inner=True)
def _add_axes(contact, system, e, rows):
    rows = _add_row(contact, system, e, rows, 1.0, 0.0, 0.0, 0.0)
    rows = _add_row(contact, system, e, rows, 0.0, 1.0, 0.0, 0.0)
    return _add_row(contact, system, e, rows, 0.0, 0.0, 1.0, 0.0)


@kernel_njit(inner=True)
def _add_row(contact, system, e, rows, x, y, z, spring):
    system.direction[rows, 0], system.direction[rows, 1], system.direction[rows, 2] = x, y, z
    system.entry[rows], system.point[rows], system.spring[rows] = e, contact.point[e], spring
    return rows + 1


@kernel_njit(inner=True)
def _curvatures(kind, sizes, frame, place, nx, ny, nz):
    """Return a tool's two principal curvatures [1/m] at a point, each with its direction."""
    ax, ay, az = (0.0, -nz, ny) if abs(nx) < 0.6 else (nz, 0.0, -nx)  # across the normal and an axis
    size = np.sqrt(ax * ax + ay * ay + az * az)
    ax, ay, az = ax / size, ay / size, az / size
    bx, by, bz = ny * az - nz * ay, nz * ax - nx * az, nx * ay - ny * ax
    distance = max(CURVATURE_STEP * sizes[0], 1e-12)
    p, q, r = _normal_derivative(kind, sizes, frame, place, ax, ay, az, distance)
    aa, ab = p * ax + q * ay + r * az, p * bx + q * by + r * bz
    p, q, r = _normal_derivative(kind, sizes, frame, place, bx, by, bz, distance)
    bb = p * bx + q * by + r * bz
    angle = 0.5 * np.arctan2(2.0 * ab, aa - bb)
    c, s = np.cos(angle), np.sin(angle)
    one, other = aa * c * c + 2.0 * ab * c * s + bb * s * s, aa * s * s - 2.0 * ab * c * s + bb * c * c
    return (
        (one, c * ax + s * bx, c * ay + s * by, c * az + s * bz),
        (other, c * bx - s * ax, c * by - s * ay, c * bz - s * az),
    )


@kernel_njit(inner=True)
def _normal_derivative(kind, sizes, frame, place, x, y, z, distance):
    """Return the derivative of a tool's normal along a direction (3) [1/m]."""
    x, y, z = distance * x, distance * y, distance * z
    _, p, q, r = gap(kind, sizes, frame, place[0] + x, place[1] + y, place[2] + z)
    _, a, b, c = gap(kind, sizes, frame, place[0] - x, place[1] - y, place[2] - z)
    return (p - a) / (2.0 * distance), (q - b) / (2.0 * distance), (r - c) / (2.0 * distance)
