"""Contact of rigid tools with nodes that a support holds, compiled.

A held node does not move, so no displacement keeps a tool out of it. The tissue between the surface and the
support gives the tool a force instead. A node of mass m between fixed neighbours has the stiffness and the
impedance

    k = m (c / h)^2,    z = s m c / h,    s = 20,

with the speed c of the fastest waves and the spacing h: c / h is half of the body's highest frequency. A tool
that is a depth d inside the node pushes it with k d along the tool's normal, and the support bears the force.
Sliding is resisted by z times its speed, at most mu times the normal force (Coulomb). So friction is Coulomb's
at speeds above mu d c / (s h), some centimetres per second, and slower tools creep. The mean depth of a
step makes the work of a normal push equal the change of the energy k d^2 / 2. The forces do not depend on
what the body does, so the stable step is unchanged.
"""

from __future__ import annotations

import numpy as np

from palpate.compiled.jit import kernel_njit
from palpate.dynamics.contact.geometry import coulomb, gap, material_velocity
from palpate.dynamics.contact.kinds import BLADE, BONDED, CAPSULE


@kernel_njit()
def press_held_nodes(held, kinds, sizes, friction, frames, step, kick, tool_impulses):
    """Push held nodes with the tools that enter them in a step [s], for a time `kick` [s].

    `kinds` (t,), `sizes` (t, 3) and `friction` (t,) are those of the tools, whose `frames` (t, 2, 3, 4) are before and
    after the step. Adds impulses [N s] and moments about the tools' origins [N m s] to `tool_impulses` (t, 6). Returns
    the work of the tools and the part that friction dissipates [J].
    """
    work, lost = 0.0, 0.0
    held.forces[:] = 0.0
    held.energy[:] = 0.0
    held.pushes[:] = 0.0
    for t in range(kinds.shape[0]):
        if kinds[t] == BONDED or kinds[t] == BLADE or sizes[t, 0] == -np.inf:  # the last are absent tools
            continue
        before, after, origin = frames[t, 0], frames[t, 1], frames[t, 1, :, 3]
        far = sizes[t, 0] + sizes[t, 1] if kinds[t] == CAPSULE else np.inf
        way = abs(after[0, 3] - before[0, 3]) + abs(after[1, 3] - before[1, 3]) + abs(after[2, 3] - before[2, 3])
        for k in range(held.nodes.shape[0]):
            x, y, z = held.points[k, 0], held.points[k, 1], held.points[k, 2]
            square = (x - origin[0]) ** 2 + (y - origin[1]) ** 2 + (z - origin[2]) ** 2
            if not held.reach[t, k] or not np.sqrt(square) < far + way:
                continue
            g, nx, ny, nz = gap(kinds[t], sizes[t], after, x, y, z)
            first, mx, my, mz = gap(kinds[t], sizes[t], before, x, y, z)
            first, last = max(-first, 0.0), max(-g, 0.0)
            if last == 0.0:
                nx, ny, nz = mx, my, mz
            size = 0.5 * held.stiffness[k] * (first + last)
            held.energy[t] += 0.5 * held.stiffness[k] * last**2
            if size == 0.0:
                continue
            speed, push = material_velocity(before, after, step, x, y, z), held.forces[k]
            c = held.impedance[k]
            px, py, pz = coulomb(size / c, friction[t], -speed[0], -speed[1], -speed[2], nx, ny, nz)
            force = c * px + size * nx, c * py + size * ny, c * pz + size * nz
            held.pushes[t] += np.sqrt(force[0] ** 2 + force[1] ** 2 + force[2] ** 2)
            power = force[0] * speed[0] + force[1] * speed[1] + force[2] * speed[2]
            work += kick * power
            lost += kick * (power - 0.5 * held.stiffness[k] * (last**2 - first**2) / step)
            place = x - origin[0], y - origin[1], z - origin[2]
            for d in range(3):
                a, b = (d + 1) % 3, (d + 2) % 3
                push[d] += force[d]
                held.impulses[k, d] += kick * force[d]
                tool_impulses[t, d] += kick * force[d]
                tool_impulses[t, 3 + d] += kick * (place[a] * force[b] - place[b] * force[a])
    return work, lost
