"""Runs of the unreduced linear system, for POD and as a reference of linear reductions."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.sparse.linalg import splu

from palpate.core.arrays import Floats
from palpate.core.faults import InputError, number_in_range
from palpate.dynamics.loads.prepared import Load
from palpate.reduction.lti.inputs import prepare_linear_loads, tool_coordinates
from palpate.reduction.lti.system import LinearSystem


def input_sizes(system: LinearSystem, loads: Sequence[Load], duration: float, samples: int = 2000) -> Floats:
    """Return the largest absolute value (p,) of each input in a run: forces [N], gravity, accelerations of tools."""
    prepared, step = prepare_linear_loads(system, loads), duration / samples
    times: Floats = step * np.arange(-1.0, samples + 2)
    g = tool_coordinates(system, prepared, times)
    bends = np.abs(g[2:] - 2 * g[1:-1] + g[:-2]).max(axis=0) / step**2
    return np.concatenate([np.abs(prepared.inputs(times[1:-1])).max(axis=0), bends])


def linear_run(
    system: LinearSystem, loads: Sequence[Load], *, duration: float, every: float, steps: int = 20
) -> tuple[Floats, Floats, Floats]:
    """Step the linearised body from rest by the trapezium rule, which is stable with any step.

    Parameters
    ----------
    system : LinearSystem
        Linearised at rest.
    loads : sequence of loads
        Those of the system, with their values in time.
    duration, every : float [s]
        Length, and time between snapshots.
    steps : int
        Steps between two snapshots.

    Returns
    -------
    times : (t,) array [s]
    free, whole : (t, n, 3) arrays [m]
        Displacements without the static fields of the tools (`LinearSystem.lifting`), and in total.
    """
    number_in_range("duration", duration, 0.0, open_low=True, unit="s")
    number_in_range("every", every, 0.0, duration * (1 + 1e-9), open_low=True, unit="s")
    if not loads:
        raise InputError("loads must not be empty for a linear run from rest; give a load")
    prepared = prepare_linear_loads(system, loads)
    frames, step = round(duration / every), every / steps
    times: Floats = step * np.arange(-1.0, frames * steps + 2)
    f = prepared.inputs(times[1:-1])
    g = tool_coordinates(system, prepared, times)
    kicks = (g[2:] - 2 * g[1:-1] + g[:-2]) / step
    pushed = f @ system.input.toarray()[:, : system.forces].T
    lift = system.lifts @ system.directions
    solver = splu((system.mass + 0.5 * step * system.damping + 0.25 * step**2 * system.stiffness).tocsc())
    w, v = np.zeros(system.order), np.zeros(system.order)
    kept = [w.copy()]
    for s in range(frames * steps):
        v -= 0.5 * kicks[s] @ lift
        # mean velocity of the step: M (v1 - v0) = h (f - D vm - K (w0 + h/2 vm)), v1 = 2 vm - v0
        right = system.mass @ v + 0.5 * step * (0.5 * (pushed[s] + pushed[s + 1]) - system.stiffness @ w)
        mean = solver.solve(right)
        w, v = w + step * mean, 2 * mean - v
        v -= 0.5 * kicks[s + 1] @ lift
        if (s + 1) % steps == 0:
            kept.append(w.copy())
    free = system.fields(np.array(kept).T)
    return times[1:-1:steps].copy(), free, free + np.tensordot(g[1:-1:steps], system.lifting, 1)
