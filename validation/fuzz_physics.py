"""Draw bodies, loads and runs at random: each is refused by name, or runs to finite numbers.

Kinds of trials:

- ``full``: extreme values. They are log-uniform over all of double precision, or zero, negative, infinite, not a
  number, or ordinary. Anything else than `palpate.InputError`, `palpate.DivergenceError` or a finite trajectory raises.
- ``reduced``: a reduced bar with ordinary values, under loads up to ten times those of its training. Its run ends, and
  takes at most 1.2 times the steps of a run without the check of energy, unless that gains energy.
- ``tools``: a reduced block under a tool that presses, slides or pulls where no training run did. Its run ends.
- ``engine``: the periods of the same block under poses that wander and jump, as the engine limits them. All are finite.

    python validation/fuzz_physics.py --trials 500 --seed 0 [--kind full reduced tools engine]
"""

from __future__ import annotations

import argparse
import warnings
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache
from time import perf_counter
from typing import Any

import numpy as np

import palpate as pt
from palpate.dynamics.run.model import Model

SIZE, SPACING = 0.015, 0.005  # [m] 64 nodes
STEPS, FRAMES = 100, 3  # of an ordinary run
MAX_SECONDS = 30.0  # [s] of a trial, after kernels are compiled
ASKED = 10 * STEPS * FRAMES  # stable steps of a run above which it may take longer: it is ended, and counts as one
ODD = (0.0, -0.0, 5e-324, 1e308, np.inf, -np.inf, np.nan)
BLOCK, BLOCK_SPACING, BALL = (0.042, 0.042, 0.024), 0.006, 0.012  # [m]
MAX_STEPS = 1.2  # of a run whose steps are checked, over those of a run without the check
MAX_GAIN = 0.05  # error of the energy balance that makes a repeated step right, over the largest energy
SERIES = ("times", "displacements", "velocities", "kinetic", "strain", "external", "dissipated")


class TooLong(Exception):
    """A trial took longer than it may."""


