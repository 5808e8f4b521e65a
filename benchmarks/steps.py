"""Steps and runs with one and two threads, steps of a quarter and the whole of a body, and equilibria.

    python benchmarks/steps.py
    GOMP_SPINCOUNT=1000 python benchmarks/steps.py

All times are the least of several in turn. Run nothing else on the processors meanwhile.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from time import perf_counter

import numba

import palpate as pt

SOFT = pt.materials.MooneyRivlin(C1=500.0, C2=200.0, density=1000.0, poisson=0.45)
SIZES = ((0.1, 0.02, 0.02), (0.2, 0.02, 0.02), (0.2, 0.025, 0.025), (0.2, 0.03, 0.03))
RUN_SIZES = {(0.2, 0.02, 0.02): 800, (0.4, 0.04, 0.04): 200, (0.84, 0.05, 0.05): 100}  # steps by size of the body
STEPS = 200


def stepper(model: pt.Solid, threads: int) -> Callable[[], float]:
    """Return a function that returns the time [s] of a step."""
    prepared, work = model.prepare([]), model.workspace()
    state = model.state(prepared)

    def seconds() -> float:
        numba.set_num_threads(threads)
        began = perf_counter()
        model.advance(state, prepared, 1e-6, STEPS, work)
        return (perf_counter() - began) / STEPS

    seconds()
    return seconds


def runner(model: pt.Solid, threads: int, steps: int) -> Callable[[], float]:
    """Return a function that returns the time [s] of a step in a run, with the estimates of the stable step."""
    duration, load = steps * model.stability.step, pt.Gravity((0.0, 0.0, -1e-3))

    def seconds() -> float:
        numba.set_num_threads(threads)
        run = pt.rollout(model, [load], duration=duration, every=duration, progress=False)
        return run.wall_seconds / float(run.steps[-1])

    seconds()
    return seconds


def least(*functions: Callable[[], float], rounds: int = 10) -> list[float]:
    """Return the least values of functions that are called in turn."""
    found = [[function() for function in functions] for _ in range(rounds)]
    return [min(column) for column in zip(*found, strict=True)]


def main() -> None:
    most = numba.config.NUMBA_NUM_THREADS
    print(f"GOMP_SPINCOUNT={os.environ['GOMP_SPINCOUNT']}, step [us] with 1 and {most} threads")
    for size in SIZES:
        for form in ("energy", "strong"):
            model = pt.Solid(pt.box(size, 0.005), SOFT, "x-", form=form)
            one, all_ = least(stepper(model, 1), stepper(model, most))
            print(f"  {len(model.cloud):6d} nodes, {form}: {1e6 * one:.0f} {1e6 * all_:.0f}")
    print(f"steps of runs [us] with 1 and {most} threads, and their ratio")
    for size, steps in RUN_SIZES.items():
        model = pt.Solid(pt.box(size, 0.005), SOFT, "x-")
        one, all_ = least(runner(model, 1, steps), runner(model, most, steps), rounds=5)
        print(f"  {len(model.cloud):6d} nodes: {1e6 * one:.0f} {1e6 * all_:.0f}, {one / all_:.2f}")
    print(f"a quarter and the whole body, step [us], {most} threads")
    for form in ("energy", "strong"):
        quarter = ["x-", pt.SymmetryPlane("y-"), pt.SymmetryPlane("z-")]
        part = pt.Solid(pt.box((0.08, 0.03, 0.03), 0.0025), SOFT, quarter, form=form, stiffness_damping=2e-4)
        whole = pt.Solid(pt.box((0.08, 0.06, 0.06), 0.0025), SOFT, "x-", form=form, stiffness_damping=2e-4)
        small, large = least(stepper(part, most), stepper(whole, most), rounds=3)
        nodes = f"{len(part.cloud)} and {len(whole.cloud)} nodes"
        print(f"  {nodes}, {form}: {1e6 * small:.0f} {1e6 * large:.0f}, ratio {small / large:.2f}")
    print("equilibria of the paper's beam, energy form [s]")
    law = pt.materials.MooneyRivlin(C1=60e3, C2=1.2e3, density=1120.0, poisson=0.49)
    beam = pt.Solid(pt.box((0.2, 0.02, 0.02), 0.005), law, "x-")
    for force in ((0.0, 0.1, 0.0), (10.0, 0.0, 0.0), (100.0, 0.0, 0.0)):

        def solve(force: tuple[float, float, float] = force) -> float:
            began = perf_counter()
            pt.equilibrium(beam, [pt.SurfaceForce("x+", force=force)])
            return perf_counter() - began

        print(f"  {force} N: {least(solve, rounds=2)[0]:.2f}")


if __name__ == "__main__":
    main()
