"""A run of a model under loads."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter

import numpy as np

from palpate.arrays import Floats
from palpate.dynamics.loads.prepared import Load, PreparedLoads, listed
from palpate.dynamics.run.model import Model, Outputs, State
from palpate.dynamics.run.progress import progress_bar
from palpate.dynamics.run.recorder import Recorder
from palpate.dynamics.run.trajectory import Trajectory
from palpate.faults import DivergenceError, InputError, number_in_range

__all__ = ["machine_memory", "rollout"]


CHUNK = 50  # steps between two estimates of the stable step
FINEST = 1 / 256  # of the stable step, below which steps that the body does not survive are not tried again
RUNAWAY = 100.0  # displacement in body sizes
CRAWL = 100  # steps to the next snapshot, over those that the run's first stable step would need
MOST_FRAMES = 10**6
MOST_STEPS = 1e7  # between two snapshots
LATEST = 1e9  # largest start, in times between snapshots
RESOLVED = 64  # least step, in distances between neighbouring floating-point numbers at its time


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
        Length of the run, and time between snapshots, at most a million; the first is the initial state.
    start : float [s]
        Time of the initial state; at most 1e9 times `every` from zero, so that times differ in double precision.
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
        The state became non-finite, ran away or turned inside out, or needs more than 100 times the steps that it
        needed at first. Its `trajectory` holds the frames until then.
    InputError, OSError
        Bad arguments; a file that cannot be written.
    """
    frames = _frames(model, duration, every, start)
    if step is not None:
        number_in_range("step", step, every / MOST_STEPS, every, unit="s")
    prepared = model.prepare(listed(loads))
    with np.errstate(all="ignore"):  # what is not finite is refused by name
        state = model.state(prepared, displacement, velocity, float(start))
        outputs = _initial(model, state, prepared)
    path = None if file is None else Path(file)
    recorder = Recorder(path, model.name, model.cloud.points, model.stiffness_damping, label)
    pace = _Pace(step, every / model.min_steps_per_frame)
    began, steps = perf_counter(), 0
    try:
        shows = nullcontext(progress) if callable(progress) else progress_bar(model.name, duration, progress)
        with shows as shown, np.errstate(all="ignore"):
            recorder.add(start, 0, outputs)
            for frame in range(1, frames + 1):
                for time in prepared.stops(state.time, start + frame * every):
                    state, taken, last = _advance_to(model, state, prepared, time, pace)
                    steps += taken
                outputs = model.outputs(state, prepared)
                _check(model, state, prepared, outputs, last)
                recorder.add(state.time, steps, outputs)
                if state.contact_state is not None:  # the next frame's means are of its own interval
                    state = replace(state, contact_state=state.contact_state.anew(state.time))
                shown(state.time - start, perf_counter() - began)
    except DivergenceError as error:
        error.trajectory = recorder.close(perf_counter() - began, complete=False)
        raise
    except BaseException:
        recorder.close(perf_counter() - began, complete=False)
        raise
    return recorder.close(perf_counter() - began, complete=True)


@dataclass
class _Pace:
    """Lengths of steps [s]: one that is given, or the longest allowed and the first stable one."""

    fixed: float | None
    longest: float
    first: float = 0.0

    def wished(self, model: Model, state: State, prepared: PreparedLoads, share: float) -> float:
        if self.fixed is not None:
            return self.fixed
        stable = min(model.stable_step(state, prepared), self.longest)
        self.first = self.first or stable
        return share * stable

    def most(self, interval: float) -> float:
        """Return the largest number of steps in an interval [s] that is longer than a step."""
        return MOST_STEPS if self.fixed else CRAWL * np.ceil(max(interval, self.longest) / self.first)


def _frames(model: Model, duration: float, every: float, start: float) -> int:
    """Return the number of snapshots after the first, or raise `InputError` for times that make no run."""
    duration = number_in_range("duration", duration, 0.0, open_low=True, unit="s")
    every = number_in_range("every", every, 0.0, duration * (1 + 1e-9), open_low=True, unit="s")
    number_in_range("start", start, -LATEST * every, LATEST * every, unit="s")
    needed = 2.0 * model.cloud.points.shape[0] * 3 * 8 * duration / every
    if duration / every > MOST_FRAMES or needed > machine_memory():
        raise InputError(
            f"every = {every:g} s in {duration:g} s makes {duration / every:.3g} snapshots of {needed / 1e6:.3g} MB: "
            f"allowed are {MOST_FRAMES} and {machine_memory() / 1e6:.3g} MB; keep fewer, or run shorter"
        )
    return round(duration / every)


