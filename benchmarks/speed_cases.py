"""Cases of `speed.py`: the paper's beam, and a large reduced model trained on two bodies."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, cast

import numpy as np
from timing import force_seconds, median_seconds, read_seconds, step_seconds

from palpate.app.common.console import Console
from palpate.core.faults import TrustWarning
from palpate.dynamics.loads.prepared import Load
from palpate.dynamics.loads.surface_force import SurfaceForce
from palpate.dynamics.run.model import Model
from palpate.dynamics.run.rollout import rollout
from palpate.dynamics.run.trajectory import Trajectory
from palpate.dynamics.solid.model import Solid
from palpate.meshfree.cloud import box
from palpate.reduction.hyper.model import ReducedModel
from palpate.reduction.training.reduce import hyper_reduce
from palpate.scenes.beam import beam
from palpate.tissue.materials import MooneyRivlin

BEAM_MODES = 8  # modes for the beam
LARGE_MODEL_MODES, LARGE_MODEL_NODES = 64, 256  # modes and nodes of the large model
BLOCK_EDGE_NODES = (10, 27)  # nodes along the edges of a block: 1,000 and 19,683 nodes
BLOCK_EDGE = 0.05  # [m]
# of a training run of the block: snapshots, time [s], share of the stable step
BLOCK_FRAMES, RUN_SECONDS, BLOCK_STEP_SHARE = 24, 0.006, 0.9
CUBATURE_TOLERANCE = 0.1  # of a model for timing alone; its nodes are repeated up to SAMPLED
BYTES_BEYOND_CACHES = 256_000_000  # bytes that no cache holds
CHUNK_STEPS = 50  # steps that `rollout` takes at once

# forces [N] and moments [N m] on the block's face, each with its own number of swings
FACE_LOADS = (((8.0, 0.0, 0.0), 0.0), ((0.0, 3.0, 1.0), 0.0), ((-2.0, 1.0, -3.0), 0.0), ((1.0, 0.0, 0.0), 0.1))


def beam_case(spacing: float, repeats: int, forms: Sequence[str], console: Console) -> dict[str, Any]:
    """Measure the paper's pull of the beam [m]: forms of the full model, and the hyper-reduced one."""
    case = beam(spacing=spacing)
    strong = cast(Solid, case.model)
    bodies = {"strong": strong, "energy": Solid(strong.cloud, strong.material, strong.supports, form="energy")}
    seconds: dict[str, list[float]] = {form: [] for form in (*forms, "reduced")}
    steps: dict[str, int] = {}

    def pull(name: str, model: Model) -> Trajectory:
        if name not in steps:  # compiles
            rollout(model, case.loads, duration=1e-3, every=1e-3, progress=False)
        with warnings.catch_warnings(action="ignore", category=TrustWarning):  # speed counts here
            run = rollout(model, case.loads, duration=case.duration, every=case.every)
        seconds[name].append(run.wall_seconds)
        steps[name] = int(run.steps[-1])
        at = f"beam, {1e3 * spacing:g} mm, round {len(seconds[name])} of {repeats}"
        console.say(f"{at}: {name}, {run.wall_seconds:.3g} s for {case.duration:g} s, {steps[name]} steps")
        return run

    fast: ReducedModel | None = None
    for _ in range(repeats):
        runs = [pull(form, bodies[form]) for form in forms]
        fast = fast or hyper_reduce(bodies[forms[0]], runs[0], modes=BEAM_MODES)
        pull("reduced", fast)
    assert fast is not None
    prepared = fast.prepare(case.loads)
    measured = {name: _pull(walls, steps[name], case.duration) for name, walls in seconds.items()}
    reduced_run = measured.pop("reduced")
    return {
        "spacing": spacing,
        "nodes": len(strong.cloud),
        "full": measured,
        "hyper_reduced": reduced_run
        | {
            "modes": BEAM_MODES,
            "nodes": len(fast.data.cubature.nodes),
            "seconds_per_step": reduced_run["wall_seconds"] / reduced_run["steps"],
            "compiled_seconds_per_step": step_seconds((fast, prepared, fast.state(prepared)))[0],
            "ratio": {form: reduced_run["wall_seconds"] / full["wall_seconds"] for form, full in measured.items()},
        },
    }


