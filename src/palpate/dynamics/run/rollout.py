"""Time integration of a model under loads."""

from __future__ import annotations

import os
import traceback
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from palpate.compiled.threads import check_process
from palpate.core.arrays import Floats
from palpate.core.faults import DivergenceError, InputError, TrustWarning, check_call, number_in_range, user_level
from palpate.core.files import shortened
from palpate.dynamics.loads.prepared import Load, PreparedLoads, listed
from palpate.dynamics.run.divergence import deformation_size, diverged
from palpate.dynamics.run.model import Model, Outputs, State
from palpate.dynamics.run.progress import progress_bar
from palpate.dynamics.run.recorder import Recorder
from palpate.dynamics.run.series import NUMBER_NAMES, SERIES
from palpate.dynamics.run.trajectory import Trajectory, check_trajectory_name

MAX_OVERSTEP = 1.2  # longest step that is accepted, over the stable step after it
STEPS_PER_ESTIMATE = 50  # steps between two estimates of the stable step
MIN_RETRY_STEP = 1 / 256  # smallest retry step, as a fraction of the stable step
MAX_DEFORMATION = 100.0  # largest displacement but for rigid motions, in body sizes
MAX_INVERTED = 0.03  # of the cells between nodes: beyond it forces of crushed bodies fall while tools go deeper
MAX_STEP_RATIO = 100  # most steps to a snapshot, relative to their number at the run's first stable step
MAX_FRAMES = 10**6
MAX_STEPS_PER_FRAME = 1e7
MAX_START = 1e9  # largest start time, in frame intervals
MIN_STEP_ULPS = 64  # smallest step, in spacings of floating-point numbers at its time
DEFAULT_MEMORY = 8e9  # [bytes] where the system reports none