def trial(rng: np.random.Generator) -> str:
    """Run one trial of extreme values.

    Parameters
    ----------
    rng : Generator

    Returns
    -------
    str
        ``"refused"`` or ``"ran"``.

    Raises
    ------
    TooLong
        It took more than 30 s, without having been asked for many steps.
    AssertionError
        A trajectory holds a number that is not finite.
    Exception
        Whatever else escapes from palpate.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RuntimeWarning)  # a number left its range, and nobody looked
            warnings.filterwarnings("ignore", "stiffness_damping of .* makes the stable step", RuntimeWarning)
            run = _run(_Draw(rng))
    except pt.DivergenceError as error:
        _check(error.trajectory)
        return "refused"
    except pt.InputError:
        return "refused"
    except _Enough:
        return "ran"
    _check(run)
    return "ran"


def reduced_trial(rng: np.random.Generator) -> str:
    """Run a reduced bar under random loads, with and without the check of its steps.

    Raises
    ------
    AssertionError
        The check repeats good steps, or a trajectory holds a number that is not finite.
    Exception
        Whatever else escapes, `palpate.DivergenceError` included.
    """
    C1, poisson = float(10 ** rng.uniform(3, 4.8)), float(rng.choice([0.3, 0.45, 0.49]))
    prony = pt.materials.Prony(shares=[0.3, 0.2], times=[0.01, 0.1]) if rng.random() < 0.25 else None
    tissue = pt.materials.NeoHookean(C1=C1, density=1000.0, poisson=poisson, prony=prony)
    width = float(rng.choice([0.015, 0.02]))
    cloud = pt.box((float(rng.choice([0.03, 0.05])), width, width), SPACING)
    damping = float(rng.choice([0.0, 2e-6, 2e-5, 1e-4, 1e-3]))
    body = pt.Solid(cloud, tissue, "x-", stiffness_damping=damping)
    held: list[Any] = [pt.Foundation("y-", stiffness=1e5, damping=100.0)] if rng.random() < 0.25 else []
    force = C1 * width**2 * rng.uniform(0.1, 1.0)
    pull = pt.SurfaceForce("x+", force=lambda t: (force * min(1.0, t / 0.02) if t < 0.04 else 0.0, 0.0, 0.0))
    run = pt.rollout(body, [pull, *held], duration=0.08, every=0.002, progress=False)
    model = pt.hyper_reduce(body, run, modes=int(rng.choice([2, 4, 8])))
    size = force * 10 ** rng.uniform(-1.0, 1.0)
    course = (
        lambda t: (size if t < 0.05 else 0.0, 0.0, 0.0),
        lambda t: (0.0, size, 0.0),
        lambda t: (size * np.sin(900 * t), 0.2 * size * np.cos(500 * t), 0.1 * size),
        lambda t: (size * np.sin(60 * t) ** 2, 0.0, 0.0),
    )[rng.integers(4)]
    loads = [pt.SurfaceForce("x+", force=course), *held]
    times = {"duration": 0.2, "every": float(rng.choice([0.001, 0.002, 0.005, 0.01])), "progress": False}
    checked = pt.rollout(model, loads, **times)
    _check(checked)
    with _unchecked_steps(), np.errstate(all="ignore"):
        free = pt.rollout(model, loads, **times)
    largest = max(free.external.max(), (free.kinetic + free.strain).max())
    gained = np.abs(free.balance).max() > MAX_GAIN * largest
    assert gained or checked.steps[-1] <= MAX_STEPS * free.steps[-1], (
        f"{checked.steps[-1]:.0f} steps in place of {free.steps[-1]:.0f}"
    )
    return "ran"


@contextmanager
def _unchecked_steps() -> Iterator[None]:
    """Accept all finite steps of reduced models."""
    check = pt.ReducedModel.accept_step
    pt.ReducedModel.accept_step = Model.accept_step  # type: ignore[method-assign]
    try:
        yield
    finally:
        pt.ReducedModel.accept_step = check  # type: ignore[method-assign]


@cache
def _block(relaxes: bool, damping: float) -> pt.ReducedModel:
    """Return a block, reduced to 12 modes with two presses of a ball from above."""
    prony = pt.materials.Prony(shares=[0.3, 0.2], times=[0.01, 0.1]) if relaxes else None
    tissue = pt.materials.NeoHookean(C1=2e3, density=1000.0, poisson=0.45, prony=prony)
    body = pt.Solid(pt.box(BLOCK, BLOCK_SPACING), tissue, "z-", stiffness_damping=damping)
    runs = [
        pt.rollout(body, [_ball(lambda t, x=x: _press(x, t))], duration=0.12, every=0.005, progress=False)
        for x in (0.016, 0.026)
    ]
    return pt.hyper_reduce(body, runs, modes=12)


def _ball(motion: Any, radius: float = BALL) -> pt.tools.Contact:
    return pt.tools.Contact(pt.tools.Sphere(radius), motion)


def _press(x: float, time: float) -> tuple[float, float, float]:
    share = np.sin(np.pi * min(time / 0.12, 1.0)) ** 2
    return x, 0.021, BLOCK[2] + BALL + 0.001 - 0.004 * share


def _random_block(rng: np.random.Generator) -> pt.ReducedModel:
    return _block(bool(rng.random() < 0.4), float(rng.choice([1e-5, 1e-4, 1e-3])))


def tools_trial(rng: np.random.Generator) -> str:
    """Run a reduced block under a tool with a random path.

    Raises
    ------
    Exception
        Whatever escapes, `palpate.DivergenceError` included.
    """
    model = _random_block(rng)
    start = np.array([*rng.uniform(0.0, BLOCK[0], 2), BLOCK[2] + 0.012])
    across, depth = rng.uniform(-0.01, 0.01, 2), rng.uniform(0.001, 0.006)
    lasting = rng.uniform(0.02, 0.2)

    def path(time: float) -> tuple[float, float, float]:
        share = np.sin(np.pi * min(time / lasting, 1.0)) ** 2
        x, y = start[:2] + share * across
        return float(x), float(y), float(start[2] + 0.001 - share * (depth + 0.001))

    kind = rng.integers(4)
    if kind == 3:
        middle = (float(rng.uniform(0.01, 0.032)), float(rng.uniform(0.01, 0.032)), BLOCK[2])
        motion = lambda time: np.array([*across, depth]) * np.sin(np.pi * min(time / lasting, 1.0)) ** 2  # noqa: E731
        load: Any = pt.tools.Grasp(middle, 0.006, motion, until=0.8 * lasting)
    else:
        shape = (pt.tools.Sphere(0.012), pt.tools.Capsule(0.012, 0.02), pt.tools.Sphere(0.012))[kind]
        load = pt.tools.Contact(shape, path, friction=float(rng.choice([0.0, 0.5])))
    every = float(rng.choice([0.001, 0.005, 0.01]))
    try:
        _check(pt.rollout(model, [load], duration=max(1.2 * lasting, every), every=every, progress=False))
    except pt.InputError:
        return "refused"
    return "ran"


def engine_trial(rng: np.random.Generator) -> str:
    """Take 400 periods of a reduced block under a tool that wanders and jumps.

    Raises
    ------
    AssertionError
        A period fails, or a force is not finite.
    """
    model = _random_block(rng)
    home = np.array([*rng.uniform(0.0, BLOCK[0], 2), BLOCK[2] + BALL + 0.001])
    made = pt.realtime_model(model, contact=_ball(tuple(home)))
    q, v, report = np.zeros(len(made.rest)), np.zeros(len(made.rest)), np.zeros(8 + len(made.tool))
    pose, aim, speed = np.zeros(3), np.zeros(3), float(rng.choice([0.1, 0.5, 2.0]))
    for k in range(400):
        if k % 25 == 0:
            aim = rng.uniform([-0.02, -0.02, -0.012], [0.02, 0.02, 0.01])
        way = aim - pose
        pose = pose + way * min(1.0, 1e-3 * speed / max(float(np.linalg.norm(way)), 1e-12))
        made.advance(made.data, q, v, np.concatenate([pose, np.zeros(9)]), 1e-3, report)
        assert report[0] == 0, f"period {k} fails"
        assert all(np.isfinite(each).all() for each in (report, q, v)), f"period {k} is not finite"
    return "ran"


TRIALS = {"full": trial, "reduced": reduced_trial, "tools": tools_trial, "engine": engine_trial}


class _Enough(Exception):
    """A run that is long because it was asked to be is left."""


class _Draw:
    """Values of a trial: one to three of them are extreme, the others ordinary."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.rng = rng
        self.share = rng.choice([0.03, 0.1, 0.3])

    def __call__(self, ordinary: float) -> float:
        return self.extreme() if self.rng.random() < self.share else ordinary

    def extreme(self) -> float:
        kind = self.rng.integers(4)
        if kind == 0:
            return float(self.rng.choice(ODD))
        exponent = self.rng.uniform(-323.0, 308.0) if kind == 1 else self.rng.uniform(-12.0, 12.0)
        return float(self.rng.choice([1.0, -0.5]) * 10.0**exponent)

    def vector(self, *ordinary: float) -> tuple[float, ...]:
        return tuple(self(value) for value in ordinary)

    def one_of(self, *choices: Any) -> Any:
        return choices[self.rng.integers(len(choices))]


