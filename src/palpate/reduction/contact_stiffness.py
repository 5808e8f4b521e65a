"""How the force on a tool that touches a reduced body rises with its displacement, compiled.

A tool is moved a little, and the forces are found anew with the law of contact that the steps use, the modes following
without inertia along their present tangent: what a hand that moves slowly feels.
"""

from __future__ import annotations

from palpate.dynamics.compiled import kernel_njit
from palpate.reduction.compliance import refresh
from palpate.reduction.stepping import cholesky_factor, cholesky_solve
from palpate.reduction.touch import relax

__all__ = ["contact_stiffness"]

PART = 0.03  # of the deepest dent: by how much the tool is moved
SWEEPS = 12
STEP = 1e-3  # [s] in which the tool moves, for the law of friction


@kernel_njit()
def contact_stiffness(data, q, out):  # type: ignore[no-untyped-def]
    """Write derivatives of the force [N] on the body by the tool's displacement [m] into out (12, 12).

    One column a call, in turn, once all three are known; zero where nothing is touched. Columns stay as they were where
    the modes' tangent is not positive definite.
    """
    touch, count, modes = data.touch, data.touch.numbers[0], data.modes
    for m in range(modes):
        for k in range(modes):
            data.condensed[m, k] = 0.5 * (data.tangent[m, k] + data.tangent[k, m])
    deepest, known = 0.0, False
    for e in range(count):
        for d in range(3):
            deepest = max(deepest, abs(touch.now[e, d] - touch.modal[e, d]))
    for i in range(3):
        known = known or out[i, i] != 0.0
    if deepest == 0.0:
        out[:] = 0.0
        return
    if not cholesky_factor(data.condensed, modes):
        return
    kept = refresh(data.skin.compliance, touch.near, touch.point, count)
    for e in range(count):
        for d in range(3):
            touch.old[0, e, d], touch.old[1, e, d] = touch.now[e, d], touch.push[e, d]
    for column in range(3):
        if known and column != touch.numbers[3]:
            continue
        settled = _moved(data, kept, column, 0.0)
        moved = _moved(data, kept, column, PART * deepest)
        for i in range(3):
            out[i, column] = (moved[i] - settled[i]) / (PART * deepest)
    touch.numbers[3] = (touch.numbers[3] + 1) % 3
    for e in range(count):
        for d in range(3):
            touch.now[e, d], touch.push[e, d] = touch.old[0, e, d], touch.old[1, e, d]


@kernel_njit()
def _moved(data, kept, column, by):  # type: ignore[no-untyped-def]
    """Return the tool's force (3) [N] on the body when it is moved [m] from where it is, all others following."""
    touch, tools, skin, modes = data.touch, data.tools, data.skin, data.modes
    count, response = touch.numbers[0], data.vectors[4]
    for e in range(count):
        for d in range(3):
            touch.now[e, d], touch.push[e, d] = touch.old[0, e, d], touch.old[1, e, d]
    tools.frames[0, 1, column, 3] += by
    for _ in range(SWEEPS):
        for e in range(count):
            for d in range(3):
                touch.old[2, e, d] = touch.push[e, d]
        for e in range(count):
            relax(skin, touch, tools, kept, STEP, e)
        for m in range(modes):
            response[m] = 0.0
        for e in range(count):
            for d in range(3):
                change = touch.push[e, d] - touch.old[2, e, d]
                if change != 0.0:
                    for m in range(modes):
                        response[m] += skin.columns[touch.node[e], d, m] * change
        cholesky_solve(data.condensed, modes, response)
        for e in range(count):
            for d in range(3):
                for m in range(modes):
                    touch.now[e, d] += skin.columns[touch.node[e], d, m] * response[m]
    tools.frames[0, 1, column, 3] -= by
    x, y, z = 0.0, 0.0, 0.0
    for e in range(count):
        x, y, z = x + touch.push[e, 0], y + touch.push[e, 1], z + touch.push[e, 2]
    return x, y, z
