"""Draw extreme values for a small body, its loads and its run: each is refused by name, or runs to finite numbers.

`trial` is one draw. Values are log-uniform over all of double precision, or zero, negative, infinite, not a number, or
ordinary. Anything else than `palpate.InputError`, `palpate.DivergenceError` or a finite trajectory raises.

    python validation/fuzz_physics.py --trials 500 --seed 0
"""

from __future__ import annotations

import argparse
import warnings
from collections import Counter
from dataclasses import replace
from time import perf_counter
from typing import Any

import numpy as np

import palpate as pt

SIZE, SPACING = 0.015, 0.005  # [m] 64 nodes
STEPS, FRAMES = 100, 3  # of an ordinary run
MAX_SECONDS = 30.0  # [s] of a trial, after kernels are compiled
ASKED = 10 * STEPS * FRAMES  # stable steps of a run above which it may take longer: it is ended, and counts as one
ODD = (0.0, -0.0, 5e-324, 1e308, np.inf, -np.inf, np.nan)
SERIES = ("times", "displacements", "velocities", "kinetic", "strain", "external", "dissipated")


class TooLong(Exception):
    """A trial took longer than it may."""


def trial(rng: np.random.Generator) -> str:
    """Run one trial.

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
    given: dict[str, Any] = {"stiffness_damping": draw(6e-5)} if draw.rng.random() < 0.7 else {}
    if form == "energy" and draw.rng.random() < 0.1:
        given["stiffness"] = {"x+": draw(2.0)}
    return pt.Solid(cloud, material, draw.one_of("x-", "x-", ()), form=form, **given)


def _sheet(draw: _Draw) -> pt.Membrane:
    cloud = pt.disc(draw(0.1), draw(0.025))
    if len(cloud) > 1000:
        raise pt.InputError("too many nodes for a trial")
    material = pt.materials.NeoHookean(C1=draw(1e5), density=draw(1000.0), poisson=0.5)
    given = {"stiffness_damping": draw(1e-5)} if draw.rng.random() < 0.3 else {}
    return pt.Membrane(cloud, material, draw(1e-4), "rim", prestretch=draw(1.1), **given)


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
    options = parser.parse_args()
    ends: Counter[str] = Counter()
    for k in range(options.trials):
        try:
            ends[trial(np.random.default_rng([options.seed, k]))] += 1
        except Exception as error:  # the report of a fuzzer
            ends["escaped"] += 1
            print(f"trial {k}: {type(error).__name__}: {str(error)[:200]}", flush=True)
    print(", ".join(f"{count} {end}" for end, count in sorted(ends.items())))


if __name__ == "__main__":
    main()