def _run(draw: _Draw) -> pt.Trajectory:
    plane = draw.rng.random() < 0.2
    model = _sheet(draw) if plane else _solid(draw)
    every = STEPS * model.stability.step
    times: dict[str, Any] = {"duration": draw(FRAMES * every), "every": draw(every), "start": draw(0.0)}
    if draw.rng.random() < 0.2:
        times["step"] = draw(every / STEPS)
    for name, size in (("displacement", 1e-5), ("velocity", 1e-3)):
        if draw.rng.random() < 0.2:
            field = size * draw.rng.standard_normal((len(model.cloud), 3))
            field[draw.rng.integers(len(field))] = draw.vector(size, 0.0, 0.0)
            times[name] = field
    loads = _loads(draw, plane)
    with np.errstate(all="ignore"):
        ready = model.prepare(loads)
        stable = model.stable_step(model.state(ready), ready)[0]
    long = times["duration"] > ASKED * min(stable, times.get("step", np.inf))
    watched = _watched(draw.vector(0.0, 0.0, -9.81), _Enough if long else TooLong)
    return pt.rollout(model, [watched, *loads], **times, progress=False)


def _watched(acceleration: tuple[float, ...], late: type[Exception]) -> pt.Gravity:
    """Return a gravity that looks at the clock whenever it is evaluated."""
    end = perf_counter() + MAX_SECONDS * (0.1 if late is _Enough else 1.0)

    def at(time: float) -> tuple[float, ...]:
        if perf_counter() > end:
            raise late
        return acceleration

    return pt.Gravity(at)