@check_call
def rollout(
    model: Model,
    loads: Load | Sequence[Load] = (),
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
    """Integrate a model in time and record snapshots at regular intervals.

    Parameters
    ----------
    model : Model
        Full or reduced.
    loads : load or sequence of loads
    duration, every : float [s]
        Length of the run, and interval between snapshots (at most a million). The first snapshot
        is the initial state.
    start : float [s]
        Time of the initial state, at most 1e9 times `every` from zero, so that times differ in
        double precision.
    displacement, velocity : (n, 3) arrays, optional [m], [m/s]
        Initial state (equations 7 and 8); at rest by default.
    step : float, optional [s]
        Time step. By default the stable step, which is estimated again as the body deforms.
        Rejected steps are retried at half their length, down to 1/256. The remaining energy error
        is in the run's `balance`.
    file : path, optional
        File of the trajectory, ``.h5``. After an interruption it contains all frames until then.
    label : str
        Label of the trajectory.
    progress : bool or function
        True shows a bar on standard error if that is a terminal. A function is called at every
        snapshot with the simulated and the wall time [s] since the start.

    Returns
    -------
    Trajectory
        Forces of tools are means over the frame before, so they are zero in frame 0, also of a run that starts from a
        state in contact.

    Raises
    ------
    DivergenceError
        The state became non-finite, too large or inverted, or requires more than 100 times the
        initial number of steps. The error's `trajectory` contains the frames until then.
    InputError
        An argument is out of range.
    OSError
        The file cannot be written.

    Warns
    -----
    TrustWarning
        Once for an error indicator above 1: the reduced model was not trained on such states.

    Examples
    --------
    >>> import palpate as pt
    >>> cloud = pt.box((0.03, 0.015, 0.015), spacing=0.005)
    >>> tissue = pt.materials.MooneyRivlin(C1=20e3, C2=5e3, density=1000, poisson=0.45)
    >>> bar = pt.Solid(cloud, tissue, fixed="x-")
    >>> pull = pt.SurfaceForce("x+", force=lambda t: (20 * t, 0, 0))
    >>> run = pt.rollout(bar, [pull], duration=0.03, every=0.01)
    >>> run.times.round(6).tolist()
    [0.0, 0.01, 0.02, 0.03]
    >>> run.displacements.shape, sorted(run.reactions)
    ((4, 112, 3), ['x-'])
    """
    check_process()
    if file is not None:
        check_trajectory_name(file, "file")
    frames = _frame_count(model, duration, every, start)
    if step is not None:
        number_in_range("step", step, every / MAX_STEPS_PER_FRAME, every, unit="s")
    prepared = model.prepare(listed(loads))
    with np.errstate(all="ignore"):  # non-finite values raise errors that name them
        state = model.state(prepared, displacement, velocity, float(start))
        work = model.workspace()
        outputs = _initial_outputs(model, state, prepared)
    path = None if file is None else Path(file)
    recorder = Recorder(path, model.name, model.cloud, model.stiffness_damping, label)
    bounds = model.error_bounds
    began = perf_counter()
    try:
        bar = nullcontext(progress) if callable(progress) else progress_bar(model.name, duration, progress)
        with bar as report_progress, np.errstate(all="ignore"):
            recorder.add(start, 0, outputs)
            for present, reached, loads_then, steps, last in frame_states(
                model, state, prepared, frames, every, step, work
            ):
                outputs = present.outputs(reached, loads_then, work)
                _check_outputs(present, reached, loads_then, outputs, last)
                recorder.add(reached.time, steps, outputs)
                report_progress(reached.time - start, perf_counter() - began)
    except DivergenceError as error:
        error.trajectory = recorder.close(perf_counter() - began, complete=False, bounds=bounds)
        stable = np.inf if step is None else model.stable_step(state, prepared, work)[0]
        if step is not None and step > stable:
            error.args = (
                f"step must be at most {stable:.3g} s, the stable one at the start, got {step:.3g} s; omit it, or use "
                "a shorter one",
            )
        raise
    except BaseException:
        recorder.close(perf_counter() - began, complete=False, bounds=bounds)
        raise
    run = recorder.close(perf_counter() - began, complete=True, bounds=bounds)
    _warn_out_of_training(run)
    return run


def frame_states(
    model: Model, state: State, prepared: PreparedLoads, frames: int, every: float, step: float | None, work: Any
) -> Iterator[tuple[Model, State, PreparedLoads, int, float]]:
    """Yield the model, state and loads at every frame after the present one, the number of steps, the last step [s].

    Model and loads are those of the start, unless a blade cuts the body.
    """
    control, start, steps = _StepControl(step, model.longest_step(every)), state.time, 0
    for frame in range(1, frames + 1):
        for time in prepared.breakpoints(state.time, start + frame * every):
            try:
                model, state, prepared, taken, last = _advance_to(model, state, prepared, time, control, work)
            except (ArithmeticError, np.linalg.LinAlgError, SystemError) as error:
                if not _is_own(error):  # of a function that a person has given, such as a load's
                    raise
                what = f"the equations of a step have no solution ({shortened(str(error.__cause__ or error))})"
                raise diverged(model, state, prepared, what, control.last) from error
            steps += taken
        yield model, state, prepared, steps, last
        if state.contact_state is not None:  # contact forces are means over one frame
            state = replace(state, contact_state=state.contact_state.reset_impulses(state.time))


def _is_own(error: BaseException) -> bool:
    """Return whether an error was raised by palpate, or by NumPy or compiled code that it called.

    A parallel loop of compiled code that divides by zero ends in a `SystemError` that this caused.
    """
    if isinstance(error, SystemError) and not isinstance(error.__cause__, ArithmeticError):
        return False
    frames = [frame.f_globals.get("__name__", "") for frame, _ in traceback.walk_tb(error.__traceback__)]
    return frames[-1].partition(".")[0] in ("palpate", "numpy", "scipy")


def _warn_out_of_training(run: Trajectory) -> None:
    """Warn of a run outside the training of its model."""
    if run.trust.max(initial=0.0) <= 1:
        return
    k = int(run.trust.argmax())
    warnings.warn(
        f"the error indicator reached {run.trust[k]:.3g} at t = {run.times[k]:.4g} s, above 1: the model was not "
        "trained on such states; compare the run with the full model's, or train on runs like it",
        TrustWarning,
        stacklevel=user_level(),
    )


@dataclass
class _StepControl:
    """Step lengths [s]: a fixed step, or the longest allowed, and the first and the last stable one."""

    fixed: float | None
    longest: float
    first: float = 0.0
    last: float = 0.0

    def stable_step(self, model: Model, state: State, prepared: PreparedLoads, work: Any) -> tuple[float, State]:
        """Return the fixed step [s], or the stable one, and the state with its estimate."""
        if self.fixed is not None:
            return self.fixed, state
        stable, state = model.stable_step(state, prepared, work)
        stable = min(stable, self.longest)
        self.first, self.last = self.first or stable, stable
        return stable, state

    def max_steps(self, interval: float) -> float:
        """Return the largest number of steps allowed in an interval [s]."""
        return MAX_STEPS_PER_FRAME if self.fixed else MAX_STEP_RATIO * np.ceil(max(interval, self.longest) / self.first)


def _frame_count(model: Model, duration: float, every: float, start: float) -> int:
    """Return the number of snapshots after the first; raise `InputError` for times out of range."""
    duration = number_in_range("duration", duration, 0.0, open_low=True, unit="s")
    every = number_in_range("every", every, 0.0, duration * (1 + 1e-9), open_low=True, unit="s")
    number_in_range("start", start, -MAX_START * every, MAX_START * every, unit="s")
    needed = 2.0 * model.cloud.points.shape[0] * 3 * 8 * duration / every
    if duration / every > MAX_FRAMES or needed > machine_memory():
        raise InputError(
            f"duration / every must be at most {MAX_FRAMES} snapshots and {machine_memory() / 1e6:.3g} MB, "
            f"got {duration / every:.3g} and {needed / 1e6:.3g} MB; use a longer interval or a shorter run"
        )
    return round(duration / every)


def machine_memory() -> float:
    """Return the physical memory [bytes]; 8 GB if the system reports none."""
    try:
        return float(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES"))
    except (AttributeError, ValueError, OSError):
        return DEFAULT_MEMORY


def _initial_outputs(model: Model, state: State, prepared: PreparedLoads) -> Outputs:
    """Return the outputs at the start; attach an empty trajectory to a `DivergenceError`."""
    try:
        outputs = model.outputs(state, prepared)
        _check_outputs(model, state, prepared, outputs, 0.0)
    except DivergenceError as error:
        error.trajectory = Recorder(None, model.name, model.cloud, model.stiffness_damping).close(0.0, complete=False)
        raise
    return outputs


def _advance_to(
    model: Model, state: State, prepared: PreparedLoads, time: float, control: _StepControl, work: Any
) -> tuple[Model, State, PreparedLoads, int, float]:
    """Advance to a time [s]; return the model, state and loads then, the number of steps and the last step [s]."""
    taken, used, share, interval = 0, control.longest, 1.0, time - state.time
    stable = control.last  # of the state after the last steps
    if not stable:
        stable, state = control.stable_step(model, state, prepared, work)
    while time - state.time > 1e-12 * abs(time):
        target = share * stable
        if not target > 0 or (time - state.time) / target > MAX_STEPS_PER_FRAME:
            raise diverged(model, state, prepared, "no step is stable", target)
        if target < MIN_STEP_ULPS * np.spacing(abs(time)):
            raise InputError(
                f"start must be near 0 for steps of {target:.3g} s, got t = {time:g} s; start the run nearer to 0"
            )
        if taken > control.max_steps(interval):
            what = (
                f"the stable step became too small: {taken} steps, {MAX_STEP_RATIO} times those of the first stable "
                f"step, {control.first:.3g} s,"
            )
            raise diverged(model, state, prepared, what, target)
        left = int(np.ceil((time - state.time) / target * (1 - 1e-9)))
        step = (time - state.time) / left
        count = min(left, STEPS_PER_ESTIMATE, model.most_steps(state, prepared, step))
        new, report = model.advance(state, prepared, step, count, work)
        checked, after = control.fixed is None and share > MIN_RETRY_STEP, stable
        accepted = not checked or model.accept_step(state, new, report, work)
        if accepted and np.isfinite(new.coordinates).all():
            reached = replace(new, time=new.time - 0.5 * step)  # with the constraints of these steps
            after, reached = control.stable_step(model, reached, prepared, work)
            new, accepted = replace(reached, time=new.time), not checked or step <= MAX_OVERSTEP * after
        if not accepted:
            share /= 2  # the body is stiffer than at the estimate
            continue
        if not np.isfinite(new.coordinates).all():
            raise diverged(model, state, prepared, "the state became non-finite", step, new)
        share = 1.0 if after < stable else min(1.0, 2 * share)  # a smaller estimate has taken account of it
        stable, taken, used = after, taken + count, step
        model, state, prepared = model.after_steps(new, prepared)
    return model, state, prepared, taken, used


def _check_outputs(model: Model, state: State, prepared: PreparedLoads, outputs: Outputs, step: float) -> None:
    """Raise `DivergenceError` for outputs that are not finite or too large."""
    points, moved = model.cloud.points, outputs.displacements
    most = MAX_DEFORMATION * np.ptp(points, axis=0).max()
    if np.abs(moved).max() > most and deformation_size(points, moved, model.pieces) > most:
        what = f"the body deformed by more than {MAX_DEFORMATION:g} times its size"
        raise diverged(model, state, prepared, what, step)
    if np.isnan(outputs.strain):
        raise diverged(model, state, prepared, "the body turned inside out (J <= 0)", step)
    share = model.inverted_share(state)
    if share > MAX_INVERTED:
        what = f"{share:.1%} of the cells between nodes are turned inside out"
        raise diverged(model, state, prepared, what, step)
    forces = {f"force of {name!r}": force for name, force in outputs.reactions.items()}
    moments = {f"moment of {name!r}": moment for name, moment in outputs.moments.items()}
    energies = {f"{name} energy": getattr(outputs, name) for name in NUMBER_NAMES if SERIES[name].array.unit == "J"}
    fields = {
        "displacement": outputs.displacements,
        "velocity": outputs.velocities,
        "contact_forces": outputs.contact_forces,
    }
    for name, values in {**fields, **energies, **forces, **moments}.items():
        if not np.isfinite(values).all():
            raise diverged(model, state, prepared, f"the {name} became non-finite", step)
