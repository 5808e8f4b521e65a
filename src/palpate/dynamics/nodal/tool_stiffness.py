"""Contact stiffness of the tools of a full body in the engine, from their ways and forces, compiled.

Between two calls the tools move by s and their forces change by y. Powell's symmetric Broyden update (in Nonlinear
Programming, Academic Press 1970) is the matrix nearest to the last one with K s = y. It holds along the directions in
which the tools have moved. A pair s, y counts only where it is above the noise:

- The tools have moved by more than `MIN_WAY`, which is the accuracy of places in a period.
- The work s . y / 2 is more than `NOISE_RATIO` R times the kinetic energy E of the body at both ends, of which
  `UNREST_TIME` keeps the largest. A vibration of that energy changes the force on a tool of stiffness k by at most
  sqrt(2 k E). So the error of the slope is at most R^-1/2 of it.

Ways begin at a calmer place as soon as there is one: after a fast motion no later one would be above its noise.

A force that falls as a tool moves on, beyond the noise, means no stiffness along that way. An update fades what was
known before by exp(-|s| / a), with the radius a of the contact: a tool that has moved on touches other tissue.

The stiffness of each tool is symmetric, without negative eigenvalues, and at most that of the tissue,

    k <= (w / w0)^2 (2 E* a + sum over the nodes in contact of M A / h),    E* = E / (1 - nu^2).

The first part is that of a rigid punch of radius a on a half-space (Hertz; Johnson, Contact Mechanics, 1985, section
3.4), and of a ball whose contact has that radius. The second is that of columns of the cross section A = pi a^2 / n
under uniaxial strain, from each of n nodes to the nearest support or other tool at a distance h: springs parallel to
the half-space. The ratio of the highest frequencies now and at rest is that of the stiffening. Nodes that supports hold
add their own stiffness (`palpate.dynamics.contact.held`).
"""

from __future__ import annotations

import numpy as np

from palpate.compiled.jit import kernel_njit
from palpate.dynamics.contact.stiffness import limit_stiffness
from palpate.dynamics.nodal.period_data import ESTIMATE, RECENT_ENERGY

MIN_WAY = 0.02  # of the tools between two updates, in spacings
NOISE_RATIO = 10.0  # least work of a change of force over the kinetic energy
CALMER_SHARE = 0.5  # of the kinetic energy at the last place, below which the next ways begin at the present one


