"""Random cuts of stretched bodies: whether they make energy, and how much they shorten the stable step.

A box is fixed on one side and held stretched; organs are free, stretched evenly and let go. Cuts are straight, curved,
crossing, through the body, or take off a sliver. A blade also goes out and in again, in the same place or less than
a spacing from it. Damping is the default one. `cuts.py` runs it.
"""

from __future__ import annotations

import time
from functools import cache

import numpy as np
import organs

import palpate as pt
from palpate.core.arrays import Floats
from palpate.dynamics.solid.cutting.cut import cut_from
from palpate.meshfree.cut.surface import swept

KINDS = ("straight", "curved", "crossing", "through", "sliver", "again", "adjacent")
BODIES = {  # name of the surface in `organs`, nodes, and duration of a run [s]
    "box": ("", 2600, 0.1),
    "generated liver": ("generated", 3000, 0.2),
    "HRA liver": ("HRA female 6k", 5000, 0.2),
    "SOFA liver": ("SOFA smooth", 10000, 0.1),
    "generated liver, fine": ("generated", 30000, 0.2),
}
BOX, BOX_SPACING, BOX_JITTER = np.array([40e-3, 40e-3, 20e-3]), 2.5e-3, 0.25
BETWEEN = 0.1  # share of a run between two cuts
FRAMES = 20
STEP, SPEED = 0.25, 0.2  # of a blade that advances, in spacings, and [m/s]


@cache
def cloud_of(name: str) -> pt.Cloud:
    source, nodes, _ = BODIES[name]
    if not source:
        return pt.box(BOX, BOX_SPACING, jitter=BOX_JITTER, seed=3)
    surface = organs.surface(source)
    return pt.fill(surface, organs.spacing_for(surface, nodes))


@cache
def stretched(name: str, poisson: float) -> tuple[pt.Solid, list, Floats]:
    """Return an uncut body, its loads, and displacements."""
    cloud = cloud_of(name)
    material = pt.materials.MooneyRivlin(C1=1000.0, C2=0.0, poisson=poisson, density=1000.0)
    if name == "box":
        body, loads = pt.Solid(cloud, material, "x-"), [pt.PrescribedMotion("x+", (0.15 * BOX[0], 0.0, 0.0))]
        return body, loads, pt.equilibrium(body, loads).displacements
    return pt.Solid(cloud, material), [], (cloud.points - cloud.points.mean(axis=0)) * [0.1, -0.03, -0.03]


def blade_path(
    points: Floats,
    spacing: float,
    center: Floats,
    normal: Floats,
    end: float,
    bend: float,
    turn: float,
    step: float = 2.0,
) -> list[Floats]:
    """Triangles of the steps of a cut through a place, `end` [m] beyond it, bent by so much [1/m], near the body."""
    normal = normal / np.linalg.norm(normal)
    first = np.linalg.svd(normal[None])[2][1]
    along = np.cos(turn) * first + np.sin(turn) * np.cross(normal, first)
    reach = float(np.linalg.norm(np.ptp(points, axis=0))) + 6 * spacing
    x = np.arange(-reach, min(end, reach) - 1e-3 * spacing, step * spacing)
    x = np.append(x, min(end, reach))[:, None]
    across = np.arange(-reach, reach + spacing, 2 * spacing)[:, None] * np.cross(normal, along)
    line = center + x * along + bend * x**2 * normal
    edges = line[:, None] + across[None]
    low, high = points.min(axis=0) - 5 * spacing, points.max(axis=0) + 5 * spacing
    steps = [swept(edges[k : k + 2]) for k in range(len(edges) - 1)]
    near = [each[np.any(np.all((each > low) & (each < high), axis=2), axis=1)] for each in steps]
    return [each for each in near if len(each)]


def random_paths(name: str, seed: int) -> tuple[str, list[dict]]:
    """Return the kind of a random cut, and the paths of one or two blades."""
    cloud, random, kind = cloud_of(name), np.random.default_rng(seed), KINDS[seed % len(KINDS)]
    points, h = cloud.points, cloud.spacing
    low, size = points.min(axis=0), np.ptp(points, axis=0)
    middle = points.mean(axis=0)
    draw = {
        "center": middle + size * (0.4 * random.random(3) - 0.2), "normal": random.normal(size=3),
        "end": np.inf if kind in ("through", "sliver") else random.uniform(-0.3, 0.3) * size.min(),
        "bend": random.uniform(-0.5, 0.5) / size.max() if kind == "curved" else 0.0,
        "turn": random.uniform(0, 2 * np.pi),
    }  # fmt: skip
    if kind == "sliver":
        axis = random.integers(1, 3)
        draw["normal"] = np.eye(3)[axis] + 0.03 * random.normal(size=3)
        draw["center"] = middle.copy()
        draw["center"][axis] = low[axis] + h * random.uniform(0.2, 1.3)
    paths = [draw]
    if kind == "crossing":
        other = {"normal": random.normal(size=3), "turn": random.uniform(0, 2 * np.pi)}
        paths.append({**draw, **other})
    if kind in ("again", "adjacent"):  # farther, and in another plane that is close by
        normal = draw["normal"] / np.linalg.norm(draw["normal"])
        aside = h * random.uniform(0.05, 1.0) * (kind == "adjacent")
        tilt = 0.02 * random.normal(size=3) * (kind == "adjacent")
        farther = {"center": draw["center"] + aside * normal, "normal": normal + tilt, "end": draw["end"] + 1.5 * h}
        paths.append({**draw, **farther})
    return kind, paths