def machine_memory() -> float:
    """Return the memory of this machine [bytes]; 8 GB where the system does not say."""
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, ValueError, OSError):
        return 8e9


def _initial(model: Model, state: State, prepared: PreparedLoads) -> Outputs:
    """Return the outputs at the start, or raise `DivergenceError` with a trajectory without frames."""
    try:
        outputs = model.outputs(state, prepared)
        _check(model, state, prepared, outputs, 0.0)
    except DivergenceError as error:
        error.trajectory = Recorder(None, model.name, model.cloud.points, model.stiffness_damping).close(
            0.0, complete=False
        )
        raise
    return outputs


def _advance_to(
    model: Model, state: State, prepared: PreparedLoads, time: float, pace: _Pace
) -> tuple[State, int, float]:
    taken, used, share, interval = 0, pace.longest, 1.0, time - state.time
    while time - state.time > 1e-12 * abs(time):
        wished = pace.wished(model, state, prepared, share)
        if not wished > 0 or (time - state.time) / wished > MOST_STEPS:
            raise _diverged(model, state, prepared, "no step is stable", wished)
        if wished < RESOLVED * np.spacing(abs(time)):
            raise InputError(f"t = {time:g} s is too far from 0 for steps of {wished:.3g} s: start the run nearer to 0")
        if taken > pace.most(interval):
            what = f"the run crawls: {taken} steps, {CRAWL} times those of the first stable step, {pace.first:.3g} s,"
            raise _diverged(model, state, prepared, what, wished)
        left = int(np.ceil((time - state.time) / wished * (1 - 1e-9)))
        step = (time - state.time) / left
        count = min(left, CHUNK)
        new = model.advance(state, prepared, step, count)
        if pace.fixed is None and share > FINEST and not model.accept_step(state, new):
            share /= 2  # the body has stiffened since the step was estimated
            continue
        if not np.isfinite(new.coordinates).all():
            raise _diverged(model, state, prepared, "the state became non-finite", step, new)
        state, taken, used, share = new, taken + count, step, min(1.0, 2 * share)
    return state, taken, used


def _check(model: Model, state: State, prepared: PreparedLoads, outputs: Outputs, step: float) -> None:
    """Refuse what must not be kept: a snapshot that is not finite, or of a body that ran away."""
    size = np.ptp(model.cloud.points, axis=0).max()
    if np.abs(outputs.displacements).max() > RUNAWAY * size:
        raise _diverged(model, state, prepared, f"the body moved more than {RUNAWAY:g} times its size", step)
    if np.isnan(outputs.strain):
        raise _diverged(model, state, prepared, "the body turned inside out (J <= 0)", step)
    forces = {f"force of {name!r}": force for name, force in outputs.reactions.items()}
    moments = {f"moment of {name!r}": moment for name, moment in outputs.moments.items()}
    energies = {f"{name} energy": getattr(outputs, name) for name in ("kinetic", "strain", "external", "dissipated")}
    fields = {
        "displacement": outputs.displacements,
        "velocity": outputs.velocities,
        "contact_forces": outputs.contact_forces,
    }
    for name, values in {**fields, **energies, **forces, **moments}.items():
        if not np.isfinite(values).all():
            raise _diverged(model, state, prepared, f"the {name} became non-finite", step)


def _diverged(
    model: Model, state: State, prepared: PreparedLoads, what: str, step: float, after: State | None = None
) -> DivergenceError:
    """Return the error of a run at a state; with the state `after` it, name a node that is not finite there."""
    node, which = _worst(model, state if after is None else after, prepared)
    if node is None:
        node, which = _worst(model, state, prepared)
    where = "all nodes at once"
    if node is not None:
        where = f"{which} node {node} at {np.array2string(model.cloud.points[node], precision=4)} m"
    return DivergenceError(
        f"{what} at t = {state.time:.5g} s; {where}, step {step:.3g} s, stiffness damping {model.stiffness_damping:.3g} s. "
        f"Try more damping (stiffness_damping={2 * max(model.stiffness_damping, 1e-5):.2g}), smaller loads, or a finer "
        "spacing"
    )


def _worst(model: Model, state: State, prepared: PreparedLoads) -> tuple[int | None, str]:
    """Return the first node that is not finite, or else the fastest; none where all are the same."""
    velocity = model.velocity(state, prepared)
    bad = ~np.isfinite(np.column_stack([model.displacement(state, prepared), velocity])).all(axis=1)
    if bad.all():
        return None, ""
    if bad.any():
        return int(np.argmax(bad)), "first non-finite"
    speed = np.abs(velocity).max(axis=1)
    return int(np.argmax(speed)), "fastest"