def _solid(draw: _Draw) -> pt.Solid:
    cloud = pt.box((draw(SIZE), SIZE, SIZE), draw(SPACING))
    if len(cloud) > 1000:
        raise pt.InputError("too many nodes for a trial")
    if draw.rng.random() < 0.1:
        with np.errstate(all="ignore"):
            cloud = replace(cloud, points=cloud.points * draw(1.0), volumes=cloud.volumes * draw(1.0))
    density = draw(1000.0)
    compressible: dict[str, float] = {"poisson": draw(0.45)} if draw.rng.random() < 0.8 else {"bulk": draw(1e5)}
    if draw.rng.random() < 0.5:
        material: Any = pt.materials.NeoHookean(C1=draw(5e3), density=density, **compressible)
    else:
        material = pt.materials.MooneyRivlin(C1=draw(8e3), C2=draw(2e3), density=density, **compressible)
    form = draw.one_of("strong", "energy")
    options: dict[str, Any] = {"stiffness_damping": draw(6e-5)} if draw.rng.random() < 0.7 else {}
    if form == "energy" and draw.rng.random() < 0.1:
        options["stiffness"] = {"x+": draw(2.0)}
    return pt.Solid(cloud, material, draw.one_of("x-", "x-", ()), form=form, **options)


def _sheet(draw: _Draw) -> pt.Membrane:
    cloud = pt.disc(draw(0.1), draw(0.025))
    if len(cloud) > 1000:
        raise pt.InputError("too many nodes for a trial")
    material = pt.materials.NeoHookean(C1=draw(1e5), density=draw(1000.0), poisson=0.5)
    options = {"stiffness_damping": draw(1e-5)} if draw.rng.random() < 0.3 else {}
    return pt.Membrane(cloud, material, draw(1e-4), "rim", prestretch=draw(1.1), **options)


def _loads(draw: _Draw, plane: bool) -> list[Any]:
    group = "rim" if plane else "x+"
    loads: list[Any] = []
    kind = draw.one_of("force", "moment", "pressure", "motion", "foundation", "contact", "grasp", "none")
    centre = (0.0, 0.0) if plane else (SIZE, SIZE / 2, SIZE / 2)
    if kind in ("force", "moment") and not plane:
        loads.append(pt.SurfaceForce(group, **{kind: draw.vector(0.1, 0.0, 0.01)}))
    elif kind == "pressure" and not plane:
        loads.append(pt.Pressure(group, draw(100.0)))
    elif kind == "motion" and not plane:
        loads.append(pt.PrescribedMotion(group, draw.vector(1e-4, 0.0, 0.0), until=draw(1e-3)))
    elif kind == "foundation" and not plane:
        loads.append(pt.Foundation(group, stiffness=draw(1e5), damping=draw(10.0)))
    elif kind == "contact":
        height = 0.012 if plane else SIZE + 0.012
        place = (0.0, 0.0, height) if plane else (SIZE / 2, SIZE / 2, height)
        tool = draw.one_of(pt.tools.Sphere, lambda r: pt.tools.Capsule(r, draw(0.01)), pt.tools.Punch)(draw(0.01))
        loads.append(pt.tools.Contact(tool, (draw.vector(*place), draw.vector(0.0, 0.0, 0.1)), friction=draw(0.2)))
    elif kind == "grasp":
        turned = ((*centre, 0.0)[:3], draw.vector(0.0, 0.0, 0.1))
        loads.append(pt.tools.Grasp(draw.vector(*centre), draw(0.03 if plane else 0.006), turned, until=draw(1e-3)))
    return loads


def _check(run: Any) -> None:
    assert isinstance(run, pt.Trajectory)
    values = (
        {name: getattr(run, name) for name in SERIES}
        | run.reactions
        | run.moments
        | {"contact_forces": run.contact_forces}
    )
    for name, value in values.items():
        assert np.isfinite(value).all(), f"{name} is not finite"


def main() -> None:
    """Run trials and print how they ended."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--trials", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--kind", nargs="+", choices=TRIALS, default=list(TRIALS))
    options = parser.parse_args()
    warnings.simplefilter("ignore", pt.TrustWarning)
    for kind in options.kind:
        ends: Counter[str] = Counter()
        for k in range(options.trials):
            try:
                ends[TRIALS[kind](np.random.default_rng([options.seed, k]))] += 1
            except Exception as error:  # the report of a fuzzer
                ends["escaped"] += 1
                print(f"{kind}, trial {k}: {type(error).__name__}: {str(error)[:200]}", flush=True)
        print(f"{kind}: " + ", ".join(f"{count} {end}" for end, count in sorted(ends.items())), flush=True)


if __name__ == "__main__":
    main()