def run(name: str, poisson: float, seed: int) -> dict:
    """Cut a stretched body, let it move, and return what became of its energy."""
    begin = time.perf_counter()
    body, loads, u = stretched(name, poisson)
    uncut, v, worst, seconds = body, np.zeros_like(u), -np.inf, 0.0
    kind, paths = random_paths(name, seed)
    cuts = [np.concatenate(blade_path(body.cloud.points, body.cloud.spacing, **path)) for path in paths]
    row = {
        "body": name, "nodes": len(body.cloud), "poisson": poisson, "seed": seed, "kind": kind, "stable": False,
    }  # fmt: skip
    changes = []
    try:
        for number, triangles in enumerate(cuts):
            before, start = body.strain_energy(u), time.perf_counter()
            body = cut_from(body, len(body.cut_surface.triangles), triangles)  # some are outside
            seconds += time.perf_counter() - start
            changes.append(body.strain_energy(u) / before - 1)
            share = 1.0 if number == len(cuts) - 1 else BETWEEN
            duration = share * BODIES[name][2]
            run = pt.rollout(
                body, loads, duration=duration, every=duration / FRAMES, displacement=u, velocity=v, progress=False
            )  # fmt: skip
            energy = run.kinetic + run.strain - run.external
            worst = max(worst, float(energy[1:].max() / energy[0] - 1))
            u, v = run.displacements[-1], run.velocities[-1]
    except (pt.CloudError, pt.DivergenceError) as error:
        row["why"] = " ".join(str(error).split())[:300]
        print(f"{name} nu {poisson} seed {seed} {kind}: FAILED {row['why']}", flush=True)
        return row
    momentum = body.masses @ v
    scale = float(body.masses.sum() * np.sqrt(2 * run.kinetic.max() / body.masses.sum()))
    row |= {
        "stable": True, "growth": worst, "energy_end": float(energy[-1] / energy[0]), "changes": changes,
        "step_ratio": uncut.stability.step / body.stability.step,
        "frequency_ratio": body.stability.highest_frequency / uncut.stability.highest_frequency,
        "released": len(body.released_nodes), "touched": int(body._cut.touched.sum()),
        "residuals": [float(each) for each in body._cut.residuals],
        "momentum": None if loads else float(np.abs(momentum).max() / scale),
        "cut_seconds": seconds, "seconds": time.perf_counter() - begin,
    }  # fmt: skip
    print(
        f"{name} nu {poisson} seed {seed} {kind}: growth {worst:+.1e}, end {row['energy_end']:.3f}, step ratio "
        f"{row['step_ratio']:.2f}, released {row['released']}, touched {row['touched']}, changes "
        f"{' '.join(f'{each:+.3f}' for each in changes)}, residuals {row['residuals'][0]:.0e} "
        f"{row['residuals'][1]:.0e}, momentum {row['momentum']}, {row['cut_seconds']:.1f} of {row['seconds']:.0f} s",
        flush=True,
    )  # fmt: skip
    return row


def advance(name: str, poisson: float, seed: int) -> dict:
    """Move the second blade of a random cut in steps of `STEP` through the body with its first cut, at rest.

    Returns the energy that the steps made and released at fixed displacements, over that of the body at rest.
    """
    begin = time.perf_counter()
    body, loads, u = stretched(name, poisson)
    points, spacing = body.cloud.points, body.cloud.spacing
    kind, (first, second) = random_paths(name, seed)
    body = pt.cut(body, np.concatenate(blade_path(points, spacing, **first)))
    start = pt.equilibrium(body, loads, displacement=u)
    u, v, changes = start.displacements, np.zeros_like(u), []
    steps = blade_path(points, spacing, **second, step=STEP)
    for triangles in steps:
        cut = cut_from(body, len(body.cut_surface.triangles), triangles)  # the blade has passed the body at its end
        changes.append((cut.strain_energy(u) - body.strain_energy(u)) / start.strain_energy)
        duration, body = STEP * spacing / SPEED, cut
        run = pt.rollout(
            body, loads, duration=duration, every=duration, displacement=u, velocity=v, progress=False
        )  # fmt: skip
        u, v = run.displacements[-1], run.velocities[-1]
    row = {
        "body": name, "poisson": poisson, "seed": seed, "kind": kind, "steps": len(steps),
        "made": sum(each for each in changes if each > 0), "freed": -sum(each for each in changes if each < 0),
        "largest": max(changes), "end": float(run.kinetic[-1] + run.strain[-1]) / start.strain_energy,
        "seconds": time.perf_counter() - begin,
    }  # fmt: skip
    print(
        f"{name} nu {poisson} seed {seed} {kind}: {len(steps)} steps made {row['made']:.4f}, freed {row['freed']:.4f}, "
        f"end {row['end']:.3f}, {row['seconds']:.0f} s", flush=True,
    )  # fmt: skip
    return row
