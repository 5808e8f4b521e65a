"""A long cut in a strip under pure shear, against the energy per area of the strip ahead; `cuts.py` runs it.

The sides of the strip move apart. Far behind the front the tissue has no energy, far ahead it has the energy W of a
wide strip, so G = W H for a strip of height H (Rivlin and Thomas, J. Polym. Sci. 10, 1953), at any strain. W comes from
the same strip without a cut.
"""

from __future__ import annotations

import time

import numpy as np

import palpate as pt
from palpate.core.arrays import Floats
from palpate.meshfree.cut.surface import swept

SPACING = 2.5e-3
SIZE = np.array([90e-3, 22.5e-3, 10e-3])
PLANE = 0.5 * SIZE[1] + 0.15 * SPACING  # between nodes
FIRST_END, WAY = 37.5e-3, 3.0  # [m], and spacings by which the front moves
SHORTEST_STEP = 0.25  # of the front, in spacings
STEPS = (0.25, 0.5, 1.0, 2.0)
AHEAD = (20e-3, 70e-3)  # where the uncut strip is far from its ends
POISSON, SHEAR_MODULUS = 0.45, 1e3
COMMON = {"poisson": POISSON, "density": 1000.0}
LAWS = {
    "neo-Hookean": pt.materials.MooneyRivlin(C1=SHEAR_MODULUS, C2=0.0, **COMMON),
    "Gent": pt.materials.Gent(mu=SHEAR_MODULUS, Jm=8.0, **COMMON),
    "Ogden": pt.materials.Ogden(C=SHEAR_MODULUS / 8, alpha=4.0, **COMMON),
}


def front_edges(ends: Floats) -> Floats:
    """Positions (k, 9, 3) [m] of a straight front across the strip, from behind one face to beyond the other."""
    across = np.linspace(-3 * SPACING, SIZE[2] + 3 * SPACING, 9)
    return np.stack(np.broadcast_arrays(np.asarray(ends)[:, None], PLANE, across), axis=2)


def opened(body: pt.Solid, end: float, start: float = -3 * SPACING) -> pt.Solid:
    """Cut the strip from one end of the cut to another."""
    return pt.cut(body, swept(front_edges(np.array([start, end]))))


def energy_per_area(body: pt.Solid, u: Floats) -> float:
    """Energy [J/m^2] of an uncut strip for a unit of length and thickness, from its columns far from the ends."""
    energies = body.evaluate(u).energy_density * body.volumes
    column = np.rint(body.cloud.points[:, 0] / SPACING).astype(int)
    first, last = (round(x / SPACING) for x in AHEAD)
    return float(np.bincount(column, energies)[first : last + 1].mean() / (SPACING * SIZE[2]))


def strip(law: str, stretch: float, jitter: float, moving: bool, way: float = WAY) -> dict:
    """Energy release of fronts between two ends, and what a step of the front does at fixed displacements."""
    begin = time.perf_counter()
    cloud = pt.box(SIZE, SPACING, jitter=jitter, seed=4)
    uncut = pt.Solid(cloud, LAWS[law], "y-")
    loads = [pt.PrescribedMotion("y+", (0.0, stretch * SIZE[1], 0.0))]
    u = pt.equilibrium(uncut, loads).displacements
    expected = energy_per_area(uncut, u)
    ends = FIRST_END + SPACING * np.arange(0.0, way + 1e-9, SHORTEST_STEP)
    bodies, states = [opened(uncut, ends[0])], []
    for end in ends[1:]:
        bodies.append(opened(bodies[-1], end, end - SHORTEST_STEP * SPACING))
    for body in bodies:
        states.append(equilibrium(body, loads, [u, np.zeros_like(u)]))
        u = states[-1].displacements
    energies = np.array([state.strain_energy for state in states])
    line = np.polyfit(ends, energies, 1)
    unit = expected * SIZE[2]
    changes = {}
    for step in (each for each in STEPS if each <= way):
        k = round(step / SHORTEST_STEP)
        change = [
            (after.strain_energy(state.displacements) - state.strain_energy) / (unit * step * SPACING)
            for state, after in zip(states, bodies[k:], strict=False)
        ]
        changes[f"{step:g}"] = {"mean": float(np.mean(change)), "low": min(change), "high": max(change)}
    row = {
        "law": law, "stretch": stretch, "jitter": jitter, "poisson": POISSON, "nodes": len(cloud),
        "energy_per_area": expected, "release": -line[0] / unit - 1,
        "staircase": float(np.std(energies - np.polyval(line, ends)) / (unit * SPACING)), "changes": changes,
        "frequency": max(body.stability.highest_frequency for body in bodies) / uncut.stability.highest_frequency,
        "released": max(len(body.released_nodes) for body in bodies),
    }  # fmt: skip
    if moving:
        row["moving"] = [move(bodies[0], states[0], loads, unit, *case) for case in ((0.05, 0.25), (0.05, 1.0))]
    row["seconds"] = time.perf_counter() - begin
    print(
        f"strip of {law}, stretch {stretch}, jitter {jitter}: release {row['release']:+.2%}, staircase "
        f"{row['staircase']:.3f} h, changes " + ", ".join(
            f"{step} h {each['mean']:+.2f} ({each['low']:+.2f} to {each['high']:+.2f})"
            for step, each in changes.items()
        ) + f", frequency {row['frequency']:.2f}, released {row['released']}, {row['seconds']:.0f} s", flush=True,
    )  # fmt: skip
    for each in row.get("moving", []):
        print(
            f"  front at {each['speed']} m/s in steps of {each['step']} h: lost {each['lost']:.2f} G dA, at fixed "
            f"displacements {each['at_once']:.2f}, damped {each['damped']:.2f}, kinetic {each['kinetic']:.2f}",
            flush=True,
        )  # fmt: skip
    return row


def equilibrium(body: pt.Solid, loads: list, starts: list[Floats]) -> pt.typing.Equilibrium:
    """Return the equilibrium from the first state from which there is one."""
    for start in starts[:-1]:
        try:
            return pt.equilibrium(body, loads, displacement=start)
        except pt.DivergenceError:
            continue
    return pt.equilibrium(body, loads, displacement=starts[-1])


def move(body: pt.Solid, state: pt.typing.Equilibrium, loads: list, unit: float, speed: float, step: float) -> dict:
    """Shares of G dA of a front that moves by three spacings: released at fixed displacements, damped, kinetic."""
    u, v, at_once = state.displacements, np.zeros_like(state.displacements), 0.0
    end, last = FIRST_END, FIRST_END + WAY * SPACING
    while end < last - 1e-9:
        cut = opened(body, end + step * SPACING, end)
        at_once += body.strain_energy(u) - cut.strain_energy(u)
        end, body = end + step * SPACING, cut
        duration = step * SPACING / speed
        run = pt.rollout(
            body, loads, duration=duration, every=duration, displacement=u, velocity=v, progress=False
        )  # fmt: skip
        u, v = run.displacements[-1], run.velocities[-1]
    whole = unit * (last - FIRST_END)
    kinetic = 0.5 * float(body.masses @ np.sum(v**2, axis=1))
    lost = state.strain_energy - body.strain_energy(u)
    return {
        "speed": speed, "step": step, "lost": lost / whole, "at_once": at_once / whole, "kinetic": kinetic / whole,
        "damped": (lost - at_once - kinetic) / whole,
    }  # fmt: skip