@kernel_njit()
def contact_stiffness(data, q, out):
    """Write the contact stiffness of each tool into the first three rows and columns of its part of out (12 t, 12).

    It is zero without contact.
    """
    secant, tools = data.tools.secant, data.tools.path.shape[0]
    touches, same = False, True
    for t in range(tools):
        touching, touched = _is_pushed(data.tools.force, 12 * t), _is_pushed(secant.forces, 3 * t)
        touches, same = touches or touching, same and touching == touched
        _write_way(data, t, touching)
        _write_bound(data, q.reshape((q.shape[0] // 3, 3)), t, touching)
    calmer = data.energies[RECENT_ENERGY] < CALMER_SHARE * secant.unrest[0]
    if not touches or not same or _follow(data) or calmer:
        secant.unrest[0] = data.energies[RECENT_ENERGY]
        for i in range(3 * tools):
            secant.positions[i] = _place(data, i)
            secant.forces[i] = data.tools.force[12 * (i // 3) + i % 3]
    _limit(secant)
    for i in range(out.shape[0]):
        for j in range(out.shape[1]):
            t, row = i // 12, i % 12
            out[i, j] = secant.stiffness[3 * t + row, 3 * t + j] if row < 3 and j < 3 else 0.0


@kernel_njit(inline="always")
def _is_pushed(forces, first):
    """Return whether the three forces from an index on have one that is not zero."""
    return forces[first] != 0.0 or forces[first + 1] != 0.0 or forces[first + 2] != 0.0


@kernel_njit(inline="always")
def _place(data, i):
    """Return coordinate i of the positions of the tools in the last step, of which the forces are."""
    return data.tools.contacts.work.frames[i // 3, 1, i % 3, 3]


@kernel_njit(inner=True)
def _write_way(data, t, touching):
    """Write the way of a tool since the last update, zero for one that does not touch."""
    secant = data.tools.secant
    for i in range(3 * t, 3 * t + 3):
        secant.way[i] = _place(data, i) - secant.positions[i] if touching else 0.0


@kernel_njit(inner=True)
def _write_bound(data, u, t, touching):
    """Write the contact radius of a tool and the largest stiffness; zero for one that does not touch."""
    secant, contact, held = data.tools.secant, data.contact_work, data.tools.contacts.held
    points, count, spread = data.tools.contacts.patches.points, 0, 0.0
    secant.radius[t], secant.bound[t] = 0.5 * secant.spacing, 0.0
    if not touching:
        return
    for d in range(3):
        count, mean, square = 0, 0.0, 0.0
        for k in range(contact.numbers[0]):
            if contact.tool[k] == t:
                x = points[contact.node[k], d] + u[contact.node[k], d]
                count, mean, square = count + 1, mean + x, square + x * x
        if count > 0:
            spread += max(0.0, square / count - (mean / count) ** 2)
    # of a disc with these second moments: the mean squared distance from its centre is half of its squared radius
    radius = 0.5 * secant.spacing + np.sqrt(2.0 * spread)
    bound, area = 2.0 * secant.plane_modulus * radius, np.pi * radius**2 / max(count, 1)
    for k in range(contact.numbers[0]):
        if contact.tool[k] == t:
            bound += secant.uniaxial_modulus * area / _support_distance(data, u, contact.node[k], t)
    if held.energy[t] > 0.0:
        for k in range(held.stiffness.shape[0]):
            bound += held.stiffness[k] if _is_pushed(held.forces[k], 0) else 0.0
    stiffening = max(1.0, data.stepping[ESTIMATE] / data.body.resting_frequency)
    secant.radius[t], secant.bound[t] = radius, stiffening**2 * bound


@kernel_njit(inner=True)
def _support_distance(data, u, node, t):
    """Return the distance [m] from a node to the nearest supported node or node under another tool."""
    secant, contact, points = data.tools.secant, data.contact_work, data.tools.contacts.patches.points
    nearest, supports = np.inf, secant.supports.shape[0]
    for k in range(supports + contact.numbers[0]):
        if k >= supports and contact.tool[k - supports] == t:
            continue
        i, square = secant.supports[k] if k < supports else contact.node[k - supports], 0.0
        for d in range(3):
            square += (points[i, d] + u[i, d] - points[node, d] - u[node, d]) ** 2
        nearest = min(nearest, square)
    return max(0.5 * secant.spacing, np.sqrt(nearest))


@kernel_njit(inner=True)
def _follow(data):
    """Update the matrix by the ways since the last update; return False where they are within the noise."""
    secant, forces = data.tools.secant, data.tools.force
    count, square, work, farthest = secant.way.shape[0], 0.0, 0.0, 0.0
    for t in range(count // 3):
        of_tool = 0.0
        for i in range(3 * t, 3 * t + 3):
            of_tool += secant.way[i] ** 2
            work += 0.5 * secant.way[i] * (forces[12 * t + i - 3 * t] - secant.forces[i])
        square, farthest = square + of_tool, max(farthest, np.sqrt(of_tool) / secant.radius[t])
        secant.fade[t] = np.exp(-0.5 * np.sqrt(of_tool) / secant.radius[t])
    if not square > (MIN_WAY * secant.spacing) ** 2:
        return False
    noise = NOISE_RATIO * (secant.unrest[0] + data.energies[RECENT_ENERGY])
    if not abs(work) > noise and not farthest > 1.0:
        return False
    for i in range(count):
        for j in range(count):
            secant.stiffness[i, j] *= secant.fade[i // 3] * secant.fade[j // 3]
    if abs(work) > noise:
        _update(secant, forces, 1.0 if work > 0.0 else 0.0, square)
    return True


@kernel_njit(inner=True)
def _update(secant, forces, share, square):
    """Give the matrix the secant of a share of the change of force, for ways of a squared length."""
    matrix, way, excess, count, along = secant.stiffness, secant.way, secant.excess, secant.way.shape[0], 0.0
    for i in range(count):  # the change of force that the present matrix does not explain
        excess[i] = share * (forces[12 * (i // 3) + i % 3] - secant.forces[i])
        for j in range(count):
            excess[i] -= matrix[i, j] * way[j]
        along += excess[i] * way[i]
    for i in range(count):
        for j in range(i, count):
            change = excess[i] * way[j] + way[i] * excess[j] - along * way[i] * way[j] / square
            matrix[i, j] += change / square
            matrix[j, i] = matrix[i, j]


@kernel_njit(inner=True)
def _limit(secant):
    """Limit the stiffness of each tool; between two tools it is at most the geometric mean of theirs."""
    matrix = secant.stiffness
    for t in range(secant.bound.shape[0]):
        block = matrix[3 * t : 3 * t + 3, 3 * t : 3 * t + 3]
        limit_stiffness((block[0], block[1], block[2]), secant.bound[t])
    for i in range(matrix.shape[0]):
        for j in range(matrix.shape[0]):
            if i // 3 != j // 3:
                largest = np.sqrt(max(0.0, matrix[i, i]) * max(0.0, matrix[j, j]))
                matrix[i, j] = min(max(matrix[i, j], -largest), largest)
