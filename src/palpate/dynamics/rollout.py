"""A run of a model under loads."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import numpy as np
from numpy.typing import NDArray

from palpate.dynamics.loads import Drive, Load
from palpate.dynamics.model import Model, Outputs, State
from palpate.dynamics.progress import progress_bar
from palpate.dynamics.recorder import Recorder
from palpate.dynamics.trajectory import Trajectory
from palpate.faults import DivergenceError, number_in_range

__all__ = ["rollout"]

Floats = NDArray[np.float64]

CHUNK = 50  # steps between two estimates of the stable step
FINEST = 1 / 256  # of the stable step, below which steps that the body does not survive are not tried again
RUNAWAY = 100.0  # displacement in body sizes


def rollout(
    model: Model,
    loads: Sequence[Load] = (),
    *,
    duration: float,
    every: float,
    start: float = 0.0,
    displacement: Floats | None = None,
    velocity: Floats | None = None,
    step: float | None = None,
    file: str | Path | None = None,
    label: str = "",
    progress: bool | Callable[[float, float], None] = True,
) -> Trajectory:
    """Run a model and keep a snapshot at regular times.

    Parameters
    ----------
    model : Model
        Full or reduced.
    loads : sequence of loads
    duration, every : float [s]
        Length of the run, and time between snapshots; the first is the initial state.
    start : float [s]
        Time of the initial state.
    displacement, velocity : (n, 3) arrays, optional [m], [m/s]
        Initial state (equations 7 and 8); at rest by default.
    step : float, optional [s]
        Time step. By default the stable step, which follows the state of the body; steps that a body crushed flat does
        not survive are taken again, half as long, down to 1/256. What energy these still make is in the run's
        `balance`.
    file : path, optional
        File of the trajectory. It holds the frames until then if the run is stopped, whatever stops it.
    label : str
        Of the trajectory.
    progress : bool or function
        Whether to show a bar on standard error when that is a terminal; or a function to call at every snapshot with
        the simulated and the wall time [s] since the start.

    Returns
    -------
    Trajectory

    Raises
    ------
    DivergenceError
        The state became non-finite, ran away or turned inside out. Its `trajectory` holds the frames until then.
    InputError, OSError
        Bad arguments; a file that cannot be written.
    """
    number_in_range("duration", duration, 0.0, open_low=True, unit="s")
    number_in_range("every", every, 0.0, duration * (1 + 1e-9), open_low=True, unit="s")
    if step is not None:
        number_in_range("step", step, 0.0, every, open_low=True, unit="s")
    drive = model.drive(loads)
    state = model.state(drive, displacement, velocity, number_in_range("start", start, unit="s"))
    path = None if file is None else Path(file)
    recorder = Recorder(path, model.name, model.cloud.points, model.viscosity, label)
    frames = round(duration / every)
    began, steps = perf_counter(), 0
    try:
        with nullcontext(progress) if callable(progress) else progress_bar(model.name, duration, progress) as shown:
            recorder.add(start, 0, model.outputs(state, drive))
            for frame in range(1, frames + 1):
                for time in drive.stops(state.time, start + frame * every):
                    state, taken, last = _advance_to(model, state, drive, time, step, every / model.fewest)
                    steps += taken
                outputs = model.outputs(state, drive)
                _check(model, state, drive, outputs, last)
                recorder.add(state.time, steps, outputs)
                if state.touch is not None:  # the next frame's means are of its own interval
                    state = replace(state, touch=state.touch.anew(state.time))
                shown(state.time - start, perf_counter() - began)
    except DivergenceError as error:
        error.trajectory = recorder.close(perf_counter() - began, complete=False)
        raise
    except BaseException:
        recorder.close(perf_counter() - began, complete=False)
        raise
    return recorder.close(perf_counter() - began, complete=True)


def _advance_to(
    model: Model, state: State, drive: Drive, time: float, fixed_step: float | None, longest: float
) -> tuple[State, int, float]:
    taken, used, share = 0, longest, 1.0
    while time - state.time > 1e-12 * abs(time):
        wished = share * min(model.stable_step(state, drive), longest) if fixed_step is None else fixed_step
        if not np.isfinite(wished) or (time - state.time) / wished > 1e9:
            raise _diverged(model, state, drive, "no step is stable", wished)
        left = int(np.ceil((time - state.time) / wished * (1 - 1e-9)))
        step = (time - state.time) / left
        count = min(left, CHUNK)
        new = model.advance(state, drive, step, count)
        if fixed_step is None and share > FINEST and not model.sound(state, new):
            share /= 2  # the body has stiffened since the step was estimated
            continue
        if not np.isfinite(new.coordinates).all():
            raise _diverged(model, state, drive, "the state became non-finite", step)
        state, taken, used, share = new, taken + count, step, min(1.0, 2 * share)
    return state, taken, used


def _check(model: Model, state: State, drive: Drive, outputs: Outputs, step: float) -> None:
    size = np.ptp(model.cloud.points, axis=0).max()
    if np.abs(outputs.displacements).max() > RUNAWAY * size:
        raise _diverged(model, state, drive, f"the body moved more than {RUNAWAY:g} times its size", step)
    if not np.isfinite(outputs.strain):
        raise _diverged(model, state, drive, "the body turned inside out (J <= 0)", step)


def _diverged(model: Model, state: State, drive: Drive, what: str, step: float) -> DivergenceError:
    speed = np.linalg.norm(model.velocity(state, drive), axis=1)
    worst = int(np.argmax(np.where(np.isfinite(speed), speed, np.inf)))
    at = np.array2string(model.cloud.points[worst], precision=4)
    return DivergenceError(
        f"{what} at t = {state.time:.5g} s; fastest node {worst} at {at} m, step {step:.3g} s, "
        f"viscosity {model.viscosity:.3g} s. "
        f"Try more viscosity (viscosity={2 * max(model.viscosity, 1e-5):.2g}), smaller loads, or a finer spacing"
    )