def _pull(seconds: list[float], steps: int, duration: float) -> dict[str, Any]:
    median = float(np.median(seconds))
    return {
        "wall_seconds": median,
        "rounds": seconds,
        "steps": steps,
        "steps_per_second": steps / median,
        "real_time_factor": duration / median,
    }


def large_case(repeats: int, console: Console) -> dict[str, Any]:
    """Measure a model of many modes: its force over reading its table, and its step after training on two bodies."""
    bodies = []
    for nodes in BLOCK_EDGE_NODES:
        console.say(f"block of {nodes**3} nodes: {len(FACE_LOADS)} runs, training {LARGE_MODEL_MODES} modes ...")
        model = _with_samples(_trained_on_block(nodes), LARGE_MODEL_NODES)
        prepared = model.prepare([_load(0)])
        bodies.append((model, prepared, model.state(prepared)))
    small, rounds = bodies[0][0], max(repeats, 15)
    force, reading = force_seconds(small, rounds)
    table = small.body.points.table.nbytes
    from_memory = table * read_seconds(np.ones(BYTES_BEYOND_CACHES // 8), repeats=rounds) / BYTES_BEYOND_CACHES
    steps = step_seconds(*bodies, repeats=rounds)
    chunks = median_seconds(*(_chunk(*each) for each in bodies), repeats=rounds)
    return {
        "modes": LARGE_MODEL_MODES,
        "nodes": LARGE_MODEL_NODES,
        "force_seconds": force,
        "table_bytes": table,
        "read_seconds": reading,
        "read_bytes_per_second": table / reading,
        "force_over_reading": force / reading,
        "memory_read_seconds": from_memory,
        "force_over_memory_reading": force / from_memory,
        "bodies": [
            {"nodes": n**3, "compiled_seconds_per_step": step, "seconds_per_step": chunk / CHUNK_STEPS}
            for n, step, chunk in zip(BLOCK_EDGE_NODES, steps, chunks, strict=True)
        ],
        "compiled_step_ratio": steps[1] / steps[0],
        "step_ratio": chunks[1] / chunks[0],
    }


def _chunk(model: ReducedModel, prepared: Any, state: Any) -> Callable[[], Any]:
    """Return a call that takes steps as `rollout` does."""
    step, state = model.stable_step(state, prepared)
    work = model.workspace()
    return lambda: model.advance(state, prepared, step, CHUNK_STEPS, work)


def _load(k: int) -> Load:
    force, twist = FACE_LOADS[k]

    def share(time: float) -> float:
        return math.sin((1 + k) * math.pi * time / RUN_SECONDS / 2) ** 2

    def pull(time: float) -> list[float]:
        return [share(time) * part for part in force]

    return SurfaceForce("x+", force=pull, moment=lambda time: (share(time) * twist, 0.0, 0.0))


def _trained_on_block(nodes: int) -> ReducedModel:
    """Train on a few short runs of a block."""
    law = MooneyRivlin(C1=60e3, C2=1.2e3, density=1120.0, poisson=0.45)
    body = Solid(box((BLOCK_EDGE,) * 3, BLOCK_EDGE / (nodes - 1)), law, "x-", form="energy")
    every = RUN_SECONDS / BLOCK_FRAMES
    step = every / np.ceil(every / (BLOCK_STEP_SHARE * body.stability.step))
    runs = [rollout(body, [_load(k)], duration=RUN_SECONDS, every=every, step=step) for k in range(len(FACE_LOADS))]
    return hyper_reduce(body, runs, modes=LARGE_MODEL_MODES, cubature=CUBATURE_TOLERANCE)


def _with_samples(model: ReducedModel, count: int) -> ReducedModel:
    """Return a model with a number of sampled nodes: the heaviest ones, or all, some in several equal parts.

    A node in parts leaves the energy as it is.
    """
    rule = model.data.cubature
    index = np.resize(np.argsort(-rule.weights), count)
    parts = 1 / np.bincount(index, minlength=len(rule.nodes))[index]
    cubature = replace(
        rule, nodes=rule.nodes[index], weights=rule.weights[index] * parts, pressure=rule.pressure[:, index] * parts
    )
    sampled = model.data.sampled
    return model.with_data(sampled=replace(sampled, cubature=cubature, gradients=sampled.gradients[index]))
